"""The DBC files: their names, their text, and what can be read from that without a library.

Bits and scales are read by cantools, in ``gateway.chassis.dbc``, when layouts are generated. Who only wants to
know which frames there are needs no such thing: every statement of these files is one line.
"""

from __future__ import annotations

import re
from importlib import resources
from typing import Final

import msgspec

from schemas.messages import Variant

DBC_FILES: Final = {Variant.COARSE: "cruiser-coarse.dbc", Variant.FINE: "cruiser-fine.dbc"}

CHASSIS_NODE: Final = "Chassis"
"""The node that sends the feedback; whatever another one sends is a command."""

_FRAME: Final = re.compile(r"^BO_ (\d+) (\w+): \d+ (\w+)$", re.MULTILINE)
_CYCLE_TIME: Final = re.compile(r'^BA_ "GenMsgCycleTime" BO_ (\d+) (\d+);$', re.MULTILINE)
_SIGNAL_COMMENT: Final = re.compile(r'^CM_ SG_ (\d+) (\w+) "(.*)";$', re.MULTILINE)


class DbcFrame(msgspec.Struct, frozen=True):
    """A frame as its DBC describes it.

    Attributes:
        can_id: identifier with the EXTENDED flag, which a DBC has where linux/can.h has it.
        sender: the node that sends it.
        period_ns: nominal cycle time; 0 if it has none.
    """

    can_id: int
    name: str
    sender: str
    period_ns: int

    @property
    def is_feedback(self) -> bool:
        """Sent by the chassis."""
        return self.sender == CHASSIS_NODE


def dbc_text(variant: Variant) -> str:
    """The text of a variant's DBC.

    Raises:
        KeyError: the variant is unknown.
    """
    return resources.files("schemas").joinpath(DBC_FILES[variant]).read_text(encoding="ascii")


def frames(text: str) -> list[DbcFrame]:
    """The frames of a DBC, in its order."""
    cycles_ms = {int(can_id): int(cycle) for can_id, cycle in _CYCLE_TIME.findall(text)}
    return [
        DbcFrame(int(can_id), name, sender, cycles_ms.get(int(can_id), 0) * 1_000_000)
        for can_id, name, sender in _FRAME.findall(text)
    ]


def signal_comments(text: str) -> dict[tuple[str, str], str]:
    """The comment of each signal of a DBC, by the names of frame and signal."""
    names = {frame.can_id: frame.name for frame in frames(text)}
    return {(names[int(can_id)], signal): comment for can_id, signal, comment in _SIGNAL_COMMENT.findall(text)}
