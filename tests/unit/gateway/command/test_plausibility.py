"""Rows 'plausibility', 'rolling', 'steering', 'measured speed over the limit', and a body frame that is frozen."""

from collections.abc import Callable

import msgspec
import pytest

from gateway.chassis.cruiser.tracker import Encoders
from gateway.chassis.port import AT_REST, Actuation, ChassisState
from gateway.choice import CHASSIS
from gateway.command.monitor import Plausibility, exceeds, fits, fitting_scale
from schemas.messages import GearPosition, WheelPulse
from schemas.reasons import Reason

MS = 1_000_000
LAG_S = 0.4
"""The lag of a slow chassis that still does what it is told."""


def told(speed_mps: float = 0.0, angle_deg: float = 0.0) -> Actuation:
    """A signed speed."""
    gear = GearPosition.REVERSE if speed_mps < 0 else GearPosition.DRIVE
    return Actuation(True, gear, abs(speed_mps), angle_deg, parking=False)  # noqa: FBT003


def seen(wheel_mps: float | None = 0.0, drive_mps: float | None = None, **changes: object) -> ChassisState:
    """A chassis whose drive feedback fits its wheels, but for what is given."""
    fastest_mps = None if wheel_mps is None else abs(wheel_mps)
    chassis = ChassisState(
        speed_mps=fastest_mps if drive_mps is None else drive_mps,
        wheel_speed_mps=wheel_mps,
        fastest_wheel_mps=fastest_mps,
        angle_deg=0.0,
    )
    return msgspec.structs.replace(chassis, **changes)


class Watched:
    """A robot that is told and seen something, tick by tick."""

    def __init__(self, start_mps: float = 0.0, angle_deg: float = 0.0) -> None:
        self.made = Plausibility(CHASSIS)
        self.made.forget(start_mps, angle_deg)
        self.now_ms = 0

    def run(
        self, chassis: ChassisState, actuation: Actuation = AT_REST, ms: int = 10, limit_mps: float = 2.222
    ) -> list[Reason]:
        """Ticks, the last of them so many milliseconds after the first; what is found in the last."""
        found: list[Reason] = []
        for _ in range(0, ms, 10):
            found = self.made.check(chassis, actuation, limit_mps, self.now_ms * MS)
            self.now_ms += 10
        return found

    def found_after_ms(self, reason: Reason, chassis: ChassisState, actuation: Actuation = AT_REST) -> int | None:
        """When this is found, counted from the first tick; None if it is not within 10 s."""
        begun_ms = self.now_ms
        for _ in range(1_000):
            if reason in self.run(chassis, actuation):
                return self.now_ms - begun_ms - 10
        return None

    def follow(
        self, way: Callable[[float], Actuation], seconds: float, limit_mps: float = 2.222, lag_s: float = LAG_S
    ) -> set[Reason]:
        """A chassis that follows what it is told with this lag; all that is found on the way."""
        found: set[Reason] = set()
        actual_mps = way(0.0).signed_speed_mps
        for tick in range(round(seconds * 100)):
            now = way(tick / 100)
            actual_mps += (now.signed_speed_mps - actual_mps) * 0.01 / lag_s
            found |= set(self.run(seen(actual_mps, angle_deg=now.angle_deg), now, limit_mps=limit_mps))
        return found


# Speeds.


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
    ("sign", "wheel_mps", "drive_mps", "told_mps", "words"),
    [
        (1, 1.0, 1.0, 0.5, "the wheels turn forward at 1.00 m/s, commanded is 0.50"),
        (-1, 1.0, 1.0, 0.5, "the wheels turn backward at 1.00 m/s, commanded is 0.50"),
        (1, -0.5, 0.5, 0.5, "the wheels turn backward at 0.50 m/s, commanded is 0.00"),
        (-1, -0.5, 0.5, 0.5, "the wheels turn forward at 0.50 m/s, commanded is 0.00"),
        (1, 0.0, 1.0, 1.0, "the wheels turn at 0.00 m/s, the drive feedback says 1.00"),
        (1, 1.0, 0.5, 1.0, "the wheels turn at 1.00 m/s, the drive feedback says 0.50"),
        (-1, 1.0, 0.5, 1.0, "the wheels turn at 1.00 m/s, the drive feedback says 0.50"),
        (1, 2.0, 2.0, 0.05, "the coarse scale of the drive frames would fit"),
    ],
)
def test_speeds_that_do_not_fit_are_found_after_300_ms(
    sign: int, wheel_mps: float, drive_mps: float, told_mps: float, words: str
) -> None:
    """Row 'plausibility: wheels against the command and drive feedback, for 300 ms: stop, and say which scale'."""
    watched = Watched()
    chassis = seen(sign * wheel_mps, drive_mps)
    assert watched.found_after_ms(Reason.IMPLAUSIBLE_SPEED, chassis, told(sign * told_mps)) == 300
    assert words in watched.made.details[Reason.IMPLAUSIBLE_SPEED]


def test_what_fits_in_between_begins_anew() -> None:
    """Row 'plausibility: for 300 ms': without a break."""
    watched = Watched()
    for at_ms in range(0, 2_000, 10):
        fits = at_ms % 300 == 290
        assert watched.run(seen(1.0) if fits else seen(0.5, 1.0), told(1.0)) == []


@pytest.mark.parametrize("chassis", [seen(None, 2.0), seen(2.0, speed_mps=None), seen(None, angle_deg=None)])
def test_what_is_not_known_does_not_misfit(chassis: ChassisState) -> None:
    """Missing feedback is a cause of its own."""
    assert Watched().found_after_ms(Reason.IMPLAUSIBLE_SPEED, chassis, told(2.0)) is None


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


# Rolling.

FORWARD, BACKWARD = told(0.5), told(-0.5)


@pytest.mark.parametrize(
    ("chassis", "actuation", "words"),
    [
        (seen(0.101, 0.0), AT_REST, "forward at 0.10 m/s by the wheels"),
        (seen(-0.101, 0.0), AT_REST, "backward at 0.10 m/s by the wheels"),
        (seen(None, 0.101), AT_REST, "at 0.10 m/s"),
        (seen(0.0, fastest_wheel_mps=0.11), AT_REST, "at 0.11 m/s"),
        (seen(0.0, pulses=1), AT_REST, "forward by the wheel pulses"),
        (seen(None, None, pulses=-1), AT_REST, "backward by the wheel pulses"),
        (seen(-0.101), FORWARD, "backward at 0.10 m/s by the wheels"),
        (seen(0.101), BACKWARD, "forward at 0.10 m/s by the wheels"),
        (seen(0.0, pulses=-1), FORWARD, "backward by the wheel pulses"),
        (seen(0.0, pulses=1), BACKWARD, "forward by the wheel pulses"),
    ],
)
def test_a_robot_that_rolls_is_found_after_100_ms(chassis: ChassisState, actuation: Actuation, words: str) -> None:
    """Row 'rolling: at zero command, or against the commanded direction, by wheels or pulses, for 100 ms'."""
    watched = Watched()
    assert watched.found_after_ms(Reason.ROLLING, chassis, actuation) == 100
    assert watched.made.details[Reason.ROLLING] == words


@pytest.mark.parametrize(
    ("chassis", "actuation"),
    [
        (seen(0.05), AT_REST),
        (seen(-0.05), AT_REST),
        (seen(-0.05), FORWARD),
        (seen(0.7), FORWARD),
        (seen(-0.7), BACKWARD),
        (seen(0.5, pulses=1), FORWARD),
        (seen(None, 0.5), FORWARD),
    ],
)
def test_what_stands_or_goes_as_it_is_told_does_not_roll(chassis: ChassisState, actuation: Actuation) -> None:
    """Row 'rolling: over the standstill bound'."""
    assert Watched().found_after_ms(Reason.ROLLING, chassis, actuation) is None


class Counted(Watched):
    """A robot of which nothing is seen but its wheel pulses, each 50 ms, so many in a metre of each wheel."""

    def __init__(self, pulses_per_m: float) -> None:
        super().__init__()
        self._pulses_per_m = pulses_per_m
        self._encoders = Encoders()
        self._frame: WheelPulse | None = None
        self.actual_mps = self._travelled_m = 0.0

    def drive(self, actuation: Actuation, seconds: float, *, obeys: bool = True) -> list[int]:
        """Follow what it is told with the lag, or go on as before. Returns when it is found to roll, in ms."""
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
            if Reason.ROLLING in self.run(seen(None, None, pulses=pulses), actuation):
                found_ms.append(self.now_ms - begun_ms)
        return found_ms


@pytest.mark.parametrize("pulses_per_m", [800, 2000])
@pytest.mark.parametrize("speed_mps", [0.02, 0.04, 0.1, 0.2])
def test_a_short_slow_drive_of_a_slow_chassis_does_not_roll(speed_mps: float, pulses_per_m: float) -> None:
    """Row 'rolling: beyond the ramp': as many pulses on the way down as on the way up are no steady motion.

    Nor are those of a robot that was told to creep, slower than what counts as standing.
    """
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


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("deceleration_mps2", [1.2, 2.0])
def test_a_slow_chassis_that_follows_its_ramp_does_not_roll(sign: int, deceleration_mps2: float) -> None:
    """Row 'rolling: beyond the ramp': with a lag of 0.4 s, from any speed; nothing else is found either."""
    for start_mps in (0.2, 1.0, 2.222):
        watched = Watched(sign * start_mps)

        def ramp(at_s: float, start_mps: float = start_mps) -> Actuation:
            return told(sign * max(0.0, start_mps - deceleration_mps2 * at_s))

        assert watched.follow(ramp, 6) == set()


def test_a_robot_that_does_not_follow_its_ramp_rolls() -> None:
    """Row 'rolling: beyond the ramp': the command is zero, and half a metre a second is left."""
    watched = Watched(0.5)
    after_ms = watched.found_after_ms(Reason.ROLLING, seen(0.5))
    assert after_ms is not None
    assert 100 < after_ms < 300


@pytest.mark.parametrize("speed_mps", [1.5, -1.5])
def test_a_robot_that_is_found_moving_has_its_speed(speed_mps: float) -> None:
    """It was not commanded by us: it lags behind from there."""
    assert Watched(speed_mps).run(seen(speed_mps), ms=100) == []
    assert Watched().found_after_ms(Reason.ROLLING, seen(speed_mps)) == 100


# The limit.


@pytest.mark.parametrize(
    ("limit_mps", "chassis", "is_over"),
    [
        (2.222, seen(2.53), True),
        (2.222, seen(2.51), False),
        (0.5, seen(0.8), True),
        (0.5, seen(0.79), False),
        (0.5, seen(-0.8), True),
        (0.5, seen(0.5, 0.8), True),
        (0.5, seen(0.8, 0.5), True),
    ],
)
def test_a_robot_that_is_faster_than_its_limit_is_found(
    limit_mps: float,
    chassis: ChassisState,
    is_over: bool,  # noqa: FBT001 - a case of the table
) -> None:
    """Row 'measured speed over the limit in force by 0.3 m/s for 300 ms', also under a lowered limit."""
    watched = Watched()
    assert chassis.wheel_speed_mps is not None
    actuation = told(limit_mps if chassis.wheel_speed_mps > 0 else -limit_mps)
    assert Reason.OVERSPEED not in watched.run(chassis, actuation, 300, limit_mps)
    assert (Reason.OVERSPEED in watched.run(chassis, actuation, 10, limit_mps)) is is_over


def test_a_limit_that_was_lowered_has_to_be_reached_first() -> None:
    """Row 'measured speed over the limit in force': not while the robot still slows down to it."""
    watched = Watched(2.0)
    assert watched.follow(lambda at_s: told(max(0.5, 2.0 - 1.2 * at_s)), 5, limit_mps=0.5) == set()


# Steering.


@pytest.mark.parametrize(("angle_deg", "is_off"), [(5.1, True), (-5.1, True), (4.9, False), (-4.9, False)])
def test_wheels_that_are_not_turned_as_they_were_told_are_found(angle_deg: float, is_off: bool) -> None:  # noqa: FBT001
    """Row 'steering: measured against commanded, over 5 deg for 300 ms'."""
    found_ms = Watched().found_after_ms(Reason.STEERING, seen(0.0, angle_deg=angle_deg))
    assert found_ms == (300 if is_off else None)


@pytest.mark.parametrize("sign", [1, -1])
def test_steering_that_turns_slowly_follows(sign: int) -> None:
    """Row 'steering: beyond the rate': at 30 deg/s to the other side and back, half the rate of the command."""
    watched = Watched(0.0, sign * -24.0)
    actual_deg = sign * -24.0
    for target_deg in (sign * 24.0, sign * -24.0, 0.0):
        for _ in range(200):
            actual_deg += max(-0.3, min(0.3, target_deg - actual_deg))
            assert watched.run(seen(0.0, angle_deg=actual_deg), told(0.0, target_deg)) == []


@pytest.mark.parametrize("rate_degps", [5, 20, 28, 30, 32, 40, 60])
def test_steering_that_lags_follows(rate_degps: float) -> None:
    """Row 'steering': with a lag of 0.2 s, at each rate that may be set, from one side to the other."""
    watched = Watched(0.0, 24.0)
    told_deg = actual_deg = 24.0
    for _ in range(1000):
        told_deg = max(-24.0, told_deg - rate_degps / 100)
        actual_deg += (told_deg - actual_deg) * 0.01 / 0.2
        assert watched.run(seen(0.0, angle_deg=actual_deg), told(0.0, told_deg)) == []


def test_steering_that_is_stuck_is_found() -> None:
    """Row 'steering': at full lock while straight on is told."""
    watched = Watched(0.0, 24.0)
    after_ms = watched.found_after_ms(Reason.STEERING, seen(0.0, angle_deg=24.0))
    assert after_ms is not None
    assert after_ms < 500
    assert watched.made.details[Reason.STEERING] == "off by 14.1 deg, at 24.0 deg"


# A body frame that is frozen.


def test_a_mileage_that_stands_still_while_the_robot_drives_is_found() -> None:
    """It counts whole metres: after three of them its frame is frozen, whatever its counter does."""
    watched = Watched(1.0)
    after_ms = watched.found_after_ms(Reason.FEEDBACK_FROZEN, seen(1.0, total_mileage_km=1.5), told(1.0))
    assert after_ms == pytest.approx(3_000, abs=20)
    assert watched.made.details[Reason.FEEDBACK_FROZEN] == "the mileage, for 3.0 m"


@pytest.mark.parametrize(
    "chassis",
    [
        seen(0.0, 1.0, total_mileage_km=1.5),
        seen(1.0, 0.0, total_mileage_km=1.5),
        seen(0.0, total_mileage_km=1.5),
        seen(1.0, total_mileage_km=None),
    ],
    ids=["drive alone", "wheels alone", "stands", "no mileage"],
)
def test_what_may_be_another_fault_is_no_frozen_mileage(chassis: ChassisState) -> None:
    """The lower of both speeds counts, and a mileage that is not known is missing, not frozen."""
    assert Watched(1.0).found_after_ms(Reason.FEEDBACK_FROZEN, chassis, told(1.0)) is None


def test_a_noisy_bit_of_a_standing_robot_is_no_way() -> None:
    """A frozen mileage is one of a robot that drives: 0.04 m/s is what a coarse chassis at rest may read."""
    watched = Watched()
    for _ in range(8):
        assert watched.found_after_ms(Reason.FEEDBACK_FROZEN, seen(0.04, total_mileage_km=1.5), told(0.0)) is None


def test_a_mileage_that_counts_or_is_cleared_is_not_frozen() -> None:
    """Metre by metre, and from zero again."""
    watched = Watched(1.0)
    for metre in (*range(1500, 1503), *range(6)):
        assert watched.run(seen(1.0, total_mileage_km=metre / 1000), told(1.0), 1_000) == []


@pytest.mark.parametrize("speed_mps", [0.06, -0.1])
def test_a_robot_that_creeps_is_found_after_a_second(speed_mps: float) -> None:
    """Row 'rolling: over the standstill bound': noise of a bit does not last so long."""
    assert Watched().found_after_ms(Reason.ROLLING, seen(speed_mps)) == 1_000


def test_noise_is_no_speed_that_a_robot_gathers() -> None:
    """Row 'commanded to move, seen to stand': one that is blocked, and whose coarse speeds flicker, is found."""
    robot = Watched()
    found = [Reason.NOT_MOVING in robot.run(seen(0.08 * (tick // 5 % 2)), told(0.5)) for tick in range(250)]
    assert True in found
