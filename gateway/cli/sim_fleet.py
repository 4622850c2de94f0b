"""A fleet of virtual robots at one Zenoh endpoint of this machine, each with a real gateway and its guard."""

from __future__ import annotations

import os
import sys
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final, Self

from gateway.cli.child import Child, address_of
from gateway.cli.sim_patrol import Patrol
from gateway.host.stop_note import StopNote
from gateway.zenoh.client import close_session
from gateway.zenoh.router import open_local_router
from schemas.exit_codes import ExitCode
from schemas.settings import Settings

ROBOTS_PER_PROCESSOR: Final = 5
"""A chassis, its gateway and its guard take an eighth of a processor at rest, and more while it is driven."""

POLL_S: Final = 0.2

BEGUN_MAX: Final = 5
"""A gateway that died so often is started no more."""

_ENDED_AT_ONCE: Final = 8
"""Processes that are ended at the same time."""


class VirtualFleet:
    """Chassis, gateways and guards of some robots, and the router where they meet.

    Attributes:
        endpoint: of the router.
        robots: their names, ``cruiser-1`` and so on.
        started: other processes that ``end`` ends too, before the gateways.
    """

    def __init__(self, count: int, endpoint: str, chassis: Sequence[str], configuration: Sequence[str]) -> None:
        """Plan a fleet; it starts where a ``with`` begins.

        Args:
            count: of robots.
            endpoint: of the router, on this machine's own loopback.
            chassis: words of ``cruiser sim`` for each chassis.
            configuration: words that name the configuration of all of them.
        """
        self.endpoint = endpoint
        self.robots = [f"cruiser-{number}" for number in range(1, count + 1)]
        self.started: list[Child] = []
        self._words = [*configuration, *chassis]
        self._configuration = configuration
        self._stack = ExitStack()
        self._chassis: list[Child] = []
        self._gateways: dict[str, Child] = {}
        self._begun: Counter[str] = Counter()
        self._noted: dict[str, str] = {}

    def __enter__(self) -> Self:
        """Start all of it. Each process has started before the first of its kind is waited for.

        Raises:
            CommandError: the endpoint is taken, or a process does not start.
        """
        with ExitStack() as stack:
            stack.callback(close_session, open_local_router(self.endpoint))
            # A stop by the guard in another run latches none of these; one in this run does.
            self._state = Path(stack.enter_context(TemporaryDirectory(prefix="cruiser-")))
            words = [*self._words, "--listen", "127.0.0.1:0"]
            self._chassis = [stack.enter_context(Child("sim", words)) for _ in self.robots]
            self._gateways = {robot: stack.enter_context(self._gateway(robot)) for robot in self.robots}
            for gateway in self._gateways.values():
                gateway.wait_ready()
            self._stack = stack.pop_all()
        return self

    def _gateway(self, robot: str) -> Child:
        self._begun[robot] += 1
        bus = ["--interface", "socketcand", "--channel", address_of(self._chassis[self.robots.index(robot)])]
        words = [*self._configuration, "--robot", robot, *bus, "--connect", self.endpoint]
        return Child("gateway", words, environment=environment(self._state))

    def __exit__(self, *raised: object) -> None:
        self._stack.close()

    def start(self, name: str, *words: str) -> str:
        """Start another command beside the fleet. Returns its first line; it ends with the fleet.

        Raises:
            CommandError: it does not start.
        """
        child = self._stack.enter_context(Child(name, [*self._configuration, *words]))
        self.started.append(child)
        return child.wait_ready()

    def tend(self, tell: Callable[[str], object]) -> None:
        """Start a gateway that has died again, and tell of it, and of what its guard did.

        Raises:
            CommandError: anything else has ended, or a gateway dies again and again.
        """
        for child in (*self._chassis, *self.started):
            child.check()
        for robot, gateway in self._gateways.items():
            if not gateway.is_over:
                continue
            if self._begun[robot] > BEGUN_MAX:
                gateway.check()
            tell(f"{robot}: its gateway has died. Its guard stops the robot; another gateway starts")
            self._gateways[robot] = self._stack.enter_context(self._gateway(robot))
        for path in self._state.glob("*.guard-stop"):
            line = StopNote(path).last()
            if line is not None and self._noted.get(path.name) != line[1]:
                self._noted[path.name] = line[1]
                tell(f"{path.name.split('.')[-2]}: {line[1]}")

    def end(self) -> None:
        """End all of it, the gateways before their chassis: a robot that moves is stopped first.

        Raises:
            CommandError: a process ended before, or does not end.
        """
        for children in (self.started, self._gateways.values(), self._chassis):
            with ThreadPoolExecutor(_ENDED_AT_ONCE) as pool:
                list(pool.map(Child.end, children))


def environment(state: Path) -> Mapping[str, str]:
    """The environment of a virtual robot's gateway: it has no keys, and meets all others at the router.

    Args:
        state: the directory of what outlives it.
    """
    own = {"ZENOH_MODE": "client", "ZENOH_CONFIG": "", "AUTHORITY_MODE": "open", "GATEWAY_STATE_DIR": str(state)}
    return os.environ | {f"CRUISER_{name}": text for name, text in own.items()}


def warn_of_load(count: int) -> None:
    """Say so where there are more robots than this machine's processors can hold."""
    processors = os.cpu_count() or 1
    if count > ROBOTS_PER_PROCESSOR * processors:
        sys.stderr.write(
            f"sim: {count} robots are many for {processors} processors, which hold about "
            f"{ROBOTS_PER_PROCESSOR * processors}: frames come late, and then the arbiters stop the robots\n"
        )


def run(fleet: VirtualFleet, patrolling: int, settings: Settings, ends: Callable[[], bool]) -> int:
    """Run a fleet until the end.

    Args:
        fleet: that has not started.
        patrolling: how many robots drive by themselves at a time.
        settings: for the root of the keys.
        ends: turns true when it should end.

    Raises:
        CommandError: it does not start, or a part of it ends by itself.
    """
    warn_of_load(len(fleet.robots))
    with fleet:
        sys.stderr.write(f"sim: {fleet.robots[0]} to {fleet.robots[-1]} at {fleet.endpoint}\n")
        sys.stderr.flush()
        with Patrol(fleet.robots, patrolling, settings, fleet.endpoint):
            while not ends():
                fleet.tend(lambda line: sys.stderr.write(f"sim: {line}\n"))
                time.sleep(POLL_S)
        fleet.end()
    return int(ExitCode.OK)
