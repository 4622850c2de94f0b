"""What waits for the disk, within a bound."""

from hypothesis import given
from hypothesis import strategies as st

from recorder.disk.log_writer import LogQueue
from recorder.record.actions import (
    CloseLog,
    LogAction,
    OpenLog,
    SyncLog,
    WriteAttachment,
    WriteChunk,
    WriteMetadata,
)
from tests.support.logs import sealed
from tests.support.messages import WALL_NS


def chunk(size: int) -> WriteChunk:
    """A chunk that takes so many bytes with its message's header."""
    return WriteChunk("x", sealed([(1, 0, WALL_NS, WALL_NS, bytes(max(0, size - 31)))]))


def queue_of(limit_bytes: int, *actions: LogAction) -> LogQueue:
    """A queue in which these wait."""
    queue = LogQueue(limit_bytes)
    for action in actions:
        queue.put(action)
    return queue


def left(queue: LogQueue) -> list[LogAction]:
    return [queue.take() for _ in range(len(queue))]


def test_what_can_never_fit_goes_before_everything_else() -> None:
    """For it all the others would have to go, and then it too."""
    small = [chunk(200) for _ in range(5)]
    large = chunk(5000)
    queue = queue_of(2000, *small[:3], large, *small[3:])
    assert queue.trim(0) == [large]
    assert left(queue) == small


def test_the_oldest_messages_go_first_and_what_is_said_of_files_last() -> None:
    """Which files there are, and what lasts, stays whatever happens."""
    opened, end, sync = OpenLog("x", "x", WALL_NS), CloseLog("x"), SyncLog("x")
    once = WriteMetadata("x", "cruiser.completeness", {"t": "1" * 500})
    lasting = WriteMetadata("x", "cruiser", {"t": "1" * 500}, lasts=True)
    attachment = WriteAttachment("x", "a.dbc", "text/plain", bytes(500), WALL_NS)
    first, second = chunk(300), chunk(300)
    actions: list[LogAction] = [opened, lasting, attachment, first, sync, second, once, end]
    queue = queue_of(3000, *actions)
    assert queue.trim(0) == []
    assert queue.trim(3000 - queue.bytes + 300) == [first]
    assert queue.trim(3000) == [sync, second, once]
    assert left(queue) == [opened, lasting, attachment, end]


@given(
    st.lists(st.sampled_from([SyncLog("x"), CloseLog("x"), chunk(50), chunk(400), chunk(3000)]), max_size=40),
    st.integers(0, 3000),
)
def test_nothing_goes_without_need_and_the_order_stays(actions: list[LogAction], other_bytes: int) -> None:
    """What is dropped and what is left is all there was; what is counted is what is there."""
    queue = queue_of(4000, *actions)
    dropped = queue.trim(other_bytes)
    bound = queue.bytes
    there = left(queue)
    assert queue.bytes == 0
    assert sorted(map(id, dropped + there)) == sorted(map(id, actions))
    assert [one for one in actions if isinstance(one, CloseLog)] == [
        one for one in there if isinstance(one, CloseLog)
    ]
    ones = [one for one in there if not isinstance(one, CloseLog)]
    assert bound <= 4000 - other_bytes or not ones
    if dropped:
        needed = bound + min(one.bytes for one in dropped[-1:])
        assert needed > 4000 - other_bytes
