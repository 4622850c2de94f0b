"""Virtual robots that drive by themselves: their operator is like any other, and has a lease for each."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Sequence
from typing import Final, Self

import msgspec

from gateway.client.reasons_text import is_idle
from gateway.client.robot import Robot
from schemas.decisions import SafetyState
from schemas.exit_codes import CommandError
from schemas.settings import Settings

log = logging.getLogger(__name__)

OPERATOR: Final = "patrol"

SPEED_MPS: Final = 0.6
ANGLE_DEG: Final = 18.0
BEND_S: Final = 8.0
"""One of the two bends of an eight."""

READY_TIMEOUT_S: Final = 2.0
"""A gateway that has just started, or a robot that was just given back, is ready within this time."""

PERIOD_S: Final = 0.1
PAUSE_S: Final = 1.0
"""Between two drives of one driver."""


class Patrol:
    """Drivers, each of whom drives one robot after the other through an eight, and gives it back.

    A robot that somebody holds, or that is blocked for a cause, is left alone: nothing is taken from anybody, and
    nothing is reset.
    """

    def __init__(self, robots: Sequence[str], drivers: int, settings: Settings, endpoint: str) -> None:
        """Plan it; it begins where a ``with`` begins, and ends with it.

        Args:
            robots: their names.
            drivers: how many robots are driven at a time.
            settings: for the root of the keys.
            endpoint: of Zenoh.
        """
        zenoh = msgspec.structs.replace(
            settings.zenoh, mode="client", connect=[endpoint], config="", given=frozenset({"mode", "connect"})
        )
        authority = msgspec.structs.replace(settings.authority, mode="open")
        self._settings = msgspec.structs.replace(settings, zenoh=zenoh, authority=authority)
        self._waiting = deque(robots)
        self._ending = threading.Event()
        self._threads = [threading.Thread(target=self._drive_all) for _ in range(min(drivers, len(robots)))]

    def __enter__(self) -> Self:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *raised: object) -> None:
        """End; robots that are driven come to rest."""
        self._ending.set()
        for thread in self._threads:
            thread.join()

    def _drive_all(self) -> None:
        while not self._ending.is_set():
            robot = self._waiting.popleft()
            try:
                self._drive(robot)
            except CommandError as error:
                # Somebody took it, or it was stopped: that is what a demonstration is for.
                log.info("%s", error)
            self._waiting.append(robot)
            self._ending.wait(PAUSE_S)

    def _drive(self, name: str) -> None:
        with Robot.connect(name, OPERATOR, self._settings, stopped=self._ending.is_set) as robot:
            if not robot.wait_for(_waits_for_a_driver, READY_TIMEOUT_S):
                return
            with robot.lease() as lease:
                lease.engage(speed_limit_mps=SPEED_MPS)
                lease.unpark()
                for angle_deg in (ANGLE_DEG, -ANGLE_DEG):
                    end_s = time.monotonic() + BEND_S
                    while time.monotonic() < end_s and not self._ending.is_set():
                        lease.drive(SPEED_MPS, angle_deg=angle_deg)
                        self._ending.wait(PERIOD_S)
                lease.disengage()


def _waits_for_a_driver(state: SafetyState) -> bool:
    return state.guarded and not state.lease_holder and is_idle(state.blocked_by)
