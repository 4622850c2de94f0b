"""Memory use of every question, whatever size the chunks of a log claim."""

import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Final

import pytest
import zstandard
from mcap import records
from mcap.opcode import Opcode

from recorder.mcap.framing import MESSAGE_HEADER, MESSAGE_OPCODE, RECORD_HEADER, UNPACKED_MAX, encode
from tests.support.logs import small_log
from tests.support.nights import by_night
from tests.unit.recorder.cli.test_faulty_logs import READERS, WRITE

BYTES_MAX: Final = 1_000_000_000
"""As docs/threats.md promises."""

ASK: Final = """
import re, sys
from pathlib import Path
from gateway.cli.main import main
try:
    main()
finally:
    print(re.search(r"VmHWM:\\s+(\\d+) kB", Path("/proc/self/status").read_text())[1])
"""
"""Asks, and says at its end how much memory it had at most."""


def zeros(_number: int) -> bytes:
    return bytes(UNPACKED_MAX)


def tiny(_number: int) -> bytes:
    size = MESSAGE_HEADER.size
    record = MESSAGE_HEADER.pack(MESSAGE_OPCODE, size - RECORD_HEADER.size, 1, 0, 1, 1)
    return record * (UNPACKED_MAX // size)


def channels(_number: int) -> bytes:
    record = RECORD_HEADER.pack(Opcode.CHANNEL, 16) + struct.pack("<HHIII", 999, 0, 0, 0, 0)
    return record * (UNPACKED_MAX // len(record))


def schemas(number: int) -> bytes:
    length = UNPACKED_MAX - RECORD_HEADER.size
    head = struct.pack("<HIII", 1000 + number, 0, 0, length - 14)
    return RECORD_HEADER.pack(Opcode.SCHEMA, length) + head + bytes(length - len(head))


def bomb(content: Callable[[int], bytes], chunks: int) -> bytes:
    """A log cut off, with such chunks in place of its end."""
    log = small_log()
    parts = [log[: log.index(encode(records.DataEnd(0))[: RECORD_HEADER.size])]]
    for number in range(chunks):
        made = content(number)
        parts.append(encode(records.Chunk("zstd", zstandard.compress(made), 2, 1, 0, len(made))))
    return b"".join(parts)


BOMBS: Final = ((zeros, 16), (tiny, 3), (channels, 3), (schemas, 16))
BY_DAY: Final = {("check", zeros), ("check", tiny), ("info", schemas)}
MORE: Final = {"rerun": ("--processes", "1"), "recover": ("-o", "out.mcap")}


@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    ("question", "content", "chunks"),
    [
        row if (row[0], row[1]) in BY_DAY else by_night(*row)
        for row in [(question, *bomb) for question in [*READERS, "rerun", "recover"] for bomb in BOMBS]
    ],
)
def test_no_log_fills_the_memory(
    tmp_path: Path, question: str, content: Callable[[int], bytes], chunks: int
) -> None:
    """A few hundred kilobytes that promise gigabytes."""
    path = tmp_path / "bomb.mcap"
    path.write_bytes(bomb(content, chunks))
    assert path.stat().st_size < 2_000_000
    words = ["review", question, str(path), *WRITE.get(question, ()), *MORE.get(question, ())]
    done = subprocess.run(
        [sys.executable, "-c", ASK, *words], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert 1024 * int(done.stdout.split()[-1]) < BYTES_MAX, done.stderr
