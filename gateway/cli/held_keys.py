"""Hold to move: the motion that the held keys ask for. Pure, time as an argument.

A terminal that reports releases is trusted while it answers: one behind a dead link reports nothing.
In any other, a key is held while it repeats: motion begins with its first repetition, and ends soon after the
last. A link that stalls delivers old strokes in a burst: after a pause or a burst a key must be let go and
pressed again.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

import msgspec

from gateway.cli.keyboard import Action, Flags, Focus, Heard, Stroke

REPEAT_NS: Final = 200_000_000
"""A key that repeats comes again within this time; slow keyboards take 90 ms."""

BEGIN_NS: Final = 800_000_000
"""A key that is held begins to repeat within this time; keyboards wait for up to 660 ms."""

BEGIN_MIN_NS: Final = 150_000_000
"""No keyboard begins to repeat sooner."""

BURST_STROKES: Final = 6
"""As many strokes of one key in one read have waited somewhere: the fastest keyboards take 15 ms for each."""

ANSWER_NS: Final = 400_000_000
"""A terminal that reports releases is no longer trusted when it has not answered for this long."""


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
that reports no releases repeats one key only, so speed and angle must come from one."""


class HeldKeys:
    """The keys that are held.

    Attributes:
        reports_releases: the terminal does, so keys may be held together.
    """

    def __init__(self) -> None:
        self.reports_releases = False
        self._held: list[str] = []
        self._answered_ns = 0
        self._last = ""
        self._last_ns = 0
        self._is_press = False
        self._until_ns = 0

    def receive(self, events: Iterable[Heard], now_ns: int) -> list[str]:
        """Take in what the terminal sent at one time. Returns the other keys that were pressed."""
        others: list[str] = []
        pressed, strokes = "", 0
        for event in events:
            match event:
                case Flags(reports_releases):
                    self._receive_flags(reports_releases, now_ns)
                case Stroke(key) if key in BINDINGS:
                    if event.action is not Action.RELEASE:
                        strokes = strokes + 1 if key == pressed else 1
                        pressed = key
                    self._hold(event)
                case Stroke(_, Action.RELEASE) | Focus(True):
                    pass
                case _:
                    self.release_all()
                    pressed = ""
                    if isinstance(event, Stroke) and event.action is Action.PRESS:
                        others.append(event.key)
        if pressed and not self.reports_releases:
            self._repeat(pressed, strokes, now_ns)
        return others

    def wish(self, now_ns: int) -> Wish:
        """Return the motion asked for now."""
        if self.reports_releases:
            if now_ns - self._answered_ns > ANSWER_NS:
                self._held.clear()
            return _together(self._held)
        return BINDINGS[self._last] if self._last and now_ns < self._until_ns else NOTHING

    def release_all(self) -> None:
        """Forget all held keys: each must be pressed again."""
        self._held.clear()
        self._last = ""
        self._until_ns = 0

    def _receive_flags(self, reports_releases: bool, now_ns: int) -> None:  # noqa: FBT001 - a field of the event
        if reports_releases is not self.reports_releases:
            self.release_all()
        self.reports_releases, self._answered_ns = reports_releases, now_ns

    def _hold(self, stroke: Stroke) -> None:
        """Follow presses and releases in a terminal that reports both. A repetition does not count as a press."""
        if stroke.action is Action.RELEASE and stroke.key in self._held:
            self._held.remove(stroke.key)
        if stroke.action is Action.PRESS and self.reports_releases and stroke.key not in self._held:
            self._held.append(stroke.key)

    def _repeat(self, key: str, strokes: int, now_ns: int) -> None:
        """A key came, and nobody knows whether it is held: if it repeats as a keyboard does, it is.

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


def _together(held: list[str]) -> Wish:
    """Keys that are held together; opposite ones cancel each other."""
    forward = sum(BINDINGS[key].forward for key in held)
    left = sum(BINDINGS[key].left for key in held)
    return Wish(max(-1, min(1, forward)), max(-1, min(1, left)))
