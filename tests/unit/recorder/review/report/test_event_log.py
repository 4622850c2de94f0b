"""What happened to one robot, from the entries of the timeline."""

import msgspec
import pytest

from recorder.review.entries import Entry, EntryKind, EntrySource, kind_of
from recorder.review.report.event_log import DIED, ERRORS_MAX, MOMENTS_MAX, OUTAGES_MAX, SILENCES_MAX, EventLog
from recorder.review.report.findings import Outage
from recorder.review.report.odometry import Place
from recorder.review.stops import Stops
from schemas.decisions import Severity
from schemas.reasons import AS_ASKED, Reason
from tests.support.messages import SECOND, WALL_NS

HOUR_NS = 3600 * SECOND


def entry(at_s: float, kind: EntryKind, **fields: object) -> Entry:
    """Something that happened so long after the beginning."""
    time_ns = WALL_NS + round(at_s * SECOND)
    plain = Entry(
        time_ns=time_ns,
        last_ns=time_ns,
        robot="cruiser-1",
        kind=kind,
        severity=Severity.WARNING,
        source=EntrySource.LOG,
        text=kind.value,
    )
    return msgspec.structs.replace(plain, **fields)


def silence(from_s: float, to_s: float, **fields: object) -> Entry:
    """Nothing of the arbiter for a while."""
    return entry(from_s, EntryKind.GAP, last_ns=WALL_NS + round(to_s * SECOND), **fields)


def happened(*entries: Entry) -> EventLog:
    """All of them."""
    found, stops = EventLog(), Stops()
    for one in entries:
        found.take(stops.mark(one))
    return found


@pytest.mark.parametrize("reason", [reason for reason in Reason if reason in AS_ASKED])
def test_an_end_that_somebody_asked_for_is_no_stop(reason: Reason) -> None:
    """Neither among the numbers nor among the moments; one for any other reason is both."""
    end, stop = (
        entry(1, kind_of(EntryKind.STOP, why), reason=why, source=EntrySource.EVENT)
        for why in (reason, Reason.DEADMAN)
    )
    assert (end.kind, stop.kind) == (EntryKind.END, EntryKind.STOP)
    found = happened(end, stop)
    assert (found.stops, found.ends) == ({"deadman": 1}, {reason.value: 1})


def test_the_silence_before_a_restart_is_its_own() -> None:
    """Of the others another gateway did not come; both stand among the moments."""
    found = happened(
        silence(1, 3),
        silence(5, 9, severity=Severity.ERROR),
        silence(6, 7),
        entry(9, EntryKind.GATEWAY, severity=Severity.ERROR, source=EntrySource.STATE),
        entry(20, EntryKind.GATEWAY, source=EntrySource.HEALTH),
    )
    assert found.outages == [
        Outage(WALL_NS + 5 * SECOND, WALL_NS + 9 * SECOND, is_commanding=True),
        Outage(WALL_NS + 20 * SECOND, WALL_NS + 20 * SECOND, is_commanding=False),
    ]
    assert [(one.from_ns - WALL_NS) // SECOND for one in found.silences] == [1, 6]
    kinds = [one.kind for one in found.moments([], WALL_NS, WALL_NS + HOUR_NS)]
    assert kinds == ["gap", "gap", "gap", "gateway", "gateway"]


def test_another_variant_is_no_other_gateway() -> None:
    """It is told, and no more."""
    found = happened(entry(1, EntryKind.GATEWAY, severity=Severity.INFO, source=EntrySource.HEALTH))
    assert found.outages == []
    assert found.counts == {"gateway": 1}


def test_what_the_recorder_could_not_keep_is_no_silence() -> None:
    """The recorder's own account tells it."""
    assert happened(silence(1, 2, source=EntrySource.RECORDER)).silences == []


def test_refusals_and_requests_have_a_table_of_their_own() -> None:
    """Stops are counted by their reasons."""
    found = happened(
        entry(1, EntryKind.REFUSAL),
        entry(2, EntryKind.REQUEST),
        entry(3, EntryKind.STOP, reason=Reason.DEADMAN),
        entry(3.5, EntryKind.ENGAGED),
        entry(4, EntryKind.STOP, reason=Reason.DEADMAN),
    )
    assert found.counts == {"stop": 2, "engaged": 1}
    assert found.stops == {"deadman": 2}


def test_who_held_the_lease_goes_with_a_moment() -> None:
    """And how many alike ones there were, and where."""
    found = happened(entry(2, EntryKind.FAULT, holder="operator-1", count=7, last_ns=WALL_NS + 3 * SECOND))
    places = [Place(WALL_NS + number * SECOND, float(number), -1.0, 0.0, begins=not number) for number in range(5)]
    (moment,) = found.moments(places, WALL_NS, WALL_NS + HOUR_NS)
    assert (moment.operator, moment.holder, moment.count) == ("", "operator-1", 7)
    assert (moment.last_ns, moment.x_m, moment.y_m) == (WALL_NS + 3 * SECOND, 2.0, -1.0)


def test_a_thousand_leases_hide_no_error() -> None:
    """There is room for what matters, and what is left out is counted."""
    leases = [entry(number, EntryKind.LEASE, severity=Severity.INFO) for number in range(MOMENTS_MAX + 100)]
    errors = [entry(number + 0.5, EntryKind.GATEWAY, severity=Severity.ERROR) for number in range(ERRORS_MAX + 50)]
    found = happened(*leases, *errors)
    kinds = [one.kind for one in found.moments([], WALL_NS, WALL_NS + HOUR_NS)]
    assert (kinds.count("lease"), kinds.count("gateway")) == (MOMENTS_MAX, ERRORS_MAX)
    assert found.more_moments == 150
    assert (len(found.outages), found.more_outages) == (OUTAGES_MAX, ERRORS_MAX + 50 - OUTAGES_MAX)


def test_silences_without_end_are_counted() -> None:
    """One that turns out to be before a restart is none of them, though there was no room for it."""
    many = SILENCES_MAX + 3
    found = happened(*(silence(number, number + 0.5) for number in range(many)))
    assert (len(found.silences), found.more_silences) == (SILENCES_MAX, 3)
    found.take(entry(many - 0.5, EntryKind.GATEWAY))
    assert (len(found.silences), found.more_silences) == (SILENCES_MAX, 2)
    assert found.outages[0].heard_ns == WALL_NS + (many - 1) * SECOND


@pytest.mark.parametrize("far_ns", [0, 2**63])
def test_a_time_beyond_reason_is_put_where_the_robot_was(far_ns: int) -> None:
    """One event of the year 1970 must not stretch the charts over half a century."""
    found = happened(entry(0, EntryKind.STOP, time_ns=far_ns, last_ns=far_ns))
    (moment,) = found.moments([], WALL_NS, WALL_NS + HOUR_NS)
    assert moment.time_ns == (WALL_NS + HOUR_NS if far_ns else WALL_NS)
    assert moment.last_ns == moment.time_ns


def test_the_cause_of_a_gateways_death_is_what_the_next_one_latches() -> None:
    """Without a word of it the cause is that the gateway died."""
    died = entry(1, EntryKind.GATEWAY, severity=Severity.ERROR)
    latch = entry(9, EntryKind.LATCH, reason=Reason.GUARD)
    found = happened(died, latch)
    assert +found.stops == {"guard": 1}
    assert [one.reason for one in found.moments([], WALL_NS, WALL_NS) if one.is_stop] == ["guard"]
    assert happened(died).stops == {DIED: 1}
