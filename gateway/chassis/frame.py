"""Frames with their flags, and their faults, which are values: wire input never raises."""

from __future__ import annotations

from enum import Enum

import msgspec

from schemas.can_word import (
    BITRATE_SWITCH,
    ERROR,
    ERROR_STATE_INDICATOR,
    EXTENDED,
    FD,
    IDENTIFIER_MASK,
    REMOTE,
    STANDARD_MASK,
)

__all__ = [
    "BITRATE_SWITCH",
    "ERROR",
    "ERROR_STATE_INDICATOR",
    "EXTENDED",
    "FD",
    "IDENTIFIER_MASK",
    "REMOTE",
    "STANDARD_MASK",
    "Frame",
    "hex_identifier",
]


class FaultKind(Enum):
    """Faults by kind; each is counted under its value in ``gateway/health``."""

    UNKNOWN_IDENTIFIER = "unknown_identifier"
    """No frame of the DBC has this identifier (standard identifiers never do)."""
    REMOTE_FRAME = "remote_frame"
    ERROR_FRAME = "error_frame"
    FD_FRAME = "fd_frame"
    """A CAN FD frame with an identifier of the DBC: the protocol is CAN 2.0B."""
    LENGTH = "length"
    CHECKSUM = "checksum"
    UNDEFINED_VALUE = "undefined_value"
    """A value that the value table does not name. The message is published and says ``undefined``."""
    IMPLAUSIBLE = "implausible"
    """A value outside this chassis's table of plausible ones. The frame is not published."""
    VARIANT_CONTRADICTED = "variant_contradicted"
    """A standstill wheel speed frame of the other firmware variant."""
    ALIVE_REPEATED = "alive_repeated"
    ALIVE_LOST = "alive_lost"
    ALIVE_SEQUENCE = "alive_sequence"
    ALIVE_STUCK = "alive_stuck"
    PERIOD = "period"
    SILENCE = "silence"


class FrameFault(msgspec.Struct, frozen=True):
    """Why a frame is no valid message. ``name``: of the frame in the DBC; empty if it has none."""

    kind: FaultKind
    can_id: int
    name: str = ""
    detail: str = ""


class GateFault(msgspec.Struct, frozen=True):
    """Why the gate refused a burst."""

    can_id: int
    detail: str


class Frame(msgspec.Struct, frozen=True, gc=False, array_like=True):
    """A CAN frame. Flags as in linux/can.h, so that one word holds identifier and kind.

    In the journal it is an array, in this order.

    Attributes:
        can_id: identifier with the flags EXTENDED, REMOTE and ERROR.
        data: 0 to 8 bytes, up to 64 for CAN FD; empty for a remote frame.
        wall_ns: when the bus delivered it, nanoseconds since 1970; 0 if unknown.
        fd_flags: 0 for classic CAN; FD, with BITRATE_SWITCH and ERROR_STATE_INDICATOR, for CAN FD.
        remote_length: the data length that a remote frame asks for; 0 for every other.
    """

    can_id: int
    data: bytes
    wall_ns: int = 0
    fd_flags: int = 0
    remote_length: int = 0

    @property
    def identifier(self) -> int:
        """The 11-bit or 29-bit identifier without flags."""
        return self.can_id & IDENTIFIER_MASK

    @property
    def length(self) -> int:
        """Data length in bytes; the requested length for a remote frame."""
        return self.remote_length or len(self.data)


def hex_identifier(can_id: int) -> str:
    """The identifier in hexadecimal: 8 digits if extended, else 3."""
    return f"{can_id & IDENTIFIER_MASK:08X}" if can_id & EXTENDED else f"{can_id & STANDARD_MASK:03X}"
