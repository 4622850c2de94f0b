"""How the chassis moves."""

import math
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.sim.motion import Demand, Motion
from gateway.sim.parameters import (
    ACCELERATION_MPS2,
    BRAKING_DECELERATION_MPS2,
    DECELERATION_MPS2,
    PARKING_DECELERATION_MPS2,
    STEERING_RATE_DEGPS,
    TOP_SPEED_MPS,
)
from schemas.messages import GearPosition

DT_S = 0.01
GEARS = st.sampled_from([GearPosition.DRIVE, GearPosition.REVERSE, GearPosition.NEUTRAL])
DEMANDS = st.builds(
    Demand,
    gear=GEARS,
    speed_mps=st.floats(0, 100),
    angle_deg=st.none() | st.floats(-90, 90),
    pedal_percent=st.sampled_from([0.0, 0.0, 0.0, 30.0, 100.0]),
    parked=st.sampled_from([False, False, False, True]),
)


def demand(gear: GearPosition = GearPosition.DRIVE, speed_mps: float = 0.0, angle_deg: float = 0.0) -> Demand:
    """A demand without brakes."""
    return Demand(gear, speed_mps, angle_deg, 0.0, parked=False)


def moving(what: Demand, seconds: float, motion: Motion | None = None) -> Motion:
    """The motion after this long under one demand."""
    motion = motion or Motion()
    for _ in range(round(seconds / DT_S)):
        motion.step(what, DT_S)
    return motion


@given(st.lists(st.tuples(DEMANDS, st.integers(1, 40)), max_size=30))
def test_no_demand_makes_it_jump(script: list[tuple[Demand, int]]) -> None:
    """Whatever is asked for, speed, steering and their changes stay within what the machine can do."""
    motion = Motion()
    most_mps2 = max(
        ACCELERATION_MPS2, DECELERATION_MPS2, BRAKING_DECELERATION_MPS2 + 0.3, PARKING_DECELERATION_MPS2
    )
    for what, steps in script:
        for _ in range(steps):
            speed_mps, angle_deg, gear = motion.speed_mps, motion.angle_deg, motion.gear
            motion.step(what, DT_S)
            assert abs(motion.speed_mps) <= TOP_SPEED_MPS
            assert abs(motion.angle_deg) <= 24
            assert abs(motion.speed_mps - speed_mps) <= most_mps2 * DT_S + 1e-9
            assert abs(motion.angle_deg - angle_deg) <= STEERING_RATE_DEGPS * DT_S + 1e-9
            assert -math.pi <= motion.yaw_rad <= math.pi
            if motion.gear is not gear and motion.gear is not GearPosition.NEUTRAL:
                direction = 1 if motion.gear is GearPosition.DRIVE else -1
                assert speed_mps * direction > -0.011, "the gear of the other direction engaged at speed"


def test_it_reaches_what_is_asked_for_with_a_lag() -> None:
    """Speed follows its target late, and gets there without overshoot."""
    motion = Motion()
    speeds = []
    for _ in range(300):
        motion.step(demand(speed_mps=1.0), DT_S)
        speeds.append(motion.speed_mps)
    assert speeds[10] < 0.2
    assert speeds == sorted(speeds)
    assert speeds[-1] == 1.0


def test_a_reversal_goes_through_standstill() -> None:
    """Asked for reverse at speed, it stays in drive until it stands."""
    motion = moving(demand(speed_mps=1.5), 3)
    gears = []
    for _ in range(300):
        motion.step(demand(GearPosition.REVERSE, 1.0), DT_S)
        gears.append((motion.gear, motion.speed_mps > 0.02))
    assert (GearPosition.REVERSE, True) not in gears
    assert gears[0] == (GearPosition.DRIVE, True)
    assert motion.gear is GearPosition.REVERSE
    assert motion.speed_mps == pytest.approx(-1.0)


def test_in_neutral_it_rolls() -> None:
    """Neutral takes the drive away, and no more."""
    motion = moving(demand(speed_mps=1.5), 3)
    moving(demand(GearPosition.NEUTRAL, 1.5), 1, motion)
    assert motion.speed_mps == pytest.approx(1.2)


def test_the_pedal_wins_over_the_drive() -> None:
    """Braking with the speed still asked for stops it."""
    motion = moving(demand(speed_mps=2.0), 3)
    moving(Demand(GearPosition.DRIVE, 2.0, 0.0, 100.0, parked=False), 0.7, motion)
    assert motion.speed_mps == 0


def test_the_parking_brake_stops_it() -> None:
    """Applied at speed, it locks the wheels."""
    motion = moving(demand(speed_mps=2.0), 3)
    moving(Demand(GearPosition.DRIVE, 2.0, 0.0, 0.0, parked=True), 0.55, motion)
    assert motion.speed_mps == 0


def test_it_drives_a_circle() -> None:
    """At a steering angle it comes back to where it was: radius wheelbase by tangent, left is positive."""
    motion = moving(demand(angle_deg=20.0), 1)
    radius_m = 0.660 / math.tan(math.radians(20))
    highest_m = 0.0
    yaw_rad = 0.0
    while yaw_rad >= 0 or motion.yaw_rad < 0:
        yaw_rad = motion.yaw_rad
        motion.step(demand(speed_mps=1.0, angle_deg=20.0), 0.001)
        highest_m = max(highest_m, motion.y_m)
    assert highest_m == pytest.approx(2 * radius_m, rel=1e-3)
    assert math.hypot(motion.x_m, motion.y_m) < 0.01


def test_the_outer_wheel_is_faster() -> None:
    """To the left the right wheel runs further, by track and yaw rate."""
    motion = moving(demand(speed_mps=1.0, angle_deg=20.0), 3)
    left_mps, right_mps = motion.wheel_speeds_mps
    assert (left_mps + right_mps) / 2 == pytest.approx(1.0)
    assert right_mps - left_mps == pytest.approx(0.606 * math.tan(math.radians(20)) / 0.660)


def test_pulses_wrap_as_signed_16_bit() -> None:
    """Forward counts up and passes from 32767 to -32768; reverse counts back to where it began."""
    motion = Motion()
    forward = []
    for _ in range(3000):
        motion.step(demand(speed_mps=2.0), DT_S)
        forward.append(motion.wheel_pulses[0])
    steps = [after - before for before, after in pairwise(forward)]
    assert any(step < -65000 for step in steps)
    assert all(step >= 0 or step < -65000 for step in steps)
    while motion.x_m > 0:
        motion.step(demand(GearPosition.REVERSE, 2.0), DT_S)
    assert abs(motion.wheel_pulses[0]) < 40


def test_mileage_counts_both_ways() -> None:
    """Going back does not take distance off the odometer."""
    motion = moving(demand(speed_mps=1.0), 5)
    there_m = motion.mileage_m
    moving(demand(GearPosition.REVERSE, 1.0), 5, motion)
    assert motion.mileage_m > there_m + 2
