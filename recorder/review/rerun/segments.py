"""The places at which a robot's runs can be cut, so that several processes run them again in parallel. Pure.

A run can be run again from any checkpoint in its journal, and from any place where the gateway was at rest. A
segment goes from one such place to another.
Which messages belong in it is said by their times alone: a robot whose clock was ever set back is not cut.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Final

import msgspec

from recorder.reading.faults import Faults
from recorder.reading.rows import END_OF_TIME_NS, Row
from recorder.reading.topics import UNREADABLE
from recorder.review.rerun.tapes import JOURNAL, PartEnd, Tape
from schemas.decisions import Journal

SETTLED_NS: Final = 500_000_000
"""Time between a place and the cut: what is said in batches is then all of this side or of that."""

BEFORE_NS: Final = 4_500_000_000
"""The inputs that are needed before a cut: a gateway looks back three seconds from where it was at rest."""

BEHIND_NS: Final = 1_500_000_000
"""The inputs that are needed behind the end of a segment, so that all that belongs in it has come out."""

EARLY_NS: Final = 5_000_000_000
"""A record is received no sooner than this before the soonest journal."""

LATE_NS: Final = 30_000_000_000
"""A record is received no later than this after the latest journal."""

Places = Callable[[Journal], list[int]]
"""A journal message to the times in it from which a run can be run again, in nanoseconds since 1970."""


class RunSegment(msgspec.Struct, frozen=True):
    """A part of a robot's time. Times are nanoseconds since 1970; by default it is all of it.

    Attributes:
        from_ns, to_ns: messages that were published from then on, and before then, are compared.
        inputs_from_ns, inputs_to_ns: journals that were published then are needed for it.
        log_from_ns, log_to_ns: the range of log times that is needed.
    """

    from_ns: int = 0
    to_ns: int = END_OF_TIME_NS
    inputs_from_ns: int = 0
    inputs_to_ns: int = END_OF_TIME_NS
    log_from_ns: int = 0
    log_to_ns: int = END_OF_TIME_NS

    def holds(self, time_ns: int) -> bool:
        """Report whether what was published then is compared in it."""
        return self.from_ns <= time_ns < self.to_ns

    def needs(self, row: Row) -> bool:
        """Report whether a row is a journal that is needed, or something else that is compared."""
        if row.topic.subject == JOURNAL:
            return self.inputs_from_ns <= row.publish_ns <= self.inputs_to_ns
        return self.holds(row.publish_ns)


WHOLE: Final = RunSegment()


class Plan(msgspec.Struct, frozen=True):
    """The plan by which a robot's runs are run again.

    Attributes:
        parts: the runs, and the parts of runs between gaps.
        segments: one behind the other; only one if there is nowhere to cut.
    """

    parts: list[PartEnd]
    segments: list[RunSegment]


class JournalLateness:
    """The least and the most time between publication and receipt of the journals.

    Attributes:
        least_ns, most_ns: of those that were watched so far.
    """

    def __init__(self) -> None:
        self.least_ns = END_OF_TIME_NS
        self.most_ns = -END_OF_TIME_NS

    def watch(self, rows: Iterator[Row]) -> Iterator[Row]:
        """The same rows, looked at."""
        for row in rows:
            if row.topic.subject == JOURNAL:
                late_ns = row.log_ns - row.publish_ns
                self.least_ns = min(self.least_ns, late_ns)
                self.most_ns = max(self.most_ns, late_ns)
            yield row


def plan(
    rows: Iterator[Row],
    places_in: Places,
    length_ns: int,
    faults: Faults,
    take: Callable[[Row], None] = lambda _: None,
) -> Plan:
    """Look through a robot's journals for places to cut.

    Args:
        rows: of its journals, by log time.
        places_in: finds the places from which a run can be run again.
        length_ns: a segment is at least so long.
        faults: takes what cannot be read.
        take: takes each row that is no journal.
    """
    lateness = JournalLateness()
    tape = Tape(lateness.watch(rows), take, faults)
    parts: list[PartEnd] = []
    cuts: list[int] = []
    begins_ns, newest_ns, is_steady = None, 0, True
    while tape.next_part():
        places: list[int] = []
        part_ns = None
        for journal in tape.journals():
            is_steady = is_steady and journal.time_ns >= newest_ns
            newest_ns = journal.time_ns
            part_ns = newest_ns if part_ns is None else part_ns
            begins_ns = newest_ns if begins_ns is None else begins_ns
            try:
                places += places_in(journal)
            except UNREADABLE:
                is_steady = False
        parts.append(tape.end)
        for place_ns in places:
            cut_ns = place_ns + SETTLED_NS
            is_inside = (part_ns or 0) + BEFORE_NS < place_ns and cut_ns + BEHIND_NS < newest_ns
            if is_inside and cut_ns - (cuts[-1] if cuts else begins_ns or 0) >= length_ns:
                cuts.append(cut_ns)
    return Plan(parts, _segments(cuts, lateness) if is_steady else [WHOLE])


def _segments(cuts: list[int], lateness: JournalLateness) -> list[RunSegment]:
    segments = [WHOLE]
    for cut_ns in cuts:
        first_ns, last_ns = cut_ns - BEFORE_NS, cut_ns + BEHIND_NS
        segments[-1] = msgspec.structs.replace(
            segments[-1],
            to_ns=cut_ns,
            inputs_to_ns=last_ns,
            log_to_ns=last_ns + lateness.most_ns + LATE_NS,
        )
        log_from_ns = max(0, first_ns + lateness.least_ns - EARLY_NS)
        segments.append(RunSegment(from_ns=cut_ns, inputs_from_ns=first_ns, log_from_ns=log_from_ns))
    return segments
