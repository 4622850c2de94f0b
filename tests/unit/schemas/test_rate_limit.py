"""A rate that is kept to."""

from hypothesis import given
from hypothesis import strategies as st

from schemas.peers import BURST_S, RateLimit


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
