"""The stop sequence, and when the guard acts."""

from collections.abc import Callable
from copy import deepcopy
from functools import cache
from math import inf, nan

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from gateway.chassis.cruiser.frames import load
from gateway.chassis.cruiser.gate import MOTION
from gateway.chassis.cruiser.guard_view import ChassisView
from gateway.chassis.layout import Decoded, Encoder, FrameDecoder, Value
from gateway.chassis.port import AT_REST, Actuation, AuxiliaryFrame
from gateway.choice.chassis import CHASSIS
from gateway.guard.guardian import Guardian
from gateway.guard.stopper import Cause, Stopper
from schemas.messages import GearPosition, Mode, ParkingStatus, Variant
from schemas.settings import (
    DISABLE_NS,
    GUARD_GIVES_UP_NS,
    GUARD_LATE_NS,
    GUARD_LOOK_NS,
    GUARD_POLL_NS,
    HOLD_NS,
    OFF_BURSTS,
    TICK_NS,
    CommandSettings,
)
from tests.support.frames import Feedback
from tests.support.rigs.guard import BURST, DRIVING, MS, GuardRig, S, Step

A_STOP_S = 8.0


@cache
def _driven(variant: Variant) -> GuardRig:
    rig = GuardRig(variant)
    rig.drive()
    return rig


def driven(variant: Variant = Variant.COARSE) -> GuardRig:
    return deepcopy(_driven(variant))


ENDS: dict[str, tuple[Step, Cause]] = {
    "killed": ({"parent_lives": False}, Cause.GONE),
    "stalled": ({"loop_lives": False}, Cause.LATE),
    "mute": ({"mute": True}, Cause.MUTE),
    "closed while it drives": (GuardRig.close, Cause.GONE),
}


@pytest.mark.parametrize("variant", [Variant.COARSE, Variant.FINE])
@pytest.mark.parametrize("end", ENDS)
def test_however_the_gateway_fails_the_robot_comes_to_rest(end: str, variant: Variant) -> None:
    rig = driven(variant)
    assert rig.chassis.state.speed_mps > 0.9
    assert rig.sent == []
    fails, cause = ENDS[end]
    rig.play(fails, A_STOP_S)
    state = rig.chassis.state
    assert state.speed_mps == 0
    assert state.parking_status is ParkingStatus.APPLIED
    assert state.mode is Mode.STOP
    assert rig.guardian.cause is cause
    assert rig.guardian.status(rig.now_ns, bus_up=True).says == f"{cause.value}; the robot stands"
    assert rig.guardian.stops == 1
    assert not rig.guardian.is_sending
    assert cause.value in rig.lines[0]
    assert f"the robot stands; {len(rig.sent)} frames sent" in rig.lines[1]
    assert rig.now_ns - rig.sent[-1][0] > S


def test_the_order_of_the_stop() -> None:
    """Row 'stop': the speed falls in gear, then the parking brake; neutral with the end of the enables."""
    rig = driven()
    rig.parent_lives = False
    rig.run(A_STOP_S)
    decoder = FrameDecoder(load(Variant.COARSE))
    seen: dict[str, int] = {}
    speeds = []
    for at_ns, frame in rig.sent:
        decoded = decoder.decode(frame)
        assert isinstance(decoded, Decoded)
        match decoded.signals:
            case {"TargetVelocity": float() as speed}:
                speeds.append(speed)
                if speed == 0:
                    seen.setdefault("zero speed", at_ns)
            case {"TargetGear": "neutral"}:
                seen.setdefault("neutral", at_ns)
            case {"ParkingRequest": True}:
                seen.setdefault("parking", at_ns)
        if frame.can_id in MOTION and decoded.signals["Enable"] is False:
            seen.setdefault("disabled", at_ns)
    assert speeds == sorted(speeds, reverse=True)
    assert list(seen) == sorted(seen, key=lambda name: seen[name])
    assert set(seen) == {"zero speed", "parking", "neutral", "disabled"}
    assert seen["neutral"] == seen["disabled"] > seen["parking"] > seen["zero speed"]
    assert seen["disabled"] - seen["parking"] >= HOLD_NS
    assert rig.sent[-1][0] - seen["disabled"] == pytest.approx(DISABLE_NS, abs=2 * TICK_NS)


def test_a_stop_that_nobody_heard_does_not_go_on() -> None:
    rig = driven(Variant.FINE)
    rig.parent_lives = False
    rig.run(0.1)
    drive = load(Variant.FINE).messages["Auto_DriveCmd"].can_id

    def told_raw() -> int:
        return [int.from_bytes(frame.data[1:3], "little") for _, frame in rig.sent if frame.can_id == drive][-1]

    before = told_raw()
    rig.takes = 0
    rig.run(1)
    rig.takes = BURST
    rig.run(0.02)
    # The pause counts as ten ticks at most, and 2 m/s2 are 20 bits a tick.
    assert 0 < before - told_raw() <= 220
    rig.run(A_STOP_S)
    assert "the robot stands" in rig.lines[-1]


def test_a_late_heartbeat_is_stopped_for_within_100_ms_and_not_before_its_limit() -> None:
    """The first look is when the heartbeat becomes late, the stop at the second, 5 ms later."""
    rig = driven()
    rig.loop_lives = False
    assert rig.beat is not None
    beat_ns = rig.beat.now_ns
    rig.look_when_due(0.2)
    assert (
        GUARD_LATE_NS + GUARD_POLL_NS <= rig.sent[0][0] - beat_ns <= GUARD_LATE_NS + GUARD_POLL_NS + MS < 100 * MS
    )


def test_a_robot_that_coasts_in_mode_stop_is_told_the_parking_brake() -> None:
    """Row 'a robot in mode stop that is seen to move', by the guard too."""
    rig = driven()
    rig.loop_lives = rig.parent_lives = False
    rig.pretend("Auto_MileageAndBodyFeedback", Valid=True, Mode="stop")
    parks = load(Variant.COARSE).messages["Auto_ParkingCmd"].can_id
    while not any(frame.can_id == parks and frame.data[1] for _, frame in rig.sent):
        rig.run(0.01)
    drive, gear, *_ = [frame for _, frame in rig.sent][-BURST:]
    assert (drive.data[0], drive.data[1:3], gear.data[1]) == (1, bytes(2), 4)
    assert rig.chassis.state.speed_mps > 0.8
    rig.run(A_STOP_S)
    assert rig.chassis.state.speed_mps == 0
    assert "the robot stands" in rig.lines[-1]


# What is played before the guard, and what it does: rows of one table.

Check = Callable[[GuardRig], None]


def told_mps(rig: GuardRig) -> float | None:
    """The highest speed that the guard has sent since the mark."""
    decoder = FrameDecoder(load(rig.variant))
    told = [decoder.decode(frame) for _, frame in rig.sent[rig.mark[0] :]]
    speeds = [one.signals.get("TargetVelocity") for one in told if isinstance(one, Decoded)]
    return max((float(speed) for speed in speeds if speed is not None), default=None)


FACTS: dict[str, Callable[[GuardRig], object]] = {
    "ended": lambda rig: rig.guardian.is_ended,
    "sending": lambda rig: rig.guardian.is_sending,
    "stops": lambda rig: rig.guardian.stops,
    "cause": lambda rig: rig.guardian.cause,
    "mode": lambda rig: rig.chassis.state.mode,
    "parked": lambda rig: rig.chassis.state.parking_status is ParkingStatus.APPLIED,
    "rests": lambda rig: rig.chassis.state.speed_mps == 0,
    "drives": lambda rig: rig.chassis.state.speed_mps > 0.5,
    "frames": lambda rig: len(rig.sent) - rig.mark[0],
    "by_loop": lambda rig: len(rig.by_loop) - rig.mark[1],
    "told_mps": told_mps,
    "fastest_mps": lambda rig: rig.fastest_mps,
    "lines": lambda rig: len(rig.lines),
    "left": lambda rig: rig.left is not None,
    "sends_much": lambda rig: len([frame for _, frame in rig.sent[rig.mark[0] :] if frame.can_id in MOTION]) > 100,
    "says": lambda rig: rig.lines[-1],
}
"""Those that are counted are counted since the mark."""


def seen(**expected: object) -> Check:
    """Check facts; ``says`` is a part of the last line."""

    def look(rig: GuardRig) -> None:
        for name, value in expected.items():
            fact = FACTS[name](rig)
            assert str(value) in str(fact) if name == "says" else fact == value, (name, fact, value)

    return look


def adopt_parked(rig: GuardRig) -> None:
    rig.chassis.adopt(speed_mps=0.0, angle_deg=0.0, gear=GearPosition.NEUTRAL, parked=True)


def forget(rig: GuardRig) -> None:
    """The chassis holds no command, as after power-up."""
    rig.chassis._commands.clear()


def command_by_other(rig: GuardRig) -> None:
    rig.guardian.receive(rig.maker.make(DRIVING, [], rig.variant)[0], rig.now_ns)


def be_commanded(rig: GuardRig) -> None:
    for _ in range(100):
        command_by_other(rig)
        rig.poll()


def drive_by_other(rig: GuardRig, speed_mps: float) -> None:
    """Another computer drives at this speed; the guard does not receive its frames."""
    for frame in rig.maker.make(replace(DRIVING, speed_mps=speed_mps), [], rig.variant):
        rig.chassis.receive(frame, rig.now_ns)


def replace_guard(rig: GuardRig) -> None:
    rig.guardian = Guardian(CHASSIS, CommandSettings())


def cut_short(rig: GuardRig) -> None:
    rig.guardian._stopper.give_up("cut short by this test")


def be_stopped_by_others(rig: GuardRig) -> None:
    """For six seconds the guard does not run, and others stop the robot."""
    for _ in range(1200):
        rig.now_ns += 5 * MS
        rig.chassis.advance(rig.now_ns)
        forget(rig)
    seen(rests=True)(rig)
    rig.set_mark()


def pause(seconds: float) -> Check:
    return lambda rig: setattr(rig, "now_ns", rig.now_ns + round(seconds * S))


def ask_to_end(rig: GuardRig) -> None:
    rig.guardian.ask_to_end()


MARK = GuardRig.set_mark
STALL, LIVE, KILL = {"loop_lives": False}, {"loop_lives": True}, {"parent_lives": False}
SILENCE = {"told": None}
NO_BUS, BUS, FULL = {"bus_up": False}, {"bus_up": True}, {"takes": 0}
REMOTE, GIVEN_BACK = "transmitter remote", "transmitter command"
FIRST: tuple[Step, ...] = (GuardRig.drive,)
LEFT: tuple[Step, ...] = (*FIRST, REMOTE, 0.1, SILENCE, 1.0)
"""Driven at 1 m/s, then taken over; the gateway has given way, and lives."""

TAKEN_IN_A_STOP: tuple[Step, ...] = (*FIRST, KILL, 0.2, REMOTE, 0.1)
AT_REST_SAID = seen(rests=True, says="the robot stands")
NEAR_THE_END, AFTER_THE_END = GUARD_GIVES_UP_NS / S - 1, 2.0

SCENES: dict[str, tuple[Step, ...]] = {
    # The loop.
    "a gateway that tells the chassis nothing may be late or end: the guard leaves": (
        (0.5, STALL, 0.5, seen(ended=False), KILL, 0.01, seen(ended=True, frames=0, lines=0)),
    ),
    "one late look is not enough: the machine stood still as a whole": (
        (*FIRST, pause(0.3), STALL, 0.005, LIVE, 1.0, seen(frames=0)),
    ),
    "a loop that comes back finds the stop carried through, sends nothing beside it and is watched again": (
        (*FIRST, STALL, 0.2, seen(sending=True, stops=1), MARK, LIVE, SILENCE, A_STOP_S),
        (seen(by_loop=0, stops=1, rests=True), *FIRST, seen(drives=True), KILL, A_STOP_S),
        seen(stops=2, rests=True),
    ),
    "a loop that stays late is stopped for once": (*FIRST, STALL, 3 * A_STOP_S, seen(stops=1)),
    "a loop that stays mute is stopped for once": (*FIRST, {"mute": True}, 3 * A_STOP_S, seen(stops=1)),
    "the young beat of a dead gateway does not arm the guard again": (
        ({"told": Actuation(enabled=True)}, 0.02, KILL, 0.005, cut_short, 0.05, seen(stops=1, ended=True)),
    ),
    "a signal is ignored while the chassis is told something": (
        (*FIRST, ask_to_end, 0.1, seen(ended=False), {"told": AT_REST}, 0.1, SILENCE, 0.1, seen(ended=False)),
        (ask_to_end, 0.01, seen(ended=True)),
    ),
    "what the guard has ended itself is not left any more": (
        (*FIRST, STALL, A_STOP_S, MARK, seen(sending=False), LIVE, SILENCE, 0.5, seen(left=True), KILL, 0.5),
        seen(frames=0, ended=True),
    ),
    "a guard that stood still gives the robot back to a loop that drives": (
        (*FIRST, STALL, 0.2, LIVE, pause(1), GuardRig.loop, MARK, 0.5),
        seen(frames=0, sending=False, says="given back"),
    ),
    "a guard that stood still gives the robot back to a loop that stands by": (
        (*FIRST, STALL, 0.2, LIVE, pause(1), SILENCE, GuardRig.loop, GuardRig.loop, MARK, 0.5),
        seen(frames=0, sending=False, says="given back"),
    ),
    "a guard that stood still beside a dead gateway goes on from what it sees": (
        (*FIRST, KILL, 0.2, be_stopped_by_others, A_STOP_S, seen(fastest_mps=0, ended=True)),
    ),
    # The remote control.
    "given back unbraked and in mode stop, the robot is parked and told nothing old": (
        (*TAKEN_IN_A_STOP, 1.0, MARK, forget, GIVEN_BACK, A_STOP_S),
        seen(sends_much=True, told_mps=0, parked=True, ended=True),
    ),
    "given back rolling, the robot is told zero speed at once: who held the transmitter drove it": (
        (*TAKEN_IN_A_STOP, MARK, "sticks 0.6 0", 3.0, seen(drives=True), GIVEN_BACK, A_STOP_S),
        seen(told_mps=0, rests=True),
    ),
    "a robot that another computer has commanded meanwhile is left to it": (
        (*TAKEN_IN_A_STOP, 1.0, MARK, command_by_other, 0.1),
        seen(ended=True, frames=0, says="another computer"),
    ),
    "a chassis that is switched off under the remote control is waited for half a minute more": (
        (*TAKEN_IN_A_STOP, 2 * GUARD_GIVES_UP_NS / S, "silence all", NEAR_THE_END, seen(ended=False)),
        (AFTER_THE_END, seen(ended=True, says="its feedback has ended")),
    ),
    "a gateway that ended the command and goes leaves nothing to wait for": (
        (*FIRST, {"told": AT_REST}, 0.5, REMOTE, SILENCE, 0.5, KILL, 0.01, seen(ended=True, frames=0)),
    ),
    "a robot that was left, and commanded by others as the gateway hears, is not waited for": (
        (*LEFT, {"left": None}, 0.1, KILL, 0.01, seen(ended=True, stops=0)),
    ),
    "a robot that was left, and commanded by others as the guard alone hears, is not waited for": (
        (*LEFT, STALL, 0.3, command_by_other, 0.1, KILL, 0.01, seen(ended=True, stops=0)),
    ),
    "a signal is ignored while the chassis is left on a command": (*LEFT, ask_to_end, 0.1, seen(ended=False)),
    "a gateway that hangs is stopped for when the robot is given back, and not before": (
        (*LEFT, STALL, 30.0, seen(stops=0), GIVEN_BACK, A_STOP_S),
        seen(cause=Cause.LATE, mode=Mode.STOP, rests=True, sending=False),
    ),
    "a late loop is no matter where nothing was left": (
        (*LEFT, {"left": None}, 0.02, STALL, GIVEN_BACK, 1.0, seen(mode=Mode.AUTO, stops=0)),
    ),
    "a new guard knows by the heartbeat what was left": (
        (*LEFT, replace_guard, 0.5, KILL, 1.0, GIVEN_BACK, A_STOP_S),
        seen(rests=True, mode=Mode.STOP, ended=True),
    ),
    "a robot that was left and reads stop is told nothing old any more": (
        (*LEFT, forget, GIVEN_BACK, 0.5, seen(mode=Mode.STOP), KILL, A_STOP_S),
        seen(ended=True, sends_much=True, told_mps=0),
    ),
    # The bus.
    "a mute loop does not make what it told long ago new": (
        (*FIRST, {"mute": True}, NO_BUS, "silence all", 10.0, forget, BUS, 1.0, seen(told_mps=0)),
    ),
    "feedback that falls silent does not end the stop": (
        (*FIRST, "silence all", 0.3, KILL, A_STOP_S, seen(rests=True, parked=True, says="not seen to stand")),
    ),
    "a bus that comes back in time is used, and a loop that could act itself is not kept from it": (
        (*FIRST, KILL, NO_BUS, 2.0, seen(frames=0, sending=False, drives=True, ended=False)),
        (BUS, A_STOP_S, AT_REST_SAID),
    ),
    "a late stop is not begun beside another computer, but after it": (
        (*FIRST, KILL, NO_BUS, 1.0, BUS, be_commanded, seen(frames=0, ended=False)),
        (A_STOP_S, AT_REST_SAID),
    ),
    "what is not seen is waited for a little and then taken for a parked robot": (
        (*FIRST, KILL, NO_BUS, 1.0, forget, 3.0, adopt_parked, "silence all", 1.0, BUS, MARK),
        (GUARD_LOOK_NS / S - 0.01, seen(frames=0), A_STOP_S, seen(told_mps=0, fastest_mps=0, parked=True)),
    ),
    "a bus that comes back after others stopped the robot": (
        (*FIRST, KILL, NO_BUS, 1.0, forget, 5.0, seen(mode=Mode.STOP), BUS, MARK, A_STOP_S),
        seen(fastest_mps=0, told_mps=0, ended=True),
    ),
    "a bus that is lost in a stop and comes back after others stopped the robot": (
        (*FIRST, KILL, 0.2, NO_BUS, 1.0, forget, 5.0, seen(mode=Mode.STOP), BUS, MARK, A_STOP_S),
        seen(fastest_mps=0, told_mps=0, ended=True),
    ),
}
WITHOUT_BUS: dict[str, tuple[Step, ...]] = {
    f"a guard that finds the bus {how} {when} gives up at last": (
        (*FIRST, KILL, *before, *knobs, NEAR_THE_END, seen(ended=False), AFTER_THE_END),
        seen(ended=True, says="given up"),
    )
    for how, knobs in {"lost": (NO_BUS, FULL), "full": (FULL,)}.items()
    for when, before in {"at its beginning": (), "in its stop": (0.2,)}.items()
}


TAKEN_OVER: dict[str, tuple[Step, ...]] = {
    f"taken over {when}, the robot gets zero speed, then silence; given back it is parked": (
        (*steps, 1.0, MARK, "sticks 0.8 0", driven_s, seen(drives=True, frames=0, ended=False)),
        (seen(says="remote control"), "sticks 0 0", 5.0, seen(rests=True), MARK, GIVEN_BACK, A_STOP_S),
        seen(fastest_mps=0, mode=Mode.STOP, parked=True, ended=True, stops=1),
    )
    for when, steps, driven_s in (
        ("before the gateway has seen it", (*FIRST, REMOTE, 0.1, KILL), 20.0),
        ("before the gateway dies", (*LEFT, KILL), 20.0),
        ("in the guard's stop", TAKEN_IN_A_STOP, 150.0),
    )
}
SCENES |= WITHOUT_BUS | TAKEN_OVER


@pytest.mark.parametrize("steps", SCENES.values(), ids=SCENES)
def test_what_the_guard_does(steps: tuple[Step, ...]) -> None:
    rig = GuardRig()
    rig.play(*steps)


@pytest.mark.parametrize(("told", "others_mps"), [(1.0, 0.3), (0.3, 1.0)])
def test_a_stop_that_begins_late_begins_at_the_lower_speed(told: float, others_mps: float) -> None:
    rig = GuardRig()
    rig.drive(replace(DRIVING, speed_mps=told))
    rig.play(KILL, NO_BUS, 1.0)
    drive_by_other(rig, others_mps)
    rig.play(3.0, BUS, A_STOP_S, AT_REST_SAID)
    assert 0.2 < (told_mps(rig) or 0) <= 0.3


def test_a_stop_begins_no_faster_than_the_robot_is_seen_to_be() -> None:
    rig = GuardRig(Variant.FINE)
    rig.drive(seconds=0.4)
    slowest_mps = rig.chassis.state.speed_mps
    assert 0 < slowest_mps < 0.7
    rig.play(KILL, A_STOP_S)
    assert 0 < (told_mps(rig) or 0) <= slowest_mps + 0.01


@pytest.mark.parametrize(
    ("name", "values"),
    [("Auto_DriveFeedBack", {"Speed": 0.5}), ("Auto_ParkingFeedBack", {"ParkingStatus": "released"})],
)
def test_a_guard_that_is_not_obeyed_says_so_and_leaves_the_parking_brake_told(
    name: str, values: dict[str, Value]
) -> None:
    """Row 'stop: neutral only behind an applied parking brake'."""
    rig = driven()
    rig.parent_lives = False
    rig.pretend(name, **values)
    rig.run(GUARD_GIVES_UP_NS / S + 1)
    assert rig.guardian.is_ended
    told = {frame.can_id: frame.data for _, frame in rig.sent[-5:]}
    assert told[load(Variant.COARSE).messages["Auto_ParkingCmd"].can_id][:2] == b"\1\1"
    assert told[load(Variant.COARSE).messages["Auto_GearCmd"].can_id][1] == 4
    assert "given up: no response to zero speed and the parking brake" in rig.lines[-1]


def test_horn_and_odometer_are_ended_with_the_robot_and_its_hazard_lights_are_on() -> None:
    """Row 'a latched stop', by the guard too."""
    rig = driven()
    on = [
        AuxiliaryFrame("Auto_SpeakerCmd", {"Horn": True}),
        AuxiliaryFrame("Auto_LightCmd", {"Headlamp": True, "LeftIndicator": True, "RightIndicator": True}),
        AuxiliaryFrame("Auto_OdometerCmd", {"Enable": True, "ClearMileage": True}),
    ]
    for frame in rig.maker.make(DRIVING, on, rig.variant):
        rig.chassis.receive(frame, rig.now_ns)
    rig.parent_lives = False
    first = rig.poll()
    assert [frame.can_id for frame in first[:5]] == list(MOTION)
    assert len(first) == BURST
    rig.run(A_STOP_S)
    commands = rig.chassis._commands
    for extra in on:
        lit = {name for name in extra.values if commands[extra.name][name]}
        assert lit == ({"LeftIndicator", "RightIndicator"} if extra.name == "Auto_LightCmd" else set())
    assert len([frame for _, frame in rig.sent if frame.can_id not in MOTION]) == 3 * OFF_BURSTS


ANY_FLOAT = st.floats(allow_nan=True, allow_infinity=True)
ACTUATIONS = st.builds(
    Actuation,
    enabled=...,
    gear=...,
    speed_mps=st.floats(-3, 3) | ANY_FLOAT,
    angle_deg=st.floats(-30, 30) | ANY_FLOAT,
    parking=...,
)


@given(
    ACTUATIONS,
    st.sampled_from([Variant.COARSE, Variant.FINE]),
    st.sampled_from(["known", "unknown"]),
    st.integers(0, 15),
    st.builds(
        CommandSettings, deceleration_mps2=st.floats(0.3, 2.0), emergency_deceleration_mps2=st.floats(0.5, 3.0)
    ),
)
def test_whatever_the_heartbeat_says_the_stop_passes_the_gate(
    last: Actuation, variant: Variant, scale: str, counter: int, command: CommandSettings
) -> None:
    rig = GuardRig(variant, command)
    rig.drive(seconds=0.5)
    assert rig.beat is not None
    rig.told, rig.loop_lives = last, False
    if scale == "unknown":
        rig.told_variant = Variant.UNKNOWN
    rig.beat = type(rig.beat)(
        now_ns=rig.now_ns, is_active=True, variant=rig.told_variant, last=last, counters=bytes([counter] * 8)
    )
    rig.parent_lives = False
    assert len(rig.poll()) == BURST
    rig.run(12)
    assert rig.chassis.state.speed_mps == 0
    assert rig.chassis.state.parking_status is ParkingStatus.APPLIED
    assert rig.guardian.is_ended
    assert "the robot stands" in rig.lines[-1]


@given(st.lists(st.integers(1, 8), min_size=1, max_size=40))
def test_the_guard_never_sends_while_the_loop_lives(pauses_ticks: list[int]) -> None:
    """The loop is up to 80 ms late."""
    rig = GuardRig()
    rig.drive(seconds=0.2)
    for pause_ticks in pauses_ticks:
        rig.loop_lives = False
        rig.run(pause_ticks * TICK_NS / S)
        rig.loop_lives = True
        rig.run(TICK_NS / S)
    assert rig.sent == []
    assert rig.guardian.stops == 0


def begun(view: ChassisView, counters: bytes | None, now_ns: int = 0) -> Stopper:
    stopper = Stopper(CHASSIS, view, CommandSettings())
    stopper.begin(DRIVING, Variant.COARSE, counters, now_ns)
    return stopper


@pytest.mark.parametrize("nonsense", [nan, inf])
def test_what_is_not_a_number_counts_as_zero(nonsense: float) -> None:
    stopper = Stopper(CHASSIS, ChassisView(), CommandSettings())
    last = replace(DRIVING, speed_mps=nonsense, angle_deg=nonsense)
    stopper.begin(last, Variant.COARSE, bytes(8), 0)
    decoder = FrameDecoder(load(Variant.COARSE))
    told = [decoder.decode(frame) for frame in stopper.tick(0)]
    assert isinstance(told[2], Decoded)
    assert isinstance(told[0], Decoded)
    assert told[2].signals["TargetAngle"] == pytest.approx(0, abs=0.05)
    assert told[0].signals["TargetVelocity"] == 0


def test_one_burst_a_tick() -> None:
    stopper = begun(ChassisView(), bytes(8))
    times_ns = [at_ns for at_ns in range(0, 10 * TICK_NS, TICK_NS // 5) if stopper.tick(at_ns)]
    assert times_ns == list(range(0, 10 * TICK_NS, TICK_NS))
    assert len([at_ns for at_ns in range(15 * TICK_NS, 17 * TICK_NS, TICK_NS // 5) if stopper.tick(at_ns)]) == 2


@pytest.mark.parametrize(
    ("known", "at_ms", "counters"),
    [
        pytest.param(None, 0, [9, 0, 0, 0, 0], id="without a heartbeat those heard, else 0"),
        pytest.param(7, 100, [9, 7, 7, 7, 7], id="heard a little ahead of the heartbeat's"),
        pytest.param(7, 300, [7, 7, 7, 7, 7], id="heard long ago, from another computer"),
        pytest.param(10, 0, [10, 10, 10, 10, 10], id="heard behind: repeated ones would be refused"),
    ],
)
def test_the_counters_go_on(known: int | None, at_ms: int, counters: list[int]) -> None:
    """The bus shows a drive command with counter 8."""
    view, encoder = ChassisView(), Encoder(load(Variant.COARSE))
    view.receive(encoder.encode("Auto_DriveCmd", {}, 8), 0)
    frames = begun(view, None if known is None else bytes([known] * 8), at_ms * MS).tick(at_ms * MS)
    assert [frame.data[6] >> 4 for frame in frames[:5]] == counters


def test_it_yields_to_the_hand_transmitter_between_two_ticks() -> None:
    view, feedback = ChassisView(), Feedback(Variant.COARSE)
    stopper = begun(view, bytes(8))
    assert stopper.tick(0)
    for at_ns in (1, 2):
        view.receive(feedback.frame("Auto_MileageAndBodyFeedback", {"Mode": "remote"}), at_ns)
    assert stopper.tick(3) == []
    assert stopper.is_paused
    assert not stopper.is_over
