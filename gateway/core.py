"""Both flows on one page. No I/O, no clock: time is an argument.

    TELEMETRY  frame   > ``receive_frame``   > check, decode, supervise    > Sample     at the pace of the bus
               time    > ``tick``            > batches, state, health      > Samples    every 10 ms
    COMMAND    request > ``receive_request`` > waits for the tick
               time    > ``tick``            > arbitrate, encode, gate     > frames, replies, Samples
               the bus > ``sent``            > counters advance            > decisions

Each call returns what is to be done; the loop does it. Every call is recorded in the journal: with the same
inputs, the core does the same again.
"""

from __future__ import annotations

from collections.abc import Callable
from operator import attrgetter
from typing import Any, Final

import msgspec

from gateway.chassis.frame import ERROR, FaultKind, Frame
from gateway.chassis.layout import check, unknown_frame
from gateway.chassis.odometry import DeadReckoning
from gateway.chassis.port import Chassis, ChassisState
from gateway.chassis.supervision import VariantDetector, controller_state
from gateway.command.arbiter import Arbiter
from gateway.command.flow import CommandFlow, TickEffects
from gateway.command.restart import (
    QUIET_NS,
    Carried,
    as_array,
    is_at_rest,
    may_start_again,
    snapshot,
    take_over,
)
from gateway.command.rulings import RawRequest
from gateway.journal import FRAME, LINKS, JournalWriter, checkpoint, resume
from gateway.telemetry.feedback import FeedbackStream, FrameBatch
from gateway.telemetry.health import HealthMeter, LatestMessages, Links, robot_state
from schemas.codec import Sample, encode, sample_of
from schemas.decisions import ArbiterState, EventKind, Severity
from schemas.journal import Kind
from schemas.messages import SEQUENCE_MAX, ControllerState, Variant
from schemas.reasons import Reason
from schemas.settings import (
    BATCH_MAX_FRAMES,
    BATCH_PERIOD_NS,
    COMMANDER_NS,
    HEALTH_PERIOD_NS,
    ODOMETRY_PERIOD_NS,
    STATE_PERIOD_NS,
    Settings,
)

CONFIGURED_VARIANT: Final = {"auto": Variant.UNKNOWN, "coarse": Variant.COARSE, "fine": Variant.FINE}

REST_PERIOD_NS: Final = 60_000_000_000
"""Period of snapshots in the journal while the gateway is at rest."""

REST_LOOK_NS: Final = 1_000_000_000
"""Period at which the core checks whether the gateway is at rest."""

CHECKPOINT_PERIOD_NS: Final = 60_000_000_000
"""Period of checkpoints, the whole state, in the journal."""

RX, TX = "can/{bus}/rx", "can/{bus}/tx"


class Core:
    """The gateway without I/O."""

    def __init__(
        self, chassis: Chassis, settings: Settings, gateway_version: str, now_ns: int, run: int = 0
    ) -> None:
        """Begin in standby; a listening gateway has no command flow. ``run`` is a random number."""
        self._health = HealthMeter(gateway_version, settings.can.bus, now_ns)
        kept = BATCH_MAX_FRAMES if settings.can.raw_frames else 0
        self._received = FrameBatch(settings.can.bus, kept)
        self._sent = FrameBatch(settings.can.bus, kept)
        self._detector = VariantDetector(CONFIGURED_VARIANT[settings.chassis.variant], chassis.evidence())
        self._links = Links()
        self._told = _told(self._links)
        self._chassis = chassis
        layout = chassis.common
        self._streams = {
            message.can_id: FeedbackStream(chassis.decoder(message), self._health.faults)
            for message in layout.feedback
        }
        self._commands = {message.can_id for message in layout.commands}
        self._motion_commands = {layout.messages[name].can_id for name in chassis.motion_frames}
        self._known = self._streams.keys() | self._commands
        # All variants once: compiling a decoder takes a millisecond, too long for the loop.
        self._scaled = [
            (
                self._streams[layout.messages[name].can_id],
                {one: chassis.decoder(chassis.layout(one).messages[name]) for one in chassis.dbc_files},
            )
            for name in chassis.scaled_frames
        ]
        self._wheel_speed = layout.messages[chassis.evidence_frame].can_id
        self._body = layout.messages[chassis.bumper_frame].can_id
        self._apply_variant()
        self._state_due_ns = self._batch_due_ns = self._odometry_due_ns = now_ns
        self._odometry = DeadReckoning(chassis.wheelbase_m)
        self._health_due_ns = now_ns + HEALTH_PERIOD_NS
        self._state_sequence = 0
        self.command = None if settings.gateway.listen_only else CommandFlow(chassis, settings, run)
        self._tracker = chassis.tracker(self._streams.values(), self._detector, settings.chassis.required_feedback)
        self._commander_ns: int | None = None
        self._motion_ns: int | None = None
        self._requests: list[RawRequest] = []
        self._offered: list[Frame] = []
        self._journal = None if self.command is None else JournalWriter(run)
        self._rest_due_ns = now_ns + QUIET_NS
        self._checkpoint_due_ns = now_ns + CHECKPOINT_PERIOD_NS

    @property
    def variant(self) -> Variant:
        """The firmware variant in force; UNKNOWN without evidence, or with evidence against it."""
        return self._detector.in_force

    @property
    def newest_frames(self) -> list[Frame]:
        """The newest valid feedback frame of each identifier, without its time."""
        return [Frame(can_id, one.data, 0) for can_id, one in self._streams.items() if one.data is not None]

    def receive_frame(self, frame: Frame, now_ns: int) -> Sample | None:
        """Take a frame from the bus. Returns the decoded sample of a valid feedback frame."""
        self._received.add(frame)
        if self._journal is not None:
            self._journal.add((FRAME, now_ns, frame))
        stream = self._streams.get(frame.can_id)
        if stream is None:
            self._receive_other(frame, now_ns)
            return None
        if frame.can_id == self._wheel_speed and check(frame) is None:
            self._detect_variant(frame)
        sample = stream.receive(frame, now_ns)
        if sample is not None:
            self._tracker.follow(stream.latest, self._odometry)
            if frame.can_id == self._body:
                self._tracker.note_hits()
        return sample

    def receive_request(self, request: RawRequest, now_ns: int) -> None:
        """Take a request. It is judged at the next tick."""
        if self._journal is None:
            return
        said = (request.handle, request.verb, request.operator, request.payload, request.size, request.fault)
        proof = () if request.credentials is None else (request.attachment, request.credentials)
        self._journal.add((Kind.REQUEST, now_ns, *said, *proof))
        self._requests.append(request)

    def update_links(self, links: Links, now_ns: int) -> None:
        """Take the newest state of bus, Zenoh and guard."""
        before, self._links = self._links, links
        if links.bus_losses != before.bus_losses:
            # A returned bus may have another chassis, or one that the remote control took meanwhile.
            for stream in self._streams.values():
                stream.forget()
            self._detector.reset()
            self._health.controller = ControllerState.UNKNOWN
            self._apply_variant()
        if links.guard_sends or links.guard_stops != before.guard_stops:
            # The commands received meanwhile may have been the guard's.
            self._commander_ns = None
        told = _told(links)
        if self._journal is not None and told != self._told:
            self._journal.add((Kind.LINKS, now_ns, *told))
        self._told = told

    def tick(self, now_ns: int, wall_ns: int, late_ns: int, challenge: bytes) -> TickEffects:
        """Run the 10 ms tick. Returns what is due: commands, raw frames, state, health.

        The challenge is new random bytes: a command that echoes them was made after this tick.
        """
        self._health.tick_lateness(late_ns)
        for stream in self._streams.values():
            if now_ns > stream.supervisor.overdue_ns:
                stream.tick(now_ns)
        due = TickEffects([], [], [], [])
        if self.command is not None:
            due = self._command(self.command, now_ns, wall_ns, late_ns, challenge)
            if due.resets_odometry:
                self._odometry.reset()
        if now_ns >= self._odometry_due_ns:
            self._odometry_due_ns = _next_due(self._odometry_due_ns, ODOMETRY_PERIOD_NS, now_ns)
            odometry = self._odometry.report()
            if odometry is not None:
                due.samples.append(sample_of(odometry))
        if now_ns >= self._batch_due_ns:
            self._batch_due_ns = _next_due(self._batch_due_ns, BATCH_PERIOD_NS, now_ns)
            self._take_batches(due.samples, wall_ns)
        if now_ns >= self._state_due_ns:
            self._state_due_ns = _next_due(self._state_due_ns, STATE_PERIOD_NS, now_ns)
            due.samples.append(self._state(wall_ns))
        if now_ns >= self._health_due_ns:
            self._health_due_ns = _next_due(self._health_due_ns, HEALTH_PERIOD_NS, now_ns)
            streams = list(self._streams.values())
            frames = self._received.received
            barred = [f"{reason.value}: {words}" for reason, words in self.bars.items()]
            health = self._health.report(now_ns, wall_ns, self._links, self.variant, frames, streams, barred)
            due.samples.append(sample_of(health))
        return due

    def sent(self, count: int, now_ns: int, wall_ns: int) -> list[Sample]:
        """Note how many of the tick's frames the bus accepted. Returns the decisions of the tick."""
        if self.command is None or self._journal is None:
            return []
        self._journal.add((Kind.SENT, now_ns, count, wall_ns))
        for frame in self._offered[:count]:
            self._sent.add(msgspec.structs.replace(frame, wall_ns=wall_ns))
        self._offered = []
        decisions = self.command.sent(count, now_ns, wall_ns)
        if now_ns >= self._checkpoint_due_ns:
            # The tick's frames are sent: only the beat to the guard waits, for one or two milliseconds.
            self._checkpoint_due_ns = now_ns + CHECKPOINT_PERIOD_NS
            self._journal.add((Kind.CHECKPOINT, now_ns, wall_ns, _STATE.encode(checkpoint(self))))
        return decisions

    def resume(self, state: bytes) -> None:
        """Bring this new core, with the same settings, into the state of a checkpoint. Raises CheckpointError."""
        resume(self, state)
        for stream, decoders in self._scaled:
            stream.decoder = decoders.get(self.variant)

    def look_from(self, links: Links, controller: ControllerState) -> None:
        """Seed a core that starts mid-run with the current link and controller state, reporting no change."""
        self._links, self._told = links, _told(links)
        self._health.controller = controller

    def _arbiter(self, kind: Kind, now_ns: int, *values: object) -> Arbiter | None:
        """Record an input of the arbiter. Returns the arbiter; None if the gateway only listens."""
        if self.command is None or self._journal is None:
            return None
        self._journal.add((kind, now_ns, *values))
        return self.command.arbiter

    def last_batches(self, wall_ns: int) -> list[Sample]:
        """Return the raw frames and the journal that are not published yet, at the end."""
        samples: list[Sample] = []
        self._take_batches(samples, wall_ns)
        return samples

    def latch_guard_stop(self, words: str, now_ns: int) -> None:
        """Latch a stop of the guard from before this start, with these words."""
        if arbiter := self._arbiter(Kind.GUARD_STOP, now_ns, words):
            arbiter.engagement.latch(Reason.GUARD, words, now_ns)

    def note_crash(self, now_ns: int) -> None:
        """Note that the previous gateway crashed: the first uncommanded motion is latched."""
        if arbiter := self._arbiter(Kind.CRASHED, now_ns):
            arbiter.engagement.is_after_crash = True

    def warn(self, words: str, now_ns: int) -> None:
        """Report these words as an event."""
        if arbiter := self._arbiter(Kind.WARNING, now_ns, words):
            arbiter.outbox.add_event(Severity.WARNING, EventKind.FAULT, Reason.NONE, words)

    def end_lease(self, reason: Reason, detail: str, now_ns: int) -> None:
        """End the lease, because its holder's grant is no longer valid."""
        if arbiter := self._arbiter(Kind.END_LEASE, now_ns, reason, detail):
            arbiter.end_lease(reason, detail, now_ns)

    def bar(self, bars: dict[Reason, str], now_ns: int) -> None:
        """Forbid engaging for these reasons, each with its words; an empty dict allows it again."""
        if arbiter := self._arbiter(Kind.BARS, now_ns, bars):
            arbiter.engagement.bars = bars

    @property
    def bars(self) -> dict[Reason, str]:
        """The reasons outside the command flow against engaging, each with its words."""
        return {} if self.command is None else self.command.arbiter.engagement.bars

    def challenge_age_ns(self, challenge: bytes, now_ns: int) -> int | Reason:
        """The time since a challenge was published, or why it is unknown."""
        if self.command is None:
            return Reason.CHALLENGE_UNKNOWN
        return self.command.arbiter.link.challenges.age_ns(challenge, now_ns)

    def shut_down(self, now_ns: int) -> None:
        """Bring the robot to rest before the end. ``is_at_rest`` is true when that is done."""
        if arbiter := self._arbiter(Kind.SHUT_DOWN, now_ns):
            arbiter.engagement.shut_down(now_ns)

    def hears_commands(self, now_ns: int) -> bool:
        """Return True if another computer or a guard commands the chassis."""
        return self._motion_ns is not None and now_ns - self._motion_ns < COMMANDER_NS

    @property
    def lease_holder(self) -> str:
        """The operator who holds the lease; empty if there is none."""
        lease = self.command.arbiter.leases.held if self.command is not None else None
        return lease.operator if lease is not None else ""

    @property
    def lease_id(self) -> int:
        """The identifier of the lease in force; 0 if there is none."""
        lease = self.command.arbiter.leases.held if self.command is not None else None
        return lease.id if lease is not None else 0

    @property
    def last_sequence(self) -> int:
        """The sequence of the last drive accepted under this lease; -1 if none."""
        return self.command.arbiter.link.last_sequence if self.command is not None else -1

    def may_start_again(self, now_ns: int) -> bool:
        """Return True if the gateway may be away for seconds: the robot stands, and its lease is free."""
        return self.command is None or may_start_again(self.command, now_ns)

    def take_over(self, former: Carried, now_ns: int) -> None:
        """Continue from the state of the previous gateway: latches stay until a reset."""
        if arbiter := self._arbiter(Kind.CARRIED, now_ns, msgspec.structs.astuple(former)):
            take_over(arbiter, former, now_ns)

    @property
    def is_at_rest(self) -> bool:
        """No command is sent on the bus."""
        return self.command is None or self.command.arbiter.state is ArbiterState.STANDBY

    @property
    def is_held_by_motor(self) -> bool:
        """A stop cannot end, because only the motor holds the robot."""
        return self.command is not None and self.command.arbiter.engagement.is_held_by_motor

    def _command(
        self, command: CommandFlow, now_ns: int, wall_ns: int, late_ns: int, challenge: bytes
    ) -> TickEffects:
        if self._journal is not None:
            if now_ns >= self._rest_due_ns:
                self._remember(command, self._journal, now_ns)
            self._journal.add((Kind.TICK, now_ns, wall_ns, late_ns, challenge))
        seen = self._tracker.state(self._health.controller, self.variant, self._commander_ns, now_ns)
        chassis = as_linked(seen, self._links)
        requests, self._requests = self._requests, []
        due = command.tick(chassis, requests, now_ns, wall_ns, late_ns, challenge)
        self._offered = due.frames
        return due

    def _remember(self, command: CommandFlow, journal: JournalWriter, now_ns: int) -> None:
        """Write a snapshot if the gateway is at rest, so that a rerun can begin here."""
        self._rest_due_ns = now_ns + REST_LOOK_NS
        if is_at_rest(command, now_ns):
            self._rest_due_ns = now_ns + REST_PERIOD_NS
            controller = self._health.controller.value
            journal.add((Kind.REST, now_ns, as_array(snapshot(command)), controller, *_told(self._links)))

    def _take_batches(self, samples: list[Sample], wall_ns: int) -> None:
        for subject, batch in ((RX, self._received), (TX, self._sent)):
            frames = batch.take(wall_ns)
            if frames is not None:
                samples.append(Sample(subject, encode(frames)))
        journal = self._journal.take(wall_ns) if self._journal is not None else None
        if journal is not None:
            samples.append(sample_of(journal))

    def _receive_other(self, frame: Frame, now_ns: int) -> None:
        """Take a frame that is no feedback. Another computer's command frame is no fault: it may own the bus."""
        if frame.can_id in self._commands:
            if frame.can_id not in self._motion_commands:
                return  # Lamps and horn do not move the robot.
            # The guard's frames are ours: as another computer's, the chassis would count as taken over.
            if check(frame) is None:
                self._motion_ns = now_ns
                if not self._links.guard_sends:
                    self._commander_ns = now_ns
            return
        if frame.can_id & ERROR:
            self._health.controller = controller_state(frame) or self._health.controller
        fault = unknown_frame(frame, self._known)
        self._health.faults[fault.kind] += 1
        if fault.kind is FaultKind.UNKNOWN_IDENTIFIER:
            self._health.unknown_identifier(frame.can_id)

    def _detect_variant(self, frame: Frame) -> None:
        before = self.variant
        fault = self._detector.receive(frame.data)
        if fault is not None:
            self._health.faults[fault] += 1
        if self.variant is not before:
            self._apply_variant()

    def _apply_variant(self) -> None:
        """Set the decoders of the scaled frames; none while the variant is in doubt."""
        variant = self.variant
        for stream, decoders in self._scaled:
            stream.withhold()
            stream.decoder = decoders.get(variant)

    def _state(self, wall_ns: int) -> Sample:
        streams = self._streams.values()
        state = robot_state(
            LatestMessages([stream.latest for stream in streams if stream.latest is not None]),
            wheelbase_m=self._chassis.wheelbase_m,
            time_ns=wall_ns,
            sequence=self._state_sequence,
            bus_up=self._links.bus_up,
            variant=self.variant,
            silent=[stream.layout.name for stream in streams if stream.supervisor.is_silent],
        )
        self._state_sequence = (self._state_sequence + 1) & SEQUENCE_MAX
        return sample_of(state)


_STATE: Final = msgspec.msgpack.Encoder()

_told: Final[Callable[[Links], tuple[Any, ...]]] = attrgetter(*LINKS)
"""The links that the command flow depends on, as in the journal."""


def as_linked(seen: ChassisState, links: Links) -> ChassisState:
    """Add the state of bus and guard to the chassis as seen on the bus."""
    return msgspec.structs.replace(seen, **dict(zip(LINKS, _told(links), strict=True)))


def _next_due(due_ns: int, period_ns: int, now_ns: int) -> int:
    """The next multiple of the period after now: after a late tick there is one, not several."""
    return due_ns + period_ns * ((now_ns - due_ns) // period_ns + 1)
