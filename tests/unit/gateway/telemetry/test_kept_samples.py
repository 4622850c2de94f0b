"""The newest samples, by their sequence."""

import pytest

from gateway.telemetry.samples import KeptSamples
from schemas.subjects import KEPT_PIECE


def kept(count: int, max_bytes: int = 1_000_000) -> KeptSamples:
    """So many samples of ten bytes; each tells its sequence."""
    samples = KeptSamples(max_bytes)
    for number in range(count):
        samples.add(b"%010d" % number)
    return samples


@pytest.mark.parametrize("first", [0, 5, 99, 100, 4711])
def test_a_piece_begins_with_the_sequence_that_was_asked_for(first: int) -> None:
    """And is a bounded number; empty where nothing is that new."""
    found = [int(payload) for payload in kept(100).piece(first)]
    assert found == list(range(first, min(100, first + KEPT_PIECE)))


def test_the_oldest_go_by_their_bytes() -> None:
    """A piece of what has gone begins with the oldest that is there."""
    samples = kept(100, max_bytes=305)
    assert [int(payload) for payload in samples.piece(0)] == list(range(70, 70 + KEPT_PIECE))
    assert [int(payload) for payload in samples.piece(98)] == [98, 99]


def test_what_is_larger_than_all_there_is_room_for_is_not_kept() -> None:
    """Those after it keep their places."""
    samples = kept(3, max_bytes=20)
    samples.add(bytes(21))
    assert samples.piece(0) == []
    samples.add(b"four")
    assert samples.piece(0) == samples.piece(4) == [b"four"]
