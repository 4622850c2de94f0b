"""What is seen of a chassis, and where a stop begins that nobody of us led up to."""

from math import radians, tan

import msgspec
import pytest

from gateway.chassis.port import Actuation, ChassisState
from gateway.choice import CHASSIS
from gateway.command.motion import MotionLimits
from gateway.command.output import inferred_actuation, inferred_angle_deg
from schemas.messages import GearPosition
from schemas.settings import CommandSettings

L_M = CHASSIS.wheelbase_m
"""The wheelbase."""

LIMITS = MotionLimits.of(CommandSettings(speed_limit_mps=1.5, steering_limit_deg=10.0))
DRIVE, REVERSE, NEUTRAL, PARK, UNDEFINED = (
    GearPosition.DRIVE,
    GearPosition.REVERSE,
    GearPosition.NEUTRAL,
    GearPosition.PARK,
    GearPosition.UNDEFINED,
)


@pytest.mark.parametrize(
    ("drive_mps", "wheels_mps", "slowest_mps", "fastest_mps"),
    [
        (1.0, 0.9, 0.9, 1.0),
        (0.9, 1.0, 0.9, 1.0),
        (2.0, 0.0, 0.0, 2.0),
        (None, 0.7, 0.7, 0.7),
        (0.7, None, 0.7, 0.7),
        (None, None, 0.0, None),
    ],
)
def test_the_lower_speed_is_told_and_the_higher_one_is_feared(
    drive_mps: float | None, wheels_mps: float | None, slowest_mps: float, fastest_mps: float | None
) -> None:
    """No single faulty sensor sets a robot going, and none hides a motion."""
    chassis = ChassisState(speed_mps=drive_mps, fastest_wheel_mps=wheels_mps, gear=DRIVE)
    assert (chassis.slowest_mps, chassis.fastest_mps) == (slowest_mps, fastest_mps)
    assert inferred_actuation(chassis, LIMITS, L_M).speed_mps == slowest_mps


SLOW = ChassisState(speed_mps=0.0499, fastest_wheel_mps=0.0499, turns=False, confirmed=True)


@pytest.mark.parametrize(
    ("changes", "is_slow", "moves"),
    [
        ({}, True, False),
        ({"speed_mps": 0.051}, False, True),
        ({"fastest_wheel_mps": 0.051}, False, True),
        ({"pulses": 1}, False, True),
        ({"pulses": -1}, False, True),
        ({"speed_mps": None}, False, False),
        ({"fastest_wheel_mps": None}, False, False),
        ({"speed_mps": None, "turns": True}, False, True),
        ({"turns": True}, True, False),
        ({"turns": True, "confirmed": False}, True, True),
    ],
)
def test_what_stands_and_what_moves(changes: dict[str, object], *, is_slow: bool, moves: bool) -> None:
    """Rows 'found at start: moving by drive, wheels or pulses' and 'standstill: under 0.05 m/s'.

    The raw drive feedback counts where its scale is in doubt: else a fine scale's millimetres a second are rest.
    """
    chassis = msgspec.structs.replace(SLOW, **changes)
    assert (chassis.is_slow, chassis.moves) == (is_slow, moves)


@pytest.mark.parametrize("seen_deg", [-30.0, -17.0, 17.0])
def test_no_speed_is_told_that_the_angle_does_not_allow(seen_deg: float) -> None:
    """Row 'lateral acceleration', of a robot that is given back in a bend: v^2 tan(angle) / 0.660 m."""
    chassis = ChassisState(speed_mps=3.0, fastest_wheel_mps=3.0, gear=DRIVE, angle_deg=seen_deg)
    limits = MotionLimits.of(CommandSettings(speed_limit_mps=2.222))
    told = inferred_actuation(chassis, limits, L_M)
    assert told.speed_mps**2 * tan(radians(abs(seen_deg))) / 0.660 == pytest.approx(1.5)


@pytest.mark.parametrize(("seen_deg", "told_deg"), [(None, 0.0), (-30.0, -10.0), (30.0, 10.0), (4.0, 4.0)])
def test_the_angle_is_within_the_limit(seen_deg: float | None, told_deg: float) -> None:
    """Straight on where it is not seen."""
    assert inferred_angle_deg(ChassisState(angle_deg=seen_deg), LIMITS) == told_deg


@pytest.mark.parametrize(
    ("gear", "told", "speed_mps", "parking"),
    [
        (DRIVE, DRIVE, 1.5, False),
        (REVERSE, REVERSE, 1.5, False),
        (NEUTRAL, NEUTRAL, 0.0, False),
        (PARK, NEUTRAL, 0.0, True),
        (UNDEFINED, NEUTRAL, 0.0, True),
    ],
)
def test_only_in_gear_is_there_a_speed(
    gear: GearPosition, told: GearPosition, speed_mps: float, *, parking: bool
) -> None:
    """Within the limit; the brake is asked for where the robot may be parked."""
    chassis = ChassisState(speed_mps=2.0, fastest_wheel_mps=2.0, gear=gear)
    assert inferred_actuation(chassis, LIMITS, L_M) == Actuation(True, told, speed_mps, parking=parking)  # noqa: FBT003


@pytest.mark.parametrize(
    ("left", "slowest_mps", "gear", "told_mps"),
    [
        (Actuation(True, DRIVE, 1.0, parking=False), 0.4, DRIVE, 0.4),  # noqa: FBT003
        (Actuation(True, DRIVE, 0.4, parking=False), 1.0, DRIVE, 0.4),  # noqa: FBT003
        (Actuation(True, DRIVE, 0.0, parking=False), 1.9, DRIVE, 0.0),  # noqa: FBT003
        (Actuation(True, DRIVE, 1.0, parking=False), 1.0, REVERSE, 0.0),  # noqa: FBT003
        (Actuation(True, DRIVE, 1.0, parking=False), 1.0, UNDEFINED, 0.0),  # noqa: FBT003
        (Actuation(True, DRIVE, 0.0, parking=True), 1.0, DRIVE, 0.0),  # noqa: FBT003
        (Actuation(True, NEUTRAL, 0.0, parking=True), 1.0, DRIVE, 0.0),  # noqa: FBT003
    ],
)
def test_what_was_left_bounds_what_is_told(
    left: Actuation, slowest_mps: float, gear: GearPosition, told_mps: float
) -> None:
    """Row 'given back: never a speed above the lower of what it was left on and what is seen'; parked it stays."""
    chassis = ChassisState(speed_mps=slowest_mps, fastest_wheel_mps=slowest_mps, gear=gear)
    told = inferred_actuation(chassis, LIMITS, L_M, left)
    assert (told.speed_mps, told.parking) == (told_mps, left.parking)
