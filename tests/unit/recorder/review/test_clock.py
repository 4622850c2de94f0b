"""The robot's clock on the recorder's line of time."""

from hypothesis import given
from hypothesis import strategies as st

from recorder.review.entries import FAR_NS, NEAR_NS, RobotClock
from schemas.decisions import RUN_TICKS
from schemas.settings import TICK_NS
from tests.support.messages import MS, SECOND, WALL_NS

TICK = 10**9
HOUR_NS = 3600 * SECOND


def run(clock: RobotClock, ticks: range, ahead_ns: int = 0, delay_ns: int = MS) -> list[str]:
    """States of a robot whose clock is ahead by so much, received so much later."""
    said = []
    for tick in ticks:
        now_ns = WALL_NS + tick * TICK_NS
        said.append(clock.hear(TICK + tick, now_ns + ahead_ns, now_ns + delay_ns))
    return [text for text in said if text]


def test_a_clock_that_agrees_is_believed() -> None:
    """To the nanosecond."""
    clock = RobotClock()
    assert run(clock, range(0, 100, 5)) == []
    assert clock.place(WALL_NS + 5, WALL_NS + 7) == WALL_NS + 5


@given(ahead_ns=st.integers(-(10**15), 10**15))
def test_a_clock_that_is_far_off_is_told_once_and_set_right(ahead_ns: int) -> None:
    """Whichever way; one that is near is left alone."""
    clock = RobotClock()
    told = run(clock, range(0, 400, 5), ahead_ns)
    is_off = abs(ahead_ns - MS) > NEAR_NS
    assert len(told) == is_off
    placed_ns = clock.place(WALL_NS + 4 * SECOND + ahead_ns, WALL_NS + 4 * SECOND + MS, TICK + 400)
    assert abs(placed_ns - WALL_NS - 4 * SECOND) <= (MS if is_off else NEAR_NS + MS)


def test_the_first_states_may_have_waited() -> None:
    """What stood in a queue for seconds is no clock that is behind."""
    clock = RobotClock()
    assert run(clock, range(0, 10, 5), delay_ns=3 * SECOND) == []
    assert run(clock, range(10, 100, 5)) == []
    assert clock.offset_ns == 0


@given(waited_ticks=st.integers(30, 600))
def test_a_burst_at_the_start_is_no_clock_that_is_behind(waited_ticks: int) -> None:
    """What was said before the recorder was there comes all at once, however much it is."""
    clock = RobotClock()
    there_ns = WALL_NS + waited_ticks * TICK_NS
    for tick in range(0, waited_ticks, 5):
        said_ns = WALL_NS + tick * TICK_NS
        assert clock.hear(TICK + tick, said_ns, there_ns + tick) == ""
        assert clock.place(said_ns, there_ns + tick, TICK + tick) == said_ns
    assert run(clock, range(waited_ticks, waited_ticks + 1000, 5)) == []
    assert clock.offset_ns == 0


def test_a_state_that_is_received_sooner_proves_the_offset_wrong() -> None:
    """However long all was late before; and it tells how wrong the times before it were."""
    clock = RobotClock()
    assert len(run(clock, range(0, 400, 5), delay_ns=2 * SECOND)) == 1
    assert clock.offset_ns == 2 * SECOND
    (told,) = run(clock, range(400, 405, 5))
    assert "agrees with the recorder's" in told
    assert clock.offset_ns == 0
    assert clock.corrected_ns == -2 * SECOND


def test_a_clock_that_is_ahead_is_believed_to_be_so_by_one_state() -> None:
    """Nothing is received before it is said; what came later than the others is not the measure."""
    clock = RobotClock()
    (told,) = run(clock, range(0, 5, 5), 5 * SECOND, delay_ns=3 * SECOND)
    assert "2.0 s ahead of" in told
    (told,) = run(clock, range(5, 400, 5), 5 * SECOND)
    assert "5.0 s ahead of" in told
    assert clock.offset_ns == MS - 5 * SECOND


@given(said=st.lists(st.tuples(st.integers(1, 800), st.integers(-(10**11), 10**11), st.integers(0, 10**10))))
def test_nothing_is_placed_behind_its_receipt(said: list[tuple[int, int, int]]) -> None:
    """Whatever the clocks and the link do."""
    clock = RobotClock()
    tick, log_ns = TICK, WALL_NS
    for ticks, off_ns, later_ns in said:
        tick, log_ns = tick + ticks, log_ns + later_ns
        clock.hear(tick, log_ns - off_ns, log_ns)
        assert clock.place(log_ns - off_ns, log_ns, tick) <= log_ns
        assert clock.place(log_ns - off_ns, log_ns) <= log_ns


def test_after_a_long_pause_the_clock_is_looked_at_anew() -> None:
    """It was set meanwhile, by an hour; the ticks are too far apart to tell."""
    clock = RobotClock()
    run(clock, range(0, 400, 5))
    assert len(run(clock, range(2000, 2005, 5), -HOUR_NS)) == 1
    assert clock.corrected_ns == 0
    assert clock.offset_ns == HOUR_NS + MS


def test_one_that_is_off_by_more_than_any_delay_is_at_once() -> None:
    """So that not even the first entries are an hour off."""
    clock = RobotClock()
    assert len(run(clock, range(1), -FAR_NS - SECOND)) == 1


@given(set_ns=st.integers(-(10**14), 10**14).filter(lambda ns: abs(ns) > NEAR_NS + MS))
def test_a_clock_that_is_set_is_seen_by_the_ticks(set_ns: int) -> None:
    """The very first message after it is in its place, before any state tells."""
    clock = RobotClock()
    run(clock, range(0, 100, 5))
    now_ns = WALL_NS + 100 * TICK_NS
    assert abs(clock.place(now_ns + set_ns, now_ns + MS, TICK + 100) - now_ns) <= MS
    assert run(clock, range(100, 105, 5), set_ns) == [f"the robot's clock was set by {set_ns / 1e9:+.1f} s"]
    assert abs(clock.place(now_ns + set_ns, now_ns + MS) - now_ns) <= MS


def test_a_pause_of_the_gateway_is_no_clock_that_was_set() -> None:
    """Its ticks stand still, but the receipt is as late as its clock says."""
    clock = RobotClock()
    run(clock, range(0, 100, 5))
    late_ns = WALL_NS + 100 * TICK_NS + 4 * SECOND
    assert clock.hear(TICK + 100, late_ns, late_ns + MS) == ""
    assert clock.place(late_ns, late_ns + MS, TICK + 100) == late_ns


def test_another_run_begins_anew() -> None:
    """Its clock may be another one, and its ticks say nothing of those before."""
    clock = RobotClock()
    run(clock, range(0, 100, 5))
    assert clock.is_other_run(TICK + RUN_TICKS + 100)
    assert "behind" in clock.hear(TICK + 2 * RUN_TICKS, WALL_NS - HOUR_NS, WALL_NS)


def test_what_is_asked_for_later_keeps_its_time() -> None:
    """It is received late, and that says nothing."""
    clock = RobotClock()
    run(clock, range(10_000, 10_100, 5))
    assert clock.place(WALL_NS, WALL_NS + HOUR_NS, TICK) == WALL_NS
