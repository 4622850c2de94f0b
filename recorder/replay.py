"""Replay of a log on Zenoh, as the samples that it was made from.

Records become their typed messages and MessagePack payloads, a RawSample its original payload, frames of one batch
a batch. Foreign channels and event lines never were samples, and are skipped. All due times are relative to one
anchor, so that errors do not add up. Memory is bounded.

A replay declares no liveliness token and no queryable, and publishes nothing under the root of a connected
gateway.
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

REMEMBERED: Final = 200_000  # rows compared with those of other files, about four minutes; twice as many are held


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
            # Each file has its own topics; duplicates within one file are real.
            continue
        yield row


def runs(rows: Iterable[Row]) -> Iterator[list[Row]]:
    """Each row alone, but the raw frames of a batch together, at the place of the first."""
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


DEFAULT_ROOT: Final = "replay"
_PLAIN: Final = re.compile(r"[^/*$?#]+(/[^/*$?#]+)*")  # a key without wildcards
_LAST_NS: Final = 2**63 - 1
ENCODING_BYTES_MAX: Final = 255  # a longer encoding makes Zenoh's session panic, and stop sending
DELETED: Final = "deleted"  # the recorder's reason for a RawSample that deletes its key
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
    """A sample to publish.

    Attributes:
        time_ns: its due time, in the log's time.
        subject: its row in the table of subjects; None if it has none.
        message: its content; None of a RawSample, which has ``raw`` and ``attachment``.
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
        """The payload, with its times shifted; a RawSample's is unchanged."""
        if self.message is None:
            return self.raw
        return codec.encode(shifted(self.message, shift_ns) if shift_ns else self.message)


def shifted(message: Message, shift_ns: int) -> Message:
    """The message with its ``time_ns`` and those of its frames shifted."""

    def later(time_ns: int) -> int:
        return min(max(0, time_ns + shift_ns), _LAST_NS)

    changes: dict[str, Any] = {"time_ns": later(message.time_ns)}
    if isinstance(message, CanFrames):
        changes["frame_time_ns"] = list(map(later, message.frame_time_ns))
    return msgspec.structs.replace(message, **changes)


class KeyMap:
    """From the key in the log to the one under the replay's root; None if it must not be published.

    The log's root is replaced. If the log has several, each stays, behind the new one, to keep robots of the same
    name apart.
    """

    def __init__(self, root: str, log_roots: Sequence[str]) -> None:
        self._root = root
        self._replaced = f"{log_roots[0]}/" if len(log_roots) == 1 else ""

    def __call__(self, key: str) -> str | None:
        if _PLAIN.fullmatch(key) is None or COMMAND_CHUNK in key.split("/"):
            return None
        return f"{self._root}/{key.removeprefix(self._replaced)}"


def roots_of(topics: Iterable[Topic]) -> list[str]:
    """The roots of the robots and recorders in topics."""
    ours = [keys.parse(topic.name) for topic in topics if topic.kind not in {None, RawSample}]
    return sorted({parts.root for parts in ours if parts is not None})


def overlap(one: str, other: str) -> bool:
    """Report whether one of two roots equals or contains the other."""
    shorter, longer = sorted((f"{one}/", f"{other}/"), key=len)
    return longer.startswith(shorter)


def may_hold(topic: Topic, wants: Wants) -> bool:
    if topic.kind is RawSample:
        # The samples have their own keys; only the topic of undecodable samples of a known key names it.
        key = topic.name.removesuffix(f"/{RAW_CHUNK}")
        return key == topic.name or wants(key)
    return _subject_of(topic) is not None and wants(topic.name)


class Samples:
    """Makes samples of runs of rows.

    Attributes:
        withheld: number of samples not to be published: commands, wildcard keys, too long encodings.
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
    """The subject of a topic; None if key and schema do not match, or are foreign."""
    parts = keys.parse(topic.name)
    if parts is None:
        return None
    recorded = CanFrame if parts.subject.type is CanFrames else parts.subject.type
    return parts.subject if topic.kind is recorded else None


AS_FAST_AS_POSSIBLE: Final = 0.0  # a speed
FOR_EVER: Final = 0  # a number of loops
LONGEST_PAUSE_NS: Final = 60_000_000_000  # a longer pause of the log is cut to this
SET_BACK_NS: Final = 1_000_000_000  # a greater step back of the log's time means that the clock was set back
SLIP_NS: Final = 1_000_000_000  # after a longer standstill (Ctrl-Z, sleep) the replay resumes without a burst
ATTEND_NS: Final = 20_000_000  # period of the outlet's ``attend``


class Pace:
    """From the log's time to the clock's. Due times never step back. ``cut`` counts shortened pauses."""

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
        """Delay all further due times."""
        self._anchor_ns += duration_ns

    def due_ns(self, time_ns: int) -> int:
        """The due time of a log time. To be called once for each item, in order."""
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
        """Send a sample with shifted time stamps. Never raises."""

    def attend(self) -> CommandError | None:
        """Do regular checks. Returns the reason to end the replay, if any."""


class Played(msgspec.Struct):
    """The course of a replay.

    Attributes:
        loops: number of starts.
        late_ns: the greatest lateness of a sample, if it is paced.
        slipped_ns: the total delay; see SLIP_NS.
        has_ended: it reached the end.
        halt: why it had to stop.
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
    """Play to the end, or until stopped. ``is_now`` shifts the time stamps to the present."""
    played = Played()
    epoch_ns = time.time_ns() - time.monotonic_ns()
    attend_ns = due_ns = 0
    while loops == FOR_EVER or played.loops < loops:
        items = read()
        item = next(items, None)
        if item is None:
            break
        # Reading the beginning is no lateness. Lateness does not delay the next round.
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
TOKEN_TIMEOUT_S: Final = 1.0  # of the search for gateways at the start
POLL_S: Final = 0.02


class ZenohOutlet:
    """A session that publishes samples until ``close``.

    With endpoints to listen on and none to connect to, it is a separate network: its viewers must not see live
    robots.

    Args:
        root: the beginning of every key.
        waits: a slow subscriber delays the replay, instead of losing samples.

    Attributes:
        sent, failed: samples that Zenoh accepted, and that it did not.
        was_alone: at times no node was connected.
    """

    def __init__(self, settings: ZenohSettings, root: str, *, waits: bool) -> None:
        self.sent = self.failed = 0
        self.was_alone = False
        self._root = root
        self._congestion = zenoh.CongestionControl.BLOCK if waits else zenoh.CongestionControl.DROP
        _, connect, self.listen, _ = said_of(settings)
        if self.listen and not connect:
            # It connects to no node, and does not introduce its nodes to each other.
            self._session = open_session(settings, [], self.listen, changes={GOSSIP: False})
        else:
            self._session = join(settings, self.listen or local_port(settings))
        self._publishers: dict[str, zenoh.Publisher] = {}
        self._gateways: set[str] = set()
        self._tokens: Any = self._session.liveliness().declare_subscriber(
            keys.ANY_TOKEN, zenoh.handlers.RingChannel(TOKENS_WAITING), history=True
        )

    def wait_for_link(self, timeout_s: float, stopped: Callable[[], bool]) -> bool:
        """Wait for a connected node. False after the timeout."""
        # Zenoh does not list clients: only their subscriptions show.
        return self._wait(lambda probe: is_connected(self._session) or _matches(probe), timeout_s, stopped)

    def wait_for_subscriber(self, timeout_s: float | None, stopped: Callable[[], bool]) -> bool:
        """Wait for a subscriber; without a timeout if it is None."""
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
        """Search for gateways. Returns the refusal if there is one under the root."""
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
            log.debug("cannot publish a sample of %s: %s", item.key, error)
        else:
            self.sent += 1

    def attend(self) -> CommandError | None:
        """Check for gateways. Returns the reason to end the replay, if one has connected."""
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
                    f"a gateway is connected under this root, {key}: the replay would be mistaken for that robot; "
                    "choose another --root",
                    ExitCode.REFUSED,
                )
        return None


def _matches(publisher: zenoh.Publisher) -> bool:
    # The package annotates it as a bool.
    status = publisher.matching_status
    return bool(getattr(status, "matching", status))
