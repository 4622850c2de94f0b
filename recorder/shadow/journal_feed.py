"""The journal of a robot as it comes over the network: part by part, each without a gap. Pure."""

from __future__ import annotations

from collections import deque
from typing import Final

from schemas.decisions import Journal

ANSWER_NS: Final = 1_000_000_000
"""A piece of the past that has not come after this time is asked for again."""

TRIES: Final = 15
"""Queries for one piece in a row; then the gateway counts as one that does not keep it."""

WAITING_MAX: Final = 20_000
"""Journals that wait while the past is fetched, a quarter of an hour's; beyond it the oldest go."""

RESTARTED: Final = "the gateway was started again"


class JournalFeed:
    """Journals in, as they come, and out again in their order.

    A part ends where something is missing, or where another run begins; there the next part begins.

    Args:
        from_start: begin a run with the oldest journals that the gateway keeps, which are asked for; else with the
            first that comes by itself.

    Attributes:
        ended: why the part has ended; empty as long as it has not.
        run: the number of the run; None before its first journal.
    """

    def __init__(self, *, from_start: bool) -> None:
        self.ended = ""
        self.run: int | None = None
        self._from_start = from_start
        self._live: deque[Journal] = deque(maxlen=WAITING_MAX)
        self._replies: deque[Journal] = deque(maxlen=WAITING_MAX)
        self._is_fetching = False
        self._begin()

    def _begin(self) -> None:
        self._expected: int | None = None
        """The place of the next input."""
        self._sequence = 0
        """Of the next journal."""
        self._asked_ns: int | None = None
        self._tries = 0

    def receive(self, journal: Journal, *, is_reply: bool) -> None:
        """Take a journal, by itself or out of the past."""
        if journal.count:
            (self._replies if is_reply else self._live).append(journal)

    def begin_part(self) -> None:
        """Begin another part, once one has ended."""
        self.ended = ""
        self._begin()

    def next(self) -> Journal | None:
        """The next journal of the part; None if it has not come, or the part has ended."""
        while not self.ended and self._live:
            journal = self._live[0]
            if journal.run != self.run:
                if self._expected is not None:
                    self.ended = RESTARTED
                    break
                self.run, self._is_fetching = journal.run, self._from_start
                self._replies.clear()
            elif self._is_fetching and not self._meets(journal):
                return self._out_of_the_past()
            elif self._expected is not None and journal.first < self._expected:
                self._live.popleft()
            elif self._expected is not None and journal.first > self._expected:
                self.ended = f"inputs {self._expected} to {journal.first - 1} are missing"
            else:
                return self._taken(self._live.popleft())
        return None

    def query(self, now_ns: int) -> int | None:
        """The sequence from which on journals are to be asked for, if that is due."""
        is_asked = self._asked_ns is not None and now_ns - self._asked_ns < ANSWER_NS
        if not self._is_fetching or not self._live or self._replies or is_asked:
            return None
        if self._tries >= TRIES:
            self._is_fetching = False
            return None
        self._asked_ns, self._tries = now_ns, self._tries + 1
        return self._sequence

    def _meets(self, live: Journal) -> bool:
        """Report whether the past has met the present, and then no more of it is wanted."""
        self._is_fetching = live.first > (self._expected or 0)
        return not self._is_fetching

    def _out_of_the_past(self) -> Journal | None:
        while self._replies:
            journal = self._replies.popleft()
            # The gateway's oldest, and then one behind the other.
            if journal.run == self.run and self._expected in {None, journal.first}:
                self._tries, self._asked_ns = 0, self._asked_ns if self._replies else None
                return self._taken(journal)
        return None

    def _taken(self, journal: Journal) -> Journal:
        self._expected, self._sequence = journal.first + journal.count, journal.sequence + 1
        return journal
