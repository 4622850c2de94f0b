"""Row 'slopes': every rule holds on 20 deg up and down, empty and loaded, whatever the brake pedal does."""

from collections.abc import Sequence
from itertools import product
from typing import Any

import msgspec
import pytest

from gateway.chassis.cruiser.frames import load
from gateway.chassis.frame import Frame
from gateway.chassis.layout import Encoder
from gateway.choice import CHASSIS
from gateway.sim.body import Conditions
from gateway.sim.model import VirtualChassis
from schemas.decisions import ArbiterState, EventKind, StopPhase
from schemas.messages import GearPosition, ParkingStatus, Variant
from schemas.reasons import Reason
from schemas.settings import HOLD_NS, CommandSettings
from tests.support.nights import by_night, every_pair
from tests.support.rigs.gateway import MS, GatewayRig, Operator, driving
from tests.support.rigs.scenes import play

SLOPES = (-20.0, 8.0, 20.0)
MORE_SLOPES = (-8.0, 3.0, 15.0)
"""By night."""

PAYLOADS = (0.0, 100.0)
PEDALS = (0.0, 0.3, 1.0)
PARKING_DELAYS_S = (0.05, 0.5)
"""A brake that applies at once hides what holds the robot until it does."""

CAUSES = ("stop", "silence", "disengage", "bumper front on", "silence Auto_DriveFeedBack")

RELEASE_MAX_M = 0.10
STOP_MAX_M = 0.30
"""Row 'slopes': roll-back at release, and from the moment of any stop."""


def on_slopes(*factors: Sequence[Any]) -> list[Any]:
    """Each slope with every combination of these values; by day a selection."""
    return [*every_pair(SLOPES, *factors), *(by_night(*row) for row in product(MORE_SLOPES, *factors))]


class Hill(GatewayRig):
    """A robot on a slope, and how far it has rolled back.

    Attributes:
        operator: has the robot engaged.
        rolled_back_m: how far it is behind the furthest place that it reached, since ``watch``.
        stood_ns, braked_ns: when it first stood since then, and when its brake first read applied.
    """

    def __init__(
        self,
        slope_deg: float,
        payload_kg: float = 0.0,
        pedal_gain: float = 0.0,
        command: CommandSettings | None = None,
        parking_delay_s: float = 0.05,
        variant: Variant = Variant.COARSE,
    ) -> None:
        super().__init__(variant, command)
        conditions = Conditions(slope_deg, payload_kg, pedal_gain, parking_delay_s=parking_delay_s)
        self.chassis = VirtualChassis(CHASSIS, variant, 0, conditions=conditions)
        self._sign = 0.0
        self._furthest_m = self.rolled_back_m = 0.0
        self.stood_ns = self.braked_ns = 0
        self.run(0.6)
        self.operator = Operator(self)
        self.operator.engage()

    def watch(self, sign: float) -> None:
        """From here on going against this direction is rolling back."""
        self._sign = sign
        self._furthest_m = sign * self.chassis.state.x_m
        self.rolled_back_m = 0.0

    def drive_until_parked(self, speed_mps: float) -> None:
        """A stream, until the parking brake is told."""
        self.operator.drive(speed_mps)
        while not self.told["Auto_ParkingCmd"]["ParkingRequest"]:
            self.operator.drive(speed_mps)

    def assert_parked(self) -> None:
        """It stands under its parking brake."""
        assert (self.speed_mps, self.chassis.state.parking_status) == (0, ParkingStatus.APPLIED)

    def tick(self, count: int = 1) -> None:
        for _ in range(count):
            super().tick()
            if self._sign:
                way_m = self._sign * self.chassis.state.x_m
                self._furthest_m = max(self._furthest_m, way_m)
                self.rolled_back_m = max(self.rolled_back_m, self._furthest_m - way_m)
                self.stood_ns = self.stood_ns or self.now_ns * (not self.speed_mps)
                is_braked = self.chassis.state.parking_status is ParkingStatus.APPLIED
                self.braked_ns = self.braked_ns or self.now_ns * is_braked


@pytest.mark.parametrize(
    ("slope_deg", "payload_kg", "pedal_gain", "speed_mps"), on_slopes(PAYLOADS, PEDALS, (0.5, -0.5))
)
def test_a_robot_that_is_let_go_on_a_slope_does_not_roll_back(
    slope_deg: float, payload_kg: float, pedal_gain: float, speed_mps: float
) -> None:
    """The motor holds it in gear, the parking brake after a second; where the motor cannot, the brake at once."""
    hill = Hill(slope_deg, payload_kg, pedal_gain)
    hill.operator.drive(speed_mps, seconds=2.0)
    hill.watch(1.0 if speed_mps > 0 else -1.0)
    hill.operator.drive(0.0, seconds=4.0)
    assert hill.rolled_back_m < RELEASE_MAX_M
    hill.assert_parked()


@pytest.mark.parametrize(
    ("slope_deg", "payload_kg", "cause", "parking_delay_s"), on_slopes(PAYLOADS, CAUSES, PARKING_DELAYS_S)
)
def test_a_stop_on_a_slope_ends_parked(
    slope_deg: float, payload_kg: float, cause: str, parking_delay_s: float
) -> None:
    """Whatever the cause: it does not roll back, and stands under its parking brake in the end.

    The brake is told when it stands, and the gear stays in until a second after the brake reads applied.
    """
    hill = Hill(slope_deg, payload_kg, parking_delay_s=parking_delay_s)
    hill.operator.drive(0.5, seconds=2.5)
    hill.watch(1.0)
    begun_ns, is_driven = hill.now_ns, hill.says.engaged
    match cause:
        case "stop":
            hill.put("anyone", "stop", b"")
        case "silence":
            pass
        case "disengage":
            hill.operator.ask("disengage")
        case _:
            hill.fault(cause)
    hill.run(8.0)
    assert hill.rolled_back_m < STOP_MAX_M
    hill.assert_parked()
    assert hill.says.state is ArbiterState.STANDBY
    if not is_driven:
        return  # Loaded, it does not climb so steep a slope, and was stopped as it set off.
    told = [(at_ns, burst) for at_ns, burst in hill.bursts if at_ns > begun_ns]
    parked_ns = next(at_ns for at_ns, burst in told if burst["Auto_ParkingCmd"]["ParkingRequest"])
    disabled_ns = next(at_ns for at_ns, burst in told if not burst["Auto_GearCmd"]["Enable"])
    assert parked_ns - hill.stood_ns <= 100 * MS
    assert disabled_ns - hill.braked_ns >= HOLD_NS
    assert {burst["Auto_GearCmd"]["TargetGear"] for at_ns, burst in told if at_ns < disabled_ns} == {"drive"}


FAST = CommandSettings(speed_limit_mps=2.222, travel_delay_m=3.0)


@pytest.mark.parametrize("variant", [Variant.COARSE, Variant.FINE])
@pytest.mark.parametrize(("speed_mps", "at_most_m"), [(2.0, 1.8), (1.0, 1.0), (-2.0, 1.8), (-1.0, 1.0)])
@pytest.mark.parametrize("phase", range(5))
def test_a_motor_that_dies_downhill_is_replaced_by_the_parking_brake(
    speed_mps: float, at_most_m: float, phase: int, variant: Variant
) -> None:
    """Row 'a motor that died downhill': overspeed or implausible speed, and the brake in that tick."""
    hill = Hill(-20.0 if speed_mps > 0 else 20.0, command=FAST, variant=variant)
    hill.operator.drive(speed_mps, seconds=4.0)
    hill.tick(phase)
    before_m, told = hill.chassis.state.x_m, len(hill.bursts)
    hill.fault("motor 0")
    hill.operator.drive(speed_mps, seconds=3.0)
    assert abs(hill.chassis.state.x_m - before_m) < at_most_m
    assert hill.says.latched[0] in {Reason.OVERSPEED, Reason.IMPLAUSIBLE_SPEED}
    [latched] = [
        event for event in hill.events if event.reason is hill.says.latched[0] and event.kind is EventKind.STOP
    ]
    first = next(
        burst for at_ns, burst in hill.bursts[told:] if hill.wall_ns - hill.now_ns + at_ns >= latched.time_ns
    )
    assert first["Auto_ParkingCmd"]["ParkingRequest"]


@pytest.mark.parametrize("cause", ["let go", "lower limit", "late tick", "old commands", "nothing"])
def test_a_motor_that_holds_is_not_taken_for_one_that_died(cause: str) -> None:
    """Row 'a motor that died downhill: never by letting go, a lowered limit, a late tick, a jump of the age'."""
    hill = Hill(-20.0, command=FAST)
    hill.operator.drive(2.0, seconds=4.0)
    match cause:
        case "let go":
            hill.operator.drive(0.0, seconds=3.0)
        case "lower limit":
            hill.links = msgspec.structs.replace(hill.links, realtime=False)
        case "late tick":
            hill.late_ns = 90_000_000
            hill.tick()
            hill.late_ns = 0
        case "old commands":
            for _ in range(50):
                hill.put("first", "drive", hill.operator.drive_payload(2.0, challenge=hill.published[-40]))
                hill.tick(2)
    hill.operator.drive(0.0 if cause == "let go" else 2.0, seconds=3.0)
    assert (hill.says.engaged, hill.says.latched) == (True, [])


STEEP = (-20.0, 20.0)
BY_MOTOR = "rests, phase motor, way"
SLIPS: dict[str, str] = {
    # Auto-hold hands it over, and takes it back; the latch is an error, and no reset lets it go.
    **{
        f"held at {slope_deg} deg with grip {grip}": f"hill {slope_deg}; drive 0.5 0 2; brake {grip}; "
        f"drive 0 0 1; mark; drive 0 0 5; = {BY_MOTOR} 0.3, first brake_slips, error latch brake_slips; "
        "reply reset stopping; wait 30; = way 0.3"
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
        f"{asked} {after_ms} ms later": "hill -20; drive 0.5 0 2; brake 0.2; parks 0; mark; "
        f"drive 0 0 {after_ms / 1e3}; {asked}; wait 6; = {BY_MOTOR} 0.3"
        for asked, after_ms in product(("ask stop", "ask disengage", "drive -0.5 0 2"), (60, 100, 140, 180))
    },
    # The brake is applied to change the gear, before the robot has stood for a second.
    **{
        f"a reversal at {slope_deg} deg, delay {delay_s} s": f"hill {slope_deg} {delay_s}; drive 0.5 0 2; "
        f"brake 0.2; drive 0 0 0.7; mark; drive -0.5 0 2; wait 4; = {BY_MOTOR} 0.3"
        for slope_deg, delay_s in product(STEEP, (0.05, 0.15))
    },
    # The motor held it until the gear went. A brake that is slow to open has to open first: it becomes faster.
    **{
        f"in neutral at {slope_deg} deg, grip {grip}, delay {delay_s} s": f"hill {slope_deg} {delay_s}; "
        f"drive 0.5 0 2; neutral -0.5; brake {grip}; mark; drive -0.5 0 2; wait 4; = {BY_MOTOR} {most_m}"
        for slope_deg, (grip, delay_s, most_m) in product(
            STEEP, ((0.0, 0.05, STOP_MAX_M), (0.0, 0.15, 0.5), (0.2, 0.15, 0.3))
        )
    },
    # The motor has it since, so a brake that is asked for at speed is not let go of again.
    "driven on downhill by a weak motor": "hill -14; drive 0.5 0 2; brake 0.1; parks 0; drive 0 0 0.08; "
    "motor 0.3; drive 0.5 0 2.5; = has implausible_speed, unhas brake_slips",
}


@pytest.mark.parametrize("scene", SLIPS.values(), ids=SLIPS)
def test_a_brake_that_slips_gives_the_robot_back_to_its_motor(scene: str) -> None:
    """Row 'a parking brake that reads applied and does not hold', in a stop and in a change of direction too."""
    play(scene)


COASTS: dict[str, str] = {
    **{
        f"in mode stop at {slope_deg} deg": f"hill {slope_deg}; drive 1 0 2.5; reboot for 200ms; wait 6; = rests, "
        "parked, mode stop"
        for slope_deg in (-20.0, -8.0, 0.0)
    },
    "after a takeover, having forgotten what it was told": "hill -8; drive 0.5 0 2; transmitter remote; "
    "sticks 0.5 0; wait 1; forget; transmitter command; wait 5; = rests, parked",
    # Nothing ever resumes by itself, also where another node switches lamps: they command no motion.
    **{
        f"given back, {meanwhile}": "driving 2; transmitter remote; drive 2 0 0.2; wait 3; "
        f"{meanwhile}; wait 0.5; mark; transmitter command; wait 5; = way 0.05, parked"
        for meanwhile in ("wait 0", "foreign 18C4D7D0 every 50ms")
    },
}


@pytest.mark.parametrize("scene", COASTS.values(), ids=COASTS)
def test_a_robot_that_coasts_gets_its_parking_brake(scene: str) -> None:
    """Rows 'a stop that cannot be carried out' and 'in mode stop and seen to move': it is told to park."""
    play(scene)


@pytest.mark.parametrize("slope_deg", [-20.0, 20.0])
@pytest.mark.parametrize("grip", [0.0, 0.2])
@pytest.mark.parametrize("after_ms", [20, 100, 180])
def test_who_drives_on_uphill_while_the_brake_slips_does_not_roll_away(
    slope_deg: float, grip: float, after_ms: int
) -> None:
    """The same: the stick releases the brake, and the robot that rolls back is not given to it again."""
    uphill = 1.0 if slope_deg > 0 else -1.0
    hill = Hill(slope_deg)
    hill.operator.drive(uphill * 0.5, seconds=2.0)
    hill.fault(f"brake {grip}")
    hill.drive_until_parked(0.0)
    hill.watch(uphill)
    hill.operator.drive(0.0, seconds=after_ms / 1e3)
    hill.operator.drive(uphill * 0.5, seconds=2.0)
    hill.run(6)
    assert hill.rolled_back_m < STOP_MAX_M
    assert (hill.speed_mps, hill.says.stop_phase) == (0, StopPhase.MOTOR)


def test_a_robot_that_is_pushed_before_its_brake_reads_applied_gets_its_brake() -> None:
    """The same: nothing shows that this brake does not hold. It is asked for, and keeps the robot."""
    hill = Hill(0.0, parking_delay_s=0.15)
    hill.operator.drive(0.5, seconds=2.0)
    hill.drive_until_parked(-0.5)
    for _ in range(8):
        hill.chassis.adopt(speed_mps=0.3, angle_deg=0.0, gear=GearPosition.DRIVE, parked=False)
        hill.operator.drive(-0.5, seconds=0.02)
    hill.operator.drive(-0.5, seconds=1.0)
    assert (hill.speed_mps, hill.says.latched) == (0, [Reason.ROLLING])
    assert hill.chassis.state.parking_status is ParkingStatus.APPLIED


def test_a_robot_that_creeps_when_its_enables_are_gone_is_kept_in_gear() -> None:
    """Row 'a parking brake that does not hold': after the second return; by a reset it may try once more."""
    hill = Hill(-20.0)
    hill.operator.drive(0.5, seconds=2.0)
    hill.operator.ask("stop")
    begun_m = hill.chassis.state.x_m
    for _ in range(12_000):
        # Of this brake the enables hold it: disabled, it slips.
        is_enabled = not hill.told or hill.told["Auto_ParkingCmd"]["Enable"]
        hill.fault("brake 1" if is_enabled and hill.told else "brake 0.45")
        hill.tick()
    assert abs(hill.chassis.state.x_m - begun_m) < 0.5
    assert Reason.BRAKE_SLIPS in hill.says.latched
    assert (hill.says.state, hill.says.stop_phase) == (ArbiterState.STOPPING, StopPhase.HOLD)
    hill.chassis.adopt(speed_mps=0.2, angle_deg=0.0, gear=GearPosition.DRIVE, parked=True)
    hill.run(0.5)
    hill.fault("brake 1")
    hill.operator.take_lease()
    assert hill.operator.reason("reset") is Reason.STOPPING, "it has not stood braked for 5 s"
    for _ in range(10):
        hill.operator.ask("renew")
        hill.run(0.6)
    assert hill.operator.reason("reset") is Reason.NONE
    hill.run(2)
    assert (hill.says.state, hill.says.latched) == (ArbiterState.STANDBY, [])


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
    hill = Hill(-8.0)
    hill.operator.drive(0.5, seconds=2.0)
    hill.drive_until_parked(0.0)
    if brake == "of a robot that stands by":
        hill.operator.ask("disengage")
        hill.run(4.0)
        assert hill.says.state is ArbiterState.STANDBY
    crept_m = 0.0
    while not hill.says.latched and crept_m < 0.1:
        body = hill.chassis._motion
        body._left_m += creep_mps * 0.01
        body._right_m += creep_mps * 0.01
        crept_m += creep_mps * 0.01
        if hill.says.state is ArbiterState.ENGAGED:
            hill.operator.drive(0.0, seconds=0.01)
        else:
            hill.tick()
    assert latched in hill.says.latched
    assert hill.says.state is ArbiterState.STOPPING


def test_a_robot_that_was_told_to_creep_does_not_creep_when_it_stops() -> None:
    """Nor one that comes to rest: its last pulses are of the way that was commanded."""
    for speed_mps in (0.005, 0.02, 0.04):
        hill = Hill(0.0)
        hill.operator.drive(speed_mps, seconds=8.0)
        hill.operator.drive(0.0, seconds=6.0)
        hill.operator.drive(-speed_mps, seconds=6.0)
        assert (hill.says.state, hill.says.latched) == (ArbiterState.ENGAGED, [])


@pytest.mark.parametrize("slope_deg", [8.0, 20.0])
def test_a_hill_start_does_not_roll_back(slope_deg: float) -> None:
    """Row 'standing': the brake is released in gear, and the ramp waits for the feedback that says so."""
    hill = Hill(slope_deg)
    hill.watch(1.0)
    hill.operator.drive(0.5, seconds=2.0)
    hill.operator.drive(0.0, seconds=2.0)
    assert hill.chassis.state.parking_status is ParkingStatus.APPLIED
    hill.operator.drive(0.5, seconds=2.0)
    assert hill.speed_mps > 0.4
    assert hill.rolled_back_m < 0.01


@pytest.mark.parametrize("slope_deg", [-20.0, 20.0])
def test_a_reversal_on_a_slope_does_not_roll(slope_deg: float) -> None:
    """Row 'reversal of direction': the gear is changed behind the parking brake."""
    hill = Hill(slope_deg)
    hill.operator.drive(0.5, seconds=2.0)
    hill.watch(1.0)
    for _ in range(40):
        hill.operator.drive(-0.5)
        if hill.chassis.state.parking_status is ParkingStatus.APPLIED:
            break
    assert hill.rolled_back_m < 0.01
    hill.operator.drive(-0.5, seconds=2.5)
    assert hill.speed_mps < -0.4


@pytest.mark.parametrize("slope_deg", [8.0, 15.0, 20.0])
def test_a_motor_that_dies_is_noticed_by_the_wheels(slope_deg: float) -> None:
    """Row 'rolling': against the commanded direction for 100 ms, then the parking brake, latched, an event."""
    hill = Hill(slope_deg)
    hill.operator.drive(0.5, seconds=2.0)
    hill.watch(1.0)
    hill.fault("motor 0")
    hill.operator.drive(0.5, seconds=3.0)
    assert hill.rolled_back_m < STOP_MAX_M
    assert hill.speed_mps == 0
    assert Reason.ROLLING in hill.says.latched
    assert Reason.ROLLING in hill.event_reasons(EventKind.STOP)


@pytest.mark.parametrize("acceleration_mps2", [0.1, 0.3])
def test_a_robot_that_rolls_off_before_a_speed_is_told_is_braked(acceleration_mps2: float) -> None:
    """Row 'rolling': at zero command for 100 ms, be the ramp that begins as slow as it may: a bit is 0.04 m/s."""
    hill = Hill(-20.0, command=CommandSettings(acceleration_mps2=acceleration_mps2, speed_limit_mps=2.222))
    hill.operator.drive(0.0, seconds=0.2)
    hill.fault("motor 0")
    before_m = hill.chassis.state.x_m
    hill.operator.drive(0.5, seconds=3.0)
    assert hill.speed_mps == 0
    assert abs(hill.chassis.state.x_m - before_m) < STOP_MAX_M
    assert Reason.ROLLING in hill.says.latched


def test_a_slope_that_changes_is_borne() -> None:
    """Up, over the top and down again, and a stop at the steepest place."""
    hill = Hill(15.0, 0.0)
    for slope_deg in (20.0, 5.0, 0.0, -10.0, -20.0):
        hill.fault(f"slope {slope_deg:g}")
        hill.operator.drive(0.5, seconds=1.5)
        assert abs(hill.speed_mps - 0.5) < 0.1
    hill.put("anyone", "stop", b"")
    hill.run(5.0)
    assert hill.speed_mps == 0
    assert hill.says.latched == [Reason.REMOTE_STOP]


def test_a_stop_that_was_barred_is_carried_out_when_the_remote_control_gives_the_robot_back() -> None:
    """Row 'stop, the remote stop': with parking brake; latched meanwhile, and told as soon as it can be."""
    rig = GatewayRig()
    rig.run(0.6)
    rig.fault("transmitter remote")
    rig.fault("sticks 0.5 0")
    rig.run(1.5)
    handle = rig.query("anyone", "stop", b"")
    rig.run(0.5)
    reply = rig.replies[handle]
    assert (reply.ok, reply.reason) == (False, Reason.HAND_TRANSMITTER)
    assert "the robot moves at 0.48 m/s" in reply.detail
    assert rig.bursts == []
    rig.fault("sticks 0 0")
    rig.run(2)
    before = rig.chassis.state.parking_status
    rig.fault("transmitter command")
    rig.run(3)
    assert (before, rig.chassis.state.parking_status) == (ParkingStatus.RELEASED, ParkingStatus.APPLIED)
    assert rig.says.state is ArbiterState.STANDBY


@pytest.mark.parametrize("late_ms", [0, 30, 60])
def test_a_late_loop_slows_the_robot_down_as_fast(late_ms: int) -> None:
    """Row 'normal deceleration 1.2 m/s2': by the time that has passed, not by the number of ticks."""
    rig, operator = driving(2.0)
    rig.late_ns = late_ms * 1_000_000
    at_m = rig.chassis.state.x_m
    for _ in range(150):
        operator.drive(0.0)
    assert rig.speed_mps == 0
    assert rig.chassis.state.x_m - at_m < 2.0**2 / (2 * 1.2) + 2.0 * 0.4


def test_a_frozen_body_frame_is_not_hidden_by_engaging_anew() -> None:
    """Row 'a body frame frozen with a running counter': the way since the mileage changed goes on counting."""
    rig, operator = driving(0.5)
    rig.fault("freeze Auto_MileageAndBodyFeedback")
    way_m = rig.chassis.state.mileage_m
    while Reason.FEEDBACK_FROZEN not in rig.says.latched and rig.chassis.state.mileage_m < way_m + 6:
        operator.drive(0.5, seconds=2.0)
        operator.reason("disengage")
        rig.run(4)
        operator.take_lease("take")
        operator.ask("engage")
        rig.run(0.3)
        operator.drive(0.0)
        operator.reason("unpark")
    assert rig.chassis.state.mileage_m < way_m + 4.5


def test_a_stop_that_begins_where_another_ended_is_not_refused() -> None:
    """Row 'a stop': the steering is off by a degree (manual V2.0, 2.2) when the mode leaves auto."""
    rig, operator = driving(0.5)
    operator.drive(0.0, seconds=1.0)
    steering = load(Variant.COARSE).messages["Auto_SteeringFeedBack"]
    encoder = Encoder(load(Variant.COARSE))

    def askew(frame: Frame) -> Frame:
        if frame.can_id != steering.can_id:
            return frame
        return encoder.encode(steering.name, {"Active": True, "Angle": 1.5}, frame.data[6] >> 4)

    rig.corrupt = askew
    rig.run(0.1)
    rig.chassis._commands.clear()
    rig.run(3)
    assert Reason.GATE not in rig.says.latched
    assert rig.chassis.state.parking_status is ParkingStatus.APPLIED
