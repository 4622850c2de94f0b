"""The guard's loop, with a fake bus and memory; the heartbeat in shared memory."""

import os
import threading
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.chassis.cruiser.gate import MOTION
from gateway.chassis.frame import Frame
from gateway.chassis.port import Actuation
from gateway.choice.chassis import CHASSIS
from gateway.guard.guardian import Guardian
from gateway.guard.stopper import Beat, GuardStatus
from gateway.host.guard_main import Heartbeat, run
from schemas.messages import Variant
from schemas.settings import CommandSettings
from tests.support.frames import Feedback
from tests.support.rigs.guard import DRIVING


class World:
    """Bus and memory in one, to record their order. The parent dies once the first frames are received."""

    is_up = True

    def __init__(self, beat: Beat) -> None:
        self.beat = beat
        self.order: list[str] = []
        self.frames = list(Feedback(Variant.COARSE).all())
        self.sent: list[Frame] = []
        self.said: list[str] = []
        self._silence = threading.Event()

    def receive(self, timeout_s: float) -> Frame | None:
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
    guardian = Guardian(CHASSIS, CommandSettings(deceleration_mps2=2, emergency_deceleration_mps2=3))
    run(world, world, guardian, world.parent_lives, world.asked_to_end, world.say)
    return guardian


def test_the_loop_is_told_before_the_first_frame_leaves_and_after_the_last() -> None:
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
    """A world with its own clock, in which the guard's process is paused once, for a second."""

    def __init__(self) -> None:
        super().__init__(Beat(1))
        self.now_ns = 10**9
        self.looks = 0
        self.frames = []

    def monotonic_ns(self) -> int:
        return self.now_ns

    def receive(self, timeout_s: float) -> Frame | None:
        if self.frames:
            return self.frames.pop(0)
        self.now_ns += round(timeout_s * 1e9)
        return None

    def parent_lives(self) -> bool:
        """For ten looks, with the pause in the fifth."""
        self.looks += 1
        if self.looks == 5:
            self.now_ns += 10**9
            self.frames = list(Feedback(Variant.COARSE).all())
        return self.looks < 10


def test_what_came_while_the_guard_stood_still_is_not_believed(monkeypatch: pytest.MonkeyPatch) -> None:
    world = Paused()
    monkeypatch.setattr("gateway.host.guard_main.time.monotonic_ns", world.monotonic_ns)
    guardian = live(world)
    assert world.frames == []
    assert not guardian.view.has_feedback(world.now_ns)


TIMES_NS = st.integers(0, 2**62)
FINITE = st.floats(allow_nan=False)
LAST = st.builds(Actuation, enabled=..., gear=..., speed_mps=FINITE, angle_deg=FINITE, parking=...)
BEATS = st.builds(
    Beat,
    now_ns=TIMES_NS,
    is_active=...,
    is_mute=...,
    is_closing=...,
    variant=...,
    last=LAST,
    counters=st.binary(min_size=8, max_size=8),
)
STATUSES = st.builds(
    GuardStatus, now_ns=TIMES_NS, is_ready=..., is_sending=..., stops=TIMES_NS, cause=..., outcome=...
)


@pytest.fixture
def heartbeat() -> Iterator[Heartbeat]:
    memory = Heartbeat.create()
    yield memory
    memory.close()


def test_fresh_memory_holds_nothing(heartbeat: Heartbeat) -> None:
    assert heartbeat.read_beat() is None
    assert heartbeat.read_status() is None


@given(st.lists(st.one_of(BEATS, STATUSES), min_size=1, max_size=8))
def test_the_other_side_reads_the_newest_of_each(values: list[Beat | GuardStatus]) -> None:
    mine = Heartbeat.create()
    theirs = Heartbeat(os.dup(mine.descriptor))
    beat, status = None, None
    for value in values:
        if isinstance(value, Beat):
            beat = value
            mine.write_beat(value)
        else:
            status = value
            theirs.write_status(value)
        assert theirs.read_beat() == beat
        assert mine.read_status() == status
    mine.close()
    theirs.close()


@given(st.lists(BEATS, min_size=2, max_size=4, unique_by=lambda beat: beat.now_ns), st.data())
def test_a_torn_beat_is_never_believed(beats: list[Beat], data: st.DataObject) -> None:
    memory = Heartbeat.create()
    for beat in beats[:-1]:
        memory.write_beat(beat)
    before = memory._memory[:]
    memory.write_beat(beats[-1])
    after = memory._memory[:]
    changed = [at for at in range(len(after)) if before[at] != after[at]]
    arrived = data.draw(st.sets(st.sampled_from(changed)))
    memory._memory[:] = bytes(after[at] if at in arrived else before[at] for at in range(len(after)))
    seen = memory.read_beat()
    assert seen == (beats[-1] if arrived == set(changed) else beats[-2])
    memory.close()
