"""The age of an operator's commands when they are executed, and the speed that it allows. Pure.

A robot that drives on what its operator saw a while ago, and continues for the deadman's time after a link loss,
covers some metres before it can react. The setting ``command.travel_delay_m`` bounds these metres, and thereby the
speed.
"""

from __future__ import annotations

from collections import deque
from itertools import takewhile
from math import copysign
from typing import Final

import msgspec

from gateway.command.motion import Target
from schemas.reasons import Reason
from schemas.settings import DEADMAN_MAX_S, CommandSettings

MEAN_NS: Final = 1_000_000_000
"""The age that bounds the speed is at least the mean of so long: no deadman lasts longer."""

LARGEST_NS: Final = 300_000_000
"""And at least the largest of so long: a link that has just become slow is slow."""

QUANTILES_NS: Final = 10_000_000_000
"""Time over which the median and the 99th percentile are taken."""

RANK_NS: Final = 200_000_000
"""Period at which both are found anew: sorting takes time in the loop."""

KEPT: Final = 500
"""Commands that they are taken of at most, 50 a second."""

REFUSED_AS: Final = {
    Reason.TOO_OLD: "too old",
    Reason.CHALLENGE_UNKNOWN: "echoing an unknown challenge",
    Reason.SEQUENCE: "out of sequence",
}
"""Refusals that keep a stream of commands from holding off the deadman, in words."""

_NS_PER_S: Final = 1_000_000_000


class Ages(msgspec.Struct, frozen=True):
    """Ages of the accepted commands, in seconds; None where there were none.

    Attributes:
        age_s: the age that bounds the speed, the camera's delay included.
        last_s: of the last command.
        p50_s, p99_s: of the last ten seconds.
    """

    age_s: float | None = None
    last_s: float | None = None
    p50_s: float | None = None
    p99_s: float | None = None


class LinkAge:
    """The link of one holder of the lease, as its commands show it.

    Attributes:
        deadman_ns: without an acceptable drive command for this long, an engaged robot is stopped.
        accepted_seq: the sequence of the last accepted drive command; None before the first.
    """

    def __init__(self, settings: CommandSettings) -> None:
        self._travel_delay_m = settings.travel_delay_m
        self._view_delay_ns = round(settings.view_delay_s * _NS_PER_S)
        self._configured_s = settings.deadman_s
        self.deadman_ns = round(settings.deadman_s * _NS_PER_S)
        self.accepted_seq: int | None = None
        self._ages: deque[tuple[int, int]] = deque(maxlen=KEPT)
        self._recent: deque[tuple[int, int]] = deque()
        self._recent_sum_ns = 0
        self._rank_due_ns = 0
        self._quantiles_s: tuple[float | None, float | None] = (None, None)
        self._refused: dict[Reason, tuple[int, int | None]] = {}

    def begin(self, deadman_s: float | None) -> None:
        """Begin an engagement, with a longer deadman than the configured one if that is asked for."""
        wanted_s = min(max(deadman_s or 0.0, self._configured_s), DEADMAN_MAX_S)
        self.deadman_ns = round(wanted_s * _NS_PER_S)
        self._refused.clear()

    def accept(self, seq: int, age_ns: int, now_ns: int) -> None:
        """Note an accepted drive command."""
        self.accepted_seq = seq
        self._ages.append((now_ns, age_ns))
        self._recent.append((now_ns, age_ns))
        self._recent_sum_ns += age_ns
        self._refused.clear()

    def refuse(self, reason: Reason, age_ns: int | None) -> None:
        """Note a drive command that was refused; only what is wrong with the link counts."""
        if reason in REFUSED_AS:
            count, _ = self._refused.get(reason, (0, None))
            self._refused[reason] = count + 1, age_ns

    def silence(self, silent_ns: int) -> str:
        """Describe what came since the last accepted command: nothing, or what was refused and how old it was."""
        words = [f"none for {silent_ns / 1e6:.0f} ms"]
        for reason, (count, age_ns) in self._refused.items():
            commands = "1 command" if count == 1 else f"{count} commands"
            age = "" if age_ns is None else f", {age_ns / 1e6:.0f} ms"
            words.append(f"{commands} refused as {REFUSED_AS[reason]}{age}")
        return "; ".join(words)

    def ages(self, now_ns: int) -> Ages:
        """Return how old the commands were that were accepted lately."""
        if not self._ages or now_ns - self._ages[-1][0] > QUANTILES_NS:
            return Ages()
        age_ns = self._age_ns(now_ns)
        if now_ns >= self._rank_due_ns:
            self._rank_due_ns = now_ns + RANK_NS
            self._quantiles_s = self._rank(now_ns)
        p50_s, p99_s = self._quantiles_s
        return Ages(None if age_ns is None else age_ns / 1e9, self._ages[-1][1] / 1e9, p50_s, p99_s)

    def _rank(self, now_ns: int) -> tuple[float | None, float | None]:
        """The median and the 99th percentile."""
        ages_ns = sorted(age_ns for at_ns, age_ns in self._ages if now_ns - at_ns <= QUANTILES_NS)
        if not ages_ns:
            return None, None
        return ages_ns[(len(ages_ns) - 1) // 2] / 1e9, ages_ns[(len(ages_ns) - 1) * 99 // 100] / 1e9

    def speed_limit_mps(self, now_ns: int) -> float | None:
        """Return the highest speed that the travel delay allows; None while no age is known."""
        delay_s = self.delay_s(now_ns)
        return None if delay_s is None else self._travel_delay_m / delay_s

    def delay_s(self, now_ns: int) -> float | None:
        """Return the time from what the operator saw to the stop that follows a cut link; None if not known."""
        age_ns = self._age_ns(now_ns)
        return None if age_ns is None else (age_ns + self.deadman_ns) / 1e9

    def bounded(self, target: Target, fastest_mps: float, now_ns: int) -> Target:
        """Return the target, or one as fast as the travel delay allows if no other limit is lower."""
        limit_mps = self.speed_limit_mps(now_ns)
        if limit_mps is None or min(abs(target.speed_mps), fastest_mps) <= limit_mps:
            return target
        return Target(copysign(limit_mps, target.speed_mps), target.angle_deg)

    def _age_ns(self, now_ns: int) -> int | None:
        """The age of what the operator drives by; None where no command was accepted in the last second."""
        recent = self._recent
        while recent and now_ns - recent[0][0] > MEAN_NS:
            self._recent_sum_ns -= recent.popleft()[1]
        if not recent:
            return None
        newest = takewhile(lambda one: now_ns - one[0] <= LARGEST_NS, reversed(recent))
        largest_ns = max((age_ns for _, age_ns in newest), default=0)
        return max(self._recent_sum_ns // len(recent), largest_ns) + self._view_delay_ns
