"""The signals of a raw frame of the chassis, by the DBC."""

from __future__ import annotations

from typing import Final

import msgspec

from gateway.chassis.cruiser.layout import load
from gateway.chassis.layout import MessageLayout
from schemas.can_word import IDENTIFIER_MASK
from schemas.messages import Variant
from schemas.settings import SILENCE_MIN_NS, SILENCE_PERIODS

FRAME_BYTES: Final = 8


class DecodedFrame(msgspec.Struct, frozen=True):
    """A raw frame with an extended identifier. Times are nanoseconds since 1970.

    Attributes:
        time_ns: when it was sent, or received: when the arbiter was given it, or where the log does not hold the
            journal when the bus had it.
        bus_ns: when the bus had it; None where that is ``time_ns``.
    """

    time_ns: int
    identifier: int
    data: bytes
    bus_ns: int | None = None

    @property
    def waited_ns(self) -> int:
        """The time between the bus and the arbiter; 0 where that is not known."""
        return 0 if self.bus_ns is None else max(0, self.time_ns - self.bus_ns)

    @property
    def is_whole(self) -> bool:
        """Eight bytes whose checksum is right."""
        return len(self.data) == FRAME_BYTES and self.checksum == self.data[7]

    @property
    def checksum(self) -> int:
        """The right value of byte 7: the XOR of those before."""
        found = 0
        for byte in self.data[:7]:
            found ^= byte
        return found

    @property
    def alive_counter(self) -> int:
        """The high half of byte 6."""
        return self.data[6] >> 4

    def __str__(self) -> str:
        """Identifier, name and bytes."""
        known = BY_IDENTIFIER.get(self.identifier)
        name = f" {known.name}" if known is not None else ""
        return f"0x{self.identifier:08X}{name}, {self.data.hex(' ').upper()}"


BY_IDENTIFIER: Final[dict[int, MessageLayout]] = {
    frame.can_id & IDENTIFIER_MASK: frame for frame in load(Variant.COARSE).messages.values()
}
"""Every frame of the DBC. Both variants have the same frames and cycle times."""

IDENTIFIERS: Final = {frame.name: identifier for identifier, frame in BY_IDENTIFIER.items()}

BODY: Final = IDENTIFIERS["Auto_MileageAndBodyFeedback"]
WHEELS: Final = IDENTIFIERS["Auto_WheelSpdFeedback"]


def silence_ns(name: str) -> int:
    """The time without a feedback frame after which it counts as silent."""
    return max(SILENCE_PERIODS * BY_IDENTIFIER[IDENTIFIERS[name]].period_ns, SILENCE_MIN_NS)


def signals(frame: DecodedFrame, variant: Variant = Variant.COARSE) -> dict[str, float]:
    """A frame's signals by name, scaled, whatever its checksum is; empty if it is none of the DBC."""
    known = BY_IDENTIFIER.get(frame.identifier)
    if known is None or len(frame.data) != FRAME_BYTES:
        return {}
    return {signal.name: signal.value(frame.data) for signal in load(variant).messages[known.name].signals}
