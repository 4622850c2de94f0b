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
TESTED = {"commands_client.py", "dataset.ipynb", "drive.py", "ros2_idle.py", "subscribe.py"}
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


RCLPY = '''
"""As much of rclpy as ros2_idle.py uses: the clock is counted, and what is published is printed."""
import sys, types

class Time:
    def __init__(self, ns): self.nanoseconds = ns
    def __sub__(self, other): return Time(self.nanoseconds - other.nanoseconds)
    def to_msg(self): return self.nanoseconds // 1_000_000

class Twist:
    def __init__(self): self.header = types.SimpleNamespace(stamp=0); self.speed = 0.0

class Node:
    def __init__(self, name): self.ms = 0
    def get_clock(self): return types.SimpleNamespace(now=lambda: Time(self.ms * 1_000_000))
    def create_publisher(self, kind, topic, depth):
        assert topic == "cmd_vel"
        return types.SimpleNamespace(publish=lambda one: print(one.header.stamp, one.speed))
    def create_subscription(self, kind, topic, take, depth): self.take = take
    def create_timer(self, period_s, fill): self.period_ms, self.fill = round(1000 * period_s), fill

def spin(node):
    """Commands at 0.5 m/s from 1 s to 2 s, at 20 Hz."""
    for node.ms in range(node.period_ms, 3001, node.period_ms):
        if 1000 <= node.ms <= 2000:
            command = Twist()
            command.header.stamp, command.speed = node.ms, 0.5
            node.take(command)
        node.fill()

def add(name, **fields): sys.modules[name] = module = types.ModuleType(name); vars(module).update(fields)
add("rclpy", init=lambda: None, spin=spin)
add("rclpy.node", Node=Node)
add("rclpy.executors", ExternalShutdownException=type("ExternalShutdownException", (Exception,), {}))
add("geometry_msgs")
add("geometry_msgs.msg", TwistStamped=Twist)
'''


def test_the_node_for_a_planner_passes_each_command_on_once_and_fills_silence_with_zero(tmp_path: Path) -> None:
    """In a stand-in for ROS: a real one has not been met."""
    script = tmp_path / "idle.py"
    script.write_text(RCLPY + (EXAMPLES / "ros2_idle.py").read_text())
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=60, check=True)
    said = [(int(ms), float(speed)) for ms, speed in map(str.split, done.stdout.splitlines())]
    assert [ms for ms, speed in said if speed] == list(range(1000, 2001, 50))
    zeros = [ms for ms, speed in said if not speed]
    assert zeros == [ms for ms in range(250, 3001, 50) if not 1000 <= ms <= 2200]
