"""From a target to what the chassis is told."""

from math import radians, tan

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.chassis.port import AT_REST, Actuation
from gateway.choice import CHASSIS
from gateway.command.motion import MotionConstraints, MotionLimits, MotionProfile, Target
from schemas.decisions import Bound
from schemas.messages import GearPosition, ParkingStatus
from schemas.settings import CommandSettings

LIMITS = MotionLimits.of(CommandSettings(speed_limit_mps=2.222))
DRIVE, REVERSE, NEUTRAL, PARK = (
    GearPosition.DRIVE,
    GearPosition.REVERSE,
    GearPosition.NEUTRAL,
    GearPosition.PARK,
)
APPLIED, RELEASED = ParkingStatus.APPLIED, ParkingStatus.RELEASED
DT_S = 0.01
GO_TICKS = 30
"""More than it takes to shift and to release the brake, where the chassis follows at once."""


class Robot:
    """A motion with a chassis that follows at once, unless something is set otherwise.

    Attributes:
        gear, brake, stands: the feedback; None follows.
        speed_mps, angle_deg: as measured; None follows.
    """

    def __init__(self, limits: MotionLimits = LIMITS) -> None:
        self.motion = MotionProfile()
        self.limits = limits
        self.told = AT_REST
        self.gear: GearPosition | None = None
        self.brake: ParkingStatus | None = None
        self.stands: bool | None = None
        self.speed_mps: float | None = None
        self.angle_deg: float | None = None
        self.parked = False
        self.forward = self.backward = True
        self.bounds: set[Bound] = set()

    def tick(self, speed_mps: float, angle_deg: float = 0.0, count: int = 1) -> Actuation:
        self.bounds = set()
        for _ in range(count):
            told = self.told
            seen = MotionConstraints(
                wheelbase_m=CHASSIS.wheelbase_m,
                stands=told.speed_mps == 0 if self.stands is None else self.stands,
                gear=self.gear or (PARK if told.parking else told.gear),
                brake=self.brake or (APPLIED if told.parking else RELEASED),
                parked=self.parked,
                speed_mps=told.speed_mps if self.speed_mps is None else self.speed_mps,
                angle_deg=told.angle_deg if self.angle_deg is None else self.angle_deg,
                forward=self.forward,
                backward=self.backward,
            )
            self.told = self.motion.tick(Target(speed_mps, angle_deg), self.limits, seen, DT_S)
            self.bounds |= set(self.motion.bounds)
        return self.told


def going(speed_mps: float = 1.0, limits: MotionLimits = LIMITS) -> Robot:
    """A robot that drives at this speed."""
    robot = Robot(limits)
    assert robot.tick(speed_mps, count=GO_TICKS + 300).signed_speed_mps == speed_mps
    return robot


# Setting off.


def test_before_any_speed_is_asked_for_it_is_parked() -> None:
    """Row 'slopes: never stands in neutral unbraked': with all enables, for as long as nobody drives it."""
    assert Robot().tick(0.0, count=500) == Actuation(True, NEUTRAL, 0.0, 0.0, parking=True)  # noqa: FBT003


@pytest.mark.parametrize(("sign", "gear"), [(1, DRIVE), (-1, REVERSE)])
def test_it_sets_off_by_gear_brake_and_ramp(sign: int, gear: GearPosition) -> None:
    """Row 'reversal: brake confirmed, the other gear, brake released'; then 0.8 m/s2 up to the target."""
    robot = Robot()
    first = robot.tick(sign * 0.5)
    assert (first.gear, first.parking, first.speed_mps) == (gear, True, 0.0)
    assert robot.bounds == {Bound.GEAR}
    while robot.told.parking:
        assert robot.tick(sign * 0.5).gear is gear
        assert robot.told.speed_mps == 0
    assert robot.motion.bounds == [Bound.PARKING]
    told = [robot.tick(sign * 0.5).speed_mps for _ in range(63)]
    assert told == pytest.approx([min(0.5, 0.008 * tick) for tick in range(1, 64)])
    assert robot.told.signed_speed_mps == sign * 0.5
    assert robot.motion.bounds == []


@pytest.mark.parametrize("brake", [APPLIED, ParkingStatus.UNDEFINED])
def test_a_hill_start_waits_for_the_feedback_of_the_brake(brake: ParkingStatus) -> None:
    """Row 'standing: a drive command releases it, waits until the feedback says so, then ramps'."""
    robot = going()
    robot.tick(0.0, count=300)
    assert robot.told.parking
    robot.brake = brake
    told = robot.tick(0.5, count=100)
    assert (told.parking, told.speed_mps, told.gear) == (False, 0.0, DRIVE)
    assert robot.motion.bounds == [Bound.PARKING]
    robot.brake = RELEASED
    assert robot.tick(0.5).speed_mps == pytest.approx(0.008)


@pytest.mark.parametrize("brake", [RELEASED, ParkingStatus.UNDEFINED])
def test_without_an_applied_brake_there_is_no_gear(brake: ParkingStatus) -> None:
    """Row 'reversal: parking brake applied and confirmed': neither the first gear nor another one."""
    robot = Robot()
    robot.brake = brake
    told = robot.tick(1.0, count=100)
    assert (told.gear, told.parking, robot.bounds) == (NEUTRAL, True, {Bound.GEAR})
    robot = going()
    robot.brake = brake
    told = robot.tick(-1.0, count=200)
    assert (told.gear, told.parking, told.speed_mps) == (DRIVE, True, 0.0)


def test_a_gear_that_is_not_in_gets_no_speed() -> None:
    """Row 'reversal: the other gear, confirmed': neither at first nor where it is lost at speed."""
    robot = Robot()
    robot.gear = NEUTRAL
    assert robot.tick(1.0, count=200).speed_mps == 0
    robot = going()
    robot.gear = NEUTRAL
    assert robot.tick(1.0, count=100).speed_mps == 0
    assert Bound.GEAR in robot.bounds
    assert robot.told.gear is DRIVE


def test_a_brake_that_does_not_read_released_at_speed_takes_the_speed() -> None:
    """By the normal deceleration, and in gear."""
    robot = going()
    robot.brake = APPLIED
    assert robot.tick(1.0).speed_mps == pytest.approx(0.988)
    assert (robot.tick(1.0, count=100).speed_mps, robot.told.gear) == (0.0, DRIVE)


# MotionLimits.


@pytest.mark.parametrize(
    ("asked_mps", "told_mps"), [(2.222, 2.222), (2.2221, 2.222), (1e308, 2.222), (-9.0, 2.222)]
)
def test_the_speed_limit(asked_mps: float, told_mps: float) -> None:
    """Row 'speed limit', the chassis's highest, 2.222 m/s: at the limit unchanged, beyond it bound."""
    robot = Robot()
    assert robot.tick(asked_mps, count=400).speed_mps == told_mps
    assert (Bound.SPEED in robot.motion.bounds) is (abs(asked_mps) > 2.222)


def test_the_lower_speed_limit() -> None:
    """Row 'speed limit: and the configured lower one'."""
    robot = Robot(LIMITS.lowered(0.5))
    assert robot.tick(2.0, count=400).speed_mps == 0.5


def test_acceleration_and_deceleration() -> None:
    """Row 'acceleration / normal deceleration: 0.8 / 1.2 m/s2', also between two speeds."""
    robot = going()
    assert robot.tick(2.0).speed_mps == pytest.approx(1.008)
    assert robot.bounds == {Bound.ACCELERATION}
    assert robot.tick(0.5).speed_mps == pytest.approx(0.996)
    assert robot.bounds == {Bound.DECELERATION}
    robot.tick(1.0, count=10)
    assert robot.tick(1.0079).speed_mps == 1.0079
    assert robot.bounds == set()


@pytest.mark.parametrize(("seen_mps", "told_mps"), [(0.0, 1.0), (0.6, 1.1), (1.2, 1.5)])
def test_a_robot_that_does_not_follow_is_told_no_more_and_no_less(seen_mps: float, told_mps: float) -> None:
    """Row 'the ramp': it rises to the greatest seen speed and 0.5 m/s; above that it is held, and never cut."""
    robot = going(1.0)
    robot.speed_mps = seen_mps
    assert robot.tick(1.5, count=100).speed_mps == pytest.approx(told_mps)
    assert (Bound.FOLLOWING in robot.motion.bounds) is (told_mps < 1.5)


@pytest.mark.parametrize(("asked_deg", "told_deg"), [(24.0, 24.0), (24.1, 24.0), (-1e308, -24.0)])
def test_the_steering_limit(asked_deg: float, told_deg: float) -> None:
    """Row 'steering limit: 24 deg'."""
    robot = Robot()
    assert robot.tick(0.0, asked_deg, count=100).angle_deg == told_deg
    assert (Bound.STEERING in robot.motion.bounds) is (abs(asked_deg) > 24)


def test_the_steering_rate() -> None:
    """Row 'steering rate: 60 deg/s': 0.6 deg in a tick, to either side; a step of just that is not bound."""
    robot = Robot()
    assert robot.tick(0.0, 10.0).angle_deg == pytest.approx(0.6)
    assert robot.bounds == {Bound.STEERING_RATE}
    assert robot.tick(0.0, -10.0).angle_deg == pytest.approx(0.0)
    assert robot.tick(0.0, 0.6).angle_deg == 0.6
    assert robot.bounds == set()


def test_in_a_bend_the_speed_is_reduced_and_not_the_steering() -> None:
    """Row 'lateral acceleration: 1.5 m/s2: speed is reduced, not steering'."""
    robot = Robot()
    told = robot.tick(2.0, 24.0, count=500)
    assert told.angle_deg == 24.0
    assert told.speed_mps == pytest.approx(1.491, abs=0.001)
    assert Bound.LATERAL_ACCELERATION in robot.motion.bounds


def test_steering_waits_for_the_speed() -> None:
    """Turned at speed: never beyond the lateral limit on the way, and there in the end."""
    robot = going(2.2)
    for _ in range(200):
        told = robot.tick(2.2, 24.0)
        assert told.speed_mps**2 * tan(radians(told.angle_deg)) / 0.66 <= 1.5 + 1e-9
    assert robot.told.angle_deg == 24.0
    robot.tick(2.2, 0.0, count=400)
    assert robot.tick(1.0, 24.0, count=30).speed_mps > 1.4
    assert Bound.LATERAL_ACCELERATION in robot.motion.bounds
    robot.tick(1.4, 24.0, count=100)
    # And turned back: the speed waits for the wheels.
    assert robot.tick(2.2, 0.0).speed_mps < 1.5


def test_wheels_that_are_turned_further_than_they_were_told_bound_the_speed() -> None:
    """Row 'steering: limits use the greater of commanded and measured angle'."""
    robot = going(2.2)
    robot.angle_deg = -24.0
    assert robot.tick(2.2, 0.0, count=100).speed_mps == pytest.approx(1.491, abs=0.001)
    assert Bound.LATERAL_ACCELERATION in robot.motion.bounds


def test_a_robot_that_is_faster_than_it_was_told_is_not_turned_further() -> None:
    """Row 'steering: limits use the greater of commanded and measured speed'."""
    robot = going(1.0)
    robot.speed_mps = 2.2
    told = robot.tick(1.0, 24.0, count=100)
    assert told.angle_deg == pytest.approx(LIMITS.angle_at(2.2, CHASSIS.wheelbase_m))
    assert Bound.LATERAL_ACCELERATION in robot.motion.bounds
    robot.speed_mps = None
    assert robot.tick(1.0, 24.0, count=100).angle_deg == 24.0


# Standing and reversing.


def test_standing_at_zero_command_it_stays_in_gear_and_is_held_after_a_second() -> None:
    """Row 'standing: in gear at zero speed; after 1 s of standing the parking brake is applied by itself'."""
    robot = going()
    robot.stands = False
    told = robot.tick(0.0, count=300)
    assert (told.gear, told.speed_mps, told.parking) == (DRIVE, 0.0, False)
    robot.stands = True
    told = robot.tick(0.0, count=100)
    assert (told.gear, told.speed_mps, told.parking) == (DRIVE, 0.0, False)
    told = robot.tick(0.0)
    assert (told.gear, told.speed_mps, told.parking) == (DRIVE, 0.0, True)
    assert robot.bounds == set()


def test_the_second_of_standing_begins_anew_with_each_motion() -> None:
    """Row 'standing: after 1 s of standing'."""
    robot = going()
    robot.tick(0.0, count=84)
    for stands in (True, False, True):
        robot.stands = stands
        assert not robot.tick(0.0, count=99).parking


@pytest.mark.parametrize(("sign", "before", "after"), [(1, DRIVE, REVERSE), (-1, REVERSE, DRIVE)])
def test_reversal_goes_through_standstill_behind_the_parking_brake(
    sign: int, before: GearPosition, after: GearPosition
) -> None:
    """Row 'reversal: standstill, parking brake applied and confirmed, neutral, the other gear, released'."""
    robot = going(sign * 1.0)
    robot.stands = False
    told = robot.tick(-sign * 1.0, count=200)
    assert (told.speed_mps, told.gear, told.parking) == (0.0, before, False)
    assert robot.bounds == {Bound.REVERSAL, Bound.DECELERATION}
    robot.stands, robot.brake = True, RELEASED
    told = robot.tick(-sign * 1.0, count=50)
    assert (told.gear, told.parking) == (before, True)
    robot.brake = None
    steps = [(robot.tick(-sign * 1.0).gear, robot.told.parking) for _ in range(35)]
    assert list(dict.fromkeys(steps)) == [(before, True), (NEUTRAL, True), (after, True), (after, False)]
    counts = [steps.count((gear, True)) for gear in (before, NEUTRAL, after)]
    assert counts == [9, 10, 10], "each for 100 ms, the first from the tick on that confirms the brake"
    robot.stands = None
    assert robot.tick(-sign * 1.0, count=200).signed_speed_mps == -sign * 1.0


def test_a_reversal_that_is_given_up_midway_stays_parked() -> None:
    """Row 'slopes: never stands in neutral unbraked', whatever is asked next."""
    robot = going()
    while robot.told.gear is not NEUTRAL:
        robot.tick(-1.0)
    told = robot.tick(0.0, count=300)
    assert (told.gear, told.parking) == (NEUTRAL, True)
    assert robot.tick(1.0, count=GO_TICKS + 200).signed_speed_mps == 1.0


@pytest.mark.parametrize("stands", [True, False])
def test_the_parking_brake_is_told_at_once_when_it_is_asked_for(*, stands: bool) -> None:
    """Row 'rolling: park is accepted at any speed while the command is zero': in gear, and no speed against it."""
    robot = going()
    robot.parked, robot.stands = True, stands
    told = robot.tick(0.0)
    assert (told.speed_mps, told.gear, told.parking) == (0.0, DRIVE, True)
    told = robot.tick(1.0, count=50)
    assert (told.speed_mps, told.gear, told.parking) == (0.0, DRIVE, True)
    assert robot.bounds == {Bound.PARKING}


@pytest.mark.parametrize("toward", [1, -1])
def test_a_pressed_bumper_forbids_its_direction(toward: int) -> None:
    """Row 'bumper: only motion away from the hit side'."""
    robot = Robot()
    robot.forward, robot.backward = toward < 0, toward > 0
    assert robot.tick(toward * 1.0, count=200).speed_mps == 0
    assert robot.bounds == {Bound.BUMPER}
    assert robot.tick(-toward * 1.0, count=300).signed_speed_mps == -toward * 1.0
    assert Bound.BUMPER not in robot.bounds
    assert robot.tick(0.0, count=300).speed_mps == 0
    assert Bound.BUMPER not in robot.bounds


targets = st.lists(st.tuples(st.floats(-4, 4), st.floats(-40, 40), st.integers(1, 60)), min_size=1, max_size=8)
feedback = st.lists(
    st.tuples(st.none() | st.booleans(), st.none() | st.sampled_from(ParkingStatus)), min_size=1, max_size=8
)


@given(targets=targets, feedback=feedback)
def test_every_step_is_within_every_limit(
    targets: list[tuple[float, float, int]], feedback: list[tuple[bool | None, ParkingStatus | None]]
) -> None:
    """Whatever is asked in whatever order, and whatever standstill and brake read."""
    robot = Robot()
    before = robot.tick(0.0)
    for number, (speed_mps, angle_deg, ticks) in enumerate(targets):
        robot.stands, robot.brake = feedback[number % len(feedback)]
        for _ in range(ticks):
            told = robot.tick(speed_mps, angle_deg)
            change_mps = told.signed_speed_mps - before.signed_speed_mps
            away = abs(told.signed_speed_mps) > abs(before.signed_speed_mps)
            assert abs(change_mps) <= (0.8 if away else 1.2) * DT_S + 1e-12
            assert abs(told.angle_deg - before.angle_deg) <= 0.6 + 1e-9
            assert abs(told.angle_deg) <= 24
            assert told.speed_mps <= 2.222
            assert told.speed_mps**2 * abs(tan(radians(told.angle_deg))) / 0.66 <= 1.5 + 1e-9
            assert told.parking or told.gear is not NEUTRAL
            assert not (told.speed_mps and told.parking)
            if told.gear is not before.gear:
                assert NEUTRAL in {told.gear, before.gear}
                assert told.parking
                assert before.parking
            before = told


@given(speed_mps=st.floats(-2.222, 2.222), share=st.floats(-0.999, 0.999))
def test_what_is_within_the_limits_is_reached_unchanged(speed_mps: float, share: float) -> None:
    """To the last bit, and nothing is told to have bound it."""
    angle_deg = share * LIMITS.angle_at(speed_mps, CHASSIS.wheelbase_m)
    robot = Robot()
    told = robot.tick(speed_mps, angle_deg, count=450)
    assert (told.signed_speed_mps, told.angle_deg) == (speed_mps, angle_deg)
    assert robot.motion.bounds == []
