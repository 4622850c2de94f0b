"""The gate against a second statement of its rules, over as much of its domain as a minute allows.

Exhausted: every pattern of six of the eight frames, every value of every signal, all counters, all standard
identifiers, every speed and angle step, every combination of the discrete signals of two bursts. ``make nightly``
exhausts the other two frames, speeds far beyond the bound, every fine step, and takes every step through the gate.

Sampled, with the reason: bits without a meaning pass through one mask, so single bits suffice. No rule relates
speed, angle and pedal beyond their being zero, so the steps of each are tried with the others at rest, and by
night on both sides of every bound. Eight extended identifiers are compared by equality, so neighbours and family
suffice. Random walks combine the gate's memory: the previous burst, the last counters, the times of twelve frames.
"""

from itertools import combinations, pairwise, product
from random import Random

import pytest

from gateway.chassis.cruiser.gate import Gate, word_fault
from gateway.chassis.frame import ERROR, EXTENDED, REMOTE, Frame
from schemas.messages import Variant
from tests.support import bus_rules
from tests.support.bus_rules import DRIVE, PICTURES, STEERING
from tests.support.gate_domain import (
    ANGLES,
    BIT_UMPS,
    NO_STOP,
    SPEEDS,
    STOP,
    D,
    N,
    R,
    Raw,
    Walk,
    checksum,
    disagreements,
    discrete,
    gate_after,
    make_burst,
    make_frames,
    patterns,
    possible,
    rules_after,
    stop_in_place,
    wrong_checksums,
    wrong_steps,
)
from tests.support.nights import by_night

SMALL = [identifier for identifier in PICTURES if identifier not in {DRIVE, STEERING}]
SCALES = list(BIT_UMPS)
ONE_SCALE = [one if one is Variant.COARSE else by_night(one) for one in SCALES]
"""By day."""

FEW = 400
"""Fine speeds and angles by day: many times the largest step."""

NEAR = 3_000
"""Raw speeds by day, of 2^16: beyond every bound."""


@pytest.mark.parametrize("identifier", SMALL)
def test_every_pattern_of_a_frame(identifier: int) -> None:
    """Of 2^13 to 2^21 patterns one in 256 passes: the one with its checksum."""
    words = patterns(identifier)
    assert wrong_checksums(identifier, words) == (len(words), 0)


@pytest.mark.parametrize("identifier", [DRIVE, STEERING])
def test_every_value_of_the_two_large_frames(identifier: int) -> None:
    """With the enable and without it; their 2^25 and 2^29 patterns are for the night."""
    for word in patterns(identifier, without=".xc"):
        assert not word_fault(identifier | EXTENDED, word | checksum(word) << 56, None)


@pytest.mark.parametrize("identifier", PICTURES)
def test_one_and_two_wrong_bits(identifier: int) -> None:
    """Every bit and every pair of the 64, with the old checksum and with the right one."""
    for base in (patterns(identifier)[0], patterns(identifier, without=".xc")[-1]):
        whole = base | checksum(base) << 56
        flips = [1 << first | 1 << second for first, second in combinations(range(64), 2)]
        for flip in flips + [1 << bit for bit in range(64)]:
            wrong = whole ^ flip
            for word in (wrong, wrong & (1 << 56) - 1 | checksum(wrong) << 56):
                lawful = bus_rules.is_well_formed(identifier, word.to_bytes(8, "little"))
                assert (not word_fault(identifier | EXTENDED, word, None)) is lawful, hex(word)


@pytest.mark.parametrize("identifier", PICTURES)
def test_every_counter_after_every_counter(identifier: int) -> None:
    """Only the next one of 16 passes; the first may be any."""
    for base in {0, patterns(identifier, without=".xc")[-1]}:
        for counter in range(16):
            word = base | counter << 52
            word |= checksum(word) << 56
            after = [last for last in range(16) if not word_fault(identifier | EXTENDED, word, last)]
            assert after == [(counter - 1) % 16]
            assert not word_fault(identifier | EXTENDED, word, None)


def _other_identifiers() -> set[int]:
    """A selection of the 2^32 words with flags: see the test."""
    own = [identifier | EXTENDED for identifier in PICTURES]
    near = {can_id ^ 1 << first ^ 1 << second for can_id in own for first, second in product(range(32), repeat=2)}
    near |= {can_id + offset for can_id in own for offset in range(-300, 301)}
    family = {0x18C40000 | EXTENDED | low for low in range(0x1_0000)}
    family |= {high << 16 | can_id & 0xFFFF | EXTENDED for high in range(0x2000) for can_id in own}
    flagged = {can_id & (1 << 29) - 1 | flags << 29 for can_id in own for flags in range(8)}
    random = Random(1)  # noqa: S311 - any numbers will do, and always the same
    others = {random.getrandbits(32) for _ in range(20_000)}
    return {*range(0x800), *near, *family, *flagged, *others, ERROR, REMOTE} - set(own)


def test_no_other_identifier() -> None:
    """All 2^11 standard ones; of the extended ones the two-bit and numeric neighbours, the family, 20,000 more."""
    frames = make_frames(Raw(parking=1))
    identifiers = _other_identifiers()
    assert len(identifiers) > 150_000
    gate = Gate()
    for can_id in identifiers:
        fault = gate.admit([Frame(can_id, frames[0].data), *frames[1:]], Variant.COARSE, 0)
        assert fault is not None
        assert fault.detail == "this identifier is not sent"


@pytest.mark.parametrize(
    ("variant", "speeds"),
    [(Variant.COARSE, NEAR), *(by_night(scale, 1 << 16) for scale in SCALES)],
)
def test_every_value_of_every_signal(variant: Variant, speeds: int) -> None:
    """2^12 angles, 2^8 pedals, 2^3 gears, by night 2^16 speeds: in gear, in neutral, parked and disabled."""
    contexts = [Raw(), Raw(parking=1), Raw(gear=N, parking=1), Raw(0, N, parking=1)]
    raws = [Raw(speed=speed) for speed in range(speeds)]
    raws += [raw._replace(angle=angle) for raw in contexts for angle in range(1 << 12)]
    raws += [
        raw._replace(pedal=pedal, speed=speed) for raw in contexts for pedal in range(256) for speed in (0, 1)
    ]
    raws += [raw._replace(gear=gear) for raw in contexts for gear in range(8)]
    gate, rules = gate_after(None, variant), rules_after(None, variant)
    for raw in raws:
        burst = make_burst(raw, variant)
        assert gate(burst, STOP) == rules(burst, STOP), raw


@pytest.mark.parametrize("variant", ONE_SCALE)
def test_every_combination_of_two_bursts(variant: Variant) -> None:
    """32 enables, 8 gears, parking, pedal and speed of both, as a stop or not, and out of silence."""
    combos = list(discrete(speeds=(0, 1), pedals=(0, 1)))
    befores = possible(combos, variant)
    # Disabled; neutral; in two gears parked or not. In two gears at a speed.
    assert len(befores) == (1 + 1 + 4 + 2 if variant is not Variant.UNKNOWN else 6)
    admitted, wrong = disagreements([None, *befores], combos, variant)
    assert wrong == []
    assert admitted > len(befores)


@pytest.mark.parametrize(
    ("variant", "raws"),
    [*((scale, SPEEDS[scale][:FEW]) for scale in SCALES), by_night(Variant.FINE, SPEEDS[Variant.FINE])],
)
def test_every_speed_step(variant: Variant, raws: range) -> None:
    """56 x 56 coarse ones, by night 2,223 x 2,223 fine ones, as a stop and not; and out of the parking brake."""
    speeds = [Raw(speed=speed) for speed in raws]
    assert wrong_steps([*speeds, Raw(parking=1)], speeds, variant) == []


@pytest.mark.parametrize("raws", [ANGLES[:FEW], by_night(ANGLES)], ids=len)
def test_every_angle_step(raws: range) -> None:
    """By night 1,093 x 1,093, each as a stop and not."""
    angles = [Raw(angle=angle) for angle in raws]
    assert wrong_steps(angles, angles, Variant.COARSE) == []


@pytest.mark.parametrize("angles", [ANGLES[::21], by_night(ANGLES)], ids=len)
@pytest.mark.parametrize("variant", SCALES)
def test_a_stop_in_place_is_always_admitted(variant: Variant, angles: range) -> None:
    """After every admitted burst: angles (by night each), speeds, all combinations of the rest; and silence."""
    speeds = SPEEDS[variant]
    kinds = possible(discrete((0, speeds[-1]), (0, 255)), variant)
    befores = [raw._replace(angle=angle) for raw in kinds for angle in angles]
    befores += [Raw(gear=gear, speed=speed) for gear in (R, D) for speed in speeds]
    out_of_silence = gate_after(None, variant)
    for before in befores:
        stop = make_burst(stop_in_place(before), variant, 1)
        assert gate_after(make_burst(before, variant), variant)(stop, STOP), before
        assert out_of_silence(stop, STOP), before


def test_the_rules_can_be_kept() -> None:
    """From a stop in place to silence, and from there through neutral into the other gear and away."""
    parked, away = Raw(gear=R, parking=1), Raw(gear=D, speed=1)
    neutral = Raw(gear=N, parking=1)
    steps = [parked, neutral, neutral._replace(enables=0), neutral, Raw(parking=1), Raw(), away, Raw()]
    for before, after in pairwise(steps):
        judge = gate_after(make_burst(before, Variant.COARSE), Variant.COARSE)
        assert judge(make_burst(after, Variant.COARSE, 1), NO_STOP)


@pytest.mark.parametrize("bursts", [4_000, by_night(10_000)])
@pytest.mark.parametrize("variant", SCALES)
def test_walks(variant: Variant, bursts: int) -> None:
    """Bursts with pauses, parts, wrong bits and too high a rate: every reason to refuse occurs."""
    walk = Walk(1, variant)
    for _ in range(bursts):
        walk.step()
    # Where the scale is not known no speed passes the bound, and those on its steps have nothing to refuse.
    assert len(walk.faults) == (25 if variant is not Variant.UNKNOWN else 22), walk.faults
    assert walk.faults[""] > bursts / 2
