"""The one thread that owns both flows on the robot: a frame in, a sample out, and a tick every 10 ms."""

from __future__ import annotations

import gc
import logging
import os
import secrets
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Final, Protocol

import msgspec

from gateway.chassis.frame import Frame
from gateway.command.flow import CommandFlow, PendingReply
from gateway.command.restart import LeaseNumbers
from gateway.command.rulings import RawRequest
from gateway.core import Core
from gateway.guard.stopper import GuardView
from gateway.telemetry.health import Links
from schemas.codec import Sample
from schemas.decisions import Severity
from schemas.reasons import Reason, of_a_robot
from schemas.requests import CHALLENGE_BYTES, LEASE_MAX
from schemas.settings import BEHIND_NS, LATE_NS, LATE_TOLD_NS, LOOP_LATE_STOP_NS, REST_TIMEOUT_NS, TICK_NS

if TYPE_CHECKING:
    # Loaded in signed mode alone.
    from gateway.authority.robot_authority import Kept, RobotAuthority

log = logging.getLogger(__name__)

MS: Final = 1_000_000

LEVELS: Final = {Severity.INFO: logging.INFO, Severity.WARNING: logging.WARNING, Severity.ERROR: logging.ERROR}
"""Log levels of events."""

BURST_MAX_FRAMES: Final = 32
"""Frames read at a time, so that a busy bus cannot delay the tick."""

NO_GUARD: Final = GuardView()

SELDOM_TICKS: Final = 10
"""Period in ticks of slow queries: connected nodes and real-time priority."""


CATCH_UP_BURSTS: Final = 256
"""Most bursts read before the first tick after a pause: a second of a saturated bus."""


class FrameSource(Protocol):
    """The bus. Its methods never raise: it is up or down."""

    is_up: bool
    detail: str
    losses: int

    @property
    def drops(self) -> int:
        """Frames dropped before they were read, since the start."""

    def receive(self, timeout_s: float) -> Frame | None:
        """The next frame, or None after the timeout."""

    def send(self, frames: list[Frame]) -> int:
        """Send frames. Returns how many the bus accepted, up to the first that it did not."""


class SampleSink(Protocol):
    """Zenoh. Its methods never raise and never block."""

    @property
    def failures(self) -> int:
        """Samples that Zenoh did not accept."""

    def publish(self, sample: Sample) -> None:
        """Publish a sample."""

    def peers(self) -> int:
        """Directly connected nodes."""

    def outside(self) -> tuple[str, ...]:
        """The remote ends of connections that leave this machine."""

    def answer(self, reply: Callable[[], bytes]) -> None:
        """Answer waiting queries, a bounded number."""


class RequestInbox(Protocol):
    """Waiting requests. Its methods never raise and never block."""

    @property
    def drops(self) -> int:
        """Requests dropped unread since the start, because there were too many."""

    def drain(self, holder: str, lease: int, after: int) -> list[RawRequest]:
        """Return waiting requests, a bounded number: stops first, then the lease holder's."""

    def statements(self) -> list[RawRequest]:
        """Return waiting statements of the authority, a bounded number."""

    def reply(self, reply: PendingReply) -> None:
        """Send a reply."""


class Admission(Protocol):
    """Between inbox and core: it knows secrets that core and journal must not hold."""

    def number_of(self, lease_id: int) -> int:
        """The number in the holder's requests; 0 if there is no such lease."""

    def admit(self, raw: RawRequest, now_ns: int) -> RawRequest:
        """Return the request for the core, without secrets, with the sender's credentials."""

    def reply(self, reply: PendingReply) -> PendingReply:
        """Return the reply for its receiver."""


class SignedModePort(Protocol):
    """The authority in signed mode. ``certificate_ends_s``: seconds since 1970; None without a certificate."""

    authority: RobotAuthority
    certificate_ends_s: int | None

    def save(self, kept: Kept) -> None:
        """Save this for a restart, without waiting."""


class Guard(Protocol):
    """The guard."""

    def look(self) -> GuardView:
        """Return the guard's state."""

    def beat(self, now_ns: int, command: CommandFlow) -> None:
        """Report that the loop is alive, each tick after the frames are sent."""


class Note(Protocol):
    """The note of a stop by the guard. Its methods never raise and never block."""

    def follow(self, *, is_latched: bool) -> None:
        """Take each tick whether a stop by the guard is latched."""


class FormerGuardView(Protocol):
    """The guard of the previous gateway.

    Attributes:
        is_stopping: it has begun a stop recently, and not reported its end.
        says: how the stop ended; empty until then.
    """

    is_stopping: bool
    says: str


class LoopPorts(msgspec.Struct):
    """The ports of the loop. Inbox, guard and notes are None if the gateway only listens.

    Attributes:
        manager: tells the service manager that the loop runs, with its state for people.
        latch_note: takes the latches each tick, and returns once why they could not be written.
        mileage_note: takes the mileage each tick, and returns once a question if it differs from the noted one.
    """

    bus: FrameSource
    sink: SampleSink
    inbox: RequestInbox | None = None
    guard: Guard | None = None
    note: Note | None = None
    former_guard: FormerGuardView | None = None
    has_realtime: Callable[[], bool] = lambda: False
    signed: SignedModePort | None = None
    notes: Callable[[], tuple[str, ...]] = tuple
    manager: Callable[[str], None] | None = None
    latch_note: Callable[[Mapping[Reason, str]], str] | None = None
    mileage_note: Callable[[float | None], str] | None = None


@contextmanager
def _no_collections() -> Iterator[None]:
    """Disable garbage collection, which would pause the loop at any time."""
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
        gc.unfreeze()


@_no_collections()
def run(ports: LoopPorts, core: Core, info: Callable[[], bytes], stopped: Callable[[], bool]) -> None:
    """Run until ``stopped()``, asked every tick, and then until the robot is at rest."""
    monotonic_ns = time.monotonic_ns
    sink = ports.sink
    reader = Reader(ports, core)
    due_ns = monotonic_ns() + TICK_NS
    links = Links()
    signed = ports.signed
    admission: Admission = (
        LeaseNumbers(lambda: secrets.randbelow(LEASE_MAX) + 1) if signed is None else signed.authority.admission
    )
    complained_ns = 0
    ticks = 0
    end_ns: int | None = None
    while True:
        now_ns = monotonic_ns()
        if end_ns is not None and (core.is_at_rest or now_ns > end_ns):
            break
        if end_ns is None and stopped():
            # One more tick reports the shutdown, at rest or not.
            end_ns = now_ns + REST_TIMEOUT_NS
            core.shut_down(now_ns)
        while now_ns < due_ns:
            reader.read_burst((due_ns - now_ns) / 1e9)
            now_ns = monotonic_ns()
        late_ns = now_ns - due_ns
        if late_ns > LOOP_LATE_STOP_NS:
            # Decisions must not use feedback from before the pause.
            reader.catch_up()
            now_ns = monotonic_ns()
        # With an arbiter this is an event, which is logged.
        if core.command is None and late_ns > LATE_NS and now_ns - complained_ns > LATE_TOLD_NS:
            complained_ns = now_ns
            log.warning("the loop was %d ms late; frames that waited keep their own times", late_ns // MS)
        is_behind = now_ns - reader.read_all_ns > BEHIND_NS
        links = _read_links(ports, links, is_behind=is_behind, is_full=ticks % SELDOM_TICKS == 0)
        if ports.former_guard is not None:
            links = _with_former(links, ports.former_guard, hears_commands=core.hears_commands(now_ns))
        ticks += 1
        _tick(ports, core, admission, links, now_ns, late_ns)
        sink.answer(info)
        # Last in the round, so that only a completed one feeds the watchdog.
        if ticks % SELDOM_TICKS == 0 and ports.manager is not None:
            ports.manager(_status(core, links))
        due_ns += TICK_NS * (1 + (now_ns - due_ns) // TICK_NS)
    if ports.guard is not None and core.command is not None:
        # The last beat: nothing is commanded now, so the guard has nothing to stop.
        ports.guard.beat(monotonic_ns(), core.command)
    _publish_last(ports, core)


def _status(core: Core, links: Links) -> str:
    state = "listening only" if core.command is None else core.command.arbiter.state.value
    bus = "bus up" if links.bus_up else f"no bus: {links.bus_detail}"
    guard = "guarded" if links.guarded else "not guarded"
    return "; ".join((f"{state}, {bus}, {guard}", *links.notes))


def _publish_last(ports: LoopPorts, core: Core) -> None:
    for sample in core.last_batches(time.time_ns()):
        ports.sink.publish(sample)
    if ports.signed is not None:
        ports.signed.save(ports.signed.authority.to_keep(time.clock_gettime_ns(time.CLOCK_BOOTTIME)))


def _follow_notes(ports: LoopPorts, core: Core, now_ns: int) -> None:
    if core.command is None:
        return
    arbiter = core.command.arbiter
    latched = arbiter.latches.details
    if ports.note is not None:
        ports.note.follow(is_latched=Reason.GUARD in latched)
    if ports.latch_note is not None and (fault := ports.latch_note(latched)):
        core.warn(fault, now_ns)
    mileage_km = arbiter.monitor.chassis.total_mileage_km
    if ports.mileage_note is not None and (question := ports.mileage_note(mileage_km)):
        core.warn(question, now_ns)


def _tick(ports: LoopPorts, core: Core, admission: Admission, links: Links, now_ns: int, late_ns: int) -> None:
    """Take requests; send the frames first, then everything else."""
    monotonic_ns, inbox = time.monotonic_ns, ports.inbox
    core.update_links(links, now_ns)
    said = [] if ports.signed is None else _follow_authority(ports.signed, core, inbox, now_ns)
    if ports.signed is None and links.outside and not core.bars:
        # In open mode it is unknown who commands from there.
        core.bar({Reason.UNAUTHENTICATED: f"connected with {', '.join(links.outside)}"}, now_ns)
    if inbox is not None:
        lease = admission.number_of(core.lease_id)
        for request in inbox.drain(core.lease_holder, lease, core.last_sequence):
            core.receive_request(admission.admit(request, now_ns), now_ns)
    due = core.tick(now_ns, time.time_ns(), late_ns, os.urandom(CHALLENGE_BYTES))
    # Ask again right before sending: this process may have been paused for longer than the guard waits.
    guard = ports.guard.look() if ports.guard is not None else NO_GUARD
    is_ours = not guard.is_sending and guard.stops == links.guard_stops
    count = ports.bus.send(due.frames) if due.frames and is_ours else 0
    samples = core.sent(count, monotonic_ns(), time.time_ns())
    if ports.guard is not None and core.command is not None:
        ports.guard.beat(monotonic_ns(), core.command)
    _follow_notes(ports, core, monotonic_ns())
    if inbox is not None:
        for reply in due.replies:
            inbox.reply(admission.reply(reply))
    for sample in (*due.samples, *samples, *said):
        ports.sink.publish(sample)
    for event in due.events:
        log.log(LEVELS[event.severity], "%s", event.text)


def warn_of_bars(bars: dict[Reason, str]) -> None:
    """Log why the robot cannot be engaged."""
    for reason, words in bars.items():
        text = of_a_robot(reason, bars)
        log.warning("the robot cannot be engaged: %s: %s; %s", text.means, words, text.cure)


def _follow_authority(signed: SignedModePort, core: Core, inbox: RequestInbox | None, now_ns: int) -> list[Sample]:
    """Take the authority's statements, and act on them. Returns the samples to publish."""
    boot_ns = time.clock_gettime_ns(time.CLOCK_BOOTTIME)
    authority = signed.authority
    if inbox is not None:
        for statement in inbox.statements():
            inbox.reply(authority.receive(statement, boot_ns))
    effects = authority.tick(now_ns, boot_ns, time.time_ns())
    if effects.bars is not None:
        core.bar(effects.bars, now_ns)
        warn_of_bars(effects.bars)
    lease = authority.admission.lease
    if effects.ended is not None and lease is not None and core.lease_id == lease.id:
        core.end_lease(effects.ended.reason, effects.ended.detail, now_ns)
    if effects.kept is not None:
        signed.save(effects.kept)
    return effects.samples


class Reader:
    """Reads the bus, and publishes its samples.

    Attributes:
        read_all_ns: when the bus was last read to its end. Long ago: frames arrive faster than they are read.
    """

    def __init__(self, ports: LoopPorts, core: Core) -> None:
        self.read_all_ns = time.monotonic_ns()
        self._receive = ports.bus.receive
        self._publish = ports.sink.publish
        self._core = core

    def read_burst(self, timeout_s: float) -> bool:
        """Wait for a frame, and read those behind it. Returns True if nothing is left.

        Published right after each other, samples share Zenoh's batches and wake its sending thread once.
        """
        receive, receive_frame, monotonic_ns = self._receive, self._core.receive_frame, time.monotonic_ns
        samples: list[Sample] = []
        is_empty = False
        for _ in range(BURST_MAX_FRAMES):
            frame = receive(timeout_s)
            if frame is None:
                is_empty = True
                break
            sample = receive_frame(frame, monotonic_ns())
            if sample is not None:
                samples.append(sample)
            timeout_s = 0
        if is_empty:
            self.read_all_ns = monotonic_ns()
        for sample in samples:
            self._publish(sample)
        return is_empty

    def catch_up(self) -> None:
        """Read the frames that waited during a pause, a bounded number."""
        for _ in range(CATCH_UP_BURSTS):
            if self.read_burst(0):
                return


def _read_links(ports: LoopPorts, before: Links, *, is_behind: bool, is_full: bool) -> Links:
    bus, sink, signed = ports.bus, ports.sink, ports.signed
    peers = sink.peers() if is_full else before.zenoh_peers
    guard = ports.guard.look() if ports.guard is not None else NO_GUARD
    if bus.is_up and not before.bus_up:
        log.info("the bus is up%s", " again" if bus.losses else "")
    elif bus.losses != before.bus_losses:
        log.warning("the bus is lost: %s; trying again", bus.detail)
    if before.zenoh_peers and not peers:
        log.info("no Zenoh node is connected any more")
    elif peers and not before.zenoh_peers:
        log.info("a Zenoh node is connected")
    return Links(
        bus_up=bus.is_up,
        bus_detail=bus.detail,
        bus_losses=bus.losses,
        bus_drops=bus.drops,
        zenoh_peers=peers,
        publish_failures=sink.failures,
        cpu_ns=time.process_time_ns(),
        guarded=guard.is_watching,
        guard_sends=guard.is_sending,
        guard_stops=guard.stops,
        guard_says=guard.says,
        is_behind=is_behind,
        realtime=ports.has_realtime() if is_full else before.realtime,
        inbox_drops=ports.inbox.drops if ports.inbox is not None else 0,
        outside=sink.outside() if is_full else before.outside,
        certificate_ends_s=None if signed is None else signed.certificate_ends_s,
        grant_ends_s=signed.authority.grant_ends_s if signed is not None and is_full else before.grant_ends_s,
        notes=ports.notes() if is_full else before.notes,
    )


def _with_former(links: Links, former: FormerGuardView, *, hears_commands: bool) -> Links:
    """Add the guard of the previous gateway to the links.

    Until it reports its end, commands on the bus are its own. Without any, it may be dead, and the gateway acts.
    """
    return msgspec.structs.replace(
        links,
        guard_sends=links.guard_sends or (former.is_stopping and hears_commands),
        guard_says=links.guard_says or former.says,
    )
