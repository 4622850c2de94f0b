"""Samples that wait."""

import weakref

from hypothesis import given
from hypothesis import strategies as st

from recorder.encoding.samples import ReceivedSample
from recorder.record.recorder import SAMPLE_BYTES, SampleInbox
from tests.support.messages import FakeSample

LIMIT_BYTES = 5000


def sample(number: int, size: int) -> ReceivedSample:
    """A sample of this size, known by its receipt."""
    return FakeSample("k", "x", bytes(size), received_ns=number)


@given(st.lists(st.one_of(st.integers(0, 6000), st.tuples(st.integers(0, 5), st.integers(0, 3000))), max_size=60))
def test_the_oldest_go_first_and_each_is_taken_or_told(steps: list[int | tuple[int, int]]) -> None:
    """In the order of their receipt, within the limit whatever comes; none goes while there is room."""
    inbox = SampleInbox(LIMIT_BYTES)
    waiting: list[tuple[int, int]] = []
    for number, step in enumerate(steps):
        if isinstance(step, int):
            waiting.append((number, step + 1 + SAMPLE_BYTES))
            dropped = inbox.put(sample(number, step))
            gone = []
            while sum(size for _, size in waiting) > LIMIT_BYTES:
                gone.append(("k", waiting.pop(0)[0]))
            assert dropped == gone
        else:
            taken = list(inbox.take(*step))
            assert [one.received_ns for one in taken] == [number for number, _ in waiting[: len(taken)]]
            sizes = [size for _, size in waiting[: len(taken)]]
            # The last one may go beyond.
            assert len(taken) <= step[0]
            assert sum(sizes[:-1]) <= step[1]
            assert len(taken) == min(step[0], len(waiting)) or sum(sizes) > step[1]
            del waiting[: len(taken)]
        assert (len(inbox), inbox.bytes) == (len(waiting), sum(size for _, size in waiting))
        assert inbox.bytes <= LIMIT_BYTES


class Received:
    """A sample that holds on to the buffer that it came in."""

    key, encoding, payload, attachment = "k", "x", b"payload", b"attachment"
    zenoh_time_ns, received_ns, source, deleted, is_reply = 1, 2, ("source", 3), True, True


def test_what_waits_is_a_copy() -> None:
    """It holds on to nothing; all of the sample is there when its turn comes."""
    inbox, received = SampleInbox(1000), Received()
    gone = weakref.ref(received)
    inbox.put(received)
    del received
    assert gone() is None
    (taken,) = inbox.take(1, 1000)
    for name in ("key", "encoding", "payload", "attachment", "zenoh_time_ns", "received_ns", "source"):
        assert getattr(taken, name) == getattr(Received, name)
    assert taken.deleted
    assert taken.is_reply
