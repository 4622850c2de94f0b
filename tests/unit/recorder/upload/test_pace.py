"""Bandwidth and hours of the day."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from recorder.upload.pace import BURST_S, RateLimit, is_within


@given(
    st.lists(st.tuples(st.integers(1, 100_000), st.floats(0, 5)), min_size=1, max_size=50),
    st.integers(1000, 10**6),
)
def test_no_more_goes_than_the_rate_and_a_moment(steps: list[tuple[int, float]], rate: int) -> None:
    """Whoever waits as he is told never exceeds it, whatever pauses he makes besides."""
    pace, now_s, went = RateLimit(rate), 1000.0, 0
    for count, pause_s in steps:
        now_s += pause_s
        now_s += pace.delay_s(count, now_s)
        went += count
        assert went <= rate * (now_s - 1000.0 + BURST_S) * (1 + 1e-9) + 1


def test_without_a_rate_nothing_waits() -> None:
    """0 is no limit."""
    assert RateLimit(0).delay_s(10**12, 0.0) == 0.0


@pytest.mark.parametrize(
    ("hours", "inside", "outside"),
    [
        ("", ["00:00", "12:00", "23:59"], []),
        ("08:00-17:30", ["08:00", "17:29"], ["07:59", "17:30", "00:00"]),
        ("22:00-05:30", ["22:00", "23:59", "00:00", "05:29"], ["05:30", "21:59", "12:00"]),
        ("07:00-07:00", ["07:00", "06:59"], []),
    ],
)
def test_hours_may_go_over_midnight(hours: str, inside: list[str], outside: list[str]) -> None:
    """The first minute is within, the last one is not; from a time to the same is the whole day."""

    def minute(text: str) -> int:
        return int(text[:2]) * 60 + int(text[3:])

    assert [one for one in [*inside, *outside] if is_within(hours, minute(one))] == inside
