"""The command to the chassis: the stop sequence, lamps and horn, handover to others, and where a stop begins.

A row of a stop begins with a speed, a gear and "parking", and goes on with what is seen for so many milliseconds.
"""

from collections.abc import Callable
from itertools import product
from math import radians, tan

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.chassis.port import Actuation, AuxiliaryFrame, ChassisState
from gateway.choice.chassis import CHASSIS
from gateway.command.auxiliary import Auxiliary
from gateway.command.motion import MotionLimits
from gateway.command.output import Handover, inferred_actuation, inferred_angle_deg
from gateway.command.stop import StopFeedback, StopSequence
from schemas.decisions import StopPhase
from schemas.messages import GearPosition, Mode
from schemas.reasons import Reason
from schemas.settings import LEFT_BLIND_NS, ODOMETER_TIMEOUT_NS, TAIL_NS, CommandSettings
from tests.support.rigs.steps import Acted, Doing, near, rows, seen

MS = 1_000_000
L_M = CHASSIS.wheelbase_m
DRIVE, REVERSE, NEUTRAL, PARK, UNDEFINED = (
    GearPosition.DRIVE,
    GearPosition.REVERSE,
    GearPosition.NEUTRAL,
    GearPosition.PARK,
    GearPosition.UNDEFINED,
)
BLIND = StopFeedback()
STANDS = StopFeedback(stands=True, speed_mps=0.0, wheel_speed_mps=0.0, is_braked=False)
HELD = StopFeedback(stands=True, speed_mps=0.0, wheel_speed_mps=0.0, is_braked=True)

See = Callable[[float, Actuation], StopFeedback]


def doing(
    speed_mps: float, gear: GearPosition = DRIVE, *, parking: bool = False, angle_deg: float = 0.0
) -> Actuation:
    return Actuation(True, gear, speed_mps, angle_deg, parking=parking)  # noqa: FBT003


def moving(speed_mps: float, *flags: str) -> StopFeedback:
    wheels_mps = -speed_mps if "back" in flags else speed_mps
    return StopFeedback(moves=True, speed_mps=speed_mps, wheel_speed_mps=wheels_mps, is_braked="braked" in flags)


def obedient(_at_s: float, told: Actuation) -> StopFeedback:
    """A robot that follows at once, with its brake."""
    if told.speed_mps == 0:
        return HELD if told.parking else STANDS
    return moving(told.speed_mps, *["back"] * (told.gear is REVERSE))


def open_brake(at_s: float, told: Actuation) -> StopFeedback:
    """A robot whose brake never reads applied."""
    return STANDS if told.speed_mps == 0 else obedient(at_s, told)


class Stop(Acted):
    """A stop, tick by tick; ``told`` is the output of every tick with its phase."""

    def __init__(self, begin: str) -> None:
        speed, gear, *words = begin.split()
        self.last = doing(float(speed), GearPosition(gear), parking="parking" in words, angle_deg=10.0)
        deceleration_mps2 = next((float(word[1:]) for word in words if word[0] == "@"), 2.0)
        self.sequence = StopSequence(
            self.last,
            deceleration_mps2,
            0,
            may_release="may_release" in words,
            stood_by_motor="stood_by_motor" in words,
        )
        self.now_ms = 0
        self.told: list[tuple[StopPhase, Actuation]] = []

    def run(self, see: See, ms: str) -> None:
        begun_ms = self.now_ms
        for _ in range(int(ms) // 10):
            at_s = (self.now_ms - begun_ms) / 1000
            actuation = self.sequence.tick(self.now_ms * MS, see(at_s, self.last))
            self.now_ms += 10
            if actuation is None:
                assert self.sequence.phase is StopPhase.IDLE
                break
            self.last = actuation
            self.told.append((self.sequence.phase, actuation))

    def until(self, phase: str) -> None:
        while self.sequence.phase is not StopPhase(phase):
            self.run(lambda *_: HELD, "10")

    def lasted(self) -> list[str]:
        """The durations of the phases, in order."""
        phases = [phase.value for phase, _ in self.told]
        return [f"{phase}:{10 * phases.count(phase)}" for phase in dict.fromkeys(phases)]

    def steps(self) -> Doing:
        run, sequence = self.run, self.sequence
        return {
            "obeys": lambda ms: run(obedient, ms),
            "opens": lambda ms: run(open_brake, ms),
            "stands": lambda ms: run(lambda *_: STANDS, ms),
            "held": lambda ms: run(lambda *_: HELD, ms),
            "blind": lambda ms: run(lambda *_: BLIND, ms),
            "unread": lambda ms: run(lambda *_: StopFeedback(moves=True), ms),
            "moving": lambda mps, ms, *flags: run(lambda *_: moving(float(mps), *flags), ms),
            "slowing": lambda mps, by, ms: run(lambda at_s, _: moving(float(mps) - float(by) * at_s), ms),
            "until": self.until,
            "pause": lambda ms: setattr(self, "now_ms", self.now_ms + int(ms)),
            "hasten": lambda mps2: sequence.hasten(float(mps2)),
            "cut": lambda mps: sequence.not_above(float(mps)),
            "park": lambda: sequence.park(self.now_ms * MS),
            "release": lambda: sequence.release(self.now_ms * MS),
            "finish": lambda: sequence.finish(self.now_ms * MS),
        }

    def claims(self) -> Doing:
        last, sequence, now_ns = self.last, self.sequence, self.now_ms * MS
        enabled = [actuation for phase, actuation in self.told if phase is not StopPhase.DISABLE]
        return {
            "told": lambda mps: near(last.speed_mps, mps),
            "gear": lambda gear: last.gear.value == gear,
            "gears": lambda gear: {one.gear.value for one in enabled} == {gear},
            "parking": lambda: last.parking,
            "braked": lambda: all(one.parking and not one.speed_mps for _, one in self.told),
            "enabled": lambda: last.enabled,
            "phase": lambda phase: sequence.phase.value == phase,
            "lasted": lambda *phases: self.lasted() == [*phases],
            "returns": lambda count: sequence.returns == int(count),
            "stays": lambda: sequence.stays,
            "secure": lambda: sequence.is_braked(now_ns),
            "lacking": lambda: sequence.lacks_brake(now_ns),
        }


def stop(row: str) -> None:
    begin, _, steps = row.partition("; ")
    Stop(begin).play(steps)


RAMP = {
    "the whole": "1 drive; obeys 10000; = lasted ramp:490 brake:10 park:10 hold:1000 disable:500, gears drive, "
    "phase idle, unenabled, gear neutral, parking",
    **{
        f"{gear} by {by}": f"1 {gear} @{by}; obeys 10; = told {1 - by / 100}, gear {gear}; obeys 10; = told "
        f"{1 - 2 * by / 100}; obeys {ms}; = phase ramp, unparking, gear {gear}; obeys 20; = unphase ramp"
        for (by, ms), gear in product(((1.2, 800), (2.0, 470)), ("drive", "reverse"))
    },
    # Where the scale is in doubt.
    "no ramp": "1 drive @inf; obeys 10; = told 0, phase brake",
    # A graver cause hastens, and a lesser one does not slow it.
    "hastened": "1 drive @1.2; hasten 2; hasten 1.2; obeys 10; = told 0.98; obeys 10; = told 0.96",
    # A late loop is no jump to zero: one step of a tenth of a second at most.
    "after a pause": "1 drive; pause 5000; moving 0.9 10; = told 0.8",
    "never cut higher": "1 drive; cut 5; obeys 10; = told 0.98; cut 0.5; obeys 10; = told 0.48, phase ramp",
    # Zero speed before the parking brake, and that before neutral: one phase a tick, however late it is.
    "each phase is told also after a pause": "1 drive @inf; held 10; = told 0, unparking; pause 5000; held 10; = "
    "parking, gear drive; pause 5000; held 10; = parking, gear drive; pause 5000; held 10; = parking, gear "
    "neutral",
}


@rows(RAMP)
def test_the_whole_sequence(row: str) -> None:
    """Row 'stop: ramp to zero in gear, parking brake, hold 1 s, disable 0.5 s, silence'; and the decelerations."""
    stop(row)


BRAKE = {
    "not while it only lags behind the ramp": "1 drive; slowing 1 0.8333 1200; = unparking; stands 10; = "
    "parking, gear drive",
    # By more than the standstill bound, at any commanded speed.
    **{
        f"at once against {gear}, told {mps}": f"{mps} {gear}; moving 0.05 10 {back}; = unparking; moving 0.051 "
        f"10 {back}; = parking, told 0, gear {gear}"
        for (gear, back), mps in product((("drive", "back"), ("reverse", "")), (1, 0))
    },
    # In gear meanwhile, also when nothing can be seen; at zero speed what cannot be seen at all is not waited for.
    **{
        f"after 300 ms of {seen}, told {mps}": f"{mps} drive @1.2; {seen} 300; = unparking; {seen} 10; = parking, "
        "told 0, gear drive"
        for seen, mps in product(("moving 1", "moving 0.06", "blind"), (1, 0))
        if mps or seen != "blind"
    },
    "at once blind, told 0": "0 drive @1.2; blind 10; = parking, told 0, gear drive",
    # From when it was last slower; noise is not slower.
    "300 ms after it stopped slowing": "1 drive @1.2; slowing 1 1.2 200; "
    + "moving 0.772 10; moving 0.787 10; " * 14
    + "= unparking; moving 0.772 30; = parking",
    # A robot that slows down very little would coast for metres.
    "a second after zero was told": "1 drive @inf; slowing 2 0.3 1000; = lasted brake:1000; moving 1.7 10; = "
    "phase park",
    # What was parked is never released in a stop.
    **{
        f"{last}, {seen}": f"0 {last}; {seen} 8000; = braked"
        for last, seen in product(
            ("neutral", "undefined", "drive parking", "neutral parking"), ("stands", "moving 0.5", "blind")
        )
    },
    # Later nothing begins again.
    "asked for at any speed": "1 drive; obeys 50; park; moving 0.9 10; = parking, told 0, gear drive; held 500; "
    "park; = phase hold",
    "it never reads applied": "1 drive; opens 510; = phase park; stands 2980; = unlacking; stands 10; = lacking; "
    "stands 60000; = phase park, gear drive, parking, enabled; held 10; = unlacking",
    # It is waited for, 3 s; then the rest comes all the same, in gear.
    "nothing is known of it": "1 drive; blind 10000; = lasted ramp:300 park:3000 hold:1000 disable:500, gears "
    "drive",
}


@rows(BRAKE)
def test_when_the_parking_brake_is_told(row: str) -> None:
    """Row 'stop: parking brake as soon as the robot stands, moves against the ramp, does not slow for 300 ms'."""
    stop(row)


NOISE = "moving 0 10; moving 0.08 10; " * 100
HOLDS = {
    # The second restarts while it moves, braked or not.
    "a robot that moves is not left": "1 drive; obeys 1000; = phase hold; moving 0.1 60000 braked; = phase hold; "
    "held 990; = enabled; held 10; = unenabled",
    # Disabled frames may release the brake of some firmware; after the second return the enables stay.
    "the enables hold it": "1 drive; until disable; = unstays; moving 0.1 10; = phase park, enabled, parking, "
    "returns 1; until disable; = unstays; moving 0.1 10; = returns 2, stays; held 4990; = unsecure; held 60000; "
    "= phase hold, enabled, gear drive, secure; finish; held 1000; = phase idle",
    # Faster 300 ms later: brake again, for good.
    **{
        f"its motor, later {seen}": "0 drive parking; release; moving 0.2 300; = enabled, gear drive, told 0, "
        f"unparking; {seen} 10000{flag}; = {un}parking, stays; moving 0.4 10000 braked; = parking; held 60000; = "
        "enabled"
        for seen, flag, un in (("moving 0.3", " braked", ""), ("moving 0.1", " braked", "un"), ("held", "", "un"))
    },
    # Seen by the pulses alone it is faster. A robot of which nothing is received is not.
    "by pulses alone": "0 drive parking; release; moving 0.2 310; unread 50; = parking",
    "nothing received": "0 drive parking; release; moving 0.2 310; blind 50; = unparking",
    "no speed ever": "0 drive parking; release; unread 310; unread 50; = parking",
    # A robot at rest whose coarse speeds flicker by a bit each way is not given to its brake again.
    "noise": f"0 drive parking; release; moving 0 310; {NOISE}= unparking; moving 0.081 10; = parking",
    # In a change of direction the gear is engaged behind the brake, and a tick later the motor holds it.
    **{
        f"in neutral, rolling to {gear}": "0 neutral parking may_release stood_by_motor; held 30; moving 0.2 100 "
        f"braked {back}; = parking, gear neutral; moving 0.2 10 braked {back}; = parking, gear {gear}; moving 0.2 "
        f"10 braked {back}; = unparking, gear {gear}"
        for back, gear in (("back", "reverse"), ("", "drive"))
    },
    # Once, if the motor brought it to rest; a robot that slows down is held by its brake.
    **{
        f"given back to the motor that stopped it, {flag or 'not'}": f"1 drive {flag}; obeys 1000; = phase hold; "
        "moving 0.3 50 braked; = parking; moving 0.1 60 braked; = parking; held 200; moving 0.1 100 braked; = "
        f"parking; moving 0.1 20 braked; = {un}parking, {un2}stays"
        for flag, un, un2 in (("may_release", "un", ""), ("", "", "un"))
    },
    "not seen to stand by its motor": "1 drive may_release; blind 1000; moving 0.1 1000 braked; = parking",
}


@rows(HOLDS)
def test_what_holds_the_robot(row: str) -> None:
    """Row 'a parking brake that reads applied and does not hold', and 'neutral only behind an applied brake'."""
    stop(row)


def test_a_brake_that_slows_a_robot_beyond_what_can_be_read_does_not_slip() -> None:
    """Its controller restarts on a hill, and its brake stops it from 5 m/s, which is no valid speed."""
    sequence = StopSequence(doing(0, parking=True), 2.0, 0, may_release=True, stood_by_motor=True)
    speed_mps = 5.0
    for now_ms in range(10, 3000, 10):
        is_braked = now_ms > 500
        speed_mps = max(0.0, speed_mps - 0.037 * is_braked)
        mps = speed_mps if speed_mps < 2.5 else None
        see = StopFeedback(not speed_mps, speed_mps > 0, mps, mps, is_braked)
        told = sequence.tick(now_ms * MS, see)
        assert told is not None
        assert told.parking, now_ms


@given(
    speed_mps=st.floats(0, 2.222),
    gear=st.sampled_from([DRIVE, REVERSE, NEUTRAL]),
    parking=st.booleans(),
    seen_=st.lists(
        st.builds(
            StopFeedback,
            stands=st.booleans(),
            moves=st.booleans(),
            speed_mps=st.none() | st.floats(0, 3),
            wheel_speed_mps=st.none() | st.floats(-3, 3),
            is_braked=st.none() | st.booleans(),
        ),
        min_size=1,
        max_size=30,
    ),
    steps_ms=st.lists(st.integers(1, 400), min_size=1, max_size=30),
)
def test_nothing_is_ever_taken_back_in_a_stop(
    speed_mps: float, gear: GearPosition, *, parking: bool, seen_: list[StopFeedback], steps_ms: list[int]
) -> None:
    """With any feedback and ticks the speed falls, the brake stays, and neutral is only behind it."""
    is_driven = gear is not NEUTRAL and not parking
    last = before = doing(speed_mps if is_driven else 0.0, gear, parking=parking)
    sequence = StopSequence(last, 1.2, 0)
    now_ms = 0
    for tick in range(400):
        now_ms += steps_ms[tick % len(steps_ms)]
        told = sequence.tick(now_ms * MS, seen_[tick % len(seen_)])
        if told is None:
            break
        assert told.speed_mps <= before.speed_mps
        assert not (told.parking and told.speed_mps)
        assert told.parking or not before.parking
        assert told.enabled or (told.gear is NEUTRAL and told.parking)
        if told.gear is not before.gear:
            assert (before.parking, before.speed_mps) == (True, 0.0)
            assert told.gear in {NEUTRAL, last.gear}
        before = told
    assert before.parking, "within 300 ms of any robot that does not slow down"


# Handover. When the output ceases, and what may be obeyed after that, are rows of test_arbiter.

AUTO = ChassisState(bus_up=True, mode=Mode.AUTO)
NOW_NS = 7_000_000_000


def test_what_is_not_seen_yet_is_waited_for_from_when_the_bus_is_back() -> None:
    """After the handover, and after each return of the bus."""
    handover = Handover()
    handover.begin(AUTO)
    unseen, lost = seen(AUTO, ("mode:undefined",)), seen(AUTO, ("bus_up:false",))
    handover.leave(doing(1.0), Reason.BUS_DOWN, lost, NOW_NS)
    assert not handover.is_obeyed_again(unseen, NOW_NS + LEFT_BLIND_NS - 1, is_taken=False)
    back_ns = NOW_NS + 5 * LEFT_BLIND_NS
    assert not handover.is_obeyed_again(lost, back_ns, is_taken=False)
    assert not handover.is_obeyed_again(unseen, back_ns + LEFT_BLIND_NS - 1, is_taken=False)
    assert handover.is_obeyed_again(AUTO, back_ns + 1, is_taken=False), "what is seen is not waited for"
    assert handover.is_obeyed_again(unseen, back_ns + LEFT_BLIND_NS, is_taken=False)
    # What another computer commands is not ours any more, also when it falls silent.
    assert not handover.is_obeyed_again(AUTO, back_ns + LEFT_BLIND_NS, is_taken=True)
    assert not handover.is_obeyed_again(AUTO, back_ns + LEFT_BLIND_NS, is_taken=False)


# The measured state of a chassis, and where a stop of a robot that was found moving begins.

LIMITS = MotionLimits.of(CommandSettings(speed_limit_mps=1.5, steering_limit_deg=10.0))


def at(
    mps: float | None, gear: GearPosition = DRIVE, wheels_mps: float | None = -1, **others: float
) -> ChassisState:
    wheels_mps = mps if wheels_mps == -1 else wheels_mps
    return ChassisState(speed_mps=mps, fastest_wheel_mps=wheels_mps, gear=gear, **others)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("drive_mps", "wheels_mps", "slowest_mps", "fastest_mps"),
    [
        (1.0, 0.9, 0.9, 1.0),
        (0.9, 1.0, 0.9, 1.0),
        (2.0, 0.0, 0.0, 2.0),
        (None, 0.7, 0.7, 0.7),
        (0.7, None, 0.7, 0.7),
        (None, None, 0.0, None),
    ],
)
def test_the_lower_speed_is_told_and_the_higher_one_is_feared(
    drive_mps: float | None, wheels_mps: float | None, slowest_mps: float, fastest_mps: float | None
) -> None:
    """No single faulty sensor sets a robot going, and none hides a motion."""
    chassis = at(drive_mps, DRIVE, wheels_mps)
    assert (chassis.slowest_mps, chassis.fastest_mps) == (slowest_mps, fastest_mps)
    assert inferred_actuation(chassis, LIMITS, L_M).speed_mps == slowest_mps


@pytest.mark.parametrize(
    ("words", "is_slow", "moves"),
    [
        ("", True, False),
        ("speed_mps:0.051", False, True),
        ("fastest_wheel_mps:0.051", False, True),
        ("pulses:1", False, True),
        ("pulses:-1", False, True),
        ("speed_mps:null", False, False),
        ("fastest_wheel_mps:null", False, False),
        ("speed_mps:null turns:true", False, True),
        ("turns:true", True, False),
        ("turns:true confirmed:false", True, True),
    ],
)
def test_what_stands_and_what_moves(words: str, *, is_slow: bool, moves: bool) -> None:
    """Rows 'found at start: moving' and 'standstill: under 0.05 m/s'; the raw drive feedback counts in doubt."""
    slow = ChassisState(speed_mps=0.0499, fastest_wheel_mps=0.0499, turns=False, confirmed=True)
    chassis = seen(slow, tuple(words.split()))
    assert (chassis.is_slow, chassis.moves) == (is_slow, moves)


@pytest.mark.parametrize("seen_deg", [-30.0, -17.0, 17.0])
def test_no_speed_is_told_that_the_angle_does_not_allow(seen_deg: float) -> None:
    """Row 'lateral acceleration', of a robot that is given back in a bend: v^2 tan(angle) / 0.660 m."""
    limits = MotionLimits.of(CommandSettings(speed_limit_mps=2.222))
    told = inferred_actuation(at(3.0, angle_deg=seen_deg), limits, L_M)
    assert told.speed_mps**2 * tan(radians(abs(seen_deg))) / 0.660 == pytest.approx(1.5)


@pytest.mark.parametrize(("seen_deg", "told_deg"), [(None, 0.0), (-30.0, -10.0), (30.0, 10.0), (4.0, 4.0)])
def test_the_angle_is_within_the_limit(seen_deg: float | None, told_deg: float) -> None:
    """Straight ahead if unknown."""
    assert inferred_angle_deg(ChassisState(angle_deg=seen_deg), LIMITS) == told_deg


@pytest.mark.parametrize(
    ("chassis", "left", "told"),
    [
        # Within the limit, in gear alone; the brake is asked for where the robot may be parked.
        (at(2.0, DRIVE), None, doing(1.5)),
        (at(2.0, REVERSE), None, doing(1.5, REVERSE)),
        (at(2.0, NEUTRAL), None, doing(0.0, NEUTRAL)),
        (at(2.0, PARK), None, doing(0.0, NEUTRAL, parking=True)),
        (at(2.0, UNDEFINED), None, doing(0.0, NEUTRAL, parking=True)),
        # Never above what it was left on, and what is seen; parked it stays.
        (at(0.4), doing(1.0), doing(0.4)),
        (at(1.0), doing(0.4), doing(0.4)),
        (at(1.9), doing(0.0), doing(0.0)),
        (at(1.0, REVERSE), doing(1.0), doing(0.0, REVERSE)),
        (at(1.0, UNDEFINED), doing(1.0), doing(0.0)),
        (at(1.0), doing(0.0, parking=True), doing(0.0, parking=True)),
        (at(1.0), doing(0.0, NEUTRAL, parking=True), doing(0.0, parking=True)),
    ],
)
def test_what_was_left_bounds_what_is_told(chassis: ChassisState, left: Actuation | None, told: Actuation) -> None:
    """Row 'given back: never a speed above the lower of what it was left on and what is seen'."""
    assert inferred_actuation(chassis, LIMITS, L_M, left) == told


# Lamps, horn and odometer.

LATER_NS = 10**12
ALL = ("head", "left", "right")


def lamps(*on: str) -> AuxiliaryFrame:
    return AuxiliaryFrame(
        "Auto_LightCmd",
        {"Headlamp": "head" in on, "RightIndicator": "right" in on, "LeftIndicator": "left" in on},
    )


def horn(*, on: bool) -> AuxiliaryFrame:
    return AuxiliaryFrame("Auto_SpeakerCmd", {"Horn": on})


def odometer(*, on: bool) -> AuxiliaryFrame:
    return AuxiliaryFrame("Auto_OdometerCmd", {"Enable": on, "ClearMileage": on})


def shining(*on: str) -> Auxiliary:
    made = Auxiliary(CHASSIS)
    made.set_light(headlamp="head" in on, left="left" in on, right="right" in on, now_ns=0)
    return made


def assert_off(made: Auxiliary, since_ns: int, *frames: AuxiliaryFrame) -> None:
    """Off frames for 100 ms, then none."""
    assert made.frames(since_ns + TAIL_NS - 1) == [*frames]
    assert made.frames(since_ns + TAIL_NS) == []


def test_what_is_on_is_sent_until_it_is_ended() -> None:
    """A stop ends all of it: the chassis keeps the last command forever."""
    made = Auxiliary(CHASSIS)
    made.end(0)
    assert made.frames(0) == []
    for lamp in ALL:
        made = shining(lamp)
        assert made.frames(0) == made.frames(LATER_NS) == [lamps(lamp)]
        made.set_light(headlamp=False, left=False, right=False, now_ns=LATER_NS)
        assert_off(made, LATER_NS, lamps())
    made = Auxiliary(CHASSIS)
    made.set_horn(on=True, now_ns=0)
    assert made.frames(LATER_NS) == [horn(on=True)]
    made.set_horn(on=False, now_ns=5)
    assert_off(made, 5, horn(on=False))
    made = shining("left")
    made.set_horn(on=True, now_ns=0)
    made.clear_odometer(0)
    made.end(5)
    assert_off(made, 5, lamps(), horn(on=False), odometer(on=False))


def test_the_odometer_is_cleared_once_it_reads_zero() -> None:
    """Not before the frames can have had an effect, and once; otherwise it fails in time."""
    made = Auxiliary(CHASSIS)
    assert made.clearing_result(0.0, 0) is None
    made.clear_odometer(0)
    assert made.is_clearing
    assert made.frames(0) == [odometer(on=True)]
    for mileage_km, now_ns, result in (
        (0.0, TAIL_NS - 1, None),
        (0.0005, TAIL_NS, None),
        (0.0004, TAIL_NS, True),
        (0.0, TAIL_NS, None),
    ):
        assert made.clearing_result(mileage_km, now_ns) is result
    assert not made.is_clearing
    assert_off(made, TAIL_NS, odometer(on=False))
    for failed_km in (12.0, None):
        made.clear_odometer(0)
        assert made.clearing_result(failed_km, ODOMETER_TIMEOUT_NS - 1) is None
        assert made.clearing_result(failed_km, ODOMETER_TIMEOUT_NS) is False


@pytest.mark.parametrize(
    ("is_out", "is_left", "frames"), [(True, False, [lamps()]), (True, True, []), (False, True, [lamps()])]
)
def test_what_the_next_stop_or_engagement_puts_out(
    is_out: bool,  # noqa: FBT001 - a case
    is_left: bool,  # noqa: FBT001 - a case
    frames: list[AuxiliaryFrame],
) -> None:
    """Lamps that were switched off are switched off again, but not after a takeover; lit ones always."""
    made = shining("right")
    if is_out:
        made.set_light(headlamp=False, left=False, right=False, now_ns=1)
        assert not made.is_off(TAIL_NS)
        assert made.is_off(1 + TAIL_NS)
    if is_left:
        made.leave(2)
    assert made.is_off(LATER_NS) is is_out
    made.end(LATER_NS)
    assert made.frames(LATER_NS) == frames
    assert made.is_off(LATER_NS + TAIL_NS)
