"""Joins robots to a ROS graph: telemetry out, and with ``drive`` commands and services in.

One thread passes on what arrives. Requests that wait for a robot run beside it, one at a time for each robot, and
the remote stop beside those.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from typing import Final

import msgspec

from gateway.choice.chassis import CHASSIS
from gateway.client.fleet import read_sample
from gateway.client.remote_stop import stop_from_here
from gateway.client.robot import CONNECT_TIMEOUT_S, RelayLease, Robot
from gateway.ros import commands
from gateway.ros.commands import CommandReader
from gateway.telemetry.samples import Received
from gateway.zenoh.ros import Arrivals, RobotFeed, RosRequest, RosSession, clock_ns
from schemas.command_line import CommandError, short
from schemas.decisions import SafetyState
from schemas.reasons import Reason
from schemas.ros import face, wire
from schemas.ros.face import OK, STALE, WARN, RosFace, stamp, status
from schemas.ros.wire import EntityKind
from schemas.settings import Settings

log = logging.getLogger(__name__)

NODE: Final = "cruiser_gateway"
LOOP_S: Final = 0.01
TICK_S: Final = 0.2
SILENT_S: Final = 3.0  # a robot whose state is older is stale in the diagnostics
ROBOTS_MAX: Final = 256
WARN_S: Final = 5.0  # the log has what is wrong with commands this often; the diagnostics have it each second
STOPS_WAITING: Final = 4  # calls of stop that may wait for the one under way
SERVICES: Final = ("engage", "disengage", "park", "unpark", "stop", "reset")
QUIET: Final = frozenset({"ackermann_output"})  # in bags alone: the graph has the commands themselves


class RosChoice(msgspec.Struct, frozen=True):
    """The choices of a bridge.

    Attributes:
        namespace: of a single robot; None for each robot's own name.
        tf: publish the transform from odom to base_link.
        drive: take commands and serve requests.
        speed_limit_mps: a lower limit than the robot's own while it is engaged from here.
    """

    robots: tuple[str, ...]
    namespace: str | None = None
    tf: bool = True
    drive: bool = False
    operator: str = ""
    speed_limit_mps: float | None = None


class RobotBridge:
    """A robot on the graph."""

    def __init__(self, name: str, namespace: str, ros: RosSession, choice: RosChoice, settings: Settings) -> None:
        self.name = name
        self._ros = ros
        self._choice = choice
        self._settings = settings
        self._face = RosFace(name, CHASSIS.wheel_radius_m)
        self._node = ros.node(namespace, NODE)
        self._topics = {
            topic: ros.publisher(self._node, topic, type_name, latched=topic == "remote_stop")
            for topic, type_name in face.TOPICS.items()
            if topic not in QUIET and (choice.tf or topic != "tf")
        }
        self._state: SafetyState | None = None
        self._heard_s = self._told_s = time.monotonic()
        self._warn_s = 0.0
        self._reader = CommandReader()
        self._robot: Robot | None = None
        self._lease: RelayLease | None = None
        self._doing: list[str] = []
        self._requests = ThreadPoolExecutor(1, f"ros-{name}")
        self._stops = ThreadPoolExecutor(1, f"ros-stop-{name}")
        self._publishers: list[Callable[[], list[str]]] = []
        if choice.drive:
            for topic, type_names in commands.TOPICS.items():
                self._publishers.append(ros.watch(EntityKind.PUBLISHER, self._node, topic))
                ros.subscribe(self._node, topic, type_names, self._command)
            self._servers = ros.watch(EntityKind.SERVER, self._node, "engage")
            for service in SERVICES:
                ros.serve(self._node, service, partial(self._serve, service))
            self._requests.submit(self._connect_early)

    def hear(self, message: object) -> None:
        """Tell the graph what the robot says."""
        if isinstance(message, SafetyState):
            self._state, self._heard_s = message, time.monotonic()
        for said in self._face.convert(message):
            if said.topic == "diagnostics":
                said.fields["status"].append(self._commands_status())
                self._told_s = time.monotonic()
            if said.topic in self._topics:
                self._topics[said.topic].publish(said.fields)

    def tick(self) -> None:
        """Say that the robot is silent."""
        now_s = time.monotonic()
        silent_s = now_s - self._heard_s
        if silent_s > SILENT_S and now_s - self._told_s >= 1.0:
            self._told_s = now_s
            silent = status(STALE, f"{self.name}: safety", f"no state for {silent_s:.0f} s", self.name, {})
            fields = {"header": {"stamp": stamp(time.time_ns())}, "status": [silent, self._commands_status()]}
            self._topics["diagnostics"].publish(fields)

    def let_go(self, why: str) -> None:
        """Pass nothing on from now, stop the robot if it is engaged from here, and give the lease back."""
        self._reader.end()
        self._requests.submit(self._let_go, why)

    def close(self) -> None:
        """Leave, after ``let_go``."""
        self._requests.shutdown()
        self._stops.shutdown()
        if self._robot is not None:
            self._robot.close()

    def _command(self, received: Received, arrived_ns: int) -> None:
        """A drive command of the graph: passed on now, or dropped."""
        angle_deg = self._state.output_angle_deg if self._state is not None else 0.0
        set_point = self._reader.read(received, arrived_ns, clock_ns(), time.time_ns(), angle_deg)
        if self._reader.note and (now_s := time.monotonic()) >= self._warn_s:
            self._warn_s = now_s + WARN_S
            log.warning("%s: a drive command of the graph: %s", self.name, self._reader.note)
        lease = self._lease
        if lease is None:
            return
        if foreign := self._reader.foreign:
            self.let_go(f"a second publisher sends drive commands ({foreign})")
        elif set_point is not None and (admitted := self._reader.admit(set_point, angle_deg)) is not None:
            lease.relay(admitted)

    def _serve(self, service: str, request: RosRequest) -> None:
        """Begin what a service asks for. Nothing waits, to be done later than it was asked for, but stops."""
        if service in {"stop", "disengage"}:
            self._reader.end()  # At once, whatever is under way.
        if service == "stop":
            is_busy = self._doing.count(service) > STOPS_WAITING
        else:
            others = {one for one in self._doing if one != "stop"}
            is_busy = service in others or (bool(others) and service != "disengage")
        if is_busy:
            request.answer(success=False, text=f"busy: {self._doing[0]} is under way")
            return
        self._doing.append(service)
        (self._stops if service == "stop" else self._requests).submit(self._answer, service, request)

    def _answer(self, service: str, request: RosRequest) -> None:
        try:
            text, success = getattr(self, f"_{service}")() or "ok", True
        except (CommandError, ValueError) as error:
            text, success = str(error), False
        except Exception as error:  # a caller waits for the answer
            log.exception("%s: %s", self.name, service)
            text, success = f"{service} failed: {error!a}", False
        finally:
            self._doing.remove(service)
        log.info("%s: %s: %s", self.name, service, text)
        request.answer(success=success, text=text)

    # The services. Each returns a text, or raises what kept it from being done.

    def _engage(self) -> str:
        if self._lease is not None and self._lease.is_engaged:
            raise ValueError(f"{self.name} is engaged from here already")
        if others := self._servers():
            raise ValueError(f"another node serves engage too ({short(', '.join(others))}): leave one")
        self._give_back()
        if why := self._reader.begin(self._publishing(), clock_ns()):
            raise ValueError(why)
        try:
            self._take_command()
        except BaseException as error:
            self._let_go(f"engage: {error}")
            raise
        return f"{self.name} is engaged; without commands it stops"

    def _take_command(self) -> None:
        lease = self._connected().relay_lease()
        lease.__enter__()
        self._lease = lease
        lease.engage(self._choice.speed_limit_mps)
        # All of that may have taken seconds.
        if why := self._reader.confirm(self._publishing(), clock_ns()):
            raise ValueError(why)

    def _disengage(self) -> str:
        if self._lease is None:
            return f"{self.name} was not engaged from here"
        try:
            self._lease.disengage()
        finally:
            self._give_back()
        return f"{self.name} stands by"

    def _park(self) -> str:
        self._held().park()
        return ""

    def _unpark(self) -> str:
        self._held().unpark()
        return ""

    def _stop(self) -> str:
        robot = self._robot
        if robot is not None:
            robot.stop(wait=False)
            return f"{self.name} is seen to stand"
        report = stop_from_here(self._settings, self.name, self._choice.operator, CONNECT_TIMEOUT_S)
        if self.name in report.stopped:
            return f"{self.name} is seen to stand"
        why = [*report.refused.values(), *report.unconfirmed.values()] or ["it did not answer"]
        raise ValueError(f"{self.name} is not known to stand: {'; '.join(why)}")

    def _reset(self) -> str:
        if self._reader.moves(clock_ns()):
            raise ValueError("drive commands that are not zero arrive: end them, then reset")
        # By the state whose challenge the reset echoes: what is latched later is not cleared.
        latched = self._connected().state().state.latched
        if others := [reason.value for reason in latched if reason is not Reason.REMOTE_STOP]:
            raise ValueError(f"{', '.join(others)} is latched: 'cruiser reset {self.name}' clears it")
        if self._lease is not None:
            cleared = self._lease.reset()
        else:
            with self._connected().lease() as lease:
                cleared = lease.reset()
        return f"cleared: {cleared}" if cleared else "nothing was latched"

    def _let_go(self, why: str) -> None:
        """Stop the robot, and give the lease back."""
        if (lease := self._lease) is not None:
            log.warning("%s: %s: it is disengaged", self.name, why)
            with suppress(CommandError, ValueError):
                lease.disengage(wait=False)
        self._give_back()

    def _give_back(self) -> None:
        lease, self._lease = self._lease, None
        self._reader.end()
        if lease is not None:
            lease.__exit__(None, None, None)

    def _held(self) -> RelayLease:
        if self._lease is None:
            raise ValueError(f"{self.name} is not engaged from here: call engage first")
        return self._lease

    def _connected(self) -> Robot:
        if self._robot is None:
            self._robot = Robot.connect(self.name, self._choice.operator, self._settings)
        return self._robot

    def _connect_early(self) -> None:
        """So that the first stop need not wait for a session."""
        with suppress(CommandError):
            self._connected()

    def _publishing(self) -> list[str]:
        """The nodes that publish drive commands."""
        return [node for nodes in self._publishers for node in nodes()]

    def _commands_status(self) -> dict[str, object]:
        """The result of the graph's commands."""
        if not self._choice.drive:
            return status(
                OK, f"{self.name}: ROS commands", "read only: 'cruiser ros --drive' takes commands", self.name, {}
            )
        lease = self._lease
        engaged = lease is not None and lease.is_engaged
        leads_nowhere = not engaged and self._reader.moves(clock_ns())
        note = self._reader.note or (
            "commands arrive, but it is not engaged: call engage" if leads_nowhere else ""
        )
        values = {"publishers": short(", ".join(self._publishing())), "engaged_from_here": str(engaged)}
        return status(WARN if note else OK, f"{self.name}: ROS commands", note or "ok", self.name, values)


class Bridge:
    """All robots on one graph."""

    def __init__(self, ros: RosSession, arrivals: Arrivals, choice: RosChoice, settings: Settings) -> None:
        self._ros = ros
        self._arrivals = arrivals
        self._choice = choice
        self._settings = settings
        self._robots: dict[str, RobotBridge] = {}
        self._namespaces: dict[str, str] = {}
        self._was_connected = True
        self._said: set[str] = set()
        for name in choice.robots:
            if "*" not in name:
                self._add(name)

    def run(self, stopped: Callable[[], bool]) -> None:
        """Pass on what arrives until the end."""
        with RobotFeed.open(self._settings, self._choice.robots, self._arrivals, self._hear):
            due_s = 0.0
            while not stopped():
                self._arrivals.handle(LOOP_S)
                if (now_s := time.monotonic()) >= due_s:
                    due_s = now_s + TICK_S
                    self._tick()

    def close(self) -> None:
        for robot in self._robots.values():
            robot.let_go("cruiser ros ends")
        for robot in self._robots.values():
            robot.close()

    def _hear(self, received: Received) -> None:
        sample = read_sample(received)
        if sample is None:
            return
        robot = self._robots.get(sample.parts.robot) or self._add(sample.parts.robot)
        if robot is not None:
            robot.hear(sample.message)

    def _add(self, name: str) -> RobotBridge | None:
        namespace = self._choice.namespace
        namespace = wire.namespace_of(name) if namespace is None else namespace
        if len(self._robots) >= ROBOTS_MAX:
            self._say(f"{name} is left out: {ROBOTS_MAX} robots are the most")
            return None
        if (other := self._namespaces.setdefault(namespace, name)) != name:
            self._say(f"{name} is left out: /{namespace} is {other}")
            return None
        log.info("%s is /%s", name, namespace)
        self._robots[name] = robot = RobotBridge(name, namespace, self._ros, self._choice, self._settings)
        return robot

    def _say(self, what: str) -> None:
        if what not in self._said and len(self._said) < ROBOTS_MAX:
            self._said.add(what)
            log.warning("%s", what)

    def _tick(self) -> None:
        is_connected = self._ros.connected()
        is_lost = self._was_connected and not is_connected
        if is_connected is not self._was_connected:
            self._was_connected = is_connected
            log.warning(
                "the ROS 2 router is %s", "lost: robots that it drove are disengaged" if is_lost else "back"
            )
        for robot in self._robots.values():
            if is_lost:
                robot.let_go("the ROS 2 router is lost")
            robot.tick()
