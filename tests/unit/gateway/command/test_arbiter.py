"""The arbiter's states, causes and outputs."""

import pytest

from gateway.chassis.port import Actuation, AuxiliaryFrame
from gateway.command.motion import Target
from gateway.command.rulings import Ruling
from schemas.decisions import ArbiterState, EventKind, Severity, StopPhase
from schemas.messages import GearPosition, Mode, ParkingStatus, Variant
from schemas.reasons import Reason
from schemas.settings import YIELD_BURSTS
from tests.support.rigs.arbiter import MS, ArbiterRig, engaged


def test_standing_by_is_silent() -> None:
    """Row 'standing by: silent on the bus'."""
    bench = ArbiterRig()
    for _ in range(50):
        assert bench.tick().actuation is None


def test_engaging_gives_five_enables_with_zero_speed_until_it_reads_auto() -> None:
    """Row 'engage: then five enables with zero speed, and mode must read auto'; the reply comes then."""
    bench = ArbiterRig()
    bench.changes = {"angle_deg": 7.0, "mode": Mode.STOP}
    bench.ask("acquire")
    assert bench.ask("engage").is_pending
    for _ in range(20):
        told = bench.arbiter.output.actuation
        assert told is not None
        assert (told.enabled, told.gear, told.speed_mps, told.parking) == (True, GearPosition.NEUTRAL, 0.0, True)
        assert told.angle_deg == 7.0, "the wheels stay where they are"
        assert bench.tick().answers == []
    bench.changes = {}
    [answer] = bench.tick().answers
    assert (answer.verb, answer.ruling.reason) == ("engage", Reason.NONE)
    assert bench.arbiter.state is ArbiterState.ENGAGED
    assert [event.operator for event in bench.told(EventKind.ENGAGED)] == ["first"]
    assert bench.arbiter.setpoint.target == Target(0.0, 7.0), "until the first command nothing changes"


def test_what_failed_before_does_not_count_after_engaging() -> None:
    """The bus takes our frames again, or we shall see."""
    bench = ArbiterRig()
    bench.arbiter.monitor.send_failures = 9
    bench.ask("acquire")
    bench.ask("engage")
    assert bench.arbiter.monitor.send_failures == 0
    assert bench.arbiter.state is ArbiterState.ENGAGING


def test_a_chassis_that_reads_auto_already_confirms_nothing() -> None:
    """By somebody's old enables: first ours have to be sent."""
    bench = ArbiterRig()
    bench.changes = {"mode": Mode.AUTO}
    bench.ask("acquire")
    bench.ask("engage")
    before = bench.arbiter.state
    bench.tick()
    assert (before, bench.arbiter.state) == (ArbiterState.ENGAGING, ArbiterState.ENGAGED)


def test_a_chassis_that_does_not_read_auto_in_a_second_is_not_engaged() -> None:
    """Row 'engage: mode must read auto within 1 s'."""
    bench = ArbiterRig()
    bench.changes = {"mode": Mode.STOP}
    bench.ask("acquire")
    bench.ask("engage")
    bench.tick(count=99)
    before = bench.arbiter.state
    [answer] = bench.tick().answers
    assert answer.ruling.reason is Reason.NOT_CONFIRMED
    assert (before, bench.arbiter.state) == (ArbiterState.ENGAGING, ArbiterState.STOPPING)


def test_a_bench_told_nothing_yet_stops_by_what_is_seen() -> None:
    """Engage and stop in one tick: the sequence begins at rest."""
    bench = ArbiterRig()
    bench.ask("acquire")
    bench.changes = {"mode": Mode.STOP}
    bench.ask("engage")
    bench.arbiter.output.actuation = None
    bench.ask("stop")
    assert bench.arbiter.output.actuation is not None
    assert bench.arbiter.output.actuation.speed_mps == 0


@pytest.mark.parametrize(("deadman_s", "ticks"), [(0.3, 30), (0.1, 10)])
def test_the_deadman(deadman_s: float, ticks: int) -> None:
    """Row 'deadman: no acceptable drive command for 300 ms: controlled stop'; from the moment it is engaged on."""
    bench = engaged(deadman_s=deadman_s)
    bench.drive()
    bench.tick(count=ticks)
    assert bench.arbiter.state is ArbiterState.ENGAGED
    bench.tick()
    assert bench.arbiter.engagement.stop_reason is Reason.DEADMAN
    assert bench.told(EventKind.STOP)[-1].text.endswith(f"none for {ticks * 10 + 10} ms")
    assert bench.told(EventKind.STOP)[-1].severity is Severity.INFO


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"missing": ("Auto_GearFeedBack", "Auto_LightFeedback")}, Reason.FEEDBACK_MISSING),
        ({"faulty": ("Auto_GearFeedBack",)}, Reason.FEEDBACK_FAULTY),
        ({"variant": Variant.UNKNOWN}, Reason.VARIANT_UNKNOWN),
        ({"variant": Variant.FINE}, Reason.VARIANT_UNKNOWN),
        ({"front_bumper": True}, Reason.FRONT_BUMPER),
        ({"rear_bumper": True}, Reason.REAR_BUMPER),
        ({"guarded": False}, Reason.UNGUARDED),
        ({"commander_ns": 10**12}, Reason.OTHER_COMMANDER),
    ],
)
def test_each_cause_stops_an_engaged_robot(changes: dict[str, object], reason: Reason) -> None:
    """In the tick in which it is seen, with an event that says so."""
    bench = engaged()
    bench.drive_for(100, 0.5)
    bench.changes = changes
    bench.drive(0.5)
    assert bench.arbiter.state is ArbiterState.STOPPING
    assert bench.arbiter.engagement.stop_reason is reason
    event = bench.told(EventKind.STOP)[-1]
    assert event.reason is reason
    if reason is Reason.FEEDBACK_MISSING:
        assert event.text.endswith("; Auto_GearFeedBack, Auto_LightFeedback")
    told = bench.arbiter.output.actuation
    assert told is not None
    expected_mps = 0.5 - (0.012 if reason is Reason.UNGUARDED else 0.02)
    assert told.speed_mps == pytest.approx(0.0 if reason is Reason.VARIANT_UNKNOWN else expected_mps)


def test_a_stop_ends_horn_lamps_and_clearing() -> None:
    """The chassis keeps the last command for ever: each is told off, or to hazard, while it is brought to rest."""
    bench = engaged()
    bench.ask("horn", on=True)
    bench.ask("light", headlamp=True)
    bench.ask("clear_odometer")
    bench.ask("stop")
    off = {frame.name: frame.values for frame in bench.tick().auxiliary}
    assert off == {
        "Auto_LightCmd": {"Headlamp": False, "RightIndicator": True, "LeftIndicator": True},
        "Auto_SpeakerCmd": {"Horn": False},
        "Auto_OdometerCmd": {"Enable": False, "ClearMileage": False},
    }


def test_a_horn_that_was_cut_off_does_not_sound_again() -> None:
    """Nothing resumes by itself, with the next engagement either."""
    bench = engaged()
    bench.ask("horn", on=True)
    bench.changes = {"mode": Mode.REMOTE}
    bench.tick()
    bench.changes = {"mode": Mode.STOP}
    bench.tick(count=6)
    bench.ask("engage")
    assert bench.tick().auxiliary == [AuxiliaryFrame("Auto_SpeakerCmd", {"Horn": False})]
    assert bench.tick(count=10).auxiliary == []


def test_unguarded_is_accepted_where_the_settings_say_so() -> None:
    """Else it refuses to engage."""
    bench = ArbiterRig(accept_unguarded=True)
    bench.changes = {"guarded": False}
    bench.engage()
    assert bench.arbiter.state is ArbiterState.ENGAGED


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"mode": Mode.REMOTE}, Reason.HAND_TRANSMITTER),
        ({"bus_up": False}, Reason.BUS_DOWN),
        ({"bus_losses": 1, "mode": Mode.UNDEFINED, "bus_up": False}, Reason.BUS_DOWN),
        ({"guard_sends": True}, Reason.GUARD),
    ],
)
@pytest.mark.parametrize("stopping", [True, False])
def test_the_output_ceases_at_once(changes: dict[str, object], reason: Reason, *, stopping: bool) -> None:
    """Row 'remote control takes over: output ceases at once', in a stop too."""
    bench = engaged()
    bench.drive_for(100, 0.5)
    if stopping:
        bench.ask("disengage")
    bench.ask("horn", on=True)
    handle = bench.ask("clear_odometer")
    bench.changes = changes
    outcome = bench.tick()
    # The remote control alone leaves a way to the chassis: it is left with zero speed and its parking brake.
    if reason is Reason.HAND_TRANSMITTER:
        left = outcome.actuation
        assert left is not None
        assert (left.enabled, left.gear, left.speed_mps, left.parking) == (True, GearPosition.DRIVE, 0.0, True)
    else:
        assert outcome.actuation is None
    assert outcome.auxiliary == []
    assert bench.arbiter.state is ArbiterState.STANDBY
    assert bench.arbiter.engagement.stop_reason is reason
    assert bench.arbiter.output.stop_phase is StopPhase.IDLE
    kind = EventKind.GUARD if reason is Reason.GUARD else EventKind.TAKEOVER
    assert [event.reason for event in bench.told(kind)] == [reason]
    assert (Reason.GUARD in bench.arbiter.latches.details) is (reason is Reason.GUARD)
    assert handle.reason in {Reason.MOVING, Reason.NOT_ENGAGED}
    bench.tick(count=YIELD_BURSTS - 1)
    for _ in range(50):
        assert bench.tick().actuation is None, "no automatic return"


AT_REST = {"speed_mps": 0.0, "wheel_speed_mps": 0.0, "fastest_wheel_mps": 0.0, "turns": False}


@pytest.mark.parametrize("seen", [{"pulses": 1}, {"fastest_wheel_mps": 0.5}, {"turns": True, "confirmed": False}])
@pytest.mark.parametrize("stopping", [True, False])
def test_a_robot_that_coasts_in_mode_stop_is_told_the_parking_brake(
    seen: dict[str, object], *, stopping: bool
) -> None:
    """Row 'a robot in mode stop that is seen to move: enables, zero speed, parking brake', until it stands."""
    bench = engaged()
    bench.drive_for(100, 0.5)
    if stopping:
        bench.ask("disengage")
    bench.changes = {"mode": Mode.STOP, **AT_REST, **seen}
    told = bench.tick().actuation
    assert told is not None
    assert (told.enabled, told.speed_mps, told.gear, told.parking) == (True, 0.0, GearPosition.DRIVE, True)
    bench.tick(count=1_000)
    assert bench.arbiter.output.stop_phase is StopPhase.HOLD, "a robot that is seen to move is not left"
    bench.changes = {"mode": Mode.STOP, **AT_REST}
    assert bench.tick(count=200).actuation is None
    assert bench.arbiter.engagement.stop_reason is (Reason.DISENGAGED if stopping else Reason.MODE_NOT_AUTO)


STOPPED_BY_GUARD = {
    "guard_stops": 1,
    "mode": Mode.STOP,
    "brake": ParkingStatus.APPLIED,
    "speed_mps": 0.0,
    "wheel_speed_mps": 0.0,
    "fastest_wheel_mps": 0.0,
}


@pytest.mark.parametrize("seen", [{}, {"mode": Mode.AUTO}, {"mode": Mode.UNDEFINED, "speed_mps": None}])
def test_a_gateway_that_comes_back_after_the_guard_has_ended_tells_the_chassis_nothing(
    seen: dict[str, object],
) -> None:
    """Row 'nothing ever resumes by itself': it was stopped at 1 m/s for 6 s, and the robot stands by now."""
    bench = engaged()
    bench.drive_for(150, 1.0)
    assert bench.arbiter.output.motion.speed_mps == 1.0
    bench.changes = STOPPED_BY_GUARD | seen
    bench.now_ns += 6000 * MS
    told = bench.tick(late_ns=6000 * MS).actuation
    # One that reads auto all the same is stopped from where it stands.
    assert (told is None) is (bench.chassis.mode is not Mode.AUTO)
    assert told is None or told.speed_mps == 0
    assert list(bench.arbiter.latches.details) == [Reason.GUARD]
    assert [event.reason for event in bench.told(EventKind.GUARD)] == [Reason.GUARD]
    for _ in range(300):
        told = bench.tick().actuation
        assert told is None or told.speed_mps == 0


def test_a_burst_that_left_after_a_pause_is_not_what_the_next_stop_begins_from() -> None:
    """It went out when the guard had brought the robot to rest; the chassis has hardly begun to obey it."""
    bench = engaged()
    bench.drive_for(150, 1.0)
    bench.now_ns += 3500 * MS
    bench.arbiter.output.told_ns = bench.now_ns
    bench.changes = {"guard_stops": 1, "mode": Mode.AUTO, "speed_mps": 0.04, "fastest_wheel_mps": 0.05}
    told = bench.tick(late_ns=0).actuation
    assert told is not None
    assert told.speed_mps < 0.04


@pytest.mark.parametrize(("slowest_mps", "first_mps"), [(0.0, 0.0), (0.4, 0.4), (None, 0.0), (1.3, 0.98)])
def test_an_unguarded_gateway_that_comes_back_stops_from_what_is_seen(
    slowest_mps: float | None, first_mps: float
) -> None:
    """Row 'loop late over 100 ms: stop': never from a speed above the one that the robot has now."""
    bench = ArbiterRig(accept_unguarded=True)
    bench.changes = {"guarded": False}
    bench.engage()
    bench.drive_for(150, 1.0)
    seen = {"speed_mps": slowest_mps, "wheel_speed_mps": slowest_mps, "fastest_wheel_mps": slowest_mps}
    bench.changes = {"guarded": False, "mode": Mode.AUTO} | seen
    bench.now_ns += 500 * MS
    told = bench.tick(late_ns=500 * MS).actuation
    assert told is not None
    assert told.speed_mps == pytest.approx(max(0.0, first_mps - (0.0 if first_mps == 0.98 else 0.02)), abs=1e-9)


def test_a_chassis_that_the_guard_left_to_the_hand_transmitter_is_stopped_when_it_is_given_back() -> None:
    """It still holds what it was told last."""
    bench = engaged()
    bench.drive_for(150, 1.0)
    bench.changes = {"guard_sends": True, "mode": Mode.REMOTE}
    bench.tick(count=5)
    bench.changes = {"mode": Mode.REMOTE, "guard_stops": 1}
    assert bench.tick(count=5).actuation is None
    bench.changes = {"mode": Mode.AUTO, "guard_stops": 1, "gear": GearPosition.DRIVE}
    told = bench.tick().actuation
    assert told is not None
    assert told.speed_mps == 0


def test_nothing_is_released_that_is_not_seen() -> None:
    """A remote stop, standing by, with no feedback at all: the parking brake is asked for from the first frame."""
    bench = ArbiterRig()
    blind = {"mode": Mode.UNDEFINED, "gear": GearPosition.UNDEFINED, "speed_mps": None, "fastest_wheel_mps": None}
    bench.changes = blind | {"missing": ("all",)}
    bench.ask("stop")
    for _ in range(600):
        told = bench.outcome.actuation if bench.outcome is not None else None
        assert told is None or (told.parking and told.speed_mps == 0)
        bench.tick()


@pytest.mark.parametrize("parked", [True, False])
def test_a_bus_that_comes_back_to_a_chassis_that_is_not_seen_parks_it(*, parked: bool) -> None:
    """What is not seen in the first moment may be seen in the next: nothing is told before."""
    bench = engaged()
    bench.drive_for(60, 0.0 if parked else 0.5)
    blind = {"mode": Mode.UNDEFINED, "gear": GearPosition.UNDEFINED}
    bench.changes = blind | {"bus_up": False, "bus_losses": 1}
    bench.tick(count=100)
    bench.changes = blind | {"bus_losses": 1}
    for _ in range(19):
        assert bench.tick().actuation is None
    told = bench.tick().actuation
    assert told is not None
    assert (told.speed_mps, told.parking) == (0.0, True)


@pytest.mark.parametrize(
    ("left_mps", "slowest_mps", "told_mps"),
    [(0.5, 0.3, 0.3), (0.5, 1.9, 0.5), (0.0, 1.9, 0.0), (-0.5, 0.3, 0.0)],
)
@pytest.mark.parametrize("latched", [True, False])
def test_a_robot_that_is_given_back_is_not_told_a_speed_above_what_it_was_left_on(
    left_mps: float, slowest_mps: float, told_mps: float, *, latched: bool
) -> None:
    """Row 'given back: never above the lower of left on and seen; emergency deceleration if latched'."""
    bench = engaged()
    bench.drive_for(150, left_mps)
    bench.changes = {"mode": Mode.REMOTE}
    bench.tick(count=100)
    if latched:
        bench.ask("stop", "anyone")
    moving = {"speed_mps": slowest_mps, "wheel_speed_mps": slowest_mps, "fastest_wheel_mps": slowest_mps}
    released = {"gear": GearPosition.DRIVE, "brake": ParkingStatus.RELEASED}
    bench.changes = {"mode": Mode.AUTO, **released, **moving}
    speeds = [told.speed_mps for told in (bench.tick().actuation for _ in range(40)) if told is not None]
    assert len(speeds) == 40
    step_mps = 0.02 if latched else 0.012
    assert speeds[:5] == pytest.approx([max(0.0, told_mps - step_mps * tick) for tick in range(1, 6)])
    assert speeds == sorted(speeds, reverse=True)


def test_who_waits_is_told_when_the_output_ceases() -> None:
    """And when it stops."""
    bench = ArbiterRig()
    bench.changes = {"mode": Mode.STOP}
    bench.ask("acquire")
    bench.ask("engage")
    bench.changes = {"mode": Mode.REMOTE}
    [answer] = bench.tick().answers
    assert (answer.verb, answer.ruling.reason) == ("engage", Reason.HAND_TRANSMITTER)
    bench.tick(count=YIELD_BURSTS)
    bench.changes = {}
    bench.tick(count=6)
    bench.ask("engage")
    bench.changes = {"front_bumper": True}
    [answer] = bench.tick().answers
    assert (answer.verb, answer.ruling.reason) == ("engage", Reason.FRONT_BUMPER)


def test_where_nobody_waits_nobody_is_told() -> None:
    """A result that nobody asked for."""
    bench = ArbiterRig()
    bench.arbiter.outbox.settle("engage", Ruling())
    assert bench.tick().answers == []


def test_the_mode_may_leave_auto_when_the_frames_are_disabled() -> None:
    """That is what they are for."""
    bench = engaged()
    bench.ask("disengage")
    while bench.arbiter.output.stop_phase is not StopPhase.DISABLE:
        bench.tick()
    for _ in range(49):
        assert bench.tick().actuation is not None
    assert bench.chassis.mode is Mode.STOP
    assert bench.tick().actuation is None
    assert bench.arbiter.state is ArbiterState.STANDBY
    [event] = bench.told(EventKind.STOPPED)
    assert (event.reason, event.severity) == (Reason.DISENGAGED, Severity.INFO)
    assert event.text.endswith("and stands")
    assert bench.told(EventKind.TAKEOVER) == []


def test_a_robot_that_is_not_seen_to_stand_at_the_end_is_an_error() -> None:
    """Somebody has to look."""
    bench = engaged()
    bench.changes = {"missing": ("Auto_DriveFeedBack",), "speed_mps": None}
    bench.tick(count=600)
    [event] = bench.told(EventKind.STOPPED)
    assert event.severity is Severity.ERROR
    assert event.text.endswith("but the robot is not seen to stand")


def test_a_stop_beside_another_commander_does_not_say_that_the_robot_is_safe() -> None:
    """It is told nothing by us any more, and may be moved by the other one at once."""
    bench = engaged()
    bench.ask("stop")
    for _ in range(400):
        bench.changes = {"commander_ns": bench.now_ns}
        bench.tick()
    [event] = bench.told(EventKind.STOPPED)
    assert event.text.endswith("but another computer commands it, and can move it")


@pytest.mark.parametrize("changes", [{"mode": Mode.AUTO}, {"mode": Mode.UNDEFINED, "missing": ("body",)}])
def test_what_was_left_under_command_is_stopped_when_it_may_obey_again(changes: dict[str, object]) -> None:
    """Row 'nothing ever resumes by itself': the chassis keeps our last command, and would."""
    bench = engaged()
    bench.changes = {"mode": Mode.REMOTE}
    bench.tick(count=100)
    assert bench.told(EventKind.STOP) == []
    bench.changes = changes
    bench.tick()
    assert bench.arbiter.state is ArbiterState.STOPPING
    assert bench.arbiter.engagement.stop_reason is Reason.FOUND_MOVING
    assert bench.arbiter.output.actuation is not None
    assert bench.arbiter.output.actuation.speed_mps == 0


@pytest.mark.parametrize(
    ("seen", "gear", "speed_mps", "angle_deg"),
    [
        ({"gear": GearPosition.DRIVE}, GearPosition.DRIVE, 1.0, 24.0),
        ({"gear": GearPosition.REVERSE, "wheel_speed_mps": -1.0}, GearPosition.REVERSE, 1.0, 24.0),
        ({"gear": GearPosition.NEUTRAL, "angle_deg": None}, GearPosition.NEUTRAL, 0.0, 0.0),
        ({"gear": GearPosition.DRIVE, "speed_mps": None, "angle_deg": -30.0}, GearPosition.DRIVE, 1.0, -24.0),
        ({"gear": GearPosition.DRIVE, "speed_mps": 2.5}, GearPosition.DRIVE, 1.309, 24.0),
    ],
)
def test_a_robot_found_moving_is_stopped_from_what_is_seen(
    seen: dict[str, object], gear: GearPosition, speed_mps: float, angle_deg: float
) -> None:
    """Row 'found at start: in auto, moving, nobody sending: the stop sequence, an event'."""
    bench = ArbiterRig()
    moving = {"mode": Mode.AUTO, "turns": True, "speed_mps": 1.0, "wheel_speed_mps": 1.0, "angle_deg": 30.0}
    released = {"brake": ParkingStatus.RELEASED}
    bench.changes = moving | released | {"fastest_wheel_mps": 2.6 if seen.get("speed_mps") else 1.0} | seen
    bench.tick(count=20)
    assert bench.arbiter.state is ArbiterState.STANDBY
    told = bench.tick().actuation
    assert told is not None
    assert (told.enabled, told.gear, told.parking) == (True, gear, gear is GearPosition.NEUTRAL)
    assert told.speed_mps == pytest.approx(max(0.0, speed_mps - 0.012), abs=1e-3)
    assert told.angle_deg == angle_deg
    assert [event.reason for event in bench.told(EventKind.STOP)] == [Reason.FOUND_MOVING]
    later = bench.tick(count=25).actuation
    assert later is not None
    assert later.speed_mps == pytest.approx(max(0.0, speed_mps - 26 * 0.012), abs=1e-3), "its scale is known"
    rolls = gear is GearPosition.NEUTRAL  # told to stand, and no slower for a fifth of a second
    assert [*bench.arbiter.latches.details] == [Reason.ROLLING] * rolls, "its own speed is no fault"


@pytest.mark.parametrize(("ticks", "parks"), [(10, True), (99, False)])
def test_a_mode_that_flickers_parks_a_robot_that_moves(ticks: int, *, parks: bool) -> None:
    """A stop out of standing by that follows another one within a second: no ramp begins over and over again."""
    bench = ArbiterRig()
    moving = {"gear": GearPosition.DRIVE, "brake": ParkingStatus.RELEASED, "turns": True, "angle_deg": 0.0}
    moving |= {"speed_mps": 1.0, "wheel_speed_mps": 1.0, "fastest_wheel_mps": 1.0}
    bench.changes = moving | {"mode": Mode.AUTO}
    told = bench.tick(count=21).actuation
    assert told is not None
    assert not told.parking
    bench.changes = moving | {"mode": Mode.REMOTE}
    bench.tick(count=ticks)
    bench.changes = moving | {"mode": Mode.AUTO}
    told = bench.tick().actuation
    assert told is not None
    assert told.parking is parks


@pytest.mark.parametrize(
    ("cause", "standing", "moving"),
    [
        ("deadman", Severity.INFO, Severity.WARNING),
        ("take", Severity.INFO, Severity.WARNING),
        ("disengage", Severity.INFO, Severity.INFO),
        ("release", Severity.INFO, Severity.INFO),
        ("stop", Severity.WARNING, Severity.WARNING),
    ],
)
@pytest.mark.parametrize("speed_mps", [0.0, 1.0])
def test_a_stop_at_speed_is_an_incident_unless_it_was_asked_for(
    cause: str, speed_mps: float, standing: Severity, moving: Severity
) -> None:
    """A warning makes an incident. The planned end of a drive makes none; a stop at once always does."""
    bench = engaged()
    bench.drive_for(200, speed_mps)
    if cause == "deadman":
        bench.tick(count=31)
    elif cause == "take":
        bench.ask("take", "second", role="supervisor", override=True)
    else:
        bench.ask(cause)
    [event] = bench.told(EventKind.STOP)
    assert event.severity is (moving if speed_mps else standing)


COASTING = {"mode": Mode.STOP, "gear": GearPosition.DRIVE, "brake": ParkingStatus.RELEASED}


@pytest.mark.parametrize(
    ("changes", "is_told"),
    [
        ({"mode": Mode.AUTO}, True),
        ({"mode": Mode.UNDEFINED}, True),
        ({"mode": Mode.STOP}, False),
        ({"mode": Mode.REMOTE}, False),
        ({"mode": Mode.AUTO, "bus_up": False}, False),
        ({"mode": Mode.AUTO, "guard_sends": True}, False),
        (COASTING | {"pulses": 1}, True),
        (COASTING | {"fastest_wheel_mps": 0.5}, True),
    ],
)
def test_a_remote_stop_while_standing_by(changes: dict[str, object], *, is_told: bool) -> None:
    """Row 'stop': latched always; sent where the chassis may obey an old command, or coasts in mode stop."""
    bench = ArbiterRig()
    bench.changes = changes
    bench.tick()
    bench.ask("stop", "anyone")
    told = bench.arbiter.output.actuation
    assert (told is not None) is is_told
    assert told is None or (told.enabled, told.speed_mps, told.parking) == (True, 0.0, True)
    assert Reason.REMOTE_STOP in bench.arbiter.latches.details
    assert bench.told(EventKind.LATCH)[-1].text.endswith("by anyone")


@pytest.mark.parametrize(
    ("changes", "reason", "detail"),
    [
        ({}, Reason.NONE, "the robot stands"),
        ({"mode": Mode.AUTO, "speed_mps": 0.7}, Reason.NONE, "the robot moves at 0.70 m/s"),
        (
            {"speed_mps": None, "fastest_wheel_mps": None},
            Reason.FEEDBACK_MISSING,
            "latched; not carried out: the robot is not seen to stand",
        ),
        ({"guard_sends": True}, Reason.NONE, "the guard is stopping it; the robot stands"),
        ({"bus_up": False}, Reason.BUS_DOWN, "latched; not carried out: the robot stands"),
        (
            {"mode": Mode.REMOTE, "fastest_wheel_mps": 0.8, "pulses": 1},
            Reason.HAND_TRANSMITTER,
            "latched; not carried out: the robot moves at 0.80 m/s",
        ),
        ({"commander_ns": 10**12}, Reason.OTHER_COMMANDER, "latched; not carried out: the robot stands"),
    ],
)
def test_the_reply_to_a_stop_says_what_the_robot_does(
    changes: dict[str, object], reason: Reason, detail: str
) -> None:
    """Row 'a stop that cannot be carried out: the reply says so with reason and what the robot does now'."""
    bench = ArbiterRig()
    bench.changes = changes
    bench.tick()
    ruling = bench.ask("stop", "anyone")
    assert (ruling.reason, ruling.detail) == (reason, detail)
    assert Reason.REMOTE_STOP in bench.arbiter.latches.details


def test_a_brake_that_does_not_read_applied_is_told_once() -> None:
    """Row 'stop: neutral only behind an applied parking brake': after 3 s, and in gear till then."""
    bench = engaged()
    bench.drive_for(100, 0.5)
    bench.changes = {"brake": ParkingStatus.RELEASED}
    bench.ask("stop")
    bench.tick(count=30)
    assert bench.arbiter.output.stop_phase is StopPhase.PARK
    bench.tick(count=269)
    assert bench.told(EventKind.FAULT) == []
    told = bench.tick(count=500).actuation
    [event] = bench.told(EventKind.FAULT)
    assert (event.reason, event.severity) == (Reason.NOT_CONFIRMED, Severity.ERROR)
    assert "the parking brake does not read applied" in event.text
    assert told is not None
    assert (told.gear, told.parking) == (GearPosition.DRIVE, True)


@pytest.mark.parametrize(
    ("changes", "reason", "ticks"),
    [
        ({"wheel_speed_mps": -0.11, "fastest_wheel_mps": 0.11, "speed_mps": 0.11}, Reason.ROLLING, 11),
        ({"pulses": -1}, Reason.ROLLING, 11),
        # So sudden a rise is that of a motor that has died: the parking brake, and no ramp.
        ({"speed_mps": 0.8, "wheel_speed_mps": 0.8, "fastest_wheel_mps": 0.8}, Reason.OVERSPEED, 11),
        ({"angle_deg": 5.1}, Reason.STEERING, 31),
    ],
)
def test_what_the_robot_does_of_itself_stops_it_and_is_latched(
    changes: dict[str, object], reason: Reason, ticks: int
) -> None:
    """Rows 'rolling', 'measured speed over the limit in force' (a lowered one) and 'steering'."""
    bench = ArbiterRig()
    bench.ask("acquire")
    bench.ask("engage", speed_limit_mps=0.5)
    bench.tick(count=2)
    bench.drive()
    bench.ask("unpark")
    bench.drive_for(150, 0.5)
    bench.changes = changes
    bench.drive_for(ticks - 1, 0.5)
    assert bench.arbiter.state is ArbiterState.ENGAGED
    bench.drive(0.5)
    assert [*bench.arbiter.latches.details] == [reason]
    told = bench.arbiter.output.actuation
    assert told is not None
    assert (told.speed_mps, told.parking) == ((0.48, False) if reason is Reason.STEERING else (0.0, True))


def test_stop_wins_over_everything_in_its_tick() -> None:
    """Row 'stop: from any operator, lease or not'; the emergency deceleration, also in a slower stop."""
    bench = engaged()
    bench.drive_for(200, 1.0)
    bench.ask("disengage")
    before = bench.arbiter.output.actuation
    bench.ask("stop", "second")
    after = bench.arbiter.output.actuation
    assert before is not None
    assert after is not None
    assert before.speed_mps - after.speed_mps == pytest.approx(0.02)
    assert bench.arbiter.engagement.stop_reason is Reason.DISENGAGED
    assert Reason.REMOTE_STOP in bench.arbiter.latches.details
    bench.ask("stop", "carl")
    assert len(bench.told(EventKind.LATCH)) == 1


def test_a_graver_cause_during_a_stop_latches() -> None:
    """The wheels do not slow down as they are told."""
    bench = engaged()
    bench.drive_for(200, 1.0)
    bench.ask("disengage")
    bench.changes = {"speed_mps": 1.0, "wheel_speed_mps": 1.0}
    bench.tick(count=100)
    assert Reason.IMPLAUSIBLE_SPEED in bench.arbiter.latches.details


def test_a_bumper_latches_in_every_state() -> None:
    """Row 'bumper: latched'."""
    bench = ArbiterRig()
    bench.changes = {"rear_bumper": True}
    bench.tick(count=3)
    assert [*bench.arbiter.latches.details] == [Reason.REAR_BUMPER]
    assert bench.arbiter.output.actuation is None
    assert len(bench.told(EventKind.LATCH)) == 1


def test_shutting_down() -> None:
    """Engaged: a controlled stop. Standing by: nothing. Then nobody engages it."""
    bench = engaged()
    bench.drive_for(10, 0.5)
    bench.arbiter.engagement.shut_down(bench.now_ns)
    assert bench.arbiter.engagement.stop_reason is Reason.SHUTDOWN
    bench.tick()
    told = [(event.kind, event.severity) for event in bench.events if event.reason is Reason.SHUTDOWN]
    assert told == [(EventKind.GATEWAY, Severity.INFO), (EventKind.STOP, Severity.INFO)]
    idle = ArbiterRig()
    idle.changes = {"mode": Mode.AUTO}
    idle.tick()
    idle.arbiter.engagement.shut_down(idle.now_ns)
    assert idle.arbiter.state is ArbiterState.STANDBY, "somebody else may have it in auto"
    idle.ask("acquire")
    assert idle.ask("engage").reason is Reason.SHUTDOWN


def test_what_the_bus_did_not_take_was_no_step() -> None:
    """The next burst is a step from what the chassis was told last."""
    bench = engaged()
    bench.drive_for(60, 1.0)
    before = bench.arbiter.output.actuation
    bench.drive(1.0)
    once = bench.arbiter.output.actuation
    bench.arbiter.output.undo_step()
    assert bench.arbiter.output.actuation == before
    bench.drive(1.0)
    assert bench.arbiter.output.actuation == once
    bench.arbiter.output.undo_step()
    bench.ask("stop")
    assert before is not None
    assert bench.arbiter.output.actuation is not None
    assert bench.arbiter.output.actuation.speed_mps == pytest.approx(before.speed_mps - 0.02)


@pytest.mark.parametrize("stopping", [True, False])
def test_in_place_of_a_refused_burst_zero_speed_and_the_parking_brake_are_told(*, stopping: bool) -> None:
    """A fault of our own: latched, in gear, and from there the stop goes on; also where the bus takes nothing."""
    bench = engaged()
    bench.drive_for(60, 1.0)
    if stopping:
        bench.ask("disengage")
    bench.drive(1.0)
    instead = Actuation(True, GearPosition.DRIVE, 0.0, parking=True)  # noqa: FBT003
    assert bench.arbiter.engagement.refuse_output("why", bench.now_ns) == bench.arbiter.output.actuation == instead
    assert bench.arbiter.latches.details == {Reason.GATE: "why"}
    bench.arbiter.output.undo_step()
    told = bench.tick().actuation
    assert told == instead
    bench.tick(count=3)
    assert bench.arbiter.output.stop_phase is StopPhase.HOLD
    bench.tick(count=200)
    assert bench.arbiter.state is ArbiterState.STANDBY


def test_a_run_is_told_by_its_number() -> None:
    """Ticks and leases of another run fit none of this one; those of the same run are the same."""
    one, same = ArbiterRig(), ArbiterRig()
    assert one.arbiter.tick_number == same.arbiter.tick_number
    assert one.ask("acquire") == same.ask("acquire")


@pytest.mark.parametrize(("asked_mps", "is_stopped"), [(0.11, False), (0.13, True)])
def test_a_speed_is_judged_as_its_frames_say_it(asked_mps: float, *, is_stopped: bool) -> None:
    """Row 'frozen feedback': asked 0.11 m/s, a coarse chassis is told 0.08 m/s, and may read one bit, 0.04 m/s."""
    bench = engaged()
    bench.drive_for(60, asked_mps)
    bench.changes = {"speed_mps": 0.04, "wheel_speed_mps": 0.04, "fastest_wheel_mps": 0.04, "pulses": 1}
    bench.drive_for(60, asked_mps)
    assert (bench.arbiter.engagement.stop_reason is Reason.FEEDBACK_FROZEN) is is_stopped
