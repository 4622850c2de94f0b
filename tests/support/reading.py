"""What is in a log: as the mcap package reads it, as our own reader does, and as a report sums it up."""

from pathlib import Path
from typing import Any

import msgspec
from mcap import records
from mcap.reader import make_reader

from recorder.encoding.protobuf import compile_encoder, descriptor_set, schema_name
from recorder.reading.logs import Faults, LogFile, find_logs
from recorder.reading.rows import Row, Selection, read_rows
from recorder.reading.topics import Topic, topic_of
from recorder.review.entries import Entry, EntryKind, EntrySource
from recorder.review.report.findings import Report
from recorder.review.report.gather import read_report
from schemas.decisions import Severity
from schemas.messages import CanFrame, RawSample
from tests.support.messages import ROBOT, WALL_NS


class Read:
    """A file as the mcap package reads it, every checksum verified."""

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


def rows_of(*paths: Path) -> list[Row]:
    return list(read_rows(logs_of(*paths), Selection(), Faults()))


def logs_of(*paths: Path) -> list[LogFile]:
    return find_logs(paths, Faults())


def topic(name: str, kind: type[msgspec.Struct] = CanFrame) -> Topic:
    channel = records.Channel(1, name, "protobuf", {}, 1)
    return topic_of(channel, records.Schema(1, descriptor_set(kind), "protobuf", schema_name(kind)))


_FRAME = compile_encoder(CanFrame)
_RAW = compile_encoder(RawSample)


def row_of(of: Topic, frame: CanFrame, sequence: int = 0, log_ns: int = WALL_NS) -> Row:
    return Row(of, sequence, log_ns, frame.time_ns, _FRAME(frame))


def raw_row(of: Topic, raw: RawSample) -> Row:
    """The row of a sample that was stored undecoded."""
    return Row(of, 0, WALL_NS, WALL_NS, _RAW(raw))


def report_of(*paths: Path, faults: Faults | None = None) -> Report:
    told = Faults() if faults is None else faults
    return read_report(find_logs(paths, told), Selection(), told, version="0.1.0")


def entry(kind: EntryKind, time_ns: int, text: str = "", **fields: Any) -> Entry:  # noqa: ANN401 - any field
    plain = Entry(
        time_ns=time_ns,
        last_ns=time_ns,
        robot=ROBOT,
        kind=kind,
        severity=Severity.WARNING,
        source=EntrySource.EVENT,
        text=text,
    )
    return msgspec.structs.replace(plain, **fields)
