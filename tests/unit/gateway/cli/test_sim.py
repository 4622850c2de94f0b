"""``cruiser sim``: its run."""

from collections.abc import Callable, Iterable

from gateway.chassis.frame import ERROR, Frame
from gateway.choice.chassis import CHASSIS
from gateway.cli.sim import CanBusLink, Inject, SimClock, SimSummary, live
from gateway.sim.model import VirtualChassis
from schemas.messages import Variant
from tests.support.rigs.chassis import MS, S

WALL_NS = 1_700_000_000 * S


class FakeClock(SimClock):
    """Stands still until a wait; each wait takes ``late_ns`` longer."""

    def __init__(self) -> None:
        self.now_ns = 0
        self.late_ns = 0
        self.waits_ns: list[int] = []

    def monotonic_ns(self) -> int:
        return self.now_ns

    def wall_ns(self) -> int:
        return WALL_NS + self.now_ns

    def wait(self, timeout_s: float) -> None:
        self.waits_ns.append(round(timeout_s * S))
        self.now_ns += round(timeout_s * S) + self.late_ns


class FakeLink:
    def __init__(self, clock: FakeClock) -> None:
        self._clock = clock
        self.incoming: list[Frame] = []
        self.sent: list[tuple[int, Frame]] = []

    def wait(self, timeout_s: float) -> None:
        self._clock.wait(timeout_s)

    def read(self, now_ns: int, wall_ns: int, _inject: Inject) -> list[Frame]:
        assert wall_ns == WALL_NS + self._clock.now_ns
        assert now_ns <= self._clock.now_ns
        frames, self.incoming = self.incoming, []
        return frames

    def send(self, frames: Iterable[Frame], now_ns: int) -> None:
        self.sent += [(now_ns, frame) for frame in frames]


class Bench:
    def __init__(self) -> None:
        self.clock = FakeClock()
        self.link = FakeLink(self.clock)
        self.chassis = VirtualChassis(CHASSIS, Variant.COARSE, 0)

    def run(self, seconds: float | None = None, stopped: Callable[[], bool] = lambda: False) -> SimSummary:
        return live(self.chassis, self.link, stopped, self.clock, seconds)


def test_it_wakes_exactly_when_a_frame_is_due() -> None:
    bench = Bench()
    summary = bench.run(seconds=1)
    assert bench.clock.waits_ns == [10 * MS] * 100
    assert summary.sent == len(bench.link.sent) == 630
    assert all(frame.wall_ns == WALL_NS + now_ns for now_ns, frame in bench.link.sent)


def test_waking_late_loses_nothing_and_does_not_add_up() -> None:
    bench = Bench()
    bench.clock.late_ns = 3 * MS
    assert bench.run(seconds=10).sent == 6300
    assert bench.clock.now_ns < 10 * S + 14 * MS


def test_a_stopped_process_does_not_flood_the_bus() -> None:
    bench = Bench()
    wakes = 0

    def stall() -> bool:
        nonlocal wakes
        wakes += 1
        bench.clock.late_ns = 60 * S if wakes == 20 else 0
        return False

    summary = bench.run(seconds=1, stopped=stall)
    assert summary.sent == 630
    assert summary.stalled_ns == 60 * S
    times = [now_ns for now_ns, _ in bench.link.sent]
    assert max(map(times.count, times)) == 10


class FakeBus:
    def __init__(self, *frames: Frame) -> None:
        self.frames = list(frames)
        self.drops = 0
        self.sent: list[Frame] = []

    def receive(self, _timeout_s: float) -> Frame | None:
        return self.frames.pop(0) if self.frames else None

    def send(self, frame: Frame) -> None:
        self.sent.append(frame)

    def close(self) -> None:
        pass


def test_a_flooded_can_bus_leaves_the_chassis_its_turn() -> None:
    bus = FakeBus(*[Frame(0x123, b"")] * 1000)
    link = CanBusLink(bus)
    link.wait(0.01)
    first = len(link.read(0, 0, lambda _text: ""))
    assert 0 < first < 1000
    assert first + len(bus.frames) == 1000


def test_error_frames_are_not_for_a_real_bus() -> None:
    bus = FakeBus()
    CanBusLink(bus).send([Frame(1, b""), Frame(4 | ERROR, bytes(8)), Frame(2, b"")], 0)
    assert [frame.can_id for frame in bus.sent] == [1, 2]
