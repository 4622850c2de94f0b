"""The plant against what can be worked out on paper."""

from math import radians, sin
from random import Random

import pytest

from tests.system.scenarios.plant import (
    BODY,
    BRAKING_CMD,
    DRIVE,
    GEAR,
    GEAR_D,
    GEAR_N,
    GEAR_P,
    GRAVITY_MPS2,
    PARKING,
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


def test_a_controller_that_restarts_forgets_its_commands() -> None:
    """It says nothing meanwhile, and is in mode stop after."""
    plant = on_hill(0)
    assert plant.mode == 0
    plant.reboot(0.5)
    assert not [frame for _ in range(80) for frame in plant.step()]
    assert [frame for _ in range(40) for frame in plant.step()]
    assert plant.mode == 2


def test_held_wheels_stay_whatever_the_motor_does() -> None:
    """And the robot sets off when they come free."""
    plant = on_hill(0)
    plant.blocked = True
    told(plant, GEAR_D, 2.0)
    passes(plant, 1.0)
    assert plant.speed_mps == 0
    plant.blocked = False
    passes(plant, 1.0)
    assert plant.speed_mps > 1.0


@pytest.mark.parametrize(
    ("grip", "creep_mps", "rolled_m"), [(1.0, 0.0, 0.0), (0.0, 0.0, 0.16), (1.0, 0.02, 0.0136)]
)
def test_a_parking_brake_that_reads_applied_may_hold_nothing(
    grip: float, creep_mps: float, rolled_m: float
) -> None:
    """Without grip it rolls as gravity says, and it creeps at its speed; in gear the motor holds the robot."""
    plant = on_hill(5)
    plant.brake_grip, plant.brake_creep_mps = grip, creep_mps
    told(plant, GEAR_D, parking=1)
    shown = passes(plant, 0.5)
    assert (plant.x_m, shown[PARKING][1], plant.brake_holds) == (0, 1, not rolled_m)
    told(plant, GEAR_N, parking=1)
    passes(plant, 0.68)
    assert -plant.x_m == pytest.approx(rolled_m, rel=0.1)


def test_a_weak_battery_takes_force_and_speed() -> None:
    """At 0.6 of it, 20 deg are too steep even without a load, and 2 m/s is the most."""
    weak = Plant(Build(battery=0.6), Random(1), 20)  # noqa: S311
    assert on_hill(20).can_climb
    assert not weak.can_climb
    weak.slope_deg = weak.slope_target_deg = 0.0
    told(weak, GEAR_D, 2.2)
    passes(weak, 5.0)
    assert weak.speed_mps == pytest.approx(2.0, abs=0.01)


def test_frozen_frames_count_on_and_silent_ones_do_not_come() -> None:
    """A frozen frame repeats its values with a counter that runs."""
    plant = on_hill(0)
    plant.frozen, plant.silent = frozenset({DRIVE}), frozenset({BODY})
    told(plant, GEAR_D, 1.0)
    frames = [frame for _ in range(200) for frame in plant.step()]
    drives = [data for identifier, data in frames if identifier == DRIVE]
    assert {data[:6] for data in drives} == {drives[0][:6]}
    assert len({data[6] for data in drives}) == 16
    assert BODY not in {identifier for identifier, _ in frames}


def test_a_bumper_bounces_and_is_clear_after_the_way_back() -> None:
    """On and off at first, then on; off for good 0.3 m away."""
    plant = on_hill(0)
    plant.touch("front")
    touches = [plant._touches()[0] for _ in range(4)]
    assert touches[0] == 1
    plant.x_m += 0.1
    plant._contact_s = 1.0
    assert plant._touches() == (1, 0)
    plant.x_m -= 0.5
    plant._touches()
    assert plant.wall is None
