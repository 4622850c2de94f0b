"""Decodes the bytes of a terminal: keys, releases of keys where it reports them, the focus. Pure.

Every terminal sends characters and arrow keys, and repeats those that are held. Some also speak the kitty keyboard
protocol, which reports each press, repetition and release; and most report whether their window has the focus.
"""

from __future__ import annotations

import re
from enum import Enum
from typing import Final

import msgspec

KITTY_FLAGS: Final = 0b1011
"""Report keys unambiguously, report repetitions and releases, report letters in the same way."""

BEGIN: Final = f"\x1b[>{KITTY_FLAGS}u\x1b[?1004h\x1b[?u".encode()
"""Ask for the kitty protocol and for the focus, and whether the former is spoken."""

ASK: Final = b"\x1b[?u"
"""Ask for the flags in force. A terminal that answers is there, and has reported every release before it."""

END: Final = b"\x1b[<u\x1b[?1004l"

LONGEST: Final = 64
"""No sequence that a terminal sends is longer."""

_ESCAPE: Final = 0x1B
_CSI: Final = re.compile(rb"\x1b\[([0-9:;<=>?]*)[ -/]*([@-~])")
_SS3: Final = re.compile(rb"\x1bO([A-Z])")
_BEGUN: Final = re.compile(rb"\x1b(\[[0-9:;<=>?]*[ -/]*|O)?")
_ARROWS: Final = {"A": "up", "B": "down", "C": "right", "D": "left"}
_CHARACTERS: Final = {0x03: "ctrl-c", 0x20: "space"}
_CTRL: Final = 0b100
_LOCKS_AND_SHIFT: Final = 0b1100_0001


class Action(Enum):
    """The kind of a stroke."""

    PRESS = "press"
    REPEAT = "repeat"
    RELEASE = "release"


class Stroke(msgspec.Struct, frozen=True):
    """A key: a lower-case letter, ``up``, ``space``, ``ctrl-c``; empty if it is any other."""

    key: str
    action: Action = Action.PRESS


class Focus(msgspec.Struct, frozen=True):
    """The window has got the focus, or lost it."""

    has: bool


class Flags(msgspec.Struct, frozen=True):
    """The terminal's report of its keyboard flags."""

    reports_releases: bool


Heard = Stroke | Focus | Flags


class KeyDecoder:
    """Makes events of what is read, however it is cut in pieces."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> list[Heard]:
        """The events of these bytes."""
        buffer = self._rest + data
        self._rest = b""
        events: list[Heard] = []
        while buffer:
            if buffer[0] != _ESCAPE:
                events.append(Stroke(_character(buffer[0])))
                buffer = buffer[1:]
            elif (match := _CSI.match(buffer)) is not None:
                events.append(_control(match[1].decode(), match[2].decode()))
                buffer = buffer[match.end() :]
            elif (match := _SS3.match(buffer)) is not None:
                events.append(Stroke(_ARROWS.get(match[1].decode(), "")))
                buffer = buffer[match.end() :]
            elif len(buffer) < LONGEST and _BEGUN.fullmatch(buffer) is not None:
                self._rest = buffer
                break
            else:
                events.append(Stroke(""))
                buffer = buffer[1:]
        return events

    def settle(self) -> list[Heard]:
        """Nothing more came for a while: what has begun is a key by itself, such as Escape."""
        if not self._rest:
            return []
        self._rest = b""
        return [Stroke("")]


def _character(code: int) -> str:
    if code in _CHARACTERS:
        return _CHARACTERS[code]
    return chr(code).lower() if 0x21 <= code < 0x7F else ""


def _control(parameters: str, final: str) -> Heard:
    """A control sequence. What is not known is some other key."""
    if final in "IO" and not parameters:
        return Focus(final == "I")
    if final == "u" and parameters.startswith("?"):
        return Flags(_number(parameters[1:]) & KITTY_FLAGS == KITTY_FLAGS)
    fields = [field.split(":") for field in parameters.split(";")]
    second = fields[1] if len(fields) > 1 else [""]
    held = max(0, _number(second[0]) - 1) & ~_LOCKS_AND_SHIFT
    event = _number(second[1]) if len(second) > 1 else 1
    action = {2: Action.REPEAT, 3: Action.RELEASE}.get(event, Action.PRESS)
    if final in _ARROWS:
        return Stroke("" if held else _ARROWS[final], action)
    if final != "u":
        return Stroke("", action)
    code = _number(fields[0][0])
    if held:
        return Stroke("ctrl-c" if held == _CTRL and code == ord("c") else "", action)
    return Stroke(_character(code) if code != 0x03 else "", action)


def _number(text: str) -> int:
    return int(text) if text.isdigit() else 0
