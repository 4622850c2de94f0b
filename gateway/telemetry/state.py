"""The whole robot in one message, from the newest message of each feedback frame."""

from __future__ import annotations

from math import radians, tan
from typing import Final, TypeVar

from schemas.cruiser import WHEELBASE_M
from schemas.messages import (
    Body,
    Braking,
    BrakingStatus,
    Drive,
    Feedback,
    Gear,
    GearPosition,
    Light,
    Mode,
    Parking,
    ParkingStatus,
    RobotState,
    Speaker,
    Steering,
    Variant,
    WheelPulse,
    WheelSpeed,
)
from schemas.settings import STANDSTILL_MPS

FeedbackType = TypeVar("FeedbackType", bound=Feedback)

DECIMALS: Final = 4
"""Of derived values: 0.1 mm/s, well below the chassis's own resolution."""


class LatestMessages:
    """The newest message of each class; none of a frame that is silent."""

    def __init__(self, messages: list[Feedback]) -> None:
        self._by_type: dict[type[Feedback], Feedback] = {type(message): message for message in messages}

    def of(self, kind: type[FeedbackType]) -> FeedbackType | None:
        """The newest message of this class, or None."""
        message = self._by_type.get(kind)
        return message if isinstance(message, kind) else None


def signed_speed_mps(drive: Drive | None, wheels: WheelSpeed | None, gear: Gear | None) -> float | None:
    """The drive feedback, a magnitude, with the direction of the wheels if they turn, else of the gear.

    None if the robot moves and neither gives the direction: half of the guesses would be wrong.
    """
    if drive is None:
        return None
    if wheels is not None and wheels.valid:
        mean_mps = (wheels.rear_left_speed_mps + wheels.rear_right_speed_mps) / 2
        if abs(mean_mps) > STANDSTILL_MPS:
            return -drive.speed_mps if mean_mps < 0 else drive.speed_mps
    if drive.speed_mps <= STANDSTILL_MPS:
        return drive.speed_mps
    direction = 0 if gear is None else {GearPosition.DRIVE: 1, GearPosition.REVERSE: -1}.get(gear.gear_position, 0)
    return direction * drive.speed_mps if direction else None


def yaw_rate_radps(speed_mps: float, angle_deg: float) -> float:
    """The yaw rate of the bicycle model (ISO 8855: left positive)."""
    return speed_mps * tan(radians(angle_deg)) / WHEELBASE_M


def robot_state(
    messages: LatestMessages, *, time_ns: int, sequence: int, bus_up: bool, variant: Variant, silent: list[str]
) -> RobotState:
    """The state. A field whose feedback is missing, silent or marked invalid is None, or ``undefined``.

    That holds for the mode too: that of an invalid frame is no evidence that the chassis accepts commands.
    """
    gear, steering, drive = messages.of(Gear), messages.of(Steering), messages.of(Drive)
    braking, parking, body = messages.of(Braking), messages.of(Parking), messages.of(Body)
    wheels, pulses = messages.of(WheelSpeed), messages.of(WheelPulse)
    light, speaker = messages.of(Light), messages.of(Speaker)
    speed_mps = signed_speed_mps(drive, wheels, gear)
    return RobotState(
        time_ns=time_ns,
        sequence=sequence,
        bus_up=bus_up,
        variant=variant,
        silent=silent,
        mode=body.mode if body and body.valid else Mode.UNDEFINED,
        gear_position=gear.gear_position if gear else GearPosition.UNDEFINED,
        speed_mps=speed_mps,
        angle_deg=steering.angle_deg if steering else None,
        yaw_rate_radps=(
            round(yaw_rate_radps(speed_mps, steering.angle_deg), DECIMALS) + 0.0  # + 0.0: no -0.0
            if steering and speed_mps is not None
            else None
        ),
        rear_left_speed_mps=wheels.rear_left_speed_mps if wheels and wheels.valid else None,
        rear_right_speed_mps=wheels.rear_right_speed_mps if wheels and wheels.valid else None,
        rear_left_pulses=pulses.rear_left_pulses if pulses and pulses.valid else None,
        rear_right_pulses=pulses.rear_right_pulses if pulses and pulses.valid else None,
        braking_status=braking.braking_status if braking else BrakingStatus.UNDEFINED,
        parking_status=parking.parking_status if parking else ParkingStatus.UNDEFINED,
        total_mileage_km=body.total_mileage_km if body and body.valid else None,
        front_bumper=body.front_bumper if body and body.valid else None,
        rear_bumper=body.rear_bumper if body and body.valid else None,
        headlamp=light.headlamp if light else None,
        right_indicator=light.right_indicator if light else None,
        left_indicator=light.left_indicator if light else None,
        horn=speaker.horn if speaker else None,
    )
