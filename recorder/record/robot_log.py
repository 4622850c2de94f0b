"""The log of one robot, without I/O: samples in, actions on the log's files and its incidents' files out.

``receive_sample`` finds the route by the sample's key, decodes the sample, and appends protobuf records to the
current chunk; a sample that fits no subject is recorded as it is. ``tick`` hands the chunk over in time for
``flush_ns``, and ends a file that is long enough; the next sample begins another. While no file is open, chunks go
into the incidents' ring only.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Final

import msgspec

from recorder.encoding.routes import FastPath, Latest, Record, Route, keep_raw
from recorder.encoding.samples import SEQUENCE_SPAN, ReceivedSample
from recorder.encoding.viewers import (
    LINES,
    OUTLINE_NS,
    OUTLINES,
    TRANSFORM_NS,
    TRANSFORMS,
    Shown,
    log_record,
    outline_record,
    transform_record,
)
from recorder.mcap.writer import ChunkBuilder, LogChannel, log_time
from recorder.record.accounting import (
    COMPLETENESS_NAME,
    NO_REPORT,
    ChannelQuota,
    Channels,
    KeyReport,
    LossReport,
    since,
)
from recorder.record.actions import (
    Action,
    Announcement,
    CloseLog,
    DeclareChannel,
    Ended,
    LogAction,
    Lost,
    Opened,
    OpenLog,
    Query,
    SyncLog,
    WriteChunk,
    WriteMetadata,
    incident_begun,
    incident_cut,
    incident_refused,
    other_version,
)
from recorder.record.incidents import INCIDENT_NAME, Incidents
from recorder.record.robots import Backlog, Robots, Statements
from schemas import keys
from schemas.codec import names_schema
from schemas.command_line import short
from schemas.decisions import ArbiterState, EventKind, SafetyEvent, SafetyState, Severity, SignedStatement
from schemas.messages import CanFrames, GatewayHealth, GatewayInfo, Message, Odometry, RobotState
from schemas.recording import GapReason, RecorderEvent, RecordGap
from schemas.settings import OWNED_KEY_LIMIT, STANDSTILL_MPS
from schemas.subjects import BY_DBC_MESSAGE, BY_TYPE

if TYPE_CHECKING:
    from recorder.record.signed_mode import StatementProofs

INFO_MAX_BYTES: Final = 1_000_000
"""A larger answer of a gateway is recorded like any sample, but not repeated in later files."""

ROLL_MIN_NS: Final = 1_000_000_000
"""Shortest age of a file ended for its size, and shortest time between two requested files."""

CONTINUED_NAME: Final = "cruiser.continued"
"""Metadata record with the number of a log's file, and why the file before it ended."""

LATEST_NAME: Final = "cruiser.latest"
"""Metadata record with each topic's newest state when this file began, as JSON, with its log time.

Not messages: joining the files of a log must not repeat a message.
"""

GAPS_MAX: Final = 10_000  # gaps of all logs that wait to be reported

PENDING_EVENTS_MAX: Final = 1000
"""Recorder events that wait for a log's next file; the oldest beyond it are dropped."""

PENDING_GAPS_MAX: Final = 1000  # gaps that wait for a log's next file

ANNOUNCEMENTS_MAX: Final = 1000

VERSIONS_SAID_MAX: Final = 32  # announcements of samples from other versions


class LogPlan(msgspec.Struct, frozen=True):
    """The settings of a log.

    Attributes:
        chunk_bytes: a chunk is handed over at this size.
        flush_ns: at most this much of the log is lost in a crash.
        rotate_bytes, rotate_ns, idle_ns: end a file at this size, at this age, or after this long without a
            message; 0 is never.
        before_ns: length of the record before an incident.
        after_ns: an incident ends this long after the last alarm.
        proofs: makes the verifier of statements, if the recorder has the fleet's authority.
    """

    name: str
    chunk_bytes: int
    flush_ns: int
    version: str
    rotate_bytes: int = 0
    rotate_ns: int = 0
    idle_ns: int = 0
    alarms: frozenset[EventKind] = frozenset()
    before_ns: int = 0
    after_ns: int = 0
    proofs: Callable[[], StatementProofs] | None = None


class LogContext:
    """State that the logs of a recorder share.

    Attributes:
        losses: by log, until they are reported.
        left_out: why chunks are not written while no file is open; None is no loss.
    """

    def __init__(self) -> None:
        self.actions: list[Action] = []
        self.losses = LossReport(GAPS_MAX)
        self.fast_paths: dict[str, FastPath] = {}
        self.left_out: GapReason | None = None
        self.has_incident_room = True
        self.incidents = 0
        self.announcements: deque[Announcement] = deque(maxlen=ANNOUNCEMENTS_MAX)


_ODOMETRY: Final = BY_TYPE[Odometry].name


class _Pose:
    """A robot as viewers have it: the times of its newest transform and of its outline."""

    def __init__(self, latest: Latest) -> None:
        self.latest = latest
        self.drawn_ns = self.outlined_ns = -OUTLINE_NS
        self.outlined_in = 0  # the number of the file


class RobotLog:
    """The log of one robot, or the one log of all."""

    def __init__(self, plan: LogPlan, context: LogContext) -> None:
        self.name = plan.name
        self._plan = plan
        self._context = context
        self._chunk = ChunkBuilder(plan.chunk_bytes)
        self.channels = Channels(self._declare)
        self.incidents = Incidents(plan.name, plan.before_ns, plan.after_ns)
        self.robots = Robots(plan.name, plan.version)
        self.statements = Statements(plan.name, None if plan.proofs is None else plan.proofs())
        self._backlog = Backlog()
        self._counted: dict[str, KeyReport] = {}
        """Reports at the end of the previous file, from which the next one counts."""
        self._fast_keys: list[str] = []  # its keys that take the fast path, while a file is written
        self._poses: dict[str, _Pose] = {}  # by the key of the odometry
        self._pending_events: deque[tuple[str, RecorderEvent]] = deque(maxlen=PENDING_EVENTS_MAX)
        self._pending_gaps = LossReport(PENDING_GAPS_MAX)
        self._versions_said: set[str] = set()
        self.ended_ticks: dict[str, int] = {}
        """Ticks at which gateways reported a shutdown, by the key of their events."""
        self.is_open = False  # a file is requested and not ended; the disk may not have begun it yet
        self.is_paused = False  # no file is written, and none begun
        self.file = ""  # name of the open file without its directory; empty if there is none yet
        self.incident_file = ""  # likewise of the incident
        self._is_incident_announced = True
        self._linked_incident = ""  # the incident named in the current file
        self._files = 0
        self._is_awaited = False  # the disk has not begun the file yet: it must not be ended
        self._opened_ns = self._received_ns = 0
        self._rolled_ns: int | None = None
        self._roll_wanted = ""  # reason to end the file as soon as possible; empty if there is none
        self._ended_by = ""
        self._at_risk_since_ns: int | None = None
        # Half to collect messages, half for the ticks, the write and the sync.
        self._patience_ns = plan.flush_ns // 2

    # Samples

    def receive_sample(self, sample: ReceivedSample, now_ns: int, wall_ns: int) -> None:
        """Record a sample. Never raises, whatever the sample holds."""
        log_ns = log_time(wall_ns)
        if not self.is_open and not self.is_paused:
            self._open(now_ns, log_ns)
        route = self.channels.get(sample.key) or self._find_route(sample.key, now_ns)
        message = route.decode(sample)
        if isinstance(message, str):
            self._keep_raw(sample, message, route, now_ns, log_ns)
        elif self._follow(sample, message, route, now_ns, log_ns):
            if route.has_unknown_fields(sample) and (newer := route.understand(sample)) is not None:
                self._say_version(
                    route, f"fields of a newer version are not recorded ({', '.join(newer.unknown)})"
                )
            self._add(route, message.sequence, now_ns, log_ns, route.transcode(message))
        if self._at_risk_since_ns is None:
            self._at_risk_since_ns = self._received_ns = now_ns
        if self._chunk.is_full:
            self.hand_over(now_ns)

    def find_fast_path(self, key: str) -> None:
        """Put a key on its fast path, if it has one."""
        paths, route = self._context.fast_paths, self.channels.get(key)
        if not self.is_open or route is None or key in paths or len(paths) >= OWNED_KEY_LIMIT:
            return
        add = route.adder(self._chunk)
        if add is not None:
            paths[key] = route.encoding, add
            self._fast_keys.append(key)

    def drop_sample(self, key: str, reason: GapReason, now_ns: int, wall_ns: int) -> None:
        route = self.channels.get(key) or self._find_route(key, now_ns)
        route.counters.lose(reason, 1)
        self._context.losses.lose(self.name, key, reason, 1, wall_ns, wall_ns)

    def add_own(self, topic: str, message: RecorderEvent | RecordGap, now_ns: int) -> None:
        """Record a message of the recorder's own; if no file is open, in the next one."""
        if self.is_open:
            route = self.channels.declare(topic, BY_TYPE[type(message)], "", ChannelQuota.OWN)
            log_ns = log_time(message.time_ns)
            self._add(route, message.sequence, now_ns, log_ns, route.transcode(message))
            if isinstance(message, RecorderEvent):
                self._add_line(topic, message, now_ns, log_ns, ChannelQuota.OWN)
            if self._at_risk_since_ns is None:
                self._at_risk_since_ns = now_ns
        elif isinstance(message, RecorderEvent):
            self._pending_events.append((topic, message))
        else:
            self._pending_gaps.add(topic, message)

    def _follow(self, sample: ReceivedSample, message: Message, route: Route, now_ns: int, log_ns: int) -> bool:
        """Count a message, and act on its content. False if the log has it already."""
        if sample.is_reply and route.is_kept:
            was_missing, was_counted = self._backlog.receive_reply(sample.key, message.sequence, sample.payload)
            if was_counted:
                route.counters.find()
            if not was_missing:
                return False
        elif route.counts_sequence:
            is_restart = not route.counters.count_sequence(message.sequence)
            if is_restart:
                self.robots.see_restart(route.robot, now_ns)
            if route.is_kept:
                self._backlog.receive(sample.key, message.sequence, sample.payload, now_ns, is_restart=is_restart)
        if route.is_watched:
            self._watch(sample, message, route, now_ns, log_ns)
        if route.is_state:
            route.latest.log_ns, route.latest.message = log_ns, message
        return True

    def _keep_raw(self, sample: ReceivedSample, reason: str, route: Route, now_ns: int, log_ns: int) -> None:
        """Record a sample as it is, and count what can be decoded: a newer version may have sent it."""
        newer = route.understand(sample)
        if newer is not None and not self._follow(sample, newer.message, route, now_ns, log_ns):
            return
        if newer is not None:
            what = f"samples of a newer version are kept as they are ({', '.join(newer.unknown)})"
            self._say_version(route, what)
        elif route.subject is not None and sample.encoding != route.encoding and names_schema(sample.encoding):
            self._say_version(route, f"samples are kept as they are: {reason}", cure="")
        self._add_raw(sample, reason, route, now_ns, log_ns)

    def _say_version(self, route: Route, what: str, cure: str = ": upgrade the recorder") -> None:
        """Announce once what another version sends."""
        subject = route.subject.name if route.subject is not None else ""
        announcement = other_version(route.robot, subject, f"{what}{cure}")
        if announcement.text not in self._versions_said and len(self._versions_said) < VERSIONS_SAID_MAX:
            self._versions_said.add(announcement.text)
            self._context.announcements.append(announcement)

    def _add_raw(self, sample: ReceivedSample, reason: str, route: Route, now_ns: int, log_ns: int) -> None:
        if route.subject is not None:
            route = self.channels.declare_raw(sample.key)
        time_ns = log_time(sample.zenoh_time_ns)
        source, sequence = sample.source or ("", 0)
        if source and route.subject is None:
            route.counters.count_source(source, sequence)
        # Without a source time, use the time of receipt.
        records = [(time_ns or log_ns, keep_raw(sample, reason, time_ns))]
        self._add(route, sequence % SEQUENCE_SPAN, now_ns, log_ns, records)

    def _add(self, route: Route, sequence: int, now_ns: int, log_ns: int, records: Sequence[Record]) -> None:
        """Append the records of a sample, and hand each full chunk over."""
        for publish_ns, data in records:
            if self._chunk.is_full:
                self.hand_over(now_ns)
            self._chunk.add(route.channel_id, sequence, log_ns, publish_ns, data)
        route.counters.samples += 1
        route.counters.messages += len(records)

    def _add_line(
        self, key: str, event: SafetyEvent | RecorderEvent, now_ns: int, log_ns: int, quota: ChannelQuota
    ) -> None:
        parts = keys.parse(key)
        name = (parts.robot or parts.recorder) if parts else key
        self._add_shown(key, LINES, event, now_ns, log_ns, log_record(event, name), quota)

    def _add_shown(
        self, key: str, shown: Shown, message: Message, now_ns: int, log_ns: int, data: bytes, quota: ChannelQuota
    ) -> None:
        """Append what viewers draw of a message."""
        route = self.channels.declare_shown(key, shown, quota)
        if route is not None:
            self._add(route, message.sequence, now_ns, log_ns, [(message.time_ns, data)])

    def _draw(self, now_ns: int) -> None:
        """Append the newest pose of each robot, and its outline once a file and every ``OUTLINE_NS``.

        At ticks: odometry itself takes the fast path.
        """
        if not self.is_open and not self.is_paused:
            return
        for key, pose in self._poses.items():
            newest = pose.latest.message
            if not isinstance(newest, Odometry) or 0 <= newest.time_ns - pose.drawn_ns < TRANSFORM_NS:
                continue
            robot = key.removesuffix(f"/{_ODOMETRY}")
            log_ns, quota = pose.latest.log_ns, ChannelQuota.TABLE
            if pose.outlined_in != self._files or log_ns - pose.outlined_ns >= OUTLINE_NS:
                pose.outlined_in, pose.outlined_ns = self._files, log_ns
                outline = outline_record(newest.time_ns, robot)
                self._add_shown(key, OUTLINES, newest, now_ns, log_ns, outline, quota)
            pose.drawn_ns = newest.time_ns
            transform = transform_record(newest, robot)
            self._add_shown(key, TRANSFORMS, newest, now_ns, log_ns, transform, quota)

    def _watch(self, sample: ReceivedSample, message: Message, route: Route, now_ns: int, log_ns: int) -> None:
        """Act on a message that concerns the recorder itself."""
        if isinstance(message, CanFrames):
            route.counters.dropped = max(route.counters.dropped, message.dropped)
        elif isinstance(message, GatewayInfo):
            if len(sample.payload) <= INFO_MAX_BYTES:
                self._apply_all(self.robots.receive_info(route.robot, message, log_ns))
        elif isinstance(message, GatewayHealth):
            self._count_bus(sample.key, message)
        elif isinstance(message, SignedStatement):
            self.statements.receive(
                sample.key.removesuffix(f"/{BY_TYPE[SignedStatement].name}"), message.text, message.time_ns
            )
        elif isinstance(message, SafetyEvent):
            self._add_line(sample.key, message, now_ns, log_ns, ChannelQuota.TABLE)
            if message.kind is EventKind.GATEWAY:
                self.ended_ticks[sample.key] = message.tick
            # A replayed event is long past.
            is_alarm = message.kind in self._plan.alarms and message.severity is not Severity.INFO
            is_grave = message.severity is Severity.ERROR or not self._is_idle(sample.key)
            if is_alarm and is_grave and not sample.is_reply:
                self.raise_alarm(short(f"{message.kind.value}: {message.text}"), now_ns, log_ns)

    def _is_idle(self, event_key: str) -> bool:
        """Report whether the robot is known to stand by, without a lease, at standstill."""
        robot = event_key.removesuffix(BY_TYPE[SafetyEvent].name)
        routes = (self.channels.get(f"{robot}{BY_TYPE[kind].name}") for kind in (SafetyState, RobotState))
        arbiter, state = (None if route is None else route.latest.message for route in routes)
        if not isinstance(arbiter, SafetyState) or not isinstance(state, RobotState) or state.speed_mps is None:
            return False
        is_held = bool(arbiter.lease_holder) or arbiter.state is not ArbiterState.STANDBY
        return not is_held and abs(state.speed_mps) < STANDSTILL_MPS

    def _count_bus(self, key: str, health: GatewayHealth) -> None:
        parts = keys.parse(key)
        # Each name once: the list may hold a hundred thousand.
        for name, lost in {frame.name: frame.lost for frame in health.feedback}.items():
            subject = BY_DBC_MESSAGE.get(name)
            if parts is not None and subject is not None:
                of_frame = self.channels.get(keys.build(parts.root, parts.robot, subject))
                if of_frame is not None:
                    of_frame.counters.count_bus(lost)

    def _find_route(self, key: str, now_ns: int) -> Route:
        parts = keys.parse(key)
        if parts is None:
            return self.channels.declare(key, None, "")
        if not parts.robot:
            return self.channels.declare(key, parts.subject, "")
        robot = self.robots.see(parts.root, parts.robot, now_ns)
        self._backlog.see(parts.root, parts.robot, now_ns)
        quota = ChannelQuota.TABLE if self.robots.has_quota(robot, parts.bus) else ChannelQuota.OTHER
        route = self.channels.declare(key, parts.subject, robot, quota)
        if parts.subject.type is Odometry and quota is ChannelQuota.TABLE:
            self._poses[key] = _Pose(route.latest)
        return route

    # Chunks and files

    def tick(self, now_ns: int, file_bytes: int = 0) -> None:
        self.statements.tick()
        self._draw(now_ns)
        if self._at_risk_since_ns is None and len(self._chunk):
            # Samples that took the fast path since the last tick.
            self._at_risk_since_ns = self._received_ns = now_ns
        if self._chunk.is_full:
            self.hand_over(now_ns)
        waiting_ns = self._at_risk_since_ns
        if waiting_ns is not None and now_ns - waiting_ns >= self._patience_ns:
            self.hand_over(now_ns)
            self._sync()
            self._at_risk_since_ns = None
        if self.is_open and (reason := self._why_roll(now_ns, file_bytes)):
            self.roll(reason, now_ns)
        if self.incidents.is_over(now_ns):
            self.end_incident(now_ns)

    def roll(self, reason: str, now_ns: int) -> None:
        """End the open file; the next sample begins another. Requests within ROLL_MIN_NS are merged into one."""
        if self.is_open and (
            self._is_awaited or (self._rolled_ns is not None and now_ns - self._rolled_ns < ROLL_MIN_NS)
        ):
            self._roll_wanted = reason
            return
        if self.is_open:
            self._rolled_ns, self._ended_by = now_ns, reason
        self.close(now_ns)

    def pause(self, reason: str, now_ns: int) -> None:
        """End the file, and begin no other until ``resume``."""
        if self.is_open:
            self._ended_by = reason
        self.is_paused = True
        self.close(now_ns)

    def resume(self, now_ns: int) -> None:
        self.hand_over(now_ns)
        self.is_paused = False

    def hand_over(self, now_ns: int) -> None:
        """Hand the current chunk to the open file, if there is one, and to the incidents."""
        chunk = self._chunk.seal()
        if chunk is None:
            return
        if self.is_open:
            self._apply(WriteChunk(self.name, chunk))
        else:
            # A full disk is a loss; a stopped recorder is not.
            self._lose_written(chunk.counts, self._context.left_out, chunk.start_ns, chunk.end_ns)
        self._context.actions += self.incidents.add(chunk, now_ns)

    def queries(self, now_ns: int, most: int) -> list[Query]:
        """The due queries, at most ``most``: robot infos first, then stored samples."""
        queries = self.robots.queries(now_ns, most)
        return queries + self._backlog.queries(now_ns, most - len(queries))

    def ask_last(self, now_ns: int) -> None:
        """Make the last queries before ``close`` due."""
        self.robots.ask_last(now_ns)
        self._backlog.ask_last()

    def close(self, now_ns: int) -> None:
        self.hand_over(now_ns)
        if not self.is_open:
            return
        self._apply_all(self.robots.describe())
        before, self._counted = self._counted, self.channels.counts
        completeness = {
            topic: msgspec.json.encode(since(report, before.get(topic, NO_REPORT))).decode()
            for topic, report in self._counted.items()
        }
        self._apply(WriteMetadata(self.name, COMPLETENESS_NAME, completeness))
        self._apply(CloseLog(self.name))
        self.is_open = self._is_awaited = False
        self._roll_wanted = ""
        self._at_risk_since_ns = None
        for key in self._fast_keys:
            # The next sample of each key takes the slow path, which begins a file.
            del self._context.fast_paths[key]
        self._fast_keys.clear()

    def _why_roll(self, now_ns: int, file_bytes: int) -> str:
        """Return the reason to end the file now; empty if there is none."""
        age_ns = now_ns - self._opened_ns
        if 0 < self._plan.idle_ns <= now_ns - self._received_ns:
            return "silence"
        if 0 < self._plan.rotate_bytes <= file_bytes and age_ns >= ROLL_MIN_NS:
            return "size"
        if 0 < self._plan.rotate_ns <= age_ns:
            return "time"
        return self._roll_wanted

    def _open(self, now_ns: int, log_ns: int) -> None:
        self.is_open = self._is_awaited = True
        self._linked_incident = ""
        self._files += 1
        self._opened_ns = self._received_ns = now_ns
        self._apply(OpenLog(self.name, self.name, log_ns))
        self._describe()
        if self._files > 1:
            continued = {"file": str(self._files), "because": self._ended_by}
            self._apply(WriteMetadata(self.name, CONTINUED_NAME, continued))
            self._apply(WriteMetadata(self.name, LATEST_NAME, self.channels.latest))
        events, self._pending_events = self._pending_events, deque(maxlen=PENDING_EVENTS_MAX)
        for topic, event in events:
            self.add_own(topic, event, now_ns)
        for topic, gap in self._pending_gaps.take():
            self.add_own(topic, gap, now_ns)

    def _describe(self) -> None:
        """Write the metadata of the log's robots."""
        self._apply_all(self.robots.describe())
        self._apply_all(self.statements.describe())

    def _sync(self) -> None:
        if self.is_open:
            self._apply(SyncLog(self.name))
        if self.incidents.is_open:
            self._apply(SyncLog(self.incidents.log))

    def _declare(self, channel: LogChannel) -> None:
        self._apply(DeclareChannel(self.name, channel))

    def _apply(self, action: LogAction) -> None:
        """Queue an action on the log, and on the open incident if every file repeats it."""
        self._context.actions.append(action)
        if action.is_repeated and self.incidents.is_open:
            self._context.actions.append(msgspec.structs.replace(action, log=self.incidents.log))

    def _apply_all(self, actions: Iterable[LogAction]) -> None:
        for action in actions:
            self._apply(action)

    def _lose_written(self, counts: dict[int, int], reason: GapReason | None, first_ns: int, last_ns: int) -> None:
        for topic, count in self.channels.lose_written(counts, reason).items():
            if reason is not None:
                self._context.losses.lose(self.name, topic, reason, count, first_ns, last_ns)

    # Incidents

    def raise_alarm(self, because: str, now_ns: int, wall_ns: int) -> None:
        """Begin an incident, or announce that there is no space for it."""
        if self._context.has_incident_room:
            self.begin_incident(because, now_ns, wall_ns)
        else:
            self._context.announcements.append(incident_refused(self.name, because))

    def begin_incident(self, because: str, now_ns: int, wall_ns: int) -> None:
        """Begin an incident file with the ring, or extend the open one."""
        # Where no file has been begun yet, the robots have not been described.
        self._describe()
        actions = self.incidents.begin(now_ns, wall_ns, because, self.file if self.is_open else "")
        if actions:
            self._is_incident_announced = False
            self.incident_file = ""
            self._context.incidents += 1
        self._context.actions += actions

    def end_incident(self, now_ns: int) -> None:
        if self.incidents.is_open:
            # The current chunk was received in time.
            self.hand_over(now_ns)
            self._context.actions += self.incidents.close()

    def cut_incident(self, now_ns: int) -> None:
        """End the open incident, if any, because the disk is full."""
        if self.incidents.is_open:
            self.end_incident(now_ns)
            self._context.announcements.append(incident_cut(self.name, self.incident_file))

    # Notices of the disk

    def receive_opened(self, notice: Opened) -> Announcement | None:
        """Note that a file of the log or of its incident was begun. Returns an announcement, if any."""
        if notice.log == self.name:
            self.file = notice.file
            self._is_awaited = False
            self._context.actions += self.incidents.link_to(notice.file)
            if self.incidents.is_open and self.incident_file:
                self._link_to_incident()
            return None
        self.incident_file = notice.file
        if self._is_incident_announced:
            return None  # The incident goes on in another file, after a fault of the disk.
        self._is_incident_announced = True
        self._link_to_incident()
        return incident_begun(notice.file, self.incidents.about["because"])

    def receive_ended(self, notice: Ended) -> None:
        """Note that a file of the log or of its incident is complete."""
        if notice.log == self.name and self.file == notice.file:
            self.file = ""
        elif self.incident_file == notice.file:
            self.incident_file = ""

    def receive_lost(self, lost: Lost) -> None:
        """Count messages that the disk lost. Those of an incident may still be in the log."""
        if lost.log == self.name:
            self._lose_written(lost.counts, GapReason.DISK, lost.first_ns, lost.last_ns)

    def _link_to_incident(self) -> None:
        if self.is_open and self._linked_incident != self.incident_file:
            self._linked_incident = self.incident_file
            entries = {**self.incidents.about, "file": self.incident_file}
            self._apply(WriteMetadata(self.name, INCIDENT_NAME, entries))
