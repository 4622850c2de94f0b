"""The words that describe a CAN frame, as in linux/can.h: identifier and kind in one, CAN FD's flags in another.

Frames are in this form on Zenoh (``CanFrames.can_id`` and ``fd_flags``), so gateway and recorder share it.
"""

from __future__ import annotations

from typing import Final

EXTENDED: Final = 0x8000_0000
REMOTE: Final = 0x4000_0000
ERROR: Final = 0x2000_0000
IDENTIFIER_MASK: Final = 0x1FFF_FFFF
STANDARD_MASK: Final = 0x7FF

FD: Final = 0x4
BITRATE_SWITCH: Final = 0x1
ERROR_STATE_INDICATOR: Final = 0x2
