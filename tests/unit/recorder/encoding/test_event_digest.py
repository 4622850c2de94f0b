"""The digest of a log holds what its questions need, however the log was written, and says when it is none."""

from itertools import pairwise

import msgspec
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from recorder.encoding import event_digest
from recorder.encoding.event_digest import (
    KEPT_NS,
    PASSED_MAX,
    Digest,
    DigestedMessage,
    DigestUnreadableError,
    EventDigest,
)
from recorder.mcap.channel import LogChannel
from schemas.decisions import Decision, SafetyEvent, SafetyState, Verdict
from schemas.messages import Message
from tests.support.logs import channel_of, encoded, sealed
from tests.support.messages import MS, SECOND, WALL_NS, arbiter, event, refusal

STATES, EVENTS, DECISIONS, OTHERS = 1, 2, 3, 4
CHANNELS = (channel_of(SafetyState, STATES), channel_of(SafetyEvent, EVENTS), channel_of(Decision, DECISIONS))

STEP = event_digest.PLACE_BYTES

Logged = tuple[int, int, int, int, bytes]
"""Channel, sequence, log time, publish time and data."""


def logged(channel: int, message: Message, lag_ns: int = 0) -> Logged:
    """A message as it stands in a chunk."""
    return channel, message.sequence, message.time_ns + lag_ns, message.time_ns, encoded(message)


def digest_of(chunks: list[list[Logged]], channels: tuple[LogChannel, ...] = CHANNELS, step: int = STEP) -> Digest:
    """The digest of a log of these chunks, each so many bytes behind the one before; written and read."""
    made = EventDigest()
    for channel in channels:
        made.add_channel(channel)
    parts = []
    for number, chunk in enumerate(chunks):
        made.add_chunk(sealed(chunk), 100 + number * step)
        parts.append(made.take_part())
    parts.append(made.take_end())
    return Digest(filter(None, parts), sum(map(len, chunks)))


def kept(digest: Digest, channel: int) -> list[int]:
    """The sequences of a channel in it."""
    return [one.sequence for one in digest.messages if one.channel_id == channel]


def accepted(number: int, **other: object) -> Decision:
    """A drive command of a stream that was accepted."""
    base = refusal(number)
    time_ns = WALL_NS + number * 20 * MS
    return msgspec.structs.replace(
        base, time_ns=time_ns, sequence=number, tick=2 * number, request="drive", verdict=Verdict.ACCEPTED, **other
    )


def test_of_states_that_say_the_same_two_a_second_are_kept() -> None:
    """The first, the last, and what is needed to see that there was no silence."""
    states = [logged(STATES, arbiter(number)) for number in range(100)]
    digest = digest_of([states])
    found = [one for one in digest.messages if one.channel_id == STATES]
    assert (found[0].sequence, found[-1].sequence) == (0, 99)
    gaps = [two.log_ns - one.log_ns for one, two in pairwise(found)]
    assert max(gaps) <= KEPT_NS
    assert len(found) < 20


@pytest.mark.parametrize("changed", [{"lease_holder": "berta"}, {"guarded": False}])
def test_a_change_is_kept_with_the_state_before_it(changed: dict[str, object]) -> None:
    """Entries of the change are made of both."""
    states = [arbiter(number) for number in range(40)]
    states[25] = msgspec.structs.replace(states[25], **changed)
    assert {24, 25, 26} <= set(kept(digest_of([[logged(STATES, one) for one in states]]), STATES))


def test_both_sides_of_a_gap_are_kept() -> None:
    """Of sequences, and of time."""
    numbers = [*range(15), *range(17, 40)]
    late = [logged(STATES, arbiter(number)) for number in numbers]
    assert {14, 17} <= set(kept(digest_of([late]), STATES))
    pause = [arbiter(number) for number in range(40)]
    pause = [
        msgspec.structs.replace(one, time_ns=one.time_ns + SECOND * (number > 20))
        for number, one in enumerate(pause)
    ]
    assert {20, 21} <= set(kept(digest_of([[logged(STATES, one) for one in pause]]), STATES))


def test_states_of_another_clock_are_all_kept() -> None:
    """By them the offset of the clocks is found; so they are where they came late."""
    for lag_ns in (-SECOND, SECOND):
        states = [logged(STATES, arbiter(number), lag_ns) for number in range(30)]
        assert kept(digest_of([states]), STATES) == list(range(30))


def test_a_stream_of_accepted_commands_is_counted_and_all_else_is_kept() -> None:
    """The last before a refusal and the first behind it are there, with how many were left out."""
    decisions = [accepted(number) for number in range(50)]
    decisions[20] = msgspec.structs.replace(decisions[20], verdict=Verdict.REFUSED)
    decisions[30] = msgspec.structs.replace(decisions[30], request="park")
    digest = digest_of([[logged(DECISIONS, one) for one in decisions if one.sequence != 40]])
    found = [(one.sequence, one.passed) for one in digest.messages]
    assert found == [(0, 0), (19, 18), (20, 0), (21, 0), (29, 7), (30, 0), (31, 0), (39, 7), (41, 0), (49, 7)]


def test_however_long_a_stream_is_what_is_left_out_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """A reader counts it one by one."""
    monkeypatch.setattr(event_digest, "PASSED_MAX", 10)
    digest = digest_of([[logged(DECISIONS, accepted(number)) for number in range(100)]])
    assert {one.passed for one in digest.messages} <= set(range(11))
    assert sum(one.passed + 1 for one in digest.messages) == 100


def test_events_are_there_as_they_are_in_the_order_of_the_file() -> None:
    """Among the states, though these are decided on later."""
    chunk = [
        logged(STATES, arbiter(0)),
        logged(EVENTS, event(0)),
        logged(STATES, arbiter(1)),
        logged(EVENTS, event(1)),
    ]
    digest = digest_of([chunk])
    assert [(one.channel_id, one.sequence, one.data) for one in digest.messages] == [
        (one[0], one[1], one[4]) for one in chunk
    ]


def test_schemas_of_other_versions_are_not_told_of() -> None:
    """Their numbers may mean something else; who asks reads the log."""
    other = msgspec.structs.replace(CHANNELS[0], schema_data=b"another")
    digest = digest_of([[logged(STATES, arbiter(0)), logged(EVENTS, event(0))]], (other, *CHANNELS[1:]))
    assert digest.channels == {EVENTS, DECISIONS}
    assert kept(digest, STATES) == []
    assert EventDigest().take_end() == b""


def test_a_state_that_cannot_be_read_is_kept() -> None:
    """It is the log's, and perhaps the question's business."""
    broken = [(STATES, number, WALL_NS + number, WALL_NS + number, b"\xff") for number in range(9)]
    assert kept(digest_of([broken]), STATES) == list(range(9))


def test_a_long_log_has_its_digest_in_several_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Memory is bounded; together they are one."""
    monkeypatch.setattr(event_digest, "BLOCK_BYTES", 500)
    monkeypatch.setattr(event_digest, "PART_BYTES", 1000)
    made, parts, count = EventDigest(), [], 400
    made.add_channel(CHANNELS[1])
    for number in range(count):
        made.add_chunk(sealed([logged(EVENTS, event(number))]), 100 + number)
        if part := made.take_part():
            parts.append(part)
    assert len(parts) > 3
    with pytest.raises(DigestUnreadableError):
        # So is one of a log that was cut off before its end.
        Digest(parts, count)
    digest = Digest([*parts, made.take_end()], count)
    assert kept(digest, EVENTS) == list(range(count))


@given(
    st.lists(st.lists(st.integers(0, 100), min_size=1, max_size=4), min_size=1, max_size=12),
    st.integers(0, 101),
    st.integers(0, 101),
    st.sampled_from([STEP, STEP // 3]),
)
@example([[90], [10]], 50, 100, STEP // 3)
@example([[90], [10]], 0, 50, STEP // 3)
@settings(max_examples=10 * settings().max_examples)
def test_a_time_is_where_the_digest_says_whatever_the_order_of_the_chunks(
    chunks: list[list[int]], from_ns: int, to_ns: int, step: int
) -> None:
    """Also where a clock was set, and where a place stands for several chunks."""
    made = [[(OTHERS, 0, time_ns, time_ns, b"") for time_ns in chunk] for chunk in chunks]
    digest = digest_of(made, step=step)
    found = digest.stretch(from_ns, to_ns)
    held = [number for number, chunk in enumerate(chunks) if any(from_ns <= one < to_ns for one in chunk)]
    if held:
        assert found is not None
        start, end = found
        offsets = [100 + number * step for number in held]
        assert start <= offsets[0]
        assert end is None or offsets[-1] < end


@given(st.binary(max_size=400), st.integers(0, 400))
@settings(deadline=None)
def test_nothing_that_is_no_digest_is_taken_for_one(noise: bytes, at: int) -> None:
    """It is said, by one exception."""
    made = EventDigest()
    made.add_channel(CHANNELS[1])
    made.add_chunk(sealed([logged(EVENTS, event(0))]), 100)
    whole = made.take_end()
    spoilt = whole[:at] + noise + whole[at + len(noise) :]
    try:
        digest = Digest([spoilt], 1)
    except DigestUnreadableError:
        return
    assert spoilt.startswith(whole) or digest.messages == Digest([whole], 1).messages


def test_a_count_that_no_writer_makes_is_refused() -> None:
    """Whoever reads it would count for minutes."""
    one = DigestedMessage(1, 1, 9, PASSED_MAX + 1, 0, 0, b"")
    made = EventDigest()
    made.add_channel(CHANNELS[1])
    made._add(one)
    with pytest.raises(DigestUnreadableError):
        Digest([made.take_end()], 0)
