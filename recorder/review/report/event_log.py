"""The events of one robot, from the entries of the timeline, in memory that does not grow with them."""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter, deque
from collections.abc import Sequence
from typing import Final

import msgspec

from recorder.review.entries import Entry, EntryKind, EntrySource
from recorder.review.report.findings import Moment, Outage, Silence
from recorder.review.report.odometry import Place
from schemas.decisions import Severity
from schemas.reasons import Reason

MOMENTS_MAX: Final = 2000
ERRORS_MAX: Final = 500
"""Errors that are kept beyond these: a thousand leases must not hide a gateway that died."""

OUTAGES_MAX: Final = 200
SILENCES_MAX: Final = 200

RECENT: Final = 50
"""Silences among which the one before a restart is."""

BEYOND_NS: Final = 24 * 3600 * 1_000_000_000
"""A time that is further from all that the robot said is of no use."""

CLOCKS_APART_NS: Final = 2_000_000_000
"""The robot's clock and the recorder's may differ by so much, and the log times are the recorder's."""

DIED: Final = "gateway_died"
"""The cause of a stop of which no more is known."""

_IN_OTHER_TABLES: Final = frozenset({EntryKind.REFUSAL, EntryKind.REQUEST})


class EventLog:
    """Gathers entries, which come in the order of their time, as far as that is known.

    Attributes:
        stops: number of stops, by reason.
        ends: likewise what was asked for.
        counts: entries by kind.
        outages: when the gateway fell silent or began anew; ``more_outages`` are left out.
        silences: other gaps of the log; ``more_silences`` are left out.
    """

    def __init__(self) -> None:
        self.stops: Counter[str] = Counter()
        self.ends: Counter[str] = Counter()
        self.counts: Counter[str] = Counter()
        self.outages: list[Outage] = []
        self.silences: list[Silence] = []
        self.more_outages = self.more_silences = 0
        self._entries: list[Entry] = []
        self._recent: deque[Silence] = deque(maxlen=RECENT)
        self._cause = ""
        self._stop_at = 0

    def take(self, entry: Entry) -> None:
        """Add the next one."""
        if entry.kind in _IN_OTHER_TABLES:
            return
        self._keep(entry)
        self._count_stop(entry)
        if entry.kind is EntryKind.END:
            self.ends[entry.reason.value] += 1
        elif entry.kind is EntryKind.GAP and entry.source is EntrySource.LOG and entry.last_ns > entry.time_ns:
            self._take_silence(entry)
        elif _is_restart(entry):
            self._take_restart(entry)

    def set_apart(self, pauses: Sequence[tuple[int, int]]) -> None:
        """Between two logs nobody knows whether a gateway was silent."""
        self.outages = [
            msgspec.structs.replace(one, is_between_logs=True) if _is_pause(one, pauses) else one
            for one in self.outages
        ]

    def moments(self, places: Sequence[Place], start_ns: int, end_ns: int) -> list[Moment]:
        """The events to be shown, by time.

        Args:
            places: the path, by time.
            start_ns: the first time of what the robot said...
            end_ns: ...and the last one.
        """
        times_ns = [place.time_ns for place in places]
        first_ns, last_ns = start_ns - BEYOND_NS, end_ns + BEYOND_NS
        found = []
        for entry in self._entries:
            near_ns = (
                entry.time_ns if first_ns < entry.time_ns < last_ns else min(max(entry.time_ns, start_ns), end_ns)
            )
            place = places[max(0, bisect_right(times_ns, near_ns) - 1)] if places else None
            found.append(_moment(entry, near_ns, place))
        return sorted(found, key=lambda moment: moment.time_ns)

    @property
    def more_moments(self) -> int:
        """Number of events for which there was no room."""
        return self.counts.total() - len(self._entries)

    def _keep(self, entry: Entry) -> None:
        self.counts[entry.kind.value] += 1
        room = MOMENTS_MAX + (ERRORS_MAX if entry.severity is Severity.ERROR else 0)
        if len(self._entries) < room:
            self._entries.append(entry)

    def _count_stop(self, entry: Entry) -> None:
        """Count a stop by its cause; of a gateway that died the next one may say it."""
        if entry.is_stop:
            self._cause = DIED if entry.reason is Reason.NONE else entry.reason.value
            self._stop_at = len(self._entries) - 1
            self.stops[self._cause] += 1
        elif entry.kind is EntryKind.ENGAGED:
            self._cause = ""
        elif entry.kind is EntryKind.LATCH and self._cause == DIED:
            self.stops[DIED] -= 1
            self._cause = entry.reason.value
            self.stops[self._cause] += 1
            stop = self._entries[self._stop_at]
            self._entries[self._stop_at] = msgspec.structs.replace(stop, reason=entry.reason)

    def _take_silence(self, entry: Entry) -> None:
        silence = Silence(entry.time_ns, entry.last_ns, entry.text)
        self._recent.append(silence)
        if len(self.silences) < SILENCES_MAX:
            self.silences.append(silence)
        else:
            self.more_silences += 1

    def _take_restart(self, entry: Entry) -> None:
        """Add another gateway; a long silence before it has been added."""
        heard_ns = entry.time_ns
        before = next((one for one in reversed(self._recent) if one.to_ns == entry.time_ns), None)
        if before is not None:
            heard_ns = before.from_ns
            if before in self.silences:
                self.silences.remove(before)
            else:
                self.more_silences -= 1
        self.add_outage(Outage(heard_ns, entry.time_ns, entry.severity is Severity.ERROR))

    def add_outage(self, outage: Outage) -> None:
        """The gateway fell silent."""
        if len(self.outages) < OUTAGES_MAX:
            self.outages.append(outage)
        else:
            self.more_outages += 1


def _is_restart(entry: Entry) -> bool:
    """Note another gateway, whose predecessor did not shut down as requested."""
    is_grave = entry.severity is not Severity.INFO
    return entry.kind is EntryKind.GATEWAY and is_grave and entry.source is not EntrySource.RECORDER


def _is_pause(outage: Outage, pauses: Sequence[tuple[int, int]]) -> bool:
    began_ns = outage.began_ns
    if began_ns is None:
        return False
    return any(
        outage.heard_ns - CLOCKS_APART_NS <= from_ns and to_ns <= began_ns + CLOCKS_APART_NS
        for from_ns, to_ns in pauses
    )


def _moment(entry: Entry, time_ns: int, place: Place | None) -> Moment:
    return Moment(
        time_ns=time_ns,
        last_ns=max(time_ns, entry.last_ns + time_ns - entry.time_ns),
        kind=entry.kind.value,
        severity=entry.severity.value,
        count=entry.count,
        reason=entry.reason.value,
        operator=entry.operator,
        holder=entry.holder,
        text=entry.text,
        x_m=None if place is None else place.x_m,
        y_m=None if place is None else place.y_m,
        is_stop=entry.is_stop,
    )
