"""The gateway's health, each second, and the whole robot in one message."""

from enum import Enum
from typing import Any, Final

import msgspec
import pytest

from gateway.choice.chassis import CHASSIS
from gateway.telemetry.health import (
    OTHER_IDENTIFIERS,
    UNKNOWN_IDENTIFIERS_MAX,
    HealthMeter,
    LatestMessages,
    Links,
    robot_state,
)
from schemas.messages import (
    Body,
    Braking,
    BrakingStatus,
    Drive,
    Feedback,
    GatewayHealth,
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

SECOND_NS = 10**9


def report(meter: HealthMeter, now_ns: int, *, cpu_ns: int = 0, frames: int = 0) -> GatewayHealth:
    return meter.report(now_ns, 0, Links(cpu_ns=cpu_ns), Variant.COARSE, frames, [])


def test_rates_are_those_since_the_last_report() -> None:
    meter = HealthMeter("0", "can0", 0)
    first = report(meter, SECOND_NS, cpu_ns=400_000_000, frames=630)
    second = report(meter, 3 * SECOND_NS, cpu_ns=600_000_000, frames=830)
    third = report(meter, 4 * SECOND_NS, cpu_ns=600_000_000, frames=830)
    assert [health.cpu_percent for health in (first, second, third)] == [40.0, 10.0, 0.0]
    assert [health.frames_per_s for health in (first, second, third)] == [630.0, 100.0, 0.0]
    assert [health.frames for health in (first, second, third)] == [630, 830, 830]
    assert [health.sequence for health in (first, second, third)] == [0, 1, 2]


def test_lateness_is_that_since_the_last_report_but_for_the_worst() -> None:
    meter = HealthMeter("0", "can0", 0)
    for late_ms in range(1, 101):
        meter.tick_lateness(late_ms * 1_000_000)
    first = report(meter, SECOND_NS)
    meter.tick_lateness(2_000_000)
    second = report(meter, 2 * SECOND_NS)
    assert (first.tick_lateness_p50_ms, first.tick_lateness_p99_ms, first.tick_lateness_max_ms) == (51, 100, 100)
    assert (second.tick_lateness_p50_ms, second.tick_lateness_max_ms) == (2, 2)
    assert (first.tick_lateness_worst_ms, second.tick_lateness_worst_ms) == (100, 100)


def test_strangers_are_counted_by_name_up_to_a_number() -> None:
    meter = HealthMeter("0", "can0", 0)
    for can_id in (*range(UNKNOWN_IDENTIFIERS_MAX + 10), 0):
        meter.unknown_identifier(can_id)
    counted = report(meter, SECOND_NS).unknown_identifiers
    assert len(counted) == UNKNOWN_IDENTIFIERS_MAX + 1
    assert counted[OTHER_IDENTIFIERS] == 10
    assert sum(counted.values()) == UNKNOWN_IDENTIFIERS_MAX + 11


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


def another(value: object) -> object:
    """A value of the same type that no message at rest has."""
    match value:
        case bool():
            return not value
        case Enum():
            return next(one for one in type(value) if one not in {value, getattr(type(value), "UNDEFINED", None)})
        case int():
            return 7
    return 0.04


SIGNALS: Final = [
    (type(message), name, another(getattr(message, name)))
    for message in AT_REST
    for name in message.__struct_fields__
    if name in {*RobotState.__struct_fields__} - {*COMMON}
]
"""The class, its field, which is also that of the state, and another value."""

FIELDS: Final = [name for _, name, _ in SIGNALS]


def test_the_state_has_the_signals_of_all_messages() -> None:
    derived = {*COMMON, "bus_up", "variant", "silent", "yaw_rate_radps"} - {"alive_counter"}
    assert sorted(FIELDS) == sorted({*RobotState.__struct_fields__} - derived)


def state_of(messages: list[Feedback]) -> RobotState:
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
    return [
        msgspec.structs.replace(message, **values) if isinstance(message, kind) else message for message in AT_REST
    ]


def differing(one: RobotState, other: RobotState) -> dict[str, Any]:
    return {
        name: getattr(one, name)
        for name in RobotState.__struct_fields__
        if getattr(one, name) != getattr(other, name)
    }


@pytest.mark.parametrize(("kind", "field", "value"), SIGNALS, ids=FIELDS)
def test_a_field_is_its_own_signal(kind: type[Feedback], field: str, value: object) -> None:
    assert differing(state_of(at_rest_but(kind, **{field: value})), state_of(AT_REST)) == {field: value}
    state = state_of([message for message in AT_REST if not isinstance(message, kind)])
    assert getattr(state, field) is getattr(type(value), "UNDEFINED", None)


@pytest.mark.parametrize(
    ("kind", "unknown"),
    [
        (WheelSpeed, {"rear_left_speed_mps": None, "rear_right_speed_mps": None}),
        (WheelPulse, {"rear_left_pulses": None, "rear_right_pulses": None}),
        (Body, {"mode": Mode.UNDEFINED, "total_mileage_km": None, "front_bumper": None, "rear_bumper": None}),
    ],
)
def test_what_is_marked_invalid_is_unknown(kind: type[Feedback], unknown: dict[str, object]) -> None:
    assert differing(state_of(at_rest_but(kind, valid=False)), state_of(AT_REST)) == unknown
