"""Distances, drives and what befell a robot, from its samples and its entries."""

from collections.abc import Sequence
from math import inf, nan
from typing import Any

import msgspec
import pytest

from gateway.chassis.odometry import GAP_NS, DeadReckoning
from recorder.review.drives import (
    CLOCK_STEP_NS,
    DIED,
    ENTRIES_MAX,
    ERRORS_MAX,
    GAPS_MAX,
    MARGIN_NS,
    REST_NS,
    Drives,
    Outage,
    SpeedMeter,
)
from recorder.review.entries import Entry, EntryKind, EntrySource, Stops
from schemas.cruiser import WHEELBASE_M
from schemas.decisions import Severity
from schemas.messages import Odometry
from schemas.reasons import Reason
from tests.support.messages import MS, SECOND, WALL_NS
from tests.support.reading import entry as entry_at

STEP_NS = 50 * MS


def moved(speeds: Sequence[float | None], start_ns: int = 0) -> SpeedMeter:
    motion = SpeedMeter()
    for number, speed_mps in enumerate(speeds):
        motion.add(start_ns + number * STEP_NS, speed_mps)
    return motion


@pytest.mark.parametrize(
    ("speeds", "distance_m", "moving_s", "top_mps"),
    [
        pytest.param([0.5] * 41, 1.0, 2.0, 0.5, id="steady"),
        pytest.param([0.5] * 41 + [-0.5] * 41, 2.0, 4.0, 0.5, id="forward and back"),
        pytest.param([0.0] * 1000, 0.0, 0.0, 0.0, id="standing"),
        pytest.param([-0.2, -0.6, -0.2], 0.04, 0.1, -0.6, id="in reverse"),
        *(
            pytest.param([1.0] * 3 + [odd] + [1.0] * 3, 0.3, 0.3, 1.0, id=f"unknown: {odd}")
            for odd in (None, nan, inf, -inf, 1e9)
        ),
        pytest.param(
            [1, 2.9, 2.5, 2.1, 1.7, 1.3, 0.9, 0.5, 0.1, 0, 0.4, 0.8, 1.2], 0.71, 0.6, 1.2, id="till rest"
        ),
        pytest.param([1.0, 1.0, 2.9, 1.0, 1.0], 0.295, 0.2, 1.0, id="one frame of a wrong scale"),
        pytest.param([1.0, 1.0, 2.9, 2.9, 2.9, 1.0], 0.535, 0.25, 1.0, id="some frames of a wrong scale"),
    ],
)
def test_distance_and_top_speed(speeds: list[float], distance_m: float, moving_s: float, top_mps: float) -> None:
    motion = moved(speeds)
    assert motion.distance_m == pytest.approx(distance_m, abs=0.03)
    assert motion.moving_ns / 1e9 == pytest.approx(moving_s, abs=0.1)
    assert motion.top_mps == top_mps
    assert motion.gaps == 0


@pytest.mark.parametrize(
    ("gap_ns", "speeds_mps", "is_missing"),
    [
        (GAP_NS, (1.0, 1.0), False),
        (GAP_NS + 1, (1.0, 1.0), True),
        (REST_NS, (0.0, 0.0), True),
        (REST_NS + 1, (0.0, 0.02), False),
        (REST_NS + 1, (0.0, 0.03), True),
        (REST_NS + 1, (-1.0, 0.0), True),
    ],
)
def test_a_gap_is_not_guessed(gap_ns: int, speeds_mps: tuple[float, float], is_missing: bool) -> None:  # noqa: FBT001 - a case
    before_mps, behind_mps = speeds_mps
    motion = moved([before_mps] * 21)
    step_m = motion.add(20 * STEP_NS + gap_ns, behind_mps)
    assert (step_m == 0.0) is (gap_ns > GAP_NS or not before_mps)
    assert (motion.gaps, motion.gap_ns) == ((1, gap_ns) if is_missing else (0, 0))
    assert (motion.begun_ns == motion.last_ns) is (gap_ns > GAP_NS)


def test_what_is_there_twice_adds_nothing() -> None:
    motion = moved([1.0] * 21, start_ns=2 * CLOCK_STEP_NS)
    assert motion.add(2 * CLOCK_STEP_NS, 1.0) is None
    for number in range(21):
        motion.add(number * STEP_NS, 1.0)
    assert motion.distance_m == pytest.approx(2.0)
    assert (motion.gaps, motion.gap_ns) == (1, 0)


def entry(at_s: float, kind: EntryKind, **fields: Any) -> Entry:  # noqa: ANN401 - any field
    """Something that happened so long after the beginning."""
    said = {"source": EntrySource.LOG, "text": kind.value, **fields}
    return entry_at(kind, WALL_NS + round(at_s * SECOND), **said)


def happened(*entries: Entry, found: Drives | None = None) -> Drives:
    found, stops = found or Drives(), Stops()
    for one in entries:
        found.take(stops.mark(one))
    return found


def silence(from_s: float, to_s: float, **fields: object) -> Entry:
    return entry(from_s, EntryKind.GAP, last_ns=WALL_NS + round(to_s * SECOND), **fields)


@pytest.mark.parametrize(("rest_ns", "count"), [(REST_NS, 1), (REST_NS + 1, 2)])
def test_a_long_rest_ends_a_drive(rest_ns: int, count: int) -> None:
    found = Drives()
    for time_ns in (10**15, 10**15 + 5, 10**15 + 5 + rest_ns):
        found.command(time_ns, time_ns)
    assert len(found.drives()) == count
    assert found.drives()[-1].end_ns == 10**15 + 5 + rest_ns


def test_a_drive_misses_what_was_not_recorded_in_it() -> None:
    found = Drives()
    for at_s in (0.0, 0.05, 8.35, 8.4, 4000.0, 4000.05):
        found.move(WALL_NS + round(at_s * SECOND), WALL_NS, 1.0)
    assert [one.missing_s for one in found.drives()] == pytest.approx([8.3, 0.0])
    assert [one.distance_m for one in found.drives()] == pytest.approx([0.1, 0.05])
    assert found.motion.gaps == 2


@pytest.mark.parametrize(("off_ns", "is_in"), [(-MARGIN_NS, 1), (-MARGIN_NS - 1, 0), (MARGIN_NS + 1, 0)])
def test_what_happens_near_a_drive_belongs_to_it(off_ns: int, is_in: int) -> None:
    found = Drives()
    found.command(WALL_NS, WALL_NS)
    happened(entry(off_ns / SECOND, EntryKind.STOP, reason=Reason.DEADMAN), found=found)
    (drive,) = found.drives()
    found_there = (drive.stops, drive.worst, drive.severity.value)
    assert found_there == ((1, "stop", "warning") if is_in else (0, "", "info"))


@pytest.mark.parametrize(
    ("severities", "worst"),
    [
        ("info", ""),
        ("info warning", "1"),
        ("warning error error", "1"),
        ("warning warning* error", "2"),
        ("warning warning* warning", "1"),
    ],
)
def test_the_worst_moment_is_the_first_of_the_gravest(severities: str, worst: str) -> None:
    """News are none; a stop (*) is worse than what is as grave."""
    found = Drives()
    found.command(WALL_NS, WALL_NS)
    for number, said in enumerate(severities.split()):
        one = entry(number, EntryKind.FAULT, severity=Severity(said.strip("*")), text=str(number))
        found.take(msgspec.structs.replace(one, is_stop="*" in said))
    (drive,) = found.drives()
    assert (drive.worst, "" if found.worst is None else found.worst.text) == (worst, worst)


@pytest.mark.parametrize("is_latched", [True, False])
def test_the_cause_of_a_gateways_death_is_what_the_next_one_latches(is_latched: bool) -> None:  # noqa: FBT001 - a case
    died = entry(1, EntryKind.GATEWAY, severity=Severity.ERROR)
    latch = entry(9, EntryKind.LATCH, reason=Reason.GUARD)
    found = happened(died, *[latch] * is_latched)
    assert +found.stops == ({"guard": 1} if is_latched else {DIED: 1})
    assert [one.reason for one in found.entries if one.is_stop] == [Reason.GUARD if is_latched else Reason.NONE]


def test_the_silence_before_a_restart_is_its_own() -> None:
    found = happened(
        silence(1, 3),
        silence(5, 9, severity=Severity.ERROR),
        silence(6, 7),
        silence(6, 8, source=EntrySource.RECORDER),
        entry(9, EntryKind.GATEWAY, severity=Severity.ERROR, source=EntrySource.STATE),
        entry(20, EntryKind.GATEWAY, source=EntrySource.HEALTH),
        entry(21, EntryKind.GATEWAY, severity=Severity.INFO, source=EntrySource.HEALTH),
        entry(22, EntryKind.REFUSAL),
    )
    assert found.outages == [
        Outage(WALL_NS + 5 * SECOND, WALL_NS + 9 * SECOND, is_commanding=True),
        Outage(WALL_NS + 20 * SECOND, WALL_NS + 20 * SECOND, is_commanding=False),
    ]
    assert found.counts == {"gap": 4, "gateway": 3}


def test_a_thousand_leases_hide_no_error() -> None:
    leases = [entry(number, EntryKind.LEASE, severity=Severity.INFO) for number in range(ENTRIES_MAX + 100)]
    errors = [entry(number + 0.5, EntryKind.GATEWAY, severity=Severity.ERROR) for number in range(ERRORS_MAX + 50)]
    found = happened(*leases, *errors)
    kinds = [one.kind.value for one in found.entries]
    assert (kinds.count("lease"), kinds.count("gateway")) == (ENTRIES_MAX, ERRORS_MAX)
    assert found.more_entries == 150
    assert (len(found.outages), found.more_outages) == (GAPS_MAX, ERRORS_MAX + 50 - GAPS_MAX)


# The way, by the robot's own odometry.


def odometries(parts: Sequence[tuple[float, float]], start_ns: int) -> list[Odometry]:
    """The odometry of a gateway that begins at zero: speeds and angles, a second of each."""
    made, found = DeadReckoning(WHEELBASE_M), []
    for number, (speed_mps, angle_deg) in enumerate(one for one in parts for _ in range(50)):
        made.move(start_ns + number * 20 * MS, speed_mps, angle_deg)
        said = made.report()
        assert said is not None
        found.append(said)
    return found


def place(way: DeadReckoning) -> tuple[float, float, float, float]:
    return way.x_m, way.y_m, way.heading_rad, way.distance_m


def test_the_way_is_that_of_the_robots_odometry_where_the_log_has_it() -> None:
    """Whatever ``state`` says beside it; by the states alone it is the same to 3 cm."""
    parts = [(1.0, 10.0), (1.0, -20.0), (0.0, 0.0), (-0.5, 5.0)]
    told, alone, mixed = odometries(parts, WALL_NS), SpeedMeter(), SpeedMeter()
    for number, said in enumerate(told):
        mixed.way.follow(said, said.time_ns)
        if number % 3 == 0:
            speed_mps, angle_deg = parts[number // 50]
            alone.add(said.time_ns, speed_mps, angle_deg)
            mixed.add(said.time_ns, 2 * speed_mps, -angle_deg)
    last = told[-1]
    expected = (last.x_m, last.y_m, last.heading_rad, last.distance_m)
    assert place(mixed.way) == pytest.approx(expected, abs=1e-9)
    assert place(alone.way) == pytest.approx(expected, abs=0.03)


@pytest.mark.parametrize("rest_ns", [20 * MS, 10 * SECOND])
def test_another_gateway_or_a_reset_goes_on_from_the_same_place(rest_ns: int) -> None:
    way = SpeedMeter().way
    first = odometries([(1.0, 0.0)] * 2, WALL_NS)
    second = odometries([(1.0, 0.0)], first[-1].time_ns + rest_ns)
    for said in (*first, *second):
        way.follow(said, said.time_ns)
    assert place(way) == pytest.approx((2.96, 0.0, 0.0, 2.96), abs=0.03)
