"""A recording, without I/O: samples and ticks in, effects out.

``receive_sample`` finds the sample's route by its key, decodes it, and appends protobuf records to the chunk in
hand; what fits no subject is kept whole. ``tick`` hands the chunk over before ``flush_ns`` of the log are at
risk, and ends a file that is long enough; the next sample begins the next one. The caller carries the effects
out, in order, and has each file repeat the channels of those before it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Final

import msgspec

from recorder.backlog import Backlog
from recorder.channels import Channels
from recorder.chunk import ChunkBuilder, log_time
from recorder.completeness import KeyReport, since
from recorder.effects import (
    Alarm,
    CloseLog,
    Effect,
    OpenLog,
    SyncLog,
    WriteChunk,
    WriteMetadata,
)
from recorder.fast_path import FastPath
from recorder.foxglove_log import log_record
from recorder.robots import Robots
from recorder.routes import RAW_CHUNK, Route, keep_raw
from recorder.sample import Sample
from recorder.tally import SEQUENCE_SPAN
from schemas import keys
from schemas.decisions import EventKind, SafetyEvent, Severity
from schemas.messages import CanFrames, GatewayHealth, GatewayInfo, Message
from schemas.recording import GapReason, RecorderEvent
from schemas.subjects import BY_DBC_MESSAGE, BY_TYPE

INFO_MAX_BYTES: Final = 1_000_000
"""A gateway's answer that is larger is recorded like any sample, but not kept for every further file."""

UNSAID_MAX: Final = 10_000

ROLL_MIN_NS: Final = 1_000_000_000
"""A file is not ended for its size sooner: what each repeats may already be as large as that."""

COMPLETENESS_NAME: Final = "cruiser.completeness"
"""The metadata record with a ``KeyReport`` of each topic, as JSON: what was received and lost during this file."""

CONTINUED_NAME: Final = "cruiser.continued"
"""The metadata record that says which file of a recording this is, and why the one before it ended."""

LATEST_NAME: Final = "cruiser.latest"
"""The metadata record with the newest state of each topic when this file began, as JSON, with its log time.

No message of a channel: no message may be there twice when the files of a recording are put together.
"""


class Plan(msgspec.Struct, frozen=True):
    """What to record.

    Attributes:
        name: begins the file's name.
        chunk_bytes: a chunk is handed over at this size.
        flush_ns: at most this much of the log is at risk.
        version: the recorder's.
        rotate_bytes: a file that has reached this size is ended...
        rotate_ns: ...and one that was begun so long ago. 0 is never.
        idle_ns: and one in which nothing was written for so long.
        alarms: kinds of safety events that are incidents.
    """

    name: str
    chunk_bytes: int
    flush_ns: int
    version: str
    rotate_bytes: int = 0
    rotate_ns: int = 0
    idle_ns: int = 0
    alarms: frozenset[EventKind] = frozenset()


class Session:
    """One recording."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._chunk = ChunkBuilder(plan.chunk_bytes)
        self.channels = Channels()
        self._robots = Robots(plan.version)
        self._backlog = Backlog()
        self._file = 0
        """Which file of the recording is being written; ``is_open`` if there is one at present."""
        self.is_open = False
        self.is_paused = False
        """No file is written, and none begun; chunks are made all the same, for a ring of them."""
        self._opened_ns = self._heard_ns = 0
        self._ended_by = ""
        self._counted: dict[str, KeyReport] = {}
        """The counts when the file before was ended: what was lost in between is told in the next one."""
        self._unsaid: deque[tuple[str, Message]] = deque(maxlen=UNSAID_MAX)
        """What the recorder had to say while no file was open."""
        self._at_risk_since_ns: int | None = None
        # Half for what comes together, half for the ticks, the write and the sync.
        self._patience_ns = plan.flush_ns // 2

    @property
    def robots(self) -> int:
        """Robots that were heard of."""
        return len(self._robots)

    def has_heard(self, robot: str) -> bool:
        """Whether a sample of this robot has come."""
        return robot in self._robots

    def receive_sample(self, sample: Sample, now_ns: int, wall_ns: int) -> Sequence[Effect]:
        """Record a sample. It may hold anything: nothing in it raises."""
        effects: list[Effect] = []
        log_ns = log_time(wall_ns)
        if not self.is_open and not self.is_paused:
            self._open(now_ns, log_ns, effects)
        route = self.channels.get(sample.key) or self._find_route(sample.key, now_ns, effects)
        message = route.decode(sample)
        if isinstance(message, str):
            self._add_raw(sample, message, route, log_ns, effects)
        else:
            self._add_message(sample, message, route, now_ns, log_ns, effects)
        if self._at_risk_since_ns is None:
            self._at_risk_since_ns = now_ns
            self._heard_ns = now_ns
        if self._chunk.is_full:
            self._seal(effects)
        return effects

    def fast_path(self, key: str) -> FastPath | None:
        """The fast path for the samples of a key while this file is open; see ``fast_path``."""
        route = self.channels.get(key)
        if route is None or not self.is_open:
            return None
        add = route.adder(self._chunk)
        return None if add is None else (route.encoding, add)

    def tick(self, now_ns: int, file_bytes: int = 0) -> Sequence[Effect]:
        """What is due: queries, handing the chunk over to the disk, ending a file of this size."""
        effects = self._robots.ask(now_ns) + self._backlog.ask(now_ns)
        if self._at_risk_since_ns is None and len(self._chunk):
            # What took the fast path since the last tick.
            self._at_risk_since_ns = self._heard_ns = now_ns
        if self._chunk.is_full:
            self._seal(effects)
        since = self._at_risk_since_ns
        if since is not None and now_ns - since >= self._patience_ns:
            self._seal(effects)
            effects.append(SyncLog())
            self._at_risk_since_ns = None
        age_ns = now_ns - self._opened_ns
        if not self.is_open:
            return effects
        if 0 < self._plan.idle_ns <= now_ns - self._heard_ns:
            effects += self.roll("silence")
        elif 0 < self._plan.rotate_bytes <= file_bytes and age_ns >= ROLL_MIN_NS:
            effects += self.roll("size")
        elif 0 < self._plan.rotate_ns <= age_ns:
            effects += self.roll("time")
        return effects

    def roll(self, reason: str) -> Sequence[Effect]:
        """End the file; the next sample begins another. Nothing if none is open."""
        if self.is_open:
            self._ended_by = reason
        return self.close()

    def pause(self, reason: str) -> Sequence[Effect]:
        """End the file, and begin none until ``resume``."""
        effects = self.roll(reason)
        self.is_paused = True
        return effects

    def resume(self, *, counts_anew: bool = False) -> Sequence[Effect]:
        """The next sample begins a file; what came before it is handed over, to the ring.

        Args:
            counts_anew: what came meanwhile is none of the next file's business.
        """
        self.is_paused = False
        effects = self.seal()
        if counts_anew:
            self._counted = self.channels.counts
        return effects

    def describe(self) -> Sequence[Effect]:
        """Say what is known of the robots, unless that has been said."""
        return self._robots.describe()

    def seal(self) -> Sequence[Effect]:
        """Hand over the chunk in hand."""
        effects: list[Effect] = []
        self._seal(effects)
        return effects

    def add_own(self, topic: str, message: Message, now_ns: int) -> Sequence[Effect]:
        """Record something that the recorder itself has to say; while no file is open, in the next one."""
        if not self.is_open:
            self._unsaid.append((topic, message))
            return []
        effects: list[Effect] = []
        route = self.channels.declare(topic, BY_TYPE[type(message)], "", effects, is_own=True)
        self._add_records(route, message, log_time(message.time_ns))
        if isinstance(message, RecorderEvent):
            self._add_line(topic, message, log_time(message.time_ns), effects)
        if self._at_risk_since_ns is None:
            self._at_risk_since_ns = now_ns
        return effects

    def lose(self, key: str, reason: GapReason, count: int, now_ns: int) -> Sequence[Effect]:
        """So many samples of a key were dropped before they came here."""
        effects: list[Effect] = []
        route = self.channels.get(key) or self._find_route(key, now_ns, effects)
        route.tally.lose(reason, count)
        return effects

    def ask_last(self, now_ns: int) -> Sequence[Effect]:
        """What is worth asking once more before ``close``."""
        return self._robots.ask_last() + self._backlog.ask_last(now_ns)

    def close(self) -> Sequence[Effect]:
        """End the file. Nothing at all if nothing was recorded."""
        effects: list[Effect] = []
        self._seal(effects)
        if not self.is_open:
            return effects
        self.is_open = False
        self._at_risk_since_ns = None
        effects += self._robots.describe()
        completeness = WriteMetadata(COMPLETENESS_NAME, self._completeness())
        self._counted = self.channels.counts
        return [*effects, completeness, CloseLog()]

    def _open(self, now_ns: int, log_ns: int, effects: list[Effect]) -> None:
        self.is_open = True
        self._file += 1
        self._opened_ns = self._heard_ns = now_ns
        effects.append(OpenLog(self._plan.name, log_ns))
        effects += self._robots.describe()
        if self._file > 1:
            effects.append(WriteMetadata(CONTINUED_NAME, {"file": str(self._file), "because": self._ended_by}))
            effects.append(WriteMetadata(LATEST_NAME, self.channels.latest))
        while self._unsaid:
            effects += self.add_own(*self._unsaid.popleft(), now_ns)

    def _completeness(self) -> dict[str, str]:
        none = KeyReport()
        return {
            topic: msgspec.json.encode(since(count, self._counted.get(topic, none))).decode()
            for topic, count in self.channels.counts.items()
        }

    def _add_message(
        self, sample: Sample, message: Message, route: Route, now_ns: int, log_ns: int, effects: list[Effect]
    ) -> None:
        if sample.is_reply and route.is_kept:
            was_missing, was_counted = self._backlog.take(sample.key, message.sequence)
            if not was_missing:
                return
            if was_counted:
                route.tally.find()
        elif route.counts_sequence:
            is_restart = not route.tally.count_sequence(message.sequence)
            if is_restart:
                self._robots.see_restart(route.robot, now_ns)
            if route.is_kept:
                self._backlog.hear(sample.key, message.sequence, now_ns, is_restart=is_restart)
        if route.is_watched:
            self._look(sample, message, route, log_ns, effects)
        if route.is_state:
            route.latest.log_ns, route.latest.message = log_ns, message
        self._add_records(route, message, log_ns)

    def _add_records(self, route: Route, message: Message, log_ns: int) -> None:
        records = route.transcode(message)
        for publish_ns, data in records:
            self._chunk.add(route.channel_id, message.sequence, log_ns, publish_ns, data)
        route.tally.samples += 1
        route.tally.messages += len(records)

    def _look(self, sample: Sample, message: Message, route: Route, log_ns: int, effects: list[Effect]) -> None:
        """What a message says to the recorder itself."""
        if isinstance(message, CanFrames):
            route.tally.dropped = max(route.tally.dropped, message.dropped)
        elif isinstance(message, GatewayInfo):
            if len(sample.payload) <= INFO_MAX_BYTES:
                effects += self._robots.take_info(route.robot, message, log_ns)
        elif isinstance(message, GatewayHealth):
            self._count_bus(sample.key, message)
        elif isinstance(message, SafetyEvent):
            self._add_line(sample.key, message, log_ns, effects)
            # What was asked for later is long past.
            is_alarm = message.kind in self._plan.alarms and message.severity is not Severity.INFO
            if is_alarm and not sample.is_reply:
                effects.append(Alarm(f"{message.kind.value}: {message.text}", log_ns))

    def _add_line(
        self, topic: str, event: SafetyEvent | RecorderEvent, log_ns: int, effects: list[Effect]
    ) -> None:
        """The event once more, as viewers list them."""
        route = self.channels.declare_line(topic, effects)
        if route is None:
            return
        parts = keys.parse(topic)
        name = (parts.robot or parts.recorder) if parts else topic
        data = log_record(event, name)
        self._chunk.add(route.channel_id, event.sequence, log_ns, event.time_ns, data)
        route.tally.samples += 1
        route.tally.messages += 1

    def _count_bus(self, key: str, health: GatewayHealth) -> None:
        parts = keys.parse(key)
        for frame in health.feedback:
            subject = BY_DBC_MESSAGE.get(frame.name)
            if parts is not None and subject is not None:
                of_frame = self.channels.get(keys.build(parts.root, parts.robot, subject))
                if of_frame is not None:
                    of_frame.tally.count_bus(frame.lost)

    def _add_raw(self, sample: Sample, reason: str, route: Route, log_ns: int, effects: list[Effect]) -> None:
        if route.subject is not None:
            route = self.channels.declare(f"{sample.key}/{RAW_CHUNK}", None, "", effects)
        time_ns = log_time(sample.zenoh_time_ns)
        source, sequence = sample.source or ("", 0)
        if source and route.subject is None:
            route.tally.count_source(source, sequence)
        # Without a time of the source's, the receipt's is the best there is.
        data = keep_raw(sample, reason, time_ns)
        self._chunk.add(route.channel_id, sequence % SEQUENCE_SPAN, log_ns, time_ns or log_ns, data)
        route.tally.samples += 1
        route.tally.messages += 1

    def _find_route(self, key: str, now_ns: int, effects: list[Effect]) -> Route:
        parts = keys.parse(key)
        if parts is None:
            return self.channels.declare(key, None, "", effects)
        if not parts.robot:
            return self.channels.declare(key, parts.subject, "", effects)
        robot = self._robots.see(parts.root, parts.robot, now_ns)
        self._backlog.see(parts.root, parts.robot, now_ns)
        return self.channels.declare(key, parts.subject, robot, effects)

    def _seal(self, effects: list[Effect]) -> None:
        chunk = self._chunk.seal()
        if chunk is not None:
            effects.append(WriteChunk(chunk))
