"""The last gate before the bus: default deny."""

import msgspec
import pytest

from gateway.chassis.cruiser import gate as gate_module
from gateway.chassis.cruiser.bursts import FrameMaker
from gateway.chassis.cruiser.frames import load
from gateway.chassis.cruiser.gate import BRAKE_FIRST, MOTION, USED_BITS, Gate
from gateway.chassis.frame import FD, Frame
from gateway.chassis.port import Actuation, AuxiliaryFrame
from schemas.messages import GearPosition, Variant
from tests.support.strategies import with_checksum

MS = 1_000_000
REST = Actuation(enabled=True)
DRIVING = Actuation(True, GearPosition.DRIVE, 1.0, 0.0, parking=False)  # noqa: FBT003
SLOW = msgspec.structs.replace(DRIVING, speed_mps=0.04)
EXTRAS = [
    AuxiliaryFrame("Auto_LightCmd", {"Headlamp": True, "LeftIndicator": True, "RightIndicator": True}),
    AuxiliaryFrame("Auto_SpeakerCmd", {"Horn": True}),
    AuxiliaryFrame("Auto_OdometerCmd", {"Enable": True, "ClearMileage": True}),
]


class Bench:
    """A gate and a maker of frames; what is admitted is sent."""

    def __init__(self, variant: Variant = Variant.COARSE) -> None:
        self.gate = Gate()
        self.maker = FrameMaker()
        self.variant = variant
        self.now_ns = 0

    def burst(self, actuation: Actuation = REST, extras: list[AuxiliaryFrame] | None = None) -> list[Frame]:
        known = self.variant if self.variant is not Variant.UNKNOWN else Variant.COARSE
        return self.maker.make(actuation, extras or [], known)

    def offer(self, frames: list[Frame], *, stopping: bool | None = None) -> str:
        """Why they are refused; empty if they are admitted and sent. By default only the first is a stop's."""
        self.now_ns += 10 * MS
        stopping = self.now_ns == 10 * MS if stopping is None else stopping
        fault = self.gate.admit(frames, self.variant, self.now_ns, stopping=stopping)
        if fault is not None:
            return fault.detail
        self.gate.sent(frames, self.now_ns)
        self.maker.sent(frames)
        return ""


def test_the_table_is_that_of_the_dbc() -> None:
    """Written by hand from the manual, and held against the other source of the same facts."""
    used = {}
    for message in load(Variant.COARSE).commands:
        bits = 0
        for signal in message.signals:
            if signal.name != "Checksum":
                bits |= ((1 << signal.length) - 1) << signal.start_bit
        used[message.can_id] = bits & (1 << 56) - 1
    assert used == USED_BITS


@pytest.mark.parametrize("length", range(65))
def test_every_length_but_eight_is_refused(length: int) -> None:
    """For each of the eight identifiers; and eight bytes that are no classic data frame's."""
    bench = Bench()
    frames = bench.burst(REST, EXTRAS)
    for index, frame in enumerate(frames):
        data = (frame.data * 9)[:length]
        for wrong in ({}, {"fd_flags": FD}, {"remote_length": 8}):
            changed = msgspec.structs.replace(frame, data=data, **wrong)
            fault = bench.gate.admit([*frames[:index], changed, *frames[index + 1 :]], Variant.COARSE, 0)
            assert (fault is None) is (length == 8 and not wrong)


def test_a_burst_is_whole_and_in_order() -> None:
    """Less, more, twice, or in another order: nothing of it goes out."""
    bench = Bench()
    frames = bench.burst(REST, EXTRAS)
    for wrong in ([], frames[:4], frames[1:], [*frames[1::-1], *frames[2:]], [*frames[5:], *frames[:5]]):
        assert bench.offer(wrong) == "a burst begins with the five motion frames"
    for wrong in ([*frames, frames[0]], [*frames[:5], frames[4]]):
        assert bench.offer(wrong) == "too many frames, or one twice"
    assert bench.offer(frames) == ""


def test_each_combination_of_enables() -> None:
    """Row 'engage: then five enables': all or none; 30 of 32 are refused."""
    bench = Bench()
    frames = bench.burst()
    for mask in range(32):
        offered = [
            Frame(frame.can_id, with_checksum(bytes([mask >> index & 1]) + frame.data[1:]))
            for index, frame in enumerate(frames)
        ]
        fault = bench.gate.admit(offered, Variant.COARSE, 0)
        assert (fault is None) is (mask in {0, 31})


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({}, ""),
        ({"enabled": False}, "a gear without the enables"),
        ({"enabled": False, "speed_mps": 0.0}, "a gear without the enables"),
        ({"enabled": False, "gear": GearPosition.NEUTRAL}, "neutral without the parking brake"),
        ({"gear": GearPosition.NEUTRAL}, "neutral without the parking brake"),
        ({"gear": GearPosition.NEUTRAL, "speed_mps": 0.0}, "neutral without the parking brake"),
        ({"gear": GearPosition.NEUTRAL, "parking": True}, "a speed against the parking brake"),
        ({"parking": True}, "a speed against the parking brake"),
    ],
)
def test_what_contradicts_itself_is_refused(changes: dict[str, object], why: str) -> None:
    """The five frames are judged together."""
    bench = Bench()
    assert bench.offer(bench.burst(msgspec.structs.replace(DRIVING, **changes))) == why


replace = msgspec.structs.replace
BURSTS = {
    "rest": REST,
    "drive": DRIVING,
    "faster": replace(DRIVING, speed_mps=DRIVING.speed_mps + 0.04),
    "slow": SLOW,
    "still": replace(SLOW, speed_mps=0.0),
    "parked": replace(SLOW, speed_mps=0.0, parking=True),
    "back parked": replace(SLOW, speed_mps=0.0, parking=True, gear=GearPosition.REVERSE),
    "back": replace(SLOW, speed_mps=0.0, gear=GearPosition.REVERSE),
}
SILENT, FAST = "released out of silence", "the speed rises too fast"
UNBRAKED, AT_ONCE = "the gear changes without the parking brake", "the direction changes without neutral"
RELEASED, AT_SPEED = "a stop releases the parking brake", "the parking brake is released at speed"
STEPS: dict[str, list[str]] = {
    "row 'engage: five enables with zero speed': out of silence": [f"drive: {SILENT}", "rest:"],
    "a stop may begin with a speed, which does not rise by a bit": [
        *("stop drive:", f"stop faster: {FAST}", "stop drive:", "faster:", "pause:", f"faster: {SILENT}"),
    ],
    "row 'reversal of direction': a robot on a slope never stands in neutral unbraked": [
        *("stop slow:", f"rest: {UNBRAKED}", "parked:", f"back parked: {AT_ONCE}", f"back: {UNBRAKED}", "rest:"),
        *(f"back: {UNBRAKED}", "back parked:", "back:"),
    ],
    "rows 'standing' and 'stop': the brake is released first, in no stop, and the speed comes after": [
        *("stop parked:", f"slow: {AT_SPEED}", f"stop still: {RELEASED}", "still:", "slow:"),
    ],
    "row 'a parking brake that reads applied and does not hold': once after an engagement": [
        *("parked:", f"stop slow: {FAST}", "stop still:", "stop parked:", f"stop still: {RELEASED}"),
        *("parked:", "stop still:"),
    ],
}


@pytest.mark.parametrize("steps", STEPS.values(), ids=STEPS)
def test_what_may_follow_what(steps: list[str]) -> None:
    """Bursts in a row, of a stop or not, and why one is refused."""
    bench = Bench()
    for step in steps:
        words, _, why = step.partition(":")
        if words == "pause":
            bench.gate.pause()
            continue
        burst = bench.burst(BURSTS[words.removeprefix("stop ")])
        assert bench.offer(burst, stopping=words.startswith("stop ")) == why.strip(), step


def test_a_torn_burst_may_be_followed_by_the_brake_first() -> None:
    """Row 'a burst of which the bus took only a part': at zero speed alone, and only then."""
    bench = Bench()

    def brake_first(actuation: Actuation) -> list[Frame]:
        by_id = {frame.can_id: frame for frame in bench.burst(actuation)}
        return [by_id[can_id] for can_id in BRAKE_FIRST]

    assert bench.offer(brake_first(REST)) == "a burst begins with the five motion frames"
    assert bench.offer(bench.burst(REST)) == ""
    for taken in (1, 4):
        torn = bench.burst(REST)[:taken]
        bench.gate.sent(torn, bench.now_ns)
        bench.maker.sent(torn)
        assert [frame.can_id for frame in bench.burst(REST)[:5]] == list(BRAKE_FIRST)
        at_speed = bench.offer(brake_first(SLOW), stopping=True)
        assert at_speed == "the parking frame comes second at zero speed alone"
        assert bench.offer(brake_first(REST)) == ""
        assert [frame.can_id for frame in bench.burst(REST)[:5]] == list(MOTION)
        assert bench.offer(brake_first(REST)) == "a burst begins with the five motion frames"


def test_the_rate_of_each_frame_is_bounded() -> None:
    """Twelve in 100 ms; the thirteenth is refused until the first is 100 ms old."""
    bench = Bench()
    for _ in range(12):
        bench.now_ns -= 9 * MS
        assert bench.offer(bench.burst()) == ""
    bench.now_ns = MS + gate_module.RATE_WINDOW_NS - 1 - 10 * MS
    assert bench.offer(bench.burst()) == "too many frames of this identifier"
    bench.now_ns = MS + gate_module.RATE_WINDOW_NS - 10 * MS
    assert bench.offer(bench.burst()) == ""
