"""The whole gateway with a simulated chassis in simulated time: requests in, the chassis's motion out.

The rig is a witness too: each tick it decodes the frames that went out, and asserts what must always hold.
"""

from collections.abc import Callable
from copy import deepcopy
from functools import cache
from hashlib import blake2b
from math import radians, tan
from typing import TypeVar

import msgspec

from gateway.chassis.cruiser.frames import BRAKE_FIRST_FRAMES, MOTION_FRAMES, load
from gateway.chassis.frame import Frame
from gateway.chassis.layout import Decoded, FrameDecoder, Value
from gateway.choice.chassis import CHASSIS
from gateway.command.rulings import RawRequest
from gateway.core import Core
from gateway.sim.model import VirtualChassis
from gateway.telemetry.health import Links
from schemas import codec, decisions
from schemas.codec import Sample
from schemas.cruiser import SPEED_TOP_MPS
from schemas.decisions import ArbiterState, Decision, Journal, SafetyEvent, SafetyState
from schemas.messages import Mode, ParkingStatus, Variant
from schemas.reasons import Reason
from schemas.requests import CHALLENGE_BYTES
from schemas.settings import (
    MUTE_FAILURES,
    YIELD_BURSTS,
    ChassisSettings,
    CommandSettings,
    GatewaySettings,
    Settings,
)
from schemas.subjects import BY_NAME, BY_VERB
from tests.support.rigs.chassis import fault_line

MS = 1_000_000
TICK = 10 * MS
WALL_NS = 1_700_000_000_000_000_000
GUARDED = Links(bus_up=True, guarded=True, realtime=True)

Signals = dict[str, Value]
DRIVE_CAN_ID = load(Variant.COARSE).messages["Auto_DriveCmd"].can_id


def challenge_of(run: int, now_ns: int) -> bytes:
    return blake2b(b"%d %d" % (run, now_ns), digest_size=CHALLENGE_BYTES).digest()


class GatewayRig:
    """A gateway's core, a chassis, and time.

    Attributes:
        takes: how many frames of a tick the bus takes; None for all.
        corrupt: changes a feedback frame on its way; None loses it.
        samples: all that was published in the last tick.
        published: the challenges, newest last.
        bursts: all motion frames sent: time, and decoded signals by frame.
        heard: raw speeds of all drive frames that reached the chassis.
        recorded: all that was published, with the time of a recorder's clock, which is never set.
        offered: the frames of each tick, before the bus took them.
        recorder_ns: the recorder's time when the rig's is 0.
        lived: of each tick time, place, speed, and whether the parking brake is applied.
        gate_refuses: a test makes the gate refuse, so that is no fault.
    """

    def __init__(
        self,
        variant: Variant = Variant.COARSE,
        command: CommandSettings | None = None,
        *,
        configured: str = "auto",
        accept_unguarded: bool = False,
        run: int = 7,
        now_ns: int = 0,
    ) -> None:
        self.settings = Settings(
            command=command or CommandSettings(speed_limit_mps=SPEED_TOP_MPS),
            chassis=ChassisSettings(variant=configured),  # type: ignore[arg-type]
            gateway=GatewaySettings(accept_unguarded=accept_unguarded),
        )
        self.now_ns = now_ns
        self.core = Core(CHASSIS, self.settings, "1.2.3", now_ns, run)
        self.chassis = VirtualChassis(CHASSIS, variant, now_ns)
        self.links = GUARDED
        self.takes: int | None = None
        self.corrupt: Callable[[Frame], Frame | None] = lambda frame: frame
        self.wall_ns = WALL_NS
        self.late_ns = 0
        self.chassis_hears = True
        self.samples: list[Sample] = []
        self.state: SafetyState | None = None
        self.published: list[bytes] = []
        self.events: list[SafetyEvent] = []
        self.decided: list[Decision] = []
        self.replies: dict[int, decisions.Reply] = {}
        self.bursts: list[tuple[int, dict[str, Signals]]] = []
        self.out: list[Frame] = []
        self.heard: list[int] = []
        self.faults: list[str] = []
        self.recorded: list[tuple[int, Sample]] = []
        self.offered: list[list[Frame]] = []
        self.recorder_ns = WALL_NS - now_ns
        self.lived: list[tuple[int, float, float, bool]] = []
        self.gate_refuses = False
        self._decoder = FrameDecoder(load(variant))
        self._run = run
        self._requests: list[RawRequest] = []
        self._handles = 0
        self._counters: dict[int, int] = {}
        self._partings = 0
        self._is_torn = False
        self._latched: set[Reason] = set()

    @property
    def says(self) -> SafetyState:
        assert self.state is not None
        return self.state

    @property
    def at_ns(self) -> int:
        return self.recorder_ns + self.now_ns

    @property
    def speed_mps(self) -> float:
        return self.chassis.state.speed_mps

    @property
    def told(self) -> dict[str, Signals]:
        """The burst of the last tick; empty if there was none."""
        return self.bursts[-1][1] if self.bursts and self.bursts[-1][0] == self.now_ns else {}

    @property
    def told_mps(self) -> float:
        """The speed commanded in the last tick, a magnitude."""
        return float(self.told["Auto_DriveCmd"]["TargetVelocity"]) if self.told else 0.0

    @property
    def journals(self) -> list[Journal]:
        payloads = [sample.payload for _, sample in self.recorded if sample.subject == "journal"]
        return [msgspec.msgpack.decode(payload, type=Journal) for payload in payloads]

    def fault(self, text: str) -> None:
        self.faults.append(text)
        self.chassis.inject(fault_line(text), self.now_ns)

    def put(self, operator: str, verb: str, payload: bytes) -> None:
        self._requests.append(RawRequest(0, verb, operator, payload, len(payload)))

    def query(self, operator: str, verb: str, payload: bytes) -> int:
        """A query. Returns the number of its reply."""
        self._handles += 1
        self._requests.append(RawRequest(self._handles, verb, operator, payload, len(payload)))
        return self._handles

    def tick(self, count: int = 1) -> None:
        for _ in range(count):
            self.now_ns += TICK + self.late_ns
            self.wall_ns += TICK + self.late_ns
            self._tick(self.late_ns)

    def run(self, seconds: float) -> None:
        self.tick(round(seconds * 100))

    def until(self, holds: Callable[[], bool], seconds: float = 5.0) -> None:
        for _ in range(round(seconds * 100)):
            if holds():
                return
            self.tick()
        assert holds(), f"not within {seconds} s: {self.state}"

    def ruled(self) -> Reason:
        return self.decided[-1].reason

    def event_reasons(self, kind: decisions.EventKind) -> list[Reason]:
        return [event.reason for event in self.events if event.kind is kind]

    def _tick(self, late_ns: int) -> None:
        at_ns = self.at_ns
        for frame in self.chassis.advance(self.now_ns, self.wall_ns):
            arrived = self.corrupt(frame)
            if arrived is not None:
                sample = self.core.receive_frame(arrived, self.now_ns)
                if sample is not None:
                    self.recorded.append((at_ns, sample))
        requests, self._requests = self._requests, []
        for request in requests:
            self.core.receive_request(request, self.now_ns)
        self.core.update_links(self.links, self.now_ns)
        due = self.core.tick(self.now_ns, self.wall_ns, late_ns, challenge_of(self._run, self.now_ns))
        taken = due.frames[: self.takes]
        for frame in taken:
            self._send(frame)
        for reply in due.replies:
            kind = BY_VERB[reply.verb].reply if reply.verb in BY_VERB else decisions.Reply
            assert reply.handle not in self.replies, "a query has one reply"
            self.replies[reply.handle] = msgspec.msgpack.decode(reply.payload, type=kind)
        self.offered.append(due.frames)
        self.samples = [*due.samples, *self.core.sent(len(taken), self.now_ns, self.wall_ns)]
        for sample in self.samples:
            self.recorded.append((at_ns, sample))
            if sample.subject.startswith("safety/"):
                self._read(sample)
        self._witness(due.frames, taken)
        body = self.chassis.state
        self.lived.append((self.now_ns, body.x_m, body.speed_mps, body.parking_status is ParkingStatus.APPLIED))

    def _send(self, frame: Frame) -> None:
        self.out.append(frame)
        if self.chassis_hears:
            if frame.can_id == DRIVE_CAN_ID:
                self.heard.append(int.from_bytes(frame.data[1:3], "little"))
            self.chassis.receive(frame, self.now_ns)

    def _read(self, sample: Sample) -> None:
        message = codec.decode(BY_NAME[sample.subject], sample.payload)
        match message:
            case SafetyState():
                self.state = message
                self.published.append(message.challenge)
            case SafetyEvent():
                self.events.append(message)
            case Decision():
                self.decided.append(message)
            case _:
                raise AssertionError(message)

    # What must always be true.

    def _witness(self, offered: list[Frame], taken: list[Frame]) -> None:
        command = self.core.command
        assert command is not None
        arbiter = command.arbiter
        is_refused = Reason.GATE in arbiter.latches.details
        assert self.gate_refuses or not is_refused, f"the gate refused: {arbiter.latches.details}"
        jammed = arbiter.monitor.send_failures >= MUTE_FAILURES and arbiter.state is ArbiterState.STOPPING
        is_mute = arbiter.handover.is_cut_off or jammed
        assert self.gate_refuses or command.is_mute is is_mute, "mute for want of a bus only"
        reset = any(d.request == "reset" and d.reason is Reason.NONE for d in self.decided[-4:])
        assert reset or self._latched <= arbiter.latches.details.keys(), "a latch cleared itself"
        self._latched = set(arbiter.latches.details)
        is_yielding = arbiter.monitor.chassis.mode is Mode.REMOTE
        if arbiter.state is ArbiterState.STANDBY:
            assert not offered or is_yielding, "standing by is silent, but for what a robot is left with"
            self._partings = self._partings + 1 if offered else 0
            assert self._partings <= YIELD_BURSTS
        for frame in taken:
            last = self._counters.get(frame.can_id)
            assert last is None or frame.data[6] >> 4 == (last + 1) % 16
            self._counters[frame.can_id] = frame.data[6] >> 4
        if len(taken) < len(MOTION_FRAMES):
            self._is_torn |= bool(taken)
            return
        signals: dict[str, Signals] = {}
        for frame in taken:
            decoded = self._decoder.decode(frame)
            assert isinstance(decoded, Decoded), decoded
            signals[decoded.layout.name] = decoded.signals
        is_torn, self._is_torn = self._is_torn, False
        assert tuple(signals)[:5] == MOTION_FRAMES or (
            is_torn and tuple(signals)[:5] == BRAKE_FIRST_FRAMES and not signals["Auto_DriveCmd"]["TargetVelocity"]
        )
        self._witness_motion(signals)
        self.bursts.append((self.now_ns, signals))

    def _witness_motion(self, signals: dict[str, Signals]) -> None:
        arbiter = self.core.command.arbiter  # type: ignore[union-attr]
        speed_mps = float(signals["Auto_DriveCmd"]["TargetVelocity"])
        gear = signals["Auto_GearCmd"]["TargetGear"]
        angle_deg = float(signals["Auto_SteeringCmd"]["TargetAngle"])
        enables = {signals[name]["Enable"] for name in MOTION_FRAMES}
        assert len(enables) == 1, "all five enables or none"
        assert gear in {"reverse", "neutral", "drive"}
        parking = bool(signals["Auto_ParkingCmd"]["ParkingRequest"])
        assert parking or gear != "neutral", "neutral only behind the parking request"
        assert enables == {True} or (gear == "neutral" and not speed_mps), "disabled it is told nothing else"
        limits = (
            arbiter.setpoint.limits if arbiter.state in {ArbiterState.ENGAGED, ArbiterState.ENGAGING} else None
        )
        lateral_mps2 = speed_mps**2 * tan(radians(abs(angle_deg))) / 0.660
        assert lateral_mps2 <= self.settings.command.lateral_acceleration_mps2 + 0.02
        assert abs(angle_deg) <= self.settings.command.steering_limit_deg + 0.03
        before = self.bursts[-1] if self.bursts and self.now_ns - self.bursts[-1][0] <= TICK else None
        before_mps = float(before[1]["Auto_DriveCmd"]["TargetVelocity"]) if before is not None else None
        if limits is not None and speed_mps > limits.speed_mps + 1e-6:
            assert before_mps is not None, "a limit that falls is reached by the normal deceleration"
            assert speed_mps <= before_mps
        if speed_mps:
            assert enables == {True}
            assert gear != "neutral"
            assert not parking
            if arbiter.state is ArbiterState.ENGAGED:
                lease = arbiter.leases.held
                assert lease is not None, "motion without a lease"
                assert self.now_ns < lease.expires_ns, "motion without a live lease"
                assert self.now_ns - arbiter.link.fresh_ns <= arbiter.link.age.deadman_ns, "a stale command"
            else:
                assert arbiter.state is ArbiterState.STOPPING, "only a stop goes on with a speed"
                assert before_mps is None or speed_mps <= before_mps + 1e-9, "a stop never speeds up"
        if before is not None and before_mps is not None:
            self._witness_step(signals, before[1], speed_mps - before_mps)

    def _witness_step(self, signals: dict[str, Signals], before: dict[str, Signals], rise_mps: float) -> None:
        bit_mps = 0.0401 if self.chassis.state.variant is Variant.COARSE else 0.00101
        command = self.settings.command
        assert rise_mps <= command.acceleration_mps2 * 0.01 + bit_mps
        step_deg = float(signals["Auto_SteeringCmd"]["TargetAngle"]) - float(
            before["Auto_SteeringCmd"]["TargetAngle"]
        )
        assert abs(step_deg) <= command.steering_rate_degps * 0.01 + 0.06
        was_parking, parking = (bool(one["Auto_ParkingCmd"]["ParkingRequest"]) for one in (before, signals))
        if signals["Auto_GearCmd"]["TargetGear"] != before["Auto_GearCmd"]["TargetGear"]:
            assert "neutral" in {signals["Auto_GearCmd"]["TargetGear"], before["Auto_GearCmd"]["TargetGear"]}
            assert was_parking, "a gear is changed behind the parking request only"
            assert parking
        if was_parking and not parking:
            arbiter = self.core.command.arbiter  # type: ignore[union-attr]
            assert arbiter.state is ArbiterState.ENGAGED or Reason.BRAKE_SLIPS in arbiter.latches.details
            assert not signals["Auto_DriveCmd"]["TargetVelocity"]


class Operator:
    def __init__(self, rig: GatewayRig, name: str = "first") -> None:
        self.rig = rig
        self.name = name
        self.lease = 0
        self.sequence = 0

    def ask(self, verb: str, **fields: object) -> int:
        if verb not in {"acquire", "take", "stop"}:
            fields = {"lease": self.lease, **fields}
        if verb == "engage":
            fields = {"challenge": self.rig.says.challenge, **fields}
        return self.rig.query(self.name, verb, msgspec.msgpack.encode(fields))

    def reason(self, verb: str, **fields: object) -> Reason:
        handle = self.ask(verb, **fields)
        self.rig.tick()
        return self.rig.replies[handle].reason

    def reset(self) -> Reason:
        """Reset all latches, whoever stopped the robot."""
        return self.reason("reset", of=next((name for name in self.rig.says.stopped_by if name != self.name), ""))

    def take_lease(self, verb: str = "acquire", **fields: object) -> Reason:
        """Acquire or take, and store the lease's number."""
        handle = self.ask(verb, **fields)
        self.rig.tick()
        reply = self.rig.replies[handle]
        assert isinstance(reply, decisions.LeaseReply)
        if reply.ok:
            self.lease, self.sequence = reply.lease, 0
        return reply.reason

    def drive_payload(self, speed_mps: float, angle_deg: float = 0.0, **fields: object) -> bytes:
        self.sequence += 1
        made: dict[str, object] = {
            "lease": self.lease,
            "seq": self.sequence,
            "challenge": self.rig.says.challenge,
            "speed_mps": speed_mps,
            "angle_deg": angle_deg,
        }
        return msgspec.msgpack.encode(made | fields)

    def drive(self, speed_mps: float, angle_deg: float = 0.0, seconds: float = 0.0) -> None:
        """Drive at 50 Hz for a time; without one, a single command."""
        for _ in range(max(1, round(seconds * 50))):
            self.rig.put(self.name, "drive", self.drive_payload(speed_mps, angle_deg))
            self.rig.tick(2)

    def engage(self, **fields: object) -> None:
        if not self.lease:
            assert self.take_lease() is Reason.NONE
        handle = self.ask("engage", **fields)
        self.rig.until(lambda: handle in self.rig.replies)
        assert self.rig.replies[handle].ok, self.rig.replies[handle]
        self.rig.until(lambda: self.rig.says.engaged)
        self.drive(0.0)
        assert self.reason("unpark") is Reason.NONE


Rig = TypeVar("Rig", bound=GatewayRig)


def copied(rig: Rig, operator: Operator) -> tuple[Rig, Operator]:
    """Copies of both, to go on with; lists so far and layouts are shared."""
    said = [*vars(rig).values(), *vars(rig.core._journal).values()]
    shared: dict[int, object] = {id(one): one.copy() for one in said if isinstance(one, list)}
    shared |= {id(load(variant)): load(variant) for variant in (Variant.COARSE, Variant.FINE)}
    copies = deepcopy((rig, operator), shared)
    journal = copies[0].core._journal
    assert journal is not None
    # A bound method is not copied: the copy would write into its origin's journal.
    journal.add = journal._inputs.append
    return copies


@cache
def _ready(
    variant: Variant, command: CommandSettings | None, *, accept_unguarded: bool
) -> tuple[GatewayRig, Operator]:
    rig = GatewayRig(variant, command, accept_unguarded=accept_unguarded)
    rig.run(0.6)
    return rig, Operator(rig)


def ready(
    variant: Variant = Variant.COARSE, command: CommandSettings | None = None, *, accept_unguarded: bool = False
) -> tuple[GatewayRig, Operator]:
    """A robot that stands and can be engaged."""
    return copied(*_ready(variant, command, accept_unguarded=accept_unguarded))


@cache
def _driving(speed_mps: float, angle_deg: float, variant: Variant) -> tuple[GatewayRig, Operator]:
    rig, operator = ready(variant)
    operator.engage()
    operator.drive(speed_mps, angle_deg, 0.5 + abs(speed_mps) / 0.8 + 0.5)
    assert abs(rig.speed_mps - speed_mps) < 0.06, rig.speed_mps
    return rig, operator


def driving(
    speed_mps: float = 1.0, angle_deg: float = 0.0, variant: Variant = Variant.COARSE
) -> tuple[GatewayRig, Operator]:
    """A robot that is driven at this speed."""
    return copied(*_driving(speed_mps, angle_deg, variant))
