"""Files to review: of ours, of others, and damaged ones."""

from collections.abc import Iterable
from io import BytesIO
from pathlib import Path
from typing import Any

from mcap import records
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer

from recorder.encoding.protobuf_schema import descriptor_set, schema_name
from recorder.encoding.transcode import compile_encoder
from recorder.mcap.channel import LogChannel
from recorder.mcap.chunk import Chunk as PackedMessages
from recorder.mcap.chunk import ChunkBuilder
from recorder.mcap.framing import encode
from recorder.mcap.writer import McapFile
from schemas.messages import Gear
from tests.support.recorder_fakes import Disk, gear

GEAR_TOPIC = "fleet/cruiser-1/chassis/gear"
GEAR_CHANNEL = LogChannel(1, GEAR_TOPIC, schema_name(Gear), descriptor_set(Gear))
ENCODE_GEAR = compile_encoder(Gear)

Chunk = list[tuple[int, int, int, bytes]]
"""Messages of a chunk: channel, sequence, log time, data. They are published when they are logged."""


def gear_message(sequence: int, log_ns: int, channel_id: int = 1) -> tuple[int, int, int, bytes]:
    """A message of a chunk."""
    return channel_id, sequence, log_ns, ENCODE_GEAR(gear(sequence, log_ns))


def gears(first: int, count: int, start_ns: int, step_ns: int = 10) -> Chunk:
    """A chunk of so many gear messages."""
    return [gear_message(first + number, start_ns + number * step_ns) for number in range(count)]


def sealed(messages: Iterable[tuple[int, int, int, int, bytes]]) -> PackedMessages:
    """A chunk to be written: channel, sequence, log time, publish time and data of each message."""
    builder = ChunkBuilder()
    for message in messages:
        builder.add(*message)
    chunk = builder.seal()
    assert chunk is not None
    return chunk


def own_log(
    chunks: Iterable[Chunk],
    channels: Iterable[LogChannel] = (GEAR_CHANNEL,),
    metadata: Iterable[tuple[str, dict[str, str]]] = (),
    attachments: Iterable[tuple[str, bytes]] = (),
) -> bytes:
    """A whole log with these chunks."""
    disk = Disk()
    file = McapFile(disk, "test")
    for channel in channels:
        file.add_channel(channel)
    for name, entries in metadata:
        file.add_metadata(name, entries)
    for name, data in attachments:
        file.add_attachment(name, "text/plain", data, 5)
    for messages in chunks:
        file.write_chunk(sealed((one[0], one[1], one[2], one[2], one[3]) for one in messages))
    file.finish()
    return disk.getvalue()


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
    """A file of the mcap package's writer: schemas and channels stand in its chunks."""
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
    """The file with this content."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)
    return path


class Read:
    """What the mcap package reads of a file, every checksum verified."""

    def __init__(self, path: Path) -> None:
        with path.open("rb") as stream:
            reader = make_reader(stream, validate_crcs=True)
            summary = reader.get_summary()
            assert summary is not None
            assert summary.statistics is not None
            self.statistics = summary.statistics
            self.header = reader.get_header()
            self.channels = list(summary.channels.values())
            self.schemas = summary.schemas
            self.metadata = list(reader.iter_metadata())
            self.attachments = list(reader.iter_attachments())
            self.messages = [
                (channel.topic, message.sequence, message.log_time, message.publish_time, message.data)
                for _, channel, message in reader.iter_messages(log_time_order=False)
            ]


def with_record_replaced(data: bytes, before: records.McapRecord, after: records.McapRecord) -> bytes:
    """The file with another record, of the same length, in the place of one."""
    old, new = encode(before), encode(after)
    assert len(old) == len(new)
    assert data.count(old) == 1
    return data.replace(old, new)
