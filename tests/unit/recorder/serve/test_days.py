"""The days of a catalog."""

import msgspec

from recorder.review.catalog.rows import INCIDENT, NEVER_NS
from recorder.review.catalog.table import to_table
from recorder.serve.days import DAY_NS, DAYS_COLUMNS, LoggedDay, days
from tests.support.catalog import DRIVE, STOP, row
from tests.support.messages import WALL_NS

MIDNIGHT_NS = WALL_NS // DAY_NS * DAY_NS


def moment(time_ns: int, kind: str = "stop", *, is_stop: bool = True) -> msgspec.Struct:
    """A moment of this kind."""
    return msgspec.structs.replace(STOP, time_ns=time_ns, last_ns=time_ns, kind=kind, is_stop=is_stop)


def test_each_day_has_its_drives_stops_and_incidents() -> None:
    """A day ends at midnight in UTC; a drive belongs to the day on which it began."""
    late = msgspec.structs.replace(DRIVE, start_ns=MIDNIGHT_NS + DAY_NS - 1, end_ns=MIDNIGHT_NS + DAY_NS + 1)
    moments = [
        moment(MIDNIGHT_NS),
        moment(MIDNIGHT_NS + DAY_NS - 1),
        moment(MIDNIGHT_NS + DAY_NS),
        moment(MIDNIGHT_NS + 1, INCIDENT, is_stop=False),
        moment(MIDNIGHT_NS + 2, "lease", is_stop=False),
    ]
    first, second = days(to_table([row(drives=[DRIVE, late], moments=moments)]).select(DAYS_COLUMNS))
    assert (first.drives, first.stops, first.incidents, first.distance_m) == (2, 2, 1, 2 * DRIVE.distance_m)
    assert second == LoggedDay(day=second.day, drives=0, distance_m=0.0, stops=1, incidents=0)
    assert first.day < second.day


def test_what_two_logs_hold_counts_once() -> None:
    """An incident beside its log repeats what happened; one that is covered does not count at all."""
    rows = [
        row(drives=[DRIVE], moments=[STOP]),
        row(file="b.mcap", drives=[DRIVE], moments=[STOP], is_incident=True),
        row(file="c.mcap", drives=[DRIVE], moments=[moment(MIDNIGHT_NS)], is_incident=True, is_covered=True),
    ]
    (day,) = days(to_table(rows).select(DAYS_COLUMNS))
    assert (day.drives, day.stops) == (1, 1)


def test_no_log_makes_no_day_and_every_time_has_one() -> None:
    """The first and the last time that a catalog can have are days as others."""
    assert days(to_table([]).select(DAYS_COLUMNS)) == []
    first, last = days(to_table([row(moments=[moment(NEVER_NS), moment(0)])]).select(DAYS_COLUMNS))
    assert (first.day, last.day) == ("1970-01-01", "2262-04-11")
