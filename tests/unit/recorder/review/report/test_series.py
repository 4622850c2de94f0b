"""Numbers over time, reduced while they stream in."""

from hypothesis import given
from hypothesis import strategies as st

from recorder.review.report.series import BREAKS_MAX, Series
from tests.support.messages import MS, SECOND


@given(
    values=st.lists(st.floats(-10, 10), min_size=1, max_size=400),
    seed=st.randoms(use_true_random=False),
    limit=st.integers(1, 40),
)
def test_bounds_and_ends_survive_whatever_the_order(values: list[float], seed: object, limit: int) -> None:
    """The lowest and highest value, the first and the last sample are drawn; the number of points is bounded."""
    samples = [(number * 20 * MS, value) for number, value in enumerate(values)]
    series = Series(10**18, limit)
    shuffled = list(samples)
    seed.shuffle(shuffled)  # type: ignore[attr-defined]
    for time_ns, value in shuffled:
        series.add(time_ns, value)
    points = [point for point in series.points() if point is not None]
    assert len(points) <= 4 * limit
    assert points == sorted(points)
    assert set(points) <= set(samples)
    assert {points[0], points[-1]} == {samples[0], samples[-1]}
    assert min(value for _, value in points) == min(values)
    assert max(value for _, value in points) == max(values)


def test_a_spike_of_one_sample_in_a_million_is_drawn() -> None:
    """It is what the report is read for."""
    series = Series(SECOND)
    for number in range(300_000):
        series.add(number * 50 * MS, 9.0 if number == 123_456 else 1.0)
    points = series.points()
    assert (123_456 * 50 * MS, 9.0) in points
    assert len(points) <= 6000


def test_a_silence_breaks_the_line() -> None:
    """And nothing else does."""
    series = Series(SECOND // 2)
    for number in (0, 1, 2, 3, 30, 31):
        series.add(number * 100 * MS, float(number))
    assert [None if point is None else point[1] for point in series.points()] == [0, 1, 2, 3, None, 30, 31]


def test_what_is_not_known_breaks_the_line() -> None:
    """However short it is."""
    series = Series(SECOND)
    series.add(0, 1.0)
    series.cut()
    series.cut()
    series.add(50 * MS, 2.0)
    assert series.points() == [(0, 1.0), None, (50 * MS, 2.0)]


def test_of_too_many_breaks_the_longest_are_kept() -> None:
    """A line that is nothing but gaps costs no more memory than others."""
    series = Series(SECOND, limit=10_000)
    for number in range(3 * BREAKS_MAX):
        series.add(number * 2 * SECOND, 0.0)
    series.add(10**15, 1.0)
    points = series.points()
    assert points[-2] is None
    assert BREAKS_MAX // 4 < points.count(None) <= BREAKS_MAX
