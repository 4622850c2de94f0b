"""Every fault that the chassis, the bus, the link or an operator may have, each against the whole command flow."""

from collections.abc import Iterator
from itertools import combinations, product
from typing import Any

import msgspec
import pytest

from gateway.chassis.cruiser.bursts import FrameMaker
from gateway.chassis.cruiser.frames import MOTION_FRAMES, load
from gateway.chassis.frame import ERROR, FD, Frame
from gateway.chassis.layout import check
from gateway.chassis.port import Actuation
from gateway.choice import CHASSIS
from gateway.guard.stopper import Cause
from gateway.sim.model import VirtualChassis
from gateway.telemetry.health import Links
from schemas.decisions import ArbiterState, EventKind
from schemas.messages import GearPosition, Variant
from schemas.reasons import TEXTS, Reason
from schemas.settings import YIELD_BURSTS, ChassisSettings, CommandSettings
from tests.support.frames import STANDING, Feedback
from tests.support.nights import by_night
from tests.support.rigs.gateway import GUARDED, MS, GatewayRig, Operator, driving, ready
from tests.support.rigs.scenes import play
from tests.support.strategies import VARIANTS, with_checksum

YEAR_NS = 365 * 24 * 3600 * 10**9
REQUIRED = ChassisSettings().required_feedback
FAST = ("Auto_GearFeedBack", "Auto_SteeringFeedBack", "Auto_DriveFeedBack")
CAN_IDS = {message.name: message.can_id for message in load(Variant.COARSE).feedback}
SCALED = ("Auto_DriveFeedBack", "Auto_WheelSpdFeedback")
"""Their speeds are of the one scale or the other; other frames are the same in both."""

COLUMNS = ((0, 7), (1, 6), (2, 5), (3, 4))
"""The bits of a byte: those at its ends, where signs and flags are, by day."""

NAMES = {can_id: name for name, can_id in CAN_IDS.items()}


def mostly_coarse(counts: range) -> list[Any]:
    """Each count with both scales; by day with the fine one only the last."""
    rows = list(product(counts, VARIANTS))
    return [row if row[1] is Variant.COARSE or row[0] == counts[-1] else by_night(*row) for row in rows]


def flipped(data: bytes, *bits: int) -> bytes:
    word = int.from_bytes(data, "little")
    for bit in bits:
        word ^= 1 << bit
    return word.to_bytes(8, "little")


def silent_pairs() -> Iterator[tuple[int, int]]:
    """The pairs of bits that the XOR does not see: those of one column."""
    for first, second in combinations(range(64), 2):
        if first % 8 == second % 8:
            yield first, second


def assert_stops(rig: GatewayRig, reason: Reason, within_s: float = 0.4) -> None:
    """The robot is stopped for this reason, by the whole sequence, and stands by at the end."""
    rig.until(lambda: rig.says.state is not ArbiterState.ENGAGED, within_s)
    assert rig.says.stop_reason is reason, rig.says
    begun_ns = rig.now_ns
    rig.until(lambda: rig.says.state is ArbiterState.STANDBY, 8)
    assert rig.speed_mps == 0
    assert_stop_order(rig, begun_ns)


def assert_stop_order(rig: GatewayRig, begun_ns: int) -> None:
    """Zero speed in gear, parking brake, neutral, disabled: in this order, and nothing is ever taken back."""
    reached = 0
    for at_ns, burst in rig.bursts:
        if at_ns < begun_ns:
            continue
        marks = (
            not burst["Auto_DriveCmd"]["TargetVelocity"],
            bool(burst["Auto_ParkingCmd"]["ParkingRequest"]),
            burst["Auto_GearCmd"]["TargetGear"] == "neutral",
            not burst["Auto_ParkingCmd"]["Enable"],
        )
        done = marks.index(False) if False in marks else len(marks)
        assert done >= reached, (at_ns, burst)
        reached = done
    assert reached == len(marks)


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
    """Each of the 224 pairs that pass, once while it drives: no faster than commanded, and no other way.

    A frame that reads as a takeover ends the output at once; then the robot is stopped as soon as the next one
    reads auto, because it still obeys what it was told.
    """
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
    """Nor do they make a latched robot be told anything."""
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


@pytest.mark.parametrize("name", REQUIRED)
@pytest.mark.parametrize("wrong", ["zeros", "reversed"])
def test_frames_of_zeros_or_with_swapped_bytes_stop_the_robot(name: str, wrong: str) -> None:
    """Both pass the checksum: the counter and the plausibility of the values find them."""
    rig, operator = driving(0.8)

    def corrupt(frame: Frame) -> Frame:
        if frame.can_id != CAN_IDS[name]:
            return frame
        return Frame(frame.can_id, bytes(8) if wrong == "zeros" else with_checksum(frame.data[6::-1] + b"\0"))

    rig.corrupt = corrupt
    operator.drive(0.8, seconds=0.6)
    assert not rig.says.engaged
    assert rig.says.stop_reason in {
        Reason.IMPLAUSIBLE_SPEED,
        Reason.FEEDBACK_FAULTY,
        Reason.FEEDBACK_MISSING,
        Reason.MODE_NOT_AUTO,
        Reason.HAND_TRANSMITTER,
        Reason.FOUND_MOVING,
    }
    rig.run(8)
    assert rig.speed_mps == 0


@pytest.mark.parametrize("length", [*range(8), 9, 12, 16, 64])
def test_frames_of_a_wrong_length_are_silence(length: int) -> None:
    """Whatever they hold: 0 to 7 bytes, and CAN FD."""
    rig, operator = driving()
    can_id = CAN_IDS["Auto_DriveFeedBack"]
    rig.corrupt = lambda frame: (
        Frame(can_id, (frame.data * 8)[:length], fd_flags=FD if length > 8 else 0)
        if frame.can_id == can_id
        else frame
    )
    operator.drive(1.0, seconds=0.04)
    assert_stops(rig, Reason.FEEDBACK_MISSING)


# Supervision.


@pytest.mark.parametrize("name", STANDING)
def test_what_is_engaged_without_each_message(name: str) -> None:
    """Row 'engage: every feedback that chassis.required_feedback names': not what the manual calls reserved."""
    rig = GatewayRig()
    rig.fault(f"silence {name}")
    rig.run(1)
    operator = Operator(rig)
    operator.take_lease()
    handle = operator.ask("engage")
    rig.run(0.5)
    assert rig.replies[handle].ok is (name not in REQUIRED), rig.replies[handle]
    if name in REQUIRED:
        assert rig.replies[handle].reason is Reason.FEEDBACK_MISSING
        assert name in rig.replies[handle].detail


BODY = "Auto_MileageAndBodyFeedback"
SPEEDS = ("Auto_DriveFeedBack", "Auto_WheelSpdFeedback")
REMOTE = "transmitter remote; sticks {} 0"
AT_BUMPER = "ready; bumper {} on; wait 1; reply acquire none; reply reset none; engage"
"""The bumper is pressed, and was reset: the robot is engaged to back off."""


def freeze(*names: str) -> str:
    return "; ".join(f"freeze {name}" for name in names)


def borne_s(name: str) -> float:
    """Row 'feedback silence, per frame, over 10 periods (at least 100 ms): stop'."""
    return max(100, 10 * load(Variant.COARSE).messages[name].period_ns // MS) / 1000 - 0.02


FEEDBACK: dict[str, str] = {
    **{
        f"silence of {name}": f"driving 1; silence {name}; drive 1 0 {borne_s(name)}; = engaged; drive 1 0 0.1; "
        "= for feedback_missing; rest; = rests"
        for name in REQUIRED
    },
    **{
        f"{fault} of {name}, which is not required": f"driving 1; {fault} {name}; drive 1 0 2; = engaged"
        for name, fault in product(sorted(set(STANDING) - set(REQUIRED)), ("silence", "checksum", "stuck"))
    },
    **{
        f"five checksums of {name} in a second": f"driving 1; checksum {name} for 4 frames; drive 1 0 0.5; "
        f"= engaged; wait 0; checksum {name} for 1 frames; drive 1 0 0.1; = for feedback_faulty"
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
            (SPEEDS, (0.02, 0.2, 0.3), 4.0),
            (("all",), (0.6, 1.2, 1.8, 2.4, 3.0), 5.0),
            (SPEEDS, (0.6, 1.2, 1.8, 2.4), 5.0),
        ]
        for driven_s in times_s
    },
    # At a command that need not show, either of pulses and mileage is enough.
    **{
        f"speeds and {name} frozen of a slow robot": f"ready; engage; mark; {freeze(*SPEEDS, name)}; "
        "drive 0.2 0 20; "
        f"= first feedback_frozen, rests, way {most_m}"
        for name, most_m in ((BODY, 0.6), ("Auto_WheelPulseFeedback", 3.2))
    },
    "another scale while it stands": "ready; engage; drive 0 0 0.2; variant fine; drive 0 0 0.6; "
    # Read in the wrong scale its wheels turn at 33 m/s.
    "= stopped, for variant_unknown implausible_speed, told 0",
}


@pytest.mark.parametrize("scene", FEEDBACK.values(), ids=FEEDBACK)
def test_feedback_that_fails(scene: str) -> None:
    """Rows 'feedback silence', 'checksum faults', 'commanded to move' and 'frozen feedback'."""
    play(scene)


@pytest.mark.parametrize("name", FAST)
@pytest.mark.parametrize(
    "step", [step if step in {0, 2, 8, 15} else by_night(step) for step in (0, *range(2, 16))]
)
def test_a_counter_that_stands_or_jumps_stops_the_robot(name: str, step: int) -> None:
    """Row 'alive counter: +1 per fault, -1 per good frame, at 5: stop'; frozen, and every step from 2 to 15."""
    fault = f"skip {name} by {step}" if step else f"stuck {name}"
    play(
        f"driving 1; {fault}; drive 1 0 0.04; = engaged; drive 1 0 0.06; = stopped, "
        "for feedback_faulty feedback_missing"
    )


BUS: dict[str, str] = {
    # At zero speed the parking brake comes second in a burst; the enables stay.
    **{
        f"takes {taken} of each burst of a stop": f"driving 1; ask stop; takes {taken}; wait 3; = rests, "
        + ("parked, phase hold" if taken > 1 else "unparked, phase park")
        for taken in range(1, 5)
    },
    # Nobody who gave way in the hold of a stop releases the brake afterwards, not for one frame.
    **{
        f"a parked robot and {by}": f"driving 1; ask stop; hold; tick 20; = phase hold; mark; {by}; wait 6; "
        "= spoken, braked"
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
    "the controller leaves it": "driving 1; controller off; rest; = for bus_off, event fault bus_off; "
    "reply acquire none; reply engage bus_off; controller active; engage; = engaged",
    "another computer": "driving 1; foreign 18C4D3D0 every 10ms for 50ms; drive 1 0 0.04; = stopping, "
    "for other_commander",
}


@pytest.mark.parametrize("scene", BUS.values(), ids=BUS)
def test_a_bus_that_fails(scene: str) -> None:
    """Rows 'the bus', 'controller' and 'other commander'."""
    play(scene)


@pytest.mark.parametrize(("takes", "variant"), mostly_coarse(range(5)))
def test_a_full_buffer_stops_the_robot_and_nothing_stale_leaves(takes: int, variant: Variant) -> None:
    """Five ticks in a row whose frames are not taken; what was not taken is made anew, never sent later."""
    play(
        f"driving 1; takes {takes}; drive 2 20 0.04; = engaged; tick 2; = for send_failed; wait 0.3; takes all; "
        "tick 1; = below 1; wait 6; = rests, standby",
        variant,
    )


@pytest.mark.parametrize(("takes", "variant"), mostly_coarse(range(1, 5)))
def test_a_bus_that_takes_a_part_of_each_burst_does_not_keep_the_robot_going(takes: int, variant: Variant) -> None:
    """As a full queue does that drains a little each tick: the speed goes first, and ramps down."""
    play(
        f"driving 1; mark; takes {takes}; ask stop; drive 1 0 0.05; = for remote_stop; wait 3; = rests, "
        "falling, mute",
        variant,
    )


TAKEN: dict[str, str] = {
    **{
        f"{name} is cleared at speed": f"driving 1; deaf; unset {name}; drive 1 0 0.06; = for mode_not_auto, "
        "told 0, "
        "parking; hears; drive 1 0 4; = standby, ruled not_engaged, rests"
        for name in MOTION_FRAMES
    },
    **{
        f"{name} is cleared at rest": f"ready; engage; deaf; unset {name}; drive 1 0 0.06; "
        "= events takeover mode_not_auto; mark; hears; drive 1 0 2; = silent, ruled not_engaged"
        for name in MOTION_FRAMES
    },
    # What a ramp left in the chassis is not executed when it is given back; the gateway may be gone by then.
    **{
        f"taken while its mode is unknown for {away_ms} ms": f"driving 1; silence {BODY} for {away_ms}ms; "
        f"{REMOTE.format(1)}; drive 1 0 1; = standby; sticks 0 0; wait 3; mark; deaf; transmitter command; "
        "wait 5; "
        "= rests, parked, way 0.05"
        for away_ms in range(400, 601, 20)
    },
    # The bus returns, and the remote control drives since then; a body frame that comes in time is waited for.
    **{
        f"owed a stop for {phase_ms} ms": f"driving 1; bus lost; {REMOTE.format(2)}; tick 2; ask stop; "
        f"tick {phase_ms // 10 + 5}; bus again; silence {BODY} for {phase_ms}ms; mark; wait 2; = speechless, "
        "braked" + ", unspoken" * (phase_ms <= 150)
        for phase_ms in range(10, 410, 10)
    },
    "given back in motion": f"driving 1; {REMOTE.format(1)}; drive 1 0 1; mark; transmitter command; wait 4; "
    "= rests, spoken, speechless",
    "given back while it is latched": f"ready; ask stop; wait 1; {REMOTE.format(0.3)}; wait 1; sticks 0 0; "
    "wait 1; "
    "transmitter command; wait 3; = latched remote_stop, parked",
    "moved twice soon after a stop, which says nothing about its brake": "driving 0.5; ask disengage; wait 4; "
    + f"{REMOTE.format(0.8)}; wait 2; transmitter command; wait 5; " * 2
    + "= event stop found_moving, latched",
}


@pytest.mark.parametrize("scene", TAKEN.values(), ids=TAKEN)
def test_a_robot_that_somebody_takes(scene: str) -> None:
    """Rows 'mode leaves auto', 'on yielding to mode remote' and 'given back'."""
    play(scene)


BUMPERS: dict[str, str] = {
    **{
        f"{side}, at {speed_mps} m/s": f"driving {speed_mps}; bumper {side} on for 50ms; "
        f"drive {speed_mps} 0 0.04; "
        f"= stopping; drive {speed_mps} 0 4; = rests, latched {hit}; reply engage {hit}; tick 40; "
        "reply reset none; "
        "= latched"
        for (side, hit), speed_mps in product(
            {"front": "front_bumper", "rear": "rear_bumper", "both": "front_bumper rear_bumper"}.items(), (1, -1)
        )
    },
    # From the hit to rest, whenever it comes between two body frames.
    **{
        f"hit at {speed_mps} m/s, {phase} ticks later": f"driving {speed_mps}; tick {phase}; mark; "
        "bumper front on; "
        f"drive {speed_mps} 0 4; = rests, way {way_m} {way_m - 0.04}"
        for (speed_mps, way_m), phase in product(((0.48, 0.14), (1.0, 0.41), (2.2, 1.56)), (0, 1))
    },
    # After a deliberate reset only motion away from the hit side until it is clear; then a hit is new.
    **{
        f"{side} is reset": f"{AT_BUMPER.format(side)}; drive {toward} 0 1; = rests, bound bumper; "
        f"drive {-toward} 0 2; = moves {-toward}, engaged; bumper {side} off; drive {toward} 0 3; "
        f"= moves {toward}; "
        f"bumper {side} on; drive {toward} 0 0.06; = stopping"
        for side, toward in (("front", 0.5), ("rear", -0.5))
    },
    "the other one while it backs off": f"{AT_BUMPER.format('front')}; drive -0.5 0 2; bumper rear on; "
    "drive -0.5 0 0.06; = latched rear_bumper, stopping",
    "both are reset: no way is away": f"{AT_BUMPER.format('both')}; drive 0.5 0 1; = rests; drive -0.5 0 1; "
    "= rests",
    "latched standing by: nothing is sent": "ready; mark; bumper front on; wait 1; = latched front_bumper; "
    "wait 1; "
    "= silent",
}


@pytest.mark.parametrize("scene", BUMPERS.values(), ids=BUMPERS)
def test_a_bumper_that_is_hit(scene: str) -> None:
    """Row 'bumper: immediate stop, latched', whichever way the robot goes; and row 'speed limit'."""
    play(scene)


LOOP: dict[str, str] = {
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
        f"a stop of the guard's that was not seen, {begin}": f"{begin}; links guard_stops:1; tick 2; "
        "= latched guard; "
        "wait 6; reply acquire none; reply reset none; = latched"
        for begin in ("driving 1", "ready")
    },
    # The lower of the two limits, said before it is engaged.
    **{
        f"{lacks}": f"ready unguarded; links {lacks}; wait 0.2; = limit 1.0; engage; = limit 1.0; drive 2 0 3; "
        "= told 1; "
        "drive 0 0 2; reply disengage none; rest; engage 0.4; = limit 0.4"
        for lacks in ("realtime:0", "guarded:0")
    },
    "no real-time priority any more, and then again": "driving 2; links realtime:0; drive 2 0 0.2; = limit 1.0, "
    "event fault no_realtime; drive 2 0 2; = told 1, engaged; links; drive 2 0 1; = limit 1.0",
    "no guard any more": "driving 1; links guarded:0; drive 1; = for unguarded; wait 6; reply acquire none; "
    "reply engage unguarded",
}


@pytest.mark.parametrize("scene", LOOP.values(), ids=LOOP)
def test_a_loop_that_is_late_or_alone(scene: str) -> None:
    """Rows 'loop late', 'the guard has stopped the robot', 'without real-time priority', 'limits scale down'."""
    play(scene)


DRIVEN: dict[str, str] = {
    # A robot that gathers speed slowly does not stand.
    **{
        f"motor {strength}, {slope_deg} deg, {payload_kg} kg": f"ready; engage; motor {strength}; "
        f"slope {slope_deg}; "
        f"payload {payload_kg}; drive 1 0 5; drive 0 0 3; = engaged, latched"
        for strength, slope_deg, payload_kg in (
            (0.3, 5, 0),
            (0.5, 5, 100),
            (0.5, -10, 0),
            (1, 15, 100),
            (1, -20, 0),
        )
    },
    "it stands": "driving 0.5; drive 0 0 1.2; = moves 0, gear drive, unparking; drive 0 0 1; = gear drive, "
    "parking; "
    "drive -0.5 0 2; = moves -0.5",
}


@pytest.mark.parametrize("scene", DRIVEN.values(), ids=DRIVEN)
def test_what_is_no_fault(scene: str) -> None:
    """Rows 'commanded to move' and 'standing: parking brake after 1 s; unpark once allows the next'."""
    play(scene)


# The bus.


@pytest.mark.parametrize(("ticks", "variant"), mostly_coarse(range(1, 5)))
def test_a_short_jam_costs_only_its_time(ticks: int, variant: Variant) -> None:
    """The way goes on from what the chassis was told last: no jump, and the gate sees no fault."""
    rig, operator = ready(variant)
    operator.engage()
    operator.drive(2.0, 20.0, 0.5)
    before_mps = rig.told_mps
    rig.takes = 0
    rig.tick(ticks)
    rig.takes = None
    rig.put(operator.name, "drive", operator.drive_payload(2.0, -20.0))
    rig.tick()
    assert before_mps - 0.05 <= rig.told_mps <= before_mps + 0.05
    operator.drive(2.0, 5.0, 1)
    assert rig.says.engaged


def test_a_stop_that_nobody_heard_does_not_go_on_to_neutral() -> None:
    """A jammed bus: the ramp is still to come when it is free again."""
    rig, _ = driving(1.5)
    rig.put("anyone", "stop", b"")
    rig.takes = 0
    rig.run(5)
    rig.takes = None
    free_ns = rig.now_ns
    rig.until(lambda: rig.says.state is ArbiterState.STANDBY, 8)
    assert_stop_order(rig, free_ns)
    assert rig.speed_mps == 0


def test_a_stop_that_was_held_up_does_not_go_on_from_the_old_speed() -> None:
    """The bus takes nothing for 10 s; meanwhile others bring the robot to rest and switch it on anew."""
    rig, _ = driving(1.5)
    rig.put("anyone", "stop", b"")
    rig.tick(5)
    rig.takes = 0
    rig.run(10)
    rig.chassis = VirtualChassis(CHASSIS, Variant.COARSE, rig.now_ns)
    rig.takes = None
    heard = len(rig.heard)
    rig.run(6)
    assert rig.heard[heard:]
    assert not any(rig.heard[heard:])
    assert rig.says.state is ArbiterState.STANDBY


# The chassis.


def test_a_chassis_that_reads_auto_again_is_not_left_to_its_old_command() -> None:
    """The mode leaves auto for one frame only, and the chassis goes on by what it was told: it is stopped."""
    rig, operator = driving(1.5)
    left = [1]

    def corrupt(frame: Frame) -> Frame:
        if NAMES.get(frame.can_id) != "Auto_MileageAndBodyFeedback" or not left:
            return frame
        left.pop()
        return Frame(frame.can_id, with_checksum(flipped(frame.data, 41)))

    rig.corrupt = corrupt
    operator.drive(1.5, seconds=0.06)
    assert rig.says.state is ArbiterState.STOPPING
    assert rig.says.stop_reason is Reason.MODE_NOT_AUTO
    rig.run(6)
    assert rig.speed_mps == 0


def test_a_takeover_that_is_followed_by_silence_is_not_believed() -> None:
    """One frame reads remote, then none comes: the chassis may obey its old command for ever, so it is stopped."""
    rig, operator = driving(1.0)
    left = [1]

    def corrupt(frame: Frame) -> Frame | None:
        if NAMES.get(frame.can_id) != "Auto_MileageAndBodyFeedback":
            return frame
        return Frame(frame.can_id, with_checksum(flipped(frame.data, 40))) if left and left.pop() else None

    rig.corrupt = corrupt
    operator.drive(1.0, seconds=0.06)
    assert rig.says.state is ArbiterState.STANDBY
    rig.run(6)
    assert rig.event_reasons(EventKind.STOP) == [Reason.FOUND_MOVING]
    assert rig.speed_mps == 0


def lamps(rig: GatewayRig) -> set[str]:
    """The lamps that the chassis has been told to have on."""
    command = rig.chassis._commands.get("Auto_LightCmd", {})
    return {name for name in ("Headlamp", "LeftIndicator", "RightIndicator") if command.get(name)}


HAZARD = {"LeftIndicator", "RightIndicator"}


@pytest.mark.parametrize("cause", ["remote stop", "remote stop of a stop", "bumper", "deadman", "disengage"])
def test_a_latched_stop_leaves_the_hazard_lights_on_until_the_next_engage(cause: str) -> None:
    """Row 'a latched stop': both indicators on in place of off; any other stop puts the lamps out."""
    rig, operator = driving()
    assert operator.reason("light", headlamp=True) is Reason.NONE
    if cause == "bumper":
        rig.fault("bumper front on")
    elif cause in {"remote stop of a stop", "disengage"}:
        operator.ask("disengage")
        rig.run(0.2)
    if cause.startswith("remote stop"):
        operator.ask("stop")
    rig.until(lambda: rig.says.state is ArbiterState.STANDBY, 10)
    lit = HAZARD if cause in {"remote stop", "remote stop of a stop", "bumper"} else set()
    assert lamps(rig) == lit
    rig.fault("clear")
    operator.take_lease()
    rig.run(1)
    assert operator.reason("reset") is Reason.NONE
    assert lamps(rig) == lit
    operator.engage()
    assert lamps(rig) == set()


def test_the_hazard_lights_of_a_guards_stop_go_out_with_the_next_engage() -> None:
    """The gateway that finds the guard's note has not switched them on itself."""
    rig, operator = ready()
    rig.core.latch_guard_stop("late", rig.now_ns)
    operator.take_lease()
    rig.run(1)
    assert operator.reason("reset") is Reason.NONE
    rig.chassis._commands["Auto_LightCmd"] = dict.fromkeys(HAZARD, True)
    operator.engage()
    assert lamps(rig) == set()


def test_the_hand_transmitter_takes_over() -> None:
    """Row 'on yielding to mode remote: at most 10 bursts of zero speed, same gear, parking, then silence'."""
    rig, operator = driving(1.0)
    rig.fault("transmitter remote")
    rig.fault("sticks 0.3 0")
    operator.drive(1.0, seconds=0.06)
    assert rig.says.state is ArbiterState.STANDBY
    assert rig.event_reasons(EventKind.TAKEOVER) == [Reason.HAND_TRANSMITTER]
    operator.drive(1.0, seconds=2)
    last = [burst for _, burst in rig.bursts[-YIELD_BURSTS:]]
    assert {burst["Auto_DriveCmd"]["TargetVelocity"] for burst in last} == {0.0}
    assert {burst["Auto_GearCmd"]["TargetGear"] for burst in last} == {"drive"}
    assert {burst["Auto_ParkingCmd"]["ParkingRequest"] for burst in last} == {True}
    assert rig.bursts[-YIELD_BURSTS - 1][1]["Auto_DriveCmd"]["TargetVelocity"]
    sent = len(rig.out)
    operator.drive(1.0, seconds=1)
    assert len(rig.out) == sent
    assert operator.reason("engage") is Reason.HAND_TRANSMITTER


def hinder(rig: GatewayRig, obstacle: Reason) -> None:
    """From here on this keeps a stop from being carried out, or from being known to be."""
    match obstacle:
        case Reason.BUS_DOWN:
            rig.links = Links(bus_up=False, guarded=True, bus_losses=1)
        case Reason.BUS_OFF:
            rig.core.receive_frame(Frame(ERROR | 0x40, bytes(8)), rig.now_ns)
        case Reason.SEND_FAILED:
            rig.takes = 0
            rig.tick()
        case Reason.HAND_TRANSMITTER:
            rig.fault("transmitter remote")
            rig.fault("sticks 0.8 0")
            rig.run(1)
        case Reason.OTHER_COMMANDER:
            rig.fault("foreign 18C4D3D0 every 10ms for 1s")
            rig.tick(2)
        case Reason.FEEDBACK_MISSING:
            rig.corrupt = lambda _frame: None
            rig.run(0.6)


@pytest.mark.parametrize(
    ("obstacle", "words"),
    [
        (Reason.BUS_DOWN, "latched; not carried out: the robot is not seen to stand"),
        (Reason.BUS_OFF, "latched; told, but not known to be obeyed: the robot moves at 1.00 m/s"),
        (Reason.SEND_FAILED, "latched; told, but not known to be obeyed: the robot moves at 1.00 m/s"),
        (Reason.HAND_TRANSMITTER, "latched; not carried out: the robot moves at 0.80 m/s"),
        (Reason.OTHER_COMMANDER, "latched; told, but not known to be obeyed: the robot moves at 1.00 m/s"),
        (Reason.FEEDBACK_MISSING, "latched; told, but not known to be obeyed: the robot is not seen to stand"),
        (Reason.NONE, "the robot moves at 1.00 m/s"),
    ],
)
def test_a_stop_that_cannot_be_carried_out_says_so(obstacle: Reason, words: str) -> None:
    """Row 'a stop that cannot be carried out: the reply says so with reason and what the robot does now'."""
    rig, operator = driving(1.0)
    hinder(rig, obstacle)
    handle = operator.ask("stop")
    rig.tick()
    reply = rig.replies[handle]
    assert (reply.ok, reply.reason) == (obstacle is Reason.NONE, obstacle)
    assert reply.detail.endswith(words)
    assert rig.says.latched == [Reason.REMOTE_STOP]


def engaged_at_bumper(side: str) -> tuple[GatewayRig, Operator]:
    """The bumper is pressed, and was reset: the robot is engaged to back off."""
    rig, operator = ready()
    rig.fault(f"bumper {side} on")
    rig.run(1)
    operator.take_lease()
    assert operator.reason("reset") is Reason.NONE
    operator.engage()
    return rig, operator


@pytest.mark.parametrize("chatter_ms", [20, 40, 80])
def test_a_bumper_that_bounces_while_the_robot_backs_off_latches_nothing_new(chatter_ms: int) -> None:
    """Row 'bumper: contact bounce of an acknowledged bumper latches nothing new', and a later hit does."""
    rig, operator = engaged_at_bumper("front")
    body, bumper_bit = CAN_IDS["Auto_MileageAndBodyFeedback"], 32

    def bounce(frame: Frame) -> Frame:
        if frame.can_id != body or rig.now_ns // MS // chatter_ms % 2:
            return frame
        return Frame(frame.can_id, with_checksum(flipped(frame.data, bumper_bit)))

    rig.corrupt = bounce
    operator.drive(-0.3, seconds=2)
    assert (rig.says.latched, rig.says.engaged) == ([], True)
    assert rig.speed_mps < -0.2
    rig.corrupt = lambda frame: frame
    rig.fault("bumper front off")
    operator.drive(-0.3, seconds=0.4)
    assert rig.says.latched == []
    rig.fault("bumper front on for 50ms")
    operator.drive(-0.3, seconds=0.1)
    assert rig.says.latched == [Reason.FRONT_BUMPER]


def test_a_body_frame_that_is_frozen_hides_a_bumper_for_four_metres_at_most() -> None:
    """Its counter runs and its checksum fits: the wheels contradict its mileage."""
    rig, operator = driving(1.0)
    body, frozen = CAN_IDS["Auto_MileageAndBodyFeedback"], list[bytes]()

    def freeze(frame: Frame) -> Frame:
        if frame.can_id != body:
            return frame
        frozen.append(frame.data[:6])
        return Frame(frame.can_id, with_checksum(frozen[0] + frame.data[6:]))

    rig.corrupt = freeze
    operator.drive(1.0, seconds=0.1)
    rig.fault("bumper front on")
    begun_m = rig.chassis.state.mileage_m
    operator.drive(1.0, seconds=6)
    assert rig.says.latched == [Reason.FEEDBACK_FROZEN]
    assert rig.chassis.state.mileage_m - begun_m < 4


@pytest.mark.parametrize("crashed", [True, False])
def test_the_first_robot_found_moving_after_a_crash_is_latched(*, crashed: bool) -> None:
    """Row 'guard and gateway died together, only a gateway returns'; one that is pushed by hand later is not."""
    rig, operator = ready()
    if crashed:
        rig.core.note_crash(rig.now_ns)
    for latched in ([Reason.FOUND_MOVING] if crashed else [], []):
        rig.fault("slope -20")
        rig.chassis.adopt(speed_mps=0.5, angle_deg=0.0, gear=GearPosition.DRIVE, parked=False)
        rig.run(0.5)
        assert rig.event_reasons(EventKind.STOP)[-1] is Reason.FOUND_MOVING
        assert rig.says.latched == latched
        rig.run(15)
        assert rig.speed_mps == 0
        assert operator.take_lease() is Reason.NONE
        assert operator.reason("reset") is Reason.NONE
        operator.reason("release")


AT_FULL_SPEED = CommandSettings(speed_limit_mps=2.222, travel_delay_m=3.0)
ALL = ("all",)
SPEEDS = ("Auto_DriveFeedBack", "Auto_WheelSpdFeedback")


def test_a_blocked_robot_gives_up_and_was_never_told_to_jump() -> None:
    """Rows 'commanded to move' and 'the ramp': within 2 s, and the speed is held 0.5 m/s above the seen one."""
    rig, operator = ready(command=AT_FULL_SPEED)
    operator.engage()
    rig.fault("motor 0")
    operator.drive(2.2, seconds=2)
    assert rig.says.latched == [Reason.NOT_MOVING]
    assert max(float(burst["Auto_DriveCmd"]["TargetVelocity"]) for _, burst in rig.bursts) == pytest.approx(0.48)


def test_the_ramp_goes_on_from_what_is_seen() -> None:
    """Row 'the ramp': held while the robot does not follow, never cut; a robot that comes free does not jump."""
    rig, operator = ready(command=AT_FULL_SPEED)
    operator.engage()
    rig.fault("motor 0")
    operator.drive(2.2, seconds=1)
    rig.fault("motor 1")
    for _ in range(200):
        operator.drive(2.2)
        assert rig.told_mps <= max(0.5, rig.speed_mps + 0.5 + 0.04)
    assert rig.speed_mps == pytest.approx(2.2, abs=0.05)


@pytest.mark.parametrize("acceleration_mps2", [0.4, 0.8, 1.5])
@pytest.mark.parametrize("creep_mps", [0.04, 0.05, 0.07])
@pytest.mark.parametrize("variant", [Variant.COARSE, Variant.FINE])
def test_a_robot_that_creeps_and_is_then_driven_off_is_not_frozen(
    creep_mps: float, acceleration_mps2: float, variant: Variant
) -> None:
    """Row 'frozen feedback': at one coarse bit the speeds read zero, and the pulses count rightly."""
    rig, operator = ready(variant, CommandSettings(acceleration_mps2=acceleration_mps2))
    operator.engage()
    operator.drive(creep_mps, seconds=2)
    operator.drive(0.8, seconds=3)
    assert (rig.says.latched, rig.says.engaged) == ([], True)


def test_a_robot_stands_only_if_its_feedback_has_answered() -> None:
    """Row '"the robot stands"': speeds that read zero since before a speed was told prove nothing."""
    rig, operator = ready(command=AT_FULL_SPEED)
    operator.engage()
    handle = operator.ask("stop")
    rig.tick()
    assert (rig.replies[handle].ok, rig.replies[handle].detail) == (True, "the robot stands")
    rig.run(4)
    operator.take_lease()
    assert operator.reason("reset") is Reason.NONE
    operator.engage()
    operator.drive(2.2, seconds=0.16)
    rig.fault("freeze all")
    operator.drive(2.2, seconds=0.5)
    handle = operator.ask("stop")
    rig.tick()
    assert (rig.replies[handle].ok, rig.replies[handle].reason) == (False, Reason.NOT_CONFIRMED)
    assert "the speed reads 0, unchanged for" in rig.replies[handle].detail
    assert rig.says.rest_confirmed is False
    rig.fault("clear")
    rig.run(6)
    assert rig.says.rest_confirmed is True
    assert [event.text for event in rig.events if event.kind is EventKind.STOPPED][-1].endswith("and stands")


def test_a_stop_asked_in_the_last_tenth_before_standstill_is_as_good_as_any() -> None:
    """The same row: speeds that rose and fell have answered; only the time for which they read slow is missing."""
    rig, operator = driving(0.5)
    replies = {}
    for _ in range(300):
        handle = operator.ask("stop")
        rig.tick()
        replies[rig.replies[handle].detail] = rig.replies[handle].ok
    assert all(replies.values()), replies
    assert list(replies)[-2:] == ["the robot comes to rest", "the robot stands"]


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_chassis_of_the_other_scale_is_found_and_told(variant: Variant) -> None:
    """Row 'plausibility: over by 0.3 m/s and 1.5 x for 300 ms: stop, latched, and say which scale fits'."""
    rig, operator = ready(variant)
    operator.engage()
    rig.fault("scale wrong")
    operator.drive(1.0, seconds=2)
    assert Reason.IMPLAUSIBLE_SPEED in rig.says.latched
    [text] = [
        event.text
        for event in rig.events
        if (event.kind, event.reason) == (EventKind.LATCH, Reason.IMPLAUSIBLE_SPEED)
    ]
    other = "coarse" if variant is Variant.FINE else "fine"
    assert f"the {other} scale of the drive frames would fit" in text
    rig.run(6)
    assert rig.speed_mps == 0


def test_a_variant_in_doubt_at_speed_does_not_silence_the_stop() -> None:
    """The gate lets no speed pass in an unknown scale: the stop begins at zero, and is heard."""
    rig, operator = driving(1.5)
    detector = rig.core._detector
    detector.contradicted = True
    rig.core._apply_variant()
    operator.drive(1.5)
    assert rig.says.stop_reason is Reason.VARIANT_UNKNOWN
    assert rig.told
    assert rig.told_mps == 0
    rig.run(6)
    assert rig.speed_mps == 0
    assert rig.says.state is ArbiterState.STANDBY


def assert_found_moving(
    speed_mps: float, variant: Variant, silent: tuple[str, ...], seconds: float, configured: str = "auto"
) -> None:
    """A gateway that starts beside a robot that moves, without these frames, stops it within this time."""
    rig, _ = driving(speed_mps, variant=variant)
    found = GatewayRig(variant, configured=configured, now_ns=rig.now_ns)
    found.chassis = rig.chassis
    for name in silent:
        found.fault(f"silence {name}")
    found.run(seconds)
    assert found.event_reasons(EventKind.STOP)[:1] == [Reason.FOUND_MOVING]
    found.until(lambda: found.says.state is ArbiterState.STANDBY, 8)
    assert found.speed_mps == 0


@pytest.mark.parametrize(
    "missing", [(), ("Auto_DriveFeedBack",), ("Auto_WheelSpdFeedback",), ("Auto_MileageAndBodyFeedback",)]
)
@pytest.mark.parametrize("speed_mps", [1.0, -1.0])
def test_a_robot_found_moving_is_stopped_whatever_frame_is_missing(
    missing: tuple[str, ...], speed_mps: float
) -> None:
    """Row 'found at start: moving by drive, wheels or pulses, and nobody sending': also with no mode at hand."""
    assert_found_moving(speed_mps, Variant.COARSE, missing, 1.3)


@pytest.mark.parametrize("configured", ["coarse", "fine"])
@pytest.mark.parametrize("variant", [Variant.COARSE, Variant.FINE])
@pytest.mark.parametrize("speed_mps", [0.1, -2.0])
def test_a_robot_found_moving_is_stopped_whatever_scale_is_configured(
    speed_mps: float, variant: Variant, configured: str
) -> None:
    """Row 'found at start: moving by drive': read in the wrong scale it is beyond belief; and no pulses come."""
    assert_found_moving(speed_mps, variant, ("Auto_WheelPulseFeedback",), 0.3, configured)


@pytest.mark.parametrize("variant", [Variant.COARSE, Variant.FINE])
@pytest.mark.parametrize("speed_mps", [0.2, -2.0])
def test_a_robot_found_moving_is_stopped_by_wheels_of_unknown_scale(speed_mps: float, variant: Variant) -> None:
    """Row 'found at start: moving by drive, wheels or pulses': neither of the others comes."""
    assert_found_moving(speed_mps, variant, ("Auto_DriveFeedBack", "Auto_WheelPulseFeedback"), 0.4)


def test_a_robot_that_another_computer_drives_is_left_alone() -> None:
    """Row 'standing by: silent on the bus (another computer may own it)'."""
    rig, _ = driving(1.0)
    found = GatewayRig(now_ns=rig.now_ns)
    found.chassis = rig.chassis
    found.fault("foreign 18C4D3D0 every 50ms")
    found.run(2)
    assert found.bursts == []
    assert found.speed_mps > 0.9


# The operator and the link.


def test_an_operator_who_falls_silent_is_missed() -> None:
    """Row 'deadman: no acceptable drive command for 300 ms: controlled stop', by 1.2 m/s2 and no harder."""
    rig, _ = driving(2.0)
    rig.run(0.28)
    assert rig.says.engaged
    rig.tick(4)
    assert rig.says.stop_reason is Reason.DEADMAN
    before_mps, begun_ns = rig.told_mps, rig.now_ns
    rig.run(0.5)
    assert before_mps - rig.told_mps == pytest.approx(0.6, abs=0.06)
    rig.until(lambda: rig.says.state is ArbiterState.STANDBY, 8)
    assert_stop_order(rig, begun_ns)
    assert rig.says.latched == []


def test_an_operator_who_only_renews_is_no_driver() -> None:
    """Liveliness and a lease that is kept are not the deadman."""
    rig, operator = driving()
    for _ in range(40):
        operator.ask("renew")
        rig.tick()
    assert rig.says.stop_reason is Reason.DEADMAN
    assert rig.says.lease_holder == "first"


@pytest.mark.parametrize("stall_s", [0.5, 2.0, 3.0, 8.0])
@pytest.mark.parametrize("down_too", [True, False])
def test_a_stall_that_delivers_everything_at_once_moves_the_robot_by_nothing(
    stall_s: float,
    down_too: bool,  # noqa: FBT001 - a parameter
) -> None:
    """Row 'command age, by echo: over 1 s: refused'. The stream of the whole stall comes in one tick.

    ``down_too``: the operator sees no new challenge meanwhile; otherwise only the way up is stalled.
    """
    rig, operator = driving(1.0)
    stalled: list[bytes] = []
    seen = rig.says.challenge
    for _ in range(round(stall_s * 50)):
        stalled.append(operator.drive_payload(1.0, challenge=seen if down_too else rig.says.challenge))
        rig.tick(2)
    rig.until(lambda: rig.says.state is ArbiterState.STANDBY or stall_s < 5, 0.1)
    x_m, told = rig.chassis.state.mileage_m, len(rig.bursts)
    state = rig.says.state
    assert state in {ArbiterState.STOPPING, ArbiterState.STANDBY}
    for payload in stalled:
        rig.put(operator.name, "drive", payload)
    rig.tick()
    decided = [decision for decision in rig.decided[-len(stalled) :] if decision.request == "drive"]
    assert all(decision.reason is not Reason.NONE for decision in decided)
    rig.run(6)
    speeds = [float(burst["Auto_DriveCmd"]["TargetVelocity"]) for _, burst in rig.bursts[told:]]
    assert speeds == sorted(speeds, reverse=True), "the stop goes on, and nothing speeds up"
    if state is ArbiterState.STANDBY:
        assert rig.chassis.state.mileage_m == x_m


@pytest.mark.parametrize("stall_s", [0.5, 2.0, 8.0])
def test_a_stalled_stream_is_refused_although_the_robot_is_engaged_again(stall_s: float) -> None:
    """Row 'command age, by echo': here only the age speaks against it."""
    rig, operator = driving(1.0)
    stalled = []
    for _ in range(round(stall_s * 50)):
        stalled.append(operator.drive_payload(1.0))
        operator.ask("renew")
        rig.tick(2)
    while rig.says.state is not ArbiterState.STANDBY:
        operator.ask("renew")
        rig.tick()
    handle = operator.ask("engage")
    rig.until(lambda: handle in rig.replies)
    rig.run(0.25)
    for payload in stalled[:8]:
        rig.put(operator.name, "drive", payload)
    rig.tick()
    assert {decision.reason for decision in rig.decided[-8:]} <= {Reason.TOO_OLD, Reason.CHALLENGE_UNKNOWN}
    rig.run(0.2)
    assert rig.says.stop_reason is Reason.DEADMAN
    assert rig.speed_mps == 0


def test_yesterdays_commands_are_refused() -> None:
    """A capture of another run: neither its lease nor its challenges are of this one."""
    yesterday, first = driving()
    lease, challenge = first.lease, yesterday.says.challenge
    rig = GatewayRig(run=8)
    rig.run(0.6)
    today = Operator(rig)
    today.engage()
    today.lease, own = lease, today.lease
    rig.put("first", "drive", today.drive_payload(1.0))
    rig.tick()
    assert rig.ruled() is Reason.NO_LEASE
    today.lease = own
    rig.put("first", "drive", today.drive_payload(1.0, challenge=challenge))
    rig.tick()
    assert rig.ruled() is Reason.CHALLENGE_UNKNOWN
    assert rig.speed_mps == 0


def test_a_command_that_was_made_today_for_a_tick_of_tomorrow_is_refused() -> None:
    """Row 'command age, by echo': a tick to come can be guessed, and its challenge cannot."""
    rig, operator = driving(0.5)
    kept_back = operator.drive_payload(2.0, challenge=bytes(8), tick=rig.says.tick + 400, seq=900)
    operator.drive(0.5, 0.0, 3.98)
    rig.put(operator.name, "drive", kept_back)
    rig.tick()
    assert rig.ruled() is Reason.CHALLENGE_UNKNOWN
    assert rig.says.target_speed_mps == 0.5


@pytest.mark.parametrize("step_ns", [-YEAR_NS, YEAR_NS, 3600 * 10**9, -3600 * 10**9])
def test_clocks_do_not_matter(step_ns: int) -> None:
    """A sender whose clock is a year off is served, and a wall clock that steps by an hour changes nothing."""
    rig, operator = driving()
    rig.wall_ns += step_ns
    operator.drive(1.0, seconds=1)
    assert rig.says.engaged
    assert rig.ruled() is Reason.NONE
    assert rig.speed_mps == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("operator", ["first", "anyone", ""])
@pytest.mark.parametrize("payload", [b"", b"\xc1" * 1000, b"\x81\xa5lease\xff"])
def test_the_remote_stop_is_served_from_anyone_with_any_payload(operator: str, payload: bytes) -> None:
    """Row 'stop: from any operator, lease or not: immediate stop with parking brake, latched'."""
    rig, first = driving(1.5)
    rig.put(operator, "stop", payload)
    first.drive(1.5)
    assert rig.says.state is ArbiterState.STOPPING
    begun_ns, before_mps = rig.now_ns, rig.told_mps
    rig.run(0.5)
    assert before_mps - rig.told_mps == pytest.approx(1.0, abs=0.06)
    rig.until(lambda: rig.says.state is ArbiterState.STANDBY, 8)
    assert_stop_order(rig, begun_ns)
    assert rig.says.latched == [Reason.REMOTE_STOP]
    first.take_lease()
    assert first.reason("engage") is Reason.REMOTE_STOP


# The loop.


def test_a_late_stop_tells_zero_speed_before_neutral() -> None:
    """At the very start of motion, told some speed and still standing, a pause must not skip the order."""
    rig, operator = ready()
    operator.engage()
    rig.chassis_hears = True
    operator.drive(1.0, seconds=0.3)
    while rig.told_mps == 0:
        operator.drive(1.0)
    rig.late_ns = 150 * MS
    rig.tick()
    rig.late_ns = 0
    assert rig.told["Auto_GearCmd"]["TargetGear"] == "drive"
    assert rig.says.stop_reason is Reason.LOOP_LATE


def test_the_guards_words_are_in_the_events_and_in_the_latch() -> None:
    """Row 'the guard has stopped the robot: latched, with its words as an event': cause and outcome."""
    rig, operator = driving()
    cause = Cause.LATE.value
    rig.links = msgspec.structs.replace(GUARDED, guard_sends=True, guard_stops=1, guard_says=cause)
    operator.drive(1.0)
    yielded, latched = (
        next(e for e in rig.events if e.kind is kind) for kind in (EventKind.GUARD, EventKind.LATCH)
    )
    assert yielded.text == f"nothing is sent any more: {TEXTS[Reason.GUARD].means}; {cause}"
    assert latched.text.endswith(cause)
    rig.links = msgspec.structs.replace(GUARDED, guard_stops=1, guard_says=f"{cause}; the robot stands")
    rig.tick()
    ended = [event.text for event in rig.events if event.kind is EventKind.GUARD][1:]
    assert ended == [f"the guard's stop has ended: {cause}; the robot stands"]


def test_a_stop_of_the_guards_before_the_start_is_latched_until_a_reset() -> None:
    """Row 'the guard has stopped the robot: latched, also across a restart of the gateway'."""
    rig = GatewayRig()
    rig.core.latch_guard_stop("yesterday guard: the gateway is gone", rig.now_ns)
    rig.run(0.6)
    operator = Operator(rig)
    (event,) = [event for event in rig.events if event.kind is EventKind.LATCH]
    assert event.text.endswith("; yesterday guard: the gateway is gone")
    assert operator.take_lease() is Reason.NONE
    assert operator.reason("engage") is Reason.GUARD
    assert operator.reason("reset") is Reason.NONE
    operator.engage()


def test_the_guards_frames_are_not_taken_for_another_computers() -> None:
    """Read before it is known that the guard acted: what was left is stopped at once, not when it moves."""
    rig, _ = driving(1.0)
    maker = FrameMaker()
    for frame in maker.make(Actuation(enabled=True), [], Variant.COARSE):
        rig.core.receive_frame(frame, rig.now_ns)
    rig.links = Links(bus_up=True, guarded=True, guard_stops=1, realtime=True)
    rig.tick(3)
    assert rig.event_reasons(EventKind.STOP) == [Reason.FOUND_MOVING]
    assert Reason.OTHER_COMMANDER not in rig.says.blocked_by
