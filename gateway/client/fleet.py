"""The newest of each robot, and its age. Pure: samples go in, reports come out.

A report never gives an old value as a present one: a state or a health that is too old is not in it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import msgspec

from gateway.client.payloads import NewerWords, read_sample
from gateway.telemetry.received import Arrival, Missed, Received
from schemas import keys
from schemas.codec import PayloadFault
from schemas.decisions import SafetyState
from schemas.messages import GatewayHealth, RobotState
from schemas.printable import plain

STATE_STALE_NS: Final = 1_000_000_000
"""A state, due every 50 ms, is no longer shown after 1 s."""

HEALTH_STALE_NS: Final = 3_500_000_000
"""A health, due every second, is no longer shown after 3.5 s: two may be lost."""

FORGOTTEN_NS: Final = 60_000_000_000
"""A robot whose token is gone, silent for a minute, may be forgotten once somebody has seen that."""

ROBOTS_KEPT: Final = 1000
"""Beyond so many a robot is forgotten that may be: a stranger could make any number of names."""


class RobotStatus(msgspec.Struct, frozen=True):
    """A robot at one moment.

    Attributes:
        connected: its liveliness token is there. That is no proof of health.
        state: the last state; null if it is too old, or if there was none.
        state_age_s: time since the last state arrived; null if there was none.
        health: the last health, with the same rule.
        unreadable: why the last sample that could not be read could not; empty if all could.
        linked: this end is connected to Zenoh.
        newer: what a newer version says and this one does not know; empty if nothing.
        safety: the last of the arbiter's states, with the same rule; null where there is no arbiter.
    """

    robot: str
    connected: bool
    state: RobotState | None
    state_age_s: float | None
    health: GatewayHealth | None
    health_age_s: float | None
    unreadable: str
    linked: bool
    safety: SafetyState | None = None
    newer: str = ""


def alarm(report: RobotStatus) -> str:
    """Return why nothing of the robot's state can be shown; empty if it can."""
    if report.state is not None:
        return ""
    reasons = []
    if not report.linked:
        reasons.append("this end is not connected to Zenoh")
    elif not report.connected:
        reasons.append("its gateway is not connected")
    elif report.health is None:
        reasons.append("its gateway is connected, but sends no health")
    else:
        reasons.append("its gateway is connected and sends health")
    if report.unreadable:
        reasons.append(f"unreadable: {plain(report.unreadable)}")
    what = "no state yet" if report.state_age_s is None else f"no contact for {_duration(report.state_age_s)}"
    return f"{what}; {', '.join(reasons)}"


def _duration(seconds: float) -> str:
    """A time as coarse as it is of use."""
    if seconds < 10:
        return f"{seconds:.1f} s"
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.0f} h"


class _Known:
    """The last samples of a robot."""

    def __init__(self) -> None:
        self.connected = False
        self.state: RobotState | None = None
        self.state_ns = 0
        self.safety: SafetyState | None = None
        self.safety_ns = 0
        self.health: GatewayHealth | None = None
        self.health_ns = 0
        self.heard_ns = 0
        self.unreadable = ""
        self.newer = NewerWords()


class Fleet:
    """All robots under a root."""

    def __init__(self, root: str) -> None:
        self._root = root
        self._known: dict[str, _Known] = {}
        self._linked = True

    def receive(self, heard: Arrival, now_ns: int) -> None:
        """Take in a sample or a change of a token. What is no robot's is ignored."""
        if isinstance(heard, Received):
            self._receive_sample(heard, now_ns)
            return
        if isinstance(heard, Missed):
            return  # A newer sample comes soon.
        robot = keys.robot_of_liveliness(self._root, heard.key)
        if robot is not None:
            known = self._robot(robot, now_ns)
            known.connected = heard.present

    def link(self, *, connected: bool) -> None:
        """This end is connected to Zenoh, or is not. Without a link no token says anything."""
        self._linked = connected

    def robots(self, now_ns: int, forgets: Callable[[str], object] = lambda _robot: False) -> list[str]:
        """The names of the robots that are there or were there, as people order them.

        Args:
            now_ns: the time.
            forgets: asked of each robot that may be forgotten. One that is lost stays until somebody has seen it.
        """
        is_full = len(self._known) > ROBOTS_KEPT
        self._known = {
            robot: known
            for robot, known in self._known.items()
            if known.connected or now_ns - known.heard_ns < FORGOTTEN_NS or not (is_full or forgets(robot))
        }
        return sorted(self._known, key=keys.in_order)

    def report(self, robot: str, now_ns: int) -> RobotStatus:
        """A robot at this moment; one that was never heard of has an empty report."""
        known = self._known.get(robot) or _Known()
        state_age_ns = now_ns - known.state_ns
        health_age_ns = now_ns - known.health_ns
        return RobotStatus(
            robot=robot,
            connected=known.connected and self._linked,
            state=known.state if state_age_ns < STATE_STALE_NS else None,
            state_age_s=None if known.state is None else state_age_ns / 1e9,
            safety=known.safety if now_ns - known.safety_ns < STATE_STALE_NS else None,
            health=known.health if health_age_ns < HEALTH_STALE_NS else None,
            health_age_s=None if known.health is None else health_age_ns / 1e9,
            unreadable=known.unreadable,
            linked=self._linked,
            newer=known.newer.text,
        )

    def _robot(self, robot: str, now_ns: int) -> _Known:
        known = self._known.setdefault(robot, _Known())
        known.heard_ns = now_ns
        return known

    def _receive_sample(self, received: Received, now_ns: int) -> None:
        sample = read_sample(received)
        if sample is None or sample.parts.root != self._root:
            return
        message = sample.message
        known = self._robot(sample.parts.robot, now_ns)
        if sample.unknown:
            known.newer.note(sample.unknown)
        known.unreadable = message.detail if isinstance(message, PayloadFault) else ""
        match message:
            case RobotState():
                known.state, known.state_ns = message, now_ns
            case SafetyState():
                known.safety, known.safety_ns = message, now_ns
            case GatewayHealth():
                known.health, known.health_ns = message, now_ns
