"""``cruiser ros``: what it adds to odometry and commands, and the processor time it takes."""

from __future__ import annotations

import json
import os
import secrets
import struct
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from math import radians, tan
from random import Random
from typing import Any, Final

import msgspec
import zenoh

from gateway.choice.chassis import CHASSIS
from gateway.client.link import SetPoint
from gateway.client.robot import Lease, RelayLease, Robot
from gateway.zenoh.client import open_local_router
from schemas.settings import Settings, ZenohSettings
from schemas.subjects import BY_NAME
from schemas.zenoh_session import close_session
from tests.bench.command_latency import (
    ANGLES_DEG,
    MIDDLE_RAW,
    ROBOT,
    SPEED_MPS,
    STEERING_ID,
    Driver,
    Witness,
    until,
)
from tests.bench.loads import Row, beside
from tests.bench.processes import empty_loop, served_chassis, start
from tests.bench.recorder_load import Fed, make_script
from tests.bench.recorder_run import answer, go_on, started
from tests.support.fakes.peer import free_endpoint
from tests.support.processes.usage import cpu_s
from tests.support.ros_graph import STORE, Graph

NAME: Final = "/cruiser_1"
ODOMETRY: Final = "nav_msgs/msg/Odometry"
TWIST: Final = "geometry_msgs/msg/Twist"
ROBOTS: Final = (1, 20)
TICKS_PER_S: Final = 100

Send = Callable[[float, float], object]
"""Sends a drive command: speed in m/s, angle in deg."""


class Scene(msgspec.Struct, frozen=True):
    """A virtual robot, a graph's router and a bridge between them, with a witness on the bus."""

    graph: Graph
    witness: Witness
    driver: Driver
    settings: Settings


@contextmanager
def _scene() -> Iterator[Scene]:
    os.environ["CRUISER_GATEWAY_ACCEPT_UNGUARDED"] = "true"
    with ExitStack() as stack:
        endpoint, router = free_endpoint(), free_endpoint()
        stack.callback(close_session, open_local_router(router))
        address = served_chassis(stack, "--variant", "fine")
        bus = ["--interface", "socketcand", "--channel", address, "--listen", endpoint]
        start(stack, ["-m", "gateway", "gateway", *bus], "gateway: ")
        place = ["--connect", endpoint, "--ros", router]
        start(stack, ["-m", "gateway", "ros", "cruiser-1", "--drive", *place], "ros: ")
        witness, driver = Witness(address), Driver(endpoint)
        stack.callback(witness.close)
        stack.callback(driver.close)
        graph = stack.enter_context(Graph(router))
        yield Scene(graph, witness, driver, Settings(zenoh=ZenohSettings(connect=[endpoint])))


def rows(drives: int, seconds: float) -> list[Row]:
    with _scene() as scene, empty_loop() as empty:
        direct_us, odometry_us = _odometry_us(scene, seconds)
        twist_us = _by_twist(scene, drives)
        lease_us = _by_lease(scene, drives, relays=False)
        relay_us = _by_lease(scene, drives, relays=True)
    odometry, plain, added = beside(odometry_us, direct_us, (0.5, 0.99), 0.99)
    twist, lease, more = beside(twist_us, lease_us, (0.5, 0.99), 0.99)
    _, relay, over_relay = beside(twist_us, relay_us, (0.5, 0.99), 0.99)
    empty_put = beside(empty.put_us, empty.put_us, (0.5, 0.99), 0.99)[0]
    return [
        ("odometry, CAN frame to a ROS subscriber, p50 p99", f"{odometry}, of {len(odometry_us)}", ""),
        ("  to a subscriber of the gateway", plain, ""),
        ("  the difference", added, ""),
        ("Twist put to first CAN frame, p50 p99", f"{twist}, of {len(twist_us)}", ""),
        ("  Lease.drive to first CAN frame", lease, ""),
        ("  the difference", more, "under 2 ms"),
        ("  a client that sends at once (RelayLease)", relay, ""),
        ("  the difference", over_relay, "under 2 ms"),
        ("  an empty put meanwhile", empty_put, ""),
        *(
            (
                f"cruiser ros, processor, of {number} robot{'s' * (number > 1)}",
                f"{_cpu(number, seconds):.1f} %",
                "",
            )
            for number in ROBOTS
        ),
    ]


def _odometry_us(scene: Scene, seconds: float) -> tuple[list[float], list[float]]:
    """From the drive feedback to subscribers of the gateway and of the graph, sorted."""
    direct: list[float] = []
    bridged: list[float] = []
    subject = BY_NAME["chassis/odometry"]

    def on_robot(sample: zenoh.Sample) -> None:
        message = msgspec.msgpack.decode(sample.payload.to_bytes())
        direct.append((time.time_ns() - message["time_ns"]) / 1e3)

    def on_graph(sample: zenoh.Sample) -> None:
        now_ns = time.time_ns()
        stamp = STORE.deserialize_cdr(sample.payload.to_bytes(), ODOMETRY).header.stamp  # type: ignore[attr-defined]  # of rosbags' making
        bridged.append((now_ns - stamp.sec * 1_000_000_000 - stamp.nanosec) / 1e3)

    here = scene.driver.session.declare_subscriber(f"{ROBOT}{subject.name}", on_robot)
    there = scene.graph.session.declare_subscriber(f"0{NAME}/odom/**", on_graph)
    until(lambda: bool(bridged))
    direct.clear()
    bridged.clear()
    time.sleep(seconds)
    here.undeclare()
    there.undeclare()
    return sorted(direct), sorted(bridged)


def _drives_us(scene: Scene, send: Send, count: int) -> list[float]:
    """Drive at SPEED_MPS, so many times to one side or the other; from each command to its frame, sorted."""
    until(lambda: scene.driver.look()["output_speed_mps"] == SPEED_MPS, lambda: send(SPEED_MPS, 0.0), 0.02)
    random = Random(0)  # noqa: S311 - to hit every place between two ticks
    found: list[float] = []
    for number in range(count):
        left = bool(number % 2)
        put_s = time.monotonic()
        send(SPEED_MPS, ANGLES_DEG[left])
        if number:
            found.append(
                scene.witness.first_us(put_s, STEERING_ID, lambda raw, left=left: (raw > MIDDLE_RAW) is left)  # type: ignore[misc]  # bound at once
            )
        time.sleep(random.uniform(0.015, 0.035))
    return sorted(found)


def _by_twist(scene: Scene, count: int) -> list[float]:
    """Commands of a publisher on the graph."""
    graph, gid = scene.graph, secrets.token_bytes(16)
    vector, twist = STORE.types["geometry_msgs/msg/Vector3"], STORE.types[TWIST]
    key = f"0{NAME}/cmd_vel/geometry_msgs::msg::dds_::Twist_/{STORE.hash_rihs01(TWIST)}"
    sent = 0

    def send(speed_mps: float, angle_deg: float) -> None:
        nonlocal sent
        sent += 1
        yaw_radps = speed_mps * tan(radians(angle_deg)) / CHASSIS.wheelbase_m
        message: Any = twist(vector(speed_mps, 0.0, 0.0), vector(0.0, 0.0, yaw_radps))
        attachment = struct.pack("<qq", sent, time.time_ns()) + b"\x10" + gid
        graph.session.put(key, bytes(STORE.serialize_cdr(message, TWIST)), attachment=attachment)

    until(lambda: f"{NAME}/engage" in graph.topics("SS"))
    until(lambda: _called_while_zero(graph, "engage", send))
    assert _called_while_zero(graph, "unpark", send)
    found = _drives_us(scene, send, count)
    assert graph.call(f"{NAME}/disengage")[0]
    return found


def _called_while_zero(graph: Graph, service: str, send: Send) -> bool:
    """Call a service while zero speed is published at 20 Hz; True if it succeeded."""
    ended = threading.Event()

    def publish() -> None:
        while not ended.wait(0.05):
            send(0.0, 0.0)

    publishing = threading.Thread(target=publish)
    publishing.start()
    try:
        time.sleep(0.1)
        return graph.call(f"{NAME}/{service}")[0]
    finally:
        ended.set()
        publishing.join()


def _by_lease(scene: Scene, count: int, *, relays: bool) -> list[float]:
    """Commands of our own client, by its stream or each at once."""
    with Robot.connect("cruiser-1", "bench", scene.settings) as robot:
        lease: Lease = robot.relay_lease() if relays else robot.lease()
        with lease:
            lease.engage()
            lease.unpark()

            def send(speed_mps: float, angle_deg: float) -> None:
                if isinstance(lease, RelayLease):
                    assert lease.relay(SetPoint(speed_mps, angle_deg=angle_deg))
                else:
                    lease.drive(speed_mps, angle_deg=angle_deg)

            found = _drives_us(scene, send, count)
            lease.disengage()
    return found


def _cpu(robots: int, seconds: float) -> float:
    """Percent of a core that a bridge takes of robots that drive, of which one process plays all."""
    with ExitStack() as stack:
        ros, fleet = free_endpoint(), free_endpoint()
        for router in (ros, fleet):
            stack.callback(close_session, open_local_router(router))
        ros_process, _ = start(stack, ["-m", "gateway", "ros", "--connect", fleet, "--ros", ros], "ros: ")
        # The load waits for a subscriber of its last subject, and the graph for one of its topics.
        last = Driver(fleet)
        stack.callback(last.close)
        key = BY_NAME[make_script().subjects[-1]].name.replace("{bus}", "*")
        last.session.declare_subscriber(f"fleet/*/{key}", zenoh.handlers.RingChannel(1))
        graph = stack.enter_context(Graph(ros))
        seen: set[str] = set()
        graph.session.declare_subscriber("0/*/odom/**", lambda sample: seen.add(str(sample.key_expr)))
        words = ["--robots", str(robots), "--ticks", str(round(seconds * TICKS_PER_S)), "--paced", "--client"]
        load_words = [sys.executable, "-m", "tests.bench.recorder_load", fleet, *words]
        load = stack.enter_context(started(load_words, seconds))
        answer(load)
        go_on(load)
        begun_s, begun_cpu_s = time.monotonic(), cpu_s(ros_process.pid)
        fed = msgspec.convert(json.loads(go_on(load)), Fed)
        used_s, passed_s = cpu_s(ros_process.pid) - begun_cpu_s, time.monotonic() - begun_s
        if len(seen) != robots or fed.late_s > 1.0:
            raise RuntimeError(f"{len(seen)} of {robots} robots seen, the load {fed.late_s:.1f} s late")
    return used_s / passed_s * 100
