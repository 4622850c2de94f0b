"""Layouts from DBC files: the one source of bits, scales, units and cycle times."""

from __future__ import annotations

import cantools
from cantools.database.can import Database, Message, Signal

from gateway.chassis.frame import EXTENDED
from gateway.chassis.layout import ChassisLayout, MessageLayout, SignalLayout
from schemas.messages import Variant


def read_layout(variant: Variant, dbc: str, chassis_node: str) -> ChassisLayout:
    """Read the layout of a variant from the text of its DBC.

    Args:
        variant: the variant.
        dbc: the text.
        chassis_node: the node that sends the feedback; what others send are commands.

    Raises:
        ValueError: the DBC says something that is not implemented.
    """
    database = cantools.database.load_string(dbc, database_format="dbc")
    if not isinstance(database, Database):
        raise TypeError("not a CAN database")
    return ChassisLayout(variant, {message.name: _message(message, chassis_node) for message in database.messages})


def _message(message: Message, chassis_node: str) -> MessageLayout:
    if not message.is_extended_frame or message.length != 8:
        raise ValueError(f"{message.name}: every frame is extended and has 8 bytes")
    return MessageLayout(
        name=message.name,
        can_id=message.frame_id | EXTENDED,
        length=message.length,
        period_ns=(message.cycle_time or 0) * 1_000_000,
        is_feedback=message.senders == [chassis_node],
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
