"""Lines of ``candump``, of its log format (``-L``) and of its classic one, to frames. Pure.

As can-utils writes them::

    (1436509052.249713) vcan0 18C4D1EF#0104000000000005       data
    (1436509052.249713) vcan0 123#R8                          remote
    (1436509052.249713) vcan0 123##1112233                    CAN FD, one digit of flags
    (1436509052.249713) vcan0 20000004#0004000000000000       error
      vcan0  18C4D1EF   [8]  01 04 00 00 00 00 00 05          classic
"""

from __future__ import annotations

import re
from typing import Final

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
    """A line.

    Attributes:
        identifier: as it stands in the line, in upper case.
        time_ns: its time; null if the line has none.
    """

    frame: Frame
    bus: str
    identifier: str
    time_ns: int | None


def parse(line: str) -> CandumpLine | None:
    """The frame of a line, or None if candump would not write such a line."""
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
    """The identifier with its flags: three digits are standard, eight extended, or an error frame."""
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
