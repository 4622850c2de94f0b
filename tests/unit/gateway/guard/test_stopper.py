"""One stop sequence, by whoever runs it; what the guard makes of it is in test_guardian."""

from math import inf, nan

import msgspec
import pytest

from gateway.chassis.cruiser.frames import load
from gateway.chassis.cruiser.guard_view import ChassisView
from gateway.chassis.layout import Decoded, Encoder, FrameDecoder
from gateway.chassis.port import Actuation
from gateway.choice import CHASSIS
from gateway.guard.stopper import Stopper
from schemas.messages import GearPosition, Variant
from schemas.settings import TICK_NS, CommandSettings
from tests.support.frames import MS, Feedback

DRIVING = Actuation(enabled=True, gear=GearPosition.DRIVE, speed_mps=1.0, parking=False)


def begun(view: ChassisView, counters: bytes | None, now_ns: int = 0) -> Stopper:
    stopper = Stopper(CHASSIS, view, CommandSettings())
    stopper.begin(DRIVING, Variant.COARSE, counters, now_ns)
    return stopper


@pytest.mark.parametrize("nonsense", [nan, inf])
def test_what_is_not_a_number_counts_as_zero(nonsense: float) -> None:
    """Never as the furthest that is allowed."""
    stopper = Stopper(CHASSIS, ChassisView(), CommandSettings())
    last = msgspec.structs.replace(DRIVING, speed_mps=nonsense, angle_deg=nonsense)
    stopper.begin(last, Variant.COARSE, bytes(8), 0)
    decoder = FrameDecoder(load(Variant.COARSE))
    told = [decoder.decode(frame) for frame in stopper.tick(0)]
    assert isinstance(told[2], Decoded)
    assert isinstance(told[0], Decoded)
    assert told[2].signals["TargetAngle"] == pytest.approx(0, abs=0.05)
    assert told[0].signals["TargetVelocity"] == 0


def test_one_burst_a_tick() -> None:
    """However often it is asked; after a pause one, not those that were missed."""
    stopper = begun(ChassisView(), bytes(8))
    times_ns = [at_ns for at_ns in range(0, 10 * TICK_NS, TICK_NS // 5) if stopper.tick(at_ns)]
    assert times_ns == list(range(0, 10 * TICK_NS, TICK_NS))
    assert len([at_ns for at_ns in range(15 * TICK_NS, 17 * TICK_NS, TICK_NS // 5) if stopper.tick(at_ns)]) == 2


@pytest.mark.parametrize(
    ("known", "at_ms", "counters"),
    [
        pytest.param(None, 0, [9, 0, 0, 0, 0], id="without a heartbeat those heard, else 0"),
        pytest.param(7, 100, [9, 7, 7, 7, 7], id="heard a little ahead of the heartbeat's"),
        pytest.param(7, 300, [7, 7, 7, 7, 7], id="heard long ago, from another computer"),
        pytest.param(10, 0, [10, 10, 10, 10, 10], id="heard behind: repeated ones would be refused"),
    ],
)
def test_the_counters_go_on(known: int | None, at_ms: int, counters: list[int]) -> None:
    """From the heartbeat's, and what was heard since: a drive command with counter 8."""
    view, encoder = ChassisView(), Encoder(load(Variant.COARSE))
    view.receive(encoder.encode("Auto_DriveCmd", {}, 8), 0)
    frames = begun(view, None if known is None else bytes([known] * 8), at_ms * MS).tick(at_ms * MS)
    assert [frame.data[6] >> 4 for frame in frames[:5]] == counters


def test_it_yields_to_the_hand_transmitter_between_two_ticks() -> None:
    """At once, not when the next burst would be due."""
    view, feedback = ChassisView(), Feedback(Variant.COARSE)
    stopper = begun(view, bytes(8))
    assert stopper.tick(0)
    for at_ns in (1, 2):
        view.receive(feedback.frame("Auto_MileageAndBodyFeedback", {"Mode": "remote"}), at_ns)
    assert stopper.tick(3) == []
    assert stopper.is_paused
    assert not stopper.is_over
