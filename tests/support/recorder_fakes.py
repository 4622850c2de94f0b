"""Samples, disks that fail on demand, and sources that need no Zenoh."""

import errno
import os
import stat
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable
from functools import partial
from io import BytesIO
from itertools import islice
from pathlib import Path

import msgspec
import pytest

from recorder.disk.part_file import Prologue
from recorder.encoding.received_sample import ReceivedSample
from recorder.mcap.writer import McapFile
from recorder.record.actions import Action, CloseLog, DeclareChannel, LogAction, OpenLog, Publish, WriteChunk
from recorder.record.notices import Ended, Lost, Notice, Opened
from recorder.record.orders import OperatorRequest
from recorder.record.recorder import RecorderPlan
from recorder.record.robot_log import LogContext, LogPlan, RobotLog
from schemas import codec, keys
from schemas.can_word import EXTENDED
from schemas.codec import PayloadFault
from schemas.decisions import ArbiterState, EventKind, SafetyEvent, SafetyState, Severity, StopPhase
from schemas.messages import CanFrames, GatewayInfo, Gear, GearPosition, Message, Variant
from schemas.reasons import Reason
from schemas.recording import BackfillPiece, RecorderEvent, RecorderReply, RecordGap
from schemas.requests import Request, Role
from schemas.subjects import BY_TYPE

ROOT = "fleet"
ROBOT = "cruiser-1"
WALL_NS = 1_800_000_000_000_000_000
SECOND = 1_000_000_000
MS = 1_000_000
PLAN = LogPlan(
    name="cruiser-1",
    chunk_bytes=262_144,
    flush_ns=SECOND // 2,
    version="0.1.0",
    before_ns=30 * SECOND,
    after_ns=30 * SECOND,
)
RECORDER_PLAN = RecorderPlan(
    root=ROOT, recorder="bench", per_robot=True, log=PLAN, ring_bytes=1_000_000, sample_max_bytes=1_000_000
)

GEAR_FEEDBACK = 0x18C4D1EF

SAFETY_STATE = SafetyState(
    time_ns=WALL_NS, sequence=0, tick=0, state=ArbiterState.STANDBY,
    engaged=False, stop_reason=Reason.NONE, stop_phase=StopPhase.IDLE, lease_holder="",
    lease_role=Role.PROGRAM, lease_expires_s=0.0, latched=[], blocked_by=[], guarded=True, speed_limit_mps=1.0,
    acceleration_limit_mps2=0.8, deceleration_limit_mps2=1.2, emergency_deceleration_mps2=2.0,
    steering_limit_deg=24.0, steering_rate_limit_degps=60.0, lateral_acceleration_limit_mps2=1.5,
    target_speed_mps=0.0, target_angle_deg=0.0, output_speed_mps=0.0, output_angle_deg=0.0,
    output_gear=GearPosition.UNDEFINED, brake_pedal_percent=0.0, parking=False,
    challenge=bytes(8),
    link_age_s=None, link_age_last_s=None, link_age_p50_s=None, link_age_p99_s=None, travel_delay_m=0.0,
    travel_speed_limit_mps=None, deadman_s=0.3, accepted_seq=None, stop_detail="",
)  # fmt: skip
"""An arbiter that stands by."""


class FakeSample(msgspec.Struct, frozen=True):
    """A sample that never was on Zenoh."""

    key: str
    encoding: str
    payload: bytes
    attachment: bytes = b""
    zenoh_time_ns: int = 0
    deleted: bool = False
    source: tuple[str, int] | None = None
    received_ns: int = WALL_NS
    is_reply: bool = False


def key_of(kind: type[Message], robot: str = ROBOT, root: str = ROOT) -> str:
    """The key of a subject's samples."""
    subject = BY_TYPE[kind]
    return keys.build(root, robot, subject, "can0" if "{bus}" in subject.name else "")


def sample_of(message: Message, robot: str = ROBOT, root: str = ROOT) -> ReceivedSample:
    """The sample that a gateway publishes of a message."""
    kind = type(message)
    return FakeSample(key_of(kind, robot, root), BY_TYPE[kind].encoding, codec.encode(message))


def gear(sequence: int, time_ns: int = WALL_NS) -> Gear:
    """A gear message."""
    return Gear(
        time_ns=time_ns,
        sequence=sequence,
        alive_counter=sequence % 16,
        active=True,
        gear_position=GearPosition.DRIVE,
    )


def feedback(counter: int) -> bytes:
    """A gear feedback frame's data, checksum included."""
    data = bytes([1, 4, 0, 0, 0, 0, counter % 16 << 4])
    checksum = 0
    for byte in data:
        checksum ^= byte
    return data + bytes([checksum])


def batch(sequence: int, frames: list[tuple[int, bytes]], dropped: int = 0) -> CanFrames:
    """A batch of gear feedback frames: receive time and data of each."""
    return CanFrames(
        time_ns=WALL_NS,
        sequence=sequence,
        bus="can0",
        dropped=dropped,
        frame_time_ns=[time_ns for time_ns, _ in frames],
        can_id=[EXTENDED | GEAR_FEEDBACK] * len(frames),
        fd_flags=[0] * len(frames),
        length=[len(data) for _, data in frames],
        data=[data for _, data in frames],
    )


def safety_event(kind: EventKind, severity: Severity = Severity.WARNING, sequence: int = 0) -> SafetyEvent:
    """What a gateway says when something happens."""
    return SafetyEvent(WALL_NS, sequence, 0, severity, kind, Reason.NONE, "", "as it were")


def info(variant: Variant = Variant.COARSE, sequence: int = 0, dbc: str = 'VERSION "1"\n') -> GatewayInfo:
    """A gateway's answer."""
    return GatewayInfo(
        time_ns=WALL_NS,
        sequence=sequence,
        robot=ROBOT,
        bus="can0",
        listen_only=True,
        started_ns=WALL_NS - SECOND,
        variant=variant,
        versions={"cruiser-gateway": "0.1.0"},
        configuration="[can]\n",
        configuration_sha256="ab" * 32,
        dbc_name="cruiser-coarse.dbc",
        dbc=dbc,
        schemas={"cruiser.Gear": "{}"},
    )


class Disk(BytesIO):
    """A stream with so much room, which takes at most so many bytes in one write."""

    def __init__(self, room: int | None = None, at_once: int | None = None) -> None:
        super().__init__()
        self.room = room
        self.at_once = at_once

    def write(self, data: memoryview | bytes, /) -> int:  # type: ignore[override]  # the fewer types the clearer
        data = memoryview(data)[: self.at_once]
        if self.room is not None:
            data = data[: max(0, self.room - self.tell())]
            if not data:
                raise OSError(errno.ENOSPC, "No space left on device")
        return super().write(data)


class SlowDisk:
    """Syncs of files that wait, and may then fail, on demand; those of directories do not."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.goes_on = threading.Event()
        self.goes_on.set()
        self.fails = False
        self.asked: list[int] = []
        """The length of the file at each sync."""
        for name in ("fdatasync", "fsync"):
            monkeypatch.setattr(os, name, partial(self._sync, getattr(os, name)))

    def _sync(self, how: Callable[[int], None], descriptor: int) -> None:
        status = os.fstat(descriptor)
        if stat.S_ISREG(status.st_mode):
            self.asked.append(status.st_size)
            assert self.goes_on.wait(60)
            if self.fails:
                raise OSError(errno.EIO, os.strerror(errno.EIO))
        how(descriptor)


class Log:
    """One robot's log, written into memory. Remembers the actions on it."""

    def __init__(self, plan: LogPlan = PLAN) -> None:
        self.context = LogContext()
        self.log = RobotLog(plan, self.context)
        self.disk = Disk()
        self.done: list[Action] = []
        """All actions, those on incidents included."""
        self._file: McapFile | None = None

    def receive(self, *samples: ReceivedSample, now_ns: int = 0, wall_ns: int = WALL_NS) -> list[Action]:
        for sample in samples:
            self.log.receive_sample(sample, now_ns, wall_ns)
        return self.apply()

    def tick(self, now_ns: int, file_bytes: int = 0) -> list[Action]:
        self.log.tick(now_ns, file_bytes)
        return self.apply()

    def add_own(self, topic: str, message: RecorderEvent | RecordGap, now_ns: int = 0) -> list[Action]:
        self.log.add_own(topic, message, now_ns)
        return self.apply()

    def close(self, now_ns: int = 0) -> bytes:
        """Close the log; the bytes of its file."""
        self.log.close(now_ns)
        self.apply()
        return self.disk.getvalue()

    def apply(self) -> list[Action]:
        """Apply what the log has asked for since the last call, and return it."""
        actions, self.context.actions = self.context.actions, []
        self.done += actions
        for action in actions:
            if not isinstance(action, LogAction) or action.log != self.log.name:
                continue
            if isinstance(action, OpenLog):
                assert self._file is None, "opened twice"
                self._file = McapFile(self.disk, "test")
                self.log.receive_opened(Opened(action.log, f"{action.name}.mcap"))
            else:
                assert self._file is not None, "written before it is open"
                action.write_to(self._file)
        return actions


class MemoryFile:
    """A file in memory."""

    def __init__(self, name: str, opened: OpenLog) -> None:
        self.name = name
        self.opened = opened
        self.disk = Disk()
        self.mcap = McapFile(self.disk, "test")
        self.is_ended = False


class MemoryWriter:
    """Writes the files of several logs into memory, as the writer's thread does; loses chunks on demand."""

    def __init__(self) -> None:
        self.files: dict[str, list[MemoryFile]] = {}
        """Of each log."""
        self.said: list[RecorderEvent | RecordGap] = []
        self.notices: list[Notice] = []
        self.loses = False
        """Chunks are lost, but for those of incidents."""
        self.lost: Counter[tuple[str, int]] = Counter()
        """How many messages of those there were, by topic and log time: a sample of many may lose a part."""
        self._prologues: dict[str, Prologue] = {}
        self._topics: dict[tuple[str, int], str] = {}

    def apply(self, actions: Iterable[Action]) -> None:
        for action in actions:
            if isinstance(action, LogAction):
                self._apply(action)
            elif isinstance(action, Publish):
                self.said.append(action.message)

    def open_file(self, log: str) -> MemoryFile | None:
        """The file that is being written."""
        files = self.files.get(log)
        return files[-1] if files and not files[-1].is_ended else None

    def _apply(self, action: LogAction) -> None:
        log = action.log
        file = self.open_file(log)
        if isinstance(action, OpenLog):
            assert file is None, "opened twice"
            files = self.files.setdefault(log, [])
            file = MemoryFile(f"{action.name}-{len(files)}{'.incident' * action.is_incident}.mcap", action)
            files.append(file)
            if action.is_incident:
                self._prologues[log] = self._prologues[action.name].copy()
            self._prologues.setdefault(log, Prologue()).write_to(file.mcap)
            self.notices.append(Opened(log, file.name))
            return
        self._prologues.setdefault(log, Prologue()).add(action)
        if isinstance(action, DeclareChannel):
            self._topics[log, action.channel.channel_id] = action.channel.topic
        if isinstance(action, WriteChunk):
            assert file is not None, "written before it is open"
            if self.loses and not file.opened.is_incident:
                self._lose(action)
                return
        if file is not None:
            action.write_to(file.mcap)
            if isinstance(action, CloseLog):
                file.is_ended = True
                self.notices.append(Ended(log, file.name, file.mcap.size))

    def _lose(self, action: WriteChunk) -> None:
        chunk = action.chunk
        for channel_id, entries in chunk.index.items():
            self.lost.update((self._topics[action.log, channel_id], time_ns) for time_ns in entries[::2])
        self.notices.append(Lost(action.log, chunk.counts, chunk.start_ns, chunk.end_ns))


def small_log() -> bytes:
    """A whole log of a few messages of each sort, with metadata and attachments."""
    log = Log()
    log.receive(*(sample_of(gear(number)) for number in range(5)))
    log.receive(sample_of(batch(0, [(WALL_NS + number * 10 * MS, feedback(number)) for number in range(5)])))
    log.tick(SECOND)
    log.receive(FakeSample("fleet/elsewhere", "text/plain", b"hello"), sample_of(info()))
    return log.close()


class FakeSource:
    """A source that brings these samples, and answers the queries on a key with its replies, the last for ever."""

    def __init__(
        self, samples: Iterable[ReceivedSample] = (), replies: dict[str, list[ReceivedSample]] | None = None
    ) -> None:
        self.asked: list[str] = []
        self._samples = iter(samples)
        self._replies = replies or {}
        self._answers: list[ReceivedSample] = []
        self.is_exhausted = self.is_behind = False

    @property
    def is_asking(self) -> bool:
        return bool(self._answers)

    @property
    def is_connected(self) -> bool:
        return not self.is_exhausted

    def tokens_gone(self) -> list[str]:
        return []

    def drain(self, limit: int) -> list[ReceivedSample]:
        taken = list(islice(self._samples, limit))
        self.is_behind = len(taken) == limit
        if not self.is_behind:
            self.is_exhausted = True
        answers, self._answers = self._answers, []
        return [*taken, *answers]

    def ask(self, key: str, parameters: str = "") -> None:
        if parameters:
            return
        self.asked.append(key)
        if key in self._replies:
            replies = self._replies[key]
            self._answers.append(replies.pop(0) if len(replies) > 1 else replies[0])


class FakeAsked:
    """A request that remembers what it was told."""

    def __init__(self, request: Request | PayloadFault) -> None:
        self.asked = OperatorRequest("operator-1", request, self.reply, self.done)
        self.replies: list[RecorderReply | BackfillPiece] = []
        self.is_done = False

    def reply(self, answer: RecorderReply | BackfillPiece) -> None:
        assert not self.is_done
        self.replies.append(answer)

    def done(self) -> None:
        assert not self.is_done
        self.is_done = True

    @property
    def answer(self) -> RecorderReply:
        """The one reply, after which nothing comes."""
        assert self.is_done
        (answer,) = self.replies
        assert isinstance(answer, RecorderReply)
        return answer


DEADLINE_S = 60.0


def wait_until(condition: Callable[[], bool], deadline_s: float = DEADLINE_S) -> None:
    """Wait for a condition; fail when it does not come true in time."""
    end = time.monotonic() + deadline_s
    while not condition():
        assert time.monotonic() < end, "it did not come true in time"
        time.sleep(0.01)


def logs_in(directory: Path) -> list[str]:
    """The names of the files in a directory."""
    return sorted(path.name for path in directory.iterdir())
