"""The scheduler of a replay: when what is due. No clock but a number."""

from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from recorder.replay import (
    AS_FAST_AS_POSSIBLE,
    FOR_EVER,
    SET_BACK_AFTER,
    SLIP_NS,
    Due,
    Lateness,
    Pace,
    ReplaySample,
    ReplayScheduler,
)
from tests.support.messages import MS, SECOND, WALL_NS

FOR_NO_PAUSE = 10**18
BEGUN_NS = 5_000


def pace(speed: float = 1, longest_pause_ns: int = FOR_NO_PAUSE) -> Pace:
    """A pace that was started."""
    one = Pace(speed, longest_pause_ns)
    one.start(BEGUN_NS)
    return one


def dues(one: Pace, *offsets_ns: int) -> list[int]:
    """The due times, from the start on, of what is so far into the log."""
    return [one.due_ns(WALL_NS + offset_ns) - BEGUN_NS for offset_ns in offsets_ns]


HOUR = 3600 * SECOND


@pytest.mark.parametrize(
    ("one", "offsets_ns", "due_ns", "cut"),
    [
        # What is 600 ns behind the first one is due after that time, divided by the speed.
        *(
            (pace(speed), [0, 600], [0, wanted], 0)
            for speed, wanted in {1: 600, 2: 300, 0.5: 1200, 10: 60, AS_FAST_AS_POSSIBLE: 0}.items()
        ),
        # A message that was asked for later stands late in the log, and holds nothing up.
        (pace(), [0, 9 * SECOND, 2 * SECOND, 9 * SECOND + 1], [0, 9 * SECOND, 9 * SECOND, 9 * SECOND + 1], 0),
        # A log of two days is not watched overnight; the pauses are counted.
        (
            pace(1, 10 * SECOND),
            [0, 10 * SECOND, HOUR, HOUR + SECOND],
            [0, 10 * SECOND, 20 * SECOND, 21 * SECOND],
            1,
        ),
        # At twice the speed a cut pause takes half as long.
        (pace(2, 10 * SECOND), [0, HOUR], [0, 5 * SECOND], 1),
    ],
)
def test_when_what_is_so_far_into_a_log_is_due(
    one: Pace, offsets_ns: list[int], due_ns: list[int], cut: int
) -> None:
    """By its time in the log, the speed, and how long a pause may be."""
    assert dues(one, *offsets_ns) == due_ns
    assert one.cut == cut


@given(st.lists(st.integers(0, 20_000_000), min_size=1, max_size=300), st.sampled_from([1.0, 3.0, 0.7, 10.0]))
def test_nothing_adds_up(steps_ns: list[int], speed: float) -> None:
    """After any number of steps the due time is that of the whole way, to the nanosecond, and none steps back."""
    one = pace(speed)
    times = [sum(steps_ns[:number]) for number in range(len(steps_ns) + 1)]
    found = dues(one, *times)
    assert found == [round(time / speed) for time in times]
    assert found == sorted(found)


def test_a_clock_that_was_set_back_is_followed() -> None:
    """Where all that follows is earlier the clock was set back, and the replay goes on from there at its pace."""
    one = pace()
    one.due_ns(WALL_NS + 3600 * SECOND)
    found = [one.due_ns(WALL_NS + number * MS) - BEGUN_NS for number in range(2 * SET_BACK_AFTER)]
    assert found[: SET_BACK_AFTER + 1] == [0] * (SET_BACK_AFTER + 1)
    assert found[-1] == (2 * SET_BACK_AFTER - 1 - SET_BACK_AFTER) * MS


@given(st.lists(st.integers(0, 3_000_000_000), min_size=1, max_size=200), st.floats(0.01, 1))
def test_lateness_is_told_to_a_bucket(late_ns: list[int], part: float) -> None:
    """At least this part was no later than what is told, and what is told is not 0.1 ms too much, up to 2 s."""
    lateness = Lateness()
    for one in late_ns:
        lateness.add(one)
    told = lateness.quantile_ns(part)
    exact = sorted(late_ns)[max(0, -int(-part * len(late_ns) // 1) - 1)]
    assert exact <= told <= max(late_ns)
    assert told - exact <= 100_000 or told > 2 * SECOND
    assert lateness.max_ns == max(late_ns)


def test_no_lateness_is_none() -> None:
    """Of nothing, and of what came early."""
    lateness = Lateness()
    assert lateness.quantile_ns(0.99) == 0
    lateness.add(-5)
    assert lateness.quantile_ns(0.99) == lateness.max_ns == 0


def mark(time_ns: int) -> ReplaySample:
    """Something with a time."""
    return ReplaySample(time_ns, "", "")


class Tape:
    """A log of so many samples, 100 ns apart; counts how often it was read."""

    def __init__(self, count: int) -> None:
        self.times = [WALL_NS + number * 100 for number in range(count)]
        self.reads = 0

    def read(self) -> Iterator[ReplaySample]:
        self.reads += 1
        return map(mark, self.times)


def taken(player: ReplayScheduler, now_ns: int) -> list[int]:
    """All that is due, as offsets into the log."""
    found = []
    while (due := player.take(now_ns)) is not None:
        found.append(due.item.time_ns - WALL_NS)
    return found


def started(tape: Tape, speed: float = 1, loops: int = 1) -> ReplayScheduler:
    """A player that plays since the time 0."""
    player = ReplayScheduler(tape.read, Pace(speed, FOR_NO_PAUSE), loops)
    player.start(0)
    return player


def test_what_is_due_comes_out_and_nothing_else() -> None:
    """In order, each when its time has come, and then it says when the next one is due."""
    player = started(Tape(4))
    assert taken(player, 0) == [0]
    assert player.next_ns == 100
    assert taken(player, 99) == []
    assert taken(player, 250) == [100, 200]
    assert not player.is_ended
    assert taken(player, 300) == [300]
    assert player.is_ended
    assert player.next_ns is None
    assert player.lateness.max_ns == 150


def test_an_empty_log_ends_at_once() -> None:
    """Even one that is to be played for ever."""
    assert started(Tape(0), loops=FOR_EVER).is_ended


def test_a_loop_goes_on_where_the_last_round_was_due() -> None:
    """What was late in one round does not make the next one late too."""
    tape = Tape(3)
    player = started(tape, loops=2)
    assert taken(player, 230) == [0, 100, 200, 0]
    assert player.loop == 2
    assert player.next_ns == 300
    assert taken(player, 1000) == [100, 200]
    assert player.is_ended
    assert tape.reads == 2


def test_for_ever_does_not_end() -> None:
    """Round after round."""
    player = started(Tape(2), loops=FOR_EVER)
    assert taken(player, 1000) == [0, 100] * 10 + [0]
    assert not player.is_ended


def test_who_stood_still_goes_on_from_there() -> None:
    """After a stop of the process nothing comes in a burst; how far it fell behind is told."""
    player = started(Tape(3))
    taken(player, 0)
    now_ns = 100 + SLIP_NS + 1
    assert player.take(now_ns) == Due(mark(WALL_NS + 100), now_ns)
    assert player.next_ns == now_ns + 100
    assert player.slipped_ns == SLIP_NS + 1


def test_as_fast_as_possible_has_no_lateness() -> None:
    """Nothing has a due time that it could miss."""
    player = started(Tape(5), AS_FAST_AS_POSSIBLE)
    assert taken(player, 10 * SECOND) == [0, 100, 200, 300, 400]
    assert player.lateness.max_ns == player.slipped_ns == 0
