"""The beginning of a part of a log from which its runs can be run again."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Final

from recorder.reading.faults import Faults
from recorder.reading.rows import END_OF_TIME_NS, Row
from recorder.reading.topics import UNREADABLE
from recorder.review.rerun.tapes import JOURNAL, Tape
from schemas.decisions import Journal

MARGIN_NS: Final = 1_000_000_000
"""A batch is published up to this long after the oldest sample in it."""

BEFORE_NS: Final = 4_500_000_000
"""The inputs that are needed before a place: a gateway looks back three seconds from where it was at rest."""

Places = Callable[[Journal], list[int]]
"""A journal message to the times in it from which a run can be run again, in nanoseconds since 1970."""


def beginning(
    rows: Iterator[Row], places_in: Places, until_ns: int, incident_ns: int, faults: Faults
) -> int | None:
    """The log time from which on a robot's run can be run again up to an incident; None if there is none.

    Args:
        rows: the robot's journals, by log time.
        places_in: finds the places from which a run can be run again.
        until_ns: the log time by which it should begin; where it cannot, it begins as soon as it can.
        incident_ns: the log time by which it has to begin.
        faults: takes what cannot be read.
    """
    lateness = _JournalLateness()
    tape = Tape(lateness.watch(rows), lambda _: None, faults)
    places: list[int] = []
    while tape.next_part():
        part_ns: int | None = None
        for journal in tape.journals():
            if part_ns is None:
                part_ns = journal.time_ns
                if part_ns + lateness.least_ns <= incident_ns:
                    # Behind a gap nothing of before is of use.
                    places.clear()
                if journal.first == 0:
                    places.append(part_ns)
            try:
                found = places_in(journal)
            except UNREADABLE as error:
                faults.add(f"a journal that cannot be read: {error}")
                continue
            places += [place_ns - BEFORE_NS for place_ns in found if place_ns - BEFORE_NS >= part_ns]
    begins = [place_ns + lateness.least_ns - MARGIN_NS for place_ns in places]
    early = [begin_ns for begin_ns in begins if begin_ns <= until_ns]
    late = [begin_ns for begin_ns in begins if until_ns < begin_ns <= incident_ns]
    return max(early) if early else min(late, default=None)


class _JournalLateness:
    """The least time between publication and receipt of the journals that were watched so far."""

    def __init__(self) -> None:
        self.least_ns = END_OF_TIME_NS

    def watch(self, rows: Iterator[Row]) -> Iterator[Row]:
        """The same rows, looked at."""
        for row in rows:
            if row.topic.subject == JOURNAL:
                self.least_ns = min(self.least_ns, row.log_ns - row.publish_ns)
            yield row
