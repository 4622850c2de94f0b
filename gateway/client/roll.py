"""Finds out which robots are connected."""

from __future__ import annotations

import time
from typing import Final

from gateway.zenoh.client import PendingQuery, RobotListener
from gateway.zenoh.operator import CommandPort
from schemas import keys
from schemas.keys import login_operator
from schemas.settings import Settings

REPEAT_S: Final = 0.5
"""The period in which it is asked who is connected."""

TIMEOUT_S: Final = 5.0
"""So long an answer to that is waited for, before it is asked anew."""

SETTLE_S: Final = 1.0
"""The time after which no other robot is expected: nodes find each other by gossip in less."""

NAMES_SHOWN: Final = 10

POLL_S: Final = 0.02


class RollCall:
    """Asks again and again who is connected. On a busy network robots answer later than they follow each other.

    Attributes:
        robots: those that answered.
        is_answered: everybody who is linked has answered.
    """

    def __init__(self, port: CommandPort | RobotListener, root: str) -> None:
        self.robots: set[str] = set()
        self.is_answered = False
        self._port = port
        self._root = root
        self._links: frozenset[str] = frozenset()
        self._query: PendingQuery | None = None
        self._asked_s = self._changed_s = float("-inf")

    def step(self, now_s: float) -> set[str]:
        """Ask when it is time to. Return the robots that answered since the last step."""
        links = self._port.links()
        if links != self._links:
            # A link that is lost ends the query too, and one that is new was not asked.
            self._links, self._query, self.is_answered, self._changed_s = links, None, False, now_s
        if self._query is not None and self._query.is_over:
            self.is_answered = not self._query.timed_out
            self._query = None
        if self._query is None and links and now_s - self._asked_s >= REPEAT_S:
            self._asked_s = now_s
            self._query = self._port.call_roll(TIMEOUT_S)
        if self._query is None:
            return set()
        names = {keys.robot_of_liveliness(self._root, received.key) for received in self._query.poll()}
        answered = {name for name in names if name is not None}
        if not answered <= self.robots:
            # A peer answers from what it was told so far: while it is told of others, that is not all.
            self._changed_s = now_s
        self.robots |= answered
        return answered

    def is_complete(self, now_s: float) -> bool:
        """Report whether everybody has answered, and no other robot has appeared for a while."""
        return self.is_answered and now_s - self._changed_s >= SETTLE_S


def who_is_there(settings: Settings, robot: str) -> str:
    """Return the end of a message that this robot was not found: those that are, or '' if it is one of them.

    Raises:
        CommandError: an endpoint is not of its form.
    """
    deadline_s = time.monotonic() + SETTLE_S
    with CommandPort.open(settings, keys.ALL, login_operator()) as port:
        roll = RollCall(port, settings.robot.root)
        while (now_s := time.monotonic()) < deadline_s:
            roll.step(now_s)
            time.sleep(POLL_S)
        if robot in roll.robots or not port.connected():
            return ""
    names = sorted(roll.robots, key=keys.in_order)
    more = f" and {len(names) - NAMES_SHOWN} more" if len(names) > NAMES_SHOWN else ""
    return f"; connected: {', '.join(names[:NAMES_SHOWN])}{more}" if names else "; no robot is connected"
