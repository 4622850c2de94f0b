"""Lines, bands and the path of a drive, reduced while the samples stream in."""

from math import cos, hypot, radians, sin, tan
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from recorder.review.report.findings import BREAKS_MAX, MIXED, PLACES_MAX, Path, Point, Series, Span, Spans
from tests.support.messages import MS, SECOND

STEP_NS = 50 * MS


def series_of(*samples: tuple[int, float], limit: int = 1500) -> list[Point | None]:
    """The line of these samples, at milliseconds."""
    series = Series(limit)
    for time_ms, value in samples:
        series.add(time_ms * MS, value)
    return list(series.points())


@given(
    values=st.lists(st.floats(-10, 10), min_size=1, max_size=400),
    random=st.randoms(use_true_random=False),
    limit=st.integers(1, 40),
)
def test_bounds_and_ends_survive_whatever_the_order(values: list[float], random: Random, limit: int) -> None:
    """The lowest and highest value, the first and the last sample are drawn; the number of points is bounded."""
    samples = [(number * 20, value) for number, value in enumerate(values)]
    shuffled = list(samples)
    random.shuffle(shuffled)
    points = [point for point in series_of(*shuffled, limit=limit) if point is not None]
    assert len(points) <= 4 * limit
    assert points == sorted(points)
    assert {points[0], points[-1]} == {(samples[0][0], values[0]), (samples[-1][0] * MS, values[-1])}
    assert (min(value for _, value in points), max(value for _, value in points)) == (min(values), max(values))


def test_a_spike_of_one_sample_in_many_is_drawn() -> None:
    """It is what the report is read for; a period without it has it not."""
    series = Series()
    for number in range(300_000):
        series.add(number * STEP_NS, 9.0 if number == 123_456 else 1.0)
    points = list(series.points())
    assert (123_456 * STEP_NS, 9.0) in points
    assert len(points) <= 6000
    part = list(series.points(1000 * SECOND, 2000 * SECOND))
    assert all(point is not None and 1000 * SECOND <= point[0] <= 2000 * SECOND for point in part)


def test_a_silence_breaks_the_line() -> None:
    """And nothing else does."""
    times_ms = (0, 100, 200, 300, 3000, 3100)
    found = series_of(*((time_ms, float(time_ms)) for time_ms in times_ms))
    assert [None if point is None else point[1] for point in found] == [0, 100, 200, 300, None, 3000, 3100]


def test_what_is_not_known_breaks_the_line() -> None:
    """However short it is."""
    series = Series()
    series.add(0, 1.0)
    series.cut()
    series.cut()
    series.add(50 * MS, 2.0)
    assert list(series.points()) == [(0, 1.0), None, (50 * MS, 2.0)]


def test_of_too_many_breaks_the_longest_are_kept() -> None:
    """A line that is nothing but gaps costs no more memory than others."""
    points = series_of(*((number * 2000, 0.0) for number in range(3 * BREAKS_MAX)), (10**9, 1.0), limit=10_000)
    assert points[-2] is None
    assert BREAKS_MAX // 4 < points.count(None) <= BREAKS_MAX


@pytest.mark.parametrize(
    ("samples", "found"),
    [
        pytest.param([(0, "a"), (100, "a"), (200, "b"), (300, "b")], [(0, 200, "a"), (200, 300, "b")], id="holds"),
        pytest.param(
            [(0, "a"), (400, "a"), (5000, "a"), (5001, "a")], [(0, 400, "a"), (5000, 5001, "a")], id="silence"
        ),
        pytest.param(
            [(0, ""), (100, "a"), (200, ""), (300, "a"), (250, "late"), (400, "a")],
            [(100, 200, "a"), (300, 400, "a")],
            id="nothing",
        ),
    ],
)
def test_a_value_holds_until_another_comes(
    samples: list[tuple[int, str]], found: list[tuple[int, int, str]]
) -> None:
    """Across a silence nothing is known; an empty value leaves a hole; what comes late is passed over."""
    spans = Spans()
    for time_ms, value in samples:
        spans.add(time_ms * MS, value)
    assert spans.spans() == [Span(start_ms * MS, end_ms * MS, value) for start_ms, end_ms, value in found]


def test_what_changes_too_often_is_mixed_and_long_spans_stay() -> None:
    """The number of spans is bounded; what is long enough to be seen is seen."""
    spans = Spans(limit=50)
    for number in range(10_000):
        spans.add(number * MS, "ab"[number % 2])
    for number in range(300):
        spans.add((10_000 + number * 400) * MS, "long")
    found = spans.spans()
    assert len(found) <= 52
    assert found[0].start_ns == 0
    assert MIXED in {span.value for span in found}
    assert any(span.value == "long" and span.end_ns - span.start_ns > 99 * SECOND for span in found)


def test_a_path_that_breaks_off_goes_on_from_the_same_place() -> None:
    """A robot that stands is one place, and the last one."""
    path = Path()
    for number, (x_m, begins) in enumerate(((0.0, True), (0.05, False), (0.1, False), (0.1, True))):
        path.add(number * STEP_NS, (x_m, 0.0, 0.0), begins=begins)
    for number in range(4, 100):
        path.add(number * STEP_NS, (0.1, 0.0, 0.0), begins=False)
    assert [place.x_m for place in path.places()] == pytest.approx([0.0, 0.05, 0.1, 0.1, 0.1])
    assert [place.begins for place in path.places()] == [True, False, False, True, False]


def test_a_long_drive_keeps_a_bounded_number_of_places_near_the_path() -> None:
    """Ten hours in a circle: few places, each on the circle, the last one where it ends."""
    path = Path()
    radius_m = 0.660 / tan(radians(10))
    for number in range(10 * 3600 * 5):
        turn_rad = number * 0.2 / radius_m
        pose = (radius_m * sin(turn_rad), radius_m * (1 - cos(turn_rad)), turn_rad)
        path.add(number * 200 * MS, pose, begins=not number)
    places = path.places()
    assert PLACES_MAX // 4 < len(places) <= PLACES_MAX + 1
    assert all(abs(hypot(place.x_m, place.y_m - radius_m) - radius_m) < 0.05 for place in places)
    assert places[-1].time_ns == (10 * 3600 * 5 - 1) * 200 * MS
    assert places == sorted(places, key=lambda place: place.time_ns)
