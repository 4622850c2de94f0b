"""The command flow as a whole, at its seams: what is offered, what was sent."""

import msgspec
import pytest

from gateway.chassis.frame import GateFault
from gateway.choice import CHASSIS
from gateway.command.flow import CommandFlow
from gateway.command.rulings import RawRequest
from gateway.telemetry.health import Links
from schemas.decisions import ArbiterState, Decision, Reply, SafetyState, StopPhase
from schemas.messages import Mode, ParkingStatus, Variant
from schemas.reasons import Reason
from schemas.settings import MUTE_FAILURES, YIELD_BURSTS, CommandSettings, Settings
from tests.support.fakes.robot import message_of
from tests.support.frames import CHALLENGE
from tests.support.rigs.arbiter import MS, STANDING
from tests.support.rigs.gateway import GatewayRig, driving, ready

WALL_NS = 1_700_000_000_000_000_000


def flow(rig: GatewayRig) -> CommandFlow:
    assert rig.core.command is not None
    return rig.core.command


def refuse(made: CommandFlow, monkeypatch: pytest.MonkeyPatch) -> None:
    """From now on the gate refuses."""
    monkeypatch.setattr(made.gate, "admit", lambda *_, **__: GateFault(0x98C4D3D0, "because"))


def test_a_tick_makes_replies_and_messages() -> None:
    """And decisions come once it is known what was sent."""
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


def test_events_come_before_the_state_that_they_explain() -> None:
    """A state is not sent where nothing is due."""
    made = CommandFlow(CHASSIS, Settings(), 7)
    [state] = map(message_of, made.tick(STANDING, [], 10 * MS, WALL_NS, 0, CHALLENGE).samples)
    assert isinstance(state, SafetyState)
    assert made.tick(STANDING, [], 20 * MS, WALL_NS, 0, CHALLENGE).samples == []


@pytest.mark.parametrize("taken", [True, False])
def test_in_place_of_what_the_gate_refuses_the_parking_brake_is_told(
    monkeypatch: pytest.MonkeyPatch, *, taken: bool
) -> None:
    """In the same tick: zero speed, the parking brake and the gear as it was; later where the bus is full."""
    rig, operator = driving(1.0)
    made = flow(rig)
    rig._witness = lambda *_: None  # type: ignore[method-assign]
    verdicts = iter([GateFault(0x98C4D3D0, "because")])
    admit = made.gate.admit
    monkeypatch.setattr(made.gate, "admit", lambda *burst, **how: next(verdicts, None) or admit(*burst, **how))
    rig.put("first", "drive", operator.drive_payload(1.0))
    sent = len(rig.out)
    rig.takes = None if taken else 0
    rig.tick()
    assert made.arbiter.latches.details == {Reason.GATE: "18C4D3D0: because"}
    assert made.arbiter.state is ArbiterState.STOPPING
    assert not made.is_mute
    rig.takes = None
    rig.tick(not taken)
    drive, gear, _, _, parking, *_ = rig.out[sent:]
    assert int.from_bytes(drive.data[1:3], "little") == 0
    assert (gear.data[1], parking.data[1]) == (4, 1)
    rig.run(6)
    assert rig.speed_mps == 0
    assert rig.says.state is ArbiterState.STANDBY


def test_where_the_gate_refuses_the_parking_brake_too_the_guard_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing goes out, and the guard is told; what the gate admits later goes out, and the robot stops."""
    rig, _ = driving(1.0)
    made = flow(rig)
    rig._witness = lambda *_: None  # type: ignore[method-assign]
    sent = len(rig.out)
    with monkeypatch.context() as patch:
        refuse(made, patch)
        rig.tick(5)
        assert made.is_mute
        assert len(rig.out) == sent
        assert made.arbiter.state is ArbiterState.STOPPING
    rig.tick()
    assert not made.is_mute
    assert len(rig.out) == sent + 6, "the five, and the hazard lights"
    rig.run(6)
    assert rig.speed_mps == 0
    assert rig.says.state is ArbiterState.STANDBY


def test_the_gate_is_told_what_was_sent() -> None:
    """A counter that does not go on is refused."""
    rig, _ = driving(1.0)
    made = flow(rig)
    rig._witness = lambda *_: None  # type: ignore[method-assign]
    made.maker.counters["Auto_DriveCmd"] = (made.maker.counters["Auto_DriveCmd"] + 15) % 16
    rig.tick()
    assert made.arbiter.latches.details == {
        Reason.GATE: "18C4D3D0: the alive counter does not follow the last one"
    }


def test_nobody_is_mute_who_has_nothing_to_say(monkeypatch: pytest.MonkeyPatch) -> None:
    """Standing by."""
    rig, _ = driving(1.0)
    made = flow(rig)
    rig._witness = lambda *_: None  # type: ignore[method-assign]
    with monkeypatch.context() as patch:
        refuse(made, patch)
        rig.tick(3)
        assert made.is_mute
        rig.fault("transmitter remote")
        rig.tick(3 + YIELD_BURSTS)
        assert made.arbiter.state is ArbiterState.STANDBY
        assert not made.is_mute


def test_who_is_cut_off_from_a_chassis_that_obeys_leaves_it_to_the_guard() -> None:
    """Our way to the bus is lost while the robot drives: mute until it is back, so that the guard acts at once."""
    rig, _ = driving(1.0)
    made = flow(rig)
    rig._witness = lambda *_: None  # type: ignore[method-assign]
    rig.links = Links(bus_up=False, guarded=True, bus_losses=1, realtime=True)
    rig.tick()
    assert made.arbiter.state is ArbiterState.STANDBY
    assert made.is_mute
    rig.tick()
    assert made.is_mute
    rig.links = Links(bus_up=True, guarded=True, bus_losses=1, realtime=True)
    rig.tick()
    assert not made.is_mute
    rig.run(10)
    assert made.arbiter.state is ArbiterState.STANDBY
    rig.links = Links(bus_up=False, guarded=True, bus_losses=2, realtime=True)
    rig.tick()
    assert not made.is_mute, "standing by, nothing is left to anybody"


@pytest.mark.parametrize(("ticks", "mute"), [(MUTE_FAILURES - 1, False), (MUTE_FAILURES, True)])
def test_a_stop_that_the_bus_does_not_take_is_left_to_the_guard_in_the_end(ticks: int, mute: bool) -> None:  # noqa: FBT001
    """Not a drive that it does not take: that becomes a stop first. What it takes again ends it."""
    rig, _ = driving(1.0)
    rig._witness = lambda *_: None  # type: ignore[method-assign]
    rig.takes = 0
    rig.tick(ticks)
    assert flow(rig).arbiter.state is ArbiterState.STOPPING
    assert flow(rig).is_mute is mute
    rig.takes = None
    rig.tick()
    assert not flow(rig).is_mute


def test_whole_bursts_alone_count_as_told() -> None:
    """Of a part the chassis has heard some; the time since it was told all goes on."""
    rig, operator = driving(1.0)
    assert flow(rig).arbiter.output.told_ns == rig.now_ns
    told_ns = rig.now_ns
    rig.takes = 4
    operator.drive(1.0)
    assert flow(rig).arbiter.output.told_ns == told_ns
    rig.takes = 5
    operator.drive(1.0)
    assert flow(rig).arbiter.output.told_ns == rig.now_ns


def test_a_ramp_goes_on_where_the_bus_takes_the_speed_and_little_more() -> None:
    """The speed is the first frame of a burst; the rest is told when there is room."""
    rig, _ = driving(1.0)
    rig.put("anyone", "stop", b"")
    rig.takes = 1
    begun = len(rig.heard)
    rig.tick(70)
    assert rig.heard[begun:] == sorted(rig.heard[begun:], reverse=True)
    assert rig.heard[-1] == 0
    assert flow(rig).arbiter.output.stop_phase is StopPhase.PARK
    assert rig.chassis.state.parking_status is not ParkingStatus.APPLIED, "the brake was not heard yet"
    rig.takes = None
    rig.run(0.1)
    assert flow(rig).arbiter.output.stop_phase is StopPhase.HOLD


def test_after_a_silence_the_gate_begins_anew() -> None:
    """The remote control has steered meanwhile: the first burst is not held against the last one."""
    rig, operator = ready()
    operator.engage()
    operator.drive(0.0, 20.0, 0.5)
    rig.fault("transmitter remote for 60ms")
    rig.tick(6)
    angle = {"angle_deg": -20.0}
    chassis = msgspec.structs.replace(STANDING, mode=Mode.STOP, **angle)
    made = flow(rig)
    while made.arbiter.state is not ArbiterState.STANDBY:
        rig.tick()
    engage = RawRequest(
        9, "engage", "first", msgspec.msgpack.encode({"lease": operator.lease, "challenge": CHALLENGE}), 40
    )
    now_ns = rig.now_ns
    frames = []
    for tick in range(1, 12):
        due = made.tick(chassis, [engage] if tick == 8 else [], now_ns + tick * 10 * MS, WALL_NS, 0, CHALLENGE)
        made.sent(len(due.frames), now_ns + tick * 10 * MS, WALL_NS)
        frames += due.frames
    assert Reason.GATE not in made.arbiter.latches.details
    assert frames


def test_send_failures_are_counted_in_a_row() -> None:
    """One whole burst in between begins anew; lamps that were not taken count too."""
    rig, operator = driving(0.5)
    monitor = flow(rig).arbiter.monitor
    for takes, failures in ((4, 1), (0, 2), (None, 0), (3, 1)):
        rig.takes = takes
        motion = flow(rig).arbiter.output.motion
        operator_payload = operator.drive_payload(0.5)
        rig.put("first", "drive", operator_payload)
        rig.tick()
        assert monitor.send_failures == failures
        assert (flow(rig).arbiter.output.motion is motion) is (takes is not None), "what was not taken was no step"
    rig.takes = None
    operator.reason("horn", on=True)
    rig.takes = 5
    before = flow(rig).arbiter.output.motion
    rig.put("first", "drive", operator.drive_payload(0.5))
    rig.tick()
    assert monitor.send_failures == 1
    assert flow(rig).arbiter.output.motion is not before, "the five were taken: that was a step"


def test_decisions_are_bound_while_it_is_engaged_only() -> None:
    """Otherwise no limit has changed anything."""
    rig, operator = driving(0.5)
    rig.put("first", "drive", operator.drive_payload(9.0))
    rig.tick()
    assert {bound.value for bound in rig.decided[-1].bound_by} == {"speed", "acceleration"}
    operator.drive(9.0, seconds=0.1)
    rig.put("anyone", "stop", b"")
    rig.put("first", "drive", operator.drive_payload(9.0))
    rig.tick()
    assert rig.decided[-1].bound_by == []


@pytest.mark.parametrize("variant", [Variant.COARSE, Variant.FINE])
def test_the_hardest_settings_make_no_frame_that_does_not_fit(variant: Variant) -> None:
    """The greatest accelerations, at the greatest speeds and angles."""
    command = CommandSettings(
        speed_limit_mps=2.222,
        acceleration_mps2=1.5,
        deceleration_mps2=2.0,
        emergency_deceleration_mps2=3.0,
        lateral_acceleration_mps2=3.0,
    )
    rig, operator = ready(variant, command)
    operator.engage()
    for speed_mps, angle_deg in ((9.0, 90.0), (-9.0, -90.0), (3e-300, 0.0), (-5e-324, 24.0), (2.222, 0.0)):
        operator.drive(speed_mps, angle_deg, 2.0)
        assert rig.says.engaged
    rig.put("anyone", "stop", b"")
    rig.run(6)
    assert rig.speed_mps == 0
