"""Faults of a frame or a stream of frames. Faults are values: wire input never raises."""

from __future__ import annotations

from enum import Enum

import msgspec


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
    """A value that this chassis cannot have, by its table of plausible ones. The frame is not published."""
    VARIANT_CONTRADICTED = "variant_contradicted"
    """A standstill wheel speed frame of the other firmware variant."""
    ALIVE_REPEATED = "alive_repeated"
    ALIVE_LOST = "alive_lost"
    ALIVE_SEQUENCE = "alive_sequence"
    ALIVE_STUCK = "alive_stuck"
    PERIOD = "period"
    SILENCE = "silence"


class FrameFault(msgspec.Struct, frozen=True):
    """A frame's fault, for which it is not a valid message.

    Attributes:
        name: the frame's name in the DBC; empty if it has none.
    """

    kind: FaultKind
    can_id: int
    name: str = ""
    detail: str = ""
