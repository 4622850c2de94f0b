"""All that one recorder writes, without I/O: samples, ticks, orders and notices in, what is to be done out.

One log for each robot, or one for all; each is a ``Session``, with a ring of its last seconds and at times an
incident beside it. ``receive_sample`` finds the log by the key. The page to begin with; then ``session``.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from typing import Final

import msgspec
from msgspec import DecodeError

from recorder.completeness import KeyReport, total
from recorder.effects import (
    Alarm,
    AskInfo,
    AskKept,
    CloseLog,
    Doing,
    Effect,
    FileEffect,
    OnLog,
    OpenLog,
    Say,
    SyncLog,
    WriteChunk,
    WriteMetadata,
)
from recorder.fast_path import ShortWay
from recorder.gaps import Gaps
from recorder.incidents import INCIDENT_NAME, IncidentPlan, Incidents
from recorder.notices import (
    FULL,
    ROOM,
    STARTED,
    STOPPED,
    Ended,
    Lost,
    Notice,
    Opened,
    Room,
    Word,
    in_words,
)
from recorder.sample import Sample
from recorder.session import Plan, Session
from recorder.tally import SEQUENCE_SPAN, Tally
from schemas import keys
from schemas.decisions import Severity
from schemas.recorder_settings import OWNED_KEY_LIMIT, ROBOT_LIMIT
from schemas.recording import (
    GapReason,
    RecorderEvent,
    RecorderEventKind,
    RecorderState,
    RecordGap,
)

INCIDENT_MARK: Final = "!"
"""Behind a log's name it is that of its incidents: no robot's name holds it."""

TELL_GAPS_NS: Final = 1_000_000_000
"""Gaps are told once a second."""


class RecordingPlan(msgspec.Struct, frozen=True):
    """What to record.

    Attributes:
        root: the first chunks of the robots' keys.
        recorder: this recorder's name, in its own keys.
        per_robot: a log for each robot; else one for all.
        session: of each log; its name is that of the log for all, and for what is no robot's.
        incident: what an incident's file holds.
        ring_bytes: all rings together.
        sample_max_bytes: larger samples are counted, and no more.
        standby: incidents are written, and no logs until ``start``.
        log_limit: robots beyond it share one log.
    """

    root: str
    recorder: str
    per_robot: bool
    session: Plan
    incident: IncidentPlan
    ring_bytes: int
    sample_max_bytes: int
    standby: bool = False
    log_limit: int = ROBOT_LIMIT


class _Log:
    """One log: its session, its incidents, and which files they are in."""

    def __init__(self, name: str, plan: RecordingPlan) -> None:
        self.name = name
        self.session = Session(msgspec.structs.replace(plan.session, name=name))
        self.incidents = Incidents(name, plan.incident)
        self.is_written = False
        self.short_ways: list[str] = []
        """Keys of it that go the short way, while a file is written."""
        self.file = ""
        """The file that is being written, without its directory; empty if there is none."""
        self.is_incident_told = True
        """Whether the latest incident has been opened, and that was told."""
        self.incident_file = ""
        """The file of the incident that is being written; empty if there is none, or not yet."""
        self.named = ""
        """The incident that the file of the log names."""

    @property
    def incident_name(self) -> str:
        return self.name + INCIDENT_MARK


class Recording:
    """Everything that one recorder writes."""

    def __init__(self, plan: RecordingPlan) -> None:
        self._plan = plan
        self._logs: dict[str, _Log] = {}
        self._by_key: dict[str, _Log] = {}
        self._short_ways: dict[str, ShortWay] = {}
        self._gaps = Gaps()
        self._gaps_told_ns = 0
        self._sequence = 0
        self._doings: list[Doing] = []
        self._is_stopped = plan.standby
        self._has_room = self._has_incident_room = True
        self._left_out: GapReason | None = None
        """Why chunks are not written that are not: None is no loss."""
        self._own = re.compile(rf"{re.escape(plan.root)}/({keys.ROBOT_PATTERN})/.*", re.DOTALL)
        self.incidents = 0
        """Incidents begun."""

    @property
    def state(self) -> RecorderState:
        """What it does."""
        if self._is_stopped:
            return RecorderState.STOPPED
        return RecorderState.RECORDING if self._has_room else RecorderState.FULL

    @property
    def counts(self) -> dict[str, KeyReport]:
        """Per topic, what was received, written and lost."""
        reports = defaultdict(list)
        for log in self._logs.values():
            for topic, report in log.session.counts.items():
                reports[topic].append(report)
        # Few are in several logs: what the recorder itself says, and what is beyond the limits.
        return {topic: found[0] if len(found) == 1 else total(found) for topic, found in reports.items()}

    @property
    def tallies(self) -> Iterable[Tally]:
        """Of every topic."""
        return (tally for log in self._logs.values() for tally in log.session.tallies)

    @property
    def robots(self) -> int:
        """Robots that were heard of."""
        return sum(log.session.robots for log in self._logs.values())

    @property
    def files(self) -> dict[str, str]:
        """The files that are being written, without their directory, by their log; no incidents."""
        return {log.name: log.file for log in self._logs.values() if log.file}

    @property
    def writing(self) -> set[str]:
        """The logs of which a file is being written, whether the disk has begun it yet or not."""
        return {log.name for log in self._logs.values() if log.is_written}

    @property
    def has_incident_room(self) -> bool:
        """Whether the disk may hold more incidents."""
        return self._has_incident_room

    @property
    def ring_bytes(self) -> int:
        """Bytes of the messages in all rings."""
        return sum(log.incidents.ring_bytes for log in self._logs.values())

    def receive(self, samples: Iterable[Sample], now_ns: int) -> Sequence[Doing]:
        """Record samples, each received when it says. They may hold anything: nothing in them raises.

        Nearly all go the short way of their key, see ``fast_path``; the others through ``receive_sample``.
        """
        short_ways, limit_bytes = self._short_ways, self._plan.sample_max_bytes
        doings: list[Doing] = []
        for sample in samples:
            way = short_ways.get(sample.key)
            payload = sample.payload
            if way is not None and way[0] == sample.encoding and len(payload) <= limit_bytes:
                try:
                    if way[1](payload, sample.received_ns):
                        continue
                except DecodeError:
                    pass
            doings += self.receive_sample(sample, now_ns, sample.received_ns)
            self._find_short_way(sample.key)
        return doings

    def receive_sample(self, sample: Sample, now_ns: int, wall_ns: int) -> Sequence[Doing]:
        """Record a sample. It may hold anything: nothing in it raises."""
        log = self._by_key.get(sample.key) or self._find_log(sample.key)
        if len(sample.payload) > self._plan.sample_max_bytes:
            self._drop(log, sample.key, GapReason.SIZE, now_ns, wall_ns)
            return ()
        effects = log.session.receive_sample(sample, now_ns, wall_ns)
        if not effects:
            return ()
        self._carry_on(log, effects, now_ns)
        return self._take_doings()

    def drop(self, key: str, reason: GapReason, now_ns: int, wall_ns: int) -> None:
        """A sample of this key was dropped unread."""
        self._drop(self._by_key.get(key) or self._find_log(key), key, reason, now_ns, wall_ns)

    def tick(self, now_ns: int, wall_ns: int, sizes: Mapping[str, int]) -> Sequence[Doing]:
        """What is due.

        Args:
            now_ns: monotonic time.
            wall_ns: since 1970.
            sizes: of the file of each log, in bytes.
        """
        limit_bytes = self._plan.ring_bytes // max(1, len(self._logs))
        for log in self._logs.values():
            self._carry_on(log, log.session.tick(now_ns, sizes.get(log.name, 0)), now_ns)
            log.incidents.trim(now_ns, limit_bytes)
            if log.incidents.is_over(now_ns):
                self._end_incident(log, now_ns)
        if now_ns - self._gaps_told_ns >= TELL_GAPS_NS:
            self._gaps_told_ns = now_ns
            self._tell_gaps(now_ns, wall_ns)
        return self._take_doings()

    def roll(self, reason: str, now_ns: int) -> Sequence[Doing]:
        """End all files; the next samples begin others."""
        for log in self._logs.values():
            self._carry_on(log, log.session.roll(reason), now_ns)
        return self._take_doings()

    def stop(self, operator: str, now_ns: int, wall_ns: int) -> Sequence[Doing]:
        """End the logs, and write incidents alone."""
        if not self._is_stopped:
            self._tell(msgspec.structs.replace(STOPPED, operator=operator), now_ns, wall_ns)
            self._is_stopped = True
            self._pause_or_resume("stopped", now_ns)
        return self._take_doings()

    def start(self, operator: str, now_ns: int, wall_ns: int) -> Sequence[Doing]:
        """Record, after a stop."""
        if self._is_stopped:
            self._is_stopped = False
            self._pause_or_resume("", now_ns)
            self._tell(msgspec.structs.replace(STARTED, operator=operator), now_ns, wall_ns)
        return self._take_doings()

    def mark(self, robot: str, because: str, now_ns: int, wall_ns: int) -> tuple[dict[str, str], Sequence[Doing]]:
        """Make an incident, of one log or of all.

        Returns:
            Of each log whose incident begins or goes on, the incident's name and its file, which is empty until it
            is opened; and what is to be done. Nothing if there is no such log, or no room.
        """
        marked = [log for log in self._logs.values() if self._is_of(log, robot)]
        if not self._has_incident_room:
            return {}, ()
        for log in marked:
            self._begin_incident(log, because, now_ns, wall_ns)
        return {log.incident_name: log.incident_file for log in marked}, self._take_doings()

    def take_notice(self, notice: Notice, now_ns: int, wall_ns: int) -> Sequence[Doing]:
        """What became of files and of the disk."""
        match notice:
            case Opened():
                self._take_opened(notice, now_ns, wall_ns)
            case Ended():
                self._take_ended(notice)
            case Lost():
                self._take_lost(notice)
            case Room():
                self._take_room(notice, now_ns, wall_ns)
        word = in_words(notice)
        if word is not None:
            self._tell(word, now_ns, wall_ns)
        return self._take_doings()

    def ask_last(self, now_ns: int) -> Sequence[Doing]:
        """What is worth asking once more before ``close``."""
        for log in self._logs.values():
            self._carry_on(log, log.session.ask_last(now_ns), now_ns)
        return self._take_doings()

    def close(self, now_ns: int, wall_ns: int) -> Sequence[Doing]:
        """End everything."""
        for log in self._logs.values():
            self._carry_on(log, log.session.seal(), now_ns)
        self._tell_gaps(now_ns, wall_ns)
        for log in self._logs.values():
            self._carry_on(log, log.session.close(), now_ns)
            self._end_incident(log, now_ns)
        return self._take_doings()

    def _find_log(self, key: str) -> _Log:
        name = self._name_of(key) if self._plan.per_robot else self._plan.session.name
        if name not in self._logs and len(self._logs) > self._plan.log_limit:
            name = self._plan.session.name
        log = self._logs.get(name)
        if log is None:
            log = self._logs[name] = _Log(name, self._plan)
            if self.state is not RecorderState.RECORDING:
                log.session.pause(self.state.value)
        if len(self._by_key) >= OWNED_KEY_LIMIT:
            self._by_key.clear()
        self._by_key[key] = log
        return log

    def _name_of(self, key: str) -> str:
        own = self._own.fullmatch(key)
        if own is not None:
            return own[1]
        parts = keys.parse(key)
        if parts is None or not parts.robot:
            return self._plan.session.name
        # Robots of other roots may have the same names.
        return f"{parts.root}/{parts.robot}"

    def _close_short_ways(self, log: _Log) -> None:
        """The next sample of each key goes the long way, which begins a file where there is none."""
        for key in log.short_ways:
            del self._short_ways[key]
        log.short_ways.clear()

    def _find_short_way(self, key: str) -> None:
        log = self._by_key.get(key)
        if log is None or key in self._short_ways or len(self._short_ways) >= OWNED_KEY_LIMIT:
            return
        way = log.session.short_way(key)
        if way is not None:
            self._short_ways[key] = way
            log.short_ways.append(key)

    def _is_of(self, log: _Log, robot: str) -> bool:
        if not robot or log.name == robot:
            return True
        return not self._plan.per_robot and log.session.has_heard(robot)

    def _carry_on(self, log: _Log, effects: Iterable[Effect], now_ns: int) -> None:
        """What a session asks for goes into its log, as far as that is written, and into the ring."""
        written: list[OpenLog | FileEffect] = []
        kept: list[Effect] = []
        for effect in effects:
            if isinstance(effect, AskInfo | AskKept):
                self._doings.append(effect)
            elif isinstance(effect, Alarm):
                if self._has_incident_room:
                    self._begin_incident(log, effect.because, now_ns, effect.wall_ns)
            elif isinstance(effect, WriteChunk | SyncLog) and not log.is_written:
                kept.append(effect)
                if isinstance(effect, WriteChunk):
                    self._leave_out(log, effect)
            else:
                kept.append(effect)
                written.append(effect)
                if isinstance(effect, OpenLog | CloseLog):
                    log.is_written = isinstance(effect, OpenLog)
                    log.named = ""
                    self._close_short_ways(log)
        if written:
            self._doings.append(OnLog(log.name, tuple(written)))
        if kept:
            self._write_incident(log, log.incidents.take(kept, now_ns))

    def _leave_out(self, log: _Log, effect: WriteChunk) -> None:
        """A chunk that only the ring holds. That the disk is full is a loss; that somebody stopped us is none."""
        chunk = effect.chunk
        counts = {channel_id: len(entries) // 2 for channel_id, entries in chunk.index.items()}
        reason = self._left_out
        for topic, count in log.session.lose_written(counts, reason).items():
            if reason is not None:
                self._gaps.add(log.name, topic, reason, count, chunk.start_ns, chunk.end_ns)

    def _begin_incident(self, log: _Log, because: str, now_ns: int, wall_ns: int) -> None:
        # Where no file has been begun yet, nothing has been said of the robots.
        self._carry_on(log, log.session.describe(), now_ns)
        effects = log.incidents.begin(now_ns, wall_ns, because, log.file if log.is_written else "")
        if effects:
            log.is_incident_told = False
            log.incident_file = ""
            self.incidents += 1
        self._write_incident(log, effects)

    def _end_incident(self, log: _Log, now_ns: int) -> None:
        if log.incidents.is_open:
            # What is in hand was received in time.
            self._carry_on(log, log.session.seal(), now_ns)
            self._write_incident(log, log.incidents.close())

    def _write_incident(self, log: _Log, effects: Sequence[OpenLog | FileEffect]) -> None:
        if effects:
            self._doings.append(OnLog(log.incident_name, tuple(effects)))

    def _take_opened(self, notice: Opened, now_ns: int, wall_ns: int) -> None:
        log = self._logs.get(notice.log)
        if log is not None:
            log.file = notice.file
            self._write_incident(log, log.incidents.go_on_in(notice.file))
            if log.incidents.is_open and log.incident_file:
                self._name_incident(log, now_ns)
            return
        log = self._logs.get(notice.log.removesuffix(INCIDENT_MARK))
        if log is None:
            return
        log.incident_file = notice.file
        if log.is_incident_told:
            return  # The incident goes on in another file, after a fault of the disk.
        log.is_incident_told = True
        self._name_incident(log, now_ns)
        text = f"{notice.file} keeps what came before and after: {log.incidents.about['because']}"
        word = Word(RecorderEventKind.INCIDENT, Severity.WARNING, text, notice.file)
        self._tell(word, now_ns, wall_ns, log)

    def _name_incident(self, log: _Log, now_ns: int) -> None:
        if log.is_written and log.named != log.incident_file:
            log.named = log.incident_file
            entries = {**log.incidents.about, "file": log.incident_file}
            self._carry_on(log, [WriteMetadata(INCIDENT_NAME, entries)], now_ns)

    def _take_ended(self, notice: Ended) -> None:
        log = self._logs.get(notice.log)
        if log is not None and log.file == notice.file:
            log.file = ""
        log = self._logs.get(notice.log.removesuffix(INCIDENT_MARK))
        if log is not None and log.incident_file == notice.file:
            log.incident_file = ""

    def _take_lost(self, lost: Lost) -> None:
        log = self._logs.get(lost.log)
        if log is None:
            return  # An incident's: the log itself may have them.
        for topic, count in log.session.lose_written(lost.counts, GapReason.DISK).items():
            self._gaps.add(log.name, topic, GapReason.DISK, count, lost.first_ns, lost.last_ns)

    def _take_room(self, room: Room, now_ns: int, wall_ns: int) -> None:
        had_room, self._has_room = self._has_room, room.has_room
        self._has_incident_room = room.has_incident_room
        if room.roll:
            for log in self._logs.values():
                self._carry_on(log, log.session.roll("room"), now_ns)
        if had_room and not room.has_room:
            self._tell(FULL, now_ns, wall_ns)
            self._pause_or_resume("full", now_ns)
        elif room.has_room and not had_room:
            self._pause_or_resume("", now_ns)
            self._tell(ROOM, now_ns, wall_ns)

    def _pause_or_resume(self, reason: str, now_ns: int) -> None:
        is_paused = self.state is not RecorderState.RECORDING
        for log in self._logs.values():
            self._carry_on(log, log.session.seal(), now_ns)
            if log.session.is_paused != is_paused:
                effects = log.session.pause(reason) if is_paused else log.session.resume()
                self._carry_on(log, effects, now_ns)
        # Only now: what was in hand came before.
        self._left_out = GapReason.FULL if self.state is RecorderState.FULL else None

    def _drop(self, log: _Log, key: str, reason: GapReason, now_ns: int, wall_ns: int) -> None:
        self._carry_on(log, log.session.lose(key, reason, 1, now_ns), now_ns)
        self._gaps.add(log.name, key, reason, 1, wall_ns, wall_ns)

    def _tell_gaps(self, now_ns: int, wall_ns: int) -> None:
        for name, gap in self._gaps.tell(wall_ns):
            self._say(gap, self._logs[name], now_ns)

    def _tell(self, word: Word, now_ns: int, wall_ns: int, log: _Log | None = None) -> None:
        event = RecorderEvent(
            time_ns=wall_ns,
            sequence=self._sequence,
            severity=word.severity,
            kind=word.kind,
            robot=log.name if log is not None else "",
            file=word.file,
            operator=word.operator,
            text=word.text,
        )
        self._sequence = (self._sequence + 1) % SEQUENCE_SPAN
        self._say(event, log, now_ns)

    def _say(self, message: RecorderEvent | RecordGap, log: _Log | None, now_ns: int) -> None:
        """Publish it, and write it into its log, or into all."""
        self._doings.append(Say(message))
        name = "gap" if isinstance(message, RecordGap) else "event"
        topic = keys.of_recorder(self._plan.root, self._plan.recorder, name)
        for one in self._logs.values() if log is None else [log]:
            self._carry_on(one, one.session.add_own(topic, message, now_ns), now_ns)

    def _take_doings(self) -> Sequence[Doing]:
        doings, self._doings = self._doings, []
        return doings
