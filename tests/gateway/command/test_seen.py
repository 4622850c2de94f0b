"""Where a stop begins that nobody of us led up to."""

import pytest

from gateway.command.limits import Limits
from gateway.command.observed import Observed
from gateway.command.seen import seen_actuation, seen_angle_deg
from schemas.messages import GearPosition
from schemas.settings import CommandSettings

LIMITS = Limits.of(CommandSettings(speed_limit_mps=1.5, steering_limit_deg=10.0))


@pytest.mark.parametrize(
    ("drive_mps", "wheels_mps", "seen_mps"),
    [(1.0, 0.9, 0.9), (0.9, 1.0, 0.9), (2.0, 0.0, 0.0), (None, 0.7, 0.7), (0.7, None, 0.7), (None, None, 0.0)],
)
def test_the_lower_speed_counts(drive_mps: float | None, wheels_mps: float | None, seen_mps: float) -> None:
    """No single faulty sensor sets a robot going."""
    observed = Observed(speed_mps=drive_mps, fastest_wheel_mps=wheels_mps, gear=GearPosition.DRIVE)
    assert observed.seen_mps == seen_mps
    assert seen_actuation(observed, LIMITS, parking=False).speed_mps == seen_mps


@pytest.mark.parametrize(("seen_deg", "told_deg"), [(None, 0.0), (-30.0, -10.0), (30.0, 10.0), (4.0, 4.0)])
def test_the_angle_is_within_the_limit(seen_deg: float | None, told_deg: float) -> None:
    """Straight on where it is not seen."""
    assert seen_angle_deg(Observed(angle_deg=seen_deg), LIMITS) == told_deg


@pytest.mark.parametrize(
    ("gear", "told", "parks"),
    [
        (GearPosition.DRIVE, GearPosition.DRIVE, False),
        (GearPosition.REVERSE, GearPosition.REVERSE, False),
        (GearPosition.NEUTRAL, GearPosition.NEUTRAL, False),
        (GearPosition.PARK, GearPosition.NEUTRAL, True),
        (GearPosition.UNDEFINED, GearPosition.NEUTRAL, True),
    ],
)
def test_only_in_gear_is_there_a_speed(gear: GearPosition, told: GearPosition, parks: bool) -> None:  # noqa: FBT001
    """The brake is asked for where the robot may be parked, unless it is known what was asked."""
    observed = Observed(speed_mps=2.0, fastest_wheel_mps=2.0, gear=gear)
    first = seen_actuation(observed, LIMITS, parking=None)
    assert (first.enabled, first.gear, first.parking) == (True, told, parks)
    assert first.speed_mps == (1.5 if told is gear and gear is not GearPosition.NEUTRAL else 0.0)
    for parking in (True, False):
        assert seen_actuation(observed, LIMITS, parking=parking).parking is parking
