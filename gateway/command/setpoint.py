"""The setpoint of the motion: what the holder asks for, and the limits in force. Pure."""

from __future__ import annotations

from gateway.command.limits import MotionLimits
from gateway.command.motion import Target
from schemas.settings import CommandSettings


class Setpoint:
    """The target of the motion, and its limits.

    Attributes:
        target: the motion of the last acceptable drive command.
        parked: the parking brake stays applied, whatever speed is asked for, until ``unpark``.
        limits: those in force.
        configured_limits: the highest that may be in force.
    """

    def __init__(self, settings: CommandSettings) -> None:
        self.configured_limits = MotionLimits.of(settings)
        self.reset(self.configured_limits)

    def reset(self, limits: MotionLimits) -> None:
        """Stand, parked, under these limits."""
        self.limits = limits
        self.target = Target()
        self.parked = True
