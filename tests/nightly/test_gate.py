"""The rest of the gate's domain: what takes minutes, in a run of its own (``make nightly``)."""

import pytest

from gateway.chassis.cruiser.gate import MotionBurst, motion_fault, step_fault
from schemas.messages import Variant
from tests.support.bus_rules import DRIVE, STEERING
from tests.support.gate_domain import (
    ALL,
    ANGLES,
    BIT_UMPS,
    SPEEDS,
    D,
    R,
    Raw,
    Walk,
    disagreements,
    discrete,
    patterns,
    possible,
    wrong_checksums,
)

pytestmark = pytest.mark.timeout(3600)

SCALES = list(BIT_UMPS)
RISES = {Variant.COARSE: 1, Variant.FINE: 16, Variant.UNKNOWN: 0}  # bits that the speed may rise in a tick
TURN = 15  # bits that the angle may change in a tick


@pytest.mark.parametrize("identifier", [STEERING, DRIVE])
def test_every_pattern_of_a_frame(identifier: int) -> None:
    """Of 2^25 and 2^29 patterns of meaningful bits one in 256 passes: that with its own checksum."""
    words = patterns(identifier)
    assert wrong_checksums(identifier, words) == (len(words), 0)


@pytest.mark.parametrize("variant", SCALES)
def test_every_speed_step_through_the_whole_gate(variant: Variant) -> None:
    """2,223 x 2,223 fine ones, 56 x 56 coarse ones, as a stop and not, from the bytes."""
    speeds = [Raw(speed=speed) for speed in SPEEDS[variant]]
    admitted, wrong = disagreements(speeds, speeds, variant)
    assert wrong == []
    most, rise = len(speeds) - 1, RISES[variant]
    falls = (most + 1) * (most + 2) // 2
    assert admitted == 2 * falls + sum(min(rise, most - speed) for speed in range(most + 1))


def test_every_angle_step_through_the_whole_gate() -> None:
    """1,093 x 1,093, as a stop and not, from the bytes."""
    angles = [Raw(angle=angle) for angle in ANGLES]
    admitted, wrong = disagreements(angles, angles, Variant.COARSE)
    assert wrong == []
    assert admitted == 2 * (len(angles) * (2 * TURN + 1) - TURN * (TURN + 1))


@pytest.mark.parametrize("variant", SCALES)
def test_both_sides_of_every_bound(variant: Variant) -> None:
    """All combinations of the discrete signals of two bursts with speeds, angles and pedals at their bounds."""
    most, rise = SPEEDS[variant][-1], RISES[variant]
    speeds = sorted({0, 1, rise, rise + 1, most - rise, most, most + 1} - {-1})
    first, last = ANGLES[0], ANGLES[-1]
    angles = (first - 1, first, first + TURN, first + TURN + 1, last - TURN - 1, last - TURN, last, last + 1)
    raws = list(discrete(speeds, (0, 1, 255), angles, enables=(0, 1, ALL - 1, ALL)))
    befores = possible(raws, variant)
    admitted, wrong = disagreements([None, *befores], raws, variant)
    assert wrong == []
    assert admitted > len(befores)


@pytest.mark.parametrize("variant", SCALES)
def test_a_stop_in_place_after_every_speed_and_angle(variant: Variant) -> None:
    """2 gears x 1,093 angles x every speed."""
    for gear in (R, D):
        for angle in ANGLES:
            stop = MotionBurst(5, gear, angle, speed_raw=0, pedal_raw=0, parking=1)
            assert not motion_fault(stop, variant)
            for speed in SPEEDS[variant]:
                before = MotionBurst(5, gear, angle, speed, pedal_raw=0, parking=0)
                assert not step_fault(stop, before, variant, stopping=True, may_release=False), before


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("variant", SCALES)
def test_walks(variant: Variant, seed: int) -> None:
    """50,000 bursts in a row each."""
    walk = Walk(seed, variant)
    for _ in range(50_000):
        walk.step()
