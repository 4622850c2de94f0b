"""The limits in force, and the bicycle model."""

from math import atan, degrees, radians, sqrt, tan
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.choice import CHASSIS
from gateway.command.motion import MotionLimits, steering_angle_deg
from schemas.requests import Drive
from schemas.settings import CommandSettings

L_M = CHASSIS.wheelbase_m
"""The wheelbase."""


LIMITS = MotionLimits.of(CommandSettings(speed_limit_mps=2.222))


def drive(speed_mps: float = 1.0, **asked: Any) -> Drive:  # noqa: ANN401 - any field
    """A command with this bend."""
    return Drive(lease=1, seq=1, challenge=bytes(8), speed_mps=speed_mps, **asked)


def test_the_start_values_are_those_of_the_table() -> None:
    """Rows 'speed limit', 'acceleration / normal / emergency deceleration', 'steering limit / rate', 'lateral'."""
    assert MotionLimits.of(CommandSettings()) == MotionLimits(1.0, 0.8, 1.2, 2.0, 24.0, 60.0, 1.5)


def test_the_emergency_deceleration_is_never_the_lower_one() -> None:
    """Whatever the settings say, a graver stop is no slower."""
    settings = CommandSettings(deceleration_mps2=1.5, emergency_deceleration_mps2=0.5)
    assert MotionLimits.of(settings).emergency_deceleration_mps2 == 1.5


@pytest.mark.parametrize(
    ("asked_mps", "limit_mps"), [(None, 2.222), (3.0, 2.222), (2.222, 2.222), (1.0, 1.0), (0.0, 0.0), (-1.0, 0.0)]
)
def test_limits_scale_down_never_up(asked_mps: float | None, limit_mps: float) -> None:
    """MotionLimits scale down, never up, at run time."""
    assert LIMITS.lowered(asked_mps).speed_mps == limit_mps


def test_the_lateral_limit() -> None:
    """Row 'lateral acceleration v^2 tan(angle)/0.660: 1.5 m/s2': at full lock 1.491 m/s."""
    assert (
        LIMITS.speed_at(24, L_M) == LIMITS.speed_at(-24, L_M) == pytest.approx(sqrt(1.5 * 0.66 / tan(radians(24))))
    )
    assert LIMITS.speed_at(24, L_M) == pytest.approx(1.491, abs=0.001)
    assert LIMITS.speed_at(0, L_M) == LIMITS.speed_at(5e-324, L_M) == 2.222
    assert LIMITS.angle_at(2.222, L_M) == LIMITS.angle_at(-2.222, L_M) == pytest.approx(11.34, abs=0.01)
    assert LIMITS.angle_at(0, L_M) == 24


@given(speed_mps=st.floats(-2.222, 2.222))
def test_speed_and_angle_limits_are_the_same_rule(speed_mps: float) -> None:
    """Whatever the speed, and be it too small to be squared."""
    angle_deg = LIMITS.angle_at(speed_mps, L_M)
    assert 0 < angle_deg <= 24
    assert abs(speed_mps) <= LIMITS.speed_at(angle_deg, L_M) * (1 + 1e-9)


def test_three_ways_to_say_a_bend() -> None:
    """2 m radius, to the left: the bicycle model with a wheelbase of 0.660 m; backward it turns the other way."""
    bend_deg = degrees(atan(0.66 / 2))
    assert steering_angle_deg(drive(angle_deg=bend_deg), L_M) == bend_deg
    assert steering_angle_deg(drive(curvature_1pm=0.5), L_M) == pytest.approx(bend_deg)
    assert steering_angle_deg(drive(yaw_rate_radps=0.5), L_M) == pytest.approx(bend_deg)
    assert steering_angle_deg(drive(-2.0, yaw_rate_radps=-1.0), L_M) == pytest.approx(bend_deg)
    assert steering_angle_deg(drive(0.0, yaw_rate_radps=0.0), L_M) == 0.0


@pytest.mark.parametrize(
    ("asked", "why"),
    [
        (drive(), "exactly one"),
        (drive(angle_deg=0.0, curvature_1pm=0.0), "exactly one"),
        (drive(angle_deg=0.0, yaw_rate_radps=0.0), "exactly one"),
        (drive(curvature_1pm=0.0, yaw_rate_radps=0.0), "exactly one"),
        (drive(0.0, yaw_rate_radps=0.1), "on the spot"),
        (drive(5e-324, yaw_rate_radps=1e300), "too tight"),
    ],
)
def test_what_is_no_bend_is_told(asked: Drive, why: str) -> None:
    """None, two, or one that no robot can drive."""
    told = steering_angle_deg(asked, L_M)
    assert isinstance(told, str)
    assert why in told


numbers = st.floats(allow_nan=False, allow_infinity=False)


@given(speed_mps=numbers, bend=numbers, name=st.sampled_from(["angle_deg", "curvature_1pm", "yaw_rate_radps"]))
def test_no_finite_numbers_raise(speed_mps: float, bend: float, name: str) -> None:
    """An angle that is asked for as a bend is within a right angle."""
    told = steering_angle_deg(drive(speed_mps, **{name: bend}), L_M)
    assert isinstance(told, str) or name == "angle_deg" or abs(told) <= 90
