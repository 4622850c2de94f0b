"""The ring of a log, and what an incident takes from it."""

from hypothesis import example, given
from hypothesis import strategies as st

from recorder.mcap.writer import Chunk
from recorder.record.actions import CloseLog, LogAction, OpenLog, SyncLog, WriteChunk, WriteMetadata
from recorder.record.incidents import INCIDENT_NAME, Incidents, trim_rings
from schemas.settings import INCIDENT_MAX_NS
from tests.support.logs import sealed
from tests.support.messages import SECOND, WALL_NS

BEFORE_NS = 10 * SECOND
AFTER_NS = 5 * SECOND
RINGS = 4


def incidents_of(name: str = "a", before_ns: int = BEFORE_NS, after_ns: int = AFTER_NS) -> Incidents:
    return Incidents(name, before_ns, after_ns)


def chunk(number: int, size: int = 10) -> Chunk:
    return sealed([(1, number, number, number, bytes(size))])


def chunks(actions: list[LogAction]) -> list[Chunk]:
    return [one.chunk for one in actions if isinstance(one, WriteChunk)]


@given(steps=st.lists(st.tuples(st.integers(0, SECOND), st.integers(1, 500))), wait_ns=st.integers(0, 40 * SECOND))
def test_the_ring_holds_the_last_seconds(steps: list[tuple[int, int]], wait_ns: int) -> None:
    """All that is young enough, and nothing else; the oldest may be forgotten before."""
    incidents = incidents_of()
    now_ns = 0
    given_: list[tuple[int, Chunk]] = []
    for number, (step_ns, size) in enumerate(steps):
        now_ns += step_ns
        given_.append((now_ns, chunk(number, size)))
        incidents.add(given_[-1][1], now_ns)
    now_ns += wait_ns
    incidents.trim(now_ns)
    young = [(at_ns, one) for at_ns, one in given_ if now_ns - at_ns <= BEFORE_NS]
    assert incidents.oldest_ns == (young[0][0] if young else None)
    if young:
        assert incidents.forget_oldest() == len(young.pop(0)[1].records)
    held = chunks(incidents.begin(now_ns, WALL_NS, "", ""))
    assert held == [one for _, one in young]
    assert incidents.ring_bytes == sum(len(one.records) for one in held)


def test_an_incident_begins_with_what_came_before_and_goes_on_with_what_comes() -> None:
    """Its log repeats what the log that it is of has declared, and links to that log's file."""
    incidents = incidents_of()
    before, after = chunk(0), chunk(1)
    assert incidents.add(before, 0) == []
    about = {"at_ns": str(WALL_NS), "because": "it shook", "file": "a.mcap"}
    assert incidents.begin(1, WALL_NS, "it shook", "a.mcap") == [
        OpenLog("a!", "a", WALL_NS, is_incident=True),
        WriteMetadata("a!", INCIDENT_NAME, about, lasts=True),
        WriteChunk("a!", before),
        SyncLog("a!"),
    ]
    assert incidents.add(after, 2) == [WriteChunk("a!", after)]


def test_it_ends_once_its_time_is_up() -> None:
    """And takes no more then."""
    incidents = incidents_of()
    assert not incidents.is_over(10**20)
    assert incidents.close() == []
    incidents.begin(SECOND, WALL_NS, "", "")
    assert not incidents.is_over(SECOND + AFTER_NS - 1)
    assert incidents.is_over(SECOND + AFTER_NS)
    assert incidents.is_open
    assert incidents.close() == [CloseLog("a!")]
    assert (incidents.is_open, incidents.close(), incidents.add(chunk(0), 0)) == (False, [], [])


@given(st.lists(st.integers(0, 360 * SECOND), max_size=20))
@example([299 * SECOND] * 7)
def test_whatever_happens_meanwhile_makes_it_longer_up_to_a_bound(waits_ns: list[int]) -> None:
    """A fault that comes back all the time makes no endless file, nor many at once."""
    after_ns = 300 * SECOND
    incidents = incidents_of(after_ns=after_ns)
    now_ns = begun_ns = 0
    incidents.begin(now_ns, WALL_NS, "first", "")
    last_ns = now_ns
    for wait_ns in waits_ns:
        now_ns += wait_ns
        is_over = now_ns >= min(last_ns + after_ns, begun_ns + INCIDENT_MAX_NS)
        assert incidents.is_over(now_ns) == is_over
        if is_over:
            incidents.close()
            begun_ns = now_ns
        assert bool(incidents.begin(now_ns, WALL_NS, "again", "")) == is_over
        last_ns = now_ns


def test_an_incident_says_where_the_log_goes_on() -> None:
    """When and why it was stay as they were, whatever happens meanwhile."""
    incidents = incidents_of()
    assert incidents.link_to("a-1.mcap") == []
    incidents.begin(0, WALL_NS, "first", "")
    incidents.begin(1, WALL_NS + 1, "second", "")
    (one,) = incidents.link_to("a-2.mcap")
    about = {"at_ns": str(WALL_NS), "because": "first", "file": "a-2.mcap"}
    assert one == WriteMetadata("a!", INCIDENT_NAME, about, lasts=True)


@given(
    steps=st.lists(st.tuples(st.integers(1, SECOND), st.integers(0, RINGS - 1), st.integers(1, 500))),
    wait_ns=st.integers(0, 40 * SECOND),
    limit_bytes=st.integers(0, 3000),
)
def test_all_rings_together_hold_the_newest(
    steps: list[tuple[int, int, int]], wait_ns: int, limit_bytes: int
) -> None:
    """Whosesoever it is: a robot that says much may use what the others leave."""
    rings = [incidents_of(str(number)) for number in range(RINGS)]
    now_ns = 0
    came: list[tuple[int, int]] = []
    for number, (step_ns, ring, size) in enumerate(steps):
        now_ns += step_ns
        one = chunk(number, size)
        rings[ring].add(one, now_ns)
        came.append((now_ns, len(one.records)))
    now_ns += wait_ns
    trim_rings(rings, now_ns, limit_bytes)
    young = [size for at_ns, size in came if now_ns - at_ns <= BEFORE_NS]
    while sum(young) > limit_bytes:
        young.pop(0)
    assert sum(ring.ring_bytes for ring in rings) == sum(young)
