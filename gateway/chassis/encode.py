"""Signals to frames, by the layout."""

from __future__ import annotations

from collections.abc import Mapping

from gateway.chassis.decode import Value
from gateway.chassis.frame import Frame
from gateway.chassis.layout import ALIVE_COUNTER, CHECKSUM, ChassisLayout, SignalLayout


def checksum(data: bytes | bytearray) -> int:
    """XOR of bytes 0 to 6 (manual V2.0, section 5, last note)."""
    return data[0] ^ data[1] ^ data[2] ^ data[3] ^ data[4] ^ data[5] ^ data[6]


class Encoder:
    """Encodes every frame of a variant."""

    def __init__(self, layout: ChassisLayout) -> None:
        self._messages = {
            message.name: (message, {signal.name: signal for signal in message.payload_signals})
            for message in layout.messages.values()
        }
        # Of each message the last values and their bits: from one tick to the next most stay the same.
        self._last: dict[str, tuple[dict[str, Value], int]] = {}
        first = next(iter(layout.messages.values()))
        # Every frame ends with these two, at the same bits (manual V2.0, section 5).
        self._alive_bit = first.signal(ALIVE_COUNTER).start_bit
        self._checksum_bit = first.signal(CHECKSUM).start_bit

    def encode(self, name: str, values: Mapping[str, Value], alive_counter: int, wall_ns: int = 0) -> Frame:
        """The frame of this name.

        Args:
            name: the frame's name in the DBC.
            values: signal values by name, physical; a signal that is not named has its start value.
            alive_counter: taken modulo 16.
            wall_ns: the frame's time.

        Raises:
            KeyError: no such frame or signal.
            ValueError: a value does not fit into its signal.
        """
        layout, signals = self._messages[name]
        last = self._last.get(name)
        if last is not None and last[0] == values:
            word = last[1]
        else:
            word = _bits(name, values, signals)
            self._last[name] = dict(values), word
        word |= (alive_counter & 0xF) << self._alive_bit
        data = word.to_bytes(layout.length, "little")
        word |= checksum(data) << self._checksum_bit
        return Frame(layout.can_id, word.to_bytes(layout.length, "little"), wall_ns)


def _bits(name: str, values: Mapping[str, Value], signals: Mapping[str, SignalLayout]) -> int:
    """The signals' bits, at their places."""
    if not values.keys() <= signals.keys():
        unknown = values.keys() - signals.keys()
        raise KeyError(f"{name} has no signal {', '.join(sorted(unknown))}")
    word = 0
    for signal_name, signal in signals.items():
        raw = to_raw(signal, values[signal_name]) if signal_name in values else signal.start_raw
        word |= (raw & ((1 << signal.length) - 1)) << signal.start_bit
    return word


def to_raw(signal: SignalLayout, value: Value) -> int:
    """The raw value nearest to a physical one; a choice may be given by its name.

    Raises:
        ValueError: it does not fit into the signal's bits, or the value table has no such name.
    """
    if isinstance(value, str):
        for raw, name in signal.choices.items():
            if name == value:
                return raw
        raise ValueError(f"{signal.name} has no value {value!r}")
    raw = round((value - signal.offset) / signal.scale)
    low, high = (
        (-(1 << signal.length - 1), (1 << signal.length - 1) - 1)
        if signal.is_signed
        else (0, (1 << signal.length) - 1)
    )
    if not low <= raw <= high:
        raise ValueError(f"{signal.name}: {value} does not fit into {signal.length} bits")
    return raw
