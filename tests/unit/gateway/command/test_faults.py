"""Every fault of chassis, bus, link or operator, against the whole command flow: scenes of ``rigs.scenes``."""

from collections.abc import Iterator
from itertools import combinations, product
from typing import Any

import pytest

from gateway.chassis.cruiser.frames import MOTION_FRAMES, load
from gateway.chassis.frame import Frame
from gateway.chassis.layout import check
from schemas.decisions import ArbiterState
from schemas.messages import Variant
from schemas.reasons import TEXTS, Reason
from schemas.settings import ChassisSettings
from tests.support.frames import STANDING, Feedback
from tests.support.nights import by_night
from tests.support.rigs.gateway import MS, driving, ready
from tests.support.rigs.scenes import CAN_IDS, Scene, flipped, play
from tests.support.rigs.steps import rows
from tests.support.strategies import VARIANTS

REQUIRED = ChassisSettings().required_feedback
FAST = ("Auto_GearFeedBack", "Auto_SteeringFeedBack", "Auto_DriveFeedBack")
SCALED = ("Auto_DriveFeedBack", "Auto_WheelSpdFeedback")
"""Their speeds are of the one scale or the other; other frames are the same in both."""

COLUMNS = ((0, 7), (1, 6), (2, 5), (3, 4))
"""The bits of a byte: those at its ends, where signs and flags are, by day."""


def mostly_coarse(counts: range) -> list[Any]:
    """Each count with both scales; by day with the fine one only the last."""
    table = list(product(counts, VARIANTS))
    return [row if row[1] is Variant.COARSE or row[0] == counts[-1] else by_night(*row) for row in table]


def silent_pairs() -> Iterator[tuple[int, int]]:
    """The pairs of bits that the XOR does not see: those of one column."""
    for first, second in combinations(range(64), 2):
        if first % 8 == second % 8:
            yield first, second


# The bytes.


@pytest.mark.parametrize("variant", VARIANTS)
def test_the_checksum_refuses_eight_of_nine_pairs_of_bits(variant: Variant) -> None:
    """1,792 of 2,016 pairs in each frame, 88.9 %; those of one column pass."""
    for frame in Feedback(variant).all():
        pairs = combinations(range(64), 2)
        passed = [pair for pair in pairs if check(Frame(frame.can_id, flipped(frame.data, *pair))) is None]
        assert passed == list(silent_pairs())
        assert len(passed) == 224


@pytest.mark.parametrize(
    ("name", "variant", "columns"),
    [
        row if columns == COLUMNS[0] and (variant is Variant.COARSE) is (name not in SCALED) else by_night(*row)
        for row in product(STANDING, VARIANTS, COLUMNS)
        for name, variant, columns in [row]
    ],
)
def test_two_flipped_bits_never_move_the_robot_more_than_its_command(
    name: str, variant: Variant, columns: tuple[int, ...]
) -> None:
    """Each of the 224 undetected pairs, once during a drive: no faster than commanded, and no other way."""
    rig, operator = driving(0.6, variant=variant)
    for pair in silent_pairs():
        if pair[0] % 8 not in columns:
            continue
        left = [pair]

        def corrupt(frame: Frame, left: list[tuple[int, int]] = left) -> Frame:
            if frame.can_id == CAN_IDS[name] and left:
                return Frame(frame.can_id, flipped(frame.data, *left.pop()), frame.wall_ns)
            return frame

        rig.corrupt = corrupt
        operator.drive(0.6, seconds=0.06)
        assert not left
        assert -0.01 <= rig.speed_mps <= 0.61
        if not rig.says.engaged:
            rig.until(lambda: rig.says.state is ArbiterState.STANDBY and rig.speed_mps == 0, 6)
            operator.take_lease("take")
            operator.reason("reset")
            operator.engage()
            operator.drive(0.6, seconds=1.3)


@pytest.mark.parametrize("name", STANDING)
def test_two_flipped_bits_never_clear_a_latch(name: str) -> None:
    rig, operator = ready()
    operator.take_lease()
    rig.put("anyone", "stop", b"")
    rig.tick()
    for pair in silent_pairs():
        rig.corrupt = lambda frame, pair=pair: (  # type: ignore[misc]
            Frame(frame.can_id, flipped(frame.data, *pair)) if frame.can_id == CAN_IDS[name] else frame
        )
        operator.drive(1.0)
        assert rig.says.latched == [Reason.REMOTE_STOP, *rig.says.latched[1:]]
    assert all(not burst["Auto_DriveCmd"]["TargetVelocity"] for _, burst in rig.bursts)


# Supervision.


BODY, PULSES = "Auto_MileageAndBodyFeedback", "Auto_WheelPulseFeedback"
REMOTE = "transmitter remote; sticks {} 0"
AT_BUMPER = "ready; bumper {} on; wait 1; reply acquire none; reply reset none; engage"
"""The bumper is pressed, and was reset: the robot is engaged to back off."""


HAZARD = " left right"


def freeze(*names: str) -> str:
    return "; ".join(f"freeze {name}" for name in names)


def borne_s(name: str) -> float:
    """Row 'feedback silence, per frame, over 10 periods (at least 100 ms): stop'."""
    return max(100, 10 * load(Variant.COARSE).messages[name].period_ns // MS) / 1000 - 0.02


FEEDBACK: dict[str, str] = {
    # Not what the manual calls reserved; each that is required by its name.
    **{
        f"engaged without {name}": f"new; silence {name}; wait 1; reply acquire none; "
        + (f"reply engage feedback_missing; detail {name}" if name in REQUIRED else "engage")
        for name in STANDING
    },
    # Both pass the checksum: the counter and the plausibility of the values find them.
    **{
        f"{wrong} for {name}": f"driving 0.8; corrupt {name} {wrong}; drive 0.8 0 0.6; = stopped, for "
        "implausible_speed feedback_faulty feedback_missing mode_not_auto hand_transmitter found_moving; wait 8; "
        "= rests"
        for wrong, name in product(("zeros", "reversed"), REQUIRED)
    },
    # 0 to 7 bytes, and CAN FD.
    **{
        f"{length} bytes": f"driving 1; corrupt Auto_DriveFeedBack length {length}; drive 1 0 0.04; wait 0.3; = "
        "stopped, for feedback_missing; rest; = rests, in_order"
        for length in (*range(8), 9, 12, 16, 64)
    },
    "blocked: told no jump, and given up within 2 s": "ready fast; engage; mark; motor 0; drive 2.2 0 2; = "
    "latched not_moving, most 0.48",
    # At one coarse bit the speeds read zero, and the pulses count rightly.
    **{
        f"{variant} creeps at {creep_mps}, then off by {acceleration_mps2}": f"ready variant:{variant} "
        f"speed_limit_mps:1 acceleration_mps2:{acceleration_mps2}; engage; drive {creep_mps} 0 2; drive 0.8 0 3; "
        "= latched, engaged"
        for variant, creep_mps, acceleration_mps2 in product(
            ("coarse", "fine"), (0.04, 0.05, 0.07), (0.4, 0.8, 1.5)
        )
    },
    # Speeds that read zero since before the command prove nothing.
    "it stands only if its feedback has answered": "ready fast; engage; reply stop none; detail the robot "
    "stands; wait 4; reply acquire none; reply reset none; engage; drive 2.2 0 0.16; freeze all; drive 2.2 0 "
    "0.5; reply stop not_confirmed; detail the speed reads 0, unchanged for; = unconfirmed; clear; wait 6; = "
    "confirmed; text stopped at standstill, no commands sent",
    # The bumper is hidden for four metres at most: the wheels contradict the mileage.
    "a frozen body frame hides a bumper": f"driving 1; freeze {BODY}; drive 1 0 0.1; bumper front on; mark; "
    "drive 1 0 6; = latched feedback_frozen, way 4",
    **{
        f"{variant} read as {other}": f"ready variant:{variant}; engage; scale wrong; drive 1 0 2; = has "
        f"implausible_speed; text latch the {other} scale of the drive frames would fit; wait 6; = rests"
        for variant, other in (("coarse", "fine"), ("fine", "coarse"))
    },
    # The gate admits no speed in an unknown scale: the stop begins at zero.
    "a variant in doubt at speed": "driving 1.5; doubt; drive 1.5; = for variant_unknown, told 0; wait 6; = "
    "rests, standby",
    **{
        f"silence of {name}": f"driving 1; silence {name}; drive 1 0 {borne_s(name)}; = engaged; drive 1 0 0.1; = "
        "for feedback_missing; rest; = rests"
        for name in REQUIRED
    },
    **{
        f"{fault} of {name}, which is not required": f"driving 1; {fault} {name}; drive 1 0 2; = engaged"
        for name, fault in product(sorted(set(STANDING) - set(REQUIRED)), ("silence", "checksum", "stuck"))
    },
    **{
        f"five checksums of {name} in a second": f"driving 1; checksum {name} for 4 frames; drive 1 0 0.5; = "
        f"engaged; wait 0; checksum {name} for 1 frames; drive 1 0 0.1; = for feedback_faulty"
        for name in REQUIRED
    },
    # The counter fits again after 16, so silence is declared before.
    **{
        f"16 lost of {name}": f"driving 1; drop {name} next 16; drive 1 0 0.16; = for feedback_missing"
        for name in FAST
    },
    **{
        f"{', '.join(names)} frozen after {driven_s} s at 2.2 m/s": f"ready fast; engage; drive 2.2 0 {driven_s}; "
        f"mark; {freeze(*names)}; drive 2.2 0 8; = way {most_m}, rests, first not_moving feedback_frozen"
        for names, times_s, most_m in [
            (("all",), (0.16, 0.2, 0.3), 4.0),
            (SCALED, (0.02, 0.2, 0.3), 4.0),
            (("all",), (0.6, 1.2, 1.8, 2.4, 3.0), 5.0),
            (SCALED, (0.6, 1.2, 1.8, 2.4), 5.0),
        ]
        for driven_s in times_s
    },
    # At a command that need not show, either of pulses and mileage is enough.
    **{
        f"speeds and {name} frozen of a slow robot": f"ready; engage; mark; {freeze(*SCALED, name)}; drive 0.2 0 "
        f"20; = first feedback_frozen, rests, way {most_m}"
        for name, most_m in ((BODY, 0.6), ("Auto_WheelPulseFeedback", 3.2))
    },
    "another scale while it stands": "ready; engage; drive 0 0 0.2; variant fine; drive 0 0 0.6; "
    # Read in the wrong scale its wheels turn at 33 m/s.
    "= stopped, for variant_unknown implausible_speed, told 0",
}


@rows(FEEDBACK)
def test_feedback_that_fails(row: str) -> None:
    """Rows 'feedback silence', 'checksum faults', 'commanded to move' and 'frozen feedback'."""
    play(row)


@pytest.mark.parametrize("name", FAST)
@pytest.mark.parametrize(
    "step", [step if step in {0, 2, 8, 15} else by_night(step) for step in (0, *range(2, 16))]
)
def test_a_counter_that_stands_or_jumps_stops_the_robot(name: str, step: int) -> None:
    """Row 'alive counter: +1 per fault, -1 per good frame, at 5: stop'; frozen, and every step from 2 to 15."""
    fault = f"skip {name} by {step}" if step else f"stuck {name}"
    play(
        f"driving 1; {fault}; drive 1 0 0.04; = engaged; drive 1 0 0.06; = stopped, for feedback_faulty "
        "feedback_missing"
    )


BUS: dict[str, str] = {
    # The motion continues from the last accepted command: no jump, and no fault at the gate.
    **{
        f"jammed for {ticks} ticks": f"ready; engage; drive 2 20 0.5; mark; takes 0; tick {ticks}; takes all; "
        "once 2 -20; = slower 0; drive 2 5 1; = engaged"
        for ticks in range(1, 5)
    },
    # The ramp is still to come when it is free again; but not from the old speed.
    "jammed in a stop": "driving 1.5; stop; takes 0; wait 5; takes all; mark; rest; = in_order, rests",
    "jammed for 10 s, and the chassis changed": "driving 1.5; stop; tick 5; takes 0; wait 10; exchange; takes "
    "all; mark; wait 6; = spoken, speechless, standby",
    # A stop that cannot be carried out says so; the other obstacles are rows of test_arbiter.
    "a stop of a robot of which nothing is heard": "driving 1; corrupt all lost; wait 0.6; "
    "reply stop feedback_missing; = latched remote_stop; "
    "detail latched| commanded, but not confirmed: the robot is not seen to stand",
    # At zero speed the parking brake comes second in a burst; the enables stay.
    **{
        f"takes {taken} of each burst of a stop": f"driving 1; ask stop; takes {taken}; wait 3; = rests, "
        + ("parked, phase hold" if taken > 1 else "unparked, phase park")
        for taken in range(1, 5)
    },
    # A handover during the hold of a stop never releases the brake afterwards.
    **{
        f"a parked robot and {by}": f"driving 1; ask stop; hold; tick 20; = phase hold; mark; {by}; wait 6; = "
        "spoken, braked"
        for by in (
            "transmitter remote; wait 0.5; transmitter command",
            "bus lost; wait 1; bus again",
            "bus lost; wait 1; bus silent",
        )
    },
    # While it is away nothing reaches the chassis, which goes on; the stop comes with the first sign of auto.
    **{
        f"{away}": f"driving 1; {away}; tick 3; = stopping, for found_moving, told 0; wait 6; = rests"
        for away in (
            "links bus_losses:1; deaf; tick 1; = events takeover bus_down; hears",
            "bus lost; tick 1; = events takeover bus_down; wait 0.1; bus again",
            "bus lost; tick 1; = events takeover bus_down; wait 1; bus again",
        )
    },
    "the controller leaves it": "driving 1; controller off; rest; = for bus_off, event fault bus_off; reply "
    "acquire none; reply engage bus_off; controller active; engage; = engaged",
    "another computer": "driving 1; foreign 18C4D3D0 every 10ms for 50ms; drive 1 0 0.04; = stopping, for "
    "other_commander",
}


@rows(BUS)
def test_a_bus_that_fails(row: str) -> None:
    """Rows 'the bus', 'controller' and 'other commander'."""
    play(row)


@pytest.mark.parametrize(("takes", "variant"), mostly_coarse(range(5)))
def test_a_full_buffer_stops_the_robot_and_nothing_stale_leaves(takes: int, variant: Variant) -> None:
    """After five ticks without accepted frames; these are never sent later."""
    play(
        f"driving 1; takes {takes}; drive 2 20 0.04; = engaged; tick 2; = for send_failed; wait 0.3; takes all; "
        "tick 1; = below 1; wait 6; = rests, standby",
        variant,
    )


@pytest.mark.parametrize(("takes", "variant"), mostly_coarse(range(1, 5)))
def test_a_bus_that_takes_a_part_of_each_burst_does_not_keep_the_robot_going(takes: int, variant: Variant) -> None:
    """As a full queue does that drains a little each tick: the speed goes first, and ramps down."""
    play(
        f"driving 1; mark; takes {takes}; ask stop; drive 1 0 0.05; = for remote_stop; wait 3; = rests, falling, "
        "mute",
        variant,
    )


TAKEN: dict[str, str] = {
    "by the remote control": "driving 1; transmitter remote; sticks 0.3 0; drive 1 0 0.06; = standby, events "
    "takeover hand_transmitter; drive 1 0 2; = parted; mark; drive 1 0 1; = silent; reply engage hand_transmitter",
    # The mode leaves auto for one frame only, and the chassis continues its command.
    "for one frame": f"driving 1.5; corrupt once {BODY} flipped 41; drive 1.5 0 0.06; = stopping, for "
    "mode_not_auto; wait 6; = rests",
    # One frame reads remote, then none comes: it may execute its old command forever.
    "then silent": f"driving 1; corrupt last {BODY} flipped 40; drive 1 0 0.06; = standby; wait 6; = events stop "
    "found_moving, rests",
    # Another computer may own the bus.
    "driven by another computer": "driving 1; succeed; foreign 18C4D3D0 every 50ms; wait 2; = unspoken, moves 1",
    # Only the first robot that is found moving after a crash is latched.
    **{
        f"found moving{crash}": f"ready{crash}; slope -20; adopt 0.5; wait 0.5; = event stop found_moving, "
        f"latched {latched}; wait 15; = rests; reply acquire none; reply reset none; reply release none; slope "
        "-20; adopt 0.5; wait 0.5; = latched; wait 15; = rests"
        for crash, latched in (("; crash", "found_moving"), ("", ""))
    },
    **{
        f"{name} is cleared at speed": f"driving 1; deaf; unset {name}; drive 1 0 0.06; = for mode_not_auto, told "
        "0, parking; hears; drive 1 0 4; = standby, ruled not_engaged, rests"
        for name in MOTION_FRAMES
    },
    **{
        f"{name} is cleared at rest": f"ready; engage; deaf; unset {name}; drive 1 0 0.06; = events takeover "
        "mode_not_auto; mark; hears; drive 1 0 2; = silent, ruled not_engaged"
        for name in MOTION_FRAMES
    },
    # What a ramp left in the chassis is not executed when it is given back; the gateway may be gone by then.
    **{
        f"taken while its mode is unknown for {away_ms} ms": f"driving 1; silence {BODY} for {away_ms}ms; "
        f"{REMOTE.format(1)}; drive 1 0 1; = standby; sticks 0 0; wait 3; mark; deaf; transmitter command; wait "
        "5; = rests, parked, way 0.05"
        for away_ms in range(400, 601, 20)
    },
    # The bus returns, and the remote control drives since then; a body frame that comes in time is waited for.
    **{
        f"owed a stop for {phase_ms} ms": f"driving 1; bus lost; {REMOTE.format(2)}; tick 2; ask stop; tick "
        f"{phase_ms // 10 + 5}; bus again; silence {BODY} for {phase_ms}ms; mark; wait 2; = speechless, "
        "braked" + ", unspoken" * (phase_ms <= 150)
        for phase_ms in range(10, 410, 10)
    },
    "given back in motion": f"driving 1; {REMOTE.format(1)}; drive 1 0 1; mark; transmitter command; wait 4; = "
    "rests, spoken, speechless",
    "given back while it is latched": f"ready; ask stop; wait 1; {REMOTE.format(0.3)}; wait 1; sticks 0 0; wait "
    "1; transmitter command; wait 3; = latched remote_stop, parked",
    "moved twice soon after a stop, which says nothing about its brake": "driving 0.5; ask disengage; wait 4; "
    + f"{REMOTE.format(0.8)}; wait 2; transmitter command; wait 5; " * 2
    + "= event stop found_moving, latched",
}


@rows(TAKEN)
def test_a_robot_that_somebody_takes(row: str) -> None:
    """Rows 'mode leaves auto', 'on yielding to mode remote' and 'given back'."""
    play(row)


BUMPERS: dict[str, str] = {
    # Contact bounce of an acknowledged bumper latches nothing new, and a later hit does.
    **{
        f"bounces by {chatter_ms} ms": f"{AT_BUMPER.format('front')}; bounce {chatter_ms}; drive -0.3 0 2; = "
        "latched, engaged, faster 0.2; whole; bumper front off; drive -0.3 0 0.4; = latched; bumper front on for "
        "50ms; drive -0.3 0 0.1; = latched front_bumper"
        for chatter_ms in (20, 40, 80)
    },
    # Both indicators go on in place of off; any other stop puts the lamps out.
    **{
        f"lamps after {does}": f"driving 1; reply light none headlamp:true; {does}; rest; = lamps{lit}; clear; "
        f"reply acquire none; wait 1; reply reset none; = lamps{lit}; engage; = lamps"
        for does, lit in [
            ("ask stop", HAZARD),
            ("ask disengage; wait 0.2; ask stop", HAZARD),
            ("bumper front on", HAZARD),
            ("tick 1", ""),
            ("ask disengage; wait 0.2", ""),
        ]
    },
    # The gateway that finds the guard's note has not switched them on itself.
    "lamps after a stop of the guard's": "ready; note late; reply acquire none; wait 1; reply reset none; shine; "
    "engage; = lamps",
    **{
        f"{side}, at {speed_mps} m/s": f"driving {speed_mps}; bumper {side} on for 50ms; drive {speed_mps} 0 "
        f"0.04; = stopping; drive {speed_mps} 0 4; = rests, latched {hit}; reply engage {hit}; tick 40; reply "
        "reset none; = latched"
        for (side, hit), speed_mps in product(
            {"front": "front_bumper", "rear": "rear_bumper", "both": "front_bumper rear_bumper"}.items(), (1, -1)
        )
    },
    # From the hit to rest, whenever it comes between two body frames.
    **{
        f"hit at {speed_mps} m/s, {phase} ticks later": f"driving {speed_mps}; tick {phase}; mark; bumper front "
        f"on; drive {speed_mps} 0 4; = rests, way {way_m} {way_m - 0.04}"
        for (speed_mps, way_m), phase in product(((0.48, 0.14), (1.0, 0.41), (2.2, 1.56)), (0, 1))
    },
    # After a deliberate reset only motion away from the hit side until it is clear; then a hit is new.
    **{
        f"{side} is reset": f"{AT_BUMPER.format(side)}; drive {toward} 0 1; = rests, bound bumper; drive "
        f"{-toward} 0 2; = moves {-toward}, engaged; bumper {side} off; drive {toward} 0 3; = moves {toward}; "
        f"bumper {side} on; drive {toward} 0 0.06; = stopping"
        for side, toward in (("front", 0.5), ("rear", -0.5))
    },
    "the other one while it backs off": f"{AT_BUMPER.format('front')}; drive -0.5 0 2; bumper rear on; drive "
    "-0.5 0 0.06; = latched rear_bumper, stopping",
    "both are reset: no way is away": f"{AT_BUMPER.format('both')}; drive 0.5 0 1; = rests; drive -0.5 0 1; = "
    "rests",
    "latched standing by: nothing is sent": "ready; mark; bumper front on; wait 1; = latched front_bumper; wait "
    "1; = silent",
}


@rows(BUMPERS)
def test_a_bumper_that_is_hit(row: str) -> None:
    """Row 'bumper: immediate stop, latched', whichever way the robot goes; and row 'speed limit'."""
    play(row)


LOOP: dict[str, str] = {
    # Commanded a speed and still standing: a pause must not skip the order.
    "a late stop at the very start of motion": "ready; engage; drive 1 0 0.3; driven 1 unbelow 0.01; lag 150; "
    "tick 1; lag 0; = gear drive, for loop_late",
    "the guard's words are in the events and in the latch": "driving 1; links guard_sends:1 guard_stops:1 "
    f"guard_says:a_cause; drive 1; text guard commanding ended: {TEXTS[Reason.GUARD].means}| a cause; "
    "text latch a cause; links guard_stops:1 guard_says:a_cause,_the_robot_stands; tick 1; text guard the "
    "guard's stop has ended: a cause, the robot stands",
    "a stop of the guard's before the start": "new; note yesterday; wait 0.6; text latch | yesterday; reply "
    "acquire none; reply engage guard; reply reset none; engage",
    # Read before it is known that the guard acted: what was left is stopped at once, not when it moves.
    "the guard's frames are not taken for another computer's": "driving 1; echo; links guard_stops:1; tick 3; = "
    "events stop found_moving, unblocked other_commander",
    **{
        f"a tick is {late_ms} ms late": f"driving 1; late {late_ms}; = {'' if late_ms > 50 else 'un'}event fault "
        f"loop_late; drive 1 0 0.1; = {ruling}"
        for late_ms, ruling in (
            (50, "engaged"),
            (51, "engaged"),
            (100, "engaged"),
            (101, "stopped, for loop_late feedback_missing, says by 101 ms"),
            (400, "stopped, for loop_late feedback_missing, says by 400 ms"),
        )
    },
    # The loop stood still meanwhile.
    **{
        f"a stop of the guard's that was not seen, {begin}": f"{begin}; links guard_stops:1; tick 2; = latched "
        "guard; wait 6; reply acquire none; reply reset none; = latched"
        for begin in ("driving 1", "ready")
    },
    # The lower of the two limits, shown before it is engaged.
    **{
        f"{lacks}": f"ready unguarded; links {lacks}; wait 0.2; = limit 1.0; engage; = limit 1.0; drive 2 0 3; = "
        "told 1; drive 0 0 2; reply disengage none; rest; engage speed_limit_mps:0.4; = limit 0.4"
        for lacks in ("realtime:0", "guarded:0")
    },
    "no real-time priority any more, and then again": "driving 2; links realtime:0; drive 2 0 0.2; = limit 1.0, "
    "event fault no_realtime; drive 2 0 2; = told 1, engaged; links; drive 2 0 1; = limit 1.0",
    "no guard any more": "driving 1; links guarded:0; drive 1; = for unguarded; wait 6; reply acquire none; "
    "reply engage unguarded",
}


@rows(LOOP)
def test_a_loop_that_is_late_or_alone(row: str) -> None:
    """Rows 'loop late', 'the guard has stopped the robot', 'without real-time priority', 'limits scale down'."""
    play(row)


DRIVEN: dict[str, str] = {
    # A sender whose clock is a year off is served, and a wall clock that steps changes nothing.
    **{
        f"the clock steps by {step_s} s": f"driving 1; wall {step_s}; drive 1 0 1; = engaged, ruled none, moves 1"
        for step_s in (-31_536_000, 31_536_000, 3600, -3600)
    },
    # A robot that gathers speed slowly does not stand.
    **{
        f"motor {strength}, {slope_deg} deg, {payload_kg} kg": f"ready; engage; motor {strength}; slope "
        f"{slope_deg}; payload {payload_kg}; drive 1 0 5; drive 0 0 3; = engaged, latched"
        for strength, slope_deg, payload_kg in (
            (0.3, 5, 0),
            (0.5, 5, 100),
            (0.5, -10, 0),
            (1, 15, 100),
            (1, -20, 0),
        )
    },
    "it stands": "driving 0.5; drive 0 0 1.2; = moves 0, gear drive, unparking; drive 0 0 1; = gear drive, "
    "parking; drive -0.5 0 2; = moves -0.5",
}


@rows(DRIVEN)
def test_what_is_no_fault(row: str) -> None:
    """Rows 'commanded to move' and 'standing: parking brake after 1 s; unpark once allows the next'."""
    play(row)


FOUND = {
    f"{mps} m/s, {variant} configured as {configured}, without {silent or 'nothing'}": f"driving {mps} "
    f"variant:{variant}; succeed {configured}; "
    + "".join(f"silence {name}; " for name in silent)
    + f"wait {seconds}; = event stop found_moving; rest; = rests"
    for mps, variant, configured, silent, seconds in [
        *(
            (mps, "coarse", "auto", names, 1.3)
            for names in ((), *((one,) for one in (*SCALED, BODY)))
            for mps in (1, -1)
        ),
        # Read in the wrong scale it is beyond belief; and no pulses come.
        *((*row, (PULSES,), 0.3) for row in product((0.1, -2), ("coarse", "fine"), ("coarse", "fine"))),
        # By wheels of unknown scale: neither of the others comes.
        *((*row, "auto", ("Auto_DriveFeedBack", PULSES), 0.4) for row in product((0.2, -2), ("coarse", "fine"))),
    ]
}


@rows(FOUND)
def test_a_robot_found_moving_is_stopped(row: str) -> None:
    """Row 'found at start: moving by drive, wheels or pulses, and nobody sending': also without a mode."""
    play(row)


def test_the_ramp_goes_on_from_what_is_seen() -> None:
    """Row 'the ramp': held while the robot does not follow, never cut; a robot that comes free does not jump."""
    play("ready fast; engage; motor 0; drive 2.2 0 1; motor 1; follows 2.2; = moves 2.2")


def test_a_stop_asked_in_the_last_tenth_before_standstill_is_as_good_as_any() -> None:
    """Speeds that rose and fell have answered; only the time for which they read slow is missing."""
    rig, operator = driving(0.5)
    replies = {}
    for _ in range(300):
        handle = operator.ask("stop")
        rig.tick()
        replies[rig.replies[handle].detail] = rig.replies[handle].ok
    assert all(replies.values()), replies
    assert list(replies)[-2:] == ["the robot comes to rest", "the robot stands"]


# The operator and the link.


def test_an_operator_who_falls_silent_is_missed() -> None:
    """Row 'deadman: no valid drive command for 300 ms: controlled stop', by 1.2 m/s2 and no harder."""
    play(
        "driving 2; wait 0.28; = engaged; tick 4; = for deadman; mark; wait 0.5; = slower 0.6; rest; = in_order, "
        "latched"
    )
    # Liveliness and a lease that is kept are not the deadman.
    play("driving 1; renewing 40; = for deadman, holder first")


@pytest.mark.parametrize("stall_s", [0.5, 2.0, 3.0, 8.0])
@pytest.mark.parametrize("down_too", [True, False])
def test_a_stall_that_delivers_everything_at_once_moves_the_robot_by_nothing(
    stall_s: float,
    down_too: bool,  # noqa: FBT001 - a parameter
) -> None:
    """Row 'command age, by echo': the whole stream comes in one tick; ``down_too``: without new challenges."""
    scene = Scene("driving 1")
    rig, operator = scene.rig, scene.operator
    stalled: list[bytes] = []
    seen = rig.says.challenge
    for _ in range(round(stall_s * 50)):
        stalled.append(operator.drive_payload(1.0, challenge=seen if down_too else rig.says.challenge))
        rig.tick(2)
    rig.until(lambda: rig.says.state is ArbiterState.STANDBY or stall_s < 5, 0.1)
    scene.mark()
    is_at_rest = rig.says.state is ArbiterState.STANDBY
    assert is_at_rest or rig.says.state is ArbiterState.STOPPING
    for payload in stalled:
        rig.put(operator.name, "drive", payload)
    rig.tick()
    decided = [decision for decision in rig.decided[-len(stalled) :] if decision.request == "drive"]
    assert all(decision.reason is not Reason.NONE for decision in decided)
    scene.play("wait 6; = falling" + ", way 0.0001" * is_at_rest)


@pytest.mark.parametrize("stall_s", [0.5, 2.0, 8.0])
def test_a_stalled_stream_is_refused_although_the_robot_is_engaged_again(stall_s: float) -> None:
    """Row 'command age, by echo': only the age forbids it."""
    scene = Scene("driving 1")
    rig, operator = scene.rig, scene.operator
    stalled = []
    for _ in range(round(stall_s * 50)):
        stalled.append(operator.drive_payload(1.0))
        scene.play("ask renew; tick 2")
    while not scene.holds("standby"):
        scene.play("renewing 1")
    scene.play("ask engage; wait 0.5")
    for payload in stalled[:8]:
        rig.put(operator.name, "drive", payload)
    rig.tick()
    assert {decision.reason for decision in rig.decided[-8:]} <= {Reason.TOO_OLD, Reason.CHALLENGE_UNKNOWN}
    scene.play("wait 0.2; = for deadman, rests")


STOPPED = {
    f"{name}, {payload or 'empty'}": f"driving 1.5; send stop {name} {payload}; drive 1.5; = stopping; mark; wait "
    "0.5; = slower 1; rest; = in_order, latched remote_stop; reply acquire none; reply engage remote_stop"
    for name, payload in product(("first", "anyone", "-"), ("", "c1" * 1000, "81a56c65617365ff"))
}


@rows(STOPPED)
def test_the_remote_stop_is_served_from_anyone_with_any_payload(row: str) -> None:
    """Row 'stop: from any operator, lease or not: immediate stop with parking brake, latched'."""
    play(row)
