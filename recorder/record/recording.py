"""All that one recorder writes, without I/O: samples, ticks, orders and notices in, what is to be done out.

One ``RobotLog`` for each robot, or one for all. ``receive`` finds the log by the key. The page to begin with; then
``robot_log``, ``session``.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Final

import msgspec

from recorder.encoding.key_counters import SEQUENCE_SPAN, Tally
from recorder.encoding.sample import Sample
from recorder.record.completeness import KeyReport, total
from recorder.record.effects import Alarm, Doing, Say
from recorder.record.gateways import Gateways, Gone
from recorder.record.incidents import IncidentPlan
from recorder.record.notices import FULL, ROOM, STARTED, STOPPED, Ended, Lost, Notice, Opened, Room, Word, in_words
from recorder.record.robot_log import INCIDENT_MARK, Outlet, RobotLog, trim_rings
from recorder.record.session import Plan
from schemas import keys
from schemas.codec import PAYLOAD_ERRORS
from schemas.decisions import SafetyEvent, SafetyState, Severity
from schemas.printable import short
from schemas.recorder_settings import OWNED_KEY_LIMIT, ROBOT_LIMIT
from schemas.recording import (
    GapReason,
    RecorderEvent,
    RecorderEventKind,
    RecorderState,
    RecordGap,
)
from schemas.subjects import BY_TYPE, LIVELINESS_CHUNK

TELL_GAPS_NS: Final = 1_000_000_000
"""Gaps are told once a second."""

QUICK_BYTES: Final = 65_536
"""A larger payload takes the slow path, where the time is looked at after each: it may take long to decode."""

TICK_LOGS: Final = 50
"""Logs that are looked after in every tick..."""

TICK_TURNS: Final = 4
"""...where there are more, each has its turn after so many ticks: a thousand at once would take all the time."""


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
        log_limit: robots beyond it share one log...
        known: ...but for these.
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
    known: frozenset[str] = frozenset()


class Recording:
    """Everything that one recorder writes."""

    def __init__(self, plan: RecordingPlan) -> None:
        self._plan = plan
        self._logs: dict[str, RobotLog] = {}
        self._by_key: dict[str, RobotLog] = {}
        self._outlet = Outlet()
        self._gateways = Gateways()
        self._gaps_told_ns = 0
        self._turn = 0
        self._sequence = 0
        self._is_stopped = plan.standby
        self._has_room = True
        self._of_robot = re.compile(rf"{re.escape(plan.root)}/({keys.ROBOT_PATTERN})/.*", re.DOTALL)
        own = (_own_topic(plan, kind) for kind in (RecorderEvent, RecordGap))
        self._own_topics = frozenset(own)
        """What is said there is in the logs already, should it come back as a sample."""

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
            for topic, report in log.session.channels.counts.items():
                reports[topic].append(report)
        # Few are in several logs: what the recorder itself says, and what is beyond the limits.
        return {topic: found[0] if len(found) == 1 else total(found) for topic, found in reports.items()}

    @property
    def tallies(self) -> Iterable[Tally]:
        """Of every topic."""
        return (tally for log in self._logs.values() for tally in log.session.channels.tallies)

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
    def incidents(self) -> int:
        """Incidents that were begun."""
        return self._outlet.incidents

    @property
    def has_incident_room(self) -> bool:
        """Whether the disk may hold more incidents."""
        return self._outlet.has_incident_room

    @property
    def ring_bytes(self) -> int:
        """Bytes of the messages in all rings."""
        return sum(log.incidents.ring_bytes for log in self._logs.values())

    def receive(
        self, samples: Iterable[Sample], now_ns: int, is_late: Callable[[], bool] = lambda: False
    ) -> Sequence[Doing]:
        """Record samples, each received when it says. They may hold anything: nothing in them raises.

        Nearly all take the fast path of their key, see ``fast_path``; the others through ``receive_sample``.

        Args:
            samples: if it is an iterator, what there was no time for is still in it.
            now_ns: monotonic time.
            is_late: the time is over, asked after each sample that may have taken long.
        """
        fast_paths, limit_bytes = self._outlet.fast_paths, min(QUICK_BYTES, self._plan.sample_max_bytes)
        doings: list[Doing] = []
        for sample in samples:
            path = fast_paths.get(sample.key)
            payload = sample.payload
            if path is not None and path[0] == sample.encoding and len(payload) <= limit_bytes:
                try:
                    if path[1](payload, sample.received_ns):
                        continue
                except PAYLOAD_ERRORS:
                    pass
            doings += self.receive_sample(sample, now_ns, sample.received_ns)
            log = self._by_key.get(sample.key)
            if log is not None:
                log.find_fast_path(sample.key)
            if is_late():
                break
        return doings

    def receive_sample(self, sample: Sample, now_ns: int, wall_ns: int) -> Sequence[Doing]:
        """Record a sample. It may hold anything: nothing in it raises."""
        if sample.key in self._own_topics:
            return ()
        log = self._by_key.get(sample.key) or self._find_log(sample.key)
        if len(sample.payload) + len(sample.attachment) > self._plan.sample_max_bytes:
            self._drop(log, sample.key, GapReason.SIZE, now_ns, wall_ns)
            return ()
        effects = log.session.receive_sample(sample, now_ns, wall_ns)
        if not effects:
            return ()
        log.carry_on(effects, now_ns)
        return self._take_doings()

    def lose_token(self, key: str, now_ns: int) -> None:
        """The liveliness token of a gateway is gone. If it has died, ``tick`` makes an incident of that."""
        robot = key.removesuffix(f"/{LIVELINESS_CHUNK}")
        state_key, event_key = (f"{robot}/{BY_TYPE[kind].name}" for kind in (SafetyState, SafetyEvent))
        log = self._by_key.get(state_key)
        route = None if log is None else log.session.channels.get(state_key)
        if log is not None and route is not None:
            self._gateways.lose_token(
                state_key, route.latest, partial(log.session.ended_ticks.get, event_key), now_ns
            )

    def drop(self, key: str, reason: GapReason, now_ns: int, wall_ns: int) -> None:
        """A sample of this key was dropped unread."""
        if key not in self._own_topics:
            self._drop(self._by_key.get(key) or self._find_log(key), key, reason, now_ns, wall_ns)

    def tick(self, now_ns: int, wall_ns: int, sizes: Mapping[str, int]) -> Sequence[Doing]:
        """What is due.

        Args:
            now_ns: monotonic time.
            wall_ns: since 1970.
            sizes: of the file of each log, in bytes.
        """
        for log in self._due():
            log.carry_on(log.session.tick(now_ns, sizes.get(log.name, 0)), now_ns)
            if log.incidents.is_over(now_ns):
                log.end_incident(now_ns)
        for gone in self._gateways.due(now_ns, wall_ns):
            self._tell_gone(gone, now_ns, wall_ns)
        for word in self._outlet.take_words():
            self._tell(word, now_ns, wall_ns)
        trim_rings(self._logs.values(), now_ns, self._plan.ring_bytes)
        if now_ns - self._gaps_told_ns >= TELL_GAPS_NS:
            self._gaps_told_ns = now_ns
            self._tell_gaps(now_ns, wall_ns)
        return self._take_doings()

    def roll(self, reason: str, now_ns: int) -> Sequence[Doing]:
        """End all files; the next samples begin others. See ``Session.roll`` for how soon."""
        for log in self._logs.values():
            log.carry_on(log.session.roll(reason, now_ns), now_ns)
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
        if not self.has_incident_room:
            return {}, ()
        for log in marked:
            log.begin_incident(because, now_ns, wall_ns)
        return {log.incident_name: log.incident_file for log in marked}, self._take_doings()

    def take_notice(self, notice: Notice, now_ns: int, wall_ns: int) -> Sequence[Doing]:
        """What became of files and of the disk."""
        word, log = in_words(notice), None
        if isinstance(notice, Room):
            self._take_room(notice, now_ns, wall_ns)
        elif isinstance(notice, Opened | Ended | Lost):
            log = self._logs.get(notice.log.removesuffix(INCIDENT_MARK))
            if log is None:
                return []
            if isinstance(notice, Opened):
                word = log.take_opened(notice, now_ns)
            elif isinstance(notice, Ended):
                log.take_ended(notice)
            else:
                log.take_lost(notice)
        if word is not None:
            self._tell(word, now_ns, wall_ns, log)
        return self._take_doings()

    def ask_last(self, now_ns: int) -> Sequence[Doing]:
        """What is worth asking once more before ``close``."""
        for log in self._logs.values():
            log.carry_on(log.session.ask_last(now_ns), now_ns)
        return self._take_doings()

    def close(self, now_ns: int, wall_ns: int) -> Sequence[Doing]:
        """End everything."""
        for log in self._logs.values():
            log.carry_on(log.session.seal(), now_ns)
        self._tell_gaps(now_ns, wall_ns)
        for log in self._logs.values():
            log.carry_on(log.session.close(), now_ns)
            log.end_incident(now_ns)
        return self._take_doings()

    def _due(self) -> list[RobotLog]:
        """The logs whose turn it is: all, or of very many a part at a time."""
        logs = list(self._logs.values())
        if len(logs) <= TICK_LOGS:
            return logs
        count = max(TICK_LOGS, -(-len(logs) // TICK_TURNS))
        begin = self._turn * count
        self._turn = self._turn + 1 if begin + count < len(logs) else 0
        return logs[begin : begin + count]

    def _find_log(self, key: str) -> RobotLog:
        name = self._name_of(key) if self._plan.per_robot else self._plan.session.name
        is_new = name not in self._logs and name not in self._plan.known
        if is_new and len(self._logs) > self._plan.log_limit:
            name = self._plan.session.name
        log = self._logs.get(name)
        if log is None:
            plan = msgspec.structs.replace(self._plan.session, name=name)
            log = self._logs[name] = RobotLog(plan, self._plan.incident, self._outlet)
            if self.state is not RecorderState.RECORDING:
                log.session.pause(self.state.value)
            self._count_or_not(log)
        if len(key) > keys.KEY_MAX_LENGTH:
            return log
        if len(self._by_key) >= OWNED_KEY_LIMIT:
            self._by_key.clear()
        self._by_key[key] = log
        return log

    def _name_of(self, key: str) -> str:
        own = self._of_robot.fullmatch(key)
        if own is not None:
            return own[1]
        parts = keys.parse(key)
        if parts is None or not parts.robot:
            return self._plan.session.name
        # Robots of other roots may have the same names.
        return f"{parts.root}/{parts.robot}"

    def _is_of(self, log: RobotLog, robot: str) -> bool:
        if not robot or log.name == robot:
            return True
        return not self._plan.per_robot and log.session.has_heard(robot)

    def _take_room(self, room: Room, now_ns: int, wall_ns: int) -> None:
        had_room, self._has_room = self._has_room, room.has_room
        self._outlet.has_incident_room = room.has_incident_room
        if room.roll:
            for log in self._logs.values():
                log.carry_on(log.session.roll("room", now_ns), now_ns)
        if not room.has_incident_room:
            for log in self._logs.values():
                log.cut_incident(now_ns)
        if had_room and not room.has_room:
            self._tell(FULL, now_ns, wall_ns)
            self._pause_or_resume("full", now_ns)
        elif room.has_room and not had_room:
            self._pause_or_resume("", now_ns)
            self._tell(ROOM, now_ns, wall_ns)

    def _pause_or_resume(self, reason: str, now_ns: int) -> None:
        is_paused = self.state is not RecorderState.RECORDING
        for log in self._logs.values():
            log.carry_on(log.session.seal(), now_ns)
            if log.session.is_paused != is_paused:
                effects = log.session.pause(reason) if is_paused else log.session.resume()
                log.carry_on(effects, now_ns)
            self._count_or_not(log)
        # Only now: what was in hand came before.
        self._outlet.left_out = GapReason.FULL if self.state is RecorderState.FULL else None

    def _count_or_not(self, log: RobotLog) -> None:
        """What comes while somebody has stopped us is no loss, and no file's business."""
        account, counts = log.session.account, log.session.channels.counts
        if self._is_stopped:
            account.leave_off(counts)
        else:
            account.take_up(counts)

    def _drop(self, log: RobotLog, key: str, reason: GapReason, now_ns: int, wall_ns: int) -> None:
        log.carry_on(log.session.lose(key, reason, 1, now_ns), now_ns)
        self._outlet.gaps.add(log.name, key, reason, 1, wall_ns, wall_ns)

    def _tell_gaps(self, now_ns: int, wall_ns: int) -> None:
        for name, gap in self._outlet.gaps.tell(wall_ns):
            self._say(gap, self._logs[name], now_ns)

    def _tell_gone(self, gone: Gone, now_ns: int, wall_ns: int) -> None:
        wall_ns -= now_ns - gone.lost_ns
        log = self._find_log(gone.key)
        route = log.session.channels.get(gone.key)
        severity = Severity.ERROR if gone.was_commanding else Severity.WARNING
        word = Word(RecorderEventKind.GATEWAY, severity, gone.text, robot="" if route is None else route.robot)
        self._tell(word, now_ns, wall_ns, log)
        if gone.was_commanding:
            log.carry_on([Alarm(short(gone.text), wall_ns)], now_ns)

    def _tell(self, word: Word, now_ns: int, wall_ns: int, log: RobotLog | None = None) -> None:
        event = RecorderEvent(
            time_ns=wall_ns,
            sequence=self._sequence,
            severity=word.severity,
            kind=word.kind,
            robot=word.robot or (log.name if log is not None else ""),
            file=word.file,
            operator=word.operator,
            text=word.text,
        )
        self._sequence = (self._sequence + 1) % SEQUENCE_SPAN
        self._say(event, log, now_ns)

    def _say(self, message: RecorderEvent | RecordGap, log: RobotLog | None, now_ns: int) -> None:
        """Publish it, and write it into its log, or into all."""
        self._outlet.doings.append(Say(message))
        topic = _own_topic(self._plan, type(message))
        for one in self._logs.values() if log is None else [log]:
            one.carry_on(one.session.add_own(topic, message, now_ns), now_ns)

    def _take_doings(self) -> Sequence[Doing]:
        doings, self._outlet.doings = self._outlet.doings, []
        return doings


def _own_topic(plan: RecordingPlan, kind: type[RecorderEvent | RecordGap]) -> str:
    """Where a recorder says such a thing."""
    return keys.of_recorder(plan.root, plan.recorder, BY_TYPE[kind].name)
