"""The file of layouts, read from the DBC files: ``python -m gateway.chassis.cruiser.layout_file`` writes it."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Final

import msgspec
from cantools.database.can import Database, Message, Signal

from gateway.chassis.cruiser.frames import LAYOUTS, ReadLayout, digest
from gateway.chassis.frame import EXTENDED
from gateway.chassis.layout import ChassisLayout, MessageLayout, SignalLayout
from schemas.cruiser import DBC_FILES, dbc_text
from schemas.messages import Variant

CHASSIS_NODE: Final = "Chassis"
"""The node that sends the feedback; all other frames are commands."""

FILE: Final = Path(__file__).with_name(LAYOUTS)


def layouts_text() -> str:
    """Return the contents of the file. Raises ValueError."""
    layouts = {
        variant: ReadLayout(digest(variant), read_layout(variant, dbc_text(variant))) for variant in DBC_FILES
    }
    return msgspec.json.format(msgspec.json.encode(layouts), indent=1).decode() + "\n"


def read_layout(variant: Variant, dbc: str) -> ChassisLayout:
    """Read the layout of a variant from its DBC. Raises ValueError: it has a feature that is not implemented."""
    database = Database()
    database.add_dbc_string(dbc)
    return ChassisLayout(variant, {message.name: _message(message) for message in database.messages})


def _message(message: Message) -> MessageLayout:
    if not message.is_extended_frame or message.length != 8:
        raise ValueError(f"{message.name}: every frame is extended and has 8 bytes")
    return MessageLayout(
        name=message.name,
        can_id=message.frame_id | EXTENDED,
        length=message.length,
        period_ns=(message.cycle_time or 0) * 1_000_000,
        is_feedback=message.senders == [CHASSIS_NODE],
        signals=tuple(_signal(message.name, signal) for signal in message.signals),
    )


def _signal(message_name: str, signal: Signal) -> SignalLayout:
    if signal.byte_order != "little_endian" or signal.is_float or signal.is_multiplexer:
        raise ValueError(f"{message_name}.{signal.name}: every signal is a plain little-endian integer")
    return SignalLayout(
        name=signal.name,
        start_bit=signal.start,
        length=signal.length,
        is_signed=signal.is_signed,
        scale=float(signal.scale),
        offset=float(signal.offset),
        minimum=float(signal.minimum or 0),
        maximum=float(signal.maximum or 0),
        unit=signal.unit or "",
        choices={raw: str(name) for raw, name in (signal.choices or {}).items()},
        start_raw=int(signal.raw_initial or 0),
    )


def main() -> int:
    """Write the file. Returns the exit code."""
    FILE.write_text(layouts_text(), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
