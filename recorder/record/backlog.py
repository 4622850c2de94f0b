"""What gateways still keep and this log lacks: found by gaps in the sequence, asked for piece by piece. Pure.

A recorder that starts late, or whose link was cut, gets the journal, the decisions and the events of before. One
piece is on its way at a time for each key, so that a thin link carries the present first.
"""

from __future__ import annotations

from typing import Final

from recorder.record.effects import AskKept, Effect
from schemas import keys
from schemas.decisions import Journal
from schemas.recorder_settings import ROBOT_LIMIT
from schemas.subjects import KEPT_PIECE, SUBJECTS, Subject

ANSWER_NS: Final = 1_000_000_000
"""A piece that is not whole after this time is asked for again..."""

TRIES: Final = 5
"""...so many times in a row, then it is given up."""

AGAIN_NS: Final = 2_000_000_000
"""Of a gateway that begins anew so soon after a question, the next one waits: two of one name look like that with
every sample."""

RANGES_MAX: Final = 32
"""Gaps of one key that wait; beyond it the oldest are given up."""

ASK_PER_TICK: Final = 8

KEPT_SUBJECTS: Final = tuple(subject for subject in SUBJECTS if subject.qos.kept_bytes)


class _Range:
    """Sequences that are missing: from ``start``, up to but not including ``end``; None is as far as it goes."""

    def __init__(self, start: int, end: int | None, *, counted: bool) -> None:
        self.start = start
        self.end = end
        self.counted = counted
        """The tally has counted them as missed."""
        self.asked_to = start
        self.asked_ns: int | None = None
        self.tries = 0

    @property
    def is_over(self) -> bool:
        """Nothing of it is missing any more."""
        return self.end is not None and self.start >= self.end

    def is_due(self, now_ns: int) -> bool:
        """The piece that was asked for has come, or does not come."""
        return self.asked_ns is None or self.start >= self.asked_to or now_ns - self.asked_ns >= ANSWER_NS


class _Key:
    def __init__(self, key: str, subject: Subject, now_ns: int) -> None:
        self.key = key
        # Where the past is cut off, the rest of a journal is worth nothing: it cannot be run again.
        self.whole_only = subject.type is Journal
        self.asked_ns: int | None = None
        self.begin(now_ns)

    def begin(self, now_ns: int) -> None:
        """A gateway is new to us: all it has said is missing."""
        self.begun_ns = now_ns
        self.ask_at_ns = now_ns if self.asked_ns is None else max(now_ns, self.asked_ns + AGAIN_NS)
        self.expected = 0
        self.ranges = [_Range(0, None, counted=False)]

    def hear(self, sequence: int) -> None:
        """A sample came by itself."""
        last = self.ranges[-1] if self.ranges else None
        if last is not None and last.end is None:
            last.end = sequence
        elif sequence > self.expected:
            self.ranges.append(_Range(self.expected, sequence, counted=True))
            del self.ranges[:-RANGES_MAX]
        self.expected = sequence + 1

    def ask(self, now_ns: int) -> Effect | None:
        """What is to be asked now."""
        self.ranges = [one for one in self.ranges if not one.is_over]
        if now_ns < self.ask_at_ns or not self.ranges or not self.ranges[0].is_due(now_ns):
            return None
        one = self.ranges[0]
        one.tries = one.tries + 1 if one.asked_ns is not None and one.start < one.asked_to else 0
        if one.tries >= TRIES:
            del self.ranges[0]
            return None
        self.asked_ns = one.asked_ns = now_ns
        one.asked_to = one.start + KEPT_PIECE
        return AskKept(self.key, one.start)


class Backlog:
    """The keys of a log whose samples the gateways keep for a while."""

    def __init__(self) -> None:
        self._keys: dict[str, _Key] = {}

    def see(self, root: str, robot: str, now_ns: int) -> None:
        """A robot is there; ask for what it said before."""
        if len(self._keys) >= ROBOT_LIMIT * len(KEPT_SUBJECTS):
            return
        for subject in KEPT_SUBJECTS:
            key = keys.build(root, robot, subject)
            if key not in self._keys:
                self._keys[key] = _Key(key, subject, now_ns)

    def hear(self, key: str, sequence: int, now_ns: int, *, is_restart: bool) -> None:
        """A sample came by itself. ``is_restart``: its sequence steps back."""
        one = self._keys.get(key)
        if one is None:
            return
        if is_restart:
            self._begin_again(one, key, now_ns)
        one.hear(sequence)

    def take(self, key: str, sequence: int) -> tuple[bool, bool]:
        """A sample came as a reply. Whether it was missing, and whether the tally has counted it so."""
        one = self._keys.get(key)
        wanted = one.ranges[0] if one is not None and one.ranges else None
        if one is None or wanted is None or sequence < wanted.start:
            return False, False
        if sequence > wanted.start and not wanted.tries:
            # Perhaps an earlier reply was lost: all that is missing is asked for once more.
            return False, False
        if wanted.end is not None and sequence >= wanted.end:
            return False, False
        if sequence > wanted.start and one.whole_only:
            one.ranges.pop(0)
            return False, False
        wanted.start = sequence + 1
        wanted.tries = 0
        one.expected = max(one.expected, wanted.start)
        return True, wanted.counted

    def ask(self, now_ns: int) -> list[Effect]:
        """The questions that are due."""
        effects: list[Effect] = []
        for one in self._keys.values():
            effect = one.ask(now_ns)
            if effect is not None:
                effects.append(effect)
            if len(effects) == ASK_PER_TICK:
                break
        return effects

    def ask_last(self, now_ns: int) -> list[Effect]:
        """The end of what was said may be missing too: nothing came after it that would show it."""
        for one in self._keys.values():
            if not one.ranges:
                one.ranges.append(_Range(one.expected, None, counted=False))
        return self.ask(now_ns)

    def _begin_again(self, one: _Key, key: str, now_ns: int) -> None:
        """One subject shows that a gateway has begun anew; what is seldom said would not."""
        one.begin(now_ns)
        parts = keys.parse(key)
        if parts is None:
            return
        for subject in KEPT_SUBJECTS:
            other = self._keys.get(keys.build(parts.root, parts.robot, subject))
            if other is not None and now_ns - other.begun_ns > TRIES * ANSWER_NS:
                other.begin(now_ns)
