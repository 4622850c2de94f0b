"""``cruiser halt``: looks first, and stops only what has to be stopped."""

import json
import signal
import subprocess
import time

import pytest

from gateway.host.notes import StopNote
from schemas.messages import Mode
from schemas.settings import Settings
from tests.support.nights import by_night
from tests.support.processes.gateway import Running, chassis, run
from tests.support.processes.guard import COMMANDS, listening, watched
from tests.support.processes.other_computer import leave_rolling
from tests.support.waiting import wait_until


def halt(address: str, *words: str) -> subprocess.CompletedProcess[str]:
    return run(["halt", "--interface", "socketcand", "--channel", address, *words])


@pytest.mark.parametrize("words", [(), by_night(("--variant", "coarse"))])
def test_a_robot_that_was_left_rolling_is_stopped(words: tuple[str, ...]) -> None:
    with chassis() as (_, address), listening(address) as listener:
        leave_rolling(address, listener)
        heard = len(listener.bursts)
        done = halt(address, "--json", *words)
        assert done.returncode == 0, done.stderr
        says = json.loads(done.stdout)
        assert says["ok"] is True
        assert says["outcome"] == f"the robot stands; {says['frames_sent']} frames sent"
        assert says["frames_sent"] > 100
        assert "mode auto, the robot is not seen to stand" in done.stderr
        assert "the robot stands; " in done.stderr
        note = StopNote.of(Settings()).read()
        assert " halt: sending the stop sequence; " in note, "a gateway that starts afterwards is latched"
        assert " halt: the robot stands; " in note
        wait_until(lambda: listener.stands() and listener.mode() is Mode.STOP)
        wait_until(lambda: len(listener.bursts) > heard + 30)
        # Of the driver's last burst the end may be lost, and the very last one may still be coming in.
        assert {len(burst.frames) for burst in listener.bursts[heard + 1 : -1]} == {5, 8}


def test_a_robot_at_rest_is_sent_nothing_unless_forced() -> None:
    with chassis() as (_, address), listening(address) as listener:
        done = halt(address)
        assert done.returncode == 0, done.stderr
        assert "mode stop, the robot stands" in done.stderr
        assert "nothing is sent" in done.stderr
        assert (listener.bursts, done.stdout) == ([], "")
        assert StopNote.of(Settings()).read() == ""
        done = halt(address, "--force")
        assert done.returncode == 0, done.stderr
        assert len(listener.bursts) > 30
        # It reads stop, and is not switched back to auto.
        assert not any(frame.data[0] & 1 for burst in listener.bursts for frame in burst.frames)


def test_the_hand_transmitter_is_never_sent_against() -> None:
    faults = ["--fault", "1ms transmitter remote", "--fault", "1ms sticks 0.5 0"]
    with chassis(*faults) as (_, address), listening(address) as listener:
        wait_until(lambda: listener.mode() is Mode.REMOTE)
        for words in ((), ("--force",)):
            done = halt(address, "--wait", "0.1", "--json", *words)
            assert done.returncode == 5, done.stderr
            outcome = "the remote control has the robot, so nothing is sent"
            assert json.loads(done.stdout) == {"ok": False, "outcome": outcome, "frames_sent": 0}
            assert "remote control" in done.stderr
        assert listener.bursts == []


def test_a_robot_that_the_hand_transmitter_gives_back_is_stopped() -> None:
    """Otherwise it would execute its last command again."""
    with chassis() as (_, address), listening(address) as listener:
        leave_rolling(address, listener)
        assert run(["fault", "--sim", address, "transmitter", "remote"]).returncode == 0
        wait_until(lambda: listener.mode() is Mode.REMOTE)
        with Running("halt", "--interface", "socketcand", "--channel", address, "--wait", "60") as halting:
            halting.wait_says("remote control has the robot: waiting")
            heard = len(listener.bursts)
            assert run(["fault", "--sim", address, "transmitter", "command"]).returncode == 0
            assert halting.process.wait(30) == 0, halting.said
            wait_until(lambda: len(listener.bursts) > heard + 30)
        wait_until(lambda: listener.stands() and listener.mode() is Mode.STOP)


def test_a_parked_robot_that_is_not_heard_stays_parked() -> None:
    with chassis("--fault", "1ms silence all") as (_, address), listening(address) as listener:
        done = halt(address)
        assert done.returncode == 1, done.stderr
        frames = [frame for burst in listener.bursts for frame in burst.frames]
        parking = [frame.data[1] & 1 for frame in frames if COMMANDS[frame.can_id] == "Auto_ParkingCmd"]
        assert len(parking) > 100
        assert all(parking)


def test_the_hand_transmitter_may_take_over_during_the_stop() -> None:
    with chassis() as (sim, address), listening(address) as listener:
        leave_rolling(address, listener)
        bus_words = ["--interface", "socketcand", "--channel", address, "--wait", "1"]
        with Running("halt", *bus_words) as halting:
            halting.wait_says("sending the stop sequence")
            assert run(["fault", "--sim", address, "transmitter", "remote"]).returncode == 0, sim.said
            assert halting.process.wait(30) == 5
            halting.wait_says("remote control")


def test_it_waits_for_a_guard_at_work() -> None:
    """As systemd starts it right after the gateway died."""
    bus_words = ["--interface", "socketcand", "--wait", "60", "--channel"]
    with watched() as running, Running("halt", *bus_words, running.address) as halting:
        halting.wait_says("another sender, perhaps the guard")
        running.send_signal(signal.SIGKILL)
        assert halting.process.wait(60) == 0, halting.said
        # Where frames come late, the chassis may read auto for a moment longer: then it stops what stands.
        halting.wait_says("nothing to stop|mode auto, the robot stands")
        running.wait_guard_gone()


def test_blindly_is_better_than_not_at_all() -> None:
    with chassis() as (_, address), listening(address) as listener:
        leave_rolling(address, listener)
        assert run(["fault", "--sim", address, "silence", "all"]).returncode == 0
        wait_until(lambda: not listener.view.has_feedback(time.monotonic_ns()))
        done = halt(address)
        assert done.returncode == 1, done.stderr
        assert "stopping without it" in done.stderr
        assert "not seen to stand" in done.stderr
        assert run(["fault", "--sim", address, "clear"]).returncode == 0
        wait_until(listener.stands)
