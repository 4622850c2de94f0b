"""The command that a chassis must have had, by its feedback: there a stop begins that we did not lead up to."""

from __future__ import annotations

from gateway.command.actuation import Actuation
from gateway.command.chassis_state import ChassisState
from gateway.command.limits import MotionLimits
from schemas.messages import GearPosition
from schemas.settings import STEERING_DEVIATION_DEG

IN_GEAR = frozenset({GearPosition.DRIVE, GearPosition.REVERSE})


def inferred_angle_deg(chassis: ChassisState, limits: MotionLimits) -> float:
    """The steering angle, within the limit; straight on if it is not seen."""
    return max(-limits.steering_deg, min(limits.steering_deg, chassis.angle_deg or 0.0))


def inferred_actuation(chassis: ChassisState, limits: MotionLimits, left: Actuation | None = None) -> Actuation:
    """Infer the command that the chassis must have had.

    Args:
        chassis: the chassis now.
        limits: the configured ones; no speed is above them, nor above what they allow at the steering angle.
        left: the command that we left it with, if it may execute that again: no speed is above that one. If
            others left it, the parking brake is applied where the gear is that of a parked robot, or is not known:
            released, it may set a standing robot going.
    """
    rolls = chassis.gear in IN_GEAR
    angle_deg = inferred_angle_deg(chassis, limits)
    # The feedback is off by a degree: what we told goes on where the wheels still are there.
    if left is not None and abs(left.angle_deg - angle_deg) <= STEERING_DEVIATION_DEG:
        angle_deg = left.angle_deg
    gear = GearPosition.NEUTRAL if left is None else left.gear
    parking = chassis.gear in {GearPosition.PARK, GearPosition.UNDEFINED} if left is None else left.parking
    speed_mps = min(chassis.slowest_mps, limits.speed_at(max(abs(angle_deg), abs(chassis.angle_deg or 0.0))))
    if left is not None:
        speed_mps = min(speed_mps, left.speed_mps) if left.gear is chassis.gear else 0.0
    return Actuation(
        enabled=True,
        gear=chassis.gear if rolls else gear,
        speed_mps=speed_mps if rolls and not parking else 0.0,
        angle_deg=angle_deg,
        parking=parking,
    )
