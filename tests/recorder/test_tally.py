"""Losses by sequence."""

from hypothesis import given
from hypothesis import strategies as st

from recorder.tally import SEQUENCE_SPAN, Tally


@given(st.integers(0, SEQUENCE_SPAN - 1), st.lists(st.booleans(), min_size=1, max_size=50))
def test_a_gap_counts_what_is_missing(first: int, arrives: list[bool]) -> None:
    """What is missing between the first and the last that came is counted, across the wrap too."""
    tally = Tally()
    numbers = [number for number, comes in enumerate(arrives) if comes]
    for number in numbers:
        assert tally.count_sequence((first + number) % SEQUENCE_SPAN)
    expected = numbers[-1] - numbers[0] + 1 - len(numbers) if numbers else 0
    assert tally.missed == expected


def test_a_step_back_is_a_new_beginning() -> None:
    """A restarted sender counts from 0; that is no loss."""
    tally = Tally()
    assert tally.count_sequence(500)
    assert not tally.count_sequence(0)
    assert tally.count_sequence(1)
    assert tally.missed == 0
