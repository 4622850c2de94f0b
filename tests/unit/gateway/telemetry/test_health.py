"""The gateway's health, each second, and the whole robot in one message."""

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
from schemas.messages import Body, GatewayHealth, Mode, Variant, WheelPulse, WheelSpeed

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


@pytest.mark.parametrize(
    ("message", "fields"),
    [
        (
            WheelSpeed(valid=False, rear_left_speed_mps=1.0, rear_right_speed_mps=1.0, **COMMON),
            "rear_left_speed_mps rear_right_speed_mps",
        ),
        (
            WheelPulse(valid=False, rear_left_pulses=7, rear_right_pulses=7, **COMMON),
            "rear_left_pulses rear_right_pulses",
        ),
        (
            Body(valid=False, total_mileage_km=1.0, front_bumper=True, rear_bumper=True, mode=Mode.AUTO, **COMMON),
            "total_mileage_km front_bumper rear_bumper mode",
        ),
    ],
    ids=lambda one: type(one).__name__,
)
def test_what_is_marked_invalid_is_unknown(message: WheelSpeed | WheelPulse | Body, fields: str) -> None:
    def state_of(message: WheelSpeed | WheelPulse | Body) -> list[object]:
        state = robot_state(
            LatestMessages([message]),
            wheelbase_m=CHASSIS.wheelbase_m,
            time_ns=1,
            sequence=2,
            bus_up=True,
            variant=Variant.COARSE,
            silent=[],
        )
        return [getattr(state, field) for field in fields.split()]

    assert set(state_of(message)) <= {None, Mode.UNDEFINED}
    valid = msgspec.structs.replace(message, valid=True)
    assert state_of(valid) == [getattr(valid, field) for field in fields.split()]
