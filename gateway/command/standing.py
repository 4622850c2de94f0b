"""The consequences of standing: people are warned before a robot moves, and an idle one is disengaged. Pure."""

from __future__ import annotations

from typing import Final

from schemas.settings import WARN_AGAIN_NS, CommandSettings

_NS_PER_S: Final = 1_000_000_000


class Standing:
    """The times of an engaged robot that is told to stand.

    Attributes:
        idle_ns: an engaged robot that is asked for no speed for so long is disengaged; 0 is never.
    """

    def __init__(self, settings: CommandSettings) -> None:
        self.idle_ns = round(settings.idle_s * _NS_PER_S)
        self._warning_ns = round(settings.warning_s * _NS_PER_S)
        self._asked_ns = self._stood_ns = 0

    def begin(self, now_ns: int) -> None:
        """The robot is engaged: it has not moved, and people are warned."""
        self._asked_ns = now_ns
        self._stood_ns = now_ns + self._warning_ns

    def tick(self, now_ns: int, *, is_asked: bool, is_parked: bool, moves: bool) -> None:
        """Note the speed that is asked for, and the one that is told.

        Args:
            now_ns: monotonic.
            is_asked: a speed is asked for.
            is_parked: none is told, whatever is asked for.
            moves: one was told in the last tick.
        """
        if is_asked:
            self._asked_ns = now_ns
        if moves:
            self._stood_ns = now_ns
        elif is_asked and not is_parked and now_ns - self._stood_ns >= WARN_AGAIN_NS:
            self._stood_ns = now_ns + self._warning_ns

    def warning_until_ns(self, now_ns: int) -> int | None:
        """Return when the warning that is under way ends; None if there is none."""
        return self._stood_ns if now_ns < self._stood_ns else None

    def is_idle(self, now_ns: int) -> bool:
        """No speed was asked for, for as long as a robot may be engaged without."""
        return 0 < self.idle_ns <= now_ns - self._asked_ns
