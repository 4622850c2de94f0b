"""Checksum, alive counter, period and silence."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.chassis.cruiser.frames import load
from gateway.chassis.frame import FaultKind
from gateway.chassis.supervision import AliveCounter, FaultWindow, FrameSupervisor, Period, silence_ns
from recorder.review.checking import AliveCount
from schemas.messages import Variant
from tests.support.messages import feedback

MS = 1_000_000
GEAR = load(Variant.COARSE).messages["Auto_GearFeedBack"]


@given(first=st.integers(0, 15), frames=st.integers(1, 100))
def test_a_running_counter_has_no_fault(first: int, frames: int) -> None:
    """Any start, +1 for each frame, 15 wraps to 0: no fault, nothing lost."""
    alive = AliveCounter()
    assert [alive.receive((first + i) % 16) for i in range(frames)] == [None] * frames
    assert (alive.faults, alive.lost) == (0, 0)


@pytest.mark.parametrize("step", range(16))
def test_a_step_is_judged_as_in_e2e_profile_1(step: int) -> None:
    """0 repeats, 1 is right, 2 to 3 lost frames, 4 to 15 are a wrong sequence: for every last counter."""
    expected = {0: FaultKind.ALIVE_REPEATED, 1: None, 2: FaultKind.ALIVE_LOST, 3: FaultKind.ALIVE_LOST}
    for last in range(16):
        alive = AliveCounter()
        alive.receive(last)
        assert alive.receive((last + step) % 16) is expected.get(step, FaultKind.ALIVE_SEQUENCE)
        assert alive.lost == max(0, step - 1)


def test_a_counter_that_wraps_at_3_is_found() -> None:
    """0 1 2 3 0 is a wrong sequence (a published driver of this family wraps there)."""
    alive = AliveCounter()
    verdicts = [alive.receive(counter) for counter in (0, 1, 2, 3, 0)]
    assert verdicts == [None, None, None, None, FaultKind.ALIVE_SEQUENCE]


def test_a_counter_that_repeats_is_stuck_at_the_third_repeat() -> None:
    """Repeats are told one by one, then as stuck; the count of faults stops at its limit, 5."""
    alive = AliveCounter()
    verdicts = [alive.receive(7) for _ in range(8)]
    assert verdicts == [None, *[FaultKind.ALIVE_REPEATED] * 2, *[FaultKind.ALIVE_STUCK] * 5]
    assert alive.faults == 5
    assert alive.has_failed


def test_faults_are_paid_back_one_by_one() -> None:
    """+1 for each fault, -1 for each good frame, failed at 5 and not below."""
    alive = AliveCounter()
    alive.receive(0)
    for _ in range(4):
        alive.receive(0)
    assert not alive.has_failed
    alive.receive(0)
    assert alive.has_failed
    alive.receive(1)
    assert not alive.has_failed
    for counter in range(2, 10):
        alive.receive(counter)
    assert alive.faults == 0


@given(counters=st.lists(st.integers(0, 15), max_size=60))
def test_the_fault_count_stays_in_its_bounds(counters: list[int]) -> None:
    """Whatever counters come, the count of faults stays from 0 to 5 and lost frames never decrease."""
    alive = AliveCounter()
    lost = 0
    for counter in counters:
        alive.receive(counter)
        assert 0 <= alive.faults <= 5
        assert alive.lost >= lost
        lost = alive.lost


def test_three_faults_within_a_second_are_a_failure() -> None:
    """Two are not, three are while they lie within one second, and time heals."""
    window = FaultWindow(3, 1000 * MS)
    for at_ms in (0, 500):
        window.fault(at_ms * MS)
    assert not window.has_failed(500 * MS)
    window.fault(1000 * MS)
    assert window.has_failed(1000 * MS)
    assert not window.has_failed(1000 * MS + 1)
    window.fault(1400 * MS)
    assert window.has_failed(1500 * MS)


@pytest.mark.parametrize(("kind", "faults"), [("checksum", 5), ("implausible", 3)])
def test_corrupt_frames_and_impossible_ones_are_failures_of_their_own(kind: str, faults: int) -> None:
    """So many within a second, and each is named by its own name."""
    supervisor = FrameSupervisor(10 * MS)
    supervisor.receive(0, 0)
    window = {"checksum": supervisor.checksums, "implausible": supervisor.implausible}[kind]
    for _ in range(faults - 1):
        window.fault(0)
    assert supervisor.failures(0) == []
    window.fault(0)
    assert supervisor.failures(0) == [kind]
    assert supervisor.failures(1000 * MS) == [kind]
    assert supervisor.failures(1000 * MS + 1) == []


@pytest.mark.parametrize(("period_ms", "silence_ms"), [(10, 100), (20, 200), (50, 500), (1, 100)])
def test_silence_is_ten_periods_and_at_least_100_ms(period_ms: int, silence_ms: int) -> None:
    """So a 10 ms frame is silent before sixteen of them could be lost unseen."""
    assert silence_ns(period_ms * MS) == silence_ms * MS
    supervisor = FrameSupervisor(period_ms * MS)
    supervisor.receive(0, 0)
    assert supervisor.tick(silence_ms * MS) is None
    assert supervisor.tick(silence_ms * MS + 1) is FaultKind.SILENCE
    assert supervisor.tick(silence_ms * MS + 2) is None
    assert supervisor.is_silent


def test_a_frame_is_silent_until_the_first_one_comes() -> None:
    """Missing from the start is silence too, but no fault of its own: nothing was there to be lost."""
    supervisor = FrameSupervisor(10 * MS)
    assert supervisor.is_silent
    assert supervisor.tick(10_000 * MS) is None
    assert supervisor.receive(5, 10_000 * MS) == ()
    assert not supervisor.is_silent
    assert supervisor.lost == 0


def test_frames_lost_in_a_silence_are_counted_by_counter_and_period() -> None:
    """Of a second without a 10 ms frame the counter tells 5 at once, the period its six rounds, later."""
    supervisor = FrameSupervisor(10 * MS)
    supervisor.receive(3, 0)
    supervisor.tick(500 * MS)
    assert supervisor.receive(9, 1000 * MS) == ()
    assert supervisor.lost == 5
    for frame in range(1, 100):
        supervisor.receive((9 + frame) % 16, (1000 + frame * 10) * MS)
    assert supervisor.lost == 5 + 6 * 16


@given(
    lost=st.sets(st.integers(1, 400)),
    stalls=st.lists(st.tuples(st.integers(0, 400), st.integers(0, 60)), max_size=4),
    are_ticks_late=st.booleans(),
)
def test_what_the_log_can_show_is_what_is_counted(
    lost: set[int], stalls: list[tuple[int, int]], *, are_ticks_late: bool
) -> None:
    """As ``review check`` counts them: frames that come late and bunched are not lost; the count never falls."""
    supervisor, log = FrameSupervisor(10 * MS), AliveCount(GEAR)
    counted, now = 0, -1
    for number in range(500):
        at = number
        for start, length in sorted(stalls):
            at = max(at, start + length) if start <= at else at
        ticks = range(now + 1, at + 1)
        for tick in ticks[-1:] if are_ticks_late else ticks:
            supervisor.tick(tick * 10 * MS - 1)
        now = at
        if number not in lost:
            supervisor.receive(number % 16, at * 10 * MS)
            log.receive(at * 10 * MS, feedback(number))
        assert supervisor.lost >= counted
        counted = supervisor.lost
    assert supervisor.lost == log.lost + log.unseen
    if not lost:
        assert supervisor.lost == 0


@pytest.mark.parametrize(
    ("factor", "fault"), [(1.0, None), (1.5, None), (0.7, None), (1.6, FaultKind.PERIOD), (0.6, FaultKind.PERIOD)]
)
def test_the_mean_period_is_judged(factor: float, fault: FaultKind | None) -> None:
    """Half as long again, or two thirds, is accepted; beyond that the period is at fault."""
    period = Period(10 * MS)
    step_ns = round(10 * MS * factor)
    verdicts = [period.receive(frame * step_ns) for frame in range(21)]
    assert verdicts == [*[None] * 20, fault]
    assert period.has_failed == (fault is not None)


def test_jitter_is_not_a_wrong_period() -> None:
    """Frames that come in bursts of ten, as from a busy machine, keep their mean period."""
    period = Period(10 * MS)
    verdicts = [period.receive(frame // 10 * 100 * MS) for frame in range(100)]
    assert set(verdicts) == {None}


def test_a_frame_that_repeats_its_counter_becomes_overdue() -> None:
    """A stuck sender shows the same old value for ever; that is silence, whatever the rate of its frames."""
    supervisor = FrameSupervisor(10 * MS)
    supervisor.receive(3, 0)
    for at_ms in range(10, 101, 10):
        supervisor.receive(3, at_ms * MS)
    assert supervisor.tick(100 * MS + 1) is FaultKind.SILENCE
    supervisor.receive(3, 110 * MS)
    assert supervisor.is_silent
    supervisor.receive(4, 120 * MS)
    assert not supervisor.is_silent
