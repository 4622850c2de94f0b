"""The recorder: samples, ticks, marks and notices in, actions out. Pure.

Begin with ``Recorder.receive``, which finds the log by the key; then read ``robot_log``. ``SampleInbox`` is
bounded in bytes: it drops the oldest samples, and counts them. ``HealthReport`` makes the recorder's health.
"""

from __future__ import annotations

import re
from collections import Counter, defaultdict, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from typing import Final

import msgspec

from recorder.encoding.samples import SEQUENCE_SPAN, KeyCounters, ReceivedSample, copy
from recorder.mcap.writer import log_time
from recorder.record.accounting import KeyReport, total
from recorder.record.actions import (
    FULL,
    INCIDENT_MARK,
    QUERIES_PER_TICK,
    ROOM,
    Action,
    Announcement,
    DiskRoom,
    Ended,
    Lost,
    Notice,
    Opened,
    Publish,
    announcement_of,
)
from recorder.record.incidents import LostGateway, LostGateways, trim_rings
from recorder.record.robot_log import LogContext, LogPlan, RobotLog
from schemas import keys
from schemas.codec import PAYLOAD_ERRORS
from schemas.command_line import short
from schemas.decisions import SafetyEvent, SafetyState, Severity
from schemas.recording import GapReason, RecorderEvent, RecorderEventKind, RecorderHealth, RecorderState, RecordGap
from schemas.settings import OWNED_KEY_LIMIT, ROBOT_LIMIT
from schemas.subjects import BY_TYPE, LIVELINESS_CHUNK

SAMPLE_BYTES: Final = 500  # approximate memory of a sample besides its payload and key


class SampleInbox:
    """A queue of samples."""

    def __init__(self, limit_bytes: int) -> None:
        self._limit_bytes = limit_bytes
        self._waiting: deque[tuple[ReceivedSample, int]] = deque()
        self.bytes = 0  # bytes that wait

    def __len__(self) -> int:
        return len(self._waiting)

    def put(self, sample: ReceivedSample) -> list[tuple[str, int]]:
        """Queue a sample. Returns key and time of receipt of each sample dropped for it (it may be itself)."""
        size = len(sample.payload) + len(sample.attachment) + len(sample.key) + SAMPLE_BYTES
        self._waiting.append((copy(sample), size))
        self.bytes += size
        if self.bytes <= self._limit_bytes:
            return []
        dropped = []
        while self.bytes > self._limit_bytes:
            oldest, size = self._waiting.popleft()
            self.bytes -= size
            dropped.append((oldest.key, oldest.received_ns))
        return dropped

    def take(self, limit: int, limit_bytes: int) -> Iterator[ReceivedSample]:
        taken_bytes = 0
        for _ in range(min(limit, len(self._waiting))):
            sample, size = self._waiting.popleft()
            self.bytes -= size
            yield sample
            taken_bytes += size
            if taken_bytes > limit_bytes:
                return


REPORT_LOSSES_NS: Final = 1_000_000_000  # losses are reported once a second

QUICK_BYTES: Final = 65_536
"""A larger payload takes the slow path, which checks the time after each sample: it may be slow to decode."""

TICK_LOGS: Final = 50  # logs served in one tick, if all fit into TICK_TURNS
TICK_TURNS: Final = 4  # ticks in which every log is served once: a thousand in one tick would take too long


class RecorderPlan(msgspec.Struct, frozen=True):
    """The settings of a recorder.

    Attributes:
        per_robot: a log for each robot; else one for all.
        log: of each log; its name is that of the shared log.
        log_limit: robots beyond it share one log, except known ones.
    """

    root: str
    recorder: str
    per_robot: bool
    log: LogPlan
    ring_bytes: int
    sample_max_bytes: int
    standby: bool = False
    log_limit: int = ROBOT_LIMIT
    known: frozenset[str] = frozenset()


class Recorder:
    """Writes the logs of the robots; each method returns the actions to take."""

    def __init__(self, plan: RecorderPlan) -> None:
        self._plan = plan
        self._logs: dict[str, RobotLog] = {}
        self._by_key: dict[str, RobotLog] = {}
        self._context = LogContext()
        self._lost_gateways = LostGateways()
        self._losses_reported_ns = 0
        self._turn = 0
        self._askers: deque[RobotLog] = deque()  # the logs, the one first whose turn it is to ask
        self._is_ending = False
        self._event_sequence = self._gap_sequence = 0
        self._has_room = True
        self._of_robot = re.compile(rf"{re.escape(plan.root)}/({keys.ROBOT_PATTERN})/.*", re.DOTALL)
        self._own_topics = {
            kind: keys.of_recorder(plan.root, plan.recorder, BY_TYPE[kind].name)
            for kind in (RecorderEvent, RecordGap)
        }
        """The topic of each kind of message that it publishes."""
        self._own_keys = frozenset(self._own_topics.values())  # samples on these are in the logs already

    @property
    def state(self) -> RecorderState:
        if self._plan.standby:
            return RecorderState.STOPPED
        return RecorderState.RECORDING if self._has_room else RecorderState.FULL

    @property
    def counts(self) -> dict[str, KeyReport]:
        reports = defaultdict(list)
        for log in self._logs.values():
            for topic, report in log.channels.counts.items():
                reports[topic].append(report)
        # Few topics are in several logs: the recorder's own, and keys beyond the limits.
        return {topic: found[0] if len(found) == 1 else total(found) for topic, found in reports.items()}

    @property
    def counters(self) -> Iterable[KeyCounters]:
        return (counters for log in self._logs.values() for counters in log.channels.counters)

    @property
    def robots(self) -> int:
        return sum(len(log.robots) for log in self._logs.values())

    @property
    def files(self) -> dict[str, str]:
        """Names of the open files by log, without directory and without incidents."""
        return {log.name: log.file for log in self._logs.values() if log.file}

    @property
    def writing(self) -> set[str]:
        """The logs with an open file, even if the disk has not begun it yet."""
        return {log.name for log in self._logs.values() if log.is_open}

    @property
    def incidents(self) -> int:
        return self._context.incidents

    @property
    def has_incident_room(self) -> bool:
        return self._context.has_incident_room

    @property
    def ring_bytes(self) -> int:
        return sum(log.incidents.ring_bytes for log in self._logs.values())

    def receive(
        self, samples: Iterable[ReceivedSample], now_ns: int, is_late: Callable[[], bool] = lambda: False
    ) -> Sequence[Action]:
        """Record samples; nothing in them raises. Nearly all take the fast path of their key.

        Args:
            samples: from an iterator, samples beyond the time limit are not taken.
            is_late: the time limit is reached; asked after each slow sample.
        """
        fast_paths, limit_bytes = self._context.fast_paths, min(QUICK_BYTES, self._plan.sample_max_bytes)
        for sample in samples:
            path = fast_paths.get(sample.key)
            payload = sample.payload
            if path is not None and path[0] == sample.encoding and len(payload) <= limit_bytes:
                try:
                    if path[1](payload, sample.received_ns):
                        continue
                except PAYLOAD_ERRORS:
                    pass
            self._receive_sample(sample, now_ns)
            if is_late():
                break
        return self._take_actions()

    def _receive_sample(self, sample: ReceivedSample, now_ns: int) -> None:
        key = sample.key
        if key in self._own_keys:
            return
        log = self._by_key.get(key) or self._find_log(key)
        if len(sample.payload) + len(sample.attachment) > self._plan.sample_max_bytes:
            log.drop_sample(key, GapReason.SIZE, now_ns, sample.received_ns)
        else:
            log.receive_sample(sample, now_ns, sample.received_ns)
            log.find_fast_path(key)

    def lose_token(self, key: str, now_ns: int) -> None:
        """Note that a gateway's liveliness token is gone. If the gateway has died, ``tick`` begins an incident."""
        robot = key.removesuffix(f"/{LIVELINESS_CHUNK}")
        state_key, event_key = (f"{robot}/{BY_TYPE[kind].name}" for kind in (SafetyState, SafetyEvent))
        log = self._by_key.get(state_key)
        route = None if log is None else log.channels.get(state_key)
        if log is not None and route is not None:
            ended = partial(log.ended_ticks.get, event_key)
            self._lost_gateways.lose_token(state_key, route.latest, ended, now_ns)

    def drop(self, key: str, reason: GapReason, now_ns: int, wall_ns: int) -> None:
        if key not in self._own_keys:
            log = self._by_key.get(key) or self._find_log(key)
            log.drop_sample(key, reason, now_ns, wall_ns)

    def tick(self, now_ns: int, wall_ns: int, sizes: Mapping[str, int]) -> Sequence[Action]:
        for log in self._due():
            log.tick(now_ns, sizes.get(log.name, 0))
        for lost in self._lost_gateways.due(now_ns, wall_ns):
            self._receive_lost_gateway(lost, now_ns, wall_ns)
        while self._context.announcements:
            self._announce(self._context.announcements.popleft(), now_ns, wall_ns)
        trim_rings((log.incidents for log in self._logs.values()), now_ns, self._plan.ring_bytes)
        if now_ns - self._losses_reported_ns >= REPORT_LOSSES_NS:
            self._losses_reported_ns = now_ns
            self._report_losses(now_ns, wall_ns)
        return self._take_actions()

    def ask(self, now_ns: int, most: int = QUERIES_PER_TICK) -> Sequence[Action]:
        """Return the due queries of all logs in turn, at most ``most``; the rest stay due."""
        for _ in range(len(self._askers) if self._is_ending else min(len(self._askers), self._part)):
            if most <= 0:
                break
            queries = self._askers[0].queries(now_ns, most)
            self._askers.rotate(-1)
            self._context.actions += queries
            most -= len(queries)
        return self._take_actions()

    def roll(self, reason: str, now_ns: int) -> Sequence[Action]:
        """End all files; the next samples begin others. See ``RobotLog.roll`` for the shortest time between."""
        for log in self._logs.values():
            log.roll(reason, now_ns)
        return self._take_actions()

    def mark(self, robot: str, because: str, now_ns: int, wall_ns: int) -> tuple[dict[str, str], Sequence[Action]]:
        """Begin or extend an incident of one log, or of all.

        Returns:
            The incident's file by the incident log's name (empty until it is opened), and the actions. Both empty
            if there is no such log, or no space.
        """
        if not self.has_incident_room:
            return {}, ()
        marked = [log for log in self._logs.values() if self._is_of(log, robot)]
        for log in marked:
            log.begin_incident(because, now_ns, wall_ns)
        return {log.incidents.log: log.incident_file for log in marked}, self._take_actions()

    def receive_notice(self, notice: Notice, now_ns: int, wall_ns: int) -> Sequence[Action]:
        announcement, log = announcement_of(notice), None
        if isinstance(notice, DiskRoom):
            self._receive_room(notice, now_ns, wall_ns)
        elif isinstance(notice, Opened | Ended | Lost):
            log = self._logs.get(notice.log.removesuffix(INCIDENT_MARK))
            if log is None:
                return []
            if isinstance(notice, Opened):
                announcement = log.receive_opened(notice)
            elif isinstance(notice, Ended):
                log.receive_ended(notice)
            else:
                log.receive_lost(notice)
        if announcement is not None:
            self._announce(announcement, now_ns, wall_ns, log)
        return self._take_actions()

    def ask_last(self, now_ns: int) -> None:
        """Make the last queries before ``close`` due."""
        self._is_ending = True
        for log in self._logs.values():
            log.ask_last(now_ns)

    def close(self, now_ns: int, wall_ns: int) -> Sequence[Action]:
        for log in self._logs.values():
            log.hand_over(now_ns)
        self._report_losses(now_ns, wall_ns)
        for log in self._logs.values():
            log.close(now_ns)
            log.end_incident(now_ns)
        return self._take_actions()

    def _due(self) -> list[RobotLog]:
        """The logs to serve in this tick: all, or a part of very many."""
        logs = list(self._logs.values())
        if len(logs) <= TICK_LOGS:
            return logs
        begin = self._turn * self._part
        self._turn = self._turn + 1 if begin + self._part < len(logs) else 0
        return logs[begin : begin + self._part]

    @property
    def _part(self) -> int:
        """Number of logs to serve in one tick."""
        return max(TICK_LOGS, -(-len(self._logs) // TICK_TURNS))

    def _find_log(self, key: str) -> RobotLog:
        name = self._name_of(key) if self._plan.per_robot else self._plan.log.name
        is_new = name not in self._logs and name not in self._plan.known
        if is_new and len(self._logs) > self._plan.log_limit:
            name = self._plan.log.name
        log = self._logs.get(name)
        if log is None:
            plan = msgspec.structs.replace(self._plan.log, name=name)
            log = self._logs[name] = RobotLog(plan, self._context)
            self._askers.append(log)
            log.is_paused = self.state is not RecorderState.RECORDING
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
            return self._plan.log.name
        # Robots of other roots may have the same names.
        return f"{parts.root}/{parts.robot}"

    def _is_of(self, log: RobotLog, robot: str) -> bool:
        if not robot or log.name == robot:
            return True
        return not self._plan.per_robot and robot in log.robots

    def _receive_room(self, room: DiskRoom, now_ns: int, wall_ns: int) -> None:
        had_room, self._has_room = self._has_room, room.has_room
        self._context.has_incident_room = room.has_incident_room
        for log in self._logs.values():
            if room.roll:
                log.roll("room", now_ns)
            if not room.has_incident_room:
                log.cut_incident(now_ns)
        if had_room and not room.has_room:
            self._announce(FULL, now_ns, wall_ns)
            self._pause_or_resume("full", now_ns)
        elif room.has_room and not had_room:
            self._pause_or_resume("", now_ns)
            self._announce(ROOM, now_ns, wall_ns)

    def _pause_or_resume(self, reason: str, now_ns: int) -> None:
        is_paused = self.state is not RecorderState.RECORDING
        for log in self._logs.values():
            log.hand_over(now_ns)
            if is_paused and not log.is_paused:
                log.pause(reason, now_ns)
            elif log.is_paused and not is_paused:
                log.resume(now_ns)
        # Only now: the chunks handed over came before.
        self._context.left_out = GapReason.FULL if self.state is RecorderState.FULL else None

    def _report_losses(self, now_ns: int, wall_ns: int) -> None:
        for name, gap in self._context.losses.take():
            numbered = msgspec.structs.replace(gap, time_ns=log_time(wall_ns), sequence=self._gap_sequence)
            self._gap_sequence = (self._gap_sequence + 1) % SEQUENCE_SPAN
            self._say(numbered, self._logs[name], now_ns)

    def _receive_lost_gateway(self, lost: LostGateway, now_ns: int, wall_ns: int) -> None:
        wall_ns -= now_ns - lost.lost_ns
        log = self._find_log(lost.key)
        route = log.channels.get(lost.key)
        severity = Severity.ERROR if lost.was_commanding else Severity.WARNING
        robot = "" if route is None else route.robot
        announcement = Announcement(RecorderEventKind.GATEWAY, severity, lost.text, robot=robot)
        self._announce(announcement, now_ns, wall_ns, log)
        if lost.was_commanding:
            log.raise_alarm(short(lost.text), now_ns, wall_ns)

    def _announce(
        self, announcement: Announcement, now_ns: int, wall_ns: int, log: RobotLog | None = None
    ) -> None:
        event = RecorderEvent(
            time_ns=wall_ns,
            sequence=self._event_sequence,
            severity=announcement.severity,
            kind=announcement.kind,
            robot=announcement.robot or (log.name if log is not None else ""),
            file=announcement.file,
            operator=announcement.operator,
            text=announcement.text,
        )
        self._event_sequence = (self._event_sequence + 1) % SEQUENCE_SPAN
        self._say(event, log, now_ns)

    def _say(self, message: RecorderEvent | RecordGap, log: RobotLog | None, now_ns: int) -> None:
        """Publish a message, and write it into its log, or into all."""
        self._context.actions.append(Publish(message))
        topic = self._own_topics[type(message)]
        for one in self._logs.values() if log is None else [log]:
            one.add_own(topic, message, now_ns)

    def _take_actions(self) -> Sequence[Action]:
        if not self._context.actions:
            return ()
        actions, self._context.actions = self._context.actions, []
        return actions


SECOND_NS: Final = 1_000_000_000


class Vitals(msgspec.Struct, frozen=True):
    """Figures from the disk and the inbox, with the names of ``RecorderHealth``."""

    files: int = 0
    files_ended: int = 0
    ended_bytes: int = 0
    queue_bytes: int = 0
    disk_queue_bytes: int = 0
    disk_free_bytes: int = 0
    disk_used_bytes: int = 0
    incident_bytes: int = 0


class HealthReport:
    """Makes the health of each second."""

    def __init__(self, recorder: str, version: str, now_ns: int) -> None:
        self._recorder = recorder
        self._version = version
        self._started_ns = self._state_since_ns = self._last_ns = now_ns
        self._state: RecorderState | None = None
        self._sequence = 0
        self._received = self._cpu_ns = 0
        self._received_per_s = self._cpu_percent = 0.0

    def is_due(self, now_ns: int) -> bool:
        return now_ns - self._last_ns >= SECOND_NS

    def next(self, recorder: Recorder, vitals: Vitals, cpu_ns: int, now_ns: int, wall_ns: int) -> RecorderHealth:
        """The health of the past second; ``cpu_ns`` is the process's CPU time so far."""
        span_ns = max(1, now_ns - self._last_ns)
        self._cpu_percent = max(0, cpu_ns - self._cpu_ns) * 100 / span_ns
        self._sequence = (self._sequence + 1) % SEQUENCE_SPAN
        health = self.now(recorder, vitals, now_ns, wall_ns)
        self._received_per_s = max(0, health.received - self._received) * SECOND_NS / span_ns
        self._received, self._cpu_ns, self._last_ns = health.received, cpu_ns, now_ns
        return msgspec.structs.replace(health, received_per_s=self._received_per_s)

    def now(self, recorder: Recorder, vitals: Vitals, now_ns: int, wall_ns: int) -> RecorderHealth:
        """The current health, with the rates of the last whole second."""
        if recorder.state is not self._state:
            # The first state counts from the start.
            self._state_since_ns = self._started_ns if self._state is None else now_ns
            self._state = recorder.state
        lost: Counter[GapReason] = Counter()
        received = messages = missed = keys = 0
        for counters in recorder.counters:
            keys += 1
            received += counters.samples + counters.unread
            messages += counters.messages - counters.unwritten
            missed += counters.missed
            lost.update(counters.lost)
        return RecorderHealth(
            time_ns=wall_ns,
            sequence=self._sequence,
            recorder=self._recorder,
            recorder_version=self._version,
            uptime_s=(now_ns - self._started_ns) / SECOND_NS,
            state=recorder.state,
            state_since_s=(now_ns - self._state_since_ns) / SECOND_NS,
            robots=recorder.robots,
            keys=keys,
            received=received,
            received_per_s=self._received_per_s,
            written=max(0, messages),
            missed=missed,
            dropped={reason.value: count for reason, count in sorted(lost.items(), key=lambda one: one[0].value)},
            ring_bytes=recorder.ring_bytes,
            incidents=recorder.incidents,
            cpu_percent=self._cpu_percent,
            **msgspec.structs.asdict(vitals),
        )
