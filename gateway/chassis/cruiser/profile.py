"""The Cruiser as one value, ``CRUISER``, which only ``gateway.choice`` imports."""

from __future__ import annotations

from typing import Final

from gateway.chassis.cruiser.bursts import FrameMaker
from gateway.chassis.cruiser.frames import (
    BODY,
    LIGHT_COMMAND,
    MOTION_FRAMES,
    ODOMETER_COMMAND,
    PLAUSIBLE,
    SCALED_BY_VARIANT,
    SPEAKER_COMMAND,
    WHEEL_SPEED,
    StandstillEvidence,
    load,
)
from gateway.chassis.cruiser.gate import Gate
from gateway.chassis.cruiser.guard_view import ChassisView
from gateway.chassis.cruiser.tracker import ChassisTracker
from gateway.chassis.port import AuxiliaryFrame, Chassis
from schemas.cruiser import (
    DBC_FILES,
    SCALE_RATIO,
    SPEED_BIT_MPS,
    SPEED_TOP_MPS,
    STEERING_TOP_DEG,
    TRACK_M,
    WHEEL_RADIUS_M,
    WHEELBASE_M,
    dbc_text,
)

CRUISER: Final = Chassis(
    dbc_files=DBC_FILES,
    dbc_text=dbc_text,
    layout=load,
    rules=PLAUSIBLE,
    evidence=StandstillEvidence,
    tracker=ChassisTracker,
    maker=FrameMaker,
    gate=lambda may_release: Gate(may_release=may_release),
    view=ChassisView,
    light=AuxiliaryFrame(LIGHT_COMMAND, {"Headlamp": False, "RightIndicator": False, "LeftIndicator": False}),
    lamps=("Headlamp", "LeftIndicator", "RightIndicator"),
    horn={is_on: AuxiliaryFrame(SPEAKER_COMMAND, {"Horn": is_on}) for is_on in (False, True)},
    odometer={
        clears: AuxiliaryFrame(ODOMETER_COMMAND, {"Enable": clears, "ClearMileage": clears})
        for clears in (False, True)
    },
    motion_frames=MOTION_FRAMES,
    scaled_frames=SCALED_BY_VARIANT,
    evidence_frame=WHEEL_SPEED,
    bumper_frame=BODY,
    speed_bit_mps=SPEED_BIT_MPS,
    scale_ratio=SCALE_RATIO,
    wheelbase_m=WHEELBASE_M,
    track_m=TRACK_M,
    wheel_radius_m=WHEEL_RADIUS_M,
    top_speed_mps=SPEED_TOP_MPS,
    top_angle_deg=STEERING_TOP_DEG,
)
