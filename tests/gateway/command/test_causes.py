"""What stops the robot."""

import msgspec
import pytest

from gateway.command.causes import STOPS, Watch
from gateway.command.observed import Observed
from schemas.messages import GearPosition, Mode, Variant
from schemas.reasons import Reason
from tests.gateway.command.arbiter_bench import MS
from tests.gateway.command.arbiter_bench import STANDING as IN_STOP

STANDING = msgspec.structs.replace(IN_STOP, mode=Mode.AUTO, gear=GearPosition.NEUTRAL)
MOVING = msgspec.structs.replace(STANDING, speed_mps=1.0, wheel_speed_mps=1.0, fastest_wheel_mps=1.0, turns=True)


def but(observed: Observed = STANDING, /, **changes: object) -> Observed:
    """The same but for this."""
    return msgspec.structs.replace(observed, **changes)


def watching(*observed: Observed) -> Watch:
    """A watch that has seen these."""
    watch = Watch()
    for each in observed:
        watch.observe(each)
    return watch


def test_what_latches_is_what_the_table_says() -> None:
    """Rows 'bumper', 'stop', 'plausibility': latched; a fault of our own, and the guard's work, too."""
    assert {reason for reason, stop in STOPS.items() if stop.latched} == {
        Reason.REMOTE_STOP,
        Reason.FRONT_BUMPER,
        Reason.REAR_BUMPER,
        Reason.IMPLAUSIBLE_SPEED,
        Reason.GATE,
        Reason.GUARD,
    }
    assert all(stop.at_once for stop in STOPS.values() if stop.latched)


def test_what_is_a_controlled_stop() -> None:
    """Rows 'deadman: controlled stop' and 'disengage: controlled stop, no latch'; all of the operator's side."""
    assert {reason for reason, stop in STOPS.items() if not stop.at_once} == {
        Reason.UNGUARDED,
        Reason.DEADMAN,
        Reason.DISENGAGED,
        Reason.LEASE_EXPIRED,
        Reason.LEASE_RELEASED,
        Reason.LEASE_TAKEN,
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


@pytest.mark.parametrize(
    ("changes", "slow"),
    [
        ({}, True),
        ({"speed_mps": 0.0499, "fastest_wheel_mps": 0.0499}, True),
        ({"speed_mps": 0.05}, False),
        ({"fastest_wheel_mps": 0.05}, False),
        ({"speed_mps": None}, False),
        ({"fastest_wheel_mps": None}, False),
    ],
)
def test_standstill_is_five_slow_ticks(changes: dict[str, object], slow: bool) -> None:  # noqa: FBT001
    """Row 'standstill: measured speed under 0.05 m/s': both speeds known, for 50 ms without a break."""
    seen = but(**changes)
    assert watching(*[seen] * 4).stands is False
    assert watching(*[seen] * 5).stands is slow
    assert watching(*[seen] * 4, MOVING, *[seen] * 4).stands is False


def test_a_speed_beyond_the_chassis_is_one_in_the_other_scale() -> None:
    """Row 'plausibility: stop, latched, and say which scale fits'; before engaging it is faulty feedback."""
    watch = watching(but(absurd=("Auto_DriveFeedBack",), speed_mps=None))
    assert watch.chassis_faults() == [Reason.FEEDBACK_FAULTY]
    assert watch.faults(0.0, 0, 0)[0] is Reason.IMPLAUSIBLE_SPEED
    assert watch.fault_detail(Reason.IMPLAUSIBLE_SPEED, 0) == (
        "Auto_DriveFeedBack reads beyond what the chassis can do; the fine scale may fit"
    )
    assert Reason.IMPLAUSIBLE_SPEED not in watching(but(absurd=("Auto_SteeringFeedBack",))).faults(0.0, 0, 0)


def test_a_reset_hit_is_a_new_one_once_the_bumper_was_clear() -> None:
    """Row 'bumper': each side for itself."""
    front = but(front_bumper=True)
    watch = watching(front)
    assert watch.hits == [Reason.FRONT_BUMPER]
    watch.acknowledge([Reason.FRONT_BUMPER])
    assert watch.hits == []
    assert watch.pressed == {Reason.FRONT_BUMPER}
    watch.observe(but(front, rear_bumper=True))
    assert watch.hits == [Reason.REAR_BUMPER]
    watch.observe(STANDING)
    watch.observe(front)
    assert watch.hits == [Reason.FRONT_BUMPER]


def test_a_reset_acknowledges_only_what_was_latched() -> None:
    """A bumper that is hit in the tick of the reset is not among it."""
    watch = watching(but(front_bumper=True, rear_bumper=True))
    watch.acknowledge([Reason.FRONT_BUMPER, Reason.REMOTE_STOP])
    assert watch.hits == [Reason.REAR_BUMPER]


def test_a_bumper_strikes_once() -> None:
    """In the tick in which it is pressed, and again once it was clear."""
    front = but(front_bumper=True)
    watch = watching(front)
    assert watch.struck == {Reason.FRONT_BUMPER}
    watch.observe(but(front, rear_bumper=True))
    assert watch.struck == {Reason.REAR_BUMPER}
    watch.observe(STANDING)
    assert watch.struck == set()
    watch.observe(front)
    assert watch.struck == {Reason.FRONT_BUMPER}


def test_a_bumper_that_was_not_seen_for_a_while_is_a_new_hit() -> None:
    """Not known is not pressed, and nobody has reset what comes next."""
    front = but(front_bumper=True)
    watch = watching(front)
    watch.acknowledge([Reason.FRONT_BUMPER])
    watch.observe(but(front_bumper=None))
    assert watch.pressed == set()
    watch.observe(front)
    assert watch.hits == [Reason.FRONT_BUMPER]


@pytest.mark.parametrize(("age_ms", "heard"), [(0, True), (99, True), (100, False), (None, False)])
def test_another_commander_is_heard_for_a_tenth_of_a_second(age_ms: int | None, heard: bool) -> None:  # noqa: FBT001
    """Row 'standing by: another computer may own it'."""
    watch = watching(but(commander_ns=None if age_ms is None else 500 * MS - age_ms * MS))
    assert watch.is_commanded_by_other(500 * MS) is heard
    assert (Reason.OTHER_COMMANDER in watch.faults(0.0, 0, 500 * MS)) is heard


@pytest.mark.parametrize(
    ("changes", "reasons"),
    [
        ({}, []),
        ({"missing": ("Auto_GearFeedBack",)}, [Reason.FEEDBACK_MISSING]),
        ({"faulty": ("Auto_GearFeedBack",)}, [Reason.FEEDBACK_FAULTY]),
        ({"variant": Variant.UNKNOWN}, [Reason.VARIANT_UNKNOWN]),
        ({"confirmed": False}, [Reason.VARIANT_UNKNOWN]),
    ],
)
def test_the_chassis_speaks_against_it(changes: dict[str, object], reasons: list[Reason]) -> None:
    """Rows 'feedback silence', 'checksum faults', 'engage: variant confirmed'."""
    watch = watching(but(**changes))
    assert watch.chassis_faults() == reasons
    assert watch.faults(0.0, 0, 0) == reasons


@pytest.mark.parametrize(("late_ns", "stops"), [(100 * MS, False), (100 * MS + 1, True)])
def test_a_late_loop_stops(late_ns: int, stops: bool) -> None:  # noqa: FBT001
    """Row 'loop late: over 100 ms: stop'."""
    assert watching(STANDING).faults(0.0, late_ns, 0) == ([Reason.LOOP_LATE] if stops else [])


@pytest.mark.parametrize(("failures", "stops"), [(4, False), (5, True)])
def test_frames_that_the_bus_does_not_take_stop(failures: int, stops: bool) -> None:  # noqa: FBT001
    """Five ticks in a row."""
    watch = watching(STANDING)
    watch.send_failures = failures
    assert watch.faults(0.0, 0, 0) == ([Reason.SEND_FAILED] if stops else [])


def test_speeds_that_do_not_fit_stop() -> None:
    """Row 'plausibility'."""
    watch = watching(MOVING)
    assert watch.faults(0.0, 0, 0) == []
    assert watch.faults(0.0, 0, 300 * MS) == [Reason.IMPLAUSIBLE_SPEED]


def test_found_moving_for_a_fifth_of_a_second() -> None:
    """Row 'found at start: in auto, moving, and nobody sending': 200 ms without a break."""
    watch = watching(MOVING)
    assert [watch.found_moving(at_ms * MS) for at_ms in (0, 199, 200)] == [False, False, True]
    for calm in (
        STANDING,
        but(MOVING, mode=Mode.STOP),
        but(MOVING, commander_ns=200 * MS),
        but(MOVING, turns=None),
    ):
        watch.observe(calm)
        assert not watch.found_moving(210 * MS)
        watch.observe(MOVING)
        assert not watch.found_moving(220 * MS)
        assert not watch.found_moving(419 * MS)
        assert watch.found_moving(420 * MS)
