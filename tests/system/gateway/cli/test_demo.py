"""``cruiser demo``, as a user starts it."""

import os
import signal
import subprocess
import time
from collections.abc import Sequence
from pathlib import Path

import pytest

from gateway.cli.demo import CRUISER
from tests.support.processes.gateway import children

TIMEOUT_S = 400  # on a busy machine a demo begins again and again
pytestmark = [pytest.mark.timeout(TIMEOUT_S), pytest.mark.long]


def assert_in_order(told: str, steps: Sequence[str]) -> None:
    place = 0
    for step in steps:
        place = told.find(step, place)
        assert place >= 0, (step, told)
        place += len(step)


HELD_UP_S = 0.5  # the guard stops a robot after a tenth of a second


@pytest.mark.night
def test_a_robot_that_the_guard_has_stopped_is_driven_on(tmp_path: Path) -> None:
    """As on a busy machine. The first lines come while the log is written, in the next free directory."""
    out = tmp_path / "log"
    out.mkdir()
    (out / "of-an-earlier-run").touch()
    words = [*CRUISER, "demo", "--seconds", "20", "--out", str(out)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        told = ""
        for line in process.stdout or ():
            told += line
            if "drives a figure of eight" in line:
                break
        assert not list((tmp_path / "log-2").glob("*.mcap"))
        commands = {one: Path(f"/proc/{one}/cmdline").read_text().split("\0") for one in children(process.pid)}
        [gateway] = (one for one, words in commands.items() if words[4] == "gateway")
        os.kill(gateway, signal.SIGSTOP)
        time.sleep(HELD_UP_S)
        os.kill(gateway, signal.SIGCONT)
        rest, errors = process.communicate(timeout=TIMEOUT_S)
    told += rest
    assert process.returncode == 0, errors
    assert "WARNING" not in errors
    steps = ["the guard has stopped the robot", "tries again", "reset: guard", "engaged: ", "figure of eight"]
    assert_in_order(told, [*steps, "second-operator gave the lease back", str(tmp_path / "log-2")])
    assert [path.name for path in out.iterdir()] == ["of-an-earlier-run"]
    assert len(list((tmp_path / "log-2").glob("*Z.mcap"))) == 1


@pytest.mark.usefixtures("beside_foreign_modules")
def test_ctrl_c_stops_the_robot_and_ends_the_demo(tmp_path: Path) -> None:
    words = [*CRUISER, "demo", "--out", str(tmp_path / "log")]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            for line in process.stdout or ():
                if "drives a figure of eight" in line:
                    break
            process.send_signal(signal.SIGINT)
            told, errors = process.communicate(timeout=20)
        finally:
            process.kill()
    assert process.returncode == 3, errors
    (log,) = (tmp_path / "log").glob("*.mcap")
    assert f"cruiser demo: interrupted. The log: {log}" in errors
    assert_in_order(told, ["first-operator gave the lease back", "stopped"])
    assert "bumper" not in told
