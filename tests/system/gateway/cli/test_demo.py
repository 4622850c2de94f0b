"""``cruiser demo``, as a user starts it."""

import os
import re
import signal
import subprocess
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from gateway.cli.demo import CRUISER
from tests.support.processes.gateway import children, run

TIMEOUT_S = 400  # on a busy machine a demo begins again and again
pytestmark = [pytest.mark.timeout(TIMEOUT_S), pytest.mark.long]


def assert_in_order(told: str, steps: Sequence[str]) -> None:
    place = 0
    for step in steps:
        place = told.find(step, place)
        assert place >= 0, (step, told)
        place += len(step)


class Demo(NamedTuple):
    """A demo of a robot with its own name and variant."""

    told: str
    directory: Path

    @property
    def log(self) -> Path:
        [path] = re.findall("^log: (.+)$", self.told, re.MULTILINE)
        return Path(path)

    def states(self) -> list[Any]:
        with self.log.open("rb") as stream:
            reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
            return [message for _, _, _, message in reader.iter_decoded_messages(topics=["yard/r-7/state"])]


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Demo:
    """One demo for all these tests, because it takes its time."""
    directory = tmp_path_factory.mktemp("demo")
    file, out = directory / "robot.toml", directory / "log"
    file.write_text(
        '[robot]\nroot = "yard"\nname = "r-7"\n[can]\nbus = "can7"\n[chassis]\nvariant = "fine"\n'
        '[sim]\nvariant = "fine"\n[recorder]\nchunk_bytes = 2048\n'
    )
    done = run(["demo", "--config", str(file), "--seconds", "20", "--out", str(out)], TIMEOUT_S)
    assert done.returncode == 0, (done.stdout, done.stderr)
    return Demo(done.stdout, out)


@pytest.mark.night
def test_the_demo_tells_and_records_what_the_arbiter_did(demo: Demo) -> None:
    steps = (
        "first-operator has acquired the lease",
        "engaged",
        "stopping: the front bumper was hit",
        "reset: front_bumper",
        "engaged",
        "stopping: no valid drive command arrived in time",
        "second-operator has acquired the lease",
        "engaged",
        "stopping: the holder of the lease disengaged",
        "stopped",
    )
    assert_in_order(demo.told, steps)
    [incident] = demo.directory.glob("*.incident.mcap")
    assert {*demo.directory.iterdir()} == {demo.log, incident}
    states = demo.states()
    assert max(state.speed_mps for state in states if state.HasField("speed_mps")) > 0.5
    assert any(state.front_bumper for state in states)
    # Chassis, gateway and recorder read the demo's --config. The other variant would be evidence against it.
    variants = states[0].DESCRIPTOR.fields_by_name["variant"].enum_type.values_by_number
    assert {variants[state.variant].name for state in states} == {"VARIANT_FINE"}
    with demo.log.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    topics = {channel.topic for channel in summary.channels.values()}
    assert {"yard/r-7/can/can7/rx", "yard/r-7/can/can7/tx"} <= topics
    assert len(summary.chunk_indexes) > 10


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
