"""The odometry: what drive and steering feedback make of the pose, and when it says that it may be wrong."""

from collections.abc import Callable
from itertools import pairwise
from math import degrees, hypot, pi, radians, tan

import msgspec
import pytest

from gateway.chassis.odometry import SLIP_M, DeadReckoning
from schemas.cruiser import WHEELBASE_M
from schemas.messages import Odometry, RobotState, Variant
from schemas.reasons import Reason
from tests.support.rigs.gateway import GatewayRig, Operator, driving, ready

MS = 1_000_000
PERIOD_NS = 10 * MS
PULSES_PER_M = 800.0

Part = tuple[float, float, float]
"""Speed in m/s, angle in degrees, seconds."""


def after(
    *parts: Part, pulses: Callable[[float], float] | None = None, period_ns: int = PERIOD_NS
) -> DeadReckoning:
    """Drive parts, one behind the other; ``pulses`` makes of the true way what the wheels count."""
    made, now_ns, way_m = DeadReckoning(WHEELBASE_M), 0, 0.0
    for speed_mps, angle_deg, seconds in parts:
        for _ in range(round(seconds * 1e9 / period_ns)):
            now_ns += period_ns
            way_m += speed_mps * period_ns / 1e9
            made.move(now_ns, speed_mps, angle_deg)
            if pulses is not None and now_ns % (50 * MS) == 0:
                count = round(pulses(way_m)) % 0x1_0000
                made.count(now_ns, count - 0x8000, count - 0x8000)
    return made


def turned(heading_rad: float, wanted_rad: float) -> float:
    """The difference of two headings."""
    return abs((heading_rad - wanted_rad + pi) % (2 * pi) - pi)


LAP_S = 2 * pi * WHEELBASE_M / tan(radians(20.0))


@pytest.mark.parametrize(
    ("parts", "x_m", "y_m", "heading_deg"),
    [
        pytest.param([(1.0, 0.0, 10.0)], 10.0, 0.0, 0.0, id="straight on is along x"),
        pytest.param([(-1.0, 0.0, 10.0)], -10.0, 0.0, 0.0, id="reverse"),
        pytest.param([(1.0, 20.0, LAP_S / 4)], 1.813, 1.813, 90.0, id="left is positive"),
        pytest.param([(1.0, -20.0, LAP_S / 4)], 1.813, -1.813, -90.0, id="right"),
        pytest.param([(-1.0, 20.0, LAP_S / 4)], -1.813, 1.813, -90.0, id="reverse, steered left"),
        pytest.param([(1.0, 20.0, LAP_S)], 0.0, 0.0, 0.0, id="a lap"),
        pytest.param([(0.5, 12.0, 9.0), (0.0, 12.0, 1.0), (-0.5, 12.0, 9.0)], 0.0, 0.0, 0.0, id="there and back"),
        pytest.param([(0.0, 24.0, 60.0)], 0.0, 0.0, 0.0, id="standing"),
    ],
)
def test_the_pose_is_that_of_the_bicycle_model(
    parts: list[Part], x_m: float, y_m: float, heading_deg: float
) -> None:
    """To a centimetre, which is the way of the first period; by the signs of ISO 8855."""
    pose = after(*parts)
    assert hypot(pose.x_m - x_m, pose.y_m - y_m) < 0.02
    assert turned(pose.heading_rad, radians(heading_deg)) < radians(0.6)
    assert pose.distance_m == pytest.approx(sum(abs(speed) * seconds for speed, _, seconds in parts), abs=0.02)


def sd(pose: DeadReckoning) -> tuple[float, float]:
    """Return standard deviations of the place, in metres, and of the heading, in degrees."""
    pose.last_ns = (pose.last_ns or 0) + 1  # So that it is reported again.
    said = pose.report()
    assert said is not None
    return (said.x_variance_m2 + said.y_variance_m2) ** 0.5, degrees(said.heading_variance_rad2**0.5)


def test_variances_grow_with_the_way_and_with_turning() -> None:
    """A bend makes the heading less sure than as much way straight on, and standing changes nothing."""
    short, long, bent = (sd(after(part)) for part in ((1.0, 0.0, 5.0), (1.0, 0.0, 50.0), (1.0, 20.0, 5.0)))
    assert short < long
    assert short[1] < bent[1]
    assert sd(after((1.0, 0.0, 5.0), (0.0, 0.0, 600.0)))[0] == pytest.approx(short[0], abs=0.01)


@pytest.mark.parametrize("seconds", [0.51, 2.0, 30.0])
@pytest.mark.parametrize(
    "missing", ["nothing comes", "no speed is known", "no angle is known", "the clock is set back"]
)
def test_a_gap_moves_nothing_and_is_unsure(missing: str, seconds: float) -> None:
    """No jump; the way that may have been driven is in the variances, and the pose goes on as before."""
    pose, whole = after((1.0, 0.0, 5.0)), after((1.0, 0.0, 5.0))
    last_ns = pose.last_ns
    assert last_ns is not None
    before_m, before = pose.x_m, sd(pose)
    pose.last_ns = last_ns
    if missing == "the clock is set back":
        back_ns = last_ns - round(seconds * 1e9)
        seconds = 0.5
    else:
        back_ns = last_ns + round(seconds * 1e9)
        for at_ns in range(last_ns + 50 * MS, back_ns, 50 * MS):
            if missing != "nothing comes":
                pose.move(at_ns, *((None, 0.0) if missing == "no speed is known" else (1.0, None)))
    pose.move(back_ns, 1.0, 0.0)
    assert pose.x_m == before_m
    unsure = sd(pose)
    assert unsure[0] > max(before[0], seconds * 0.99)
    assert unsure[1] > before[1]
    pose.last_ns = back_ns
    pose.move(back_ns + PERIOD_NS, 1.0, 0.0)
    whole.move(last_ns + PERIOD_NS, 1.0, 0.0)
    assert pose.x_m == whole.x_m


@pytest.mark.parametrize(
    ("parts", "pulses", "is_doubted"),
    [
        pytest.param([(1.0, 0.0, 20.0)], lambda way: PULSES_PER_M * way, False, id="agree"),
        pytest.param([(-2.0, 9.0, 90.0)], lambda way: PULSES_PER_M * way, False, id="agree in reverse, and wrap"),
        pytest.param([(1.0, 0.0, 20.0)], lambda way: PULSES_PER_M * min(way, 10.0), True, id="stand still"),
        pytest.param([(1.0, 0.0, 20.0)], lambda way: -PULSES_PER_M * way, True, id="count the other way"),
        pytest.param([(1.0, 0.0, 1.0)], lambda _: 7.0, True, id="stand still from the first"),
        pytest.param(
            [(1.0, 0.0, 20.0)],
            lambda way: PULSES_PER_M * (way + max(0, way - 10)),
            True,
            id="slip, and count twice",
        ),
        pytest.param([(1.0, 0.0, 20.0)], lambda way: PULSES_PER_M * way * (1 + way / 400), False, id="wear"),
    ],
)
def test_pulses_that_count_another_way_make_it_unsure(
    *, parts: list[Part], pulses: Callable[[float], float], is_doubted: bool
) -> None:
    """The pose remains that of drive and steering."""
    alone, checked = after(*parts), after(*parts, pulses=pulses)
    assert (checked.x_m, checked.y_m, checked.heading_rad) == (alone.x_m, alone.y_m, alone.heading_rad)
    assert (sd(checked) > sd(alone)) is is_doubted


# In the core.


def odometry_of(rig: GatewayRig) -> list[Odometry]:
    """All that was published."""
    return [
        msgspec.msgpack.decode(sample.payload, type=Odometry)
        for _, sample in rig.recorded
        if sample.subject == "chassis/odometry"
    ]


TRIPS: dict[str, list[Part]] = {
    "straight": [(1.5, 0.0, 8.0)],
    "circle": [(1.0, 18.0, 15.0)],
    "slalom": [(1.0, 15.0, 3.0), (1.0, -15.0, 3.0), (1.0, 15.0, 3.0)],
    "reversal": [(1.0, 10.0, 4.0), (0.0, 10.0, 3.0), (-1.0, -10.0, 6.0)],
}


def driven(
    parts: list[Part], variant: Variant = Variant.FINE, slope_deg: float = 0.0
) -> tuple[GatewayRig, Operator]:
    """A robot after a trip, at rest."""
    rig, operator = ready(variant)
    if slope_deg:
        rig.fault(f"slope {slope_deg}")
    operator.engage()
    for part in parts:
        operator.drive(*part)
    operator.drive(0.0, seconds=3.0)
    return rig, operator


@pytest.mark.parametrize("slope_deg", [0.0, 12.0, -12.0])
@pytest.mark.parametrize("trip", TRIPS)
def test_it_follows_the_virtual_chassis(trip: str, slope_deg: float) -> None:
    """To 2 % of the way and 2 degrees, within three standard deviations, on any slope; 50 times a second."""
    rig, _ = driven(TRIPS[trip], slope_deg=slope_deg)
    said, truth = odometry_of(rig), rig.chassis.state
    last = said[-1]
    assert last.distance_m > 3
    off_m = hypot(last.x_m - truth.x_m, last.y_m - truth.y_m)
    assert off_m < 0.02 * last.distance_m
    assert turned(last.heading_rad, truth.yaw_rad) < radians(2)
    assert off_m < 3 * (last.x_variance_m2 + last.y_variance_m2) ** 0.5
    assert {now.time_ns - before.time_ns for before, now in pairwise(said)} == {20 * MS}
    assert [now.sequence - before.sequence for before, now in pairwise(said)] == [1] * (len(said) - 1)


@pytest.mark.parametrize("trip", TRIPS)
def test_state_alone_gives_the_same_path(trip: str) -> None:
    """The review integrates ``state``, at 20 Hz, where a log has no odometry: to 2 cm and half a degree."""
    rig, _ = driven(TRIPS[trip])
    again = DeadReckoning(WHEELBASE_M)
    for _, sample in rig.recorded:
        if sample.subject == "state":
            state = msgspec.msgpack.decode(sample.payload, type=RobotState)
            again.move(state.time_ns, state.speed_mps, state.angle_deg)
    last = odometry_of(rig)[-1]
    assert hypot(again.x_m - last.x_m, again.y_m - last.y_m) < 0.02
    assert turned(again.heading_rad, last.heading_rad) < radians(0.5)
    assert again.distance_m == pytest.approx(last.distance_m, abs=0.02)


def test_reset_odometry_wants_the_lease_alone() -> None:
    """In motion too; the reply, the decision and an event say so, and the next sample begins at zero."""
    rig, operator = driving(1.0, 5.0)
    stranger = Operator(rig, "stranger")
    stranger.lease = operator.lease + 1
    assert stranger.reason("reset_odometry") is not Reason.NONE
    assert odometry_of(rig)[-1].distance_m > 0.5
    assert operator.reason("reset_odometry") is Reason.NONE
    assert (rig.events[-1].text, rig.events[-1].operator) == (
        "odometry reset: the pose is zero here",
        operator.name,
    )
    rig.tick(2)
    last = odometry_of(rig)[-1]
    assert 0 < last.distance_m < 0.05
    assert last.x_variance_m2 < SLIP_M**2
