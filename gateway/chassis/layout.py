"""The layout of every frame: bits, scales, units and cycle times."""

from __future__ import annotations

from typing import Final, Literal

import msgspec

from schemas.can_word import snake_case
from schemas.messages import Variant

ALIVE_COUNTER: Final = "AliveCounter"
CHECKSUM: Final = "Checksum"

_UNIT_SUFFIX: Final = {"m/s": "_mps", "deg": "_deg", "km": "_km", "%": "_percent", "count": "", "": ""}


class SignalLayout(msgspec.Struct, frozen=True):
    """A signal: ``physical = raw * scale + offset``.

    Attributes:
        start_bit: from bit 0 of byte 0, least significant bit first (DBC ``@1``).
        choices: the value table, raw value to name; empty if it has none.
        start_raw: the raw value to send when nothing else is asked for.
    """

    name: str
    start_bit: int
    length: int
    is_signed: bool
    scale: float
    offset: float
    minimum: float
    maximum: float
    unit: str
    choices: dict[int, str]
    start_raw: int

    def value(self, data: bytes) -> float:
        """Return the scaled value in a frame's bytes; of a choice its raw value."""
        raw = int.from_bytes(data, "little") >> self.start_bit & (1 << self.length) - 1
        if self.is_signed and raw >> self.length - 1:
            raw -= 1 << self.length
        return raw if self.scale == 1 and self.offset == 0 else raw * self.scale + self.offset

    @property
    def field(self) -> str:
        """The message field of this signal: snake_case, with the unit as a suffix."""
        return snake_case(self.name) + _UNIT_SUFFIX[self.unit]

    @property
    def kind(self) -> Literal["flag", "choice", "integer", "physical"]:
        """The field's kind: one bit is a flag, a value table a choice, an unscaled number an integer."""
        if self.length == 1:
            return "flag"
        if self.choices:
            return "choice"
        return "integer" if self.scale == 1 and self.offset == 0 else "physical"


class MessageLayout(msgspec.Struct, frozen=True):
    """A frame's layout.

    Attributes:
        can_id: identifier with the EXTENDED flag, as in Frame.
        length: data bytes.
        period_ns: nominal cycle time.
        is_feedback: sent by the chassis; else a command to it.
    """

    name: str
    can_id: int
    length: int
    period_ns: int
    is_feedback: bool
    signals: tuple[SignalLayout, ...]

    def signal(self, name: str) -> SignalLayout:
        """The signal of this name.

        Raises:
            KeyError: there is none.
        """
        for signal in self.signals:
            if signal.name == name:
                return signal
        raise KeyError(name)

    @property
    def payload_signals(self) -> tuple[SignalLayout, ...]:
        """The signals but for the alive counter and the checksum, which every frame ends with."""
        return tuple(signal for signal in self.signals if signal.name not in {ALIVE_COUNTER, CHECKSUM})


class ChassisLayout(msgspec.Struct, frozen=True):
    """All frames of one firmware variant, by name."""

    variant: Variant
    messages: dict[str, MessageLayout]

    @property
    def feedback(self) -> tuple[MessageLayout, ...]:
        """The frames that the chassis sends."""
        return tuple(message for message in self.messages.values() if message.is_feedback)

    @property
    def identifiers(self) -> frozenset[int]:
        """Of all frames, with their flags; both variants have the same."""
        return frozenset(message.can_id for message in self.messages.values())

    @property
    def commands(self) -> tuple[MessageLayout, ...]:
        """The frames that the chassis accepts."""
        return tuple(message for message in self.messages.values() if not message.is_feedback)
