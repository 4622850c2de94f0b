"""How the chassis moves."""

import math
from itertools import pairwise

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from gateway.choice import CHASSIS
from gateway.sim.body import (
    ACCELERATION_MPS2,
    BRAKING_DECELERATION_MPS2,
    DECELERATION_MPS2,
    PARKING_DECELERATION_MPS2,
    ROLLING_DECELERATION_MPS2,
    STEERING_RATE_DEGPS,
    TOP_SPEED_MPS,
    Conditions,
    Demand,
    Motion,
)
from schemas.messages import GearPosition

L_M = CHASSIS.wheelbase_m
"""The wheelbase."""


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
    motion = motion or Motion(L_M)
    for _ in range(round(seconds / DT_S)):
        motion.step(what, DT_S)
    return motion


@given(st.lists(st.tuples(DEMANDS, st.integers(1, 40)), max_size=30), st.sampled_from([0.0, 0.3, 1.0]))
def test_no_demand_makes_it_jump(script: list[tuple[Demand, int]], pedal_gain: float) -> None:
    """Whatever is asked for, speed, steering and their changes stay within what the machine can do."""
    motion = Motion(L_M, Conditions(pedal_gain=pedal_gain))
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


def test_pulses_wrap_as_signed_16_bit() -> None:
    """Forward counts up and passes from 32767 to -32768; reverse counts back to where it began."""
    motion = Motion(L_M)
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


GRAVITY_MPS2 = 9.81
ROLLS = demand(GearPosition.NEUTRAL)
PARKS = Demand(GearPosition.NEUTRAL, 0.0, 0.0, 0.0, parked=True)


@given(slope_deg=st.floats(-30, 30), payload_kg=st.floats(0, 100))
def test_in_neutral_it_rolls_downhill(slope_deg: float, payload_kg: float) -> None:
    """Gravity less rolling resistance, whatever the load; where resistance holds the robot, it stands."""
    motion = moving(ROLLS, 2, Motion(L_M, Conditions(slope_deg=slope_deg, payload_kg=payload_kg)))
    pull_mps2 = GRAVITY_MPS2 * math.sin(math.radians(slope_deg))
    rolls_mps2 = max(0.0, abs(pull_mps2) - ROLLING_DECELERATION_MPS2)
    assert motion.speed_mps == pytest.approx(math.copysign(2 * rolls_mps2, -slope_deg), abs=1e-6)
    assert motion.x_m == pytest.approx(math.copysign(rolls_mps2 * 2**2 / 2, -slope_deg), rel=0.01, abs=1e-6)


@pytest.mark.parametrize("gear", [GearPosition.DRIVE, GearPosition.REVERSE])
@pytest.mark.parametrize(("slope_deg", "payload_kg"), [(20, 0), (-20, 0), (18, 100), (-18, 100), (25, 0)])
def test_in_gear_the_motor_holds_zero_speed(gear: GearPosition, slope_deg: float, payload_kg: float) -> None:
    """Uphill and downhill, as far as the motor's force goes."""
    motion = moving(demand(gear), 10, Motion(L_M, Conditions(slope_deg=slope_deg, payload_kg=payload_kg)))
    assert (motion.speed_mps, motion.x_m) == (0, 0)


@pytest.mark.parametrize(("slope_deg", "payload_kg"), [(20, 0), (15, 100)])
def test_it_climbs_what_the_manual_says(slope_deg: float, payload_kg: float) -> None:
    """20 deg empty and 15 deg with full payload (manual V2.0, 2.2); 20 deg with full payload is too much."""
    climbing = Motion(L_M, Conditions(slope_deg=slope_deg, payload_kg=payload_kg))
    assert moving(demand(speed_mps=0.5), 20, climbing).speed_mps == 0.5
    too_heavy = Motion(L_M, Conditions(slope_deg=20.0, payload_kg=100.0))
    assert moving(demand(speed_mps=0.5), 20, too_heavy).speed_mps < 0


@given(
    slope_deg=st.floats(-25, 20),
    payload_kg=st.floats(0, 60),
    gear=st.sampled_from([GearPosition.DRIVE, GearPosition.REVERSE]),
    speeds_mps=st.lists(st.floats(0, 3), max_size=5),
)
def test_a_slope_that_the_motor_masters_does_not_show(
    slope_deg: float, payload_kg: float, gear: GearPosition, speeds_mps: list[float]
) -> None:
    """Within its force the motor follows its target as on the flat."""
    flat, hilly = Motion(L_M), Motion(L_M, Conditions(slope_deg=slope_deg, payload_kg=payload_kg))
    most_mps2 = GRAVITY_MPS2 * math.sin(math.radians(abs(slope_deg))) + 2.0 + ROLLING_DECELERATION_MPS2
    assume(most_mps2 < hilly.conditions.drive_mps2)
    for speed_mps in speeds_mps:
        for motion in (flat, hilly):
            moving(demand(gear, speed_mps), 0.5, motion)
    assert (hilly.speed_mps, hilly.x_m) == (flat.speed_mps, flat.x_m)


@pytest.mark.parametrize("slope_deg", [-20, 0, 20])
@pytest.mark.parametrize("payload_kg", [0, 100])
def test_the_parking_brake_stops_a_rolling_robot(slope_deg: float, payload_kg: float) -> None:
    """Within v^2 / 2a of where it applies, a its grip less or more gravity; then it holds."""
    motion = Motion(L_M, Conditions(slope_deg=slope_deg, payload_kg=payload_kg, parking_delay_s=0.0))
    motion.adopt(speed_mps=2.0, angle_deg=0.0, gear=GearPosition.NEUTRAL, parked=False)
    moving(PARKS, 3, motion)
    grip_mps2 = PARKING_DECELERATION_MPS2 + GRAVITY_MPS2 * math.sin(math.radians(slope_deg))
    assert motion.speed_mps == 0
    assert motion.x_m == pytest.approx(2.0**2 / (2 * grip_mps2), abs=2.0 * DT_S)
    rest_m = motion.x_m
    assert moving(PARKS, 60, motion).x_m == rest_m


@given(delay_steps=st.integers(1, 30), begins_parked=st.booleans())
def test_the_parking_brake_takes_its_time(delay_steps: int, begins_parked: bool) -> None:  # noqa: FBT001
    """To apply and to release; a demand that is taken back meanwhile has had no effect."""
    motion = Motion(L_M, Conditions(parking_delay_s=delay_steps * DT_S))
    motion.parked = begins_parked
    other = PARKS if not begins_parked else ROLLS
    same = ROLLS if not begins_parked else PARKS
    for what, steps in ((other, delay_steps - 1), (same, 1), (other, delay_steps - 1)):
        moving(what, steps * DT_S, motion)
        assert motion.parked is begins_parked
    moving(other, DT_S, motion)
    assert motion.parked is not begins_parked
    moving(same, (delay_steps - 1) * DT_S, motion)
    assert motion.parked is not begins_parked
    moving(same, DT_S, motion)
    assert motion.parked is begins_parked


def test_the_drive_ends_when_the_parking_brake_applies() -> None:
    """Until then the motor goes on; and it has no force before the brake has released."""
    motion = moving(demand(speed_mps=1.0), 3)
    held = Demand(GearPosition.DRIVE, 1.0, 0.0, 0.0, parked=True)
    moving(held, 0.04, motion)
    assert motion.speed_mps == 1.0
    moving(held, 0.2, motion)
    assert (motion.speed_mps, motion.parked) == (0, True)
    moving(demand(speed_mps=1.0), 0.04, motion)
    assert motion.speed_mps == 0
    assert moving(demand(speed_mps=1.0), 0.1, motion).speed_mps > 0
