"""From a target to what the chassis is told."""

from math import radians, tan

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.command.actuation import AT_REST, Actuation
from gateway.command.limits import Limits
from gateway.command.motion import Motion, Surroundings, Target
from schemas.decisions import Bound
from schemas.messages import GearPosition
from schemas.settings import CommandSettings

LIMITS = Limits.of(CommandSettings())
DRIVE, REVERSE, NEUTRAL, PARK = (
    GearPosition.DRIVE,
    GearPosition.REVERSE,
    GearPosition.NEUTRAL,
    GearPosition.PARK,
)
DT_S = 0.01


class Robot:
    """A motion with a chassis that follows at once.

    Attributes:
        gear: the gear feedback; None follows.
        stands: None follows.
    """

    def __init__(self, limits: Limits = LIMITS) -> None:
        self.motion = Motion(30.0)
        self.limits = limits
        self.told = AT_REST
        self.gear: GearPosition | None = None
        self.stands: bool | None = None
        self.parked = False
        self.forward = self.backward = True
        self.bounds: set[Bound] = set()

    def tick(self, speed_mps: float, angle_deg: float = 0.0, count: int = 1) -> Actuation:
        """Ticks with this target."""
        self.bounds = set()
        for _ in range(count):
            seen = Surroundings(
                stands=self.told.speed_mps == 0 if self.stands is None else self.stands,
                gear=self.gear or (PARK if self.parked else self.told.gear),
                parked=self.parked,
                forward=self.forward,
                backward=self.backward,
            )
            self.told = self.motion.tick(Target(speed_mps, angle_deg), self.limits, seen, DT_S)
            self.bounds |= set(self.motion.bounds)
        return self.told


def test_at_rest_it_is_in_neutral_and_braked() -> None:
    """With all enables."""
    assert Robot().tick(0.0) == Actuation(True, NEUTRAL, 0.0, 0.0, 30.0, parking=False)  # noqa: FBT003


@pytest.mark.parametrize(("sign", "gear"), [(1, DRIVE), (-1, REVERSE)])
def test_it_starts_with_the_gear(sign: int, gear: GearPosition) -> None:
    """First the gear without a speed; then, once the feedback reads it, 0.8 m/s2 up to the target."""
    robot = Robot()
    first = robot.tick(sign * 0.5)
    assert (first.gear, first.speed_mps, first.pedal_percent) == (gear, 0.0, 0.0)
    assert robot.bounds == {Bound.GEAR}
    robot.gear = NEUTRAL
    assert robot.tick(sign * 0.5, count=50).speed_mps == 0
    robot.gear = None
    told = [robot.tick(sign * 0.5).speed_mps for _ in range(63)]
    assert told == pytest.approx([min(0.5, 0.008 * tick) for tick in range(1, 64)])
    assert robot.told.signed_speed_mps == sign * 0.5
    assert robot.motion.bounds == []


def test_it_waits_for_neutral_before_any_gear() -> None:
    """The chassis reads park, or another gear, while it is changing."""
    robot = Robot()
    robot.gear = PARK
    assert robot.tick(1.0, count=9).gear is NEUTRAL
    assert robot.bounds == {Bound.GEAR}
    robot.gear = None
    assert robot.tick(1.0).gear is DRIVE


@pytest.mark.parametrize(
    ("asked_mps", "told_mps"), [(2.222, 2.222), (2.2221, 2.222), (1e308, 2.222), (-9.0, 2.222)]
)
def test_the_speed_limit(asked_mps: float, told_mps: float) -> None:
    """Row 'speed limit: 2.222 m/s': at the limit unchanged, beyond it bound."""
    robot = Robot()
    assert robot.tick(asked_mps, count=400).speed_mps == told_mps
    assert (Bound.SPEED in robot.motion.bounds) is (abs(asked_mps) > 2.222)


def test_the_lower_speed_limit() -> None:
    """Row 'speed limit: and the configured lower one'."""
    robot = Robot(LIMITS.lowered(0.5))
    assert robot.tick(2.0, count=400).speed_mps == 0.5


def test_acceleration_and_deceleration() -> None:
    """Row 'acceleration / normal deceleration: 0.8 / 1.2 m/s2', also between two speeds."""
    robot = Robot()
    robot.tick(1.0, count=200)
    assert robot.tick(2.0).speed_mps == pytest.approx(1.008)
    assert robot.bounds == {Bound.ACCELERATION}
    assert robot.tick(0.5).speed_mps == pytest.approx(0.996)
    assert robot.bounds == {Bound.DECELERATION}
    robot.tick(1.0, count=10)
    assert robot.tick(1.0079).speed_mps == 1.0079
    assert robot.bounds == set()


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
    robot = Robot()
    robot.tick(2.2, count=400)
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


@pytest.mark.parametrize(("sign", "before", "after"), [(1, DRIVE, REVERSE), (-1, REVERSE, DRIVE)])
def test_reversal_goes_through_standstill_and_neutral(
    sign: int, before: GearPosition, after: GearPosition
) -> None:
    """Row 'reversal: through standstill: measured speed under 0.05 m/s, neutral, then the other gear'."""
    robot = Robot()
    robot.tick(sign * 1.0, count=200)
    robot.stands = False
    told = robot.tick(-sign * 1.0, count=200)
    assert (told.speed_mps, told.gear) == (0.0, before)
    assert robot.bounds == {Bound.REVERSAL, Bound.DECELERATION}
    robot.stands = True
    assert robot.tick(-sign * 1.0).gear is NEUTRAL
    robot.gear = before
    assert robot.tick(-sign * 1.0, count=20).gear is NEUTRAL
    robot.gear = None
    assert robot.tick(-sign * 1.0).gear is after
    robot.stands = None
    assert robot.tick(-sign * 1.0, count=200).signed_speed_mps == -sign * 1.0


def test_a_gear_that_is_lost_takes_the_speed() -> None:
    """The feedback reads another gear than the one that is asked for."""
    robot = Robot()
    robot.tick(1.0, count=200)
    robot.gear = NEUTRAL
    assert robot.tick(1.0, count=100).speed_mps == 0
    assert Bound.GEAR in robot.bounds


def test_zero_speed_ends_in_neutral() -> None:
    """Once it stands; and braked."""
    robot = Robot()
    robot.tick(1.0, count=200)
    robot.stands = False
    told = robot.tick(0.0, count=200)
    assert (told.gear, told.speed_mps, told.pedal_percent) == (DRIVE, 0.0, 0.0)
    robot.stands = True
    assert robot.tick(0.0) == Actuation(True, NEUTRAL, 0.0, 0.0, 30.0, parking=False)  # noqa: FBT003
    assert robot.bounds == set()


def test_the_parking_brake_holds_it() -> None:
    """No speed against it, and it is told."""
    robot = Robot()
    robot.parked = True
    told = robot.tick(1.0, count=50)
    assert (told.speed_mps, told.gear, told.parking) == (0.0, NEUTRAL, True)
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


@given(targets=targets)
def test_every_step_is_within_every_limit(targets: list[tuple[float, float, int]]) -> None:
    """Whatever is asked in whatever order."""
    robot = Robot()
    before = robot.tick(0.0)
    for speed_mps, angle_deg, ticks in targets:
        for _ in range(ticks):
            told = robot.tick(speed_mps, angle_deg)
            change_mps = told.signed_speed_mps - before.signed_speed_mps
            away = abs(told.signed_speed_mps) > abs(before.signed_speed_mps)
            assert abs(change_mps) <= (0.8 if away else 1.2) * DT_S + 1e-12
            assert abs(told.angle_deg - before.angle_deg) <= 0.6 + 1e-9
            assert abs(told.angle_deg) <= 24
            assert told.speed_mps <= 2.222
            assert told.speed_mps**2 * abs(tan(radians(told.angle_deg))) / 0.66 <= 1.5 + 1e-9
            assert told.speed_mps == 0 or told.gear is not NEUTRAL
            assert told.gear is before.gear or (NEUTRAL in {told.gear, before.gear} and before.speed_mps == 0)
            before = told


@given(speed_mps=st.floats(-2.222, 2.222), share=st.floats(-0.999, 0.999))
def test_what_is_within_the_limits_is_reached_unchanged(speed_mps: float, share: float) -> None:
    """To the last bit, and nothing is told to have bound it."""
    angle_deg = share * LIMITS.angle_at(speed_mps)
    robot = Robot()
    told = robot.tick(speed_mps, angle_deg, count=450)
    assert (told.signed_speed_mps, told.angle_deg) == (speed_mps, angle_deg)
    assert robot.motion.bounds == []
