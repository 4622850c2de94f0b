"""When the guard acts: after the gateway, never beside it, and until the robot rests."""

from collections.abc import Callable, Iterable
from copy import deepcopy
from functools import cache

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from gateway.chassis.cruiser.bursts import AuxiliaryFrame
from gateway.chassis.cruiser.frames import load
from gateway.chassis.cruiser.gate import MOTION
from gateway.chassis.frame import Frame
from gateway.chassis.layout import Decoded, Encoder, FrameDecoder, Value
from gateway.chassis.port import AT_REST, Actuation
from gateway.guard.guardian import Guardian
from gateway.guard.stopper import Cause
from schemas.messages import GearPosition, Mode, ParkingStatus, Variant
from schemas.settings import (
    DISABLE_NS,
    GUARD_GIVES_UP_NS,
    GUARD_LATE_NS,
    GUARD_LOOK_NS,
    GUARD_POLL_NS,
    HOLD_NS,
    NOT_SLOWING_NS,
    OFF_BURSTS,
    TICK_NS,
    CommandSettings,
)
from tests.support.rigs.guard import BURST, DRIVING, MS, GuardRig, S

A_STOP_S = 8.0


@cache
def _driven(variant: Variant) -> GuardRig:
    rig = GuardRig(variant)
    rig.drive()
    return rig


def driven(variant: Variant = Variant.COARSE) -> GuardRig:
    """A robot that the gateway drives at 1 m/s."""
    return deepcopy(_driven(variant))


def kill(rig: GuardRig) -> None:
    """The process ends."""
    rig.parent_lives = False


def stall(rig: GuardRig) -> None:
    """The process lives, and does nothing."""
    rig.loop_lives = False


def go_mute(rig: GuardRig) -> None:
    """The loop beats, and cannot send."""
    rig.mute = True


ENDS: dict[str, tuple[Callable[[GuardRig], None], Cause]] = {
    "killed": (kill, Cause.GONE),
    "stalled": (stall, Cause.LATE),
    "mute": (go_mute, Cause.MUTE),
    "closed while it drives": (GuardRig.close, Cause.GONE),
}


def no_speed(frames: Iterable[Frame]) -> bool:
    """None of them asks for a speed."""
    drive = load(Variant.COARSE).messages["Auto_DriveCmd"].can_id
    return not any(any(frame.data[1:3]) for frame in frames if frame.can_id == drive)


@pytest.mark.parametrize("variant", [Variant.COARSE, Variant.FINE])
@pytest.mark.parametrize("end", ENDS)
def test_however_the_gateway_fails_the_robot_comes_to_rest(end: str, variant: Variant) -> None:
    """Ramp in gear, parking brake, neutral, hold, disabled frames, silence; then the guard says what it did."""
    rig = driven(variant)
    assert rig.chassis.state.speed_mps > 0.9
    assert rig.sent == []
    fail, cause = ENDS[end]
    fail(rig)
    rig.run(A_STOP_S)
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
    """Row 'stop': the speed falls in gear, then the parking brake; neutral comes with the end of the enables."""
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


@pytest.mark.parametrize("heard", ["heard", "not heard"])
def test_the_counters_go_on(heard: str) -> None:
    """For each command frame the guard's first counter follows the loop's last, and then +1 for each frame."""
    rig = GuardRig()
    rig.hears_loop = heard == "heard"
    rig.drive(seconds=1.53)
    rig.parent_lives = False
    rig.run(1)
    for can_id in MOTION:
        frames = [frame for frame in rig.by_loop if frame.can_id == can_id][-1:]
        frames += [frame for _, frame in rig.sent if frame.can_id == can_id]
        counters = [frame.data[6] >> 4 for frame in frames]
        assert counters == [(counters[0] + step) % 16 for step in range(len(counters))]


def test_a_gateway_that_died_between_the_frames_and_the_heartbeat_repeats_no_counter() -> None:
    """Two frames of a burst went out, the heartbeat did not: their counters go on from the bus."""
    rig = driven()
    burst = rig.maker.make(DRIVING, [], Variant.COARSE)
    for frame in burst[:2]:
        rig.guardian.receive(frame, rig.now_ns)
    rig.parent_lives = False
    first = {frame.can_id: frame.data[6] >> 4 for frame in rig.poll()}
    ahead = [(first[frame.can_id] - (frame.data[6] >> 4)) % 16 for frame in burst]
    assert ahead == [1, 1, 0, 0, 0]


def test_a_frame_that_the_bus_did_not_take_costs_no_counter() -> None:
    """A full transmit buffer takes two of five: the next burst repeats the counters of the three."""
    rig = driven()
    rig.parent_lives, rig.takes = False, 2
    first = rig.poll()
    rig.takes = BURST
    rig.poll()
    second = rig.poll()
    assert [frame.data[6] >> 4 for frame in second[:2]] == [((frame.data[6] >> 4) + 1) % 16 for frame in first]
    assert len(second) == BURST


def test_a_stop_that_nobody_heard_does_not_go_on() -> None:
    """The bus takes nothing for a second: the ramp goes on from the speed that the chassis was last told."""
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


def test_a_gateway_that_is_gone_is_noticed_at_the_next_look() -> None:
    """No waiting for the heartbeat to age."""
    rig = driven()
    rig.parent_lives = False
    assert len(rig.poll()) == BURST


def test_a_late_heartbeat_is_stopped_for_within_100_ms_and_not_before_its_limit() -> None:
    """The first look comes right when the heartbeat is late, and the stop with the second, 5 ms after it."""
    rig = driven()
    rig.loop_lives = False
    assert rig.beat is not None
    beat_ns = rig.beat.now_ns
    rig.look_when_due(0.2)
    assert (
        GUARD_LATE_NS + GUARD_POLL_NS <= rig.sent[0][0] - beat_ns <= GUARD_LATE_NS + GUARD_POLL_NS + MS < 100 * MS
    )


def test_one_late_look_is_not_enough() -> None:
    """A machine that stood still as a whole: the loop beats before the second look, and nothing is sent."""
    rig = driven()
    rig.now_ns += 300 * MS
    rig.loop_lives = False
    rig.poll()
    rig.loop_lives = True
    rig.run(1)
    assert rig.sent == []


def test_a_gateway_that_tells_the_chassis_nothing_is_let_go() -> None:
    """Standing by, it may be late or end as it likes: nothing is sent, and the guard leaves."""
    rig = GuardRig()
    rig.run(0.5)
    rig.loop_lives = False
    rig.run(0.5)
    assert not rig.guardian.is_ended
    rig.parent_lives = False
    rig.run(0.01)
    assert rig.guardian.is_ended
    assert rig.sent == []
    assert rig.lines == []


def test_a_guard_outlives_its_gateway_until_the_stop_is_done() -> None:
    """And then it leaves."""
    rig = driven()
    rig.parent_lives = False
    while rig.poll() or rig.guardian.is_sending:
        assert not rig.guardian.is_ended
    rig.run(0.01)
    assert rig.guardian.is_ended
    assert rig.chassis.state.speed_mps == 0


def test_a_loop_that_comes_back_finds_the_stop_carried_through_and_is_watched_again() -> None:
    """Nobody sends beside the guard; later the loop drives again and fails again, and is stopped for again."""
    rig = driven()
    rig.loop_lives = False
    rig.run(0.2)
    # Counted from its beginning: a loop that was away for all of it still learns of it.
    assert (rig.guardian.is_sending, rig.guardian.stops) == (True, 1)
    by_loop = len(rig.by_loop)
    rig.loop_lives, rig.told = True, None
    rig.run(A_STOP_S)
    assert len(rig.by_loop) == by_loop
    assert (rig.guardian.stops, rig.chassis.state.speed_mps) == (1, 0)
    rig.drive()
    assert rig.chassis.state.speed_mps > 0.9
    rig.parent_lives = False
    rig.run(A_STOP_S)
    assert (rig.guardian.stops, rig.chassis.state.speed_mps) == (2, 0)


@pytest.mark.parametrize("end", ["stalled", "mute"])
def test_one_failure_is_stopped_for_once(end: str) -> None:
    """A loop that stays late or mute after the stop is not stopped for again, and again."""
    rig = driven()
    ENDS[end][0](rig)
    rig.run(3 * A_STOP_S)
    assert rig.guardian.stops == 1


def taken_over_before(rig: GuardRig) -> None:
    """The gateway dies when it has not seen yet that the remote control has the robot."""
    rig.fault("transmitter remote")
    rig.run(0.1)
    rig.parent_lives = False


def taken_over_and_left(rig: GuardRig) -> None:
    """The gateway gives way to the remote control, and dies later."""
    rig.fault("transmitter remote")
    rig.run(0.1)
    rig.told = None
    rig.run(1)
    rig.parent_lives = False


def taken_over_during(rig: GuardRig) -> None:
    """In the middle of the guard's stop."""
    rig.parent_lives = False
    rig.run(0.2)
    rig.fault("transmitter remote")
    rig.run(0.1)


@pytest.mark.parametrize(
    ("take_over", "driven_s"), [(taken_over_before, 20), (taken_over_and_left, 20), (taken_over_during, 150)]
)
def test_the_hand_transmitter_has_the_robot(take_over: Callable[[GuardRig], None], driven_s: float) -> None:
    """It is left with zero speed, then silence for minutes. Given back it does not move, and is parked."""
    rig = driven()
    take_over(rig)
    rig.run(1)
    sent = len(rig.sent)
    rig.fault("sticks 0.8 0")
    rig.run(driven_s)
    assert rig.chassis.state.speed_mps > 0.7
    assert len(rig.sent) == sent
    assert not rig.guardian.is_ended
    assert "remote control" in rig.lines[-1]
    rig.fault("sticks 0 0")
    rig.run(5)
    assert rig.chassis.state.speed_mps == 0
    rig.fault("transmitter command")
    fastest_mps = 0.0
    for _ in range(round(A_STOP_S / 0.005)):
        rig.poll()
        fastest_mps = max(fastest_mps, abs(rig.chassis.state.speed_mps))
    assert fastest_mps == 0
    assert rig.chassis.state.mode is Mode.STOP
    assert rig.chassis.state.parking_status is ParkingStatus.APPLIED
    assert rig.guardian.is_ended
    assert rig.guardian.stops == 1


def test_a_robot_that_is_given_back_unbraked_and_reads_stop_is_parked() -> None:
    """Nothing else holds it: zero speed and the parking brake, and nothing old."""
    rig = driven()
    taken_over_during(rig)
    rig.run(1)
    sent = len(rig.sent)
    rig.chassis._commands.clear()
    rig.fault("transmitter command")
    rig.run(A_STOP_S)
    after = [frame for _, frame in rig.sent[sent:] if frame.can_id in MOTION]
    assert len(after) > 100
    assert no_speed(after)
    assert rig.chassis.state.parking_status is ParkingStatus.APPLIED
    assert rig.guardian.is_ended


def test_a_robot_that_coasts_in_mode_stop_is_told_the_parking_brake() -> None:
    """Row 'a robot in mode stop that is seen to move: enables, zero speed, parking brake', by the guard too."""
    rig = driven()
    rig.loop_lives = rig.parent_lives = False
    body = load(Variant.COARSE).messages["Auto_MileageAndBodyFeedback"].can_id
    encoder = Encoder(load(Variant.COARSE))
    rig.see = lambda frame: (
        encoder.encode("Auto_MileageAndBodyFeedback", {"Valid": True, "Mode": "stop"}, frame.data[6] >> 4)
        if frame.can_id == body
        else frame
    )
    parks = load(Variant.COARSE).messages["Auto_ParkingCmd"].can_id
    while not any(frame.can_id == parks and frame.data[1] for _, frame in rig.sent):
        rig.run(0.01)
    drive, gear, *_ = [frame for _, frame in rig.sent][-BURST:]
    assert (drive.data[0], drive.data[1:3], gear.data[1]) == (1, bytes(2), 4)
    assert rig.chassis.state.speed_mps > 0.8
    rig.run(A_STOP_S)
    assert rig.chassis.state.speed_mps == 0
    assert "the robot stands" in rig.lines[-1]


@pytest.mark.parametrize("moves", [True, False])
def test_a_guard_that_is_not_obeyed_says_so_and_leaves_the_parking_brake_told(*, moves: bool) -> None:
    """Row 'stop: neutral only behind an applied parking brake': in gear to the end, and no word of a full bus."""
    rig = driven()
    rig.parent_lives = False
    parking = load(Variant.COARSE).messages["Auto_ParkingFeedBack"].can_id
    drive = load(Variant.COARSE).messages["Auto_DriveFeedBack"].can_id
    encoder = Encoder(load(Variant.COARSE))
    false_words: dict[int, tuple[str, dict[str, Value]]] = {
        parking: ("Auto_ParkingFeedBack", {"ParkingStatus": "released"})
    }
    if moves:
        false_words = {drive: ("Auto_DriveFeedBack", {"Speed": 0.5})}

    def see(frame: Frame) -> Frame:
        words = false_words.get(frame.can_id)
        return frame if words is None else encoder.encode(*words, frame.data[6] >> 4)

    rig.see = see
    rig.run(GUARD_GIVES_UP_NS / S + 1)
    assert rig.guardian.is_ended
    told = {frame.can_id: frame.data for _, frame in rig.sent[-5:]}
    assert told[load(Variant.COARSE).messages["Auto_ParkingCmd"].can_id][:2] == b"\1\1"
    assert told[load(Variant.COARSE).messages["Auto_GearCmd"].can_id][1] == 4
    assert "given up: it is told zero speed and the parking brake" in rig.lines[-1]


def test_a_robot_that_is_given_back_to_another_computer_is_left_to_it() -> None:
    """A new gateway has commanded it meanwhile: its last command is not ours any more."""
    rig = driven()
    taken_over_during(rig)
    rig.run(1)
    sent = len(rig.sent)
    rig.guardian.receive(rig.maker.make(DRIVING, [], rig.variant)[0], rig.now_ns)
    rig.run(0.1)
    assert rig.guardian.is_ended
    assert len(rig.sent) == sent
    assert "another computer" in rig.lines[-1]


def test_a_chassis_that_is_switched_off_under_the_hand_transmitter_is_waited_for_no_longer() -> None:
    """For as long as the chassis is heard, and no bus for half a minute after."""
    rig = driven()
    taken_over_during(rig)
    rig.run(2 * GUARD_GIVES_UP_NS / S)
    rig.fault("silence all")
    rig.run(GUARD_GIVES_UP_NS / S - 1)
    assert not rig.guardian.is_ended
    rig.run(2)
    assert rig.guardian.is_ended
    assert "not heard any more" in rig.lines[-1]


def test_a_gateway_that_ended_the_command_and_goes_leaves_nothing_to_wait_for() -> None:
    """Disabled frames were the last: under the remote control or not, the guard leaves with it."""
    rig = driven()
    rig.told = AT_REST
    rig.run(0.5)
    rig.fault("transmitter remote")
    rig.told = None
    rig.run(0.5)
    rig.parent_lives = False
    rig.run(0.01)
    assert rig.guardian.is_ended
    assert rig.sent == []


@pytest.mark.parametrize("heard", ["by the gateway", "by the guard alone"])
def test_a_robot_that_was_left_and_is_commanded_by_others_is_not_waited_for(heard: str) -> None:
    """The gateway gave way and dies later; somebody else has commanded the chassis meanwhile."""
    rig = left_under_the_transmitter()
    if heard == "by the gateway":
        rig.left = None
    else:
        rig.loop_lives = False
        rig.run(0.3)
        rig.guardian.receive(rig.maker.make(DRIVING, [], rig.variant)[0], rig.now_ns)
    rig.run(0.1)
    rig.parent_lives = False
    rig.run(0.01)
    assert rig.guardian.is_ended
    assert rig.guardian.stops == 0


def left_under_the_transmitter() -> GuardRig:
    """Driven at 1 m/s, then taken over; the gateway has given way, and lives."""
    rig = driven()
    rig.fault("transmitter remote")
    rig.run(0.1)
    rig.told = None
    rig.run(1)
    return rig


def test_a_signal_is_ignored_while_the_chassis_is_left_on_a_command() -> None:
    """It may be given back at any time."""
    rig = left_under_the_transmitter()
    rig.guardian.ask_to_end()
    rig.run(0.1)
    assert not rig.guardian.is_ended


def test_a_gateway_that_hangs_while_the_hand_transmitter_has_the_robot_is_stopped_for() -> None:
    """Row 'gateway hung': given back, the chassis obeys its old command. Not before: a person drives."""
    rig = left_under_the_transmitter()
    rig.loop_lives = False
    rig.run(30)
    assert rig.guardian.stops == 0
    rig.fault("transmitter command")
    rig.run(A_STOP_S)
    assert rig.guardian.cause is Cause.LATE
    assert rig.chassis.state.mode is Mode.STOP
    assert rig.chassis.state.speed_mps == 0
    assert not rig.guardian.is_sending


def test_what_the_guard_has_ended_itself_is_not_left_any_more() -> None:
    """The gateway was paused, comes back, gives way, and goes: nothing more is sent, for the stop was complete."""
    rig = driven()
    rig.loop_lives = False
    rig.run(A_STOP_S)
    sent = len(rig.sent)
    assert not rig.guardian.is_sending
    rig.loop_lives, rig.told = True, None
    rig.run(0.5)
    assert rig.left is not None
    rig.parent_lives = False
    rig.run(0.5)
    assert len(rig.sent) == sent
    assert rig.guardian.is_ended


def test_a_late_loop_is_no_matter_where_nothing_was_left() -> None:
    """Standing by, in auto by another computer, the loop may be late as long as it likes."""
    rig = left_under_the_transmitter()
    rig.left = None
    rig.run(0.02)
    rig.loop_lives = False
    rig.fault("transmitter command")
    rig.run(1)
    assert rig.chassis.state.mode is Mode.AUTO
    assert rig.guardian.stops == 0


def test_a_new_guard_knows_what_was_left() -> None:
    """It was started when the gateway had given way already: the heartbeat tells it all."""
    rig = left_under_the_transmitter()
    rig.guardian = Guardian(CommandSettings())
    rig.run(0.5)
    rig.parent_lives = False
    rig.run(1)
    rig.fault("transmitter command")
    rig.run(A_STOP_S)
    assert rig.chassis.state.speed_mps == 0
    assert rig.chassis.state.mode is Mode.STOP
    assert rig.guardian.is_ended


def test_a_robot_that_was_left_and_reads_stop_is_told_nothing_old_any_more() -> None:
    """An enable was lost; the gateway dies; what it last told is overwritten, and the robot parked."""
    rig = left_under_the_transmitter()
    rig.chassis._commands.clear()
    rig.fault("transmitter command")
    rig.run(0.5)
    assert rig.chassis.state.mode is Mode.STOP
    rig.parent_lives = False
    rig.run(A_STOP_S)
    assert rig.guardian.is_ended
    frames = [frame for _, frame in rig.sent if frame.can_id in MOTION]
    assert len(frames) > 100
    assert no_speed(frames)


def test_a_mute_loop_does_not_make_what_it_told_long_ago_new() -> None:
    """Both ways to the bus were lost; others stopped the robot; the guard's is back, and sees nothing yet."""
    rig = driven()
    rig.mute, rig.bus_up = True, False
    rig.fault("silence all")
    rig.run(10)
    rig.chassis._commands.clear()
    rig.bus_up = True
    rig.run(1)
    speeds = [frame.data[1] for _, frame in rig.sent if frame.can_id == MOTION[0]]
    assert speeds
    assert not any(speeds)


def test_a_beat_of_a_dead_gateway_does_not_arm_the_guard_again() -> None:
    """The last one is young still when a short stop has ended: one failure is stopped for once."""
    rig = GuardRig()
    rig.told = Actuation(enabled=True)
    rig.run(0.02)
    rig.parent_lives = False
    rig.poll()
    rig.guardian._stopper.give_up("cut short by this test")
    rig.run(0.05)
    assert rig.guardian.stops == 1
    assert rig.guardian.is_ended


def test_feedback_that_falls_silent_does_not_end_the_stop() -> None:
    """Standstill cannot be seen, so the brake phase lasts its time; the rest follows, and the guard says so."""
    rig = driven()
    rig.fault("silence all")
    rig.run(0.3)
    rig.parent_lives = False
    rig.run(A_STOP_S)
    assert rig.chassis.state.speed_mps == 0
    assert rig.chassis.state.parking_status is ParkingStatus.APPLIED
    assert "not seen to stand" in rig.lines[-1]


def test_a_bus_that_comes_back_in_time_is_used() -> None:
    """Gone with the gateway for 2 s: the stop begins when it is there again."""
    rig = driven()
    rig.parent_lives = rig.bus_up = False
    rig.run(2)
    assert rig.sent == []
    # A loop that could act itself is not kept from it.
    assert not rig.guardian.is_sending
    assert rig.chassis.state.speed_mps > 0.9
    assert not rig.guardian.is_ended
    rig.bus_up = True
    rig.run(A_STOP_S)
    assert rig.chassis.state.speed_mps == 0
    assert "the robot stands" in rig.lines[-1]


def told_mps(rig: GuardRig, since: int = 0) -> list[float]:
    """The speeds that the guard sent, from this frame on."""
    decoder = FrameDecoder(load(rig.variant))
    told = [decoder.decode(frame) for _, frame in rig.sent[since:]]
    return [
        float(one.signals["TargetVelocity"])
        for one in told
        if isinstance(one, Decoded) and "TargetVelocity" in one.signals
    ]


def moved(rig: GuardRig, seconds: float) -> float:
    """The fastest that the robot was in this time."""
    fastest_mps = 0.0
    for _ in range(round(seconds / 0.005)):
        rig.poll()
        fastest_mps = max(fastest_mps, abs(rig.chassis.state.speed_mps))
    return fastest_mps


@pytest.mark.parametrize("lost_after_s", [0.0, 0.2])
def test_a_bus_that_comes_back_late_finds_a_robot_that_others_stopped(lost_after_s: float) -> None:
    """It reads stop: no ramp from the old speed, before the guard has begun or in the middle."""
    rig = driven()
    rig.parent_lives, rig.bus_up = False, lost_after_s > 0
    rig.run(lost_after_s)
    rig.bus_up = False
    rig.run(1)
    rig.chassis._commands.clear()
    rig.run(5)
    assert rig.chassis.state.mode is Mode.STOP
    rig.bus_up = True
    sent = len(rig.sent)
    assert moved(rig, A_STOP_S) == 0
    assert no_speed(frame for _, frame in rig.sent[sent:])
    assert rig.guardian.is_ended


@pytest.mark.parametrize(("told", "others_mps"), [(1.0, 0.3), (0.3, 1.0)])
def test_a_stop_that_begins_late_begins_at_the_lower_speed(told: float, others_mps: float) -> None:
    """Of what it was told before, and of what is seen now that others have driven it."""
    rig = GuardRig()
    rig.drive(replace(DRIVING, speed_mps=told))
    rig.parent_lives = rig.bus_up = False
    rig.run(1)
    for frame in rig.maker.make(replace(DRIVING, speed_mps=others_mps), [], rig.variant):
        rig.chassis.receive(frame, rig.now_ns)
    rig.run(3)
    rig.bus_up = True
    moved(rig, A_STOP_S)
    assert 0.2 < max(told_mps(rig)) <= 0.3
    assert "the robot stands" in rig.lines[-1]


def test_a_stop_begins_no_faster_than_the_robot_is_seen_to_be() -> None:
    """It is speeding up when the gateway dies: the rest of that is not what the guard wants."""
    rig = GuardRig(Variant.FINE)
    rig.drive(seconds=0.4)
    slowest_mps = rig.chassis.state.speed_mps
    assert 0 < slowest_mps < 0.7
    rig.parent_lives = False
    rig.run(A_STOP_S)
    assert 0 < max(told_mps(rig)) <= slowest_mps + 0.01


def test_a_robot_that_is_given_back_rolling_is_told_zero_speed_at_once() -> None:
    """No ramp: who held the transmitter drove it, not we."""
    rig = driven()
    taken_over_during(rig)
    sent = len(rig.sent)
    rig.fault("sticks 0.6 0")
    rig.run(3)
    assert rig.chassis.state.speed_mps > 0.5
    rig.fault("transmitter command")
    rig.run(A_STOP_S)
    assert max(told_mps(rig, sent)) == 0
    assert rig.chassis.state.speed_mps == 0


def test_what_is_not_seen_is_waited_for_a_little_and_then_taken_for_a_parked_robot() -> None:
    """The bus is back and nothing is heard on it: after 100 ms zero speed, and the parking brake stays applied."""
    rig = driven()
    rig.parent_lives = rig.bus_up = False
    rig.run(1)
    rig.chassis._commands.clear()
    rig.run(3)
    rig.chassis.adopt(speed_mps=0.0, angle_deg=0.0, gear=GearPosition.NEUTRAL, parked=True)
    rig.fault("silence all")
    rig.run(1)
    rig.bus_up = True
    rig.run(GUARD_LOOK_NS / S - 0.01)
    assert rig.sent == []
    assert moved(rig, A_STOP_S) == 0
    assert max(told_mps(rig)) == 0
    parking = load(rig.variant).messages["Auto_ParkingCmd"].can_id
    assert all(frame.data[1] & 1 for _, frame in rig.sent if frame.can_id == parking)
    assert rig.chassis.state.parking_status is ParkingStatus.APPLIED


def test_a_late_stop_is_not_begun_beside_another_computer() -> None:
    """Who commands the chassis by now may have come to stop it; when it ends, the robot is looked at again."""
    rig = driven()
    rig.parent_lives = rig.bus_up = False
    rig.run(1)
    rig.bus_up = True
    for _ in range(100):
        rig.guardian.receive(rig.maker.make(DRIVING, [], rig.variant)[0], rig.now_ns)
        rig.poll()
    assert rig.sent == []
    assert not rig.guardian.is_ended
    rig.run(A_STOP_S)
    assert rig.chassis.state.speed_mps == 0
    assert "the robot stands" in rig.lines[-1]


@pytest.mark.parametrize("lost_after_s", [0.0, 0.2])
@pytest.mark.parametrize("how", ["lost", "full"])
def test_a_guard_without_a_bus_gives_up_at_last(lost_after_s: float, how: str) -> None:
    """Before or in the middle of its stop; it says so, and leaves."""
    rig = driven()
    rig.parent_lives = False
    rig.bus_up = how == "full" or lost_after_s > 0
    rig.takes = BURST if lost_after_s else 0
    rig.run(lost_after_s)
    rig.bus_up, rig.takes = how == "full", 0
    rig.run(GUARD_GIVES_UP_NS / S - 1)
    assert not rig.guardian.is_ended
    rig.run(2)
    assert rig.guardian.is_ended
    assert "given up" in rig.lines[-1]


def test_a_signal_is_ignored_while_the_chassis_is_told_something() -> None:
    """A supervisor that ends every process at once must not take the guard from a robot that drives."""
    rig = driven()
    rig.guardian.ask_to_end()
    rig.run(0.1)
    assert not rig.guardian.is_ended
    rig.told = AT_REST
    rig.run(0.1)
    rig.told = None
    rig.run(0.1)
    assert not rig.guardian.is_ended
    rig.guardian.ask_to_end()
    rig.run(0.01)
    assert rig.guardian.is_ended


@pytest.mark.parametrize("does", ["drives", "stands by"])
def test_a_guard_that_stood_still_itself_gives_the_robot_back(does: str) -> None:
    """Meanwhile the loop counted on it no more, and drives, or has brought it to rest: two must not send."""
    rig = driven()
    rig.loop_lives = False
    rig.run(0.2)
    rig.loop_lives = True
    rig.now_ns += S
    if does == "stands by":
        rig.told = None
        rig.loop()
    rig.loop()
    sent = len(rig.sent)
    rig.run(0.5)
    assert len(rig.sent) == sent
    assert not rig.guardian.is_sending
    assert "given back" in rig.lines[-1]


def test_a_guard_that_stood_still_beside_a_dead_gateway_goes_on_from_what_it_sees() -> None:
    """Others have brought the robot to rest meanwhile: no ramp from where the guard was."""
    rig = driven()
    rig.parent_lives = False
    rig.run(0.2)
    for _ in range(1200):
        rig.now_ns += 5 * MS
        rig.chassis.advance(rig.now_ns)
        rig.chassis._commands.clear()
    assert rig.chassis.state.speed_mps == 0
    assert moved(rig, A_STOP_S) == 0
    assert rig.guardian.is_ended


def test_horn_and_odometer_are_ended_with_the_robot_and_its_hazard_lights_are_on() -> None:
    """Row 'a latched stop', the guard too. The chassis keeps all for ever, and nobody else is left to end it."""
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


def test_an_unknown_variant_is_told_zero_speed_only() -> None:
    """The gate lets nothing else through, so there is no ramp; not seen to slow, it gets its parking brake."""
    rig = driven()
    rig.told_variant = Variant.UNKNOWN
    rig.run(0.01)
    rig.parent_lives = False
    drive, gear, _, _, parking, *_ = rig.poll()
    assert not any(drive.data[1:3])
    assert (gear.data[1], parking.data[1]) == (4, 0)
    rig.run(NOT_SLOWING_NS / S)
    assert rig.sent[-1][1].data[1] == 1
    rig.run(A_STOP_S)
    assert rig.chassis.state.speed_mps == 0
    assert "the robot stands" in rig.lines[-1]


ANY_FLOAT = st.floats(allow_nan=True, allow_infinity=True)
ACTUATIONS = st.builds(
    Actuation,
    enabled=st.booleans(),
    gear=st.sampled_from(GearPosition),
    speed_mps=st.one_of(st.floats(-3, 3), ANY_FLOAT),
    angle_deg=st.one_of(st.floats(-30, 30), ANY_FLOAT),
    parking=st.booleans(),
)


@given(
    ACTUATIONS,
    st.sampled_from([Variant.COARSE, Variant.FINE]),
    st.sampled_from(["known", "unknown"]),
    st.integers(0, 15),
    st.builds(
        CommandSettings,
        deceleration_mps2=st.floats(0.3, 2.0),
        emergency_deceleration_mps2=st.floats(0.5, 3.0),
    ),
)
def test_whatever_the_heartbeat_says_the_stop_passes_the_gate(
    last: Actuation, variant: Variant, scale: str, counter: int, command: CommandSettings
) -> None:
    """Any speed, angle, gear, not a number, variant in doubt: every burst is admitted, and the robot rests."""
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
    """The loop may be late by up to 80 ms, as often as it likes."""
    rig = GuardRig()
    rig.drive(seconds=0.2)
    for pause_ticks in pauses_ticks:
        rig.loop_lives = False
        rig.run(pause_ticks * TICK_NS / S)
        rig.loop_lives = True
        rig.run(TICK_NS / S)
    assert rig.sent == []
    assert rig.guardian.stops == 0
