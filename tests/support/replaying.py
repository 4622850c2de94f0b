"""Logs to be replayed, on the disk and in memory; a clock and an outlet that do what a test says."""

from collections.abc import Sequence
from pathlib import Path
from typing import Generic, TypeVar

import msgspec
from mcap import records

from recorder.encoding.protobuf_schema import descriptor_set, schema_name
from recorder.encoding.received_sample import ReceivedSample
from recorder.encoding.transcode import compile_encoder
from recorder.reading.faults import Faults
from recorder.reading.log_file import LogFile
from recorder.reading.logs import find_logs
from recorder.reading.rows import Row, Selection, read_rows
from recorder.reading.topics import Topic, topic_of
from recorder.replay.controls import Order, ReplayControls
from recorder.replay.run import Halt, ReplayClock
from schemas.exit_codes import ExitCode
from schemas.messages import CanFrame, RawSample
from tests.support.recorder_fakes import (
    MS,
    SECOND,
    WALL_NS,
    FakeSample,
    Log,
    batch,
    feedback,
    gear,
    info,
    sample_of,
)

T = TypeVar("T")

HALT = Halt("it is over", ExitCode.UNREACHABLE)
STEP_NS = 10 * MS
"""Between the messages of ``drive``."""


def drive(count: int = 20, root: str = "fleet", robot: str = "cruiser-1") -> list[ReceivedSample]:
    """What a robot says: gears, with two frames each, and who it is; and somebody else."""
    found: list[ReceivedSample] = [sample_of(info(), robot, root)]
    for number in range(count):
        time_ns = WALL_NS + number * STEP_NS
        frames = [(time_ns - 3 * MS, feedback(2 * number)), (time_ns - MS, feedback(2 * number + 1))]
        found += [
            sample_of(gear(number, time_ns), robot, root),
            sample_of(batch(number, frames), robot, root),
        ]
    return [*found, FakeSample(f"{root}/elsewhere", "text/plain", b"hello", attachment=b"with this")]


def log_of(samples: Sequence[ReceivedSample], offset_ns: int = 0) -> bytes:
    """A log of samples, each received a step after the one before."""
    log = Log()
    for number, sample in enumerate(samples):
        log.receive(sample, now_ns=number * STEP_NS, wall_ns=WALL_NS + offset_ns + number * STEP_NS)
    return log.close()


def write_log(path: Path, samples: Sequence[ReceivedSample], offset_ns: int = 0) -> Path:
    """The same in a file."""
    path.write_bytes(log_of(samples, offset_ns))
    return path


def rows_of(*paths: Path) -> list[Row]:
    """All rows of logs."""
    return list(read_rows(logs_of(*paths), Selection(), Faults()))


def logs_of(*paths: Path) -> list[LogFile]:
    """The logs at these paths."""
    return find_logs(paths, Faults())


def topic(name: str, kind: type[msgspec.Struct] = CanFrame) -> Topic:
    """The topic of one file; another call gives that of another file."""
    channel = records.Channel(1, name, "protobuf", {}, 1)
    return topic_of(channel, records.Schema(1, descriptor_set(kind), "protobuf", schema_name(kind)))


_FRAME = compile_encoder(CanFrame)
_RAW = compile_encoder(RawSample)


def can_frame(
    identifier: int = 0x18C4D1EF,
    time_ns: int = WALL_NS,
    data: bytes = b"\1\2\3\4\5\6\7\x08",
    *,
    is_extended: bool = True,
    is_remote: bool = False,
    is_error: bool = False,
    is_fd: bool = False,
) -> CanFrame:
    """A frame as a log has it."""
    return CanFrame(
        time_ns=time_ns,
        bus="can0",
        identifier=identifier,
        is_extended=is_extended,
        is_remote=is_remote,
        is_error=is_error,
        is_fd=is_fd,
        bitrate_switch=False,
        error_state_indicator=False,
        dlc=len(data),
        data=data,
    )


def row_of(of: Topic, frame: CanFrame, sequence: int = 0, log_ns: int = WALL_NS) -> Row:
    """A frame's row."""
    return Row(of, sequence, log_ns, frame.time_ns, _FRAME(frame))


def raw_row(of: Topic, raw: RawSample) -> Row:
    """The row of a sample that was kept as it was."""
    return Row(of, 0, WALL_NS, WALL_NS, _RAW(raw))


class FakeClock(ReplayClock):
    """Time passes while somebody waits, and while the outlet works."""

    def __init__(self) -> None:
        self.now_ns = 77 * SECOND
        self.slept: list[int] = []

    def monotonic_ns(self) -> int:
        return self.now_ns

    def wall_ns(self) -> int:
        return self.now_ns + 2 * WALL_NS

    def sleep(self, duration_ns: int) -> None:
        assert duration_ns > 0, "waits for nothing"
        self.slept.append(duration_ns)
        self.now_ns += duration_ns


class FakeOutlet(Generic[T]):
    """Takes what is sent, with the time and the shift; refuses, and takes its time, on demand."""

    def __init__(self, clock: FakeClock) -> None:
        self._clock = clock
        self.sent = self.failed = 0
        self.got: list[tuple[int, T, int]] = []
        self.takes_ns = 0
        """How long a send takes."""
        self.halts_at_ns: int | None = None
        """When it cannot go on any more."""
        self.attended: list[int] = []

    def send(self, item: T, shift_ns: int) -> None:
        self.got.append((self._clock.now_ns, item, shift_ns))
        self._clock.now_ns += self.takes_ns
        self.sent += 1

    def attend(self) -> Halt | None:
        self.attended.append(self._clock.now_ns)
        if self.halts_at_ns is not None and self._clock.now_ns >= self.halts_at_ns:
            return HALT
        return None

    def close(self) -> None:
        """Nothing to give back."""


class FakeControls(ReplayControls):
    """Gives orders at its times; remembers what it was shown."""

    def __init__(self, clock: FakeClock, *orders: tuple[int, Order]) -> None:
        self._clock = clock
        self._orders = list(orders)
        self.shown: list[tuple[int | None, bool]] = []

    def orders(self) -> list[Order]:
        due = [order for at_ns, order in self._orders if at_ns <= self._clock.now_ns]
        self._orders = [(at_ns, order) for at_ns, order in self._orders if at_ns > self._clock.now_ns]
        return due

    def show(self, time_ns: int | None, *, is_paused: bool) -> None:
        self.shown.append((time_ns, is_paused))
