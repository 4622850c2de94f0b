"""The files of MCAP's conformance suite: every way to write the same few records. A SHA-256 proves each."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Final

HASHES: Final = Path(__file__).parents[1] / "data" / "mcap-conformance.txt"

MAGIC: Final = b"\x89MCAP0\r\n"
UNPADDED: Final = frozenset({2, 5, 6, 15})
"""Footer, message, chunk and the end of the data have no further fields where other records have some."""
TEN: Final = (0, 2, 1, 3, 3, 5, 4, 7, 8, 9)


def hashes() -> dict[str, str]:
    """Return the SHA-256 of each variant, ``CASE-feature-feature``, in hexadecimal digits."""
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
    """Return the bodies of a case's schema and channel, and the log time and body of each message."""
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
