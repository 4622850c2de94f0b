"""The chassis over time: standstill, bumpers, other commanders, and whether its motion is plausible."""

from collections.abc import Callable
from itertools import product

import msgspec
import pytest

from gateway.chassis.cruiser.tracker import Encoders
from gateway.chassis.port import AT_REST, Actuation, ChassisState
from gateway.choice.chassis import CHASSIS
from gateway.command.monitor import ChassisMonitor, Plausibility, exceeds, fits, fitting_scale
from schemas.messages import GearPosition, Mode, WheelPulse
from schemas.reasons import Reason
from tests.support.rigs.arbiter import MS
from tests.support.rigs.arbiter import STANDING as IN_STOP
from tests.support.rigs.steps import seen as but

LIMIT_MPS = 2.222
STANDING = msgspec.structs.replace(IN_STOP, mode=Mode.AUTO, gear=GearPosition.NEUTRAL)
LAG_S = 0.4
"""Lag of a slow chassis that still follows its command."""


def told(speed_mps: float = 0.0, angle_deg: float = 0.0, *, parking: bool = False) -> Actuation:
    gear = GearPosition.REVERSE if speed_mps < 0 else GearPosition.DRIVE
    return Actuation(True, gear, abs(speed_mps), angle_deg, parking=parking)  # noqa: FBT003


def seeing(words: str = "") -> ChassisState:
    """A standing chassis with these changes."""
    return but(STANDING, tuple(words.split()))


def monitoring(*seen: str) -> ChassisMonitor:
    """A monitor that has seen these, one a tick, the last at time zero."""
    monitor = ChassisMonitor(CHASSIS)
    for number, words in enumerate(seen, 1 - len(seen)):
        monitor.update(seeing(words), number * 10 * MS)
    return monitor


def found(monitor: ChassisMonitor, at_ms: int = 0) -> list[Reason]:
    """The causes to stop a robot that is commanded to stand."""
    return monitor.faults(told(), LIMIT_MPS, 0, at_ms * MS, is_engaged=True)


@pytest.mark.parametrize(
    ("words", "is_slow"),
    [
        ("", True),
        ("speed_mps:0.0499 fastest_wheel_mps:0.0499", True),
        ("speed_mps:0.05", False),
        ("fastest_wheel_mps:0.05", False),
        ("pulses:1", False),
        ("speed_mps:null", False),
        ("fastest_wheel_mps:null", False),
    ],
)
def test_standstill_is_five_slow_ticks(words: str, is_slow: bool) -> None:  # noqa: FBT001
    """Row 'standstill: measured speed under 0.05 m/s': both speeds known, for 50 ms without a break."""
    assert monitoring(*[words] * 4).stands is False
    assert monitoring(*[words] * 5).stands is is_slow
    assert monitoring(*[words] * 4, "all:1 turns:true", *[words] * 4).stands is False


MOVING, RELEASED = "all:1 turns:true", "brake:released"


@pytest.mark.parametrize(
    ("driven", "stopped", "parked", "is_confirmed"),
    [
        (MOVING, "", "", True),
        (RELEASED, MOVING, RELEASED, True),
        (RELEASED, RELEASED, "", True),
        (RELEASED, RELEASED, RELEASED, False),
        ("", "", "", False),
        (MOVING, MOVING, MOVING, False),
    ],
    ids=["it moved", "it moved on", "its brake answered", "nothing answered", "frozen as parked", "it moves"],
)
def test_a_robot_that_was_told_a_speed_stands_once_its_feedback_has_answered(
    driven: str,
    stopped: str,
    parked: str,
    is_confirmed: bool,  # noqa: FBT001 - a case
) -> None:
    """Row '"the robot stands"': a speed that rose and fell, or a parking brake that turned applied when asked."""
    monitor = monitoring("")
    for words, actuation in ((driven, told(1)), (stopped, told()), (parked, told(parking=True))):
        for _ in range(5):
            monitor.update(seeing(words), 0, actuation)
    assert monitor.is_rest_confirmed is is_confirmed


def test_a_speed_beyond_the_chassis_is_one_in_the_other_scale() -> None:
    """Row 'plausibility: stop, latched, and say which scale fits'; before engaging it is faulty feedback."""
    monitor = monitoring("absurd:Auto_DriveFeedBack speed_mps:null")
    assert monitor.chassis_faults() == [Reason.FEEDBACK_FAULTY]
    assert found(monitor)[0] is Reason.IMPLAUSIBLE_SPEED
    assert monitor.fault_detail(Reason.IMPLAUSIBLE_SPEED, 0) == (
        "Auto_DriveFeedBack reads beyond what the chassis can do; the fine scale may fit"
    )
    assert Reason.IMPLAUSIBLE_SPEED not in found(monitoring("absurd:Auto_SteeringFeedBack"))


F, R = Reason.FRONT_BUMPER, Reason.REAR_BUMPER
FRONT, BOTH = "front_bumper:true", "front_bumper:true rear_bumper:true"
BUMPERS: dict[str, list[tuple[str, int, list[Reason], set[Reason], set[Reason]]]] = {
    # what is seen, until when; hits, pressed and struck then. What is hit at first was reset.
    "clear for 300 ms, each side for itself": [
        (BOTH, 10, [R], {F, R}, {R}),
        ("", 300, [R], {F, R}, set()),
        ("", 310, [], set(), set()),
        (FRONT, 320, [F], {F}, {F}),
    ],
    "contact bounce": [
        ("", 290, [], {F}, set()),
        (FRONT, 300, [], {F}, set()),
        ("", 590, [], {F}, set()),
        (FRONT, 600, [], {F}, set()),
    ],
    "not seen for a while": [("front_bumper:null", 300, [], set(), set()), (FRONT, 310, [F], {F}, {F})],
}


@pytest.mark.parametrize("steps", BUMPERS.values(), ids=BUMPERS)
def test_a_reset_hit_is_a_new_one_once_the_bumper_was_clear_for_300_ms(
    steps: list[tuple[str, int, list[Reason], set[Reason], set[Reason]]],
) -> None:
    """Row 'bumper: only motion away from the hit side until it reads clear for 300 ms'. Unknown is not pressed."""
    monitor = monitoring(FRONT)
    assert (monitor.hits, monitor.struck) == ([F], {F})
    monitor.acknowledge([F, Reason.REMOTE_STOP])
    assert monitor.hits == []
    at_ms = 0
    for words, until_ms, hits, pressed, struck in steps:
        while at_ms < until_ms:
            at_ms += 10
            monitor.update(seeing(words), at_ms * MS)
        assert (monitor.hits, monitor.pressed, monitor.struck) == (hits, pressed, struck)


def test_a_reset_acknowledges_only_what_was_latched() -> None:
    """Not a bumper that is hit in the tick of the reset."""
    monitor = monitoring(BOTH)
    monitor.acknowledge([F, Reason.REMOTE_STOP])
    assert monitor.hits == [R]


@pytest.mark.parametrize(("age_ms", "is_heard"), [(0, True), (99, True), (100, False), (None, False)])
def test_another_commander_is_heard_for_a_tenth_of_a_second(age_ms: int | None, is_heard: bool) -> None:  # noqa: FBT001
    """Row 'standing by: another computer may own it'."""
    monitor = monitoring(f"commander_ns:{'null' if age_ms is None else (500 - age_ms) * MS}")
    assert monitor.is_commanded_by_other(500 * MS) is is_heard
    assert (Reason.OTHER_COMMANDER in found(monitor, 500)) is is_heard


@pytest.mark.parametrize(("failures", "stops"), [(4, []), (5, [Reason.SEND_FAILED])])
def test_frames_that_the_bus_does_not_take_stop(failures: int, stops: list[Reason]) -> None:
    monitor = monitoring("")
    monitor.send_failures = failures
    assert found(monitor) == stops


def test_what_is_not_plausible_stops() -> None:
    """Rows 'rolling' and 'plausibility': it moves although commanded to stand."""
    monitor = monitoring(MOVING)
    assert found(monitor) == []
    assert found(monitor, 100) == [Reason.ROLLING]
    assert monitor.fault_detail(Reason.ROLLING, 0) == "forward at 1.00 m/s by the wheels"
    assert found(monitor, 300) == [Reason.IMPLAUSIBLE_SPEED, Reason.ROLLING]
    assert monitor.fault_detail(Reason.IMPLAUSIBLE_SPEED, 0).startswith("the wheels turn forward at 1.00 m/s")


@pytest.mark.parametrize(
    "moves",
    [
        "turns:true confirmed:false variant:unknown speed_mps:null fastest_wheel_mps:null",
        "speed_mps:0.06",
        "fastest_wheel_mps:0.06",
        "pulses:-1 speed_mps:null fastest_wheel_mps:null turns:null",
        "all:1 turns:true mode:undefined",
    ],
    ids=["raw", "drive", "wheels", "pulses", "no body frame"],
)
def test_found_moving_for_a_fifth_of_a_second(moves: str) -> None:
    """Row 'found at start: in auto, moving by drive, wheels or pulses, and nobody sending': without a break."""
    monitor = monitoring(moves)
    assert [monitor.found_moving(at_ms * MS) for at_ms in (0, 199, 200)] == [False, False, True]
    for calm in ("", f"{moves} mode:remote", f"{moves} commander_ns:{200 * MS}"):
        monitor.update(seeing(calm), 210 * MS)
        assert not monitor.found_moving(210 * MS)
        monitor.update(seeing(moves), 220 * MS)
        assert [monitor.found_moving(at_ms * MS) for at_ms in (220, 419, 420)] == [False, False, True]


# Plausible motion.


def seen(wheel_mps: float | None = 0.0, drive_mps: float | None = None, words: str = "") -> ChassisState:
    """A chassis whose drive feedback matches its wheels, unless given."""
    fastest_mps = None if wheel_mps is None else abs(wheel_mps)
    chassis = ChassisState(
        speed_mps=fastest_mps if drive_mps is None else drive_mps,
        wheel_speed_mps=wheel_mps,
        fastest_wheel_mps=fastest_mps,
        angle_deg=0.0,
    )
    return but(chassis, tuple(words.split()))


class Watched:
    """A robot with commands and feedback, tick by tick."""

    def __init__(self, start_mps: float = 0.0, angle_deg: float = 0.0) -> None:
        self.made = Plausibility(CHASSIS)
        self.made.forget(start_mps, angle_deg)
        self.now_ms = 0

    def run(
        self, chassis: ChassisState, actuation: Actuation = AT_REST, ms: int = 10, limit_mps: float = LIMIT_MPS
    ) -> list[Reason]:
        """Ticks for so many milliseconds; the findings of the last."""
        reasons: list[Reason] = []
        for _ in range(0, ms, 10):
            reasons = self.made.check(chassis, actuation, limit_mps, self.now_ms * MS)
            self.now_ms += 10
        return reasons

    def found_after_ms(
        self, reason: Reason, chassis: ChassisState, actuation: Actuation = AT_REST, limit_mps: float = LIMIT_MPS
    ) -> int | None:
        """When this is found, from the first tick on; None if not within 10 s."""
        begun_ms = self.now_ms
        for _ in range(1_000):
            if reason in self.run(chassis, actuation, limit_mps=limit_mps):
                return self.now_ms - begun_ms - 10
        return None

    def follow(
        self, way: Callable[[float], Actuation], seconds: float, limit_mps: float = LIMIT_MPS
    ) -> set[Reason]:
        """A chassis that follows its command with the lag; all findings on the way."""
        reasons: set[Reason] = set()
        actual_mps = way(0.0).signed_speed_mps
        for tick in range(round(seconds * 100)):
            now = way(tick / 100)
            actual_mps += (now.signed_speed_mps - actual_mps) * 0.01 / LAG_S
            chassis = seen(actual_mps, words=f"angle_deg:{now.angle_deg}")
            reasons |= set(self.run(chassis, now, limit_mps=limit_mps))
        return reasons


SPEED, ROLLING, OVERSPEED = Reason.IMPLAUSIBLE_SPEED, Reason.ROLLING, Reason.OVERSPEED
STEERING, FROZEN = Reason.STEERING, Reason.FEEDBACK_FROZEN
FORWARD, BACKWARD, FAR = told(0.5), told(-0.5), "total_mileage_km:1.5"


@pytest.mark.parametrize(
    ("reason", "after_ms", "chassis", "actuation", "words"),
    [
        # Wheels against command and drive feedback; which scale would fit. Missing feedback is its own cause.
        (SPEED, 300, seen(1.0, 1.0), FORWARD, "the wheels turn forward at 1.00 m/s, commanded 0.50 m/s"),
        (SPEED, 300, seen(-1.0, 1.0), BACKWARD, "the wheels turn backward at 1.00 m/s, commanded 0.50 m/s"),
        (SPEED, 300, seen(-0.5, 0.5), FORWARD, "the wheels turn backward at 0.50 m/s, commanded 0.00 m/s"),
        (SPEED, 300, seen(0.5, 0.5), BACKWARD, "the wheels turn forward at 0.50 m/s, commanded 0.00 m/s"),
        (SPEED, 300, seen(0.0, 1.0), told(1.0), "reads 1.00 m/s; the fine scale of the drive frames would fit"),
        (SPEED, 300, seen(1.0, 0.5), told(1.0), "the wheels turn at 1.00 m/s, drive feedback reads 0.50 m/s"),
        (SPEED, 300, seen(-1.0, 0.5), told(-1.0), "the wheels turn at 1.00 m/s, drive feedback reads 0.50 m/s"),
        (SPEED, 300, seen(2.0, 2.0), told(0.05), "; the coarse scale of the drive frames would fit"),
        (SPEED, None, seen(None, 2.0), told(2.0), ""),
        (SPEED, None, seen(2.0, words="speed_mps:null"), told(2.0), ""),
        (SPEED, None, seen(None, words="angle_deg:null"), told(2.0), ""),
        # At zero command, or against the commanded direction, by wheels or pulses; slower it takes a second.
        (ROLLING, 100, seen(0.101, 0.0), AT_REST, "forward at 0.10 m/s by the wheels"),
        (ROLLING, 100, seen(-0.101, 0.0), AT_REST, "backward at 0.10 m/s by the wheels"),
        (ROLLING, 100, seen(None, 0.101), AT_REST, "at 0.10 m/s"),
        (ROLLING, 100, seen(0.0, words="fastest_wheel_mps:0.11"), AT_REST, "at 0.11 m/s"),
        (ROLLING, 100, seen(0.0, words="pulses:1"), AT_REST, "forward by the wheel pulses"),
        (ROLLING, 100, seen(None, None, "pulses:-1"), AT_REST, "backward by the wheel pulses"),
        (ROLLING, 100, seen(-0.101), FORWARD, "backward at 0.10 m/s by the wheels"),
        (ROLLING, 100, seen(0.101), BACKWARD, "forward at 0.10 m/s by the wheels"),
        (ROLLING, 100, seen(0.0, words="pulses:-1"), FORWARD, "backward by the wheel pulses"),
        (ROLLING, 100, seen(0.0, words="pulses:1"), BACKWARD, "forward by the wheel pulses"),
        (ROLLING, 1000, seen(0.06), AT_REST, "forward at 0.06 m/s by the wheels"),
        (ROLLING, 1000, seen(-0.1), AT_REST, "backward at 0.10 m/s by the wheels"),
        # It stands, or follows its command.
        (ROLLING, None, seen(0.05), AT_REST, ""),
        (ROLLING, None, seen(-0.05), AT_REST, ""),
        (ROLLING, None, seen(-0.05), FORWARD, ""),
        (ROLLING, None, seen(0.7), FORWARD, ""),
        (ROLLING, None, seen(-0.7), BACKWARD, ""),
        (ROLLING, None, seen(0.5, words="pulses:1"), FORWARD, ""),
        (ROLLING, None, seen(None, 0.5), FORWARD, ""),
        # Over the limit by 0.3 m/s, also over a lowered one of 0.5 m/s.
        (OVERSPEED, 300, seen(2.53), told(2.222), "2.53 m/s, the limit is 2.22 m/s"),
        (OVERSPEED, None, seen(2.51), told(2.222), ""),
        (OVERSPEED, 300, seen(0.8), FORWARD, "0.80 m/s, the limit is 0.50 m/s"),
        (OVERSPEED, None, seen(0.79), FORWARD, ""),
        (OVERSPEED, 300, seen(-0.8), BACKWARD, "0.80 m/s, the limit is 0.50 m/s"),
        (OVERSPEED, 300, seen(0.5, 0.8), FORWARD, "0.80 m/s, the limit is 0.50 m/s"),
        (OVERSPEED, 300, seen(0.8, 0.5), FORWARD, "0.80 m/s, the limit is 0.50 m/s"),
        # Over 5 deg.
        (STEERING, 300, seen(0.0, words="angle_deg:5.1"), AT_REST, "off by 5.1 deg, at 5.1 deg"),
        (STEERING, 300, seen(0.0, words="angle_deg:-5.1"), AT_REST, "off by 5.1 deg, at -5.1 deg"),
        (STEERING, None, seen(0.0, words="angle_deg:4.9"), AT_REST, ""),
        (STEERING, None, seen(0.0, words="angle_deg:-4.9"), AT_REST, ""),
    ],
)
def test_motion_that_is_not_plausible_is_found_in_time(
    reason: Reason, after_ms: int | None, chassis: ChassisState, actuation: Actuation, words: str
) -> None:
    """Rows 'plausibility', 'rolling', 'measured speed over the limit in force' and 'steering'."""
    watched = Watched()
    limit_mps = 0.5 if reason is OVERSPEED and actuation.speed_mps == 0.5 else LIMIT_MPS
    assert watched.found_after_ms(reason, chassis, actuation, limit_mps) == after_ms
    assert watched.made.details.get(reason, "").endswith(words)
    assert bool(words) is (after_ms is not None)


def test_steering_that_is_stuck_is_found() -> None:
    """Row 'steering': at full lock with a command straight ahead, after a lag."""
    watched = Watched(0.0, 24.0)
    after_ms = watched.found_after_ms(STEERING, seen(0.0, words="angle_deg:24"))
    assert after_ms is not None
    assert after_ms < 500
    assert watched.made.details[STEERING] == "off by 14.1 deg, at 24.0 deg"


@pytest.mark.parametrize(
    ("chassis", "actuation", "is_found"),
    [
        (seen(1.0, words=FAR), told(1.0), True),
        # The lower of both speeds counts, a noisy bit is no way, and what is not known is missing, not frozen.
        (seen(0.0, 1.0, FAR), told(1.0), False),
        (seen(1.0, 0.0, FAR), told(1.0), False),
        (seen(0.0, words=FAR), told(1.0), False),
        (seen(0.04, words=FAR), told(0.0), False),
        (seen(1.0, words="total_mileage_km:null"), told(1.0), False),
    ],
)
def test_a_mileage_that_stands_still_while_the_robot_drives_is_found(
    chassis: ChassisState,
    actuation: Actuation,
    is_found: bool,  # noqa: FBT001 - a case
) -> None:
    """It counts whole metres: unchanged for three of them its frame is frozen, whatever its counter does."""
    watched = Watched(1.0)
    after_ms = [watched.found_after_ms(FROZEN, chassis, actuation) for _ in range(1 if is_found else 8)]
    assert after_ms == ([pytest.approx(3_000, abs=20)] if is_found else [None] * 8)
    assert watched.made.details.get(FROZEN, "") == ("mileage unchanged over 3.0 m" if is_found else "")


def test_a_mileage_that_counts_or_is_cleared_is_not_frozen() -> None:
    watched = Watched(1.0)
    for metre in (*range(1500, 1503), *range(6)):
        chassis = seen(1.0, words=f"total_mileage_km:{metre / 1000}")
        assert watched.run(chassis, told(1.0), 1_000) == []


@pytest.mark.parametrize(
    ("larger", "smaller", "over"),
    [
        (0.3, 0.0, False),
        (0.301, 0.0, True),
        (1.5, 1.0, False),
        (1.51, 1.0, True),
        (0.8, 0.5, False),
        (0.7, 0.3, True),
    ],
)
def test_over_by_both_the_difference_and_the_factor(larger: float, smaller: float, over: bool) -> None:  # noqa: FBT001
    """Row 'plausibility: over by 0.3 m/s and 1.5 x': each boundary."""
    assert exceeds(larger, smaller) is over
    assert not exceeds(smaller, larger)
    assert fits(larger, smaller) is fits(smaller, larger) is not over


@pytest.mark.parametrize(
    ("drive_mps", "wheel_mps", "words"),
    [
        (0.025, 1.0, "; the coarse scale of the drive frames would fit"),
        (1.0, 0.025, "; the fine scale of the drive frames would fit"),
        (1.0, 0.0, "; the fine scale of the drive frames would fit"),
        (1.0, 1.0, ""),
        (0.3, 0.3, ""),
        (1.0, 3.0, ""),
        (0.0, 1.0, ""),
    ],
)
def test_which_scale_fits(drive_mps: float, wheel_mps: float, words: str) -> None:
    """Row 'plausibility: and say which scale fits'."""
    assert fitting_scale(drive_mps, wheel_mps, CHASSIS.scale_ratio) == words


def test_what_fits_in_between_begins_anew() -> None:
    """Row 'plausibility: for 300 ms': without a break."""
    watched = Watched()
    for at_ms in range(0, 2_000, 10):
        assert watched.run(seen(1.0) if at_ms % 300 == 290 else seen(0.5, 1.0), told(1.0)) == []


@pytest.mark.parametrize(
    ("sign", "deceleration_mps2", "start_mps"), [*product((1, -1), (1.2, 2.0), (0.2, 1.0, 2.222))]
)
def test_a_slow_chassis_that_follows_its_ramp_does_not_roll(
    sign: int, deceleration_mps2: float, start_mps: float
) -> None:
    """Row 'rolling: beyond the ramp': with a lag of 0.4 s, from any speed, also down to a lowered limit."""
    for least_mps, limit_mps in ((0.0, LIMIT_MPS), (0.1, 0.1)):
        watched = Watched(sign * start_mps)

        def ramp(at_s: float, least_mps: float = least_mps) -> Actuation:
            return told(sign * max(least_mps, start_mps - deceleration_mps2 * at_s))

        assert watched.follow(ramp, 6, limit_mps) == set()


@pytest.mark.parametrize("speed_mps", [1.5, -1.5])
def test_a_robot_that_does_not_follow_its_ramp_rolls(speed_mps: float) -> None:
    watched = Watched(speed_mps)
    assert watched.run(seen(speed_mps), ms=100) == []
    assert watched.found_after_ms(ROLLING, seen(speed_mps)) in range(10, 250)


@pytest.mark.parametrize("sign", [1, -1])
def test_steering_that_turns_slowly_follows(sign: int) -> None:
    """Row 'steering: beyond the rate': at 30 deg/s to the other side and back, half the rate of the command."""
    watched = Watched(0.0, sign * -24.0)
    actual_deg = sign * -24.0
    for target_deg in (sign * 24.0, sign * -24.0, 0.0):
        for _ in range(200):
            actual_deg += max(-0.3, min(0.3, target_deg - actual_deg))
            assert watched.run(seen(0.0, words=f"angle_deg:{actual_deg}"), told(0.0, target_deg)) == []


@pytest.mark.parametrize("rate_degps", [5, 20, 28, 30, 32, 40, 60])
def test_steering_that_lags_follows(rate_degps: float) -> None:
    """Row 'steering': with a lag of 0.2 s, at each rate that may be set, from one side to the other."""
    watched = Watched(0.0, 24.0)
    told_deg = actual_deg = 24.0
    for _ in range(1000):
        told_deg = max(-24.0, told_deg - rate_degps / 100)
        actual_deg += (told_deg - actual_deg) * 0.01 / 0.2
        assert watched.run(seen(0.0, words=f"angle_deg:{actual_deg}"), told(0.0, told_deg)) == []


def test_noise_is_no_speed_that_a_robot_gathers() -> None:
    """Row 'commanded to move, seen to stand': also with flickering coarse speeds."""
    robot = Watched()
    reasons = [Reason.NOT_MOVING in robot.run(seen(0.08 * (tick // 5 % 2)), told(0.5)) for tick in range(250)]
    assert True in reasons


class Counted(Watched):
    """A robot that shows only its wheel pulses, every 50 ms."""

    def __init__(self, pulses_per_m: float) -> None:
        super().__init__()
        self._pulses_per_m = pulses_per_m
        self._encoders = Encoders()
        self._frame: WheelPulse | None = None
        self.actual_mps = self._travelled_m = 0.0

    def drive(self, actuation: Actuation, seconds: float, *, obeys: bool = True) -> list[int]:
        """Follow the command with the lag, or go on as before. Returns when it is found to roll, in ms."""
        found_ms: list[int] = []
        begun_ms = self.now_ms
        for _ in range(round(seconds * 100)):
            if obeys:
                self.actual_mps += (actuation.signed_speed_mps - self.actual_mps) * 0.01 / LAG_S
            self._travelled_m += self.actual_mps * 0.01
            if self.now_ms % 50 == 0:
                counted = int(self._travelled_m * self._pulses_per_m)
                self._frame = WheelPulse(
                    time_ns=self.now_ms * MS,
                    sequence=0,
                    alive_counter=self.now_ms // 50 % 16,
                    valid=True,
                    rear_left_pulses=counted,
                    rear_right_pulses=counted,
                )
            pulses = self._encoders.direction(self._frame)
            if ROLLING in self.run(seen(None, None, f"pulses:{pulses}"), actuation):
                found_ms.append(self.now_ms - begun_ms)
        return found_ms


@pytest.mark.parametrize("pulses_per_m", [800, 2000])
@pytest.mark.parametrize("speed_mps", [0.02, 0.04, 0.1, 0.2])
def test_a_short_slow_drive_of_a_slow_chassis_does_not_roll(speed_mps: float, pulses_per_m: float) -> None:
    """Row 'rolling: beyond the ramp': neither the pulses of a ramp nor those of creeping are steady motion."""
    for tenths in range(3, 21):
        watched = Counted(pulses_per_m)
        assert watched.drive(told(speed_mps), tenths / 10) == []
        assert watched.drive(AT_REST, 3) == [], f"driven for {tenths / 10} s"


def test_a_robot_that_goes_on_at_zero_command_is_found_by_its_pulses() -> None:
    """Row 'rolling: moving by wheels or pulses, whichever shows': within a second of the command."""
    watched = Counted(800)
    watched.drive(told(0.1), 2)
    found_ms = watched.drive(AT_REST, 2, obeys=False)
    assert found_ms, "not found"
    assert found_ms[0] < 1_000
