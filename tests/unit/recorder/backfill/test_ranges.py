"""Ranges of time, against sets of instants."""

import itertools

from hypothesis import given
from hypothesis import strategies as st

from recorder.backfill.ranges import Range, merged, overlaps, without

RANGES = st.lists(
    st.tuples(st.integers(0, 60), st.integers(1, 9)).map(lambda one: (one[0], one[0] + one[1])), max_size=8
)


def instants(ranges: list[Range]) -> set[int]:
    """What is in ranges."""
    return {time for from_ns, to_ns in ranges for time in range(from_ns, to_ns)}


@given(RANGES)
def test_merged_ranges_hold_the_same_and_do_not_touch(ranges: list[Range]) -> None:
    """In order."""
    found = merged(ranges)
    assert instants(found) == instants(ranges)
    assert all(one[1] < other[0] for one, other in itertools.pairwise(found))


@given(RANGES, RANGES)
def test_what_is_left_is_what_was_not_taken(ranges: list[Range], taken: list[Range]) -> None:
    """Instant by instant."""
    left = without(merged(ranges), merged(taken))
    assert instants(left) == instants(ranges) - instants(taken)
    assert sum(to_ns - from_ns for from_ns, to_ns in left) == len(instants(left))


@given(RANGES, st.integers(0, 60), st.integers(1, 9))
def test_an_overlap_is_an_instant_in_common(ranges: list[Range], from_ns: int, length: int) -> None:
    """Ends are not in."""
    expected = bool(instants(ranges) & set(range(from_ns, from_ns + length)))
    assert overlaps(merged(ranges), from_ns, from_ns + length) == expected


def test_near_ranges_are_one() -> None:
    """Up to the distance that is given, and no further."""
    assert merged([(0, 1), (4, 5), (9, 10)], 3) == [(0, 5), (9, 10)]
