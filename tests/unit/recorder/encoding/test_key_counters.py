"""Losses by sequence."""

from recorder.encoding.samples import KeyCounters
from schemas.recording import GapReason


def test_a_step_back_is_a_new_beginning() -> None:
    """A restarted sender counts from 0; that is no loss."""
    counters = KeyCounters()
    assert counters.count_sequence(500)
    assert not counters.count_sequence(0)
    assert counters.count_sequence(1)
    assert counters.missed == 0


def test_what_was_dropped_unread_is_not_missed() -> None:
    """But only where it was dropped: elsewhere a gap is one, and what never was numbered hides none."""
    counters = KeyCounters()
    counters.lose(GapReason.QUEUE, 5)
    counters.count_sequence(10)
    counters.count_sequence(13)
    assert counters.missed == 2
    counters.lose(GapReason.QUEUE, 2)
    counters.lose(GapReason.SIZE, 1)
    counters.lose(GapReason.DISK, 50)
    counters.count_sequence(20)
    assert counters.missed == 5
    counters.lose(GapReason.SIZE, 1)
    counters.count_sequence(21)
    counters.count_sequence(23)
    assert counters.missed == 6
    assert counters.unread == 9
    assert counters.lost == {GapReason.QUEUE: 7, GapReason.SIZE: 2, GapReason.DISK: 50}


def test_what_has_come_after_all_is_missed_no_more() -> None:
    """And never less than nothing is missed."""
    counters = KeyCounters()
    counters.count_sequence(0)
    counters.count_sequence(2)
    counters.find()
    counters.find()
    assert counters.missed == 0
