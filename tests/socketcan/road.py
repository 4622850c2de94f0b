"""Our own processes on a SocketCAN interface: the virtual chassis, the gateway with its guard, and an operator."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Final

from gateway.client.link import HOLD_MAX_S
from gateway.client.refusal import Refused, Stopped
from gateway.client.robot import Lease, Robot
from schemas.decisions import ArbiterState
from schemas.reasons import Reason
from schemas.settings import Settings, ZenohSettings
from tests.socketcan.turns import CHASSIS, PEER, come_as_usual, come_first
from tests.support.processes.gateway import Running
from tests.support.waiting import wait_until

CONNECT_S: Final = 30.0  # processes start slowly in user-mode Linux

STEADY_S: Final = 30.0

TRIES: Final = 3

HELD_UP: Final = frozenset({Reason.FEEDBACK_MISSING, Reason.GUARD, Reason.LOOP_LATE, Reason.DEADMAN})
"""What a robot stops for when one of the processes here does not come to its turn."""

SEEN_OVERCOME: Final = frozenset({Reason.NO_LEASE, Reason.NOT_ENGAGED})
"""What speaks against a robot that waits for its operator."""


@contextmanager
def chassis(channel: str, *words: str) -> Iterator[Running]:
    """A virtual chassis on the bus, with priority: it stands for a separate computer."""
    with Running("sim", "--interface", "socketcan", "--channel", channel, *words) as sim:
        sim.wait_says(r"chassis on socketcan")
        come_first(sim.process.pid, CHASSIS)
        yield sim


@contextmanager
def gateway(channel: str, endpoint: str, *words: str) -> Iterator[Running]:
    bus = ["--interface", "socketcan", "--channel", channel, "--listen", endpoint]
    with Running("gateway", *bus, *words) as running:
        running.wait_says("^gateway: ")
        yield running


@contextmanager
def operator(endpoint: str) -> Iterator[Robot]:
    settings = Settings(zenoh=ZenohSettings(connect=[endpoint]))
    with Robot.connect("cruiser-1", "first", settings, CONNECT_S) as connected:
        yield connected


def wait_engageable(robot: Robot) -> None:
    assert robot.wait_for(lambda state: state.guarded and set(state.blocked_by) <= SEEN_OVERCOME, STEADY_S), (
        robot.state().state
    )


class Drive:
    """A robot under way. Call ``keep`` all the time, or its command stream ends."""

    def __init__(self, lease: Lease, speed_mps: float, angle_deg: float) -> None:
        self.lease = lease
        self._speed_mps = speed_mps
        self._angle_deg = angle_deg

    def keep(self) -> None:
        self.lease.drive(self._speed_mps, angle_deg=self._angle_deg, hold_s=HOLD_MAX_S)


@contextmanager
def coming_first() -> Iterator[None]:
    """Give this process, the operator's, priority."""
    come_first(os.getpid(), PEER)
    try:
        yield
    finally:
        come_as_usual(os.getpid())


def _is_reset(lease: Lease) -> bool:
    try:
        lease.reset()
    except Refused:
        return False
    return True


@contextmanager
def driving(robot: Robot, speed_mps: float, angle_deg: float = 0.0) -> Iterator[Drive]:
    """Engage and drive the robot, again after a stop because user-mode Linux was held up."""
    with robot.lease() as lease, coming_first():
        for tries_left in reversed(range(TRIES)):
            wait_engageable(robot)
            lease.engage()
            lease.unpark()
            drive = Drive(lease, speed_mps, angle_deg)
            try:
                wait_until(lambda: robot.state().state.output_speed_mps == speed_mps, drive.keep)
                break
            except Stopped as stopped:
                if stopped.reason not in HELD_UP or not tries_left:
                    raise
            wait_standing_by(robot)
            wait_until(partial(_is_reset, lease))
        yield drive


def wait_standing_by(robot: Robot) -> None:
    assert robot.wait_for(lambda state: state.state is ArbiterState.STANDBY, STEADY_S), robot.state().state
