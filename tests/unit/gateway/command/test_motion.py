"""The limits in force, the bicycle model, and the way from a target to a command.

A row begins with "new" or "going M/S". "tick M/S [COUNT] [DEGREES]" asks for a speed; "set" sets what is seen.
"""

from itertools import product
from math import atan, degrees, radians, sqrt, tan
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.chassis.port import AT_REST
from gateway.choice.chassis import CHASSIS
from gateway.command.motion import MotionConstraints, MotionLimits, MotionProfile, Target, steering_angle_deg
from schemas.decisions import Bound
from schemas.messages import GearPosition, ParkingStatus
from schemas.requests import Drive
from schemas.settings import CommandSettings
from tests.support.rigs.steps import Acted, Doing, fields_of, near, rows

L_M = CHASSIS.wheelbase_m
LIMITS = MotionLimits.of(CommandSettings(speed_limit_mps=2.222))
DRIVE, REVERSE, NEUTRAL, PARK = (
    GearPosition.DRIVE,
    GearPosition.REVERSE,
    GearPosition.NEUTRAL,
    GearPosition.PARK,
)
LATERAL_MPS = sqrt(1.5 * 0.66 / tan(radians(24)))
"""At full lock: 1.491 m/s."""


class Robot(Acted):
    """A motion with a chassis that follows at once unless set; ``bounds`` are those of the last step."""

    def __init__(self, begin: str = "new", limits: MotionLimits = LIMITS) -> None:
        self.motion, self.limits, self.told = MotionProfile(), limits, AT_REST
        self.changes: dict[str, Any] = {}
        self.bounds: set[str] = set()
        if begin != "new":
            speed_mps = begin.removeprefix("going ")
            self.tick(speed_mps, "330")
            assert near(self.told.signed_speed_mps, speed_mps)

    def tick(self, speed_mps: str, count: str = "1", angle_deg: str = "0") -> None:
        self.bounds = set()
        for _ in range(int(count)):
            told = self.told
            seen = MotionConstraints(
                wheelbase_m=L_M,
                stands=told.speed_mps == 0,
                gear=PARK if told.parking else told.gear,
                brake=ParkingStatus.APPLIED if told.parking else ParkingStatus.RELEASED,
                parked=False,
                speed_mps=told.speed_mps,
                angle_deg=told.angle_deg,
                forward=True,
                backward=True,
            )
            seen = msgspec.structs.replace(seen, **self.changes)
            self.told = self.motion.tick(Target(float(speed_mps), float(angle_deg)), self.limits, seen, 0.01)
            self.bounds |= {bound.value for bound in self.motion.bounds}

    def until(self, speed_mps: str, *claim: str) -> None:
        while not self.holds(*claim):
            self.tick(speed_mps)

    def set(self, *words: str) -> None:
        self.changes |= fields_of(words)
        self.changes = {name: value for name, value in self.changes.items() if value is not None}

    def steps(self) -> Doing:
        return {"tick": self.tick, "until": self.until, "set": self.set}

    def claims(self) -> Doing:
        told = self.told
        return {
            "told": lambda mps: near(told.signed_speed_mps, mps),
            "angle": lambda deg: near(told.angle_deg, deg),
            "gear": lambda gear: told.gear.value == gear,
            "parking": lambda: told.parking,
            "enabled": lambda: told.enabled,
            "bounds": lambda *bounds: self.bounds == {*bounds},
            "bound": lambda bound: Bound(bound) in self.motion.bounds,
        }


def move(row: str) -> None:
    begin, _, steps = row.partition("; ")
    Robot(begin).play(steps)


SETS_OFF = {
    # Never in neutral unbraked: with all enables, until the first drive.
    "parked before any speed is asked for": "new; tick 0 500; = enabled, gear neutral, parking, told 0, angle 0",
    **{
        f"by gear, brake and ramp to {mps}": f"new; tick {mps}; = gear {gear}, parking, told 0, bounds gear; "
        f"until {mps} unparking; = gear {gear}, told 0, bounds parking; tick {mps}; = told {0.016 * mps}; tick "
        f"{mps} 61; = told {0.992 * mps}; tick {mps}; = told {mps}, bounds"
        for mps, gear in ((0.5, "drive"), (-0.5, "reverse"))
    },
    **{
        f"after a rest, the brake is {brake}": f"going 1; tick 0 300; = parking; set brake:{brake}; tick 0.5 100; "
        "= unparking, told 0, gear drive, bounds parking; set brake:released; tick 0.5; = told 0.008"
        for brake in ("applied", "undefined")
    },
}


@rows(SETS_OFF)
def test_it_sets_off_by_gear_brake_and_ramp(row: str) -> None:
    """Row 'standing: a drive command releases the brake, waits until the feedback says so, then ramps'."""
    move(row)


GEARS = {
    # Neither the first gear nor another one, and no speed in a gear that is not in.
    **{
        f"no gear while the brake is {brake}, {begin}": f"{begin}; set brake:{brake}; tick {asked} 200; = {then}"
        for brake, (begin, asked, then) in product(
            ("released", "undefined"),
            (("new", 1, "gear neutral, parking, bounds gear"), ("going 1", -1, "gear drive, parking, told 0")),
        )
    },
    "the gear is not in": "new; set gear:neutral; tick 1 200; = told 0",
    "the gear is lost at speed": "going 1; set gear:neutral; tick 1; = bound gear; tick 1 100; = told 0, gear "
    "drive",
    # By the normal deceleration, and in gear.
    "the brake reads applied at speed": "going 1; set brake:applied; tick 1; = told 0.988; tick 1 100; = told 0, "
    "gear drive",
    "a reversal that is given up midway": "going 1; until -1 gear neutral; tick 0 300; = gear neutral, parking; "
    "tick 1 230; = told 1",
    # After a second, which restarts with each motion; in gear at zero speed.
    "held after a second of standing": "going 1; set stands:false; tick 0 300; = gear drive, told 0, unparking; "
    "set stands:true; tick 0 100; = gear drive, told 0, unparking; tick 0; = gear drive, told 0, parking, bounds",
    "the second begins anew": "going 1; tick 0 84; "
    + "; ".join(f"set stands:{stands}; tick 0 99; = unparking" for stands in ("true", "false", "true")),
    # In gear, and no speed against it.
    **{
        f"parked, and it stands is {stands}": f"going 1; set parked:true stands:{stands}; tick 0; = told 0, gear "
        "drive, parking; tick 1 50; = told 0, gear drive, parking, bounds parking"
        for stands in ("true", "false")
    },
    # Only motion away from the hit side.
    **{
        f"{side} is hit": f"new; set {forbidden}:false; tick {toward} 200; = told 0, bounds bumper; tick "
        f"{-toward} 300; = told {-toward}, bounds gear parking acceleration; tick 0 300; = told 0, bounds "
        "deceleration"
        for side, forbidden, toward in (("front", "forward", 1), ("rear", "backward", -1))
    },
}


@rows(GEARS)
def test_without_an_applied_brake_there_is_no_gear(row: str) -> None:
    """Rows 'standing', 'reversal: parking brake applied and confirmed', 'park' and 'bumper'."""
    move(row)


@pytest.mark.parametrize(("sign", "before", "after"), [(1, DRIVE, REVERSE), (-1, REVERSE, DRIVE)])
def test_reversal_goes_through_standstill_behind_the_parking_brake(
    sign: int, before: GearPosition, after: GearPosition
) -> None:
    """Row 'reversal: standstill, parking brake applied and confirmed, neutral, the other gear, released'."""
    robot = Robot(f"going {sign}")
    robot.play(
        f"set stands:false; tick {-sign} 200; = told 0, gear {before.value}, unparking, bounds reversal "
        f"deceleration; set stands:true brake:released; tick {-sign} 50; = gear {before.value}, parking; set "
        "brake:null"
    )
    steps = []
    for _ in range(35):
        robot.tick(str(-sign))
        steps.append((robot.told.gear, robot.told.parking))
    assert list(dict.fromkeys(steps)) == [(before, True), (NEUTRAL, True), (after, True), (after, False)]
    counts = [steps.count((gear, True)) for gear in (before, NEUTRAL, after)]
    assert counts == [9, 10, 10], "each for 100 ms, the first from the tick on that confirms the brake"
    robot.play(f"set stands:null; tick {-sign} 200; = told {-sign}")


BOUND = {
    # At the limit unchanged, beyond it bound.
    **{
        f"{asked_mps} m/s": f"new; tick {asked_mps} 400; = told {told_mps}, {un}bound speed"
        for asked_mps, told_mps, un in (
            (2.222, 2.222, "un"),
            (2.2221, 2.222, ""),
            (1e308, 2.222, ""),
            (-9, -2.222, ""),
        )
    },
    "to other speeds": "going 1; tick 2; = told 1.008, bounds acceleration; tick 0.5; = told 0.996, bounds "
    "deceleration; tick 1 10; tick 1.0079; = told 1.0079, bounds",
    # It rises to the greatest seen speed and 0.5 m/s; above that it is held, and never cut.
    **{
        f"seen at {seen_mps} m/s": f"going 1; set speed_mps:{seen_mps}; tick 1.5 100; = told {told_mps}, "
        f"{un}bound following"
        for seen_mps, told_mps, un in ((0.0, 1.0, ""), (0.6, 1.1, ""), (1.2, 1.5, "un"))
    },
    **{
        f"{asked_deg} deg": f"new; tick 0 100 {asked_deg}; = angle {told_deg}, {un}bound steering"
        for asked_deg, told_deg, un in ((24.0, 24, "un"), (24.1, 24, ""), (-1e308, -24, ""))
    },
    # 60 deg/s is 0.6 deg in a tick, to either side; a step of just that is not bound.
    "the steering rate": "new; tick 0 1 10; = angle 0.6, bounds steering_rate; tick 0 1 -10; = angle 0; tick 0 1 "
    "0.6; = angle 0.6, bounds",
    # The speed is reduced, and not the steering.
    "in a bend": f"new; tick 2 500 24; = angle 24, told {LATERAL_MPS}, bound lateral_acceleration",
}
MEASURED = {
    "turned further": f"going 2.2; set angle_deg:-24; tick 2.2 100; = told {LATERAL_MPS}, bound "
    "lateral_acceleration",
    "faster": f"going 1; set speed_mps:2.2; tick 1 100 24; = angle {LIMITS.angle_at(2.2, L_M)}, bound "
    "lateral_acceleration; set speed_mps:null; tick 1 100 24; = angle 24",
}


@rows(BOUND)
def test_what_bounds_the_motion(row: str) -> None:
    """Rows 'speed limit', 'acceleration', 'the ramp', 'steering limit / rate', 'lateral acceleration'."""
    move(row)


@rows(MEASURED)
def test_limits_use_the_greater_of_commanded_and_measured(row: str) -> None:
    """Row 'steering': of the angle for the speed, and of the speed for the angle."""
    move(row)


def test_steering_waits_for_the_speed() -> None:
    """Never beyond the lateral limit on the way, and there in the end."""
    robot = Robot("going 2.2")
    for _ in range(200):
        robot.tick("2.2", "1", "24")
        assert robot.told.speed_mps**2 * tan(radians(robot.told.angle_deg)) / 0.66 <= 1.5 + 1e-9
    robot.play("= angle 24; tick 2.2 400; tick 1 30 24; = bound lateral_acceleration")
    assert robot.told.speed_mps > 1.4
    # And turned back: the speed waits for the wheels.
    robot.play("tick 1.4 100 24; tick 2.2")
    assert robot.told.speed_mps < 1.5


targets = st.lists(st.tuples(st.floats(-4, 4), st.floats(-40, 40), st.integers(1, 60)), min_size=1, max_size=8)
feedback = st.lists(
    st.tuples(st.none() | st.booleans(), st.none() | st.sampled_from(ParkingStatus)), min_size=1, max_size=8
)


@given(targets=targets, feedback=feedback)
def test_every_step_is_within_every_limit(
    targets: list[tuple[float, float, int]], feedback: list[tuple[bool | None, ParkingStatus | None]]
) -> None:
    robot = Robot()
    robot.tick("0")
    before = robot.told
    for number, (speed_mps, angle_deg, ticks) in enumerate(targets):
        seen = dict(zip(("stands", "brake"), feedback[number % len(feedback)], strict=True))
        robot.changes = {name: value for name, value in seen.items() if value is not None}
        for _ in range(ticks):
            robot.tick(str(speed_mps), "1", str(angle_deg))
            told = robot.told
            change_mps = told.signed_speed_mps - before.signed_speed_mps
            away = abs(told.signed_speed_mps) > abs(before.signed_speed_mps)
            assert abs(change_mps) <= (0.8 if away else 1.2) * 0.01 + 1e-12
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
    """To the last bit, and unbound. Both limits are the same rule at any speed."""
    limit_deg = LIMITS.angle_at(speed_mps, L_M)
    assert 0 < limit_deg <= 24
    assert abs(speed_mps) <= LIMITS.speed_at(limit_deg, L_M) * (1 + 1e-9)
    robot = Robot()
    robot.tick(repr(speed_mps), "450", repr(share * limit_deg))
    assert (robot.told.signed_speed_mps, robot.told.angle_deg) == (speed_mps, share * limit_deg)
    assert robot.motion.bounds == []


# The limits in force.


@pytest.mark.parametrize(
    ("settings", "limits"),
    [
        (CommandSettings(), MotionLimits(1.0, 0.8, 1.2, 2.0, 24.0, 60.0, 1.5)),
        # A more severe stop is never slower, with any settings.
        (
            CommandSettings(deceleration_mps2=1.5, emergency_deceleration_mps2=0.5),
            MotionLimits(1.0, 0.8, 1.5, 1.5, 24.0, 60.0, 1.5),
        ),
    ],
)
def test_the_start_values_are_those_of_the_table(settings: CommandSettings, limits: MotionLimits) -> None:
    """Rows 'speed limit', 'acceleration / normal / emergency deceleration', 'steering limit / rate', 'lateral'."""
    assert MotionLimits.of(settings) == limits


@pytest.mark.parametrize(
    ("asked_mps", "limit_mps"), [(None, 2.222), (3.0, 2.222), (2.222, 2.222), (1.0, 1.0), (0.0, 0.0), (-1.0, 0.0)]
)
def test_limits_scale_down_never_up(asked_mps: float | None, limit_mps: float) -> None:
    assert LIMITS.lowered(asked_mps).speed_mps == limit_mps


def test_the_lateral_limit() -> None:
    """Row 'lateral acceleration v^2 tan(angle)/0.660: 1.5 m/s2': at full lock 1.491 m/s."""
    assert LIMITS.speed_at(24, L_M) == LIMITS.speed_at(-24, L_M) == pytest.approx(LATERAL_MPS)
    assert pytest.approx(1.491, abs=0.001) == LATERAL_MPS
    assert LIMITS.speed_at(0, L_M) == LIMITS.speed_at(5e-324, L_M) == 2.222
    assert LIMITS.angle_at(2.222, L_M) == LIMITS.angle_at(-2.222, L_M) == pytest.approx(11.34, abs=0.01)
    assert LIMITS.angle_at(0, L_M) == 24


# Three ways to say a bend.


def drive(speed_mps: float = 1.0, **asked: Any) -> Drive:  # noqa: ANN401 - any field
    return Drive(lease=1, seq=1, challenge=bytes(8), speed_mps=speed_mps, **asked)


@pytest.mark.parametrize(
    ("asked", "says"),
    [
        # 2 m radius, to the left; backward it turns the other way.
        (drive(angle_deg=degrees(atan(0.66 / 2))), degrees(atan(0.66 / 2))),
        (drive(curvature_1pm=0.5), degrees(atan(0.66 / 2))),
        (drive(yaw_rate_radps=0.5), degrees(atan(0.66 / 2))),
        (drive(-2.0, yaw_rate_radps=-1.0), degrees(atan(0.66 / 2))),
        (drive(0.0, yaw_rate_radps=0.0), 0.0),
        # None, two, or an impossible one.
        (drive(), "exactly one"),
        (drive(angle_deg=0.0, curvature_1pm=0.0), "exactly one"),
        (drive(angle_deg=0.0, yaw_rate_radps=0.0), "exactly one"),
        (drive(curvature_1pm=0.0, yaw_rate_radps=0.0), "exactly one"),
        (drive(0.0, yaw_rate_radps=0.1), "on the spot"),
        (drive(5e-324, yaw_rate_radps=1e300), "too tight"),
    ],
)
def test_three_ways_to_say_a_bend(asked: Drive, says: float | str) -> None:
    """The bicycle model with a wheelbase of 0.660 m."""
    told = steering_angle_deg(asked, L_M)
    if isinstance(says, str):
        assert isinstance(told, str)
        assert says in told
    else:
        assert told == pytest.approx(says)


numbers = st.floats(allow_nan=False, allow_infinity=False)


@given(speed_mps=numbers, bend=numbers, name=st.sampled_from(["angle_deg", "curvature_1pm", "yaw_rate_radps"]))
def test_no_finite_numbers_raise(speed_mps: float, bend: float, name: str) -> None:
    """An angle requested as a bend is within a right angle."""
    told = steering_angle_deg(drive(speed_mps, **{name: bend}), L_M)
    assert isinstance(told, str) or name == "angle_deg" or abs(told) <= 90
