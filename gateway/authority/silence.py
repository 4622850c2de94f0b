"""The time since the last word of the authority: a statement that was new, and verified. Pure.

While a robot is on it counts by the time since the machine's start, and that is kept across restarts: no clock can
take any of it back. The time that it was off is known from the floor of time and the wall clock alone. So from a
restart on the longer of both counts: a clock that is set back hides at most the time off, and one that is set
forward only lengthens the silence.

An answer to the robot's challenge is of now. A list of revocations, or a rotation, is as old as it says: whoever
kept one back, and shows it today, ends no silence with it. Where the clock is behind, the list
seems younger than it is; after a restart its own date counts, whatever the clock says.
"""

from __future__ import annotations

_S = 1_000_000_000


class AuthoritySilence:
    """The authority's silence; of an authority that said nothing yet, since the robot's first start under it.

    Attributes:
        is_heard: the authority, or a site, has answered a challenge since this start.
    """

    def __init__(self, boot_ns: int, on_s: int = 0, since_s: int | None = None) -> None:
        """The silence as it was kept.

        Args:
            boot_ns: time since the machine's start, sleep included (CLOCK_BOOTTIME).
            on_s: so long the robot was on since the last word.
            since_s: when that was, seconds since 1970; None before the robot's first start.
        """
        self.is_heard = False
        self._begun_ns = boot_ns - on_s * _S
        self._since_s = since_s
        self._dated_s: int | None = None  # when the word of this run was signed, if it says so

    def hear_answer(self, boot_ns: int) -> None:
        """An answer to a challenge was received: it is of now."""
        self.is_heard, self._begun_ns, self._since_s, self._dated_s = True, boot_ns, None, None

    def hear_statement(self, at_s: int, boot_ns: int, now_s: int) -> None:
        """A newer statement was received, which may have been signed long ago.

        Args:
            at_s: when it was signed, as it says itself, seconds since 1970.
            boot_ns: time since the machine's start.
            now_s: the time by which grants are judged.
        """
        age_ns = max(0, now_s - at_s) * _S
        if age_ns < self.length_ns(boot_ns, now_s):
            self._begun_ns, self._since_s, self._dated_s = boot_ns - age_ns, None, at_s

    def length_ns(self, boot_ns: int, now_s: int) -> int:
        """The time since the last word.

        Args:
            boot_ns: time since the machine's start.
            now_s: the time by which grants are judged, seconds since 1970.
        """
        on_ns = boot_ns - self._begun_ns
        return on_ns if self._since_s is None else max(on_ns, (now_s - self._since_s) * _S)

    def kept(self, boot_ns: int, now_s: int) -> tuple[int, int]:
        """The time that the robot was on since the last word, and when that was.

        An answer of this run is dated anew each time: a clock that is right only minutes later dates it too.
        """
        on_s = (boot_ns - self._begun_ns) // _S
        if self._since_s is not None:
            return on_s, self._since_s
        return on_s, now_s - on_s if self._dated_s is None else self._dated_s
