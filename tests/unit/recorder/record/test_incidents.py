"""The ring of a log, and what an incident takes from it."""

from hypothesis import example, given
from hypothesis import strategies as st

from recorder.mcap.channel import LogChannel
from recorder.mcap.chunk import Chunk, ChunkBuilder
from recorder.record.effects import (
    CloseLog,
    DeclareChannel,
    FileEffect,
    OpenLog,
    SyncLog,
    WriteAttachment,
    WriteChunk,
    WriteMetadata,
)
from recorder.record.incidents import INCIDENT_NAME, IncidentPlan, Incidents
from schemas.recorder_settings import INCIDENT_MAX_NS
from tests.support.recorder_fakes import SECOND, WALL_NS

PLAN = IncidentPlan(before_ns=10 * SECOND, after_ns=5 * SECOND)
CHANNEL = DeclareChannel(LogChannel(1, "t", "s", b""))
WHOSE = WriteMetadata("cruiser", {"robots": "a"}, lasts=True)
DBC = WriteAttachment("a.dbc", "text/plain", b"", 0)


def chunk(number: int, size: int = 10) -> WriteChunk:
    """A chunk of one message."""
    builder = ChunkBuilder()
    builder.add(1, number, number, number, bytes(size))
    sealed = builder.seal()
    assert sealed is not None
    return WriteChunk(sealed)


def chunks(effects: list[OpenLog | FileEffect]) -> list[Chunk]:
    """The chunks among the effects."""
    return [one.chunk for one in effects if isinstance(one, WriteChunk)]


@given(steps=st.lists(st.tuples(st.integers(0, SECOND), st.integers(1, 500))), wait_ns=st.integers(0, 40 * SECOND))
def test_the_ring_holds_the_last_seconds(steps: list[tuple[int, int]], wait_ns: int) -> None:
    """All that is young enough, and nothing else; the oldest may be forgotten before."""
    incidents = Incidents("a", PLAN)
    now_ns = 0
    given_: list[tuple[int, WriteChunk]] = []
    for number, (step_ns, size) in enumerate(steps):
        now_ns += step_ns
        given_.append((now_ns, chunk(number, size)))
        incidents.take([given_[-1][1]], now_ns)
    now_ns += wait_ns
    incidents.trim(now_ns)
    young = [(at_ns, one.chunk) for at_ns, one in given_ if now_ns - at_ns <= PLAN.before_ns]
    assert incidents.oldest_ns == (young[0][0] if young else None)
    if young:
        assert incidents.forget_oldest() == len(young.pop(0)[1].records)
    held = chunks(incidents.begin(now_ns, WALL_NS, "", ""))
    assert held == [one for _, one in young]
    assert incidents.ring_bytes == sum(len(one.records) for one in held)


def test_an_incident_begins_with_what_was_declared_and_what_came_before() -> None:
    """It can be read alone; what a file of the log says of itself is not in it."""
    incidents = Incidents("a", PLAN)
    once = WriteMetadata("cruiser.completeness", {})
    before: list[OpenLog | FileEffect] = [
        OpenLog("a", 0),
        WHOSE,
        DBC,
        CHANNEL,
        chunk(0),
        SyncLog(),
        once,
        CloseLog(),
        OpenLog("a", 5),
    ]
    assert incidents.take(before, 0) == []
    begun = incidents.begin(1, WALL_NS, "it shook", "a.mcap")
    about = {"at_ns": str(WALL_NS), "because": "it shook", "file": "a.mcap"}
    assert begun == [
        OpenLog("a", WALL_NS, is_incident=True),
        WHOSE,
        DBC,
        CHANNEL,
        WriteMetadata(INCIDENT_NAME, about, lasts=True),
        before[4],
        SyncLog(),
    ]
    after: list[OpenLog | FileEffect] = [
        OpenLog("a", 0),
        WHOSE,
        DBC,
        CHANNEL,
        chunk(1),
        SyncLog(),
        once,
        CloseLog(),
    ]
    assert incidents.take(after, 2) == [WHOSE, DBC, CHANNEL, after[4], SyncLog()]


def test_it_ends_once_its_time_is_up() -> None:
    """And takes no more then."""
    incidents = Incidents("a", PLAN)
    assert not incidents.is_over(10**20)
    assert incidents.close() == []
    incidents.begin(SECOND, WALL_NS, "", "")
    assert not incidents.is_over(SECOND + PLAN.after_ns - 1)
    assert incidents.is_over(SECOND + PLAN.after_ns)
    assert incidents.is_open
    assert incidents.close() == [CloseLog()]
    assert (incidents.is_open, incidents.close(), incidents.take([chunk(0)], 0)) == (False, [], [])


@given(st.lists(st.integers(0, 360 * SECOND), max_size=20))
@example([299 * SECOND] * 7)
def test_whatever_happens_meanwhile_makes_it_longer_up_to_a_bound(waits_ns: list[int]) -> None:
    """A fault that comes back all the time makes no endless file, nor many at once."""
    plan = IncidentPlan(before_ns=0, after_ns=300 * SECOND)
    incidents = Incidents("a", plan)
    now_ns = begun_ns = 0
    incidents.begin(now_ns, WALL_NS, "first", "")
    last_ns = now_ns
    for wait_ns in waits_ns:
        now_ns += wait_ns
        is_over = now_ns >= min(last_ns + plan.after_ns, begun_ns + INCIDENT_MAX_NS)
        assert incidents.is_over(now_ns) == is_over
        if is_over:
            incidents.close()
            begun_ns = now_ns
        assert bool(incidents.begin(now_ns, WALL_NS, "again", "")) == is_over
        last_ns = now_ns


def test_an_incident_says_where_the_log_goes_on() -> None:
    """When and why it was stay as they were, whatever happens meanwhile."""
    incidents = Incidents("a", PLAN)
    assert incidents.go_on_in("a-1.mcap") == []
    incidents.begin(0, WALL_NS, "first", "")
    incidents.begin(1, WALL_NS + 1, "second", "")
    (one,) = incidents.go_on_in("a-2.mcap")
    about = {"at_ns": str(WALL_NS), "because": "first", "file": "a-2.mcap"}
    assert one == WriteMetadata(INCIDENT_NAME, about, lasts=True)
