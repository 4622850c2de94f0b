"""Row 'stop: ramp to zero speed, brake pedal, neutral, parking brake at standstill, hold, disable'."""

from math import inf

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.command.actuation import Actuation
from gateway.command.stop import StopSequence
from schemas.decisions import StopPhase
from schemas.messages import GearPosition

MS = 1_000_000
DRIVING = Actuation(True, GearPosition.DRIVE, 1.0, 10.0, 0.0, parking=False)  # noqa: FBT003


def phases(
    last: Actuation, stands_from_ms: int, deceleration_mps2: float = 2.0
) -> list[tuple[StopPhase, Actuation]]:
    """Phase and output of every tick until the sequence has ended."""
    sequence = StopSequence(last, deceleration_mps2, 30.0, 0)
    told: list[tuple[StopPhase, Actuation]] = []
    for at_ms in range(0, 20_000, 10):
        actuation = sequence.tick(at_ms * MS, stands=at_ms >= stands_from_ms)
        if actuation is None:
            assert sequence.phase is StopPhase.IDLE
            assert sequence.tick((at_ms + 10) * MS, stands=True) is None
            return told
        told.append((sequence.phase, actuation))
    raise AssertionError("it never ends")


def lasted(told: list[tuple[StopPhase, Actuation]]) -> dict[StopPhase, int]:
    """Ticks of each phase, in their order."""
    counts: dict[StopPhase, int] = {}
    for phase, _ in told:
        counts[phase] = counts.get(phase, 0) + 1
    return counts


def test_the_whole_sequence() -> None:
    """Each phase as long as the table says, and each output as its name says."""
    told = phases(DRIVING, 800)
    assert lasted(told) == {
        StopPhase.RAMP: 49,
        StopPhase.BRAKE: 31,
        StopPhase.NEUTRAL: 10,
        StopPhase.HOLD: 100,
        StopPhase.DISABLE: 50,
    }
    assert list(lasted(told)) == [phase for phase in StopPhase if phase is not StopPhase.IDLE]
    drive, neutral = GearPosition.DRIVE, GearPosition.NEUTRAL
    outputs = {phase: actuation for phase, actuation in told if phase is not StopPhase.RAMP}
    assert outputs == {
        StopPhase.BRAKE: Actuation(True, drive, 0.0, 10.0, 30.0, parking=False),  # noqa: FBT003
        StopPhase.NEUTRAL: Actuation(True, neutral, 0.0, 10.0, 30.0, parking=False),  # noqa: FBT003
        StopPhase.HOLD: Actuation(True, neutral, 0.0, 10.0, 30.0, parking=True),  # noqa: FBT003
        StopPhase.DISABLE: Actuation(False, neutral, 0.0, 10.0, 0.0, parking=True),  # noqa: FBT003
    }


@pytest.mark.parametrize("deceleration_mps2", [1.2, 2.0])
def test_the_ramp_keeps_its_deceleration(deceleration_mps2: float) -> None:
    """Rows 'normal / emergency deceleration': it begins with the first tick, and goes by no more and no less."""
    ramp = [actuation for phase, actuation in phases(DRIVING, 9_000, deceleration_mps2) if phase is StopPhase.RAMP]
    for tick, actuation in enumerate(ramp, 1):
        assert actuation.speed_mps == pytest.approx(1.0 - deceleration_mps2 * tick * 0.01)
        assert (actuation.gear, actuation.pedal_percent, actuation.parking) == (GearPosition.DRIVE, 0.0, False)


def test_what_cannot_ramp_is_zero_at_once() -> None:
    """Where the scale is in doubt."""
    assert lasted(phases(DRIVING, 0, inf))[StopPhase.BRAKE] == 1


def test_a_graver_cause_hastens_and_a_lesser_one_does_not_slow_it() -> None:
    """Row 'emergency deceleration'."""
    sequence = StopSequence(DRIVING, 1.2, 30.0, 0)
    sequence.hasten(2.0)
    sequence.hasten(1.2)
    first, second = (sequence.tick(at_ms * MS, stands=False) for at_ms in (0, 10))
    assert first is not None
    assert second is not None
    assert (first.speed_mps, second.speed_mps) == pytest.approx((0.98, 0.96))


def test_a_pause_makes_one_step_of_a_tenth_of_a_second_at_most() -> None:
    """A late loop is no jump to zero."""
    sequence = StopSequence(DRIVING, 2.0, 30.0, 0)
    actuation = sequence.tick(5_000 * MS, stands=False)
    assert actuation is not None
    assert actuation.speed_mps == pytest.approx(0.8)


def test_a_ramp_may_be_cut_lower_and_never_higher() -> None:
    """From the lower speed it goes on in the same steps."""
    sequence = StopSequence(DRIVING, 2.0, 30.0, 0)
    sequence.not_above(5.0)
    first = sequence.tick(0, stands=False)
    assert first is not None
    assert first.speed_mps == pytest.approx(DRIVING.speed_mps - 0.02)
    sequence.not_above(0.5)
    second = sequence.tick(10_000_000, stands=False)
    assert second is not None
    assert second.speed_mps == pytest.approx(0.48)
    assert sequence.phase is StopPhase.RAMP


def test_a_robot_that_is_not_seen_to_stand_is_braked_for_three_seconds() -> None:
    """Then the rest comes all the same."""
    assert lasted(phases(DRIVING, 99_999))[StopPhase.BRAKE] == 300


def test_zero_speed_is_told_before_neutral() -> None:
    """Also when it is told a speed and already stands, and the loop was late: one phase a tick."""
    sequence = StopSequence(DRIVING, 2.0, 30.0, 0)
    told = [sequence.tick(at_ms * MS, stands=True) for at_ms in range(0, 20_000, 500)]
    gears = [(actuation.speed_mps, actuation.gear) for actuation in told if actuation is not None]
    first = gears.index((0.0, GearPosition.NEUTRAL))
    assert gears[first - 1] == (0.0, GearPosition.DRIVE)


def test_a_parked_robot_stays_parked() -> None:
    """And braked, from the first tick on."""
    told = phases(Actuation(enabled=True, parking=True), 0)
    assert all(actuation.parking for _, actuation in told)
    assert told[0][1].pedal_percent == 30.0
    assert StopPhase.RAMP not in lasted(told)


@given(
    speed_mps=st.floats(0, 2.222),
    gear=st.sampled_from([GearPosition.DRIVE, GearPosition.REVERSE]),
    stands=st.lists(st.booleans(), min_size=1, max_size=30),
    steps_ms=st.lists(st.integers(1, 400), min_size=1, max_size=30),
)
def test_it_always_ends_and_never_speeds_up(
    speed_mps: float, gear: GearPosition, stands: list[bool], steps_ms: list[int]
) -> None:
    """However the ticks come, and whatever is seen."""
    last = Actuation(True, gear, speed_mps, 0.0, 0.0, parking=False)  # noqa: FBT003
    sequence = StopSequence(last, 1.2, 30.0, 0)
    now_ms, before = 0, last
    for tick in range(2_000):
        now_ms += steps_ms[tick % len(steps_ms)]
        told = sequence.tick(now_ms * MS, stands=stands[tick % len(stands)])
        if told is None:
            return
        assert told.speed_mps <= before.speed_mps
        assert told.gear in {before.gear, GearPosition.NEUTRAL}
        assert told.gear is before.gear or before.speed_mps == 0
        assert told.parking or not before.parking
        before = told
    assert now_ms < 12_000
