"""The rig's witness holds in each tick, whatever operators, chassis, bus and loop do."""

import msgspec
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from gateway.telemetry.health import Links
from schemas.decisions import ArbiterState
from schemas.messages import Mode, Variant
from schemas.reasons import Reason
from tests.support.rigs.gateway import GatewayRig, Operator, ready
from tests.support.strategies import VARIANTS

FEEDBACK = (
    "Auto_GearFeedBack",
    "Auto_SteeringFeedBack",
    "Auto_DriveFeedBack",
    "Auto_WheelSpdFeedback",
    "Auto_MileageAndBodyFeedback",
)
VERBS = ("renew", "release", "disengage", "reset", "park", "unpark", "clear_odometer")

speeds = st.one_of(st.sampled_from([0.0, 0.5, -0.5, 2.222, -9.0]), st.floats(-3, 3))
angles = st.one_of(st.sampled_from([0.0, 24.0, -24.0, 90.0]), st.floats(-30, 30))
operators = st.integers(0, 1)


class Machine(RuleBasedStateMachine):
    """Two operators, a chassis of either firmware with faults, a bus that is full, and a loop that is late."""

    rig: GatewayRig
    people: list[Operator]

    @initialize(variant=st.sampled_from(VARIANTS), speed_mps=speeds)
    def begin_by_driving(self, variant: Variant, speed_mps: float) -> None:
        self.rig, first = ready(variant)
        self.people = [first, Operator(self.rig, "second")]
        self.driver: Operator | None = None
        self.engage_as_one_should(0, speed_mps)

    @rule(who=operators, verb=st.sampled_from(["acquire", "take"]), override=st.booleans())
    def want_the_lease(self, who: int, verb: str, override: bool) -> None:  # noqa: FBT001 - drawn
        self.people[who].take_lease(verb, **({"override": override} if verb == "take" else {}))

    @rule(who=operators, verb=st.sampled_from(VERBS))
    def ask(self, who: int, verb: str) -> None:
        self.people[who].reason(verb) if verb != "clear_odometer" else self.people[who].ask(verb)

    @rule(who=operators, limit_mps=st.one_of(st.none(), st.floats(0.05, 3)))
    def engage(self, who: int, limit_mps: float | None) -> None:
        self.people[who].ask("engage", speed_limit_mps=limit_mps)
        self.rig.tick(4)

    @rule(who=operators, speed_mps=speeds)
    def engage_as_one_should(self, who: int, speed_mps: float) -> None:
        """And drive, so that the next event comes in motion."""
        operator = self.people[who]
        if self.rig.says.state is ArbiterState.STOPPING:
            self.rig.run(3)
        if self.rig.says.lease_holder != operator.name or operator.reason("renew") is not Reason.NONE:
            operator.take_lease("take", override=True, role="supervisor")
            self.rig.run(3 if self.rig.says.state is ArbiterState.STOPPING else 0)
        operator.reason("renew")
        operator.reason("reset")
        operator.ask("engage")
        self.rig.tick(6)
        operator.reason("unpark")
        self.driver = operator
        operator.drive(speed_mps, 5.0, 0.6)

    def _go_on(self, ticks: int, *, driving: bool) -> None:
        """Time passes; the driver goes on or falls silent."""
        if driving and self.driver is not None:
            self.driver.drive(1.5, -10.0, ticks / 100)
        else:
            self.rig.tick(ticks)

    @rule(who=operators, speed_mps=speeds, angle_deg=angles, seconds=st.floats(0.02, 1.2))
    def drive(self, who: int, speed_mps: float, angle_deg: float, seconds: float) -> None:
        """Mostly by the driver."""
        operator = self.driver if who == 0 and self.driver is not None else self.people[who]
        operator.drive(speed_mps, angle_deg, seconds)

    @rule(who=operators, speed_mps=speeds, behind=st.integers(0, 600))
    def drive_by_an_old_echo(self, who: int, speed_mps: float, behind: int) -> None:
        operator = self.people[who]
        published = self.rig.published
        payload = operator.drive_payload(speed_mps, challenge=published[-1 - behind % len(published)])
        self.rig.put(operator.name, "drive", payload)
        self.rig.tick()

    @rule(who=operators, on=st.booleans())
    def sound_and_shine(self, who: int, on: bool) -> None:  # noqa: FBT001 - drawn
        self.people[who].reason("horn", on=on)
        self.people[who].reason("light", left=on)

    @rule(verb=st.sampled_from(["drive", "engage", "acquire", "nonsense"]), payload=st.binary(max_size=40))
    def send_rubbish(self, verb: str, payload: bytes) -> None:
        self.rig.put("first", verb, payload)
        self.rig.query("second", verb, payload)
        self.rig.tick()

    @rule(payload=st.binary(max_size=10), operator=st.sampled_from(["", "first", "carl"]))
    def stop(self, payload: bytes, operator: str) -> None:
        for who in self.people:
            self.rig.put(who.name, "drive", who.drive_payload(2.0))
        self.rig.put(operator, "stop", payload)
        self.rig.tick()
        assert Reason.REMOTE_STOP in self.rig.says.latched
        assert self.rig.says.state in {ArbiterState.STOPPING, ArbiterState.STANDBY}

    @rule(ticks=st.integers(1, 250))
    def wait(self, ticks: int) -> None:
        self.rig.tick(ticks)

    @rule(
        kind=st.sampled_from(["silence", "checksum", "stuck", "skip", "drop"]),
        name=st.sampled_from(FEEDBACK),
        tenths=st.integers(1, 8),
        driving=st.booleans(),
    )
    def feedback_fails(self, kind: str, name: str, tenths: int, driving: bool) -> None:  # noqa: FBT001 - drawn
        words = f"{name} every 3" if kind == "drop" else name
        self.rig.fault(f"{kind} {words} for {tenths * 100}ms")
        self._go_on(tenths * 5, driving=driving)

    @rule(
        text=st.sampled_from(
            [
                "bumper front on",
                "bumper rear on",
                "bumper both off",
                "bumper both on for 30ms",
                "transmitter remote for 200ms",
                "transmitter remote",
                "sticks 0.4 3",
                "transmitter command",
                "foreign 18C4D3D0 every 10ms for 300ms",
                "scale wrong for 1s",
                "clear",
            ]
        ),
        ticks=st.integers(1, 60),
        driving=st.booleans(),
    )
    def chassis_fault(self, text: str, ticks: int, driving: bool) -> None:  # noqa: FBT001 - drawn
        self.rig.fault(text)
        self._go_on(ticks, driving=driving)

    @rule(takes=st.integers(0, 7), ticks=st.integers(1, 30), driving=st.booleans())
    def the_bus_is_full(self, takes: int, ticks: int, driving: bool) -> None:  # noqa: FBT001 - drawn
        self.rig.takes = takes
        self._go_on(ticks, driving=driving)
        self.rig.takes = None
        self._go_on(2, driving=driving)

    @rule(ticks=st.integers(1, 120), driving=st.booleans())
    def the_chassis_is_deaf(self, ticks: int, driving: bool) -> None:  # noqa: FBT001 - drawn
        self.rig.chassis_hears = False
        self._go_on(ticks, driving=driving)
        self.rig.chassis_hears = True

    @rule(ticks=st.integers(0, 30), driving=st.booleans())
    def the_bus_is_lost(self, ticks: int, driving: bool) -> None:  # noqa: FBT001 - drawn
        losses = self.rig.links.bus_losses + 1
        self.rig.links = msgspec.structs.replace(self.rig.links, bus_up=False, bus_losses=losses)
        self.rig.tick(ticks)
        self.rig.links = Links(bus_up=True, guarded=True, bus_losses=losses, realtime=True)
        self._go_on(30, driving=driving)

    @rule(sends=st.booleans(), ticks=st.integers(1, 20))
    def the_guard_acts_or_is_gone(self, sends: bool, ticks: int) -> None:  # noqa: FBT001 - drawn
        self.rig.links = msgspec.structs.replace(self.rig.links, guarded=sends, guard_sends=sends)
        self.rig.tick(ticks)
        self.rig.links = msgspec.structs.replace(self.rig.links, guarded=True, guard_sends=False)

    @rule(late_ms=st.integers(1, 300))
    def the_loop_is_late(self, late_ms: int) -> None:
        self.rig.late_ns = late_ms * 1_000_000
        self.rig.tick()
        self.rig.late_ns = 0

    @rule(hours=st.integers(-3, 3))
    def the_wall_clock_steps(self, hours: int) -> None:
        self.rig.wall_ns += hours * 3600 * 10**9

    @invariant()
    def the_robot_is_no_faster_than_it_was_told(self) -> None:
        """Apart from the lag of its drive, and the remote control."""
        if self.rig.chassis.state.mode is Mode.REMOTE or any("scale" in text for text in self.rig.faults[-40:]):
            return
        scale = 0.04 if self.rig.chassis.state.variant is Variant.COARSE else 0.001
        told_mps = scale * max([*self.rig.heard[-250:], 0])
        assert abs(self.rig.speed_mps) <= max(told_mps, 0.4 if "sticks 0.4 3" in self.rig.faults else 0.0) + 0.01


TestGateway = Machine.TestCase
TestGateway.settings = settings(stateful_step_count=25, suppress_health_check=[HealthCheck.too_slow])
