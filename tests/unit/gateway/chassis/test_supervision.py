"""Checksum, alive counter, period and silence; and error frames as linux/can/error.h lays them out."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.chassis.cruiser.frames import load
from gateway.chassis.frame import ERROR, FaultKind, Frame
from gateway.chassis.supervision import AliveCounter, FrameSupervisor, Period, controller_state, silence_ns
from recorder.review.checking import AliveCount
from schemas.messages import ControllerState, Variant
from tests.support.messages import feedback

MS = 1_000_000
GEAR = load(Variant.COARSE).messages["Auto_GearFeedBack"]


@pytest.mark.parametrize("step", range(16))
def test_a_step_is_judged_as_in_e2e_profile_1(step: int) -> None:
    """0 repeats, 1 is right, 2 to 3 lost frames, 4 to 15 are a wrong sequence: for every last counter."""
    expected = {0: FaultKind.ALIVE_REPEATED, 1: None, 2: FaultKind.ALIVE_LOST, 3: FaultKind.ALIVE_LOST}
    for last in range(16):
        alive = AliveCounter()
        alive.receive(last)
        assert alive.receive((last + step) % 16) is expected.get(step, FaultKind.ALIVE_SEQUENCE)
        assert alive.lost == max(0, step - 1)


def test_faults_are_counted_to_their_limit_and_paid_back_one_by_one() -> None:
    """+1 for each fault, -1 for each good frame, failed at 5 and not below; repeats are stuck from the third."""
    alive = AliveCounter()
    counters = [7, *[7] * 6, 8, *range(9, 14)]
    verdicts = [(alive.receive(counter % 16), alive.faults, alive.has_failed) for counter in counters]
    assert [faults for _, faults, _ in verdicts] == [0, 1, 2, 3, 4, 5, 5, 4, 3, 2, 1, 0, 0]
    assert [has_failed for _, _, has_failed in verdicts] == [*[False] * 5, True, True, *[False] * 6]
    assert [verdict for verdict, _, _ in verdicts[1:7]] == [FaultKind.ALIVE_REPEATED] * 2 + [
        FaultKind.ALIVE_STUCK
    ] * 4


@pytest.mark.parametrize(("kind", "faults"), [("checksum", 5), ("implausible", 3)])
def test_corrupt_frames_and_impossible_ones_are_failures_of_their_own(kind: str, faults: int) -> None:
    """After this many within a second."""
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
    """A 10 ms frame is silent before sixteen of them could be lost unseen."""
    assert silence_ns(period_ms * MS) == silence_ms * MS
    supervisor = FrameSupervisor(period_ms * MS)
    supervisor.receive(0, 0)
    assert supervisor.tick(silence_ms * MS) is None
    assert supervisor.tick(silence_ms * MS + 1) is FaultKind.SILENCE
    assert supervisor.tick(silence_ms * MS + 2) is None
    assert supervisor.is_silent


def test_a_frame_is_silent_until_the_first_one_comes() -> None:
    """But this is no fault: nothing was lost."""
    supervisor = FrameSupervisor(10 * MS)
    assert supervisor.is_silent
    assert supervisor.tick(10_000 * MS) is None
    assert supervisor.receive(5, 10_000 * MS) == ()
    assert not supervisor.is_silent
    assert supervisor.lost == 0


def test_frames_lost_in_a_silence_are_counted_by_counter_and_period() -> None:
    """After a second without a 10 ms frame the counter shows 5 at once; its six rounds follow by the period."""
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
            frame = np.frombuffer(feedback(number), np.uint8).reshape(1, -1)
            log.receive(np.array([at * 10 * MS], np.int64), frame)
        assert supervisor.lost >= counted
        counted = supervisor.lost
    assert supervisor.lost == log.lost + log.unseen
    if not lost:
        assert supervisor.lost == 0


@pytest.mark.parametrize(
    ("factor", "burst", "fault"),
    [
        *((factor, 1, None) for factor in (1.0, 1.5, 0.7)),
        *((factor, 1, FaultKind.PERIOD) for factor in (1.6, 0.6)),
        (1.0, 10, None),
    ],
)
def test_the_mean_period_is_judged(factor: float, burst: int, fault: FaultKind | None) -> None:
    """Half as long again, or two thirds, is accepted, also in bursts as from a busy machine."""
    period = Period(10 * MS)
    step_ns = round(10 * MS * factor)
    verdicts = [period.receive(frame // burst * burst * step_ns) for frame in range(21)]
    assert verdicts == [*[None] * 20, fault]
    assert period.has_failed == (fault is not None)


def test_a_frame_that_repeats_its_counter_becomes_overdue() -> None:
    """A stuck sender repeats an old value; that is silence at any frame rate."""
    supervisor = FrameSupervisor(10 * MS)
    supervisor.receive(3, 0)
    for at_ms in range(10, 101, 10):
        supervisor.receive(3, at_ms * MS)
    assert supervisor.tick(100 * MS + 1) is FaultKind.SILENCE
    supervisor.receive(3, 110 * MS)
    assert supervisor.is_silent
    supervisor.receive(4, 120 * MS)
    assert not supervisor.is_silent


@pytest.mark.parametrize(
    ("kinds", "detail", "state"),
    [
        (0x040, 0x00, ControllerState.BUS_OFF),
        (0x044, 0x20, ControllerState.BUS_OFF),
        (0x100, 0x00, ControllerState.ACTIVE),
        (0x004, 0x40, ControllerState.ACTIVE),
        (0x004, 0x04, ControllerState.WARNING),
        (0x004, 0x08, ControllerState.WARNING),
        (0x004, 0x10, ControllerState.PASSIVE),
        (0x004, 0x24, ControllerState.PASSIVE),
        (0x004, 0x01, None),
        (0x004, 0x00, None),
        (0x008, 0x30, None),
        (0x020, 0x00, None),
        (0x000, 0xFF, None),
        # Cut short, it tells nothing of what is not there.
        (0x004, None, None),
        (0x040, None, ControllerState.BUS_OFF),
    ],
)
def test_an_error_frame_tells_the_controllers_state_or_nothing(
    kinds: int, detail: int | None, state: ControllerState | None
) -> None:
    """The detail counts only where the frame says that it is about the controller."""
    data = b"\0" if detail is None else bytes([0, detail, 0, 0, 0, 0, 0, 0])
    assert controller_state(Frame(ERROR | kinds, data)) is state
