"""The limits in force, and the bicycle model that they are drawn from."""

from __future__ import annotations

from math import atan, degrees, inf, radians, sqrt, tan
from typing import Self

import msgspec

from schemas.cruiser import WHEELBASE_M
from schemas.requests import Drive
from schemas.settings import CommandSettings


class MotionLimits(msgspec.Struct, frozen=True):
    """MotionLimits of motion. They can be lowered at run time, never raised."""

    speed_mps: float
    acceleration_mps2: float
    deceleration_mps2: float
    emergency_deceleration_mps2: float
    steering_deg: float
    steering_rate_degps: float
    lateral_acceleration_mps2: float

    @classmethod
    def of(cls, settings: CommandSettings) -> Self:
        """The configured limits."""
        return cls(
            speed_mps=settings.speed_limit_mps,
            acceleration_mps2=settings.acceleration_mps2,
            deceleration_mps2=settings.deceleration_mps2,
            emergency_deceleration_mps2=max(settings.emergency_deceleration_mps2, settings.deceleration_mps2),
            steering_deg=settings.steering_limit_deg,
            steering_rate_degps=settings.steering_rate_degps,
            lateral_acceleration_mps2=settings.lateral_acceleration_mps2,
        )

    def lowered(self, speed_mps: float | None) -> MotionLimits:
        """The same with this speed limit, if it is a lower one."""
        if speed_mps is None or speed_mps >= self.speed_mps:
            return self
        return msgspec.structs.replace(self, speed_mps=max(0.0, speed_mps))

    def speed_at(self, angle_deg: float) -> float:
        """The highest speed, m/s, at this steering angle: v^2 tan(angle) / wheelbase within the lateral limit."""
        bend = tan(radians(abs(angle_deg)))
        if bend == 0:
            return self.speed_mps
        return min(self.speed_mps, sqrt(self.lateral_acceleration_mps2 * WHEELBASE_M / bend))

    def angle_at(self, speed_mps: float) -> float:
        """Return the largest steering angle, deg, at this speed, by the same rule."""
        square_m2ps2 = speed_mps * speed_mps
        if square_m2ps2 == 0:  # also that of a speed too small to be squared
            return self.steering_deg
        bend = self.lateral_acceleration_mps2 * WHEELBASE_M / square_m2ps2
        return min(self.steering_deg, degrees(atan(bend)))


def steering_angle_deg(drive: Drive) -> float | str:
    """The steering angle that a drive command asks for, before any limit, or what is wrong with the command.

    The bicycle model: curvature = tan(angle) / wheelbase, yaw rate = speed * curvature (ISO 8855: left positive).
    """
    given = [name for name in ("angle_deg", "curvature_1pm", "yaw_rate_radps") if getattr(drive, name) is not None]
    if len(given) != 1:
        return "exactly one of angle_deg, curvature_1pm and yaw_rate_radps is wanted"
    if drive.angle_deg is not None:
        return drive.angle_deg
    if drive.curvature_1pm is not None:
        return degrees(atan(drive.curvature_1pm * WHEELBASE_M))
    yaw_rate_radps = drive.yaw_rate_radps or 0.0
    if yaw_rate_radps == 0:
        return 0.0
    if drive.speed_mps == 0:
        return "the robot cannot turn on the spot: a yaw rate needs a speed"
    curvature_1pm = yaw_rate_radps / drive.speed_mps
    return degrees(atan(curvature_1pm * WHEELBASE_M)) if abs(curvature_1pm) < inf else "the curve is too tight"
