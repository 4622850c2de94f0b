"""A part of a log, as a log."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from fnmatch import fnmatchcase
from importlib.metadata import version
from pathlib import Path
from typing import BinaryIO, Final

import msgspec
from mcap import records

from recorder.disk.files import new_file
from recorder.mcap.reader import (
    FIRST_RECORD,
    DamagedError,
    Fault,
    LoggedMessage,
    MessageBlock,
    PackedChunk,
    read_pieces,
    record_at,
)
from recorder.mcap.summary_reader import read_summary
from recorder.mcap.writer import ChunkBuilder, LogChannel, McapFile
from recorder.reading.logs import Faults, LogFile
from recorder.reading.rows import Progress, Selection
from recorder.reading.survey import FORMER_DIGEST
from recorder.review.info import CUT_NAME
from schemas.command_line import CommandError, ExitCode

CHUNK_BYTES: Final = 1 << 20

Part = LogChannel | LoggedMessage | records.Metadata | records.Attachment


class CutLog(msgspec.Struct, frozen=True):
    """The result of a cut.

    Attributes:
        path: the new file.
        start_ns, end_ns: the first and the last log time; None if it holds no message.
    """

    path: str
    bytes: int
    channels: int
    messages: int
    start_ns: int | None
    end_ns: int | None


def cut(
    log: LogFile,
    path: Path,
    selection: Selection,
    topics: Sequence[str],
    faults: Faults,
    progress: Progress = lambda _: None,
) -> CutLog:
    """Write the messages of a time and of some topics into a new file, with all metadata and attachments.

    Args:
        log: the log, whose order the new file keeps.
        path: the new file.
        selection: its log times are wanted; what topics are, the patterns say.
        topics: patterns, as a shell has them; ``*`` matches any part of a topic. None for all topics.
        faults: takes what cannot be read; all the rest is in the file.
        progress: receives the number of bytes that were read.

    Raises:
        CommandError: the file is there already, or cannot be written, or no topic is of the patterns.
    """
    about = {
        "files": log.path.name,
        "from_ns": str(selection.from_ns),
        "to_ns": str(selection.to_ns),
        "topics": " ".join(topics),
    }
    reading = _Reading(log, selection, topics, faults)
    with new_file(path) as out:
        file = McapFile(out, f"cruiser-gateway {version('cruiser-gateway')}", reading.profile())
        builder = ChunkBuilder(CHUNK_BYTES)
        times: list[int] = []

        def write_chunk() -> None:
            chunk = builder.seal()
            if chunk is not None:
                file.write_chunk(chunk)
                times.extend((chunk.start_ns, chunk.end_ns))

        for one in reading.parts(progress):
            match one:
                case LoggedMessage():
                    builder.add(one.channel_id, one.sequence, one.log_ns, one.publish_ns, one.data)
                    if builder.is_full:
                        write_chunk()
                case LogChannel():
                    file.add_channel(one)
                case records.Metadata():
                    file.add_metadata(one.name, one.metadata)
                case records.Attachment():
                    file.add_attachment(one.name, one.media_type, one.data, one.log_time, one.create_time)
        if topics and not reading.wanted:
            raise CommandError("no topic is of these patterns", ExitCode.USAGE)
        write_chunk()
        file.add_metadata(CUT_NAME, about)
        file.finish()
    return CutLog(
        path=str(path),
        bytes=file.size,
        channels=len(reading.wanted),
        messages=file.messages,
        start_ns=min(times, default=None),
        end_ns=max(times, default=None),
    )


class _Reading:
    """Reads what goes into the part, in the order of the file.

    Attributes:
        wanted: ids of the channels that go into it, as far as they are known.
    """

    def __init__(self, log: LogFile, selection: Selection, topics: Sequence[str], faults: Faults) -> None:
        self._log, self._selection, self._topics, self._faults = log, selection, topics, faults
        self._schemas: dict[int, records.Schema] = {}
        self._known: set[int] = set()
        self.wanted: set[int] = set()

    def profile(self) -> str:
        """Return the promise of the file's header; nothing where that cannot be read."""
        header = None
        with suppress(OSError, DamagedError), self._log.open() as stream:
            header = record_at(stream, FIRST_RECORD, records.Header)
        return "" if header is None else str(header.profile)

    def parts(self, progress: Progress) -> Iterator[Part]:
        """The channels, messages, metadata and attachments."""
        try:
            with self._log.open() as stream:
                yield from self._parts(stream, progress)
        except OSError as error:
            self._faults.add(f"{self._log.name}: {error.strerror or error}")

    def _parts(self, stream: BinaryIO, progress: Progress) -> Iterator[Part]:
        summary = read_summary(stream)
        if summary is not None:
            # Others declare channels within chunks, which may be passed over.
            yield from self._sift([*summary.schemas.values(), *summary.channels.values()])
        read_to = 0
        for piece in read_pieces(stream, self._log.bytes, is_verifying=False):
            match piece:
                case PackedChunk():
                    if self._may_hold_some(piece):
                        yield from self._sift(piece.messages())
                    progress(piece.end - read_to)
                    read_to = piece.end
                case MessageBlock():
                    yield from self._sift(piece.messages())
                case records.Metadata():
                    yield piece
                case records.Attachment() if piece.name != FORMER_DIGEST:
                    yield piece
                case Fault() if piece.cuts and self._log.is_being_written:
                    pass
                case Fault() | records.Schema() | records.Channel():
                    yield from self._sift([piece])
                case _:
                    pass
        progress(self._log.bytes - read_to)

    def _may_hold_some(self, chunk: PackedChunk) -> bool:
        """Return False for a chunk whose message indexes say that it holds nothing wanted."""
        if chunk.index is None:
            return True
        is_of_time = chunk.start_ns < self._selection.to_ns and chunk.end_ns >= self._selection.from_ns
        return is_of_time and any(one in self.wanted or one not in self._known for one in chunk.index)

    def _sift(self, found: Iterable[LoggedMessage | records.Schema | records.Channel | Fault]) -> Iterator[Part]:
        from_ns, to_ns = self._selection.from_ns, self._selection.to_ns
        for one in found:
            match one:
                case LoggedMessage():
                    if one.channel_id in self.wanted and from_ns <= one.log_ns < to_ns:
                        yield one
                    elif one.channel_id not in self._known:
                        detail = f"messages of channel {one.channel_id}, which the file does not hold"
                        self._faults.add(f"{self._log.name}: {detail}")
                case Fault():
                    self._faults.add(f"{self._log.name}: byte {one.offset}: {one.detail}")
                case records.Schema():
                    self._schemas.setdefault(one.id, one)
                case records.Channel() if one.id not in self._known:
                    self._known.add(one.id)
                    if not self._topics or any(fnmatchcase(one.topic, pattern) for pattern in self._topics):
                        self.wanted.add(one.id)
                        yield self._channel(one)
                case _:
                    pass

    def _channel(self, channel: records.Channel) -> LogChannel:
        schema = self._schemas.get(channel.schema_id)
        return LogChannel(
            channel_id=channel.id,
            topic=channel.topic,
            schema_name="" if schema is None else schema.name,
            schema_data=b"" if schema is None else schema.data,
            schema_encoding="" if schema is None else schema.encoding,
            message_encoding=channel.message_encoding,
            metadata=channel.metadata,
        )
