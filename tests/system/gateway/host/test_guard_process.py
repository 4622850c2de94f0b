"""The guard as a process on a served bus, with a gateway that is killed, stopped or hangs; its memory."""

import errno
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

import pytest

from gateway.chassis.cruiser.bursts import FrameMaker
from gateway.chassis.port import AT_REST, Actuation
from gateway.guard.stopper import Beat, Cause, StopOutcome
from gateway.host.guard_main import Heartbeat
from gateway.host.guard_process import GuardProcess, NoGuard, start_guard
from gateway.host.notes import StopNote
from schemas.messages import Mode, Variant
from schemas.settings import GUARD_HANGS_TICKS, GUARD_RESTART_NS, CanSettings, Settings
from tests.support.processes.gateway import chassis
from tests.support.processes.guard import Watched, watched
from tests.support.waiting import wait_until

FIVE = ["Auto_DriveCmd", "Auto_GearCmd", "Auto_SteeringCmd", "Auto_BrakingCmd", "Auto_ParkingCmd"]
Found = TypeVar("Found")

OFF = ["Auto_LightCmd", "Auto_SpeakerCmd", "Auto_OdometerCmd"]


def wait_stopped(running: Watched) -> None:
    wait_until(lambda: running.listener.stands() and running.listener.mode() is Mode.STOP)


def unless_unseen(attempt: Callable[[], Found], is_unseen: Callable[[Found], bool]) -> Found:
    """Try up to three times: on a busy computer the guard may get its feedback too late to see the standstill."""
    found = attempt()
    for _ in range(2):
        found = attempt() if is_unseen(found) else found
    return found


def test_a_killed_gateway_is_stopped_for() -> None:
    said = unless_unseen(said_after_a_kill, lambda said: "the robot is not seen to stand" in said)
    assert f"guard: {Cause.GONE.value}" in said
    assert "guard: done: the robot stands" in said
    note = StopNote.of(Settings()).read()
    assert f" guard: {Cause.GONE.value}" in note, "and the next gateway is latched by what it says"
    assert " guard: done: the robot stands" in note


def said_after_a_kill() -> str:
    """Kill a gateway. Returns the guard's output."""
    with watched() as running:
        running.send_signal(signal.SIGKILL)
        wait_stopped(running)
        running.wait_guard_gone()
        bursts = running.listener.bursts
        by_guard = running.listener.by_guard()
        assert len(by_guard) > 100
        # Nobody sent after the guard, and nobody between.
        assert bursts[-len(by_guard) :][0].is_by_guard
        # The kill may have come between two frames of a burst.
        assert all(burst.names in (FIVE, FIVE + OFF) for burst in by_guard[1:])
        for place in range(len(FIVE)):
            counters = [burst.frames[place].data[6] >> 4 for burst in bursts if len(burst.frames) > place]
            assert all((after - before) % 16 == 1 for before, after in pairwise(counters))
        return "".join(running.complaints)


def test_a_stopped_gateway_that_comes_back_keeps_silent_and_learns_of_the_stop() -> None:
    assert unless_unseen(end_after_a_pause, lambda end: end is StopOutcome.UNSEEN) is StopOutcome.STANDS


def end_after_a_pause() -> StopOutcome:
    """Stop a gateway, and let it continue while the guard sends. Returns the outcome that it sees."""
    with watched() as running:
        running.send_signal(signal.SIGSTOP)
        wait_until(lambda: len(running.listener.by_guard()) > 20)
        by_gateway = [burst for burst in running.listener.bursts if not burst.is_by_guard]
        running.send_signal(signal.SIGCONT)
        running.wait_says("sending True")
        wait_stopped(running)
        running.wait_says("stops 1")
        running.wait_says("sending False")
        running.wait_says(f"cause {Cause.LATE.value}")
        running.wait_says(f"says {Cause.LATE.value}")
        ends = {f"says {Cause.LATE.value}; {end.value}": end for end in (StopOutcome.STANDS, StopOutcome.UNSEEN)}
        wait_until(lambda: not ends.keys().isdisjoint(running.said))
        # What was under way when it was stopped may have gone out; after that there is nothing of the gateway's.
        after = [burst for burst in running.listener.bursts if not burst.is_by_guard][len(by_gateway) :]
        assert len(after) <= 1
        assert running.guard_lives()
        running.send_signal(signal.SIGTERM)
        running.process.wait(30)
        running.wait_guard_gone()
        return next(ends[line] for line in running.said if line in ends)


def test_nothing_is_sent_while_the_loop_lives_and_signals_do_not_end_the_guard() -> None:
    with watched() as running:
        for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
            os.kill(running.guard, number)
        count = len(running.listener.bursts)
        wait_until(lambda: len(running.listener.bursts) > count + 50)
        assert running.guard_lives()
        assert os.getsid(running.guard) != os.getsid(0)
        running.send_signal(signal.SIGUSR2)
        count = -1

        def is_silent() -> bool:
            nonlocal count
            before, count = count, len(running.listener.bursts)
            time.sleep(0.1)
            return before == count

        wait_until(is_silent)
        running.send_signal(signal.SIGTERM)
        running.process.wait(30)
        running.wait_guard_gone()
        wait_until(lambda: bool(running._values("late_ms")))
        # On a machine that held up the stand-in itself the guard is right to act.
        if running.late_ms < 80:
            assert running.listener.by_guard() == []
            assert running.complaints == []


def test_the_guard_has_a_bus_of_its_own_and_nothing_of_the_gateway() -> None:
    with watched() as running:

        def sockets(process: int) -> set[str]:
            links = [str(link.readlink()) for link in Path(f"/proc/{process}/fd").iterdir()]
            return {link for link in links if link.startswith("socket:")}

        assert len(sockets(running.guard)) == 1
        assert sockets(running.guard) & sockets(running.process.pid) == set()
        maps = Path(f"/proc/{running.guard}/maps").read_text(encoding="utf-8")
        assert "zenoh" not in maps
        assert "cruiser-heartbeat" in maps


def test_a_guard_whose_gateway_never_beat_leaves_with_it() -> None:
    with chassis() as (_, address):
        link = start_guard(Settings(can=CanSettings(interface="socketcand", channel=address)))
        assert isinstance(link, GuardProcess)
        assert link.why_not == ""
        assert not link.look().is_watching
        wait_until(lambda: link.look().is_watching)
        assert not link.look().is_sending
        link.close()
        assert link._process.returncode == 0


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_guard_that_is_gone_or_hangs_is_replaced_while_the_robot_is_told_nothing(number: signal.Signals) -> None:
    with chassis() as (_, address):
        link = start_guard(Settings(can=CanSettings(interface="socketcand", channel=address)))
        assert isinstance(link, GuardProcess)
        maker = FrameMaker()

        def tell(later_ns: int, actuation: Actuation | None = None) -> None:
            now_ns = time.monotonic_ns() + later_ns
            link.tell(now_ns, Variant.COARSE, actuation, maker.counters, told_ns=now_ns)

        try:
            wait_until(lambda: link.look().is_watching, lambda: tell(0))
            first = link.pid
            # Told something, and no beat after: it begins a stop.
            tell(0, AT_REST)
            wait_until(lambda: link.look().stops == 1)
            os.kill(first, number)
            wait_until(lambda: not link.look().is_watching)
            for _ in range(GUARD_HANGS_TICKS):
                tell(GUARD_RESTART_NS // 2)
            assert link._starting is None
            tell(2 * GUARD_RESTART_NS, AT_REST)
            tell(2 * GUARD_RESTART_NS)
            assert link._starting is None
            assert link.look().stops == 1
            wait_until(lambda: link.pid != first, lambda: tell(2 * GUARD_RESTART_NS))
            assert not Path(f"/proc/{first}").exists()
            # That it begins within a beat from the future is this test's doing.
            wait_until(lambda: link.look().is_watching, lambda: tell(0))
            assert link.look().stops == 1
        finally:
            link.close()
        assert link._process.returncode == 0


@pytest.mark.parametrize(
    ("program", "why"), [("/bin/false", "ended at once, with exit code 1"), ("/nonexistent", "cannot be started")]
)
def test_a_guard_that_does_not_start_is_no_guard(monkeypatch: pytest.MonkeyPatch, program: str, why: str) -> None:
    class Ended(subprocess.Popen[bytes]):
        def __init__(self, *words: Any, **options: Any) -> None:  # noqa: ANN401 - what Popen takes
            super().__init__(*words, **options)
            self.wait()

    monkeypatch.setattr(sys, "executable", program)
    monkeypatch.setattr(subprocess, "Popen", Ended)
    link = start_guard(Settings())
    assert isinstance(link, NoGuard)
    assert why in link.why_not


@pytest.fixture
def heartbeat() -> Iterator[Heartbeat]:
    memory = Heartbeat.create()
    yield memory
    memory.close()


RESIZE = "import os, sys; os.truncate(sys.argv[1], int(sys.argv[2]))"


@pytest.mark.parametrize("size", [0, 1, 1 << 20])
def test_no_other_process_can_resize_it(heartbeat: Heartbeat, size: int) -> None:
    theirs = Heartbeat(os.dup(heartbeat.descriptor))
    before = os.fstat(heartbeat.descriptor).st_size
    path = f"/proc/{os.getpid()}/fd/{heartbeat.descriptor}"
    attacker = subprocess.run(
        [sys.executable, "-c", RESIZE, path, str(size)], capture_output=True, text=True, check=False
    )
    # Looked at first: were it resized, touching the memory would end this process.
    assert os.fstat(heartbeat.descriptor).st_size == before
    assert f"[Errno {errno.EPERM}]" in attacker.stderr
    heartbeat.write_beat(Beat(1))
    assert theirs.read_beat() == Beat(1)
    theirs.close()
