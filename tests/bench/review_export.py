"""Export of a log to Parquet, in messages a second: our columns against the `mcap` package's reader.

The peer is what a user would write first: `mcap` reads, `mcap-protobuf-support` decodes, `pyarrow` builds tables
of the same columns and writes them with the same compression. Both take the same log, in turns. The log is a drive
as the gateway's core tells it (see `recorder_load`), written by the recorder's own log.
"""

from __future__ import annotations

import tempfile
import time
from operator import attrgetter
from pathlib import Path
from statistics import median
from typing import Any, Final

import pyarrow as pa
import pyarrow.parquet as pq
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from recorder.mcap.writer import McapFile
from recorder.reading.logs import Faults, find_logs
from recorder.record.actions import LogAction
from recorder.record.robot_log import LogContext, LogPlan, RobotLog
from recorder.review.columns import TIME_TYPE
from recorder.review.export import COMPRESSION, COMPRESSION_LEVEL, ExportRange, export_dataset
from schemas import keys
from schemas.settings import TICK_NS
from schemas.subjects import BY_NAME
from tests.bench.loads import Row
from tests.bench.recorder_load import _SEQUENCE_KEY, _STAMP, _TIME_KEY, BUS, ROOT, SLOTS, make_script
from tests.bench.review_rate import ask
from tests.support.frames import WALL_NS
from tests.support.messages import FakeSample

GOAL_PER_S: Final = 1_000_000
PEER_ROWS: Final = 100_000
"""Rows that the peer gathers before it makes a table of them."""


def write_log(path: Path, messages: int, robot: str = "cruiser-1") -> int:
    """A log of so many messages at least. Returns how many."""
    script = make_script()
    context = LogContext()
    log = RobotLog(LogPlan(name=robot, chunk_bytes=1_000_000, flush_ns=500_000_000, version="0.1.0"), context)
    names = [keys.build(ROOT, robot, BY_NAME[name], BUS if "{bus}" in name else "") for name in script.subjects]
    encodings = [BY_NAME[name].encoding for name in script.subjects]
    sequences = [0] * len(names)
    with path.open("wb") as stream:
        file = McapFile(stream, "bench")
        tick = written = 0
        while written < messages:
            now_ns = tick * TICK_NS
            wall_ns = WALL_NS + now_ns
            for said in script.slots[tick % SLOTS]:
                number = said.subject
                stamp = _STAMP.pack(_TIME_KEY, b"\xcf", wall_ns, _SEQUENCE_KEY, b"\xce", sequences[number])
                sequences[number] += 1
                sample = FakeSample(names[number], encodings[number], said.head + stamp + said.tail)
                log.receive_sample(sample, now_ns, wall_ns)
                written += said.records
            log.tick(now_ns)
            _apply(file, context)
            tick += 1
        log.close(tick * TICK_NS)
        _apply(file, context)
    return file.messages


def _apply(file: McapFile, context: LogContext) -> None:
    for action in context.actions:
        if isinstance(action, LogAction):
            action.write_to(file)
    context.actions.clear()


def export_ours(log: Path, directory: Path) -> int:
    faults = Faults()
    done = export_dataset(find_logs([log], faults), directory, ExportRange(), faults)
    assert not faults
    return done.rows


class _PeerTable:
    """The rows of one topic, as a user would gather them."""

    def __init__(self, path: Path, descriptor: Any) -> None:  # noqa: ANN401 - protobuf makes the class at run time
        self._path = path
        self._fields = list(descriptor.fields)
        self._get = attrgetter(*[field.name for field in self._fields])
        self._optional = [field.name for field in self._fields if field.has_presence]
        self._rows: list[tuple[Any, ...]] = []
        self._writer: pq.ParquetWriter | None = None

    def add(self, message: Any, decoded: Any) -> None:  # noqa: ANN401
        self._rows.append((message.log_time, message.publish_time, message.sequence, decoded, *self._get(decoded)))
        if len(self._rows) >= PEER_ROWS:
            self.flush()

    def flush(self) -> None:
        columns = list(zip(*self._rows, strict=True))
        decoded = columns[3]
        arrays = [
            pa.array(columns[0], TIME_TYPE),
            pa.array(columns[1], TIME_TYPE),
            pa.array(columns[2], pa.int64()),
        ]
        for field, values in zip(self._fields, columns[4:], strict=True):
            arrays.append(self._array(field, values, decoded))
        names = ["log_time", "publish_time", "record_sequence", *(field.name for field in self._fields)]
        table = pa.table(arrays, names)
        if self._writer is None:
            self._writer = pq.ParquetWriter(
                self._path, table.schema, compression=COMPRESSION, compression_level=COMPRESSION_LEVEL
            )
        self._writer.write_table(table)
        self._rows.clear()

    def close(self) -> None:
        if self._rows:
            self.flush()
        if self._writer is not None:
            self._writer.close()

    def _array(self, field: Any, values: Any, decoded: Any) -> pa.Array:  # noqa: ANN401
        if field.enum_type is not None:
            names = {number: value.name for number, value in field.enum_type.values_by_number.items()}
            if field.is_repeated:
                return pa.array(
                    [[names.get(one, str(one)) for one in row] for row in values], pa.list_(pa.string())
                )
            return pa.array([names.get(one, str(one)) for one in values]).dictionary_encode()
        if field.message_type is not None and field.message_type.GetOptions().map_entry:
            return pa.array([list(row.items()) for row in values], pa.map_(pa.string(), pa.int64()))
        if field.message_type is not None:
            return pa.array([str(row) for row in values])
        if field.is_repeated:
            return pa.array([list(row) for row in values])
        if field.has_presence:
            name = field.name
            kept = [one if row.HasField(name) else None for one, row in zip(values, decoded, strict=True)]
            return pa.array(kept)
        return pa.array(values)


def export_peer(log: Path, directory: Path) -> int:
    directory.mkdir()
    tables: dict[int, _PeerTable] = {}
    count = 0
    with log.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages(log_time_order=False):
            table = tables.get(channel.id)
            if table is None:
                path = directory / f"{channel.id}.parquet"
                table = tables[channel.id] = _PeerTable(path, decoded.DESCRIPTOR)
            table.add(message, decoded)
            count += 1
    for table in tables.values():
        table.close()
    return count


def rows(messages: int, rounds: int) -> list[Row]:
    """Both in turns; medians of the rounds, and the ratios are those of each round."""
    with tempfile.TemporaryDirectory() as name:
        root = Path(name)
        log = root / "drive.mcap"
        count = write_log(log, messages)
        export_ours(log, root / "warm")
        rounds_s = []
        for number in range(rounds):
            pair = []
            for run, word in ((export_ours, "ours"), (export_peer, "peer")):
                begin_s, begin_cpu_s = time.perf_counter(), time.process_time()
                assert run(log, root / f"{word}-{number}") == count
                pair += [time.perf_counter() - begin_s, time.process_time() - begin_cpu_s]
            rounds_s.append(pair)
        alone = ask(["export", str(log), "--out", str(root / "alone")])
    ours_s, ours_cpu_s, peer_s, peer_cpu_s = (median(column) for column in zip(*rounds_s, strict=True))
    ratio, cpu_ratio = (median(one[place + 2] / one[place] for one in rounds_s) for place in (0, 1))
    return [
        (
            f"export of {count} messages to Parquet",
            f"{count / ours_s / 1e6:.2f} million messages/s, {ours_cpu_s / count * 1e6:.2f} us CPU",
            f"{GOAL_PER_S / 1e6:g} million",
        ),
        (
            "  by mcap, mcap-protobuf-support, pyarrow",
            f"{count / peer_s / 1e6:.3f} million messages/s, {peer_cpu_s / count * 1e6:.1f} us CPU",
            "",
        ),
        ("  ratio, and of CPU", f"{ratio:.0f} x, {cpu_ratio:.0f} x", ""),
        ("  peak memory of the command", f"{alone.peak_mb:.0f} MB", "300 MB"),
    ]
