"""The layout of every frame, and decoding and encoding by it.

For each frame of the layout one small function is generated and compiled, as in ``dataclasses``: the eight bytes
become one integer, and each signal is a shift and a mask of it, or of its byte. A test compares every function
with cantools. The rules for values become comparisons of raw integers in the same function.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Container, Mapping, Sequence
from enum import Enum
from functools import cache
from types import CodeType
from typing import Any, Final, Literal

import msgspec

from gateway.chassis.frame import ERROR, REMOTE, FaultKind, Frame, FrameFault
from schemas.can_word import snake_case
from schemas.messages import Feedback, Variant
from schemas.subjects import BY_DBC_MESSAGE, Subject


class Within(msgspec.Struct, frozen=True):
    """The physical value, in the signal's unit, is within these bounds, both included."""

    minimum: float
    maximum: float


class Named(msgspec.Struct, frozen=True):
    """The value table has a name for the value."""


class Requires(msgspec.Struct, frozen=True):
    """This choice requires a flag of the same frame; any other choice requires none."""

    choice: str
    flag: str


Rule = Within | Named | Requires


ALIVE_COUNTER: Final = "AliveCounter"
CHECKSUM: Final = "Checksum"

_UNIT_SUFFIX: Final = {"m/s": "_mps", "deg": "_deg", "km": "_km", "%": "_percent", "count": "", "": ""}


class SignalLayout(msgspec.Struct, frozen=True):
    """A signal: ``physical = raw * scale + offset``.

    Attributes:
        start_bit: from bit 0 of byte 0, least significant bit first (DBC ``@1``).
        choices: the value table, raw value to name; empty if it has none.
        start_raw: the raw value to send by default.
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
        """Return the scaled value in a frame's bytes; the raw value of a choice."""
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
        is_feedback: sent by the chassis; else a command to it.
    """

    name: str
    can_id: int
    length: int
    period_ns: int
    is_feedback: bool
    signals: tuple[SignalLayout, ...]

    def signal(self, name: str) -> SignalLayout:
        """The signal of this name. Raises KeyError: there is none."""
        for signal in self.signals:
            if signal.name == name:
                return signal
        raise KeyError(name)

    @property
    def payload_signals(self) -> tuple[SignalLayout, ...]:
        """The signals without the alive counter and the checksum at the end of every frame."""
        return tuple(signal for signal in self.signals if signal.name not in {ALIVE_COUNTER, CHECKSUM})


class ChassisLayout(msgspec.Struct, frozen=True):
    """All frames of one firmware variant, by name."""

    variant: Variant
    messages: dict[str, MessageLayout]

    @property
    def feedback(self) -> tuple[MessageLayout, ...]:
        return tuple(message for message in self.messages.values() if message.is_feedback)

    @property
    def identifiers(self) -> frozenset[int]:
        """All identifiers with their flags; both variants have the same ones."""
        return frozenset(message.can_id for message in self.messages.values())

    @property
    def commands(self) -> tuple[MessageLayout, ...]:
        return tuple(message for message in self.messages.values() if not message.is_feedback)


Value = bool | int | float | str
Signals = dict[str, Value]
"""Values by signal name: a flag is a bool, a choice its name, or its raw value if it has none."""


class Decoded(msgspec.Struct, frozen=True):
    """A valid frame's signals."""

    layout: MessageLayout
    signals: Signals


def check(frame: Frame) -> FaultKind | None:
    """Return the fault of a frame with an identifier of the layout, or None."""
    data = frame.data
    if frame.fd_flags:
        return FaultKind.FD_FRAME
    if len(data) != 8:
        return FaultKind.LENGTH
    if data[0] ^ data[1] ^ data[2] ^ data[3] ^ data[4] ^ data[5] ^ data[6] != data[7]:
        return FaultKind.CHECKSUM
    return None


class FrameDecoder:
    """Decodes every frame of a variant to signals; for people and tests. The loop uses ``MessageDecoder``."""

    def __init__(self, layout: ChassisLayout) -> None:
        self._by_can_id = {
            message.can_id: (message, compile_signals(message)) for message in layout.messages.values()
        }

    def decode(self, frame: Frame) -> Decoded | FrameFault:
        """The frame's signals, or its fault. Never raises."""
        row = self._by_can_id.get(frame.can_id)
        if row is None:
            return unknown_frame(frame, self._by_can_id)
        layout, signals = row
        kind = check(frame)
        if kind is not None:
            return FrameFault(kind, frame.can_id, layout.name, f"data {frame.data.hex(' ')}")
        return Decoded(layout, signals(frame.data))


def unknown_frame(frame: Frame, known: Container[int]) -> FrameFault:
    """The fault of a frame whose ``can_id`` with its flags is not a known one."""
    if frame.can_id & ERROR:
        return FrameFault(FaultKind.ERROR_FRAME, frame.can_id)
    if frame.can_id & REMOTE and frame.can_id & ~REMOTE in known:
        return FrameFault(FaultKind.REMOTE_FRAME, frame.can_id)
    return FrameFault(FaultKind.UNKNOWN_IDENTIFIER, frame.can_id)


def compile_signals(layout: MessageLayout) -> Callable[[bytes], Signals]:
    """A function from the eight data bytes to the signals by name."""
    scope: dict[str, Any] = {}
    items = ", ".join(f"{signal.name!r}: {_expression(signal, scope, unnamed='raw')}" for signal in layout.signals)
    return _compile(f"{{{items}}}", "data", scope)


MessageBuilder = Callable[[bytes, int, int], Feedback | None]
"""(data, time_ns, sequence) to the typed message, or None if a value is not plausible."""


class MessageDecoder(msgspec.Struct, frozen=True):
    """A feedback frame's way to its message.

    Attributes:
        build: makes the message.
        undefined: tells whether a choice in plausible data has no name in its value table; None if all have one.
    """

    layout: MessageLayout
    subject: Subject
    build: MessageBuilder
    undefined: Callable[[bytes], bool] | None


def compile_message(layout: MessageLayout, rules: Sequence[tuple[str, Rule]]) -> MessageDecoder:
    """Return the decoder of a feedback frame; it makes a message only if all rules hold.

    Raises KeyError, ValueError: no subject belongs to this frame, or its fields differ from the signals.
    """
    subject = BY_DBC_MESSAGE[layout.name]
    by_field = {signal.field: signal for signal in layout.signals}
    annotations = _annotations(subject.type)
    fields = [name for name in annotations if name not in {"time_ns", "sequence"}]
    if set(fields) != {ALIVE_COUNTER_FIELD, *(signal.field for signal in layout.payload_signals)}:
        raise ValueError(f"{subject.type.__name__} and {layout.name} do not have the same fields")
    scope: dict[str, Any] = {"cls": subject.type}
    values = ", ".join(
        _expression(by_field[name], scope, unnamed="undefined", enum=annotations[name]) for name in fields
    )
    message = f"cls(time_ns, sequence, {values})"
    if rules:
        message += f" if {' and '.join(_condition(layout, name, rule) for name, rule in rules)} else None"
    named = {name for name, rule in rules if isinstance(rule, Named)}
    choices = [signal for signal in layout.payload_signals if signal.kind == "choice" and signal.name not in named]
    tests = [f"{_raw(signal)} not in {set(signal.choices)!r}" for signal in choices]
    return MessageDecoder(
        layout=layout,
        subject=subject,
        build=_compile(message, "data, time_ns, sequence", scope),
        undefined=_compile(" or ".join(tests), "data", {}) if tests else None,
    )


@cache
def _annotations(kind: type[msgspec.Struct]) -> dict[str, Any]:
    """The fields of a class with their types, cached for reruns, which make many cores."""
    return {field.name: field.type for field in msgspec.structs.fields(kind)}


ROUNDING_STEPS: Final = 1e-6
"""Tolerance in steps of a signal: far below one step, far above errors of floating point."""

ALIVE_COUNTER_FIELD: Final = SignalLayout(ALIVE_COUNTER, 0, 4, False, 1, 0, 0, 15, "", {}, 0).field  # noqa: FBT003


def _compile(expression: str, arguments: str, scope: dict[str, Any]) -> Callable[..., Any]:
    """A function of the data that computes the expression, in which ``w`` is the data as one integer."""
    if re.search(r"\bw\b", expression):
        scope["from_bytes"] = int.from_bytes
        expression = f"(w := from_bytes(data, 'little'), {expression})[1]"
    # The source consists only of numbers and identifiers of our own layout, never of wire input.
    function: Callable[..., Any] = eval(_code(f"lambda {arguments}: {expression}"), scope)  # noqa: S307
    return function


@cache
def _code(source: str) -> CodeType:
    """Compile the source; cached for reruns, which make many cores of one layout."""
    return compile(source, "<layout>", "eval")


def _raw(signal: SignalLayout) -> str:
    """The raw value: from one byte if the signal lies in one, which is fastest, else from the whole integer."""
    byte, bit = divmod(signal.start_bit, 8)
    mask = (1 << signal.length) - 1
    source, shift = (f"data[{byte}]", bit) if bit + signal.length <= 8 else ("w", signal.start_bit)
    raw = f"({source} >> {shift} & {mask:#x})" if shift else f"({source} & {mask:#x})"
    if signal.is_signed:
        sign = 1 << signal.length - 1
        raw = f"(({raw} ^ {sign:#x}) - {sign:#x})"
    return raw


def _condition(layout: MessageLayout, signal_name: str, rule: Rule) -> str:
    """The rule as a comparison of raw values, which is cheaper than one of physical values."""
    signal = layout.signal(signal_name)
    match rule:
        case Within(minimum, maximum):
            # A bound on a raw value may come out beside it by a rounding error.
            lowest = math.ceil((minimum - signal.offset) / signal.scale - ROUNDING_STEPS)
            highest = math.floor((maximum - signal.offset) / signal.scale + ROUNDING_STEPS)
            return f"{lowest} <= {_raw(signal)} <= {highest}"
        case Named():
            return f"{_raw(signal)} in {set(signal.choices)!r}"
        case Requires(choice, flag):
            raw = next(raw for raw, name in signal.choices.items() if name == choice)
            return f"({_raw(signal)} != {raw} or {_raw(layout.signal(flag))})"


def _expression(signal: SignalLayout, scope: dict[str, Any], *, unnamed: str, enum: Any = None) -> str:  # noqa: ANN401
    raw = _raw(signal)
    if signal.kind == "flag":
        return f"{raw} == 1"
    if signal.kind == "integer":
        return raw
    if signal.kind == "physical":
        return f"{raw} * {signal.scale!r} + {signal.offset!r}"
    table_name = f"choices_{signal.name}"
    table = range(1 << signal.length)
    if unnamed == "undefined":
        if not (isinstance(enum, type) and issubclass(enum, Enum)):
            raise ValueError(f"{signal.name} has a value table, so its field must be an enumeration")
        scope[table_name] = [enum(signal.choices.get(raw_value, unnamed)) for raw_value in table]
    else:
        scope[table_name] = [signal.choices.get(raw_value, raw_value) for raw_value in table]
    return f"{table_name}[{raw}]"


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
        # The last values of each message with their bits: most stay the same from tick to tick.
        self._last: dict[str, tuple[dict[str, Value], int]] = {}
        first = next(iter(layout.messages.values()))
        # Every frame ends with these two, at the same bits (manual V2.0, section 5).
        self._alive_bit = first.signal(ALIVE_COUNTER).start_bit
        self._checksum_bit = first.signal(CHECKSUM).start_bit

    def encode(self, name: str, values: Mapping[str, Value], alive_counter: int, wall_ns: int = 0) -> Frame:
        """The frame of this name in the DBC; a signal that is not named has its start value.

        Raises KeyError, ValueError: there is no such frame or signal, or a value does not fit into its signal.
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
    """The raw value nearest to a physical one; a choice may be given by its name. Raises ValueError."""
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
