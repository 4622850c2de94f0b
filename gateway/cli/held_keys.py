"""Hold to move: the motion that the held key of a terminal asks for. Pure, time as an argument.

A terminal reports no release of a key. A key counts as held while it repeats: motion begins with its first
repetition, and ends soon after the last. A link that stalls delivers old strokes in a burst: after a pause or a
burst a key must be let go and pressed again.
"""

from __future__ import annotations

import re
from typing import Final

import msgspec

REPEAT_NS: Final = 200_000_000
"""A key that repeats comes again within this time; slow keyboards take 90 ms."""

BEGIN_NS: Final = 800_000_000
"""A key that is held begins to repeat within this time; keyboards wait for up to 660 ms."""

BEGIN_MIN_NS: Final = 150_000_000
"""No keyboard begins to repeat sooner."""

BURST_STROKES: Final = 6
"""As many strokes of one key in one read have waited somewhere: the fastest keyboards take 15 ms for each."""

LONGEST: Final = 64
"""No sequence that a terminal sends is longer."""

_ESCAPE: Final = 0x1B
_SEQUENCE: Final = re.compile(rb"\x1b(?:\[[0-9:;<=>?]*[ -/]*([@-~])|O([A-Z]))")
_BEGUN: Final = re.compile(rb"\x1b(\[[0-9:;<=>?]*[ -/]*|O)?")
_ARROWS: Final = {b"A": "up", b"B": "down", b"C": "right", b"D": "left"}
_ARROW_BYTES: Final = 3
"""A longer sequence is an arrow with Ctrl, Alt or Shift: another key."""

_CHARACTERS: Final = {0x03: "ctrl-c", 0x20: "space"}


class Wish(msgspec.Struct, frozen=True):
    """The motion asked for, as fractions of the chosen speed and angle. Forward and left are positive."""

    forward: int = 0
    left: int = 0


NOTHING: Final = Wish()

BINDINGS: Final[dict[str, Wish]] = {
    "w": Wish(1, 0),
    "up": Wish(1, 0),
    "s": Wish(-1, 0),
    "down": Wish(-1, 0),
    "a": Wish(0, 1),
    "left": Wish(0, 1),
    "d": Wish(0, -1),
    "right": Wish(0, -1),
    "u": Wish(1, 1),
    "o": Wish(1, -1),
    "m": Wish(-1, 1),
    ".": Wish(-1, -1),
}
"""Any other key means: stand. Those that drive a curve are where ROS's teleop_twist_keyboard has them: a terminal
repeats one key only, so speed and angle must come from one."""


class KeyDecoder:
    """Makes keys of what is read, however it is cut in pieces.

    A key is a lower-case letter, ``up``, ``space``, ``ctrl-c``; empty if it is any other.
    """

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> list[str]:
        """The keys of these bytes. Without any, what has begun is a key by itself, such as Escape."""
        if not data:
            begun, self._rest = self._rest, b""
            return [""] if begun else []
        buffer, self._rest = self._rest + data, b""
        keys: list[str] = []
        while buffer:
            length = 1
            if buffer[0] != _ESCAPE:
                keys.append(_character(buffer[0]))
            elif (match := _SEQUENCE.match(buffer)) is not None:
                length = match.end()
                keys.append(_ARROWS.get(match[1] or match[2], "") if length == _ARROW_BYTES else "")
            elif len(buffer) < LONGEST and _BEGUN.fullmatch(buffer) is not None:
                self._rest = buffer
                break
            else:
                keys.append("")
            buffer = buffer[length:]
        return keys


class HeldKeys:
    """The key that is held."""

    def __init__(self) -> None:
        self._last = ""
        self._last_ns = 0
        self._is_press = False
        self._until_ns = 0

    def receive(self, keys: list[str], now_ns: int) -> list[str]:
        """Take in the keys that the terminal sent at one time. Returns those that do not drive."""
        pressed, strokes = "", 0
        for key in keys:
            if key in BINDINGS:
                strokes = strokes + 1 if key == pressed else 1
                pressed = key
            else:
                self.release_all()
                pressed = ""
        if pressed:
            self._repeat(pressed, strokes, now_ns)
        return [key for key in keys if key not in BINDINGS]

    def wish(self, now_ns: int) -> Wish:
        """Return the motion asked for now."""
        return BINDINGS[self._last] if self._last and now_ns < self._until_ns else NOTHING

    def release_all(self) -> None:
        """Forget the held key: it must be pressed again."""
        self._last = ""
        self._until_ns = 0

    def _repeat(self, key: str, strokes: int, now_ns: int) -> None:
        """A key came, and its terminal does not say whether it is held: if it repeats as a keyboard does, it is.

        That is: a stroke after a silence is a press, its first repetition comes after a keyboard's own delay, and
        the others follow without a pause.
        """
        same, since_ns = key == self._last, now_ns - self._last_ns
        goes_on = same and now_ns < self._until_ns
        begins = same and self._is_press and BEGIN_MIN_NS <= since_ns <= BEGIN_NS
        is_burst = strokes >= BURST_STROKES
        self._is_press = not (is_burst or goes_on or begins) and (since_ns > REPEAT_NS or not same)
        self._last, self._last_ns = key, now_ns
        self._until_ns = now_ns + REPEAT_NS if (goes_on or begins) and not is_burst else 0


def _character(code: int) -> str:
    if code in _CHARACTERS:
        return _CHARACTERS[code]
    return chr(code).lower() if 0x21 <= code < 0x7F else ""
