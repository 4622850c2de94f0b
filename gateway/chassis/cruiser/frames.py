"""The Cruiser's frames by their names in the DBC, and the signals of its commands."""

from __future__ import annotations

from typing import Final

from gateway.chassis.decode import Signals
from schemas.messages import GearPosition

GEAR: Final = "Auto_GearFeedBack"
STEERING: Final = "Auto_SteeringFeedBack"
DRIVE: Final = "Auto_DriveFeedBack"
PARKING: Final = "Auto_ParkingFeedBack"
BODY: Final = "Auto_MileageAndBodyFeedback"
WHEEL_SPEED: Final = "Auto_WheelSpdFeedback"
WHEEL_PULSE: Final = "Auto_WheelPulseFeedback"

SCALED_BY_VARIANT: Final = (DRIVE, WHEEL_SPEED)
"""The feedback frames whose layout depends on the variant: those of speeds. A test holds this against the DBCs."""

DRIVE_COMMAND: Final = "Auto_DriveCmd"
GEAR_COMMAND: Final = "Auto_GearCmd"
STEERING_COMMAND: Final = "Auto_SteeringCmd"
BRAKING_COMMAND: Final = "Auto_BrakingCmd"
PARKING_COMMAND: Final = "Auto_ParkingCmd"
LIGHT_COMMAND: Final = "Auto_LightCmd"
SPEAKER_COMMAND: Final = "Auto_SpeakerCmd"
ODOMETER_COMMAND: Final = "Auto_OdometerCmd"

MOTION_FRAMES: Final = (DRIVE_COMMAND, GEAR_COMMAND, STEERING_COMMAND, BRAKING_COMMAND, PARKING_COMMAND)
"""The five of a burst. The speed frame is sent first, so even a partly accepted burst stops the robot."""

BRAKE_FIRST_FRAMES: Final = (DRIVE_COMMAND, PARKING_COMMAND, GEAR_COMMAND, STEERING_COMMAND, BRAKING_COMMAND)
"""Their order at zero speed, after a burst of which the bus took only a part: so the brake comes through too."""

TARGET_SPEED: Final = "TargetVelocity"
TARGET_ANGLE: Final = "TargetAngle"


def motion_signals(
    *, enabled: bool, gear: GearPosition, speed_mps: float, angle_deg: float, parking: bool
) -> dict[str, Signals]:
    """Return the signals of the five motion frames. The brake pedal is reserved, and never pressed."""
    return {
        GEAR_COMMAND: {"Enable": enabled, "TargetGear": gear.value},
        STEERING_COMMAND: {"Enable": enabled, TARGET_ANGLE: angle_deg},
        DRIVE_COMMAND: {"Enable": enabled, TARGET_SPEED: speed_mps},
        BRAKING_COMMAND: {"Enable": enabled, "BrakePedal": 0.0},
        PARKING_COMMAND: {"Enable": enabled, "ParkingRequest": parking},
    }


def light_signals(*, headlamp: bool = False, left: bool = False, right: bool = False) -> Signals:
    """Return the signals of the light command."""
    return {"Headlamp": headlamp, "RightIndicator": right, "LeftIndicator": left}


def speaker_signals(*, horn: bool = False) -> Signals:
    """Return the signals of the speaker command."""
    return {"Horn": horn}


def odometer_signals(*, clears: bool = False) -> Signals:
    """Return the signals of the odometer command."""
    return {"Enable": clears, "ClearMileage": clears}
