"""Sentences and their numbers."""

import pytest

from recorder.review.window import before, count, deg, mps, span
from tests.support.messages import MS, SECOND


@pytest.mark.parametrize(
    ("ns", "text"),
    [
        (0, "0.0 ms"),
        (12_345_678, "12.3 ms"),
        (99_940_000, "99.9 ms"),
        (99_960_000, "100 ms"),
        (310 * MS, "310 ms"),
        (999_400_000, "999 ms"),
        (999_600_000, "1.00 s"),
        (2_350 * MS, "2.35 s"),
        (119 * SECOND, "119.00 s"),
        (125 * SECOND, "2 min 5 s"),
        (3 * 3600 * SECOND + 20 * 60 * SECOND, "3 h 20 min"),
        (-310 * MS, "310 ms"),
    ],
)
def test_a_length_of_time_is_as_fine_as_it_is_short(ns: int, text: str) -> None:
    """Three digits or so."""
    assert span(ns) == text


def test_before_and_after() -> None:
    """Of what it is."""
    assert before(0, 20 * MS, "the stop") == "20.0 ms before the stop"
    assert before(20 * MS, 0) == "20.0 ms after that moment"
    assert before(5, 5, "the latch") == "at the latch"


def test_counts_and_nothings() -> None:
    """One and many; and no minus nothing."""
    assert (count(1, "frame"), count(2, "frame")) == ("1 frame", "2 frames")
    assert (deg(-0.01), deg(-0.06)) == ("0.0 deg", "-0.1 deg")
    assert (mps(-0.004), mps(-0.006), mps(1.0)) == ("0.00 m/s", "-0.01 m/s", "1.00 m/s")
