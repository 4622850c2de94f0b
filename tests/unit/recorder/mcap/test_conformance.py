"""Anything that MCAP's specification allows is read, and is no damage; a copy of damage has all readable data."""

from __future__ import annotations

import hashlib
import json
import struct
import zlib
from collections import Counter
from io import BytesIO
from pathlib import Path
from typing import Final

import lz4.frame
import pytest
import zstandard
from hypothesis import example, given
from hypothesis import strategies as st
from mcap.writer import CompressionType, Writer

from recorder.mcap.reader import LoggedMessage
from recorder.mcap.recovery import copy_good, survey
from recorder.reading.logs import Faults, LogFile
from recorder.reading.rows import LogReader, Selection
from schemas.command_line import ExitCode
from tests.support.commands import review
from tests.support.walking import walk

HASHES: Final = Path(__file__).parents[3] / "data" / "mcap-conformance.txt"

MAGIC: Final = b"\x89MCAP0\r\n"
UNPADDED: Final = frozenset({2, 5, 6, 15})
"""Footer, message, chunk and the end of the data have no further fields where other records have some."""
TEN: Final = (0, 2, 1, 3, 3, 5, 4, 7, 8, 9)


def hashes() -> dict[str, str]:
    """SHA-256 of each variant, ``CASE-feature-feature``, in hexadecimal."""
    pairs = (line.split() for line in HASHES.read_text("ascii").splitlines())
    return dict(pairs)


def make(variant: str) -> bytes:
    case, *features = variant.split("-")
    has = frozenset(features)

    def record(opcode: int, body: bytes, *, inside: bool = False) -> bytes:
        body += b"\x01\xff\xff" if "pad" in has and not inside and opcode not in UNPADDED else b""
        return struct.pack("<BQ", opcode, len(body)) + body

    fields = _sized(_text("foo") + _text("bar"))
    schema, channel, messages = _records(case, fields)
    times = [log_ns for log_ns, _ in messages]
    is_packed = "ch" in has
    declared = [(3, schema)] * bool(schema) + [(4, channel)] * bool(channel)
    content, index = b"".join(record(*one, inside=is_packed) for one in declared), b""
    for log_ns, body in messages:
        index += struct.pack("<QQ", log_ns, len(content))
        content += record(5, body)
    data = MAGIC + record(1, _text("") + _text(""))
    places = {8: b"", 10: b"", 13: b""}
    if case == "OneAttachment":
        body = struct.pack("<QQ", 2, 1) + _text("myFile") + _text("application/octet-stream")
        body += struct.pack("<Q", 3) + b"\1\2\3"
        attachment = record(9, body + struct.pack("<I", zlib.crc32(body)))
        place = struct.pack("<QQQQQ", len(data), len(attachment), 2, 1, 3)
        places[10] = record(10, place + _text("myFile") + _text("application/octet-stream")) * ("ax" in has)
        data += attachment
    if case == "OneMetadata":
        metadata = record(12, _text("myMetadata") + fields)
        place = struct.pack("<QQ", len(data), len(metadata)) + _text("myMetadata")
        places[13] = record(13, place) * ("mdx" in has)
        data += metadata
    if is_packed:
        span = struct.pack("<QQ", min(times), max(times))
        sizes = struct.pack("<QI", len(content), zlib.crc32(content))
        chunk = record(6, span + sizes + _text("") + struct.pack("<Q", len(content)) + content)
        indexes = record(7, struct.pack("<H", 1) + _sized(index)) * ("mx" in has)
        entries = struct.pack("<HQ", 1, len(data) + len(chunk)) if indexes else b""
        place = span + struct.pack("<QQ", len(data), len(chunk)) + _sized(entries)
        place += struct.pack("<Q", len(indexes)) + _text("") + struct.pack("<QQ", len(content), len(content))
        places[8] = record(8, place) * ("chx" in has)
        data += chunk + indexes
    else:
        data += content
    data += record(15, struct.pack("<I", zlib.crc32(data)))
    counts = [bool(schema), bool(channel), case == "OneAttachment", case == "OneMetadata", is_packed]
    statistics = struct.pack("<QHIIIIQQ", len(times), *counts, min(times, default=0), max(times, default=0))
    counted = struct.pack("<HQ", 1, len(times)) if times else b""
    groups = [
        (3, record(3, schema) * ("rsh" in has)),
        (4, record(4, channel) * ("rch" in has)),
        (11, record(11, statistics + _sized(counted)) * ("st" in has)),
        *((opcode, places[opcode]) for opcode in (13, 10, 8)),
    ]
    summary, offsets, start = b"", b"", len(data)
    for opcode, group in groups:
        offsets += record(14, struct.pack("<BQQ", opcode, start + len(summary), len(group))) * bool(group)
        summary += group
    begins = [start if summary else 0, start + len(summary) if "sum" in has else 0]
    summary += offsets * ("sum" in has) + struct.pack("<BQQQ", 2, 20, *begins)
    return data + summary + struct.pack("<I", zlib.crc32(summary)) + MAGIC


def _records(case: str, fields: bytes) -> tuple[bytes, bytes, list[tuple[int, bytes]]]:
    """The bodies of a case's schema and channel, and the log time and body of each message."""
    if case == "OneSchemalessMessage":
        channel = struct.pack("<HH", 1, 0) + _text("example") + _text("text") + _sized(b"")
    else:
        channel = struct.pack("<HH", 1, 1) + _text("example") + _text("a") + fields
    schema = struct.pack("<H", 1) + _text("Example") + _text("c") + _sized(b"\4\5\6")
    one = [(2, struct.pack("<HIQQ", 1, 10, 2, 1) + b"\1\2\3")]
    ten = [(ns, struct.pack("<HIQQ", 1, at, ns, ns) + b"\1\2\3") for at, ns in enumerate(TEN)]
    cases = {"OneMessage": (schema, channel, one), "TenMessages": (schema, channel, ten)}
    return cases.get(case, (b"", channel, one) if case == "OneSchemalessMessage" else (b"", b"", []))


def _sized(content: bytes) -> bytes:
    return struct.pack("<I", len(content)) + content


def _text(text: str) -> bytes:
    return _sized(text.encode())


CASES = {
    "NoData": 0,
    "OneAttachment": 0,
    "OneMetadata": 0,
    "OneMessage": 1,
    "OneSchemalessMessage": 1,
    "TenMessages": 10,
}
VARIANTS = hashes()


def messages(data: bytes) -> list[LoggedMessage]:
    return [one for one in walk(BytesIO(data), len(data)) if isinstance(one, LoggedMessage)]


def answer(capsys: pytest.CaptureFixture[str], *words: object) -> dict[str, object]:
    code = review(*words, "--json")
    assert code == ExitCode.OK, (words, capsys.readouterr())
    found: dict[str, object] = json.loads(capsys.readouterr().out.splitlines()[0])
    return found


@pytest.mark.parametrize("case", CASES)
def test_every_variant_of_the_conformance_suite_is_sound(
    case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    names = [name for name in VARIANTS if name.partition("-")[0] == case]
    for name in names:
        data = make(name)
        assert hashlib.sha256(data).hexdigest() == VARIANTS[name], name
        log = tmp_path / f"{name}.mcap"
        log.write_bytes(data)
        info, check = (answer(capsys, question, log) for question in ("info", "check"))
        assert (info["messages"], info["fault_count"], info["whole"]) == (CASES[case], 0, True), name
        assert (check["messages"], check["whole"]) == (CASES[case], True), name
        part = log.rename(tmp_path / f"{name}.mcap.part")
        recovered = answer(capsys, "recover", part)
        assert (recovered["outcome"], recovered["messages"]) == ("whole", CASES[case]), name
        assert log.read_bytes() == data
    assert len(names) > 5


def record(opcode: int, body: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(body)) + body


def text(words: str) -> bytes:
    return struct.pack("<I", len(words)) + words.encode()


def message(number: int, time_ns: int | None = None) -> bytes:
    time_ns = 10**9 * number if time_ns is None else time_ns
    return record(5, struct.pack("<HIQQ", 1, number, time_ns, time_ns) + b'{"x":1}')


def chunk(records: bytes, compression: str, packed: bytes) -> bytes:
    head = struct.pack("<QQQI", 0, 2 * 10**9, len(records), zlib.crc32(records))
    return record(6, head + text(compression) + struct.pack("<Q", len(packed)) + packed)


def whole(data: bytes, summary: bytes = b"") -> bytes:
    """Make a file without checksums, of the profile ``ros2``."""
    body = b"\x89MCAP0\r\n" + record(1, text("ros2") + text("other")) + data + record(15, bytes(4))
    return body + summary + record(2, struct.pack("<QQI", len(body) if summary else 0, 0, 0)) + body[:8]


SCHEMA = record(3, struct.pack("<H", 1) + text("S") + text("jsonschema") + text('{"type":"object"}'))
CHANNEL = record(4, struct.pack("<HH", 1, 1) + text("/a") + text("json") + bytes(4))
MESSAGES = [message(number) for number in range(3)]
CONTENT = SCHEMA + CHANNEL + b"".join(MESSAGES)
COUNTS = struct.pack("<QHIIIIQQI", 3, 1, 1, 0, 0, 0, 0, 2 * 10**9, 0)
FRAMES = {
    "zstd": b"".join(map(zstandard.compress, (CONTENT[:50], CONTENT[50:]))),
    "lz4": b"".join(map(lz4.frame.compress, (CONTENT[:50], CONTENT[50:]))),
}
LEGAL = {
    "a record of a later version": whole(SCHEMA + CHANNEL + record(0x20, b"later") + b"".join(MESSAGES)),
    "a later record in the summary": whole(CONTENT, SCHEMA + CHANNEL + record(0x30, b"x") + record(11, COUNTS)),
    "a later record first in the summary": whole(CONTENT, record(0x30, b"x") + SCHEMA + CHANNEL),
    "a private record like our check": whole(SCHEMA + CHANNEL + record(0x80, b"12345678") + b"".join(MESSAGES)),
    "a longer end of the data": whole(CONTENT).replace(record(15, bytes(4)), record(15, bytes(7))),
    "no counts of the channels": whole(CONTENT, SCHEMA + CHANNEL + record(11, COUNTS)),
    "no message index": whole(chunk(CONTENT, "", CONTENT)),
    "several frames of zstd": whole(chunk(CONTENT, "zstd", FRAMES["zstd"])),
    "several frames of lz4": whole(chunk(CONTENT, "lz4", FRAMES["lz4"])),
    "a later record in a chunk": whole(chunk(CONTENT + record(0x21, b"x"), "", CONTENT + record(0x21, b"x"))),
    "times that go backwards": whole(SCHEMA + CHANNEL + MESSAGES[0] + MESSAGES[2] + MESSAGES[1]),
}


@pytest.mark.parametrize("name", LEGAL)
def test_what_is_allowed_is_no_damage(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "log.mcap"
    log.write_bytes(LEGAL[name])
    assert answer(capsys, "info", log)["messages"] == 3
    assert answer(capsys, "check", log)["messages"] == 3
    assert review("export", "-o", tmp_path / "out", log) == ExitCode.OK
    assert ": 3 rows" in capsys.readouterr().out
    recovered = answer(capsys, "recover", log.rename(tmp_path / "log.mcap.part"))
    assert (recovered["outcome"], recovered["messages"]) == ("whole", 3)


def foreign(compression: CompressionType) -> bytes:
    """Make a file as the mcap package does: channels in chunks, and in the summary."""
    stream = BytesIO()
    writer = Writer(stream, chunk_size=400, compression=compression)
    writer.start("ros2")
    channel = writer.register_channel("/a", "json", 0)
    for number in range(40):
        writer.add_message(channel, number, b'{"i":%d,"pad":"%s"}' % (number, b"x" * 30), number, number)
    writer.finish()
    return stream.getvalue()


FOREIGN = [foreign(one) for one in (CompressionType.NONE, CompressionType.LZ4, CompressionType.ZSTD)]


def kept(data: bytes) -> bytes:
    copy = BytesIO()
    copy_good(BytesIO(data), len(data), copy, "test")
    return copy.getvalue()


@example(FOREIGN[0], [(1.0, 1), (0.0625, 1)])
@given(st.sampled_from(FOREIGN), st.lists(st.tuples(st.floats(0, 1), st.integers(1, 255)), min_size=1, max_size=3))
def test_a_copy_keeps_at_least_what_an_export_reads(data: bytes, damage: list[tuple[float, int]]) -> None:
    damaged = bytearray(data)
    for place, bits in damage:
        damaged[8 + int(place * (len(data) - 9))] ^= bits
    log = LogFile(Path("log.mcap"), len(damaged), 0, 0)
    rows = LogReader(BytesIO(damaged), log, Selection(), Faults()).rows()
    read = Counter(row.data for row in rows if not survey_is_whole(damaged))
    assert not read - Counter(one.data for one in messages(kept(bytes(damaged))))


def survey_is_whole(data: bytearray) -> bool:
    found = survey(BytesIO(data), len(data))
    return found.is_whole


@pytest.mark.parametrize("search_bytes", range(40, 90, 7))
def test_a_chunk_is_found_across_the_blocks_of_the_search(
    search_bytes: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("recorder.mcap.pieces.SEARCH_BYTES", search_bytes)
    first = FOREIGN[0].index(b"\x06", 30)
    # The length of the first chunk's record is wrong, so nothing tells where the next one begins.
    damaged = FOREIGN[0][: first + 1] + b"\xff" * 3 + FOREIGN[0][first + 4 :]
    assert len(messages(kept(damaged))) > 25
