"""The plant against what can be worked out on paper; what it says is frozen too, in the column ``feedback``."""

from math import radians, sin
from random import Random

import pytest

from tests.system.scenarios.plant import (
    BRAKING_CMD,
    GEAR,
    GEAR_D,
    GEAR_N,
    GEAR_P,
    GRAVITY_MPS2,
    PARKING_CMD,
    PARKING_MPS2,
    ROLLING_MPS2,
    STEP_S,
    WHEELS,
    Build,
    Plant,
    checksum,
    orders,
)


def told(plant: Plant, gear: int, speed_mps: float = 0.0, **bytes_1: int) -> None:
    """Tell the plant the five; ``parking`` and ``pedal`` are the second bytes of their frames."""
    frames = orders(gear, speed_mps, fine=plant.build.fine)
    for name, identifier in (("parking", PARKING_CMD), ("pedal", BRAKING_CMD)):
        data = bytes([1, bytes_1.get(name, 0)]) + bytes(5)
        frames[identifier] = data + bytes([checksum(data)])
    for identifier, data in frames.items():
        plant.receive(identifier, data)


def passes(plant: Plant, seconds: float) -> dict[int, bytes]:
    """Time passes; the newest feedback."""
    for _ in range(round(seconds / STEP_S)):
        plant.step()
    return plant.shown


def on_hill(slope_deg: float, payload_kg: float = 0.0) -> Plant:
    """A chassis at rest on a hill, in auto, with its brake released and its motor holding it, if it can."""
    plant = Plant(Build(payload_kg=payload_kg, brake_delay_s=0.0), Random(1), slope_deg)  # noqa: S311
    told(plant, GEAR_D)
    passes(plant, 0.01)
    return plant


def test_in_neutral_it_rolls_as_gravity_less_resistance_says() -> None:
    """V = (g sin - r) t, and a pedal without a gain changes nothing."""
    plant = on_hill(8)
    told(plant, GEAR_N, pedal=200)
    passes(plant, 2.0)
    assert plant.speed_mps == pytest.approx(-(GRAVITY_MPS2 * sin(radians(8)) - ROLLING_MPS2) * 2, rel=0.02)


@pytest.mark.parametrize(("slope_deg", "payload_kg", "holds"), [(20, 0, True), (15, 100, True), (20, 100, False)])
def test_the_motor_holds_the_hills_of_the_manual(slope_deg: float, payload_kg: float, holds: bool) -> None:  # noqa: FBT001
    """20 deg empty and 15 deg loaded, and no more than that."""
    plant = on_hill(slope_deg, payload_kg)
    passes(plant, 2.0)
    assert plant.can_hold is holds
    assert (plant.speed_mps == 0) is holds


def test_the_parking_brake_stops_a_moving_robot_and_shows_as_park() -> None:
    """Within v^2 / 2a, and it holds 20 deg loaded."""
    plant = on_hill(0)
    told(plant, GEAR_D, 2.0)
    passes(plant, 4.0)
    before_m, speed_mps = plant.x_m, plant.speed_mps
    told(plant, GEAR_N, parking=1)
    shown = passes(plant, 1.0)
    assert speed_mps == pytest.approx(2.0, abs=0.01)
    assert plant.x_m - before_m == pytest.approx(speed_mps**2 / (2 * (PARKING_MPS2 + ROLLING_MPS2)), abs=0.02)
    assert shown[GEAR][1] == GEAR_P
    plant.slope_target_deg, plant.slope_rate_degps = 20.0, 100.0
    passes(plant, 1.0)
    assert plant.speed_mps == 0


def test_standing_wheels_read_as_the_manual_says() -> None:
    """Raw 200 in the coarse scale, 32768 in the fine one."""
    for fine, zero in ((False, 200), (True, 32768)):
        plant = Plant(Build(fine=fine), Random(1))  # noqa: S311
        assert int.from_bytes(passes(plant, 0.1)[WHEELS][1:3], "little") == zero
