"""``cruiser ros`` through a real router. No ROS is here: a second reading of its conventions is the peer."""

from __future__ import annotations

import signal
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import msgspec
import pytest

from gateway.client.robot import Robot
from gateway.zenoh.client import open_local_router
from schemas.settings import Settings, ZenohSettings
from schemas.zenoh_session import close_session
from tests.support.fakes.peer import free_endpoint
from tests.support.processes.gateway import Running, chassis, run
from tests.support.provisioning import ProvisionedFleet
from tests.support.ros_graph import Graph
from tests.support.waiting import wait_until

ODOMETRY, BOOL, JOINTS = "nav_msgs/msg/Odometry", "std_msgs/msg/Bool", "sensor_msgs/msg/JointState"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
NAME = "/cruiser_1"
SERVICES = ("engage", "disengage", "park", "unpark", "stop", "reset")


class Scene(msgspec.Struct, frozen=True):
    """A robot, a router of a ROS graph, and a bridge between them."""

    graph: Graph
    bridge: Running
    gateway: Running
    settings: Settings
    router: str

    def speed_mps(self) -> float:
        """By its odometry on the graph."""
        return float(self.graph.messages[f"{NAME}/odom"][-1].twist.twist.linear.x)

    def moves(self) -> bool:
        return bool(self.graph.messages[f"{NAME}/odom"]) and self.speed_mps() > 0.1

    def stands(self) -> bool:
        return self.speed_mps() == 0.0

    def call(self, service: str) -> tuple[bool, str]:
        return self.graph.call(f"{NAME}/{service}")


@contextmanager
def scene(*words: str) -> Iterator[Scene]:
    """In open mode; ``words`` are the bridge's."""
    with ExitStack() as stack:
        router, endpoint = free_endpoint(), free_endpoint()
        routing = open_local_router(router)
        stack.callback(close_session, routing)
        _, bus = stack.enter_context(chassis())
        place = ("--interface", "socketcand", "--channel", bus, "--listen", endpoint)
        gateway = stack.enter_context(Running("gateway", *place))
        gateway.wait_says("^gateway: ")
        bridge = stack.enter_context(Running("ros", *words, "--connect", endpoint, "--ros", router))
        bridge.wait_says("^ros: ")
        graph = stack.enter_context(Graph(router))
        graph.subscribe(f"{NAME}/odom", ODOMETRY)
        wait_until(lambda: bool(graph.messages[f"{NAME}/odom"]))
        yield Scene(graph, bridge, gateway, Settings(zenoh=ZenohSettings(connect=[endpoint])), router)


def test_a_graph_sees_a_robot_and_cannot_drive_it() -> None:
    """As 'ros2 node list' and 'topic echo' would show it; a late joiner gets the newest remote_stop."""
    with scene() as one:
        graph = one.graph
        for topic, name in (("joint_states", JOINTS), ("diagnostics", DIAGNOSTICS)):
            graph.subscribe(f"{NAME}/{topic}", name)
        wait_until(lambda: bool(graph.messages[f"{NAME}/diagnostics"]))
        assert graph.topics("MP") == {
            f"{NAME}/odom": {ODOMETRY},
            f"{NAME}/tf": {"tf2_msgs/msg/TFMessage"},
            f"{NAME}/joint_states": {JOINTS},
            f"{NAME}/diagnostics": {DIAGNOSTICS},
            f"{NAME}/remote_stop": {BOOL},
        }
        assert {seen.node for seen in graph.tokens.values()} == {f"{NAME}/cruiser_gateway"}
        assert not graph.topics("MS")
        assert not graph.topics("SS")
        latched = graph.subscribe(f"{NAME}/remote_stop", BOOL, latched=True)
        wait_until(lambda: [found.data for found in latched] == [False])
        assert set(graph.messages[f"{NAME}/joint_states"][-1].name) >= {"front_steering"}
        safety, gateway, commands = graph.messages[f"{NAME}/diagnostics"][-1].status
        assert (safety.name, safety.level, gateway.level) == ("cruiser-1: safety", 0, 0)
        assert commands.message.startswith("read only")


def test_a_program_of_ros_drives_and_the_rules_hold() -> None:
    """Services, and what each refuses. The robot moves only while somebody commands it now."""
    with scene("cruiser-1", "--drive", "--no-tf") as one:
        graph = one.graph
        assert f"{NAME}/tf" not in graph.topics("MP")
        assert set(graph.topics("SS")) == {f"{NAME}/{service}" for service in SERVICES}
        assert graph.topics("MS")[f"{NAME}/cmd_vel"] == {
            "geometry_msgs/msg/Twist",
            "geometry_msgs/msg/TwistStamped",
        }
        assert one.call("park") == (False, "cruiser-1 is not engaged from here: call engage first")
        assert one.call("engage")[1].startswith("no drive command arrives")
        with graph.twists(f"{NAME}/cmd_vel") as target:
            target[0] = 0.4
            wait_until(lambda: one.call("engage")[1].startswith("drive commands that are not zero"))
            target[0] = 0.0
            wait_until(lambda: one.call("engage")[0])
            assert one.call("engage") == (False, "cruiser-1 is engaged from here already")
            assert one.call("unpark")[0]
            target[:] = [0.4, 0.2]
            wait_until(one.moves)
            target[0] = 0.0
            wait_until(one.stands)
            assert one.call("park")[0]
            assert one.call("disengage") == (True, "cruiser-1 stands by")
            assert one.call("disengage") == (True, "cruiser-1 was not engaged from here")
            # A second publisher: the robot is stopped, and cannot be engaged until one is left.
            wait_until(lambda: one.call("engage")[0])
            assert one.call("unpark")[0]
            target[0] = 0.4
            wait_until(one.moves)
            with graph.twists(f"{NAME}/cmd_vel", "teleop"):
                one.bridge.wait_says("a second publisher sends drive commands")
                wait_until(one.stands)
                assert one.call("engage")[1].startswith("2 publishers send drive commands (/planner, /teleop)")
            target[0] = 0.0
            wait_until(lambda: one.call("engage")[0])
            assert one.call("unpark")[0]
            target[0] = 0.4
            wait_until(one.moves)
            # The remote stop is latched, and is not reset under a stick that is held.
            assert one.call("stop") == (True, "cruiser-1 is seen to stand")
            assert one.call("reset") == (False, "drive commands that are not zero arrive: end them, then reset")
            target[0] = 0.0
            wait_until(lambda: one.call("reset")[0])
            wait_until(lambda: one.call("engage")[0])
            assert one.call("unpark")[0]
            target[0] = 0.4
            wait_until(one.moves)
        # Nobody publishes any more: the robot's own deadman stops it.
        wait_until(one.stands)
        # Under the login name, which is not the bridge's.
        with Robot.connect("cruiser-1", settings=one.settings) as robot:
            assert robot.wait_for(lambda state: state.stop_reason.value == "deadman", 10)
            robot.stop()
        assert not one.call("reset")[0], "somebody else's stop is not reset from the graph"


def test_what_must_not_move_a_robot() -> None:
    """Patterns, hangs, garbage, a second bridge and the end of the process."""
    with scene("cruiser-1", "--drive") as one, Robot.connect("cruiser-1", "other", one.settings) as robot:
        graph = one.graph
        with graph.twists(f"{NAME}/cmd_vel") as target:
            # A query of every key under the robot is no call of a service, with an attachment or without.
            wait_until(lambda: one.call("engage")[0])
            assert one.call("disengage")[0]
            attachment = struct.pack("<qq", 1, 1) + b"\x10" + bytes(16)
            for given in (None, attachment):
                answers = list(graph.session.get("0/cruiser_1/**", attachment=given, timeout=5.0))
                assert not [key for found in answers if found.ok and "Trigger" in (key := str(found.ok.key_expr))]
            time.sleep(0.5)
            state = robot.state().state
            assert (state.lease_holder, list(state.latched), state.state.value) == ("", [], "standby")

            def start() -> None:
                target[0] = 0.0
                wait_until(lambda: one.call("engage")[0])
                assert one.call("unpark")[0]
                target[0] = 0.4
                wait_until(one.moves)

            # The bridge hangs while commands go on: nothing that waited drives the robot later.
            start()
            one.bridge.process.send_signal(signal.SIGSTOP)
            try:
                assert robot.wait_for(lambda state: state.stop_reason.value == "deadman", 10)
                robot.wait_for_rest()
            finally:
                one.bridge.process.send_signal(signal.SIGCONT)
            wait_until(one.stands)
            time.sleep(1.0)
            assert not robot.state().state.engaged
            assert one.stands()
            # Garbage beside the commands neither ends the bridge nor stops the robot.
            start()
            for size in (0, 3, 100, 1_000_000):
                for kind in ("geometry_msgs::msg::dds_::Twist_/\n", "x/y"):
                    graph.session.put(f"0{NAME}/cmd_vel/{kind}", b"\xff" * size)
            time.sleep(0.5)
            assert one.moves()
            # The process ends: the robot stops, and the lease is free at once.
            assert one.bridge.stop() == 0
            wait_until(lambda: not robot.state().state.lease_holder)
            robot.wait_for_rest()
            assert not [line for line in one.bridge.said if "Traceback" in line]


def test_two_bridges_of_one_robot_engage_nothing() -> None:
    """Each says why; and while a robot does not answer, no call waits to be done later."""
    with scene("cruiser-1", "--drive") as one, one.graph.twists(f"{NAME}/cmd_vel"):
        graph = one.graph
        place = ("--connect", *one.settings.zenoh.connect, "--ros", one.router)
        with Running("ros", "cruiser-1", "--drive", "--operator", "second", *place) as second:
            second.wait_says("^ros: ")
            wait_until(lambda: len(graph.call_all(f"{NAME}/engage")) == 2)
            wait_until(
                lambda: all("another node serves engage" in text for _, text in graph.call_all(f"{NAME}/engage"))
            )
            second.stop()
        wait_until(lambda: one.call("engage")[0])
        one.gateway.process.send_signal(signal.SIGSTOP)
        try:
            with ThreadPoolExecutor(2) as beside:
                answers = set(beside.map(one.call, ("park", "unpark")))
            assert answers in [
                {(False, f"cruiser-1 did not answer {first}"), (False, f"busy: {first} is under way")}
                for first in ("park", "unpark")
            ]
        finally:
            one.gateway.process.send_signal(signal.SIGCONT)
        # The guard has stopped the robot: that is not the bridge's own stop.
        wait_until(lambda: one.call("reset") == (False, "guard is latched: 'cruiser reset cruiser-1' clears it"))


def test_a_graph_that_is_lost_lets_the_robot_go() -> None:
    """And finds it again. The commands that were on their way then drive nothing."""
    router, endpoint = free_endpoint(), free_endpoint()
    with ExitStack() as stack:
        routing = open_local_router(router)
        _, bus = stack.enter_context(chassis())
        place = ("--interface", "socketcand", "--channel", bus, "--listen", endpoint)
        stack.enter_context(Running("gateway", *place)).wait_says("^gateway: ")
        bridge = stack.enter_context(
            Running("ros", "cruiser-1", "--drive", "--connect", endpoint, "--ros", router)
        )
        bridge.wait_says("^ros: ")
        settings = Settings(zenoh=ZenohSettings(connect=[endpoint]))
        robot = stack.enter_context(Robot.connect("cruiser-1", "other", settings))
        with Graph(router) as graph, graph.twists(f"{NAME}/cmd_vel"):
            wait_until(lambda: graph.call(f"{NAME}/engage")[0])
            assert robot.state().state.lease_holder
            close_session(routing)
            bridge.wait_says("the ROS 2 router is lost")
            assert robot.wait_for(lambda state: not state.lease_holder, 20)
        routing = open_local_router(router)
        stack.callback(close_session, routing)
        bridge.wait_says("the ROS 2 router is back")
        with Graph(router) as graph, graph.twists(f"{NAME}/cmd_vel"):
            wait_until(lambda: f"{NAME}/engage" in graph.topics("SS"))
            wait_until(lambda: graph.call(f"{NAME}/engage")[0])
            assert graph.call(f"{NAME}/disengage")[0]


@pytest.mark.parametrize("case", ["silent", "gateway", "namespace", "pattern"])
def test_what_cannot_begin_ends_in_one_line(case: str) -> None:
    """No router; a gateway that has its port; odd names."""
    with ExitStack() as stack:
        endpoint = free_endpoint()
        words, code, says = {
            "silent": (["--ros", endpoint], 4, "no ROS 2 router answers at"),
            "gateway": (["--ros", endpoint], 4, "is no router: a gateway has the port of rmw_zenohd"),
            "namespace": (["cruiser-1", "--namespace", "a b"], 2, "is no ROS namespace"),
            "pattern": (["--drive"], 2, "name the robots that --drive may drive"),
        }[case]
        if case == "gateway":
            _, bus = stack.enter_context(chassis())
            place = ("--interface", "socketcand", "--channel", bus, "--listen", endpoint)
            stack.enter_context(Running("gateway", *place)).wait_says("^gateway: ")
        found = run(["ros", *words])
        assert found.returncode == code
        assert says in found.stderr
        assert len(found.stderr.strip().splitlines()) <= 8


def test_a_foreign_library_drives_a_robot_in_signed_mode(tmp_path: Path) -> None:
    """zenoh-ros2-sdk publishes TwistStamped; it is killed at speed, and the robot stops by its deadman."""
    made = ProvisionedFleet(tmp_path, free_endpoint().replace("tcp/", "tls/"))
    router, robot, ann = (
        made.let_in(*who) for who in (("router", "127.0.0.1"), ("robot", "cruiser-1"), ("operator", "ann"))
    )
    ros = free_endpoint()
    with ExitStack() as stack:
        stack.enter_context(Running("router", "--directory", str(router))).wait_says("listens on")
        stack.callback(close_session, open_local_router(ros))
        _, bus = stack.enter_context(chassis())
        place = ("--config", str(robot / "robot.toml"), "--interface", "socketcand", "--channel", bus)
        stack.enter_context(Running("gateway", *place)).wait_says("^gateway: ")
        words = ("--config", str(ann / "operator.toml"), "--ros", ros, "--drive")
        bridge = stack.enter_context(Running("ros", "cruiser-1", *words))
        bridge.wait_says("^ros: ")
        graph = stack.enter_context(Graph(ros))
        odometry = graph.subscribe(f"{NAME}/odom", ODOMETRY)
        latched = graph.subscribe(f"{NAME}/remote_stop", BOOL, latched=True)
        started = subprocess.Popen(
            [sys.executable, "-m", "tests.support.ros_peer", ros.rpartition(":")[2], str(tmp_path / "msg")],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        peer = stack.enter_context(started)
        stack.callback(peer.kill)
        assert peer.stdin is not None
        assert peer.stdout is not None
        assert peer.stdout.readline() == "ready\n"
        wait_until(lambda: graph.call(f"{NAME}/engage")[0])
        assert graph.call(f"{NAME}/unpark")[0]
        peer.stdin.write("0.5 0.1\n")
        peer.stdin.flush()
        seen: Any = next(line for line in peer.stdout if line.startswith("odom") and float(line.split()[1]) > 0.3)
        assert seen
        peer.kill()
        wait_until(lambda: odometry[-1].twist.twist.linear.x == 0.0)
        wait_until(lambda: graph.call(f"{NAME}/stop")[0])
        wait_until(lambda: [found.data for found in latched][-1:] == [True])
