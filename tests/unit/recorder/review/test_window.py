"""When the arbiter was given the frames by which it decided."""

import random

import msgspec
from hypothesis import given
from hypothesis import strategies as st

from recorder.review.window import given_until
from schemas.can_word import ERROR, EXTENDED, REMOTE
from schemas.decisions import Journal
from schemas.journal import Kind
from tests.support.messages import GEAR_FEEDBACK, MS, SECOND, WALL_NS, feedback

TICK_NS = 10 * MS
START_NS = 77 * SECOND
"""The monotonic clock at WALL_NS."""


def inputs_of(ticks: range, waited_ns: int = 3 * MS) -> list[list[object]]:
    """A frame in the middle of each tick, which the bus had so much earlier, and the tick."""
    inputs: list[list[object]] = []
    for tick in ticks:
        at_ns = tick * TICK_NS
        frame = [EXTENDED | GEAR_FEEDBACK, feedback(tick), WALL_NS + at_ns - 5 * MS - waited_ns]
        inputs.append([Kind.FRAME, START_NS + at_ns - 5 * MS, frame])
        inputs.append([Kind.TICK, START_NS + at_ns, WALL_NS + at_ns, 0, b"8 bytes."])
    return inputs


def journal(first_tick: int, ticks: int = 5, run: int = 7, inputs: bytes | None = None) -> Journal:
    """The journal of so many ticks."""
    span = range(first_tick, first_tick + ticks)
    encoded = msgspec.msgpack.encode(inputs_of(span)) if inputs is None else inputs
    return Journal(WALL_NS + span[-1] * TICK_NS, first_tick // 5, run, 2 * first_tick, 2 * ticks, encoded)


JOURNALS = [journal(first) for first in range(0, 100, 5)]


def counters(at_ns: int, journals: list[Journal], shift_ns: int = 0) -> list[int]:
    """The alive counters of the frames that the arbiter was given."""
    found = given_until(at_ns, journals, shift_ns)
    return [] if found is None else [frame.alive_counter for frame in found.frames.get(GEAR_FEEDBACK, [])]


@given(st.integers(0, 99), st.integers(-4 * MS, 4 * MS), st.integers(-5 * SECOND, 5 * SECOND))
def test_what_came_before_the_tick_of_the_moment_was_given(tick: int, off_ns: int, shift_ns: int) -> None:
    """And nothing that came behind it, on whatever clock."""
    at_ns = WALL_NS + tick * TICK_NS + shift_ns
    assert counters(at_ns + off_ns, JOURNALS, shift_ns) == [number % 16 for number in range(tick + 1)]
    found = given_until(at_ns + off_ns, JOURNALS, shift_ns)
    assert found is not None
    last = found.frames[GEAR_FEEDBACK][-1]
    assert (last.time_ns, last.waited_ns) == (at_ns - 5 * MS, 3 * MS)


def test_the_time_is_that_of_the_monotonic_clock() -> None:
    """The wall clock was set by an hour between the frame and the tick: the frame is no older for that."""
    inputs = inputs_of(range(5))
    inputs[-1][2] = WALL_NS + 3600 * SECOND
    found = given_until(WALL_NS + 3600 * SECOND, [journal(0, inputs=msgspec.msgpack.encode(inputs))], 0)
    assert found is not None
    assert found.frames[GEAR_FEEDBACK][-1].time_ns == WALL_NS + 3600 * SECOND - 5 * MS


def test_a_gap_ends_what_is_known() -> None:
    """What came before a part of the journal that is missing is left to the raw frames."""
    journals = [*JOURNALS[:10], *JOURNALS[11:]]
    at_ns = WALL_NS + 60 * TICK_NS
    found = given_until(at_ns, journals, 0)
    assert found is not None
    assert found.from_ns == WALL_NS + 55 * TICK_NS - 5 * MS
    assert counters(at_ns, journals) == [number % 16 for number in range(55, 61)]


def test_a_moment_that_the_journal_does_not_hold_is_not_guessed() -> None:
    """Before it, behind it, in a gap, without any."""
    assert given_until(WALL_NS - SECOND, JOURNALS, 0) is None
    assert given_until(WALL_NS + 2 * SECOND, JOURNALS, 0) is None
    assert given_until(WALL_NS + 54 * TICK_NS, [*JOURNALS[:9], *JOURNALS[15:]], 0) is None
    assert given_until(WALL_NS, [], 0) is None


def test_frames_that_are_no_data_frames_of_the_chassis_are_left_out() -> None:
    """Standard identifiers, remote frames and error frames."""
    inputs = [
        [Kind.FRAME, START_NS, [word, feedback(0), WALL_NS]]
        for word in (0x123, EXTENDED | REMOTE | GEAR_FEEDBACK, EXTENDED | ERROR | GEAR_FEEDBACK)
    ]
    inputs.append([Kind.TICK, START_NS, WALL_NS, 0, b""])
    found = given_until(WALL_NS, [journal(0, inputs=msgspec.msgpack.encode(inputs))], 0)
    assert found is not None
    assert found.frames == {}


def test_a_damaged_journal_never_raises() -> None:
    """Bytes flipped anywhere, and anything that MessagePack can say."""
    chance = random.Random(5)  # noqa: S311 - the same damage each time
    whole = msgspec.msgpack.encode(inputs_of(range(5)))
    for _ in range(2000):
        damaged = bytearray(whole)
        for _ in range(chance.randrange(1, 4)):
            damaged[chance.randrange(len(damaged))] = chance.randrange(256)
        given_until(WALL_NS + 4 * TICK_NS, [journal(0, inputs=bytes(damaged))], 0)
    wrong: list[object] = [[], [[]], [[3]], [[3, None, 5]], [[0, 1, 2], [3, 1, WALL_NS]], {"a": 1}]
    for one in wrong:
        given_until(WALL_NS, [journal(0, inputs=msgspec.msgpack.encode(one))], 0)
