"""The arbiter's states, causes and outputs, and what it says of them. Rows are those of ``ArbiterRig``."""

from itertools import product

import pytest

from gateway.chassis.port import AT_REST
from gateway.command.arbiter import Reporter, reply
from gateway.command.rulings import Judged, RawRequest, Ruling, VerbAnswer
from schemas.decisions import ArbiterState, Bound, EventKind, LeaseReply, Reply, SafetyState, Verdict
from schemas.messages import SEQUENCE_MAX, GearPosition
from schemas.reasons import TEXTS, Reason
from schemas.requests import Role
from schemas.settings import YIELD_BURSTS
from tests.support.rigs.arbiter import MS, begun, play
from tests.support.rigs.steps import rows

WALL_NS = 1_700_000_000_000_000_000
INTO_AUTO = "ready; see mode:stop; acquire; engage; mark"
OTHER = "commander_ns:1000000000000"

ENGAGE = {
    "nobody asks": "ready; tick 50; = quiet",
    "five enables with zero speed until it reads auto": "ready; see angle_deg:7 mode:stop; acquire; engage; "
    "mark; = pending, engaging; tick 20; = spoken, speechless, braked, enabled, gear neutral, angle 7, answered; "
    "see; tick; = answered engage none, engaged, by engaged first, target 0 7",
    "the bus takes frames again, or we shall see": "ready; fails 9; acquire; engage; = fails 0, engaging",
    "somebody's old enables confirm nothing": "ready; see mode:auto; acquire; engage; = engaging; tick; = engaged",
    "it does not read auto in a second": f"{INTO_AUTO}; tick 99; = engaging; tick; = stopping, answered engage "
    "not_confirmed",
    "the remote control has it": f"{INTO_AUTO}; see mode:remote; tick; = answered engage hand_transmitter",
    "a bumper is hit": f"{INTO_AUTO}; see front_bumper:true; tick; = answered engage front_bumper",
    "stopped in the same tick": "ready; see mode:stop; acquire; together engage + stop; = told 0, stopping",
    "losses and stops of before it are none": "ready; see bus_losses:3 guard_stops:2; tick 60; acquire; reset; "
    "engage; tick 3; = engaged",
    "no guard, where the settings accept that": "engaged unguarded:true; tick; = engaged",
}


@rows(ENGAGE)
def test_how_it_is_engaged(row: str) -> None:
    """Row 'engage: five enables with zero speed, and mode must read auto within 1 s'; the reply comes then."""
    play(row)


def stops(cause: str, reason: str, told_mps: float = 0.48) -> str:
    return (
        f"driving 0.5 100; see {cause}; drive 0.5; = stopping, event stop {reason}, told {told_mps}, for {reason}"
    )


LIMITED = "ready; acquire; engage speed_limit_mps:0.5; tick 2; drive; unpark; drive 0.5 150"
CAUSES = {
    **{
        f"deadman of {deadman_s} s": f"engaged deadman_s:{deadman_s}; drive; tick {ticks}; = engaged; tick; = for "
        f"deadman, event stop deadman info; text stop none for {ticks * 10 + 10} ms"
        for deadman_s, ticks in ((0.3, 30), (0.1, 10))
    },
    "missing": stops("missing:Auto_GearFeedBack+Auto_LightFeedback", "feedback_missing")
    + "; text stop Auto_GearFeedBack, Auto_LightFeedback",
    "faulty": stops("faulty:Auto_GearFeedBack", "feedback_faulty"),
    "of no variant": stops("variant:unknown", "variant_unknown", 0),
    "of another variant": stops("variant:fine", "variant_unknown", 0),
    "front bumper": stops("front_bumper:true", "front_bumper"),
    "rear bumper": stops("rear_bumper:true", "rear_bumper"),
    "no guard": stops("guarded:false", "unguarded", 0.488),
    "another computer": stops(OTHER, "other_commander"),
    # A warning makes an incident. The planned end of a drive makes none; a stop at once always does.
    **{
        f"{does} at {speed_mps} m/s": f"driving {speed_mps} 200; {does}; = events stop {reason}, event stop "
        f"{reason} {moving if speed_mps else standing}"
        for (does, reason, standing, moving), speed_mps in product(
            [
                ("tick 31", "deadman", "info", "warning"),
                ("take by second role:supervisor override:true", "lease_taken", "info", "warning"),
                ("disengage", "disengaged", "info", "info"),
                ("release", "lease_released", "info", "info"),
                ("stop", "remote_stop", "warning", "warning"),
            ],
            (0.0, 1.0),
        )
    },
    "a stop in a slower stop": "driving 1 200; disengage; = told 0.988; stop by second; = told 0.968, for "
    "disengaged, latched remote_stop; stop by carl; = events latch remote_stop",
    "a graver cause in a stop": "driving 1 200; disengage; see speed_mps:1 wheel_speed_mps:1; tick 100; = has "
    "implausible_speed",
    "a bumper standing by": "ready; see rear_bumper:true; tick 3; = latched rear_bumper, silent, events latch "
    "rear_bumper",
    "the end": "engaged; drive 0.5 10; shutdown; = for shutdown; tick; = event gateway shutdown info, event stop "
    "shutdown info",
    "the end standing by: somebody else may have it in auto": "ready; see mode:auto; tick; shutdown; = standby; "
    "acquire; engage; = refused shutdown",
    # A fault of our own: in gear, and from there the stop goes on; also where the bus takes nothing.
    **{
        f"a burst is refused{stop}": f"driving 1 60{stop}; drive 1; refuse; = enabled, gear drive, told 0, "
        "parking, latched gate; latch gate why; undo; tick; = enabled, gear drive, told 0, parking; tick 3; = "
        "phase hold; tick 200; = standby"
        for stop in ("", "; disengage")
    },
    # The speed in the frames counts: for 0.11 m/s a coarse chassis is commanded 0.08, and may read one bit.
    **{
        f"asked {asked_mps} m/s, one bit seen": f"driving {asked_mps} 60; see all:0.04 pulses:1; drive "
        f"{asked_mps} 60; = {is_found}for feedback_frozen"
        for asked_mps, is_found in ((0.11, "un"), (0.13, ""))
    },
    "horn, lamps and odometer end": "engaged; horn on:true; light headlamp:true; clear_odometer; stop; mark; "
    "tick; = beside Light Speaker Odometer, lamps lit",
}


@rows(CAUSES)
def test_each_cause_stops_the_robot(row: str) -> None:
    """In the tick of its detection, by its deceleration, with an event of its severity."""
    play(row)


ITSELF = {
    f"{seen}": f"{LIMITED}; see {seen}; drive 0.5 {ticks - 1}; = engaged; drive 0.5; = latched {reason}, {told}"
    for seen, reason, ticks, told in [
        ("wheel_speed_mps:-0.11 fastest_wheel_mps:0.11 speed_mps:0.11", "rolling", 11, "told 0, parking"),
        ("pulses:-1", "rolling", 11, "told 0, parking"),
        # So sudden a rise is that of a motor that has died: the parking brake, and no ramp.
        ("all:0.8", "overspeed", 11, "told 0, parking"),
        ("angle_deg:5.1", "steering", 31, "told 0.48, unparking"),
    ]
} | {
    "a brake that does not read applied": "driving 0.5 100; see brake:released; stop; tick 30; = phase park; tick "
    "269; = events fault; tick 500; = events fault not_confirmed, event fault not_confirmed error, gear drive, "
    "parking; text fault the parking brake does not read applied| the motor holds the robot in gear until it does"
}


@rows(ITSELF)
def test_what_the_robot_does_of_itself_stops_it_and_is_latched(row: str) -> None:
    """Rows 'rolling', 'measured speed over the limit in force' (a lowered one), 'steering', 'a parking brake'."""
    play(row)


END = {
    "disabled": "engaged; disengage; until phase disable; mark; tick 49; = spoken; tick; = silent, standby, "
    "event stopped disengaged info, events takeover; text stopped at standstill, no commands sent",
    "not seen to stand": "engaged; see missing:Auto_DriveFeedBack speed_mps:null; tick 600; = event stopped "
    "feedback_missing error; text stopped no commands sent, but the robot is not seen to stand",
    "beside another computer": f"engaged; stop; see {OTHER}; tick 400; text stopped no commands sent, but "
    "another computer commands the robot and can move it",
}


@rows(END)
def test_how_a_stop_ends(row: str) -> None:
    """Row 'a stop: disable 0.5 s, silence'; and whether the robot is seen to stand."""
    play(row)


YIELDS = {
    # The remote control alone leaves a way to the chassis: it is left with zero speed and its parking brake.
    **{
        f"{seen}{stop}": f"driving 0.5 100{stop}; horn on:true; see {seen}; mark; tick; = standby, for {reason}, "
        f"phase idle, beside, events {kind} {reason}, {left}; tick {YIELD_BURSTS - 1}; mark; tick 50; = quiet"
        for (seen, kind, reason, left), stop in product(
            [
                ("mode:remote", "takeover", "hand_transmitter", "latched, enabled, gear drive, told 0, parking"),
                ("bus_up:false", "takeover", "bus_down", "latched, silent, cut_off"),
                ("bus_losses:1 mode:undefined bus_up:false", "takeover", "bus_down", "latched, silent, cut_off"),
                # The gravest first; a bus that was lost and is back is a way.
                ("bus_losses:1 mode:remote", "takeover", "bus_down", "latched, silent, uncut_off"),
                ("guard_sends:true", "guard", "guard", "latched guard, silent, uncut_off"),
                ("guard_stops:1 bus_up:false mode:remote", "guard", "guard", "latched guard, silent, uncut_off"),
            ],
            ("", "; disengage"),
        )
    },
    "a horn that was cut off": "engaged; horn on:true; see mode:remote; tick; see mode:stop; tick 6; engage; "
    "tick; = beside Speaker; tick 10; = beside",
    # A robot that is seen to move is not left.
    **{
        f"coasts by {seen}{stop}": f"driving 0.5 100{stop}; see mode:stop all:0 turns:false {seen}; tick; = "
        "enabled, told 0, gear drive, parking; tick 1000; = phase hold; see mode:stop all:0 turns:false; tick "
        f"200; = silent, for {reason}"
        for seen, (stop, reason) in product(
            ("pulses:1", "fastest_wheel_mps:0.5", "turns:true confirmed:false"),
            (("", "mode_not_auto"), ("; disengage", "disengaged")),
        )
    },
    # The guard stopped it for 6 s, and is done; a robot that still reads auto is stopped.
    **{
        f"back after the guard has ended, {seen}": "driving 1; = told 1; see guard_stops:1 mode:stop "
        f"brake:applied all:0 {seen}; mark; late 6000; = latched guard, events guard guard, {says}; tick 300; = "
        "speechless"
        for seen, says in (("", "silent"), ("mode:auto", "told 0"), ("mode:undefined speed_mps:null", "silent"))
    },
    "a burst went out after the pause": "driving 1; see guard_stops:1 mode:auto speed_mps:0.04 "
    "fastest_wheel_mps:0.05; told 3500; = unsilent, below 0.04",
    # Never from a speed above the present one.
    **{
        f"back without a guard, at {seen_mps}": "driving 1 unguarded:true; see guarded:false mode:auto "
        f"all:{seen_mps}; late 500; = told {told_mps}"
        for seen_mps, told_mps in ((0, 0), (0.4, 0.38), ("null", 0), (1.3, 0.98))
    },
    "the guard left it to the remote control": "driving 1; see guard_sends:true mode:remote; tick 5; see "
    "mode:remote guard_stops:1; tick 5; = silent; see mode:auto guard_stops:1 gear:drive; tick; = told 0",
    # Feedback may still come: no command before.
    **{
        f"a bus that comes back, unseen, left at {speed_mps} m/s": f"engaged; drive {speed_mps} 60; see "
        "mode:undefined gear:undefined bus_up:false bus_losses:1; tick 100; see mode:undefined gear:undefined "
        "bus_losses:1; mark; tick 19; = quiet; tick; = told 0, parking"
        for speed_mps in (0, 0.5)
    },
    # The chassis keeps our last command, and would execute it.
    **{
        f"obeys again, {seen}": f"engaged; see mode:remote; tick 100; = events stop; see {seen}; tick; = "
        "stopping, for found_moving, told 0"
        for seen in ("mode:auto", "mode:undefined missing:body")
    },
}


@rows(YIELDS)
def test_when_the_output_ceases_and_what_comes_after(row: str) -> None:
    """Rows 'remote control takes over: output ceases at once', 'mode leaves auto', 'nothing resumes by itself'."""
    play(row)


ADRIFT = "gear:drive brake:released turns:true angle_deg:0 all:1"
GIVEN_BACK = {
    f"left at {left_mps}, seen at {seen_mps}{stop}": f"driving {left_mps}; see mode:remote; tick 100{stop}; see "
    f"mode:auto gear:drive brake:released all:{seen_mps}; mark; tick; = told {max(0.0, from_mps - step_mps)}; "
    f"tick 4; = told {max(0.0, from_mps - 5 * step_mps)}; tick 35; = spoken, falling"
    for (left_mps, seen_mps, from_mps), (stop, step_mps) in product(
        [(0.5, 0.3, 0.3), (0.5, 1.9, 0.5), (0.0, 1.9, 0.0), (-0.5, 0.3, 0.0)],
        (("", 0.012), ("; stop by anyone", 0.02)),
    )
}


@rows(GIVEN_BACK)
def test_a_robot_that_is_given_back_is_not_told_a_speed_above_what_it_was_left_on(row: str) -> None:
    """Row 'given back: never above the lower of left on and seen; emergency deceleration if latched'."""
    play(row)


FOUND = {
    **{
        f"{seen}": f"ready; see {ADRIFT} mode:auto angle_deg:30 {seen}; tick 20; = standby; tick; = enabled, gear "
        f"{gear}, told {max(0.0, from_mps - 0.012)}, angle {angle_deg}, events stop found_moving, {rest}"
        for seen, gear, from_mps, angle_deg, rest in [
            ("gear:drive", "drive", 1.0, 24, "unparking; tick 25; = told 0.688, latched"),
            ("gear:reverse wheel_speed_mps:-1", "reverse", 1.0, 24, "unparking; tick 25; = told 0.688, latched"),
            # Commanded to stand, and no slower for a fifth of a second.
            ("gear:neutral angle_deg:null", "neutral", 0.0, 0, "parking; tick 25; = told 0, latched rolling"),
            ("speed_mps:null angle_deg:-30", "drive", 1.0, -24, "unparking; tick 25; = told 0.688, latched"),
            # Its own speed is no fault: its scale is known.
            (
                "speed_mps:2.5 fastest_wheel_mps:2.6",
                "drive",
                1.309,
                24,
                "unparking; tick 25; = told 0.997, latched",
            ),
        ]
    },
    # A stop out of standing by that follows another one within a second: no ramp begins over and over again.
    **{
        f"a mode that flickers, {ticks} ticks": f"ready; see {ADRIFT} mode:auto; tick 21; = unsilent, unparking; "
        f"see {ADRIFT} mode:remote; tick {ticks}; see {ADRIFT} mode:auto; tick; = unsilent, {parks}parking"
        for ticks, parks in ((10, ""), (99, "un"))
    },
    "nothing is seen: the brake from the first frame on": "ready; see mode:undefined gear:undefined "
    "speed_mps:null fastest_wheel_mps:null missing:all; mark; stop; tick 600; = unquiet, speechless, braked",
    # A remote stop is sent if the chassis may execute an old command, or coasts in mode stop.
    **{
        f"stopped in {seen}": f"ready; see {seen}; tick; stop by anyone; = has remote_stop, {told}; text latch by "
        "anyone"
        for seen, told in [
            ("mode:auto", "enabled, told 0, parking"),
            ("mode:undefined", "enabled, told 0, parking"),
            ("mode:stop", "silent"),
            ("mode:remote", "silent"),
            ("mode:auto bus_up:false", "silent"),
            ("mode:auto guard_sends:true", "silent"),
            ("mode:stop gear:drive brake:released pulses:1", "enabled, told 0, parking"),
            ("mode:stop gear:drive brake:released fastest_wheel_mps:0.5", "enabled, told 0, parking"),
            ("mode:stop gear:drive brake:released turns:true confirmed:false", "enabled, told 0, parking"),
            ("mode:stop pulses:1 bus_up:false", "silent"),
            ("mode:stop pulses:1 guard_sends:true", "silent"),
            ("mode:remote pulses:1", "silent"),
        ]
    },
    # The reply says what the robot does, and what keeps the stop from being carried out.
    **{
        f"a stop with {seen}": f"ready; see {seen}; tick; stop by anyone; = ruled {reason}, has remote_stop; "
        f"detail {detail}"
        for seen, reason, detail in [
            ("mode:stop", "none", "the robot stands"),
            ("mode:auto speed_mps:0.7", "none", "the robot moves at 0.70 m/s"),
            (
                "speed_mps:null fastest_wheel_mps:null",
                "feedback_missing",
                "latched| not carried out: the robot is not seen to stand",
            ),
            ("guard_sends:true", "none", "the guard is stopping it| the robot stands"),
            ("bus_up:false", "bus_down", "latched| not carried out: the robot stands"),
            (
                "mode:remote fastest_wheel_mps:0.8 pulses:1",
                "hand_transmitter",
                "latched| not carried out: the robot moves at 0.80 m/s",
            ),
            (OTHER, "other_commander", "latched| not carried out: the robot stands"),
        ]
    },
    **{
        f"a stop at speed with {hindered}": f"driving 1; {hindered}; stop; = ruled {reason}, latched remote_stop; "
        f"detail {detail} the robot moves at {mps} m/s"
        for hindered, reason, detail, mps in [
            ("tick 0", "none", "", "1.00"),
            ("see controller:bus_off", "bus_off", "latched| commanded, but not confirmed:", "1.00"),
            ("fails 1", "send_failed", "latched| commanded, but not confirmed:", "1.00"),
            (f"see {OTHER}", "other_commander", "latched| commanded, but not confirmed:", "1.00"),
            ("see mode:remote all:0.8; tick", "hand_transmitter", "latched| not carried out:", "0.80"),
        ]
    },
}


@rows(FOUND)
def test_a_robot_that_is_found_so(row: str) -> None:
    """Rows 'found at start: moving, nobody sending', 'stop: from any operator' and 'a stop that cannot be'."""
    play(row)


STANDING = {
    # Any speed restarts the time; 0 is never.
    **{
        f"idle for {idle_s} s": f"engaged idle_s:{idle_s}; drive 0 300; drive 0.5 10; drive 0 520; = held first, "
        f"{says}"
        for idle_s, says in (
            (5.0, "unengaged, for idle, events stop idle, event stop idle info, latched"),
            (5.5, "engaged"),
            (0.0, "engaged"),
        )
    },
    "warned from engage on, and no speed is told": "engaged warning_s:2; drive 0.5 190; = lamps dark lit, told "
    "0, bound warning; drive 0.5 40; mark; drive 0.5 60; = lamps none, unsilent, untold 0, unbound warning",
    **{
        f"stood for {ticks} ticks": f"engaged warning_s:1; drive 0.5 300; = told 0.5; mark; drive 0 {ticks + 50}; "
        f"= lamps none; mark; drive 0.5 90; = {un}lit, {un}bound warning; drive 0.5 200; = told 0.5"
        for ticks, un in ((450, "un"), (560, ""))
    },
    "nobody is warned where it is off": "engaged; drive 0.5 200; = lamps none, unsilent, untold 0",
    "a stop puts the lamps out": "engaged warning_s:2; drive 0 50; mark; disengage; = lamps dark",
    # The chassis keeps its indicators while somebody else commands it: what we send next clears them.
    **{
        f"cut off by the remote control, then {then}": "engaged warning_s:2; drive 0.5 50; see mode:remote; tick "
        f"500; see; tick 50; {then}; mark; tick 50; = dark"
        for then in ("acquire; engage", "see all:0.3 turns:true")
    },
}


@rows(STANDING)
def test_what_standing_leads_to(row: str) -> None:
    """Rows 'an engaged robot at zero command' and 'warning people', from engage and after 5 s of standing."""
    play(row)


def test_what_the_bus_did_not_take_was_no_step() -> None:
    """The next burst is a step from the last accepted command."""
    rig = begun("driving 1 60")
    output = rig.arbiter.output
    before = output.actuation
    rig.drive(1.0)
    once = output.actuation
    output.undo_step()
    assert before is not None
    assert output.actuation == before
    rig.drive(1.0)
    assert output.actuation == once
    output.undo_step()
    rig.ask("stop")
    assert output.actuation is not None
    assert output.actuation.speed_mps == pytest.approx(before.speed_mps - 0.02)


# What it says.


class Told:
    def __init__(self, begin: str = "ready") -> None:
        self.bench = begun(begin)
        self.reporter = Reporter(self.bench.arbiter)

    def state(self) -> SafetyState | None:
        return self.reporter.state(self.bench.now_ns, WALL_NS, self.bench.challenge())

    def now(self) -> SafetyState:
        self.reporter.state_due_ns = 0
        state = self.state()
        assert state is not None
        return state


def test_the_state_goes_out_at_20_hz_and_on_change_and_at_50_hz_while_engaged() -> None:
    """Its challenge counts as published from then on."""
    told, due = Told(), []
    bench, challenges = told.bench, told.bench.arbiter.link.challenges
    for _ in range(20):
        bench.outcome = bench.arbiter.tick(bench.chassis, [], bench.now_ns, 0)
        challenge, state = bench.challenge(), told.state()
        assert isinstance(challenges.age_ns(challenge, bench.now_ns), int) is (state is not None)
        assert state is None or state.challenge == challenge
        due.append(state is not None)
        bench.now_ns += 10 * MS
    assert due == [True, False, False, False, False] * 4
    told.state()
    bench.ask("acquire")
    state = told.state()
    assert state is not None
    assert (state.lease_holder, state.sequence, state.time_ns) == ("first", 5, WALL_NS)
    told = Told("engaged")
    told.now()
    due = []
    for _ in range(20):
        told.bench.drive()
        due.append(told.state() is not None)
    assert due == [False, True] * 10


SAID = {
    "ready": {
        "lease_holder": "",
        "lease_role": Role.PROGRAM,
        "lease_expires_s": 0.0,
        "parking": True,
        "output_gear": GearPosition.UNDEFINED,
        "output_speed_mps": 0.0,
        "blocked_by": [Reason.NO_LEASE, Reason.NOT_ENGAGED],
        "stop_detail": "",
        "deadman_s": 0.3,
        **dict.fromkeys(("link_age_s", "link_age_last_s", "link_age_p50_s", "link_age_p99_s"), None),
        "travel_delay_m": 0.0,
        "travel_speed_limit_mps": None,
        "accepted_seq": None,
    },
    # Of a robot on its way, backward and to the right.
    "engaged; drive -0.4 80 angle_deg:-6": {
        "state": ArbiterState.ENGAGED,
        "engaged": True,
        "stop_reason": Reason.NONE,
        "blocked_by": [],
        "lease_holder": "first",
        "lease_role": Role.OPERATOR,
        "lease_expires_s": 2.0,
        "latched": [],
        "target_speed_mps": -0.4,
        "target_angle_deg": -6.0,
        "guarded": True,
        "parking": False,
        "output_speed_mps": -0.4,
        "output_angle_deg": -6.0,
        "output_gear": GearPosition.REVERSE,
        "speed_limit_mps": 2.222,
        "acceleration_limit_mps2": 0.8,
        "deceleration_limit_mps2": 1.2,
        "emergency_deceleration_mps2": 2.0,
        "steering_limit_deg": 24.0,
        "steering_rate_limit_degps": 60.0,
        "lateral_acceleration_limit_mps2": 1.5,
    },
    # A lower limit, while it is in force.
    "ready; acquire; engage speed_limit_mps:0.5": {"speed_limit_mps": 0.5, "blocked_by": [Reason.ENGAGING]},
    "ready; acquire; engage; tick 2": {"speed_limit_mps": 2.222, "blocked_by": [Reason.PARKED]},
    "ready; acquire; engage speed_limit_mps:0.5; disengage": {"speed_limit_mps": 2.222},
    "ready; acquire; see mode:remote; tick": {"blocked_by": [Reason.HAND_TRANSMITTER, Reason.NOT_ENGAGED]},
    "engaged; see gear:neutral; drive 0.5": {"blocked_by": [Reason.GEAR_SHIFTING]},
    "engaged; drive 0.5 30; drive -0.5": {"blocked_by": [Reason.GEAR_SHIFTING]},
    "engaged; stop by second": {
        "blocked_by": [Reason.REMOTE_STOP, Reason.STOPPING],
        "latched": [Reason.REMOTE_STOP],
        "stop_reason": Reason.REMOTE_STOP,
    },
    # It forbids a direction.
    "ready; see front_bumper:true; acquire; tick 60; reset; engage; tick 2": {
        "blocked_by": [Reason.FRONT_BUMPER, Reason.PARKED]
    },
}
FAR = "ready; acquire; engage deadman_s:0.8; tick 2; drive; unpark; drive 1 150 challenge:20"
SAID |= {
    # Row 'travel delay': the ages, the metres until it can react, the limit from them, the deadman, the echo.
    FAR: {
        **dict.fromkeys(("link_age_s", "link_age_last_s", "link_age_p50_s", "link_age_p99_s"), 0.2),
        "travel_speed_limit_mps": 1.0,
        "output_speed_mps": 1.0,
        "travel_delay_m": 1.0,
        "deadman_s": 0.8,
        "accepted_seq": 151,
    },
    f"{FAR}; tick 90": {
        "stop_reason": Reason.DEADMAN,
        "stop_detail": "none for 810 ms",
        "travel_delay_m": 0.0,
        "deadman_s": 0.8,
    },
    f"{FAR}; release": {"link_age_s": None, "link_age_p50_s": None, "accepted_seq": None, "deadman_s": 0.3},
}


@pytest.mark.parametrize(("row", "says"), list(SAID.items()))
def test_what_the_state_says(row: str, says: dict[str, object]) -> None:
    """Holder, link, limits, target and output, and why it stands still, in every state."""
    begin, _, steps = row.partition("; ")
    told = Told(begin)
    if steps:
        told.bench.play(steps)
    state = told.now()
    assert {name: getattr(state, name) for name in says} == says
    assert state.tick == told.bench.arbiter.tick_number


def test_a_decision_says_all_that_became_of_a_request() -> None:
    """Request, operator, lease, age, verdict, reason, limits, speed and angle before and after, frames sent."""
    told = Told("engaged")
    bench = told.bench
    bench.tick(count=3)
    bench.drive(1.0, challenge=2, angle_deg=2.0)
    assert bench.outcome is not None
    decision = told.reporter.decision(bench.outcome.judged[0], [Bound.ACCELERATION], 5, WALL_NS)
    assert (decision.request, decision.operator, decision.lease) == ("drive", "first", bench.lease)
    assert (decision.request_sequence, decision.age_ms) == (bench.sequence, 20.0)
    assert (decision.verdict, decision.reason, decision.detail) == (Verdict.ACCEPTED, Reason.NONE, "")
    assert decision.bound_by == [Bound.ACCELERATION]
    assert (decision.requested_speed_mps, decision.requested_angle_deg) == (1.0, 2.0)
    assert (decision.output_speed_mps, decision.output_angle_deg, decision.frames_sent) == (0.0, 0.6, 5)
    assert (decision.tick, decision.time_ns, decision.sequence) == (bench.arbiter.tick_number, WALL_NS, 0)


def test_a_refusal_is_bound_by_nothing() -> None:
    """It has a reason in words, with the figures; a verb asks for no speed."""
    told = Told()
    raw = RawRequest(1, "x" * 99, "second", b"", 0)
    decision = told.reporter.decision(Judged(raw, Ruling(Reason.TOO_OLD, "410 ms")), [Bound.SPEED], 0, WALL_NS)
    assert (decision.verdict, decision.reason, decision.bound_by) == (Verdict.REFUSED, Reason.TOO_OLD, [])
    assert decision.detail == f"{TEXTS[Reason.TOO_OLD].means}; 410 ms"
    assert (decision.requested_speed_mps, decision.requested_angle_deg, decision.age_ms) == (None, None, None)
    assert (decision.request, decision.output_speed_mps) == ("x" * 32, AT_REST.speed_mps)
    accepted = told.reporter.decision(Judged(raw, Ruling()), [Bound.SPEED], 0, WALL_NS)
    assert (accepted.bound_by, accepted.sequence) == ([], 1)


def test_an_event_keeps_what_it_is_made_of() -> None:
    """Each subject has its own sequence, which wraps."""
    told = Told("ready")
    told.bench.ask("acquire")
    told.reporter.sequences["SafetyEvent"] = SEQUENCE_MAX
    first, second = (told.reporter.event(told.bench.events[0], WALL_NS) for _ in range(2))
    assert (first.kind, first.operator, first.reason) == (EventKind.LEASE, "first", Reason.NONE)
    assert (first.text, first.time_ns) == ("first has acquired the lease as operator", WALL_NS)
    assert first.tick == told.bench.arbiter.tick_number
    assert (first.sequence, second.sequence) == (SEQUENCE_MAX, 0)


@pytest.mark.parametrize(
    ("verb", "ruling", "expected"),
    [
        ("acquire", Ruling(lease=7, expires_ns=2 * 10**9), LeaseReply(True, Reason.NONE, "", "", 7, 2.0)),  # noqa: FBT003
        ("engage", Ruling(lease=7), Reply(True, Reason.NONE, "", "")),  # noqa: FBT003
        ("nonsense", Ruling(), Reply(True, Reason.NONE, "", "")),  # noqa: FBT003
    ],
)
def test_a_reply_has_its_verbs_own_fields(verb: str, ruling: Ruling, expected: Reply) -> None:
    """The lease and its duration; a refusal has words and a cure for each reason."""
    made = reply(VerbAnswer(1, verb, ruling))
    assert (type(made), made) == (type(expected), expected)
    for reason in set(Reason) - {Reason.NONE}:
        refused = reply(VerbAnswer(1, verb, Ruling(reason, "42", lease=7)))
        assert (refused.ok, refused.reason, refused.cure) == (False, reason, TEXTS[reason].cure)
        assert refused.detail == f"{TEXTS[reason].means}; 42"
        assert refused.cure
        assert not isinstance(refused, LeaseReply) or refused.lease == 0
