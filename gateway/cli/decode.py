"""``cruiser decode``: candump lines in, a JSON object a line out.

Lines of ``candump``, of its log format (``-L``) and of its classic one::

    (1436509052.249713) vcan0 18C4D1EF#0104000000000005       data
    (1436509052.249713) vcan0 123#R8                          remote
    (1436509052.249713) vcan0 123##1112233                    CAN FD, one digit of flags
    (1436509052.249713) vcan0 20000004#0004000000000000       error
      vcan0  18C4D1EF   [8]  01 04 00 00 00 00 00 05          classic

A valid frame gives ``time``, ``time_ns``, ``bus``, ``id``, ``name`` and ``signals``: the physical values under
the field names of the messages, ``speed_mps``, ``gear_position``, and for command frames by the same rule. A frame
that is not valid has ``fault`` instead of ``signals``, with ``kind`` and ``detail``. A line that is not candump's
has ``line``, its number, and a fault of the kind ``not_candump``.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import select
import sys
from collections.abc import Callable, Iterator
from typing import Any, Final

import msgspec

from gateway.chassis.frame import (
    BITRATE_SWITCH,
    ERROR,
    ERROR_STATE_INDICATOR,
    EXTENDED,
    FD,
    IDENTIFIER_MASK,
    REMOTE,
    STANDARD_MASK,
    Frame,
)
from gateway.chassis.layout import CHECKSUM, Decoded, FrameDecoder
from gateway.choice.chassis import CHASSIS
from schemas.command_line import CommandError, ExitCode, plain
from schemas.messages import Variant
from schemas.settings import Settings

_TIME: Final = r"\((?P<s>\d{1,10})\.(?P<fraction>\d{1,9})\)"
_ID: Final = r"(?P<id>[0-9A-Fa-f]{8}|[0-9A-Fa-f]{3})"
_BUS: Final = r"(?P<bus>[!-~]{1,64})"
_LOG: Final = re.compile(rf"\s*{_TIME}\s+{_BUS}\s+{_ID}#(?P<rest>[0-9A-Za-z#_]*)(?:\s+[RT])?\s*", re.ASCII)
_LOG_REMOTE: Final = re.compile(r"R(?P<length>[0-8]?)(?:_[9A-Fa-f])?")
_LOG_FD: Final = re.compile(r"#(?P<flags>[0-9A-Fa-f])(?P<data>(?:[0-9A-Fa-f]{2}){0,64})")
_LOG_DATA: Final = re.compile(r"(?P<data>(?:[0-9A-Fa-f]{2}){0,8})(?:_[9A-Fa-f])?")
_CLASSIC: Final = re.compile(
    rf"\s*(?:{_TIME}\s+)?{_BUS}\s+(?:[RT]X [B-] [E-]\s+)?{_ID}\s+\[(?P<length>\d{{1,2}})\]\s*"
    r"(?:(?P<remote>remote request)|(?P<data>(?:[0-9A-Fa-f]{2}(?:\s+|\Z))*)(?:ERRORFRAME|'[^\n]*')?)\s*",
    re.ASCII,
)


class CandumpLine(msgspec.Struct, frozen=True):
    """A parsed line: identifier in upper case, time or None."""

    frame: Frame
    bus: str
    identifier: str
    time_ns: int | None


def parse(line: str) -> CandumpLine | None:
    """Return the frame of a line, or None if candump does not write such a line."""
    match = _LOG.fullmatch(line)
    if match is not None:
        frame = _log_frame(match)
    else:
        match = _CLASSIC.fullmatch(line)
        if match is None:
            return None
        frame = _classic_frame(match)
    if frame is None:
        return None
    time_ns = None
    if match["s"]:
        time_ns = int(match["s"]) * 1_000_000_000 + int(match["fraction"].ljust(9, "0"))
    return CandumpLine(
        msgspec.structs.replace(frame, wall_ns=time_ns or 0), match["bus"], match["id"].upper(), time_ns
    )


def _can_id(text: str) -> int | None:
    """Return the identifier with its flags: three digits are standard, eight extended, or an error frame."""
    value = int(text, 16)
    if len(text) == 3:
        return value if value <= STANDARD_MASK else None
    if value & ERROR and value <= ERROR | IDENTIFIER_MASK:
        return value
    return value | EXTENDED if value <= IDENTIFIER_MASK else None


def _log_frame(match: re.Match[str]) -> Frame | None:
    can_id = _can_id(match["id"])
    if can_id is None:
        return None
    rest = match["rest"]
    if remote := _LOG_REMOTE.fullmatch(rest):
        return Frame(can_id | REMOTE, b"", remote_length=int(remote["length"] or 0))
    if fd := _LOG_FD.fullmatch(rest):
        flags = int(fd["flags"], 16) & (BITRATE_SWITCH | ERROR_STATE_INDICATOR)
        return Frame(can_id, bytes.fromhex(fd["data"]), fd_flags=FD | flags)
    if data := _LOG_DATA.fullmatch(rest):
        return Frame(can_id, bytes.fromhex(data["data"]))
    return None


def _classic_frame(match: re.Match[str]) -> Frame | None:
    can_id = _can_id(match["id"])
    length = int(match["length"])
    # A length of two digits, [08], is how candump marks CAN FD.
    is_fd = len(match["length"]) == 2
    if can_id is None or length > (64 if is_fd else 8):
        return None
    if match["remote"]:
        return Frame(can_id | REMOTE, b"", remote_length=length)
    data = bytes.fromhex(match["data"])
    if len(data) != length:
        return None
    return Frame(can_id, data, fd_flags=FD if is_fd else 0)


EXAMPLE = """\
  candump -L can0 | cruiser decode --variant coarse
  cruiser decode drive.log | jq -c 'select(.name == "Auto_DriveFeedBack") | .signals.speed_mps'
  echo '(1436509052.249713) can0 18C4D1EF#0104000000000005' | cruiser decode
    {"time": 1436509052.249713, "time_ns": 1436509052249713000, "bus": "can0", "id": "18C4D1EF",
     "name": "Auto_GearFeedBack", "signals": {"active": true, "gear_position": "drive", "alive_counter": 0}}"""

NOT_CANDUMP: Final = "not_candump"

MAX_LINE_BYTES: Final = 1024  # longer lines are not parsed; candump's own have under 400 bytes
POLL_S: Final = 0.2  # the wait for more input ends so soon after a signal
_STANDARD_INPUT: Final = 0
_READ_BYTES: Final = 65_536
_SHOWN: Final = 60  # characters of a wrong line that its fault shows


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "file", nargs="?", default="-", metavar="FILE", help="candump log (default: standard input)"
    )
    parser.add_argument(
        "--variant",
        dest="chassis.variant",
        choices=["coarse", "fine"],
        help="firmware variant, which sets the scale of speeds (default coarse)",
    )


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    """Decode until the input ends. Exit code 3 if a line was not from candump."""
    decoder = FrameDecoder(CHASSIS.layout(_variant(settings)))
    all_read = True
    source = _open(arguments.file)
    name = "standard input" if source == _STANDARD_INPUT else repr(plain(arguments.file))
    try:
        for number, raw in enumerate(_lines(source, name, stopped), start=1):
            record = describe(decoder, raw, number)
            if record is not None:
                all_read &= "line" not in record
                sys.stdout.write(json.dumps(record) + "\n")
                sys.stdout.flush()
    finally:
        if source != _STANDARD_INPUT:
            os.close(source)
    return int(ExitCode.OK if all_read else ExitCode.PARTIAL)


def describe(decoder: FrameDecoder, raw: bytes, number: int) -> dict[str, Any] | None:
    """Return the contents of a line, ready for JSON; None for an empty line. Accepts any bytes."""
    if not raw.strip():
        return None
    text = raw.decode("latin-1")
    line = parse(text) if len(raw) <= MAX_LINE_BYTES else None
    if line is None:
        return {"line": number, "fault": {"kind": NOT_CANDUMP, "detail": plain(text.strip()[:_SHOWN])}}
    record: dict[str, Any] = {
        "time": None if line.time_ns is None else line.time_ns / 1e9,
        "time_ns": line.time_ns,
        "bus": line.bus,
        "id": line.identifier,
    }
    decoded = decoder.decode(line.frame)
    if isinstance(decoded, Decoded):
        signals = {
            signal.field: decoded.signals[signal.name]
            for signal in decoded.layout.signals
            if signal.name != CHECKSUM
        }
        return record | {"name": decoded.layout.name, "signals": signals}
    name = {"name": decoded.name} if decoded.name else {}
    return record | name | {"fault": {"kind": decoded.kind.value, "detail": decoded.detail}}


def _variant(settings: Settings) -> Variant:
    if settings.chassis.variant == "auto":
        sys.stderr.write("cruiser decode: no variant given, using coarse; --variant fine for the other scale\n")
        return Variant.COARSE
    return Variant(settings.chassis.variant)


def _open(file: str) -> int:
    if file == "-":
        return _STANDARD_INPUT
    try:
        return os.open(file, os.O_RDONLY)
    except (OSError, ValueError) as error:  # ValueError: no file's name can hold a NUL
        raise _unreadable(repr(plain(file)), error) from error


def _lines(source: int, name: str, stopped: Callable[[], bool]) -> Iterator[bytes]:
    """Yield the lines of a file descriptor, each cut off just above the longest that is parsed."""
    rest = b""
    while not stopped():
        try:
            # A wait with an end: a signal must not have to wait for the next line.
            if not select.select([source], [], [], POLL_S)[0]:
                continue
            chunk = os.read(source, _READ_BYTES)
        except OSError as error:
            raise _unreadable(name, error) from error
        if not chunk:
            break
        *whole, rest = (rest + chunk).split(b"\n")
        yield from (line[: MAX_LINE_BYTES + 1] for line in whole)
        rest = rest[: MAX_LINE_BYTES + 1]
    if rest:
        yield rest


def _unreadable(name: str, error: OSError | ValueError) -> CommandError:
    reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return CommandError(f"cannot read {name}: {reason.lower()}", ExitCode.USAGE)
