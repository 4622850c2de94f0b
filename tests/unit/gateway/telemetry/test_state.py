"""The whole robot in one message."""

from typing import Any, Final

import msgspec
import pytest

from gateway.choice import CHASSIS
from gateway.telemetry.health import LatestMessages, robot_state
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

COMMON: Final[dict[str, Any]] = {"time_ns": 1, "sequence": 2, "alive_counter": 3}

AT_REST: Final[list[Feedback]] = [
    Gear(active=False, gear_position=GearPosition.PARK, **COMMON),
    Steering(active=False, angle_deg=0.0, **COMMON),
    Drive(active=False, speed_mps=0.0, **COMMON),
    Braking(active=False, braking_status=BrakingStatus.RELEASED, **COMMON),
    Parking(active=False, parking_status=ParkingStatus.RELEASED, **COMMON),
    WheelSpeed(valid=True, rear_left_speed_mps=0.0, rear_right_speed_mps=0.0, **COMMON),
    WheelPulse(valid=True, rear_left_pulses=0, rear_right_pulses=0, **COMMON),
    Body(valid=True, total_mileage_km=0.0, front_bumper=False, rear_bumper=False, mode=Mode.STOP, **COMMON),
    Light(headlamp=False, right_indicator=False, left_indicator=False, **COMMON),
    Speaker(horn=False, **COMMON),
]
"""A message of each class in which every signal is off, 0 or at rest."""

SIGNALS: Final[list[tuple[type[Feedback], str, Any]]] = [
    (Body, "mode", Mode.AUTO),
    (Gear, "gear_position", GearPosition.DRIVE),
    (Drive, "speed_mps", 0.04),
    (Steering, "angle_deg", -3.5),
    (WheelSpeed, "rear_left_speed_mps", 0.04),
    (WheelSpeed, "rear_right_speed_mps", -0.04),
    (WheelPulse, "rear_left_pulses", 7),
    (WheelPulse, "rear_right_pulses", -7),
    (Braking, "braking_status", BrakingStatus.BRAKING),
    (Parking, "parking_status", ParkingStatus.APPLIED),
    (Body, "total_mileage_km", 12.5),
    (Body, "front_bumper", True),
    (Body, "rear_bumper", True),
    (Light, "headlamp", True),
    (Light, "right_indicator", True),
    (Light, "left_indicator", True),
    (Speaker, "horn", True),
]
"""The class, its field, which is also that of the state, and a value that no message at rest has."""

FIELDS: Final = [name for _, name, _ in SIGNALS]


def state_of(messages: list[Feedback]) -> RobotState:
    """The state that these messages make."""
    return robot_state(
        LatestMessages(messages),
        wheelbase_m=CHASSIS.wheelbase_m,
        time_ns=1,
        sequence=2,
        bus_up=True,
        variant=Variant.COARSE,
        silent=[],
    )


def at_rest_but(kind: type[Feedback], **values: object) -> list[Feedback]:
    """Every message at rest, but this one with these values."""
    return [
        msgspec.structs.replace(message, **values) if isinstance(message, kind) else message for message in AT_REST
    ]


def differing(one: RobotState, other: RobotState) -> dict[str, Any]:
    """The fields in which a state is not the other, with the one's values."""
    return {
        name: getattr(one, name)
        for name in RobotState.__struct_fields__
        if getattr(one, name) != getattr(other, name)
    }


@pytest.mark.parametrize(("kind", "field", "value"), SIGNALS, ids=FIELDS)
def test_a_field_is_its_own_signal(kind: type[Feedback], field: str, value: object) -> None:
    """One signal that changes changes the field of its name to its value, and no other."""
    assert differing(state_of(at_rest_but(kind, **{field: value})), state_of(AT_REST)) == {field: value}


@pytest.mark.parametrize(("kind", "field", "value"), SIGNALS, ids=FIELDS)
def test_a_field_without_its_message_is_unknown(kind: type[Feedback], field: str, value: object) -> None:
    """Silence is no value: null, or undefined."""
    state = state_of([message for message in AT_REST if not isinstance(message, kind)])
    unknown = getattr(type(value), "UNDEFINED", None)
    assert getattr(state, field) is unknown


@pytest.mark.parametrize(
    ("kind", "unknown"),
    [
        (WheelSpeed, {"rear_left_speed_mps": None, "rear_right_speed_mps": None}),
        (WheelPulse, {"rear_left_pulses": None, "rear_right_pulses": None}),
        (
            Body,
            {"mode": Mode.UNDEFINED, "total_mileage_km": None, "front_bumper": None, "rear_bumper": None},
        ),
    ],
)
def test_what_is_marked_invalid_is_unknown(kind: type[Feedback], unknown: dict[str, object]) -> None:
    """A message that says of itself that it is not valid gives no value, and no mode, to the state."""
    assert differing(state_of(at_rest_but(kind, valid=False)), state_of(AT_REST)) == unknown
