"""All that the gate can be offered, in parts that can be exhausted, and its verdicts beside those of the rules."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cache
from itertools import product
from random import Random
from typing import Final, NamedTuple

from gateway.chassis.cruiser.gate import Gate, MotionBurst, read_motion, step_fault, word_fault
from gateway.chassis.frame import EXTENDED, Frame
from schemas.messages import Variant
from tests.support import bus_rules
from tests.support.bus_rules import BURST, PICTURES, Bus, Told, compose

MS: Final = 1_000_000
TICK_NS: Final = 10 * MS
BIT_UMPS: Final = {
    Variant.COARSE: bus_rules.COARSE_UMPS,
    Variant.FINE: bus_rules.FINE_UMPS,
    Variant.UNKNOWN: None,
}

ALL: Final = 31
R, N, D = 2, 3, 4
ANGLES: Final = range(1502, 2595)  # the 1,093 from -24 to 24 deg
SPEEDS: Final = {Variant.COARSE: range(56), Variant.FINE: range(2223), Variant.UNKNOWN: range(1)}  # up to 8 km/h


class Raw(NamedTuple):
    """A burst in raw values; the enables are a mask in the order of the frames."""

    enables: int = ALL
    gear: int = D
    angle: int = 2048
    speed: int = 0
    pedal: int = 0
    parking: int = 0


class Burst(NamedTuple):
    """A burst, in the gate's terms and in those of the rules."""

    frames: list[Frame]
    motion: MotionBurst
    told: Told


Judge = Callable[[Burst, bool], bool]  # whether a burst is admitted, as a stop or not
STOP, NO_STOP = True, False


@cache
def _frame(identifier: int, letter: str, raw: int, enable: int, counter: int) -> Frame:
    return Frame(identifier | EXTENDED, compose(identifier, {letter: raw, "e": enable}, counter))


def make_frames(raw: Raw, counters: Sequence[int] = (0,) * 5) -> list[Frame]:
    values = (raw.speed, raw.gear, raw.angle, raw.pedal, raw.parking)
    enables = (raw.enables >> index & 1 for index in range(5))
    return list(map(_frame, BURST, "vgabp", values, enables, counters))


def make_burst(raw: Raw, variant: Variant, counter: int = 0) -> Burst:
    """The five frames with this alive counter."""
    frames = make_frames(raw, [counter] * 5)
    return Burst(frames, read_motion(frames), bus_rules.read(frames, BIT_UMPS[variant]))


def read_raw(frames: Sequence[Frame]) -> Raw:
    """The raw values of the five frames."""
    five = [next(frame for frame in frames[:5] if frame.identifier == identifier) for identifier in BURST]
    speed, gear, angle, pedal, parking = (
        bus_rules.value(identifier, letter, frame.data)
        for identifier, letter, frame in zip(BURST, "vgabp", five, strict=True)
    )
    enables = sum((frame.data[0] & 1) << index for index, frame in enumerate(five))
    return Raw(enables, gear, angle, speed, pedal, parking)


def gate_after(before: Burst | None, variant: Variant) -> Judge:
    """The gate after a burst that it admitted as a stop; the next counter is 1."""
    gate = Gate()
    if before is not None:
        assert gate.admit(before.frames, variant, 0, stopping=True) is None
        gate.sent(before.frames, 0)
    return lambda burst, is_stop: gate.admit(burst.frames, variant, TICK_NS, stopping=is_stop) is None


def rules_after(before: Burst | None, variant: Variant) -> Judge:
    """The second statement after the same burst."""
    past, bit_umps = None if before is None else before.told, BIT_UMPS[variant]
    return lambda burst, is_stop: (
        bus_rules.may_be_told(burst.told) and bus_rules.may_follow(burst.told, past, bit_umps, is_stop=is_stop)
    )


def disagreements(
    befores: Iterable[Raw | None], nexts: Iterable[Raw], variant: Variant
) -> tuple[int, list[tuple[Raw | None, Raw, bool]]]:
    """Number of pairs that the gate admits, as a stop or not; and the pairs on which the rules differ from it."""
    offered = [(raw, make_burst(raw, variant, 1)) for raw in nexts]
    admitted, wrong = 0, []
    for before in befores:
        past = None if before is None else make_burst(before, variant)
        gate, rules = gate_after(past, variant), rules_after(past, variant)
        for is_stop in (NO_STOP, STOP):
            for raw, burst in offered:
                verdict = gate(burst, is_stop)
                admitted += verdict
                if verdict != rules(burst, is_stop):
                    wrong.append((before, raw, is_stop))
    return admitted, wrong


def wrong_steps(befores: Iterable[Raw], nexts: Iterable[Raw], variant: Variant) -> list[tuple[Raw, bool]]:
    """Bursts after which the gate's rules of steps and the second statement differ, as a stop or not."""
    bit_umps, wrong = BIT_UMPS[variant], []
    bursts = [make_burst(raw, variant) for raw in nexts]
    motions, all_told = [burst.motion for burst in bursts], [burst.told for burst in bursts]
    for raw in befores:
        _, before, before_told = make_burst(raw, variant)
        for is_stop, may_release in ((NO_STOP, False), (STOP, False), (STOP, True)):
            gate = [
                not step_fault(motion, before, variant, stopping=is_stop, may_release=may_release)
                for motion in motions
            ]
            rules = [
                bus_rules.may_follow(told, before_told, bit_umps, is_stop=is_stop, may_let_go=may_release)
                for told in all_told
            ]
            if gate != rules:
                wrong.append((raw, is_stop))
    return wrong


def discrete(
    speeds: Sequence[int],
    pedals: Sequence[int],
    angles: Sequence[int] = (2048,),
    enables: Sequence[int] = range(32),
) -> Iterator[Raw]:
    """Every combination of gear and parking request with these speeds, pedals, angles and enables."""
    combinations = product(enables, range(8), angles, speeds, pedals, (0, 1))
    return (Raw(*combination) for combination in combinations)


def possible(raws: Iterable[Raw], variant: Variant) -> list[Raw]:
    """Bursts that may have been sent before, by the rules and by the gate."""
    rules, gate = rules_after(None, variant), gate_after(None, variant)
    bursts = [(raw, make_burst(raw, variant)) for raw in raws]
    assert all(rules(burst, STOP) == gate(burst, STOP) for _, burst in bursts)
    return [raw for raw, burst in bursts if rules(burst, STOP)]


def patterns(identifier: int, without: str = ".x") -> list[int]:
    """Every pattern of the bits with a meaning, but for those of these letters."""
    marks = PICTURES[identifier].replace(" ", "")
    words = [0]
    for place in (place for place, mark in enumerate(marks) if mark not in without):
        words += [word | 1 << place for word in words]
    return words


def wrong_checksums(identifier: int, words: Iterable[int]) -> tuple[int, int]:
    """Number of patterns tried with all 256 checksums, and of those that did not pass with their own alone."""
    can_id, tried, wrong = identifier | EXTENDED, 0, 0
    for word in words:
        let_through = [each for each in range(256) if not word_fault(can_id, word | each << 56, None)]
        tried += 1
        wrong += let_through != [checksum(word)]
    return tried, wrong


def checksum(word: int) -> int:
    """The byte that makes the number of ones in each column of bits even."""
    bits = bus_rules.bit_string(word.to_bytes(8, "little"))
    return sum((bits[column:56:8].count("1") % 2) << column for column in range(8))


def stop_in_place(before: Raw) -> Raw:
    """Zero speed, gear and angle of the burst before, parking request, no pedal, the enables."""
    return before._replace(enables=ALL, speed=0, pedal=0, parking=1)


class Walk:
    """A gate and the rules, offered the same random bursts, most of them a small step from the one before."""

    def __init__(self, seed: int, variant: Variant) -> None:
        self.variant = variant
        self.gate, self.bus = Gate(), Bus()
        self.faults: dict[str, int] = {}
        self._random = Random(seed)  # noqa: S311 - any numbers will do, and always the same
        self._raw = Raw(parking=1)
        self._now_ns = 0
        self._is_stop = False

    def step(self) -> None:
        """Offer a burst; send what is admitted, at times only in part."""
        random = self._random
        gaps_ms = (0, 5, 10, 10, 10, 10, 13) if random.random() < 0.97 else (98, 99, 100, 199, 200)
        self._now_ns += random.choice(gaps_ms) * MS
        if random.random() < 0.01:
            self.gate.pause()
            self.bus.pause()
        # A stop lasts for some bursts, so that one can let go of the parking brake twice.
        self._is_stop ^= random.random() < 0.1
        raw, is_stop = self._next(), self._is_stop
        frames = self._frames(raw)
        if random.random() < (0.3 if self.bus.is_torn else 0.02):
            frames = [frames[0], frames[4], *frames[1:4], *frames[5:]]
        frames = self._spoilt(frames)
        if self._offer(frames, is_stop=is_stop):
            self._send(frames[: random.choice((1, 4, 5, 8, 8, 8, 8, 8))])
            return
        # A stop in place is always admitted, within the rate.
        twelfth_ns = max(times[0] if len(times) == 12 else -TICK_NS * 10 for times in self.bus.sent_ns.values())
        stop = self._frames(stop_in_place(self._raw))[:5]
        assert self._offer(stop, is_stop=True) or self._now_ns - twelfth_ns < 100 * MS

    def _offer(self, frames: list[Frame], *, is_stop: bool) -> bool:
        fault = self.gate.admit(frames, self.variant, self._now_ns, stopping=is_stop)
        admitted = self.bus.may_send(frames, BIT_UMPS[self.variant], self._now_ns, is_stop=is_stop)
        text = "" if fault is None else fault.detail
        self.faults[text] = self.faults.get(text, 0) + 1
        assert (fault is None) == admitted, (text, frames, self.bus.before, is_stop)
        return admitted

    def _send(self, frames: list[Frame]) -> None:
        self.gate.sent(frames, self._now_ns)
        self.bus.sent(frames, self._now_ns)
        if len(frames) >= 5:
            self._raw = read_raw(frames)

    def _next(self) -> Raw:
        random, raw = self._random, self._raw
        if random.random() < 0.1:
            return raw._replace(speed=raw.speed + random.randrange(3), pedal=0, parking=0)
        changes: dict[str, Callable[[], int]] = {
            "enables": lambda: random.choice((0, ALL, ALL, random.randrange(32))),
            "gear": lambda: random.choice((R, N, D, random.randrange(8))),
            "angle": lambda: max(0, min(4095, raw.angle + random.choice((-16, -15, 15, 16, -400, 400)))),
            "speed": lambda: max(0, raw.speed + random.choice((-raw.speed, -1, 1, 2, 16, 17, 700))),
            "pedal": lambda: random.choice((0, 1, 255)),
            "parking": lambda: random.randrange(2),
        }
        chosen = random.sample(sorted(changes), random.choice((0, 1, 1, 1, 2)))
        return raw._replace(**{name: changes[name]() for name in chosen})

    def _frames(self, raw: Raw) -> list[Frame]:
        counters = {identifier: (self.bus.counters.get(identifier, 15) + 1) % 16 for identifier in PICTURES}
        frames = make_frames(raw, [counters[identifier] for identifier in BURST])
        others = [identifier for identifier in PICTURES if identifier not in BURST]
        return frames + [_frame(each, ".", 0, 0, counters[each]) for each in others if self._random.random() < 0.1]

    def _spoilt(self, frames: list[Frame]) -> list[Frame]:
        """At times flip a bit; drop, double or replace a frame."""
        random, index = self._random, self._random.randrange(len(frames))
        frame = frames[index]
        word = int.from_bytes(frame.data, "little") ^ 1 << random.randrange(64)
        fixed = word & (1 << 56) - 1 | checksum(word) << 56
        spoilt = {
            0: [Frame(frame.can_id, word.to_bytes(8, "little"))],
            1: [Frame(frame.can_id, fixed.to_bytes(8, "little"))],
            2: [],
            3: [frame, frame],
            4: [Frame(frame.can_id ^ 1 << random.randrange(32), frame.data)],
            5: [Frame(frame.can_id, frame.data[:7])],
        }
        return [*frames[:index], *spoilt.get(random.randrange(60), [frame]), *frames[index + 1 :]]
