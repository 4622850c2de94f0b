"""A log published again: its rows as samples, and their times.

Plays a log: waits until the next message is due, and hands it to the outlet.

The rows of logs as they are replayed: each once, frames of a batch together, by a chosen time. Pure.

Memory is bounded, however long the logs are.

Turns the rows of a log into the Zenoh samples that it was made from. Pure.

A record of ours becomes its typed message and that its MessagePack payload, a RawSample the payload that it kept,
frames of one batch a batch. What never was a Zenoh sample (other makers' channels, lines for viewers) is passed
over.

Schedules the contents of a log again. Pure: the time is an argument, and what is due comes out.

Every due time is counted from one anchor, so that nothing adds up: a replay of ten hours is as long as the log.

Publishes a log's samples again on Zenoh: no liveliness token, no queryable, nothing that a live robot has.

While it is open it looks out for gateways. Where one is connected under the same root nothing is published.
"""

from __future__ import annotations

import logging
import re
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from enum import Enum
from heapq import heappop, heappush
from typing import Any, Final, Protocol

import msgspec
import zenoh

from recorder.encoding.routes import RAW_CHUNK
from recorder.reading.logs import Faults
from recorder.reading.rows import Row
from recorder.reading.topics import UNREADABLE, Topic
from schemas import codec, keys
from schemas.can_word import BITRATE_SWITCH, ERROR, ERROR_STATE_INDICATOR, EXTENDED, FD, REMOTE
from schemas.command_line import CommandError, ExitCode
from schemas.messages import CanFrame, CanFrames, Message, RawSample
from schemas.settings import BATCH_MAX_FRAMES, ZenohSettings
from schemas.subjects import COMMAND_CHUNK, Subject
from schemas.zenoh_session import GOSSIP, close_session, is_connected, join, local_port, open_session, said_of

REMEMBERED: Final = 200_000
"""Rows that are compared with those of other files: some four minutes of a robot. Twice as many are held."""

HORIZON_NS: Final = 2_000_000_000
"""A row that reached the recorder so much later than others is not sorted in among them any more."""

SORTED_MAX: Final = 100_000
"""Rows that are held for sorting, whatever their times say."""


class By(Enum):
    """The time that decides when a message is replayed: the recorder's receipt, or the source's own."""

    LOG = "log"
    PUBLISH = "publish"


class ReplayRun(msgspec.Struct, frozen=True, gc=False):
    """One message of a log; of raw frames all that came in one batch.

    Attributes:
        time_ns: when it is due, in the log's time.
    """

    time_ns: int
    topic: Topic
    rows: list[Row]


def once(rows: Iterable[Row], remembered: int = REMEMBERED) -> Iterator[Row]:
    """The rows without those that another file repeats: an incident, another recorder's log."""
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


def runs(rows: Iterable[Row], by: By) -> Iterator[ReplayRun]:
    """The runs, each at the place of its first row."""
    pending: dict[Topic, list[Row]] = {}
    log_ns = -1
    for row in rows:
        if pending and row.log_ns != log_ns:
            yield from _released(pending, by)
        log_ns = row.log_ns
        topic = row.topic
        if topic.kind is not CanFrame:
            yield ReplayRun(_time_ns(row, by), topic, [row])
            continue
        batch = pending.get(topic)
        if batch and (batch[0].sequence != row.sequence or len(batch) >= BATCH_MAX_FRAMES):
            yield _run(batch, by)
            batch = None
        if batch is None:
            pending[topic] = [row]
        else:
            batch.append(row)
    yield from _released(pending, by)


def in_order(
    found: Iterable[ReplayRun], horizon_ns: int = HORIZON_NS, limit: int = SORTED_MAX
) -> Iterator[ReplayRun]:
    """The runs sorted by their times, as far as they are not more than the horizon out of it."""
    waiting: list[tuple[int, int, ReplayRun]] = []
    for number, run in enumerate(found):
        heappush(waiting, (run.time_ns, number, run))
        while waiting[0][2].rows[0].log_ns + horizon_ns <= run.rows[0].log_ns or len(waiting) > limit:
            yield heappop(waiting)[2]
    while waiting:
        yield heappop(waiting)[2]


def _released(pending: dict[Topic, list[Row]], by: By) -> Iterator[ReplayRun]:
    for batch in pending.values():
        yield _run(batch, by)
    pending.clear()


def _run(batch: list[Row], by: By) -> ReplayRun:
    # A batch was published when its last frame had come.
    return ReplayRun(max(_time_ns(row, by) for row in batch), batch[0].topic, batch)


def _time_ns(row: Row, by: By) -> int:
    return row.log_ns if by is By.LOG else row.publish_ns


DEFAULT_ROOT: Final = "replay"
"""The root of a replay, which nobody takes for a robot's."""

_PLAIN: Final = re.compile(r"[^/*$?#]+(/[^/*$?#]+)*")
"""A key that names one thing: a log may hold anything, and a wildcard would reach many."""

_RAW_ENDING: Final = f"/{RAW_CHUNK}"
_LAST_NS: Final = 2**63 - 1

ENCODING_BYTES_MAX: Final = 255
"""Zenoh takes no longer encoding: its session panics over one, and sends nothing from then on."""

DELETED: Final = "deleted"
"""The reason with which the recorder keeps a sample that deletes its key."""

Wants = Callable[[str], bool]
"""Reports whether a key of the log is wanted."""


class ReplaySample(msgspec.Struct, frozen=True):
    """A sample to be published again.

    Attributes:
        time_ns: when it is due, in the log's time.
        key: its destination.
        encoding: Zenoh's, with the schema.
        subject: its row in the table of subjects; None if it has none.
        message: its content; None of a sample that was kept as it was.
        raw: the payload of such a sample.
        attachment: likewise; empty if there was none.
        is_delete: it says that the key was deleted.
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

    Args:
        root: the destination.
        log_roots: the roots of the robots in the log.
    """

    def __init__(self, root: str, log_roots: Sequence[str]) -> None:
        self._root = root
        self._replaced = f"{log_roots[0]}/" if len(log_roots) == 1 else ""

    def __call__(self, key: str) -> str | None:
        """The new key. None if nothing may be published there: a command, or a key that reaches many."""
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


def root_of_token(key: str) -> str:
    """The root of the gateway whose liveliness token this is."""
    return key.rsplit("/", 2)[0]


def may_hold(topic: Topic, wants: Wants) -> bool:
    """Report whether samples of wanted keys may be in a topic."""
    if topic.kind is RawSample:
        # Its samples tell their keys; only of a broken one of a known key the topic does too.
        key = topic.name.removesuffix(_RAW_ENDING)
        return key == topic.name or wants(key)
    return _subject_of(topic) is not None and wants(topic.name)


class Samples:
    """Makes samples of runs of rows.

    Args:
        new_key: from the key in the log to the new one.
        wants: a test of keys in the log.
        faults: takes what cannot be decoded.

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

    def of(self, runs: Iterable[ReplayRun]) -> Iterator[ReplaySample]:
        """The samples, in the order of the runs."""
        for run in runs:
            try:
                sample = self._sample(run)
            except UNREADABLE as error:
                self._faults.add(f"{run.topic.name}: a message cannot be decoded: {error}")
                continue
            if sample is not None:
                yield sample

    def _sample(self, run: ReplayRun) -> ReplaySample | None:
        topic = run.topic
        decode = topic.decode
        if decode is None:
            return None
        if topic.kind is RawSample:
            return self._raw(run.time_ns, decode(run.rows[0].data))
        known = self._known.get(topic)
        if known is None:
            known = self._known[topic] = (self._new_key(topic.name), _subject_of(topic))
        key, subject = known
        if key is None or subject is None:
            self.withheld += key is None
            return None
        if topic.kind is CanFrame:
            message = batch([decode(row.data) for row in run.rows], run.rows[0].sequence)
        else:
            message = decode(run.rows[0].data)
        return ReplaySample(run.time_ns, key, subject.encoding, subject, message)

    def _raw(self, time_ns: int, raw: RawSample) -> ReplaySample | None:
        if not self._wants(raw.key):
            return None
        key = self._new_key(raw.key)
        if key is None or len(raw.encoding.encode()) > ENCODING_BYTES_MAX:
            self.withheld += 1
            return None
        return ReplaySample(
            time_ns,
            key,
            raw.encoding,
            raw=raw.payload,
            attachment=raw.attachment,
            is_delete=raw.reason == DELETED,
        )


def batch(frames: Sequence[CanFrame], sequence: int) -> CanFrames:
    """Frames of a log as the batch that they came in. Of that the log keeps neither ``dropped`` nor the time."""
    return CanFrames(
        time_ns=max(frame.time_ns for frame in frames),
        sequence=sequence,
        bus=frames[0].bus,
        dropped=0,
        frame_time_ns=[frame.time_ns for frame in frames],
        can_id=[word_of(frame) for frame in frames],
        fd_flags=[fd_flags_of(frame) for frame in frames],
        length=[frame.dlc for frame in frames],
        data=[frame.data for frame in frames],
    )


def word_of(frame: CanFrame) -> int:
    """Identifier and kind of a frame in one word."""
    return (
        frame.identifier
        | (EXTENDED if frame.is_extended else 0)
        | (REMOTE if frame.is_remote else 0)
        | (ERROR if frame.is_error else 0)
    )


def fd_flags_of(frame: CanFrame) -> int:
    """CAN FD's flags of a frame."""
    return (
        (FD if frame.is_fd else 0)
        | (BITRATE_SWITCH if frame.bitrate_switch else 0)
        | (ERROR_STATE_INDICATOR if frame.error_state_indicator else 0)
    )


def _subject_of(topic: Topic) -> Subject | None:
    """The row of the table that a topic's messages are of; None if key and schema do not fit, or are not ours."""
    parts = keys.parse(topic.name)
    if parts is None:
        return None
    recorded = CanFrame if parts.subject.type is CanFrames else parts.subject.type
    return parts.subject if topic.kind is recorded else None


AS_FAST_AS_POSSIBLE: Final = 0.0
"""The speed that waits for nothing."""

FOR_EVER: Final = 0
"""The number of loops that never ends."""

SET_BACK_NS: Final = 1_000_000_000
"""A message that is further behind in the log's time is late, or the clock was set back."""

SET_BACK_AFTER: Final = 100
"""Messages in a row that are further behind before the clock counts as set back."""

SLIP_NS: Final = 1_000_000_000
"""A process that stood still for longer (Ctrl-Z, a machine that slept) resumes from there, without a burst."""

_BUCKET_NS: Final = 100_000
_LAST_BUCKET: Final = 20_000


class Pace:
    """From the log's time to the clock's. Due times never step back.

    Args:
        speed: so many times as fast as recorded; AS_FAST_AS_POSSIBLE makes everything due at once.
        longest_pause_ns: a pause of the log that is longer is cut to this, of the log's time.

    Attributes:
        cut: pauses that were cut.
    """

    def __init__(self, speed: float, longest_pause_ns: int) -> None:
        self._speed = speed
        self._longest_pause_ns = longest_pause_ns
        self._anchor_ns = self._anchor_time_ns = self._latest_ns = 0
        self._is_anchored = False
        self._behind = 0
        self.cut = 0

    @property
    def is_paced(self) -> bool:
        """True if anything has a due time at all."""
        return self._speed > 0

    def start(self, now_ns: int) -> None:
        """Make the next item due now."""
        self._anchor_ns = now_ns
        self._is_anchored = False

    def delay(self, duration_ns: int) -> None:
        """All that is not due yet is due so much later."""
        self._anchor_ns += duration_ns

    def due_ns(self, time_ns: int) -> int:
        """Return the due time of a log time. To be called in the order of the log, once for each item."""
        if not self._is_anchored:
            self._is_anchored = True
            self._anchor_time_ns = self._latest_ns = time_ns
        self._behind = self._behind + 1 if time_ns < self._latest_ns - SET_BACK_NS else 0
        if self._behind > SET_BACK_AFTER:
            self._behind = 0
            self._anchor_time_ns += time_ns - self._latest_ns
            self._latest_ns = time_ns
        pause_ns = time_ns - self._latest_ns
        if pause_ns > self._longest_pause_ns:
            self._anchor_time_ns += pause_ns - self._longest_pause_ns
            self.cut += 1
        self._latest_ns = max(self._latest_ns, time_ns)
        if not self.is_paced:
            return self._anchor_ns
        return self._anchor_ns + round((self._latest_ns - self._anchor_time_ns) / self._speed)


class Lateness:
    """The lateness of items, in buckets of 0.1 ms; the last one holds all that is later than 2 s."""

    def __init__(self) -> None:
        self._buckets: Counter[int] = Counter()
        self.max_ns = 0

    def add(self, late_ns: int) -> None:
        """One that was so late."""
        late_ns = max(0, late_ns)
        self._buckets[min(late_ns // _BUCKET_NS, _LAST_BUCKET)] += 1
        self.max_ns = max(self.max_ns, late_ns)

    def quantile_ns(self, part: float) -> int:
        """This part of them was no later; 0 if there were none."""
        left = part * self._buckets.total()
        for number in sorted(self._buckets):
            left -= self._buckets[number]
            if left <= 0:
                return self.max_ns if number == _LAST_BUCKET else min((number + 1) * _BUCKET_NS, self.max_ns)
        return 0


class Due(msgspec.Struct, frozen=True, gc=False):
    """A sample that is due, and its due time."""

    item: ReplaySample
    due_ns: int


class ReplayScheduler:
    """Plays what a log holds, once or several times.

    Args:
        read: returns the samples from the beginning on.
        pace: when it is due.
        loops: number of times; FOR_EVER does not end.

    Attributes:
        pace: as it was given.
        lateness: of what was handed out, if it is paced.
        slipped_ns: by how much the whole has been put off, as it could not keep up: see SLIP_NS.
        loop: the number of the present loop, from 1.
        is_ended: nothing more will come.
    """

    def __init__(self, read: Callable[[], Iterator[ReplaySample]], pace: Pace, loops: int = 1) -> None:
        self._read = read
        self.pace = pace
        self._loops = loops
        self._items: Iterator[ReplaySample] = iter(())
        self._next: Due | None = None
        self._last_due_ns = 0
        self._has_played = False
        self.lateness = Lateness()
        self.slipped_ns = 0
        self.loop = 1
        self.is_ended = False

    @property
    def next_ns(self) -> int | None:
        """The due time of the next sample; None at the end."""
        return None if self._next is None else self._next.due_ns

    def start(self, now_ns: int) -> None:
        """Begin."""
        self._items = self._read()
        self._last_due_ns = now_ns
        self.pace.start(now_ns)
        self._advance()

    def take(self, now_ns: int) -> Due | None:
        """The next one, if it is due."""
        due = self._next
        if due is None or due.due_ns > now_ns:
            return None
        if self.pace.is_paced:
            late_ns = now_ns - due.due_ns
            self.lateness.add(late_ns)
            if late_ns > SLIP_NS:
                due = Due(due.item, now_ns)
                self.pace.delay(late_ns)
                self.slipped_ns += late_ns
        self._last_due_ns = due.due_ns
        self._has_played = True
        self._advance()
        return due

    def hold(self, duration_ns: int) -> None:
        """All that is not due yet is due so much later."""
        self.pace.delay(duration_ns)
        if self._next is not None:
            self._next = Due(self._next.item, self._next.due_ns + duration_ns)

    def _advance(self) -> None:
        item = next(self._items, None)
        if item is None and self._has_played and (self._loops == FOR_EVER or self.loop < self._loops):
            self.loop += 1
            self._has_played = False
            self._items = self._read()
            # Not from now on: what was late does not make the next round late too.
            self.pace.start(self._last_due_ns)
            item = next(self._items, None)
        self._next = None if item is None else Due(item, self.pace.due_ns(item.time_ns))
        self.is_ended = item is None


ATTEND_NS: Final = 20_000_000
"""The period in which the outlet is looked after."""

MIN_SLEEP_NS: Final = 1_000
"""Looking after things may have taken until the next look."""


class Halt(msgspec.Struct, frozen=True):
    """The reason for which a replay cannot continue."""

    detail: str
    code: ExitCode


class Outlet(Protocol):
    """The destination of a replay.

    Attributes:
        sent: number of samples that were accepted...
        failed: ...and of those that were not. They are never sent later.
    """

    sent: int
    failed: int

    def send(self, item: ReplaySample, shift_ns: int) -> None:
        """Send one. Its time stamps become so much later. Never raises."""
        ...

    def attend(self) -> Halt | None:
        """Look after what else there is. Returns why it cannot go on."""
        ...

    def close(self) -> None:
        """Give everything back; nothing is sent any more. Never raises."""
        ...


class ReplayClock:
    """The machine's clocks, and waiting."""

    def monotonic_ns(self) -> int:
        """Return the time for due times."""
        return time.monotonic_ns()

    def wall_ns(self) -> int:
        """Return the time since 1970."""
        return time.time_ns()

    def sleep(self, duration_ns: int) -> None:
        """Wait."""
        time.sleep(duration_ns / 1e9)


def play(
    player: ReplayScheduler,
    outlet: Outlet,
    clock: ReplayClock,
    stopped: Callable[[], bool],
    *,
    is_now: bool = False,
) -> Halt | None:
    """Play to the end, or until stopped.

    Args:
        player: plays the log.
        outlet: the destination.
        clock: the time.
        stopped: end it.
        is_now: every time stamp is moved by what lies between the log's time and the present.

    Returns:
        Why it could not go on; None if it reached the end or was stopped.
    """
    epoch_ns = clock.wall_ns() - clock.monotonic_ns()
    attend_ns = clock.monotonic_ns()
    player.start(attend_ns)
    # What it took to find the beginning is no lateness.
    player.hold(clock.monotonic_ns() - attend_ns)
    while not stopped() and not player.is_ended:
        now_ns = clock.monotonic_ns()
        if now_ns >= attend_ns:
            attend_ns = now_ns + ATTEND_NS
            halt = outlet.attend()
            if halt is not None:
                return halt
            now_ns = clock.monotonic_ns()
        due = player.take(now_ns)
        if due is not None:
            present_ns = epoch_ns + (due.due_ns if player.pace.is_paced else now_ns)
            outlet.send(due.item, present_ns - due.item.time_ns if is_now else 0)
            continue
        next_ns = player.next_ns
        clock.sleep(max(MIN_SLEEP_NS, min(attend_ns if next_ns is None else next_ns, attend_ns) - now_ns))
    return outlet.attend()


log = logging.getLogger(__name__)

TOKENS_WAITING: Final = 10_000

TOKEN_TIMEOUT_S: Final = 1.0
"""The start asks for gateways for so long."""

POLL_S: Final = 0.02


def key_checked(text: str) -> str:
    """A key expression, in the form that Zenoh wants.

    Raises:
        CommandError: it is none.
    """
    try:
        return str(zenoh.KeyExpr.autocanonize(text))
    except zenoh.ZError as error:
        raise CommandError(f"{text!a} is no key expression", ExitCode.USAGE) from error


def key_matches(expression: str, topic: str) -> bool:
    """True if a Zenoh key expression matches a topic. False of what is no key expression."""
    try:
        return zenoh.KeyExpr.autocanonize(expression).includes(zenoh.KeyExpr(topic))
    except zenoh.ZError:
        return expression == topic


class ZenohOutlet:
    """A session that publishes samples, from its beginning to ``close``.

    Where it is said where to listen, and nowhere to connect, it is a network of its own: who connects there shall
    not see live robots beside those of the log.

    Args:
        settings: of the session.
        root: the beginning of every key.
        waits: a subscriber that is too slow holds the replay up, instead of losing samples.

    Attributes:
        listen: where others are to connect; empty if nothing is said of it.
        sent: samples that Zenoh took...
        failed: ...and those that it did not.
        was_alone: for a while nobody was connected.

    Raises:
        CommandError: the session cannot be opened.
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

    @property
    def is_connected(self) -> bool:
        """True if any Zenoh node is connected."""
        return is_connected(self._session)

    def wait_for_link(self, timeout_s: float, stopped: Callable[[], bool]) -> bool:
        """Wait until somebody is connected. False if nobody is in time."""
        # Zenoh lists no clients; that one of them subscribes is all that is known of it.
        return self._wait(lambda probe: self.is_connected or _matches(probe), timeout_s, stopped)

    def wait_for_subscriber(self, timeout_s: float | None, stopped: Callable[[], bool]) -> bool:
        """Wait for somebody who wants what will be published: links and declarations take their time.

        Args:
            timeout_s: the longest wait; None waits as long as need be.
            stopped: gives up when it turns true.
        """
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

    def find_gateway(self) -> Halt | None:
        """Ask for gateways. The refusal if there is one under the root."""
        for reply in self._session.liveliness().get(keys.ANY_TOKEN, timeout=TOKEN_TIMEOUT_S):
            if reply.ok is not None:
                self._gateways.add(str(reply.ok.key_expr))
        return self._refusal()

    def send(self, item: ReplaySample, shift_ns: int) -> None:
        """Publish a sample, with the quality of service of its subject. Never raises."""
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

    def attend(self) -> Halt | None:
        """Look out for gateways. Why the replay must end, if one has come."""
        while (token := self._tokens.try_recv()) is not None:
            key = str(token.key_expr)
            if token.kind == zenoh.SampleKind.PUT:
                self._gateways.add(key)
            else:
                self._gateways.discard(key)
        self.was_alone = self.was_alone or not self.is_connected
        return self._refusal()

    def close(self) -> None:
        """Leave Zenoh. Never raises."""
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

    def _refusal(self) -> Halt | None:
        for key in sorted(self._gateways):
            if overlap(root_of_token(key), self._root):
                robot = key.split("/")[-2]
                return Halt(
                    f"the gateway of a robot is connected under this root, {key}: what is replayed would be taken "
                    f"for {robot}; choose another --root",
                    ExitCode.REFUSED,
                )
        return None


def _matches(publisher: zenoh.Publisher) -> bool:
    # The package's own annotation says that it is a bool.
    status = publisher.matching_status
    return bool(getattr(status, "matching", status))
