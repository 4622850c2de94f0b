"""The one thread, with a fake bus and a fake Zenoh."""

import gc
import logging
import time
from collections.abc import Callable

import pytest

from gateway.chassis.frame import Frame
from gateway.core import Core
from gateway.loop import BURST_MAX_FRAMES, PEERS_TICKS, run
from gateway.telemetry.sample import Sample
from schemas import codec
from schemas.messages import GatewayHealth, Message, RobotState, Variant
from schemas.settings import ChassisSettings, Settings
from schemas.subjects import BY_NAME
from tests.gateway.frames import Feedback
from tests.gateway.remote.waiting import StopWhen


class FakeBus:
    """A bus that is up or not, and holds frames."""

    def __init__(self, frames: list[Frame]) -> None:
        self.frames = frames
        self.is_up = True
        self.detail = ""
        self.losses = 0

    def receive(self, timeout_s: float) -> Frame | None:
        if self.frames and self.is_up:
            return self.frames.pop(0)
        time.sleep(timeout_s)
        return None


class FakeZenoh:
    """Keeps what is published; fails when told to."""

    def __init__(self) -> None:
        self.failures = 0
        self.samples: list[Sample] = []
        self.answered = 0
        self.connected = 3
        self.asked = 0

    def publish(self, sample: Sample) -> None:
        self.samples.append(sample)

    def peers(self) -> int:
        self.asked += 1
        return self.connected

    def answer(self, reply: Callable[[], bytes]) -> None:
        if reply() == b"info":
            self.answered += 1

    def of(self, subject: str) -> list[Message | codec.PayloadFault]:
        return [codec.decode(BY_NAME[subject], s.payload) for s in self.samples if s.subject == subject]


def core() -> Core:
    """A core of a known variant."""
    return Core(Settings(chassis=ChassisSettings(variant="coarse")), "0", time.monotonic_ns())


def test_frames_come_out_as_samples_and_ticks_go_on() -> None:
    """Every frame is published, state and health come by time, queries are answered each tick."""
    feedback = Feedback(Variant.COARSE)
    bus, zenoh = FakeBus([frame for _ in range(20) for frame in feedback.all()]), FakeZenoh()
    run(bus, zenoh, core(), lambda: b"info", lambda: bool(zenoh.of("gateway/health")))
    chassis = [sample for sample in zenoh.samples if sample.subject.startswith("chassis/")]
    assert len(chassis) == 200
    health = zenoh.of("gateway/health")[0]
    assert isinstance(health, GatewayHealth)
    assert (health.frames, health.zenoh_peers, health.bus_up) == (200, 3, True)
    assert zenoh.answered > 50
    assert len(zenoh.of("state")) > 10


def test_a_lost_bus_ends_nothing(caplog: pytest.LogCaptureFixture) -> None:
    """The ticks go on, the state says that the bus is down, the log says so once."""
    bus, zenoh = FakeBus([]), FakeZenoh()

    def stopped() -> bool:
        states = zenoh.of("state")
        if len(states) == 2 and bus.is_up:
            bus.is_up, bus.detail, bus.losses = False, "Network is down", 1
        return len(states) >= 6

    with caplog.at_level(logging.INFO):
        run(bus, zenoh, core(), lambda: b"", stopped)
    states = [state for state in zenoh.of("state") if isinstance(state, RobotState)]
    assert [state.bus_up for state in states[:2]] == [True, True]
    assert states[-1].bus_up is False
    assert [record.getMessage() for record in caplog.records] == [
        "the bus is up",
        "a Zenoh node is connected",
        "the bus is lost: Network is down; trying again",
    ]


def test_a_lost_zenoh_is_logged(caplog: pytest.LogCaptureFixture) -> None:
    """When the last node goes the log says so, once; the ticks go on."""
    zenoh = FakeZenoh()

    def go() -> None:
        zenoh.connected = 0 if zenoh.samples else 1

    asked_enough = StopWhen(lambda: zenoh.asked >= 4, go)
    with caplog.at_level(logging.INFO):
        run(FakeBus([]), zenoh, core(), lambda: b"", asked_enough)
    assert [record.getMessage() for record in caplog.records][1:] == [
        "a Zenoh node is connected",
        "no Zenoh node is connected any more",
    ]


def test_a_loop_that_stood_still_says_so(caplog: pytest.LogCaptureFixture) -> None:
    """A stall is in the log, and stays in health as the worst lateness since the start."""
    zenoh, stalls = FakeZenoh(), [0.12]

    class StallingBus(FakeBus):
        """Holds the loop once."""

        def receive(self, timeout_s: float) -> Frame | None:
            time.sleep(stalls.pop() if stalls else timeout_s)
            return None

    run(StallingBus([]), zenoh, core(), lambda: b"", lambda: len(zenoh.of("gateway/health")) == 2)
    assert any("ms late" in record.getMessage() for record in caplog.records)
    first, second = zenoh.of("gateway/health")
    assert isinstance(first, GatewayHealth)
    assert isinstance(second, GatewayHealth)
    assert first.tick_lateness_worst_ms > 100
    assert second.tick_lateness_worst_ms >= first.tick_lateness_worst_ms


def test_a_bus_that_is_never_empty_does_not_keep_the_tick_waiting() -> None:
    """Frames are taken a bounded number at a time, also where there is always one more."""
    frame = next(Feedback(Variant.COARSE).all())
    longest = 0

    class BusyBus(FakeBus):
        """Always has a frame; counts how many are taken one after the other without looking at the time."""

        taken = 0

        def receive(self, timeout_s: float) -> Frame | None:
            nonlocal longest
            self.taken = 1 if timeout_s else self.taken + 1
            longest = max(longest, self.taken)
            assert self.taken <= 100 * BURST_MAX_FRAMES, "the loop forgets its tick"
            return frame

    zenoh = FakeZenoh()
    run(BusyBus([]), zenoh, core(), lambda: b"info", StopWhen(lambda: zenoh.answered >= 3))
    assert longest == BURST_MAX_FRAMES


def test_zenoh_is_asked_who_is_there_in_every_tenth_tick() -> None:
    """The answer costs more than it changes; between two questions the last one holds."""
    zenoh = FakeZenoh()
    run(FakeBus([]), zenoh, core(), lambda: b"info", StopWhen(lambda: zenoh.answered == 3 * PEERS_TICKS))
    assert zenoh.asked == 3


def test_the_garbage_collector_is_given_back() -> None:
    """No collection runs in the loop, and everything is as before after it."""
    seen: list[bool] = []

    def stopped() -> bool:
        seen.append(gc.isenabled())
        return len(seen) > 2

    run(FakeBus([]), FakeZenoh(), core(), lambda: b"", stopped)
    assert not any(seen)
    assert gc.isenabled()
