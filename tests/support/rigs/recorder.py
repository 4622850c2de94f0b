"""A recorder without I/O, with a writer in memory and a clock, and what its files hold."""

from io import BytesIO
from typing import Final

import msgspec
from mcap.reader import make_reader

from recorder.encoding.samples import ReceivedSample
from recorder.mcap.writer import unnumbered
from recorder.record.actions import INCIDENT_MARK, DiskRoom
from recorder.record.recorder import Recorder, RecorderPlan
from recorder.record.robot_log import LogPlan
from schemas import keys
from schemas.decisions import EventKind, SafetyEvent
from schemas.messages import Gear
from schemas.recording import RecorderEvent, RecordGap
from tests.support.fakes.recording import RECORDER_PLAN, MemoryFile, MemoryWriter
from tests.support.messages import MS, ROOT, SECOND, WALL_NS, FakeSample, key_of

OTHERS: Final = "others"  # the log for keys of no robot
PLAN: Final = msgspec.structs.replace(
    RECORDER_PLAN,
    log=LogPlan(
        OTHERS,
        300,
        SECOND // 2,
        "0.1.0",
        alarms=frozenset({EventKind.STOP}),
        before_ns=2 * SECOND,
        after_ns=2 * SECOND,
    ),
    sample_max_bytes=1000,
)
GEAR_KEY = key_of(Gear)
EVENT_KEY = key_of(SafetyEvent)
OWN = keys.of_recorder(ROOT, "bench")


class RecorderRig:
    def __init__(self, plan: RecorderPlan = PLAN) -> None:
        self.recorder = Recorder(plan)
        self.writer = MemoryWriter()
        self.now_ns = 0

    @property
    def wall_ns(self) -> int:
        return WALL_NS + self.now_ns

    def receive(self, *samples: ReceivedSample) -> None:
        self.writer.apply(self.recorder.receive(map(self._now, samples), self.now_ns))

    def _now(self, sample: ReceivedSample) -> ReceivedSample:
        assert isinstance(sample, FakeSample)
        return msgspec.structs.replace(sample, received_ns=self.wall_ns)

    def tick(self) -> None:
        self.writer.apply(self.recorder.tick(self.now_ns, self.wall_ns, {}))
        self.writer.apply(self.recorder.ask(self.now_ns))

    def run(self, span_ns: int) -> None:
        end_ns = self.now_ns + span_ns
        while self.now_ns < end_ns:
            self.now_ns = min(end_ns, self.now_ns + 10 * MS)
            self.tick()
            self.notice()

    def notice(self) -> None:
        while self.writer.notices:
            notice = self.writer.notices.pop(0)
            self.writer.apply(self.recorder.receive_notice(notice, self.now_ns, self.wall_ns))

    def mark(self, robot: str = "", because: str = "it shook") -> dict[str, str]:
        marked, actions = self.recorder.mark(robot, because, self.now_ns, self.wall_ns)
        self.writer.apply(actions)
        return marked

    def room(self, *, has_room: bool = True, has_incident_room: bool = True, roll: bool = False) -> None:
        room = DiskRoom(has_room, has_incident_room, roll)
        self.writer.apply(self.recorder.receive_notice(room, self.now_ns, self.wall_ns))

    def close(self) -> None:
        self.writer.apply(self.recorder.close(self.now_ns, self.wall_ns))
        self.notice()

    def events(self) -> list[RecorderEvent]:
        return [one for one in self.writer.said if isinstance(one, RecorderEvent)]

    def gaps(self) -> list[RecordGap]:
        return [one for one in self.writer.said if isinstance(one, RecordGap)]

    def logs(self) -> dict[str, list[MemoryFile]]:
        return {log: files for log, files in self.writer.files.items() if not log.endswith(INCIDENT_MARK)}


def messages(file: MemoryFile) -> list[tuple[str, int]]:
    """Topic and log time of each message of a file, as the mcap package reads them."""
    reader = make_reader(BytesIO(file.disk.getvalue()), validate_crcs=True)
    return [(channel.topic, one.log_time) for _, channel, one in reader.iter_messages(log_time_order=False)]


def times(file: MemoryFile, topic: str = GEAR_KEY) -> list[int]:
    """When a file's messages of a topic were received, since the beginning."""
    return [time_ns - WALL_NS for found, time_ns in messages(file) if found == topic]


def metadata(file: MemoryFile, name: str) -> list[dict[str, str]]:
    reader = make_reader(BytesIO(file.disk.getvalue()), validate_crcs=True)
    return [one.metadata for one in reader.iter_metadata() if unnumbered(one.name) == name]
