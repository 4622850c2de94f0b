"""What is there twice, and what is missing."""

from hypothesis import given
from hypothesis import strategies as st

from recorder.review import entries
from recorder.review.entries import Repeats, SequenceHole, Sequences


@given(there=st.sets(st.integers(0, 60), min_size=1), chance=st.randoms())
def test_holes_are_what_is_missing_between_the_first_and_the_last(there: set[int], chance: object) -> None:
    """In whatever order the samples come, and however often."""
    order = sorted(there) * 2
    chance.shuffle(order)  # type: ignore[attr-defined]
    sequences = Sequences()
    for sequence in order:
        sequences.add(sequence, sequence * 10)
    missing = set(range(min(there), max(there))) - there
    holes = sequences.holes()
    assert sum(hole.count for hole in holes) == len(missing)
    for hole in holes:
        first, last = hole.after_ns // 10 + 1, hole.before_ns // 10 - 1
        assert set(range(first, last + 1)) <= missing
        assert hole.count == last - first + 1


def test_holes_without_end_take_no_memory_without_end() -> None:
    """The oldest are settled, and still told."""
    sequences = Sequences()
    for sequence in range(0, 2 * entries.PIECES_MAX + 20, 2):
        sequences.add(sequence, sequence)
    holes = sequences.holes()
    assert len(holes) == entries.PIECES_MAX + 9
    assert holes[0] == SequenceHole(1, 0, 2)


def test_a_sample_is_new_once() -> None:
    """The same time and sequence is the same sample."""
    seen = Repeats()
    assert [seen.is_new(*one) for one in ((1, 1), (1, 2), (2, 1), (1, 1), (1, 2))] == [True] * 3 + [False] * 2


def test_what_is_remembered_is_bounded() -> None:
    """The oldest are forgotten."""
    seen = Repeats()
    for number in range(entries.IDS_KEPT + 1):
        seen.is_new(number, 0)
    assert not seen.is_new(1, 0)
    assert seen.is_new(0, 0)
