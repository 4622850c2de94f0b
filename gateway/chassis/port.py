"""The seam between command flow and chassis: the state that the arbiter sees, the actuation that it decides.

- The command to the chassis in one tick, in physical units.
- The chassis as the arbiter sees it at a tick: where the telemetry flow and the command flow touch.
"""

from __future__ import annotations

from typing import Final

import msgspec

from schemas.messages import ControllerState, GearPosition, Mode, ParkingStatus, Variant
from schemas.settings import STANDSTILL_MPS


class Actuation(msgspec.Struct, frozen=True):
    """The five command frames of a tick.

    Attributes:
        enabled: the enables of all five.
        gear: neutral, drive or reverse. Park is reserved and never commanded (manual V2.0, table of gears).
        speed_mps: a magnitude; the gear gives the direction.
        angle_deg: left is positive.
        parking: the parking brake is asked for.
    """

    enabled: bool = False
    gear: GearPosition = GearPosition.NEUTRAL
    speed_mps: float = 0.0
    angle_deg: float = 0.0
    parking: bool = True

    @property
    def signed_speed_mps(self) -> float:
        """Forward is positive."""
        return -self.speed_mps if self.gear is GearPosition.REVERSE else self.speed_mps


AT_REST: Final = Actuation()
"""Disabled, neutral, parked."""


class ChassisState(msgspec.Struct, frozen=True):
    """The chassis, the bus and the guard now. A field that is not known is None or UNDEFINED.

    Attributes:
        bus_up: the bus is open.
        bus_losses: number of losses since the start.
        controller: the CAN controller's error state, if that is known.
        missing: required feedback frames that were never seen, are silent, or say that they are not valid.
        faulty: required feedback frames whose checksums or alive counters have failed.
        absurd: required feedback frames whose values this chassis cannot have, again and again.
        variant: the firmware variant in force; UNKNOWN while there is any doubt.
        confirmed: evidence from the bus agrees with the variant.
        brake: the parking brake's feedback.
        speed_mps: the drive feedback, a magnitude.
        wheel_speed_mps: mean of the rear wheels, signed.
        fastest_wheel_mps: the faster of the two, a magnitude.
        turns: the raw drive feedback is not zero, or there is none and the raw wheel speeds are not those of
            standstill: the robot moves, in whatever scale.
        pulses: the direction in which the wheel encoders count, 1 forward, -1 backward; 0 while they stand still
            or are not known. The manual gives no resolution, so they give a direction and no speed.
        creeps: the direction in which they have counted for a while, but not in each frame; 0 if they have not.
        commander_ns: when another computer's command frame was last received; None if never.
        guarded: the guard watches this process.
        guard_sends: the guard is stopping the robot in our place.
        guard_stops: number of stops that it has begun since the start.
        guard_says: why it last did, and how that ended; empty if it never did.
        is_behind: frames come faster than they can be read, so what is seen is old.
        realtime: the gateway has real-time priority.
    """

    bus_up: bool = False
    bus_losses: int = 0
    controller: ControllerState = ControllerState.UNKNOWN
    missing: tuple[str, ...] = ()
    faulty: tuple[str, ...] = ()
    absurd: tuple[str, ...] = ()
    variant: Variant = Variant.UNKNOWN
    confirmed: bool = False
    mode: Mode = Mode.UNDEFINED
    gear: GearPosition = GearPosition.UNDEFINED
    brake: ParkingStatus = ParkingStatus.UNDEFINED
    speed_mps: float | None = None
    wheel_speed_mps: float | None = None
    fastest_wheel_mps: float | None = None
    turns: bool | None = None
    pulses: int = 0
    angle_deg: float | None = None
    front_bumper: bool | None = None
    rear_bumper: bool | None = None
    total_mileage_km: float | None = None
    commander_ns: int | None = None
    guarded: bool = False
    guard_sends: bool = False
    guard_stops: int = 0
    guard_says: str = ""
    is_behind: bool = False
    realtime: bool = False
    creeps: int = 0

    @property
    def reads_zero(self) -> bool:
        """Both speeds are known and are those of a standing robot."""
        return (
            self.speed_mps is not None
            and self.fastest_wheel_mps is not None
            and self.speed_mps < STANDSTILL_MPS
            and self.fastest_wheel_mps < STANDSTILL_MPS
        )

    @property
    def is_slow(self) -> bool:
        """Both speeds are those of a standing robot, and no encoder counts."""
        return self.reads_zero and not self.pulses

    @property
    def moves(self) -> bool:
        """Drive feedback, wheels or encoders show a robot that moves, whichever does."""
        # Where the scale is in doubt the raw drive feedback counts; else a fine one would never be at rest.
        is_scaled = self.confirmed and self.speed_mps is not None
        turns = bool(self.turns) and not is_scaled
        return turns or bool(self.pulses or self.creeps) or (self.fastest_mps or 0.0) > STANDSTILL_MPS

    @property
    def slowest_mps(self) -> float:
        """The lowest speed that a sensor shows, a magnitude: no single faulty one sets the robot going."""
        return min(self._known_mps, default=0.0)

    @property
    def fastest_mps(self) -> float | None:
        """The highest speed that a sensor shows, a magnitude; None if none shows any."""
        return max(self._known_mps, default=None)

    @property
    def _known_mps(self) -> list[float]:
        return [speed for speed in (self.speed_mps, self.fastest_wheel_mps) if speed is not None]
