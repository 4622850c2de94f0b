"""A log published again on Zenoh, as the samples that it was made from.

A record of ours becomes its typed message and that its MessagePack payload, a RawSample the payload that it kept,
frames of one batch a batch. Other makers' channels and lines for viewers never were samples, and are passed over.
Every due time is counted from one anchor, so that nothing adds up. Memory is bounded, however long the logs are.

Nothing is declared that a live robot has, no liveliness token and no queryable, and where a gateway is connected
under the same root nothing is published.
"""

from __future__ import annotations

import logging
import re
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import lru_cache
from typing import Any, Final, Protocol

import msgspec
import zenoh

from recorder.reading.logs import Faults
from recorder.reading.rows import Row
from recorder.reading.topics import UNREADABLE, Topic
from schemas import codec, keys
from schemas.can_word import BITRATE_SWITCH, ERROR, ERROR_STATE_INDICATOR, EXTENDED, FD, REMOTE
from schemas.command_line import CommandError, ExitCode
from schemas.messages import CanFrame, CanFrames, Message, RawSample
from schemas.recording import RAW_CHUNK
from schemas.settings import BATCH_MAX_FRAMES, ZenohSettings
from schemas.subjects import COMMAND_CHUNK, Subject
from schemas.zenoh_session import GOSSIP, close_session, is_connected, join, local_port, open_session, said_of

REMEMBERED: Final = 200_000
"""Rows that are compared with those of other files: some four minutes of a robot. Twice as many are held."""


def once(rows: Iterable[Row], remembered: int = REMEMBERED) -> Iterator[Row]:
    before: dict[tuple[str, int, int], Topic] = {}
    seen: dict[tuple[str, int, int], Topic] = {}
    for row in rows:
        topic = row.topic
        name = (topic.name, row.sequence, row.publish_ns)
        first = seen.get(name) or before.get(name)
        if first is None:
            if len(seen) >= remembered:
                before, seen = seen, {}
            seen[name] = topic
        elif first is not topic:
            # Each file has topics of its own; what one file has twice was twice.
            continue
        yield row


def runs(rows: Iterable[Row]) -> Iterator[list[Row]]:
    """Each row by itself, but raw frames that came in one batch together, at the place of the first."""
    pending: dict[Topic, list[Row]] = {}
    log_ns = -1
    for row in rows:
        if row.log_ns != log_ns:
            yield from pending.values()
            pending, log_ns = {}, row.log_ns
        topic = row.topic
        if topic.kind is not CanFrame:
            yield [row]
            continue
        batch = pending.get(topic)
        if batch and (batch[0].sequence != row.sequence or len(batch) >= BATCH_MAX_FRAMES):
            yield batch
            batch = None
        if batch is None:
            pending[topic] = [row]
        else:
            batch.append(row)
    yield from pending.values()


DEFAULT_ROOT: Final = "replay"  # the root of a replay, which nobody takes for a robot's

_PLAIN: Final = re.compile(r"[^/*$?#]+(/[^/*$?#]+)*")
"""A key that names one thing: a log may hold anything, and a wildcard would reach many."""

_LAST_NS: Final = 2**63 - 1

ENCODING_BYTES_MAX: Final = 255
"""Zenoh takes no longer encoding: its session panics over one, and sends nothing from then on."""

DELETED: Final = "deleted"  # the reason with which the recorder keeps a sample that deletes its key

MATCHES_KEPT: Final = 10_000

Wants = Callable[[str], bool]  # reports whether a key of the log is wanted


def wants_of(texts: Sequence[str]) -> Wants:
    """Return a test of keys by Zenoh's key expressions."""
    expressions = []
    for text in texts:
        try:
            expressions.append(zenoh.KeyExpr.autocanonize(text))
        except zenoh.ZError as error:
            raise CommandError(f"{text!a} is no key expression", ExitCode.USAGE) from error

    @lru_cache(MATCHES_KEPT)
    def wants(key: str) -> bool:
        try:
            return any(one.includes(zenoh.KeyExpr(key)) for one in expressions)
        except zenoh.ZError:
            return False

    return wants


class ReplaySample(msgspec.Struct, frozen=True):
    """A sample to be published again.

    Attributes:
        time_ns: when it is due, in the log's time.
        subject: its row in the table of subjects; None if it has none.
        message: its content; None of a sample that was kept as it was, which has ``raw`` and ``attachment``.
    """

    time_ns: int
    key: str
    encoding: str
    subject: Subject | None = None
    message: Message | None = None
    raw: bytes = b""
    attachment: bytes = b""
    is_delete: bool = False

    def payload(self, shift_ns: int = 0) -> bytes:
        """The payload, with all its receive times so much later. A payload that nobody can read stays as it is."""
        if self.message is None:
            return self.raw
        return codec.encode(shifted(self.message, shift_ns) if shift_ns else self.message)


def shifted(message: Message, shift_ns: int) -> Message:
    """The message, so much later: its ``time_ns``, and those of the frames in it."""

    def later(time_ns: int) -> int:
        return min(max(0, time_ns + shift_ns), _LAST_NS)

    changes: dict[str, Any] = {"time_ns": later(message.time_ns)}
    if isinstance(message, CanFrames):
        changes["frame_time_ns"] = list(map(later, message.frame_time_ns))
    return msgspec.structs.replace(message, **changes)


class KeyMap:
    """From the key in the log to the one under the replay's root.

    The log's root is replaced. If the log has several, each stays, behind the new one: else two robots of the same
    name would become one. A key under none of them is put behind the new root whole.
    """

    def __init__(self, root: str, log_roots: Sequence[str]) -> None:
        self._root = root
        self._replaced = f"{log_roots[0]}/" if len(log_roots) == 1 else ""

    def __call__(self, key: str) -> str | None:
        if _PLAIN.fullmatch(key) is None or COMMAND_CHUNK in key.split("/"):
            return None
        return f"{self._root}/{key.removeprefix(self._replaced)}"


def roots_of(topics: Iterable[Topic]) -> list[str]:
    """The roots of the robots, and of the recorders, that topics are about."""
    ours = [keys.parse(topic.name) for topic in topics if topic.kind not in {None, RawSample}]
    return sorted({parts.root for parts in ours if parts is not None})


def overlap(one: str, other: str) -> bool:
    """Report whether one of two roots is the other, or begins it: what is under the longer is then under both."""
    shorter, longer = sorted((f"{one}/", f"{other}/"), key=len)
    return longer.startswith(shorter)


def may_hold(topic: Topic, wants: Wants) -> bool:
    if topic.kind is RawSample:
        # Its samples tell their keys; only of a broken one of a known key the topic does too.
        key = topic.name.removesuffix(f"/{RAW_CHUNK}")
        return key == topic.name or wants(key)
    return _subject_of(topic) is not None and wants(topic.name)


class Samples:
    """Makes samples of runs of rows.

    Attributes:
        withheld: samples that must not be published: commands, keys that name more than one thing,
            and what has an encoding that is too long for Zenoh.
    """

    def __init__(self, new_key: KeyMap, wants: Wants, faults: Faults) -> None:
        self._new_key = new_key
        self._wants = wants
        self._faults = faults
        self._known: dict[Topic, tuple[str | None, Subject | None]] = {}
        self.withheld = 0

    def of(self, runs: Iterable[list[Row]]) -> Iterator[ReplaySample]:
        for rows in runs:
            try:
                sample = self._sample(rows)
            except UNREADABLE as error:
                self._faults.add(f"{rows[0].topic.name}: a message cannot be decoded: {error}")
                continue
            if sample is not None:
                yield sample

    def _sample(self, rows: list[Row]) -> ReplaySample | None:
        topic, time_ns = rows[0].topic, rows[0].log_ns
        decode = topic.decode
        if decode is None:
            return None
        if topic.kind is RawSample:
            return self._raw(time_ns, decode(rows[0].data))
        known = self._known.get(topic)
        if known is None:
            known = self._known[topic] = (self._new_key(topic.name), _subject_of(topic))
        key, subject = known
        if key is None or subject is None:
            self.withheld += key is None
            return None
        messages = [decode(row.data) for row in rows]
        message = batch(messages, rows[0].sequence) if topic.kind is CanFrame else messages[0]
        return ReplaySample(time_ns, key, subject.encoding, subject, message)

    def _raw(self, time_ns: int, raw: RawSample) -> ReplaySample | None:
        if not self._wants(raw.key):
            return None
        key = self._new_key(raw.key)
        if key is None or len(raw.encoding.encode()) > ENCODING_BYTES_MAX:
            self.withheld += 1
            return None
        is_delete = raw.reason == DELETED
        return ReplaySample(
            time_ns, key, raw.encoding, raw=raw.payload, attachment=raw.attachment, is_delete=is_delete
        )


def batch(frames: Sequence[CanFrame], sequence: int) -> CanFrames:
    return CanFrames(
        time_ns=max(frame.time_ns for frame in frames),
        sequence=sequence,
        bus=frames[0].bus,
        dropped=0,
        frame_time_ns=[frame.time_ns for frame in frames],
        can_id=[
            one.identifier | EXTENDED * one.is_extended | REMOTE * one.is_remote | ERROR * one.is_error
            for one in frames
        ],
        fd_flags=[
            FD * one.is_fd
            | BITRATE_SWITCH * one.bitrate_switch
            | ERROR_STATE_INDICATOR * one.error_state_indicator
            for one in frames
        ],
        length=[frame.dlc for frame in frames],
        data=[frame.data for frame in frames],
    )


def _subject_of(topic: Topic) -> Subject | None:
    """The row of the table that a topic's messages are of; None if key and schema do not fit, or are not ours."""
    parts = keys.parse(topic.name)
    if parts is None:
        return None
    recorded = CanFrame if parts.subject.type is CanFrames else parts.subject.type
    return parts.subject if topic.kind is recorded else None


AS_FAST_AS_POSSIBLE: Final = 0.0  # the speed that waits for nothing
FOR_EVER: Final = 0  # the number of loops that never ends
LONGEST_PAUSE_NS: Final = 60_000_000_000  # a longer pause of the log is cut to this

SET_BACK_NS: Final = 1_000_000_000
"""A message that is further behind in the log's time was received by a clock that had been set back."""

SLIP_NS: Final = 1_000_000_000
"""A process that stood still for longer (Ctrl-Z, a machine that slept) resumes from there, without a burst."""

ATTEND_NS: Final = 20_000_000  # the period in which the outlet is looked after


class Pace:
    """From the log's time to the clock's. Due times never step back.

    Args:
        speed: so many times as fast as recorded; AS_FAST_AS_POSSIBLE makes everything due at once.

    Attributes:
        cut: pauses that were cut.
    """

    def __init__(self, speed: float) -> None:
        self.speed = speed
        self._anchor_ns = self._anchor_time_ns = 0
        self._latest_ns: int | None = None
        self.cut = 0

    def start(self, now_ns: int) -> None:
        """Make the next item due now."""
        self._anchor_ns = now_ns
        self._latest_ns = None

    def delay(self, duration_ns: int) -> None:
        """All that is not due yet is due so much later."""
        self._anchor_ns += duration_ns

    def due_ns(self, time_ns: int) -> int:
        """Return the due time of a log time. To be called in the order of the log, once for each item."""
        if self._latest_ns is None:
            self._anchor_time_ns = self._latest_ns = time_ns
        step_ns = time_ns - self._latest_ns
        if step_ns > LONGEST_PAUSE_NS:
            self._anchor_time_ns += step_ns - LONGEST_PAUSE_NS
            self.cut += 1
        if step_ns < -SET_BACK_NS:
            self._anchor_time_ns += step_ns
        elif step_ns < 0:
            time_ns = self._latest_ns
        self._latest_ns = time_ns
        return self._anchor_ns + (round((time_ns - self._anchor_time_ns) / self.speed) if self.speed else 0)


class Outlet(Protocol):
    """The destination of a replay."""

    def send(self, item: ReplaySample, shift_ns: int) -> None:
        """Send one. Its time stamps become so much later. Never raises."""

    def attend(self) -> CommandError | None:
        """Look after what else there is. Returns why it cannot go on."""


class Played(msgspec.Struct):
    """The course of a replay.

    Attributes:
        loops: number of times that it was begun.
        late_ns: the greatest lateness of a sample, if it is paced.
        slipped_ns: by how much the whole has been put off, as it could not keep up: see SLIP_NS.
        has_ended: it reached the end.
        halt: why it could not go on.
    """

    loops: int = 0
    late_ns: int = 0
    slipped_ns: int = 0
    has_ended: bool = False
    halt: CommandError | None = None


def play(
    read: Callable[[], Iterator[ReplaySample]],
    pace: Pace,
    outlet: Outlet,
    stopped: Callable[[], bool],
    *,
    loops: int = 1,
    is_now: bool = False,
) -> Played:
    """Play to the end, or until stopped.

    Args:
        is_now: every time stamp is moved by what lies between the log's time and the present.
    """
    played = Played()
    epoch_ns = time.time_ns() - time.monotonic_ns()
    attend_ns = due_ns = 0
    while loops == FOR_EVER or played.loops < loops:
        items = read()
        item = next(items, None)
        if item is None:
            break
        # What it took to find the beginning is no lateness. What was late makes the next round no later.
        pace.start(due_ns if played.loops else time.monotonic_ns())
        played.loops += 1
        while item is not None:
            due_ns = pace.due_ns(item.time_ns)
            while (now_ns := time.monotonic_ns()) < due_ns or now_ns >= attend_ns:
                if now_ns >= attend_ns:
                    attend_ns = now_ns + ATTEND_NS
                    played.halt = outlet.attend()
                else:
                    time.sleep((min(due_ns, attend_ns) - now_ns) / 1e9)
                if played.halt is not None or stopped():
                    return played
            if pace.speed:
                late_ns = now_ns - due_ns
                played.late_ns = max(played.late_ns, late_ns)
                if late_ns > SLIP_NS:
                    pace.delay(late_ns)
                    played.slipped_ns += late_ns
                    due_ns = now_ns
            present_ns = epoch_ns + (due_ns if pace.speed else now_ns)
            outlet.send(item, present_ns - item.time_ns if is_now else 0)
            item = next(items, None)
    played.has_ended = True
    played.halt = outlet.attend()
    return played


log = logging.getLogger(__name__)

TOKENS_WAITING: Final = 10_000

TOKEN_TIMEOUT_S: Final = 1.0  # the start asks for gateways for so long

POLL_S: Final = 0.02


class ZenohOutlet:
    """A session that publishes samples, from its beginning to ``close``.

    Where it is said where to listen, and nowhere to connect, it is a network of its own: who connects there shall
    not see live robots beside those of the log.

    Args:
        root: the beginning of every key.
        waits: a subscriber that is too slow holds the replay up, instead of losing samples.

    Attributes:
        listen: where others are to connect; empty if nothing is said of it.
        sent: samples that Zenoh took; ``failed`` those that it did not.
        was_alone: for a while nobody was connected.
    """

    def __init__(self, settings: ZenohSettings, root: str, *, waits: bool) -> None:
        self.sent = self.failed = 0
        self.was_alone = False
        self._root = root
        self._congestion = zenoh.CongestionControl.BLOCK if waits else zenoh.CongestionControl.DROP
        _, connect, self.listen, _ = said_of(settings)
        if self.listen and not connect:
            # It connects to nobody of itself, and tells no node that connects to it of another.
            self._session = open_session(settings, [], self.listen, changes={GOSSIP: False})
        else:
            self._session = join(settings, self.listen or local_port(settings))
        self._publishers: dict[str, zenoh.Publisher] = {}
        self._gateways: set[str] = set()
        self._tokens: Any = self._session.liveliness().declare_subscriber(
            keys.ANY_TOKEN, zenoh.handlers.RingChannel(TOKENS_WAITING), history=True
        )

    def wait_for_link(self, timeout_s: float, stopped: Callable[[], bool]) -> bool:
        """Wait until somebody is connected. False if nobody is in time."""
        # Zenoh lists no clients; that one of them subscribes is all that is known of it.
        return self._wait(lambda probe: is_connected(self._session) or _matches(probe), timeout_s, stopped)

    def wait_for_subscriber(self, timeout_s: float | None, stopped: Callable[[], bool]) -> bool:
        """Wait for somebody who wants what will be published, as long as need be if the time is None."""
        return self._wait(_matches, timeout_s, stopped)

    def _wait(
        self, is_there: Callable[[zenoh.Publisher], bool], timeout_s: float | None, stopped: Callable[[], bool]
    ) -> bool:
        end_s = None if timeout_s is None else time.monotonic() + timeout_s
        probe = self._session.declare_publisher(f"{self._root}/**")
        try:
            while not is_there(probe):
                if stopped() or (end_s is not None and time.monotonic() >= end_s):
                    return False
                time.sleep(POLL_S)
            return True
        finally:
            probe.undeclare()

    def find_gateway(self) -> CommandError | None:
        """Ask for gateways. The refusal if there is one under the root."""
        for reply in self._session.liveliness().get(keys.ANY_TOKEN, timeout=TOKEN_TIMEOUT_S):
            if reply.ok is not None:
                self._gateways.add(str(reply.ok.key_expr))
        return self._refusal()

    def send(self, item: ReplaySample, shift_ns: int) -> None:
        try:
            if item.is_delete:
                self._session.delete(item.key, congestion_control=self._congestion)
            elif item.subject is None:
                self._session.put(
                    item.key,
                    item.raw,
                    encoding=item.encoding,
                    congestion_control=self._congestion,
                    attachment=item.attachment or None,
                )
            else:
                publisher = self._publishers.get(item.key) or self._declare(item.key, item.subject)
                publisher.put(item.payload(shift_ns))
        except (zenoh.ZError, ValueError) as error:
            self.failed += 1
            log.debug("Zenoh did not take a sample of %s: %s", item.key, error)
        else:
            self.sent += 1

    def attend(self) -> CommandError | None:
        """Look out for gateways. Why the replay must end, if one has come."""
        while (token := self._tokens.try_recv()) is not None:
            key = str(token.key_expr)
            if token.kind == zenoh.SampleKind.PUT:
                self._gateways.add(key)
            else:
                self._gateways.discard(key)
        self.was_alone = self.was_alone or not is_connected(self._session)
        return self._refusal()

    def close(self) -> None:
        close_session(self._session)

    def _declare(self, key: str, subject: Subject) -> zenoh.Publisher:
        publisher = self._publishers[key] = self._session.declare_publisher(
            key,
            encoding=subject.encoding,
            congestion_control=self._congestion,
            priority=getattr(zenoh.Priority, subject.qos.priority.value),
            express=subject.qos.express,
        )
        return publisher

    def _refusal(self) -> CommandError | None:
        for key in sorted(self._gateways):
            # ROOT/ROBOT/gateway
            if overlap(key.rsplit("/", 2)[0], self._root):
                return CommandError(
                    f"the gateway of a robot is connected under this root, {key}: what is replayed would be taken "
                    "for that robot; choose another --root",
                    ExitCode.REFUSED,
                )
        return None


def _matches(publisher: zenoh.Publisher) -> bool:
    # The package's own annotation says that it is a bool.
    status = publisher.matching_status
    return bool(getattr(status, "matching", status))
