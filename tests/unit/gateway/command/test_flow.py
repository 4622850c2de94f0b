"""The command flow as a whole: its seams, what the gate refuses, and every slope. Rows are scenes.

Faults of chassis, bus, link and operators are in ``test_faults``.
"""

from collections.abc import Sequence
from itertools import product
from typing import Any

import msgspec
import pytest

from gateway.choice.chassis import CHASSIS
from gateway.command.flow import CommandFlow
from gateway.command.rulings import RawRequest
from schemas.decisions import ArbiterState, Decision, Reply
from schemas.messages import GearPosition
from schemas.reasons import Reason
from schemas.settings import MUTE_FAILURES, YIELD_BURSTS, Settings
from tests.support.fakes.robot import message_of
from tests.support.frames import CHALLENGE, WALL_NS
from tests.support.nights import by_night, every_pair
from tests.support.rigs.arbiter import MS, STANDING
from tests.support.rigs.gateway import driving
from tests.support.rigs.scenes import Scene, play
from tests.support.rigs.steps import rows

BODY = "Auto_MileageAndBodyFeedback"


def test_a_tick_makes_replies_and_messages() -> None:
    """Events before the state that they explain; decisions come once it is known what was sent."""
    made = CommandFlow(CHASSIS, Settings(), 7)
    request = RawRequest(5, "acquire", "first", b"\x80", 1)
    due = made.tick(STANDING, [request], 10 * MS, WALL_NS, 0, CHALLENGE)
    assert due.frames == []
    [reply] = due.replies
    assert (reply.handle, reply.verb) == (5, "acquire")
    assert msgspec.msgpack.decode(reply.payload, type=Reply).ok
    assert [sample.subject for sample in due.samples] == ["safety/event", "safety/state"]
    assert [message_of(due.samples[0])] == due.events
    [decision] = map(message_of, made.sent(0, 10 * MS, WALL_NS))
    assert isinstance(decision, Decision)
    assert (decision.request, decision.frames_sent) == ("acquire", 0)
    assert made.sent(0, 10 * MS, WALL_NS) == [], "a tick is told once"
    assert made.tick(STANDING, [], 20 * MS, WALL_NS, 0, CHALLENGE).samples == [], "no state where none is due"


def test_send_failures_are_counted_in_a_row() -> None:
    """A whole burst resets the count; lamps that were not accepted count too, but are no step."""
    rig, operator = driving(0.5)
    assert rig.core.command is not None
    arbiter = rig.core.command.arbiter
    for takes, failures, is_step in ((4, 1, False), (0, 2, False), (None, 0, True), (3, 1, False)):
        rig.takes, motion = takes, arbiter.output.motion
        rig.put("first", "drive", operator.drive_payload(0.5))
        rig.tick()
        assert (arbiter.monitor.send_failures, arbiter.output.motion is not motion) == (failures, is_step)
    rig.takes = None
    operator.reason("horn", on=True)
    rig.takes, motion = 5, arbiter.output.motion
    rig.put("first", "drive", operator.drive_payload(0.5))
    rig.tick()
    assert (arbiter.monitor.send_failures, arbiter.output.motion is not motion) == (1, True)


FLOW = {
    # What the gate refuses: in its place zero speed and the brake, in gear; later where the bus is full.
    "the gate refuses a burst": "driving 1; refuse 1; once 1; = latched gate, stopping, unmute, told 0, gear "
    "drive, parking; tick 1; text latch 18C4D3D0: because; wait 6; = rests, standby",
    "the gate refuses a burst, and the bus is full": "driving 1; refuse 1; takes 0; once 1; = latched gate, "
    "stopping, unmute; takes all; tick 1; = told 0, gear drive, parking; wait 6; = rests, standby",
    # If it refuses the brake too, nothing is sent, and the guard acts; later bursts are sent again.
    "the gate refuses all": "driving 1; mark; refuse 10; tick 5; = mute, silent, stopping; tick 1; = unmute, "
    "frames 6; wait 6; = rests, standby",
    "a counter that does not go on": "driving 1; slip; tick 1; = latched gate; tick 1; text latch 18C4D3D0: the "
    "alive counter does not follow the last one",
    "who has nothing to say is not mute": "driving 1; refuse 6; tick 3; = mute; transmitter remote; tick "
    f"{3 + YIELD_BURSTS}; = standby, unmute",
    # Until the way to the bus is back, so that the guard acts at once; standing by, nothing is left to anybody.
    "cut off from a chassis that obeys": "driving 1; links bus_up:0 bus_losses:1; tick 1; = standby, mute; tick "
    "1; = mute; links bus_losses:1; tick 1; = unmute; wait 10; = standby; links bus_up:0 bus_losses:2; tick 1; = "
    "unmute",
    # Not a drive that it does not take: that becomes a stop first. What it takes again ends it.
    **{
        f"a stop that the bus does not take for {ticks} ticks": f"driving 1; takes 0; tick {ticks}; = stopping, "
        f"{un}mute; takes all; tick 1; = unmute"
        for ticks, un in ((MUTE_FAILURES - 1, "un"), (MUTE_FAILURES, ""))
    },
    # A part does not reset the time since the last whole burst.
    "whole bursts alone count as told": "driving 1; = whole; takes 4; drive 1; = unwhole; takes 5; drive 1; = "
    "whole",
    # The speed is the first frame of a burst; the brake follows when the bus accepts it.
    "takes the speed alone": "driving 1; stop; takes 1; mark; tick 70; = falling, heard 0, phase park, unparked; "
    "takes all; wait 0.1; = phase hold",
    # The first burst after a silence is not held against the last one before it.
    "steered meanwhile": "ready; engage; drive 0 20 0.5; transmitter remote; sticks 0 -20; wait 2; transmitter "
    "command; wait 5; reply take none; engage; = engaged",
    "limits are said while it is engaged alone": "driving 0.5; once 9; = bound speed acceleration; drive 9 0 "
    "0.1; stop; once 9; = bound",
    # The greatest accelerations, at the greatest speeds and angles: no frame that does not fit.
    **{
        f"the hardest settings, {variant}": f"ready variant:{variant} acceleration_mps2:1.5 deceleration_mps2:2 "
        "emergency_deceleration_mps2:3 lateral_acceleration_mps2:3; engage; "
        + "".join(
            f"drive {asked} 2; = engaged; " for asked in ("9 90", "-9 -90", "3e-300 0", "-5e-324 24", "2.222 0")
        )
        + "stop; wait 6; = rests"
        for variant in ("coarse", "fine")
    },
}


@rows(FLOW)
def test_what_the_gate_refuses_and_the_bus_does_not_take(row: str) -> None:
    """Row 'the gate': the parking brake instead; a flow that can send nothing is mute, and the guard acts."""
    play(row)


# Slopes: every rule holds on 20 deg up and down, empty and loaded, with any brake pedal.

SLOPES = (-20.0, 8.0, 20.0)
MORE_SLOPES = (-8.0, 3.0, 15.0)
"""By night."""

STEEP = (-20.0, 20.0)
PAYLOADS = (0.0, 100.0)
DOES = ("stop", "tick 1", "ask disengage", "bumper front on", "silence Auto_DriveFeedBack")
RELEASE_MAX_M = 0.10
STOP_MAX_M = 0.30
"""Row 'slopes': roll-back at release, and from the moment of any stop."""


def on_slopes(*factors: Sequence[Any]) -> list[Any]:
    """Each slope with every combination of these values; by day a selection of them."""
    return [*every_pair(SLOPES, *factors), *(by_night(*row) for row in product(MORE_SLOPES, *factors))]


@pytest.mark.parametrize(
    ("slope_deg", "kg", "pedal", "speed_mps"), on_slopes(PAYLOADS, (0.0, 0.3, 1.0), (0.5, -0.5))
)
def test_a_robot_that_is_let_go_on_a_slope_does_not_roll_back(
    slope_deg: float, kg: float, pedal: float, speed_mps: float
) -> None:
    """The motor holds it in gear, the parking brake after a second; where the motor cannot, the brake at once."""
    play(
        f"hill {slope_deg} payload_kg:{kg} pedal_gain:{pedal}; drive {speed_mps} 0 2; mark; drive 0 0 4; = back "
        f"{RELEASE_MAX_M} {2 * speed_mps}, rests, parked"
    )


@pytest.mark.parametrize(("slope_deg", "kg", "does", "delay_s"), on_slopes(PAYLOADS, DOES, (0.05, 0.5)))
def test_a_stop_on_a_slope_ends_parked(slope_deg: float, kg: float, does: str, delay_s: float) -> None:
    """Whatever the cause: it does not roll back, with a fast and a slow parking brake."""
    play(
        f"hill {slope_deg} payload_kg:{kg} parking_delay_s:{delay_s}; drive 0.5 0 2.5; mark; {does}; wait 8; = "
        f"back {STOP_MAX_M}, rests, parked, standby, held"
    )


DIES = {
    f"{variant} at {speed_mps} m/s, {phase} ticks later": f"hill {-20 if speed_mps > 0 else 20} fast "
    f"variant:{variant}; drive {speed_mps} 0 4; tick {phase}; mark; motor 0; drive {speed_mps} 0 3; = way "
    f"{most_m}, first overspeed implausible_speed, parks_as_it_stops"
    for variant, (speed_mps, most_m), phase in product(
        ("coarse", "fine"), ((2.0, 1.8), (1.0, 1.0), (-2.0, 1.8), (-1.0, 1.0)), range(5)
    )
} | {
    # Neither by letting go, nor by a lowered limit, a late tick or a jump of the age.
    f"not by {does}": f"hill -20 fast; drive 2 0 4; {does}; = engaged, latched"
    for does in (
        "drive 0 0 6",
        "links realtime:0; drive 2 0 3",
        "lag 90; tick 1; lag 0; drive 2 0 3",
        "older 40; drive 2 0 3",
        "drive 2 0 3",
    )
}


@rows(DIES)
def test_a_motor_that_dies_downhill_is_replaced_by_the_parking_brake(row: str) -> None:
    """Row 'a motor that died downhill': overspeed or implausible speed, and the brake in that tick."""
    play(row)


ROLLS = {
    # Against the commanded direction for 100 ms: then the parking brake, latched, an event.
    **{
        f"uphill at {slope_deg} deg": f"hill {slope_deg}; drive 0.5 0 2; mark; motor 0; drive 0.5 0 3; = back "
        f"{STOP_MAX_M}, rests, has rolling, event stop rolling"
        for slope_deg in (8.0, 15.0, 20.0)
    },
    # Be the ramp that begins as slow as it may: a bit is 0.04 m/s.
    **{
        f"before a speed is told, by {acceleration_mps2} m/s2": f"hill -20 acceleration_mps2:{acceleration_mps2}; "
        f"drive 0 0 0.2; motor 0; mark; drive 0.5 0 3; = rests, way {STOP_MAX_M}, has rolling"
        for acceleration_mps2 in (0.1, 0.3)
    },
}


@rows(ROLLS)
def test_a_motor_that_dies_is_noticed_by_the_wheels(row: str) -> None:
    """Row 'rolling': at zero command or against the commanded direction for 100 ms, then the parking brake."""
    play(row)


STARTS = {
    # The brake is released in gear, and the ramp waits for the feedback that says so.
    **{
        f"at {slope_deg} deg": f"hill {slope_deg}; mark; drive 0.5 0 2; drive 0 0 2; = parked; drive 0.5 0 2; = "
        "faster 0.4, back 0.01"
        for slope_deg in (8.0, 20.0)
    },
    # The gear is changed behind the parking brake.
    **{
        f"reversed at {slope_deg} deg": f"hill {slope_deg}; drive 0.5 0 2; mark; driven -0.5 parked; = back 0.01; "
        "drive -0.5 0 2.5; = faster 0.4"
        for slope_deg in STEEP
    },
}


@rows(STARTS)
def test_a_hill_start_does_not_roll_back(row: str) -> None:
    """Rows 'standing' and 'reversal of direction'."""
    play(row)


BY_MOTOR = "rests, phase motor, way"
SLIPS: dict[str, str] = {
    # Auto-hold hands it over, and takes it back; the latch is an error, and no reset lets it go.
    **{
        f"held at {slope_deg} deg with grip {grip}": f"hill {slope_deg}; drive 0.5 0 2; brake {grip}; drive 0 0 "
        f"1; mark; drive 0 0 5; = {BY_MOTOR} 0.3, first brake_slips, error latch brake_slips; reply reset "
        "stopping; wait 30; = way 0.3"
        for slope_deg, grip in product(STEEP, (0.0, 0.2, 0.45))
    },
    # It would roll away behind a brake that reads applied, and cuts the motor off.
    **{
        f"a stop at {slope_deg} deg with grip {grip}": f"hill {slope_deg}; drive 0.5 0 2; brake {grip}; ask stop; "
        f"stands; mark; wait 30; = {BY_MOTOR} 0.3, has brake_slips"
        for slope_deg, grip in product(STEEP, (0.0, 0.3))
    },
    # The brake is not tried again, whatever interrupts that stop.
    **{
        f"then {interruption}": "hill -15; drive 0.5 0 2; brake 0.3; drive 0 0 4; = phase motor; mark; "
        f"{interruption}; wait 6; = {BY_MOTOR} 0.3"
        for interruption in (
            "links bus_up:0 bus_losses:1; wait 0.5; links bus_losses:1",
            "transmitter remote; wait 1; transmitter command",
            "ask stop",
        )
    },
    # Who sees it creep and presses STOP must not let it roll away.
    **{
        f"{asked} {after_ms} ms later": "hill -20; drive 0.5 0 2; brake 0.2; parks 0; mark; drive 0 0 "
        f"{after_ms / 1e3}; {asked}; wait 6; = {BY_MOTOR} 0.3"
        for asked, after_ms in product(("ask stop", "ask disengage", "drive -0.5 0 2"), (60, 100, 140, 180))
    },
    # The brake is applied to change the gear, before the robot has stood for a second.
    **{
        f"a reversal at {slope_deg} deg, delay {delay_s} s": f"hill {slope_deg} parking_delay_s:{delay_s}; drive "
        f"0.5 0 2; brake 0.2; drive 0 0 0.7; mark; drive -0.5 0 2; wait 4; = {BY_MOTOR} 0.3"
        for slope_deg, delay_s in product(STEEP, (0.05, 0.15))
    },
    # The motor held it until the gear went. A brake that is slow to open has to open first: it becomes faster.
    **{
        f"in neutral at {slope_deg} deg, grip {grip}, delay {delay_s} s": f"hill {slope_deg} "
        f"parking_delay_s:{delay_s}; drive 0.5 0 2; neutral -0.5; brake {grip}; mark; drive -0.5 0 2; wait 4; = "
        f"{BY_MOTOR} {most_m}"
        for slope_deg, (grip, delay_s, most_m) in product(
            STEEP, ((0.0, 0.05, STOP_MAX_M), (0.0, 0.15, 0.5), (0.2, 0.15, 0.3))
        )
    },
    # The stick releases the brake, and the robot that rolls back is not given to it again.
    **{
        f"driven on at {slope_deg} deg with grip {grip}, {after_ms} ms later": f"hill {slope_deg}; drive {up_mps} "
        f"0 2; brake {grip}; parks 0; mark; drive 0 0 {after_ms / 1e3}; drive {up_mps} 0 2; wait 6; = back "
        f"{STOP_MAX_M} {2 * up_mps}, rests, phase motor"
        for (slope_deg, up_mps), grip, after_ms in product(((-20, -0.5), (20, 0.5)), (0.0, 0.2), (20, 100, 180))
    },
    # Nothing shows that this brake does not hold: it is asked for, and keeps a robot that is pushed.
    "pushed before its brake reads applied": "hill 0 parking_delay_s:0.15; drive 0.5 0 2; parks -0.5; "
    + "adopt 0.3; drive -0.5 0 0.02; " * 8
    + "drive -0.5 0 1; = rests, latched rolling, parked",
    # The motor has it since, so a brake that is asked for at speed is not let go of again.
    "driven on downhill by a weak motor": "hill -14; drive 0.5 0 2; brake 0.1; parks 0; drive 0 0 0.08; motor "
    "0.3; drive 0.5 0 2.5; = has implausible_speed, unhas brake_slips",
}


@rows(SLIPS)
def test_a_brake_that_slips_gives_the_robot_back_to_its_motor(row: str) -> None:
    """Row 'a parking brake that reads applied and does not hold', in a stop and in a change of direction too."""
    play(row)


COASTS: dict[str, str] = {
    **{
        f"in mode stop at {slope_deg} deg": f"hill {slope_deg}; drive 1 0 2.5; reboot for 200ms; wait 6; = rests, "
        "parked, mode stop"
        for slope_deg in (-20.0, -8.0, 0.0)
    },
    "after a takeover, having forgotten what it was told": "hill -8; drive 0.5 0 2; transmitter remote; sticks "
    "0.5 0; wait 1; forget; transmitter command; wait 5; = rests, parked",
    # Motion never resumes automatically, also if another node switches lamps.
    **{
        f"given back, {meanwhile}": f"driving 2; transmitter remote; drive 2 0 0.2; wait 3; {meanwhile}; wait "
        "0.5; mark; transmitter command; wait 5; = way 0.05, parked"
        for meanwhile in ("wait 0", "foreign 18C4D7D0 every 50ms")
    },
}


@rows(COASTS)
def test_a_robot_that_coasts_gets_its_parking_brake(row: str) -> None:
    """Rows 'a stop that cannot be carried out' and 'in mode stop and seen to move': it is parked."""
    play(row)


CREEPS = [
    # behind which brake, how fast, latched
    ("of a robot that stands by", 0.003, Reason.ROLLING),
    ("of a robot that stands by", 0.012, Reason.ROLLING),
    ("of a robot that stands by", 0.04, Reason.ROLLING),
    ("of the auto-hold", 0.006, Reason.ROLLING),
    ("of the auto-hold", 0.012, Reason.ROLLING),
    ("of the auto-hold", 0.04, Reason.BRAKE_SLIPS),
]


@pytest.mark.parametrize(("brake", "creep_mps", "latched"), CREEPS)
def test_a_robot_that_creeps_behind_its_brake_is_found_by_a_few_pulses(
    brake: str, creep_mps: float, latched: Reason
) -> None:
    """Row 'a parking brake': the speeds read zero, and not every frame has a pulse."""
    scene = Scene("hill -8")
    scene.play("drive 0.5 0 2; parks 0")
    if brake == "of a robot that stands by":
        scene.play("ask disengage; wait 4; = standby")
    rig, crept_m = scene.rig, 0.0
    while not rig.says.latched and crept_m < 0.1:
        body = rig.chassis._motion
        body._left_m += creep_mps * 0.01
        body._right_m += creep_mps * 0.01
        crept_m += creep_mps * 0.01
        scene.play("drive 0 0 0.01" if rig.says.state is ArbiterState.ENGAGED else "tick 1")
    assert latched in rig.says.latched
    assert rig.says.state is ArbiterState.STOPPING


def test_a_robot_that_was_told_to_creep_does_not_creep_when_it_stops() -> None:
    """Nor one that comes to rest: its last pulses belong to the commanded way."""
    for mps in (0.005, 0.02, 0.04):
        play(f"hill 0; drive {mps} 0 8; drive 0 0 6; drive {-mps} 0 6; = engaged, latched")


def test_a_robot_that_creeps_when_its_enables_are_gone_is_kept_in_gear() -> None:
    """Row 'a parking brake that does not hold': after the second return; by a reset it may try once more."""
    scene = Scene("hill -20")
    scene.play("drive 0.5 0 2; ask stop; mark")
    rig = scene.rig
    for _ in range(12_000):
        # Of this brake the enables hold it: disabled, it slips.
        is_enabled = bool(rig.told) and rig.told["Auto_ParkingCmd"]["Enable"]
        rig.fault("brake 1" if is_enabled else "brake 0.45")
        rig.tick()
    scene.play("= way 0.5, has brake_slips, stopping, phase hold")
    rig.chassis.adopt(speed_mps=0.2, angle_deg=0.0, gear=GearPosition.DRIVE, parked=True)
    # At first it has not stood braked for 5 s.
    scene.play("wait 0.5; brake 1; reply acquire none; reply reset stopping")
    scene.play("; ".join(["ask renew; wait 0.6"] * 10) + "; reply reset none; wait 2; = standby, latched")


WAYS = {
    # By the time that has passed, not by the number of ticks.
    **{
        f"a loop that is late by {late_ms} ms each time": f"driving 2; lag {late_ms}; mark; drive 0 0 3; = rests, "
        "way 2.47"
        for late_ms in (0, 30, 60)
    },
    "a slope that changes": "hill 15; "
    + "".join(f"slope {slope}; drive 0.5 0 1.5; = moves 0.5; " for slope in (20, 5, 0, -10, -20))
    + "stop; wait 5; = rests, latched remote_stop",
    "a stop that was barred": "ready; transmitter remote; sticks 0.5 0; wait 1.5; reply stop hand_transmitter; "
    "detail the robot moves at 0.48 m/s; = unspoken; sticks 0 0; wait 2; = unparked; transmitter command; wait "
    "3; = parked, standby",
    # The steering is off by a degree (manual V2.0, 2.2) when the mode leaves auto.
    "a stop that begins where another ended": "driving 0.5; drive 0 0 1; corrupt Auto_SteeringFeedBack askew; "
    "wait 0.1; forget; wait 3; = unhas gate, parked",
    "a frozen body frame, engaged again and again": f"driving 0.5; freeze {BODY}; mark; "
    + "drive 0.5 0 2; ask disengage; wait 4; reply take none; ask engage; wait 0.3; drive 0; ask unpark; " * 5
    + "= has feedback_frozen, way 4.5",
}


@rows(WAYS)
def test_how_a_stop_is_carried_out_where_much_comes_together(row: str) -> None:
    """Rows 'slopes', 'stop, the remote stop', 'normal deceleration' and 'a body frame frozen'."""
    play(row)
