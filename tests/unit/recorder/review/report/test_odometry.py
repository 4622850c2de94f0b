"""The path of a robot."""

from collections.abc import Sequence
from math import cos, hypot, inf, nan, pi, radians, sin, tan

import pytest
from hypothesis import given
from hypothesis import strategies as st

from recorder.review.report.odometry import CLOCK_STEP_NS, GAP_NS, PLACES_MAX, Odometer, SpeedMeter
from tests.support.messages import MS, SECOND

STEP_NS = 50 * MS


def run(samples: Sequence[tuple[float | None, float | None]], start_ns: int = 0) -> Odometer:
    """A path of speeds and angles, 20 times a second."""
    path = Odometer()
    for number, (speed_mps, angle_deg) in enumerate(samples):
        path.add(start_ns + number * STEP_NS, speed_mps, angle_deg)
    return path


@given(st.floats(0.2, 2.0), st.floats(5, 24), st.sampled_from([1, -1]), st.sampled_from([1, -1]))
def test_a_steady_angle_is_a_circle_of_the_bicycle_model(
    speed_mps: float, angle_deg: float, side: int, way: int
) -> None:
    """Radius = wheelbase / tan(angle), here worked out apart; left is positive y, in reverse it is left too."""
    seconds = 10.0
    path = run([(way * speed_mps, side * angle_deg)] * (int(seconds * 20) + 1))
    radius_m = 0.660 / tan(radians(angle_deg))
    turn_rad = speed_mps * seconds / radius_m
    assert path.speeds.distance_m == pytest.approx(speed_mps * seconds)
    assert path.x_m == pytest.approx(way * radius_m * sin(turn_rad), abs=1e-2)
    assert path.y_m == pytest.approx(side * radius_m * (1 - cos(turn_rad)), abs=1e-2)
    assert (path.heading_rad - side * way * turn_rad + pi) % (2 * pi) == pytest.approx(pi, abs=1e-6)


def test_forward_and_back_ends_where_it_began() -> None:
    """The distance counts both ways, the top speed has its sign."""
    path = run([(0.5, 15.0)] * 41 + [(-0.5, 15.0)] * 41)
    assert hypot(path.x_m, path.y_m) < 0.03
    assert path.speeds.distance_m == pytest.approx(2.0, abs=0.03)
    assert path.speeds.moving_ns == pytest.approx(4 * SECOND, abs=STEP_NS * 2)


def test_a_gap_breaks_the_path_and_is_not_guessed() -> None:
    """It goes on from the same place; how long nothing was known is told."""
    path = run([(1.0, 0.0)] * 21)
    path.add(20 * STEP_NS + GAP_NS + 1, 1.0, 0.0)
    assert path.x_m == pytest.approx(1.0)
    assert (path.speeds.gaps, path.speeds.gap_ns) == (1, GAP_NS + 1)
    assert [place.begins for place in path.end()].count(True) == 2


@pytest.mark.parametrize("missing", [None, nan, inf, -inf, 1e9])
def test_what_is_not_known_or_not_possible_is_not_integrated(missing: float | None) -> None:
    """Short of it the path goes on; nothing becomes not-a-number."""
    path = run([(1.0, 0.0)] * 3 + [(missing, 0.0), (1.0, missing)] + [(1.0, 0.0)] * 3)
    assert path.x_m == pytest.approx(0.35)
    assert path.speeds.top_mps == 1.0
    assert path.speeds.gaps == 0


def test_a_second_copy_of_a_log_adds_nothing() -> None:
    """Samples that are there twice, one after the other or later, are passed over and counted."""
    path = run([(1.0, 5.0)] * 21)
    x_m, y_m = path.x_m, path.y_m
    for number in range(21):
        path.add(number * STEP_NS, 1.0, 5.0)
    assert (path.x_m, path.y_m, path.speeds.stale, path.speeds.gaps) == (x_m, y_m, 21, 0)


def test_a_clock_that_is_set_back_does_not_end_the_path() -> None:
    """The path goes on, broken off."""
    path = run([(1.0, 0.0)] * 21, start_ns=2 * CLOCK_STEP_NS)
    for number in range(21):
        path.add(number * STEP_NS, 1.0, 0.0)
    assert path.x_m == pytest.approx(2.0)
    assert (path.speeds.gaps, path.speeds.gap_ns) == (1, 0)


def test_a_long_drive_keeps_a_bounded_number_of_places_near_the_path() -> None:
    """Ten hours in a circle: few places, each on the circle, the last one where it ends."""
    path = Odometer()
    for number in range(10 * 3600 * 5):
        path.add(number * 200 * MS, 1.0, 10.0)
    places = path.end()
    radius_m = 0.660 / tan(radians(10))
    assert PLACES_MAX // 4 < len(places) <= PLACES_MAX + 1
    assert all(abs(hypot(place.x_m, place.y_m - radius_m) - radius_m) < 0.05 for place in places)
    assert (places[-1].x_m, places[-1].y_m) == (path.x_m, path.y_m)
    assert places == sorted(places, key=lambda place: place.time_ns)


def test_a_standing_robot_is_one_place() -> None:
    """However long it stands; the time is known all the same."""
    path = run([(0.0, 3.0)] * 1000)
    assert len(path.end()) == 2
    assert (path.speeds.distance_m, path.speeds.moving_ns, path.speeds.known_ns) == (0.0, 0, 999 * STEP_NS)


def test_speeds_count_without_an_angle() -> None:
    """And with one they count as much."""
    meter, path = SpeedMeter(), run([(0.5, 4.0)] * 41 + [(-1.0, 4.0)] * 41)
    for number in range(82):
        meter.add(number * STEP_NS, 0.5 if number < 41 else -1.0)
    assert vars(meter) == vars(path.speeds)
    assert (meter.top_mps, meter.top_ns, meter.known_ns) == (-1.0, 41 * STEP_NS, 81 * STEP_NS)
    assert meter.add(81 * STEP_NS + GAP_NS + 1, 2.0) == 0.0
    assert (meter.gaps, meter.begun_ns) == (1, meter.last_ns)
