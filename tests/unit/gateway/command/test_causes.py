"""What stops the robot."""

import msgspec
import pytest

from gateway.chassis.port import Actuation, ChassisState
from gateway.choice import CHASSIS
from gateway.command.monitor import ChassisMonitor
from gateway.command.rulings import STOPS
from schemas.messages import GearPosition, Mode, ParkingStatus, Variant
from schemas.reasons import Reason
from tests.support.rigs.arbiter import MS
from tests.support.rigs.arbiter import STANDING as IN_STOP

TOLD = Actuation(enabled=True, gear=GearPosition.DRIVE, parking=False)
LIMIT_MPS = 2.222
STANDING = msgspec.structs.replace(IN_STOP, mode=Mode.AUTO, gear=GearPosition.NEUTRAL)
MOVING = msgspec.structs.replace(STANDING, speed_mps=1.0, wheel_speed_mps=1.0, fastest_wheel_mps=1.0, turns=True)


def but(chassis: ChassisState = STANDING, /, **changes: object) -> ChassisState:
    """The same but for this."""
    return msgspec.structs.replace(chassis, **changes)


def monitoring(*chassis: ChassisState) -> ChassisMonitor:
    """A monitor that has seen these, a tick each, the last of them at zero."""
    monitor = ChassisMonitor(CHASSIS)
    for number, each in enumerate(chassis, 1 - len(chassis)):
        monitor.update(each, number * 10 * MS)
    return monitor


def found(monitor: ChassisMonitor, at_ms: int = 0, late_ns: int = 0) -> list[Reason]:
    """The causes to stop a robot that is told to stand."""
    return monitor.faults(TOLD, LIMIT_MPS, late_ns, at_ms * MS, is_engaged=True)


def test_what_latches_is_what_the_table_says() -> None:
    """Each row that says 'latched'; a fault of our own, and a frame that is frozen, too."""
    assert {reason for reason, stop in STOPS.items() if stop.latched} == {
        Reason.REMOTE_STOP,
        Reason.FRONT_BUMPER,
        Reason.REAR_BUMPER,
        Reason.ROLLING,
        Reason.IMPLAUSIBLE_SPEED,
        Reason.OVERSPEED,
        Reason.STEERING,
        Reason.NOT_MOVING,
        Reason.BRAKE_SLIPS,
        Reason.FEEDBACK_FROZEN,
        Reason.GATE,
        Reason.GUARD,
    }
    assert all(stop.at_once for stop in STOPS.values() if stop.latched)


def test_what_is_a_controlled_stop() -> None:
    """Rows 'deadman: controlled stop' and 'disengage: controlled stop, no latch'; all of the operator's side."""
    assert {reason for reason, stop in STOPS.items() if not stop.at_once} == {
        Reason.IDLE,
        Reason.UNGUARDED,
        Reason.DEADMAN,
        Reason.DISENGAGED,
        Reason.LEASE_EXPIRED,
        Reason.LEASE_RELEASED,
        Reason.LEASE_TAKEN,
        Reason.GRANT_EXPIRED,
        Reason.GRANT_REVOKED,
        Reason.NOT_CONFIRMED,
        Reason.FOUND_MOVING,
        Reason.SHUTDOWN,
    }


def test_a_scale_in_doubt_does_not_ramp() -> None:
    """A ramp in the wrong scale would ask for 40 times the speed."""
    assert {reason for reason, stop in STOPS.items() if not stop.ramps} == {
        Reason.IMPLAUSIBLE_SPEED,
        Reason.VARIANT_UNKNOWN,
    }


def test_what_gets_the_parking_brake_at_once() -> None:
    """Row 'rolling: parking brake at once'; and where a ramp cannot be told: what the gate refuses, mode stop."""
    assert {reason for reason, stop in STOPS.items() if stop.parks} == {
        Reason.ROLLING,
        Reason.GATE,
        Reason.MODE_NOT_AUTO,
    }


@pytest.mark.parametrize(
    ("changes", "slow"),
    [
        ({}, True),
        ({"speed_mps": 0.0499, "fastest_wheel_mps": 0.0499}, True),
        ({"speed_mps": 0.05}, False),
        ({"fastest_wheel_mps": 0.05}, False),
        ({"pulses": 1}, False),
        ({"speed_mps": None}, False),
        ({"fastest_wheel_mps": None}, False),
    ],
)
def test_standstill_is_five_slow_ticks(changes: dict[str, object], slow: bool) -> None:  # noqa: FBT001
    """Row 'standstill: measured speed under 0.05 m/s': both speeds known, for 50 ms without a break."""
    seen = but(**changes)
    assert monitoring(*[seen] * 4).stands is False
    assert monitoring(*[seen] * 5).stands is slow
    assert monitoring(*[seen] * 4, MOVING, *[seen] * 4).stands is False


RELEASED = but(brake=ParkingStatus.RELEASED)
DRIVEN = msgspec.structs.replace(TOLD, speed_mps=1.0)
PARKED = msgspec.structs.replace(TOLD, parking=True)


@pytest.mark.parametrize(
    ("driven", "stopped", "parked", "is_confirmed"),
    [
        (MOVING, STANDING, STANDING, True),
        (RELEASED, MOVING, RELEASED, True),
        (RELEASED, RELEASED, STANDING, True),
        (RELEASED, RELEASED, RELEASED, False),
        (STANDING, STANDING, STANDING, False),
        (MOVING, MOVING, MOVING, False),
    ],
    ids=["it moved", "it moved on", "its brake answered", "nothing answered", "frozen as parked", "it moves"],
)
def test_a_robot_that_was_told_a_speed_stands_once_its_feedback_has_answered(
    driven: ChassisState,
    stopped: ChassisState,
    parked: ChassisState,
    is_confirmed: bool,  # noqa: FBT001 - a case
) -> None:
    """Row '"the robot stands"': a speed that rose and fell, or a parking brake that turned applied when asked."""
    monitor = monitoring(STANDING)
    for chassis, told in ((driven, DRIVEN), (stopped, TOLD), (parked, PARKED)):
        for _ in range(5):
            monitor.update(chassis, 0, told)
    assert monitor.is_rest_confirmed is is_confirmed


def test_a_speed_beyond_the_chassis_is_one_in_the_other_scale() -> None:
    """Row 'plausibility: stop, latched, and say which scale fits'; before engaging it is faulty feedback."""
    monitor = monitoring(but(absurd=("Auto_DriveFeedBack",), speed_mps=None))
    assert monitor.chassis_faults() == [Reason.FEEDBACK_FAULTY]
    assert found(monitor)[0] is Reason.IMPLAUSIBLE_SPEED
    assert monitor.fault_detail(Reason.IMPLAUSIBLE_SPEED, 0) == (
        "Auto_DriveFeedBack reads beyond what the chassis can do; the fine scale may fit"
    )
    assert Reason.IMPLAUSIBLE_SPEED not in found(monitoring(but(absurd=("Auto_SteeringFeedBack",))))


FRONT = but(front_bumper=True)


def see(monitor: ChassisMonitor, chassis: ChassisState, from_ms: int, until_ms: int) -> None:
    """The same in every tick of this time, the last included."""
    for at_ms in range(from_ms, until_ms + 1, 10):
        monitor.update(chassis, at_ms * MS)


def test_a_reset_hit_is_a_new_one_once_the_bumper_was_clear_for_300_ms() -> None:
    """Row 'bumper: only motion away from the hit side until it reads clear for 300 ms'; each side for itself."""
    monitor = monitoring(FRONT)
    assert monitor.hits == [Reason.FRONT_BUMPER]
    monitor.acknowledge([Reason.FRONT_BUMPER])
    assert monitor.hits == []
    monitor.update(but(FRONT, rear_bumper=True), 10 * MS)
    assert monitor.hits == [Reason.REAR_BUMPER]
    see(monitor, STANDING, 20, 300)
    assert monitor.pressed == {Reason.FRONT_BUMPER, Reason.REAR_BUMPER}
    see(monitor, STANDING, 310, 310)
    assert monitor.pressed == set()
    see(monitor, FRONT, 320, 320)
    assert monitor.hits == [Reason.FRONT_BUMPER]


@pytest.mark.parametrize("chatter_ms", range(10, 81, 10))
def test_contacts_that_bounce_hit_once(chatter_ms: int) -> None:
    """Row 'bumper: contact bounce of an acknowledged bumper latches nothing new'; it is pressed meanwhile."""
    monitor = monitoring(FRONT)
    monitor.acknowledge([Reason.FRONT_BUMPER])
    for at_ms in range(10, 3_000, 10):
        monitor.update(FRONT if at_ms // chatter_ms % 2 else STANDING, at_ms * MS)
        assert (monitor.hits, monitor.pressed, monitor.struck) == ([], {Reason.FRONT_BUMPER}, set())


def test_a_reset_acknowledges_only_what_was_latched() -> None:
    """A bumper that is hit in the tick of the reset is not among it."""
    monitor = monitoring(but(front_bumper=True, rear_bumper=True))
    monitor.acknowledge([Reason.FRONT_BUMPER, Reason.REMOTE_STOP])
    assert monitor.hits == [Reason.REAR_BUMPER]


def test_a_bumper_strikes_once() -> None:
    """In the tick in which it is pressed, and again once it was clear for 300 ms."""
    monitor = monitoring(FRONT)
    assert monitor.struck == {Reason.FRONT_BUMPER}
    monitor.update(but(FRONT, rear_bumper=True), 10 * MS)
    assert monitor.struck == {Reason.REAR_BUMPER}
    see(monitor, STANDING, 20, 310)
    assert monitor.struck == set()
    see(monitor, FRONT, 320, 320)
    assert monitor.struck == {Reason.FRONT_BUMPER}


def test_a_bumper_that_was_not_seen_for_a_while_is_a_new_hit() -> None:
    """Not known is not pressed, and nobody has reset what comes next."""
    monitor = monitoring(FRONT)
    monitor.acknowledge([Reason.FRONT_BUMPER])
    see(monitor, but(front_bumper=None), 10, 300)
    assert monitor.pressed == set()
    see(monitor, FRONT, 310, 310)
    assert monitor.hits == [Reason.FRONT_BUMPER]


@pytest.mark.parametrize(("age_ms", "heard"), [(0, True), (99, True), (100, False), (None, False)])
def test_another_commander_is_heard_for_a_tenth_of_a_second(age_ms: int | None, heard: bool) -> None:  # noqa: FBT001
    """Row 'standing by: another computer may own it'."""
    monitor = monitoring(but(commander_ns=None if age_ms is None else 500 * MS - age_ms * MS))
    assert monitor.is_commanded_by_other(500 * MS) is heard
    assert (Reason.OTHER_COMMANDER in monitor.faults(TOLD, LIMIT_MPS, 0, 500 * MS, is_engaged=True)) is heard


@pytest.mark.parametrize(("failures", "stops"), [(4, False), (5, True)])
def test_frames_that_the_bus_does_not_take_stop(failures: int, stops: bool) -> None:  # noqa: FBT001
    """Five ticks in a row."""
    monitor = monitoring(STANDING)
    monitor.send_failures = failures
    assert found(monitor) == ([Reason.SEND_FAILED] if stops else [])


def test_what_is_not_plausible_stops() -> None:
    """Rows 'rolling' and 'plausibility': told to stand it moves; the details are those of what was found."""
    monitor = monitoring(MOVING)
    assert found(monitor) == []
    assert found(monitor, 100) == [Reason.ROLLING]
    assert monitor.fault_detail(Reason.ROLLING, 0) == "forward at 1.00 m/s by the wheels"
    assert found(monitor, 300) == [Reason.IMPLAUSIBLE_SPEED, Reason.ROLLING]
    assert monitor.fault_detail(Reason.IMPLAUSIBLE_SPEED, 0).startswith("the wheels turn forward at 1.00 m/s")


@pytest.mark.parametrize(
    "moves",
    [
        but(turns=True, confirmed=False, variant=Variant.UNKNOWN, speed_mps=None, fastest_wheel_mps=None),
        but(speed_mps=0.06),
        but(fastest_wheel_mps=0.06),
        but(pulses=-1, speed_mps=None, fastest_wheel_mps=None, turns=None),
        but(MOVING, mode=Mode.UNDEFINED),
    ],
    ids=["raw", "drive", "wheels", "pulses", "no body frame"],
)
def test_found_moving_for_a_fifth_of_a_second(moves: ChassisState) -> None:
    """Row 'found at start: in auto, moving by drive, wheels or pulses, and nobody sending': without a break."""
    monitor = monitoring(moves)
    assert [monitor.found_moving(at_ms * MS) for at_ms in (0, 199, 200)] == [False, False, True]
    for calm in (
        STANDING,
        but(moves, mode=Mode.STOP),
        but(moves, mode=Mode.REMOTE),
        but(moves, commander_ns=200 * MS),
    ):
        monitor.update(calm, 210 * MS)
        assert not monitor.found_moving(210 * MS)
        monitor.update(moves, 220 * MS)
        assert not monitor.found_moving(220 * MS)
        assert not monitor.found_moving(419 * MS)
        assert monitor.found_moving(420 * MS)
