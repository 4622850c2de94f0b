"""Samples that gateways still keep and this log lacks: found by gaps in the sequence, queried in pieces. Pure.

A recorder that starts late, or whose link was cut, gets earlier journals, decisions and events. One
piece is on its way at a time for each key, so that a thin link carries the present first.
"""

from __future__ import annotations

from itertools import islice
from typing import Final

from recorder.record.actions import QUERIES_PER_TICK, Query
from schemas import keys
from schemas.decisions import Journal
from schemas.settings import ROBOT_LIMIT
from schemas.subjects import KEPT_PIECE, SUBJECTS, Subject

ANSWER_NS: Final = 1_000_000_000
"""A piece that is not whole after this time is asked for again."""

TRIES: Final = 5
"""Queries for one piece in a row; then it is given up."""

AGAIN_NS: Final = 2_000_000_000
"""Shortest time between two queries for the whole past of a key: two gateways of one name look like a restart with
every sample."""

RANGES_MAX: Final = 32
"""Gaps of one key that wait; beyond it the oldest are given up."""

HELD: Final = 16_384
"""Samples of one key that are known again, by their place in the run: as many as a gateway keeps, in 2 MB."""

KEPT_SUBJECTS: Final = tuple(subject for subject in SUBJECTS if subject.qos.kept_bytes)


class _Range:
    """Sequences that are missing: from ``start``, up to but not including ``end``; None is as far as it goes."""

    def __init__(self, start: int, end: int | None, *, counted: bool) -> None:
        self.start = start
        self.end = end
        self.counted = counted
        """The key's counters count them as missed."""
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
        # Hashes of what the log has, by place: who repeats a robot's sample makes it look as if it had begun anew.
        self._held: dict[int, int] = {}
        self.asked_ns: int | None = None
        self.begin(now_ns)

    def begin(self, now_ns: int) -> None:
        """Treat the gateway as new: all that it has published is missing."""
        self.begun_ns = now_ns
        self.ask_at_ns = now_ns if self.asked_ns is None else max(now_ns, self.asked_ns + AGAIN_NS)
        self.expected = 0
        self.ranges = [_Range(0, None, counted=False)]

    def receive(self, sequence: int) -> None:
        """Note a sample that came by itself."""
        last = self.ranges[-1] if self.ranges else None
        if last is not None and last.end is None:
            last.end = sequence
        elif sequence > self.expected:
            self.ranges.append(_Range(self.expected, sequence, counted=True))
            del self.ranges[:-RANGES_MAX]
        self.expected = sequence + 1

    def hold(self, sequence: int, payload: bytes) -> bool:
        """Note that the log has a sample from now on. False if it had it before."""
        place, digest = sequence % HELD, hash(payload)
        is_new = self._held.get(place) != digest
        self._held[place] = digest
        return is_new

    def query(self, now_ns: int) -> Query | None:
        """The query that is due."""
        while self.ranges and self.ranges[0].is_over:
            del self.ranges[0]
        if not self.ranges or now_ns < self.ask_at_ns or not self.ranges[0].is_due(now_ns):
            return None
        one = self.ranges[0]
        one.tries = one.tries + 1 if one.asked_ns is not None and one.start < one.asked_to else 0
        if one.tries >= TRIES:
            del self.ranges[0]
            return None
        self.asked_ns = one.asked_ns = now_ns
        one.asked_to = one.start + KEPT_PIECE
        return Query(self.key, one.start)


class Backlog:
    """The keys of a log whose samples the gateways keep for a while."""

    def __init__(self) -> None:
        self._keys: dict[str, _Key] = {}

    def see(self, root: str, robot: str, now_ns: int) -> None:
        """Ask a robot for what it published before, if it is new."""
        if len(self._keys) >= ROBOT_LIMIT * len(KEPT_SUBJECTS):
            return
        for subject in KEPT_SUBJECTS:
            key = keys.build(root, robot, subject)
            if key not in self._keys:
                self._keys[key] = _Key(key, subject, now_ns)

    def receive(self, key: str, sequence: int, payload: bytes, now_ns: int, *, is_restart: bool) -> None:
        """Note a sample that came by itself. ``is_restart``: its sequence steps back."""
        one = self._keys.get(key)
        if one is None:
            return
        if is_restart:
            self._begin_again(one, key, now_ns)
        one.receive(sequence)
        one.hold(sequence, payload)

    def receive_reply(self, key: str, sequence: int, payload: bytes) -> tuple[bool, bool]:
        """Note a sample that came as a reply. Whether it was missing, and whether it was counted as missed."""
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
        return one.hold(sequence, payload), wanted.counted

    def queries(self, now_ns: int, most: int = QUERIES_PER_TICK) -> list[Query]:
        """The queries that are due, at most so many; the others stay due."""
        due = (query for one in self._keys.values() if (query := one.query(now_ns)) is not None)
        return list(islice(due, most))

    def ask_last(self) -> None:
        """Ask for the end, too: the last samples may be missing, and nothing came after them to show it."""
        for one in self._keys.values():
            missing = [part for part in one.ranges if not part.is_over]
            one.ranges = missing or [_Range(one.expected, None, counted=False)]

    def _begin_again(self, one: _Key, key: str, now_ns: int) -> None:
        """Begin again with all subjects of a gateway: those that are seldom published would not show a restart."""
        one.begin(now_ns)
        parts = keys.parse(key)
        if parts is None:
            return
        for subject in KEPT_SUBJECTS:
            other = self._keys.get(keys.build(parts.root, parts.robot, subject))
            if other is not None and now_ns - other.begun_ns > TRIES * ANSWER_NS:
                other.begin(now_ns)
