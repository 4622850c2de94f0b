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
        """Why they are refused; empty if they are admitted, and sent then. The first is a stop's unless said."""
        self.now_ns += 10 * MS
        stopping = self.now_ns == 10 * MS if stopping is None else stopping
        fault = self.gate.admit(frames, self.variant, self.now_ns, stopping=stopping)
        if fault is not None:
            return fault.detail
        self.gate.sent(frames, self.now_ns)
        self.maker.sent(frames)
        return ""


def test_out_of_silence_only_a_stop_begins_with_a_speed() -> None:
    """Row 'engage: five enables with zero speed'; and in a stop no speed rises, not by a bit."""
    bench = Bench()
    assert bench.offer(bench.burst(DRIVING), stopping=False) == "released out of silence"
    assert bench.offer(bench.burst(), stopping=False) == ""
    bench = Bench()
    assert bench.offer(bench.burst(DRIVING), stopping=True) == ""
    faster = msgspec.structs.replace(DRIVING, speed_mps=DRIVING.speed_mps + 0.04)
    assert bench.offer(bench.burst(faster), stopping=True) == "the speed rises too fast"
    assert bench.offer(bench.burst(DRIVING), stopping=True) == ""
    assert bench.offer(bench.burst(faster), stopping=False) == ""
    bench.gate.pause()
    assert bench.offer(bench.burst(faster), stopping=False) == "released out of silence"


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


def test_the_gear_changes_through_neutral_behind_the_parking_brake() -> None:
    """Row 'reversal of direction': a robot on a slope never stands in neutral unbraked."""
    bench = Bench()
    slow = msgspec.structs.replace(DRIVING, speed_mps=0.04)
    still = msgspec.structs.replace(DRIVING, speed_mps=0.0)
    parked = msgspec.structs.replace(still, parking=True)
    back = msgspec.structs.replace(parked, gear=GearPosition.REVERSE)
    away = msgspec.structs.replace(back, parking=False)
    for actuation, why in (
        (slow, ""),
        (REST, "the gear changes without the parking brake"),
        (parked, ""),
        (back, "the direction changes without neutral"),
        (away, "the gear changes without the parking brake"),
        (REST, ""),
        (away, "the gear changes without the parking brake"),
        (back, ""),
        (away, ""),
    ):
        assert bench.offer(bench.burst(actuation)) == why


def test_the_parking_brake_is_released_in_gear_at_zero_speed_and_not_in_a_stop() -> None:
    """Rows 'standing' and 'stop': the brake is released first, and the speed comes after."""
    bench = Bench()
    parked = msgspec.structs.replace(DRIVING, speed_mps=0.0, parking=True)
    slow = msgspec.structs.replace(DRIVING, speed_mps=0.04)
    released = msgspec.structs.replace(DRIVING, speed_mps=0.0)
    assert bench.offer(bench.burst(parked)) == ""
    assert bench.offer(bench.burst(slow)) == "the parking brake is released at speed"
    assert bench.offer(bench.burst(released), stopping=True) == "a stop releases the parking brake"
    assert bench.offer(bench.burst(released)) == ""
    assert bench.offer(bench.burst(slow)) == ""


def test_a_stop_after_an_engagement_releases_the_parking_brake_once() -> None:
    """Row 'a parking brake that reads applied and does not hold': back to the motor, in gear at zero speed."""
    bench = Bench()
    parked = msgspec.structs.replace(DRIVING, speed_mps=0.0, parking=True)
    released = msgspec.structs.replace(DRIVING, speed_mps=0.0)
    slow = msgspec.structs.replace(DRIVING, speed_mps=0.04)
    assert bench.offer(bench.burst(parked), stopping=False) == ""
    assert bench.offer(bench.burst(slow), stopping=True) == "the speed rises too fast"
    assert bench.offer(bench.burst(released), stopping=True) == ""
    assert bench.offer(bench.burst(parked), stopping=True) == ""
    assert bench.offer(bench.burst(released), stopping=True) == "a stop releases the parking brake"
    assert bench.offer(bench.burst(parked), stopping=False) == ""
    assert bench.offer(bench.burst(released), stopping=True) == ""


def test_a_torn_burst_may_be_followed_by_the_brake_first() -> None:
    """Row 'a burst of which the bus took only a part': at zero speed alone, and only then."""
    bench = Bench()
    slow = msgspec.structs.replace(DRIVING, speed_mps=0.04)

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
        assert (
            bench.offer(brake_first(slow), stopping=True) == "the parking frame comes second at zero speed alone"
        )
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
