"""Makers of logs: as a recorder writes them, chunk by chunk, as others write them, and damaged ones."""

import errno
from collections.abc import Iterable
from io import BytesIO
from itertools import count
from pathlib import Path
from typing import Any

import msgspec
from mcap.reader import make_reader
from mcap.records import Message as McapMessage
from mcap.writer import CompressionType, IndexType, Writer
from mcap_protobuf.decoder import DecoderFactory

from recorder.encoding.protobuf import compile_encoder, descriptor_set, schema_name
from recorder.encoding.samples import ReceivedSample
from recorder.encoding.viewers import SHOWN
from recorder.mcap.writer import Chunk as PackedMessages
from recorder.mcap.writer import ChunkBuilder, LogChannel, McapFile
from recorder.record.actions import QUERIES_PER_TICK, Action, LogAction, Opened, OpenLog, Query
from recorder.record.robot_log import LogContext, LogPlan, RobotLog
from schemas.messages import Gear
from schemas.recording import RecorderEvent, RecordGap
from tests.support.messages import MS, SECOND, WALL_NS, FakeSample, batch, feedback, gear, info, sample_of

PLAN = LogPlan(
    name="cruiser-1",
    chunk_bytes=262_144,
    flush_ns=SECOND // 2,
    version="0.1.0",
    before_ns=30 * SECOND,
    after_ns=30 * SECOND,
)


class Disk(BytesIO):
    """A stream with limited capacity, which takes at most so many bytes in one write."""

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


class Log:
    """One robot's log, written into memory; stores the actions on it."""

    def __init__(self, plan: LogPlan = PLAN) -> None:
        self.context = LogContext()
        self.log = RobotLog(plan, self.context)
        self.disk = Disk()
        self.done: list[Action] = []  # all actions, those on incidents included
        self._file: McapFile | None = None

    def receive(self, *samples: ReceivedSample, now_ns: int = 0, wall_ns: int = WALL_NS) -> list[Action]:
        for sample in samples:
            self.log.receive_sample(sample, now_ns, wall_ns)
        return self.apply()

    def tick(self, now_ns: int, file_bytes: int = 0) -> list[Action]:
        self.log.tick(now_ns, file_bytes)
        return self.apply()

    def ask(self, now_ns: int, most: int = QUERIES_PER_TICK) -> list[Query]:
        return self.log.queries(now_ns, most)

    def add_own(self, topic: str, message: RecorderEvent | RecordGap, now_ns: int = 0) -> list[Action]:
        self.log.add_own(topic, message, now_ns)
        return self.apply()

    def close(self, now_ns: int = 0) -> bytes:
        self.log.close(now_ns)
        self.apply()
        return self.disk.getvalue()

    def apply(self) -> list[Action]:
        """Apply and return the actions since the last call."""
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


def small_log() -> bytes:
    """A whole log: a few messages of each kind, metadata and attachments."""
    log = Log()
    log.receive(*(sample_of(gear(number)) for number in range(5)))
    log.receive(sample_of(batch(0, [(WALL_NS + number * 10 * MS, feedback(number)) for number in range(5)])))
    log.tick(SECOND)
    log.receive(FakeSample("fleet/elsewhere", "text/plain", b"hello"), sample_of(info()))
    return log.close()


def flipped(data: bytes, place: int | None = None, bits: int = 4) -> bytes:
    """The log with bits flipped there, or in its first compressed chunk."""
    place = data.index(b"zstd") + 30 if place is None else place
    return data[:place] + bytes([data[place] ^ bits]) + data[place + 1 :]


def logs_in(directory: Path) -> list[str]:
    return sorted(path.name for path in directory.iterdir())


def channel_of(kind: type[msgspec.Struct], channel_id: int = 1, topic: str = "t") -> LogChannel:
    return LogChannel(channel_id, topic, schema_name(kind), descriptor_set(kind))


def encoded(message: msgspec.Struct) -> bytes:
    return compile_encoder(type(message))(message)


GEAR_TOPIC = "fleet/cruiser-1/chassis/gear"
GEAR_CHANNEL = LogChannel(1, GEAR_TOPIC, schema_name(Gear), descriptor_set(Gear))
ENCODE_GEAR = compile_encoder(Gear)

Chunk = list[tuple[int, int, int, bytes]]  # channel, sequence, log time (equal to the publish time), data


def gear_message(sequence: int, log_ns: int, channel_id: int = 1) -> tuple[int, int, int, bytes]:
    return channel_id, sequence, log_ns, ENCODE_GEAR(gear(sequence, log_ns))


def gears(first: int, count: int, start_ns: int, step_ns: int = 10) -> Chunk:
    return [gear_message(first + number, start_ns + number * step_ns) for number in range(count)]


def sealed(messages: Iterable[tuple[int, int, int, int, bytes]]) -> PackedMessages:
    """A chunk of messages: channel, sequence, log time, publish time, data."""
    builder = ChunkBuilder()
    for message in messages:
        builder.add(*message)
    chunk = builder.seal()
    assert chunk is not None
    return chunk


def mcap_log(
    channels: Iterable[LogChannel],
    chunks: Iterable[Iterable[tuple[int, int, int, int, bytes]]],
    metadata: Iterable[tuple[str, dict[str, str]]] = (),
    attachments: Iterable[tuple[str, bytes]] = (),
    *,
    disk: Disk | None = None,
) -> bytes:
    """A log of chunks of messages: channel, sequence, log time, publish time, data."""
    disk = disk or Disk()
    file = McapFile(disk, "test")
    for channel in channels:
        file.add_channel(channel)
    for name, entries in metadata:
        file.add_metadata(name, entries)
    for name, data in attachments:
        file.add_attachment(name, "text/plain", data, 5)
    for messages in chunks:
        if made := list(messages):
            file.write_chunk(sealed(made))
    file.finish()
    return disk.getvalue()


def own_log(
    chunks: Iterable[Chunk],
    channels: Iterable[LogChannel] = (GEAR_CHANNEL,),
    metadata: Iterable[tuple[str, dict[str, str]]] = (),
    attachments: Iterable[tuple[str, bytes]] = (),
) -> bytes:
    """A log of chunks whose messages are published when they are logged; of gears by default."""
    timed = ([(one, number, ns, ns, data) for one, number, ns, data in chunk] for chunk in chunks)
    return mcap_log(channels, timed, metadata, attachments)


def numbered_log(channels: Iterable[LogChannel], chunks: Iterable[Iterable[tuple[int, bytes]]]) -> bytes:
    """A log of chunks of channel and data: one a nanosecond, published in reverse order."""
    numbers = count()
    timed = (
        [(one, n := next(numbers), WALL_NS + n, WALL_NS - n, data) for one, data in chunk] for chunk in chunks
    )
    return mcap_log(channels, timed)


def foreign_log(
    times: Iterable[int] = range(10),
    *,
    encoding: str = "json",
    schema: tuple[str, str, bytes] | None = ("thing", "jsonschema", b"{}"),
    data: bytes = b"{}",
    topic: str = "/t",
    compression: CompressionType = CompressionType.ZSTD,
    profile: str = "",
    **given: Any,  # noqa: ANN401 - the writer's own arguments
) -> bytes:
    """A file of the mcap package's writer: schemas and channels are inside its chunks."""
    stream = BytesIO()
    writer = Writer(stream, compression=compression, **given)
    writer.start(profile)
    schema_id = 0 if schema is None else writer.register_schema(*schema)
    channel = writer.register_channel(topic, encoding, schema_id, {"who": "else"})
    for number, time_ns in enumerate(times):
        writer.add_message(channel, time_ns, data, time_ns, number)
    writer.add_attachment(3, 4, "note", "text/plain", b"as it were")
    writer.add_metadata("origin", {"by": "somebody"})
    writer.finish()
    return stream.getvalue()


NO_INDEXES = IndexType.NONE


def saved(path: Path, data: bytes) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)
    return path


def read_records(data: bytes, *, lines: bool = False) -> list[tuple[str, str, McapMessage, Any]]:
    """Topic, schema, record and content of every message; ``lines`` adds what is there for viewers."""
    reader = make_reader(BytesIO(data), validate_crcs=True, decoder_factories=[DecoderFactory()])
    return [
        (channel.topic, schema.name if schema else "", message, content)
        for schema, channel, message, content in reader.iter_decoded_messages(log_time_order=False)
        if schema is not None and (lines or schema.name not in {shown.schema_name for shown in SHOWN})
    ]
