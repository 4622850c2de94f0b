"""Python programs of docs/examples and docs/commands.md against a robot; the notebook over a dataset."""

import json
import os
import re
import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from schemas.decisions import ArbiterState
from tests.support.commands import review
from tests.support.fakes.robot import FakeRobot
from tests.support.processes.tcp_link import TcpLink
from tests.support.rigs.recorded import RecordedRig
from tests.support.waiting import wait_until

EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"
TESTED = {"commands_client.py", "dataset.ipynb", "drive.py", "subscribe.py"}
# Settings of a program for a robot at another endpoint.
ELSEWHERE = """\
from schemas.settings import Settings, ZenohSettings
SETTINGS = Settings(zenoh=ZenohSettings(connect=["{endpoint}"]))
"""


DEFAULT = "tcp/127.0.0.1:7447"


def program(name: str) -> str:
    if name != "commands.md":
        return (EXAMPLES / name).read_text("utf-8")
    section = (
        (EXAMPLES.parent / name).read_text("utf-8").partition("### A whole client\n")[2].partition("\n## ")[0]
    )
    return textwrap.dedent("\n".join(line for line in section.splitlines() if line.startswith("    ")))


def run(name: str, endpoint: str) -> subprocess.CompletedProcess[str]:
    text = program(name).replace('Robot.connect("cruiser-1")', 'Robot.connect("cruiser-1", settings=SETTINGS)')
    text = ELSEWHERE.format(endpoint=endpoint) + text.replace(DEFAULT, endpoint)
    words = [sys.executable, "-c", text, endpoint]
    return subprocess.run(words, capture_output=True, text=True, timeout=60, check=False)


def test_every_python_example_is_run_here() -> None:
    """And each one that is run exists."""
    assert {path.name for path in EXAMPLES.iterdir() if path.suffix in {".py", ".ipynb"}} == TESTED


@pytest.mark.parametrize(
    ("name", "one_way_s"), [("commands_client.py", 0.0), ("drive.py", 0.0), ("commands.md", 0.2)]
)
def test_a_client_drives_and_leaves_the_robot_to_others(name: str, one_way_s: float) -> None:
    """At half a metre a second, also 200 ms away (row 'travel delay'); the lease is free afterwards."""
    with FakeRobot() as fake:
        with TcpLink(fake.listen, lambda: one_way_s) as link:
            done = run(name, link.endpoint)
        assert (done.returncode, done.stderr) == (0, "")
        assert {one.requested_speed_mps for one in fake.accepted("drive")} <= {0.0, 0.5}
        assert max(one.output_speed_mps for one in fake.accepted("drive")) == 0.5
        wait_until(lambda: fake.state is ArbiterState.STANDBY)
        assert fake.accepted("release")


@pytest.mark.parametrize("name", ["commands_client.py", "drive.py"])
def test_a_client_that_is_refused_says_what_would_cure_it(name: str) -> None:
    """In the robot's words, without a traceback."""
    with FakeRobot(front_bumper=True) as fake:
        done = run(name, fake.listen)
    assert done.returncode == 1
    assert re.fullmatch(r".*bumper.*\. Cure: .*reset.*\n", done.stderr)


def test_a_subscriber_prints_what_a_robot_reports() -> None:
    """A line each time, until Ctrl-C."""
    with FakeRobot() as fake:
        words = [sys.executable, str(EXAMPLES / "subscribe.py"), fake.listen]
        process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        assert process.stdout is not None
        with process.stdout as lines:
            first = next(iter(lines))
            process.send_signal(signal.SIGINT)
            process.wait(30)
    assert re.match(r"fleet/cruiser-1/state mode=\w+ gear_position=\w+ speed_mps=0\.0 ", first)


def test_the_notebook_says_how_far_the_robot_went(tmp_path: Path) -> None:
    """Every cell runs on an exported dataset; the notebook is stored without output."""
    rig, operator = RecordedRig.driving(1.0)
    operator.drive(1.0, 0.0, 3.0)
    rig.rest_after(0.5)
    (tmp_path / "drive.mcap").write_bytes(rig.log())
    assert review("export", "-o", str(tmp_path / "dataset"), str(tmp_path / "drive.mcap")) == 0
    notebook = json.loads((EXAMPLES / "dataset.ipynb").read_text("utf-8"))
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert all(cell["outputs"] == [] and cell["execution_count"] is None for cell in cells)
    program = "\n".join("".join(cell["source"]) for cell in cells)
    program += '\nprint("events", len(happened), "metres", distance.fetchall()[0][1])\n'
    words = [sys.executable, "-c", program]
    done = subprocess.run(
        words, cwd=tmp_path, env=os.environ, capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr
    assert (said := re.search(r"events (\d+) metres ([\d.]+)", done.stdout))
    assert int(said[1]) > 2
    assert 3.0 < float(said[2]) < 6.0
