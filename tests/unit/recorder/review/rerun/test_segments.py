"""Where runs can be cut."""

from collections.abc import Iterator
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from recorder.encoding.transcode import compile_encoder
from recorder.reading.faults import Faults
from recorder.reading.rows import END_OF_TIME_NS, Row
from recorder.reading.topics import Topic, typed_decoder
from recorder.review.rerun.segments import BEFORE_NS, BEHIND_NS, WHOLE, Plan, plan
from schemas.decisions import Journal
from tests.support.messages import MS, SECOND, WALL_NS

LENGTH_NS = 10 * SECOND
TOPIC = Topic(
    "fleet/cruiser-1/journal",
    "",
    "protobuf",
    "protobuf",
    b"",
    None,
    "cruiser-1",
    "cruiser-1",
    "journal",
    typed_decoder(Journal),
)
ENCODE = compile_encoder(Journal)


def journals(times_ms: list[int], rests: set[int], run: int = 1, late_ms: int = 5) -> Iterator[Row]:
    """A message of one input at each time; at some of them the gateway was at rest."""
    for number, time_ms in enumerate(times_ms):
        time_ns = WALL_NS + time_ms * MS
        inputs = b"rest" if time_ms in rests else b"busy"
        message = Journal(time_ns, number, run=run, first=number, count=1, inputs=inputs)
        yield Row(TOPIC, number, time_ns + late_ms * MS, time_ns, ENCODE(message))


def rests_of(journal: Journal) -> list[int]:
    """When the gateway was at rest."""
    if journal.inputs == b"bad":
        raise ValueError
    return [journal.time_ns] if journal.inputs == b"rest" else []


def planned(rows: Iterator[Row]) -> Plan:
    """How these are run again."""
    return plan(rows, rests_of, LENGTH_NS, Faults())


def cuts_ms(found: Plan) -> list[int]:
    """Where it is cut."""
    return [(one.from_ns - WALL_NS) // MS for one in found.segments[1:]]


def test_it_is_cut_behind_places_of_rest() -> None:
    """At those that lie far enough from the one before, from the beginning, and from the end."""
    found = planned(journals(list(range(0, 40_000, 50)), {3000, 12_000, 15_000, 20_000, 25_000, 39_000}))
    assert cuts_ms(found) == [12_500, 25_500]
    assert [(part.run, part.first, part.inputs) for part in found.parts] == [(1, 0, 800)]


@given(
    rests=st.sets(st.integers(0, 1199).map(lambda number: number * 50)), late_ms=st.integers(-3_600_000, 3_600_000)
)
def test_segments_lie_behind_each_other_and_have_what_they_need(rests: set[int], late_ms: int) -> None:
    """Of their own every moment is in one, and what is needed around it is read."""
    rows = list(journals(list(range(0, 60_000, 50)), rests, late_ms=late_ms))
    segments = planned(iter(rows)).segments
    edges = [0, *(one.from_ns for one in segments[1:]), END_OF_TIME_NS]
    assert [(one.from_ns, one.to_ns) for one in segments] == list(pairwise(edges))
    for one in segments:
        read = [row for row in rows if one.log_from_ns <= row.log_ns < one.log_to_ns and one.needs(row)]
        wanted = [row for row in rows if one.from_ns - BEFORE_NS <= row.publish_ns <= one.to_ns + BEHIND_NS]
        assert read == wanted
        assert one.to_ns - max(one.from_ns, WALL_NS) >= LENGTH_NS


def test_a_run_is_not_cut_near_its_beginning_or_its_end() -> None:
    """Each has what comes before a place of rest, and goes on behind it."""
    first, second = list(range(0, 20_000, 50)), list(range(20_000, 60_000, 50))
    rows = [*journals(first, {19_000}), *journals(second, {22_000, 40_000}, run=2)]
    assert cuts_ms(planned(iter(rows))) == [40_500]


@pytest.mark.parametrize("back_ms", [50, 3_600_000])
def test_a_robot_whose_clock_was_set_back_is_not_cut(back_ms: int) -> None:
    """Its times do not tell what belongs together."""
    before, behind = range(0, 30_000, 50), range(30_000 - back_ms - 50, 60_000, 50)
    assert planned(journals([*before, *behind], {15_000, 45_000})).segments == [WHOLE]


def test_a_journal_that_cannot_be_read_is_not_cut() -> None:
    """Whoever runs it again says what is wrong."""
    rows = list(journals(list(range(0, 40_000, 50)), {15_000}))
    broken = Journal(rows[700].publish_ns, 700, run=1, first=700, count=1, inputs=b"bad")
    rows[700] = Row(TOPIC, 700, rows[700].log_ns, rows[700].publish_ns, ENCODE(broken))
    assert planned(iter(rows)).segments == [WHOLE]


def test_without_a_journal_there_is_nothing_to_cut() -> None:
    """Nor any part."""
    assert planned(iter([])) == Plan([], [WHOLE])
