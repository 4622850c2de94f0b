"""The review on a large log: seconds and memory of each question in a process of its own.

The log is a minute with two operators, faults and stops, repeated.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from resource import RUSAGE_CHILDREN, getrusage
from typing import Final

import msgspec

from recorder.mcap.writer import ChunkBuilder, LogChannel, McapFile
from recorder.reading.logs import Faults, look_at
from recorder.reading.rows import Row as LogRow
from recorder.reading.rows import Selection, read_rows
from schemas.messages import Variant
from tests.bench.loads import Row
from tests.support.rigs.day import MINUTE_TICKS, Day

CHUNK_BYTES: Final = 1 << 20
MINUTE_NS: Final = 60_000_000_000
LAG_NS: Final = 1_000_000
CRUISER: Final = Path(sys.executable).with_name("cruiser")
MEMORY_MB: Final = 300
LOOK_S: Final = 0.02

QUESTIONS: Final[dict[str, list[str]]] = {
    "info": ["info"],
    "check": ["check", "--json"],
    "events": ["events", "--json"],
    "export": ["export", "--out", "dataset"],
}


class Asked(msgspec.Struct, frozen=True):
    """Cost of a question: seconds, processor time, peak memory of its processes."""

    seconds: float
    cpu_s: float
    peak_mb: float


def rows(megabytes: int) -> list[Row]:
    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory) / "cruiser-1-20260102T030405Z.mcap"
        messages = write_log(path, megabytes * 1_000_000)
        size_mb = path.stat().st_size / 1e6
        found: list[Row] = [("log of the review", f"{size_mb:.0f} MB, {messages:,} messages", "")]
        for name, words in QUESTIONS.items():
            asked = ask([*words, str(path)], path.parent)
            figure = f"{asked.seconds:.1f} s, {messages / asked.seconds:,.0f} messages/s, {asked.peak_mb:.0f} MB"
            found.append((f"review {name}", figure, f"under {MEMORY_MB} MB"))
    return found


def ask(words: list[str], directory: Path) -> Asked:
    begun, before_s, peak_kb = time.perf_counter(), _children_cpu_s(), 0
    with subprocess.Popen([CRUISER, "review", *words], cwd=directory, stdout=subprocess.DEVNULL) as process:
        # What the kernel tells at the end counts this process's own memory too, which the child was begun with.
        while process.poll() is None:
            peak_kb = max(peak_kb, _peak_kb(process.pid))
            time.sleep(LOOK_S)
    # Findings are an answer too: much happens in these logs.
    if process.returncode not in {0, 1}:
        raise SystemExit(f"cruiser review {' '.join(words)} ended with {process.returncode}")
    return Asked(time.perf_counter() - begun, _children_cpu_s() - before_s, peak_kb / 1000)


def _children_cpu_s() -> float:
    used = getrusage(RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _peak_kb(pid: int) -> int:
    """Peak memory of a process and its children; 0 if it has ended."""
    with suppress(OSError):
        status = Path(f"/proc/{pid}/status").read_text(encoding="utf-8")
        own_kb = next((int(line.split()[1]) for line in status.splitlines() if line.startswith("VmHWM")), 0)
        return own_kb + sum(map(_peak_kb, _children(pid)))
    return 0


def _children(pid: int) -> list[int]:
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            # Behind the name in brackets: the state, and the parent.
            if int(stat.read_text(encoding="utf-8").rpartition(")")[2].split()[1]) == pid:
                found.append(int(stat.parent.name))
    return found


def write_log(path: Path, size: int) -> int:
    """Write a log of at least this size. Returns its number of messages."""
    minute = _minute()
    topics = {row.topic.name: row.topic for row in minute}
    ids = {name: number for number, name in enumerate(topics, start=1)}
    count = 0
    with path.open("wb", buffering=0) as stream:
        file = McapFile(stream, "bench")
        for name, topic in topics.items():
            file.add_channel(LogChannel(ids[name], name, topic.schema, topic.schema_data))
        builder = ChunkBuilder(CHUNK_BYTES)
        for row in _repeated(minute, path, size):
            builder.add(ids[row.topic.name], row.sequence, row.log_ns, row.publish_ns, row.data)
            count += 1
            if builder.is_full:
                _write(file, builder)
        _write(file, builder)
        file.finish()
    return count


def _minute() -> list[LogRow]:
    day = Day(1, Variant.COARSE, MINUTE_TICKS)
    day.live()
    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory) / "minute.mcap"
        path.write_bytes(day.rig.log())
        return list(read_rows([look_at(path)], Selection(), Faults()))


def _repeated(minute: list[LogRow], path: Path, size: int) -> Iterator[LogRow]:
    """The same minute again and again, each time later."""
    spans = {row.topic.name: row.sequence + 1 for row in minute}
    turn = 0
    while path.stat().st_size < size:
        for number, row in enumerate(minute):
            later_ns = turn * MINUTE_NS
            # The minute's own clock steps now and then; here time goes on.
            log_ns = minute[0].log_ns + later_ns + number * MINUTE_NS // len(minute)
            sequence = (row.sequence + turn * spans[row.topic.name]) % 2**32
            yield LogRow(row.topic, sequence, log_ns, log_ns - LAG_NS, row.data)
        turn += 1


def _write(file: McapFile, builder: ChunkBuilder) -> None:
    chunk = builder.seal()
    if chunk is not None:
        file.write_chunk(chunk)
