"""The guard's thread, with a bus and a memory that have knobs."""

import threading

import pytest

from gateway.chassis.cruiser.gate import MOTION
from gateway.chassis.frame import Frame
from gateway.choice import CHASSIS
from gateway.guard.guardian import Guardian
from gateway.guard.stopper import Beat, GuardStatus
from gateway.host.guard_main import run
from schemas.messages import Mode, Variant
from schemas.settings import CommandSettings
from tests.support.frames import Feedback
from tests.support.rigs.guard import DRIVING


class World:
    """Bus and memory at once, so that their order shows. The parent dies when the first frames were received."""

    is_up = True

    def __init__(self, beat: Beat) -> None:
        self.beat = beat
        self.order: list[str] = []
        self.frames = list(Feedback(Variant.COARSE).all())
        self.sent: list[Frame] = []
        self.said: list[str] = []
        self._silence = threading.Event()

    def receive(self, timeout_s: float) -> Frame | None:
        """The next frame; a bus on which nothing comes keeps its reader waiting."""
        assert 0 <= timeout_s <= 0.005
        if self.frames:
            return self.frames.pop(0)
        self._silence.wait(timeout_s)
        return None

    def send(self, frames: list[Frame]) -> int:
        self.order.append("frames")
        self.sent += frames
        return len(frames)

    def read_beat(self) -> Beat:
        return self.beat

    def write_status(self, status: GuardStatus) -> None:
        """Remembers what was told, in its place."""
        self.order.append("sending" if status.is_sending else "watching")

    def parent_lives(self) -> bool:
        return bool(self.frames)

    def asked_to_end(self) -> bool:
        return False

    def say(self, line: str) -> None:
        self.said.append(line)
        if line.startswith("done"):
            self.order.append("done")


def live(world: World) -> Guardian:
    """Let the guard live on this bus to its end."""
    guardian = Guardian(CHASSIS, CommandSettings(deceleration_mps2=2, emergency_deceleration_mps2=3))
    run(world, world, guardian, world.parent_lives, world.asked_to_end, world.say)
    return guardian


def test_the_loop_is_told_before_the_first_frame_leaves_and_after_the_last() -> None:
    """A loop that comes back must not send beside the guard."""
    world = World(Beat(1, is_active=True, variant=Variant.COARSE, last=DRIVING))
    live(world)
    first = world.order.index("frames")
    assert world.order[first - 1] == "sending"
    assert set(world.order[: first - 1]) <= {"watching"}
    assert "frames" not in world.order[world.order.index("done") :]
    assert world.order[world.order.index("done") :].count("sending") == 0
    assert [frame.can_id for frame in world.sent[:5]] == list(MOTION)
    assert len(world.said) == 2


class Paused(World):
    """A world in which the guard's process stands still for a second, once, on a clock of its own."""

    def __init__(self) -> None:
        super().__init__(Beat(1))
        self.now_ns = 10**9
        self.looks = 0
        self.frames = []

    def monotonic_ns(self) -> int:
        """Time passes while it waits for frames, and in the pause."""
        return self.now_ns

    def receive(self, timeout_s: float) -> Frame | None:
        """The next frame, or so much time is over."""
        if self.frames:
            return self.frames.pop(0)
        self.now_ns += round(timeout_s * 1e9)
        return None

    def parent_lives(self) -> bool:
        """For ten looks; the pause is in the fifth."""
        self.looks += 1
        if self.looks == 5:
            self.now_ns += 10**9
            self.frames = list(Feedback(Variant.COARSE).all())
        return self.looks < 10


def test_what_came_while_the_guard_stood_still_is_not_believed(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is old, and would be taken for what the chassis says now."""
    world = Paused()
    monkeypatch.setattr("gateway.host.guard_main.time.monotonic_ns", world.monotonic_ns)
    guardian = live(world)
    assert world.frames == []
    assert not guardian.view.has_feedback(world.now_ns)


def test_frames_are_heard_and_an_idle_guard_leaves_without_a_word() -> None:
    """With its parent."""
    world = World(Beat(1))
    guardian = live(world)
    assert guardian.view.has_feedback(0)
    assert guardian.view.mode(0) is Mode.STOP
    assert world.sent == []
    assert world.said == []
