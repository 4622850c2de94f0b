"""The counters of a key, and event lines."""

from recorder.encoding.samples import SOURCES_MAX, KeyCounters
from schemas.recording import GapReason


def test_a_step_back_is_a_new_beginning() -> None:
    counters = KeyCounters()
    assert counters.count_sequence(500)
    assert not counters.count_sequence(0)
    assert counters.count_sequence(1)
    assert counters.missed == 0


def test_what_was_dropped_unread_is_not_missed() -> None:
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
    counters = KeyCounters()
    counters.count_sequence(0)
    counters.count_sequence(2)
    counters.find()
    counters.find()
    assert counters.missed == 0


def test_each_source_of_a_key_has_a_sequence_of_its_own() -> None:
    """The number of followed sources is bounded."""
    counters = KeyCounters()
    for source, sequence in (("a", 5), ("a", 7), ("b", 900), ("b", 902), ("a", 8), ("b", 906)):
        counters.count_source(source, sequence)
    assert counters.missed == 1 + 1 + 3
    for number in range(10 * SOURCES_MAX):
        counters.count_source(str(number), 7)
    assert (counters.missed, len(counters._sources)) == (5, SOURCES_MAX)
