"""A recording, without I/O: samples and ticks in, effects out.

``receive_sample`` finds the sample's route by its key, decodes it, and appends protobuf records to the chunk in
hand; what fits no subject is kept whole. ``tick`` hands the chunk over before ``flush_ns`` of the log are at
risk, and ends a file that is long enough; the next sample begins the next one. The caller carries the effects
out, in order, and has each file repeat the channels of those before it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import msgspec

from recorder.encoding.fast_path import FastPath
from recorder.encoding.foxglove_log import log_record
from recorder.encoding.key_counters import SEQUENCE_SPAN
from recorder.encoding.routes import Record, Route, keep_raw
from recorder.encoding.sample import Sample
from recorder.mcap.chunk import ChunkBuilder, log_time
from recorder.record.backlog import Backlog
from recorder.record.channels import Channels, Room
from recorder.record.completeness import Account
from recorder.record.effects import (
    Alarm,
    CloseLog,
    Effect,
    OpenLog,
    SyncLog,
    WriteChunk,
    WriteMetadata,
)
from recorder.record.robots import Robots
from recorder.record.unsaid import Unsaid
from schemas import keys
from schemas.decisions import EventKind, SafetyEvent, Severity
from schemas.messages import CanFrames, GatewayHealth, GatewayInfo, Message
from schemas.printable import short
from schemas.recording import GapReason, RecorderEvent
from schemas.subjects import BY_DBC_MESSAGE, BY_TYPE

INFO_MAX_BYTES: Final = 1_000_000
"""A gateway's answer that is larger is recorded like any sample, but not kept for every further file."""

ROLL_MIN_NS: Final = 1_000_000_000
"""A file is not ended for its size sooner: what each repeats may already be as large as that. Nor is one ended so
soon after another, however often that is asked for."""

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
        self.is_awaited = False
        """The disk has not begun the file yet, says the caller: it is not ended for the sake of another."""
        self._opened_ns = self._heard_ns = 0
        self._rolled_ns: int | None = None
        self._roll_wanted = ""
        """Why the file is to be ended as soon as may be."""
        self._ended_by = ""
        self.account = Account()
        self.ended_ticks: dict[str, int] = {}
        """When gateways were told to end, by the key of their events."""
        self._unsaid = Unsaid()
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
        if self.is_open and (reason := self._why_roll(now_ns, file_bytes)):
            effects += self.roll(reason, now_ns)
        return effects

    def roll(self, reason: str, now_ns: int) -> Sequence[Effect]:
        """End the file; the next sample begins another. Nothing if none is open.

        However often that is asked for, files do not become many: what comes too soon waits, and is one then.
        """
        if not self.is_open:
            return self.close()
        if self.is_awaited or (self._rolled_ns is not None and now_ns - self._rolled_ns < ROLL_MIN_NS):
            self._roll_wanted = reason
            return []
        self._rolled_ns, self._ended_by = now_ns, reason
        return self.close()

    def pause(self, reason: str) -> Sequence[Effect]:
        """End the file, and begin none until ``resume``."""
        if self.is_open:
            self._ended_by = reason
        self.is_paused = True
        return self.close()

    def resume(self) -> Sequence[Effect]:
        """The next sample begins a file; what came before it is handed over, to the ring."""
        self.is_paused = False
        return self.seal()

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
            self._unsaid.add(topic, message)
            return []
        effects: list[Effect] = []
        route = self.channels.declare(topic, BY_TYPE[type(message)], "", effects, Room.OWN)
        self._add_records(route, message, log_time(message.time_ns), effects)
        if isinstance(message, RecorderEvent):
            self._add_line(topic, message, log_time(message.time_ns), effects, Room.OWN)
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
        self.is_open = self.is_awaited = False
        self._roll_wanted = ""
        self._at_risk_since_ns = None
        effects += self._robots.describe()
        told = self.account.of_file(self.channels.counts)
        completeness = {topic: msgspec.json.encode(report).decode() for topic, report in told.items()}
        return [*effects, WriteMetadata(COMPLETENESS_NAME, completeness), CloseLog()]

    def _why_roll(self, now_ns: int, file_bytes: int) -> str:
        """Why the file is to be ended now; empty if it is not."""
        age_ns = now_ns - self._opened_ns
        if 0 < self._plan.idle_ns <= now_ns - self._heard_ns:
            return "silence"
        if 0 < self._plan.rotate_bytes <= file_bytes and age_ns >= ROLL_MIN_NS:
            return "size"
        if 0 < self._plan.rotate_ns <= age_ns:
            return "time"
        return self._roll_wanted

    def _open(self, now_ns: int, log_ns: int, effects: list[Effect]) -> None:
        self.is_open = True
        self._file += 1
        self._opened_ns = self._heard_ns = now_ns
        effects.append(OpenLog(self._plan.name, log_ns))
        effects += self._robots.describe()
        if self._file > 1:
            effects.append(WriteMetadata(CONTINUED_NAME, {"file": str(self._file), "because": self._ended_by}))
            effects.append(WriteMetadata(LATEST_NAME, self.channels.latest))
        for topic, message in self._unsaid.take():
            effects += self.add_own(topic, message, now_ns)

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
        self._add_records(route, message, log_ns, effects)

    def _add_records(self, route: Route, message: Message, log_ns: int, effects: list[Effect]) -> None:
        self._add(route, message.sequence, log_ns, route.transcode(message), effects)

    def _add(
        self, route: Route, sequence: int, log_ns: int, records: Sequence[Record], effects: list[Effect]
    ) -> None:
        """Append the records of a sample. A chunk is handed over as soon as it is full: many more may follow."""
        for publish_ns, data in records:
            if self._chunk.is_full:
                self._seal(effects)
            self._chunk.add(route.channel_id, sequence, log_ns, publish_ns, data)
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
            if message.kind is EventKind.GATEWAY:
                self.ended_ticks[sample.key] = message.tick
            # What was asked for later is long past.
            is_alarm = message.kind in self._plan.alarms and message.severity is not Severity.INFO
            if is_alarm and not sample.is_reply:
                effects.append(Alarm(short(f"{message.kind.value}: {message.text}"), log_ns))

    def _add_line(
        self,
        key: str,
        event: SafetyEvent | RecorderEvent,
        log_ns: int,
        effects: list[Effect],
        room: Room = Room.TABLE,
    ) -> None:
        """The event once more, as viewers list them."""
        route = self.channels.declare_line(key, effects, room)
        if route is None:
            return
        parts = keys.parse(key)
        name = (parts.robot or parts.recorder) if parts else key
        self._add(route, event.sequence, log_ns, [(event.time_ns, log_record(event, name))], effects)

    def _count_bus(self, key: str, health: GatewayHealth) -> None:
        parts = keys.parse(key)
        # Each name once: somebody may send a hundred thousand.
        for name, lost in {frame.name: frame.lost for frame in health.feedback}.items():
            subject = BY_DBC_MESSAGE.get(name)
            if parts is not None and subject is not None:
                of_frame = self.channels.get(keys.build(parts.root, parts.robot, subject))
                if of_frame is not None:
                    of_frame.tally.count_bus(lost)

    def _add_raw(self, sample: Sample, reason: str, route: Route, log_ns: int, effects: list[Effect]) -> None:
        if route.subject is not None:
            route = self.channels.declare_raw(sample.key, effects)
        time_ns = log_time(sample.zenoh_time_ns)
        source, sequence = sample.source or ("", 0)
        if source and route.subject is None:
            route.tally.count_source(source, sequence)
        # Without a time of the source's, the receipt's is the best there is.
        records = [(time_ns or log_ns, keep_raw(sample, reason, time_ns))]
        self._add(route, sequence % SEQUENCE_SPAN, log_ns, records, effects)

    def _find_route(self, key: str, now_ns: int, effects: list[Effect]) -> Route:
        parts = keys.parse(key)
        if parts is None:
            return self.channels.declare(key, None, "", effects)
        if not parts.robot:
            return self.channels.declare(key, parts.subject, "", effects)
        robot = self._robots.see(parts.root, parts.robot, now_ns)
        self._backlog.see(parts.root, parts.robot, now_ns)
        room = Room.TABLE if self._robots.has_room(robot, parts.bus) else Room.OTHER
        return self.channels.declare(key, parts.subject, robot, effects, room)

    def _seal(self, effects: list[Effect]) -> None:
        chunk = self._chunk.seal()
        if chunk is not None:
            effects.append(WriteChunk(chunk))
