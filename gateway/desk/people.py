"""The words that people pass to each other through the desk: who asks for a robot, who sees to an alarm. Pure.

None of it is proven, and no robot hears of it: a lease changes hands by verbs that the robot judges.
"""

from __future__ import annotations

from typing import Final

REQUEST_NS: Final = 60_000_000_000
"""A request that nobody has answered for so long is over."""

REQUESTS_MAX: Final = 8
"""People who may ask for one robot at a time."""


class People:
    """Requests and acknowledgements of robots that are shown, until they are over."""

    def __init__(self) -> None:
        self._requests: dict[str, dict[str, int]] = {}
        self._acknowledged: dict[str, tuple[str, str]] = {}

    def ask(self, robot: str, asker: str, now_ns: int) -> None:
        """Ask whoever holds a robot's lease to hand it over.

        Raises:
            ValueError: too many ask already.
        """
        requests = self._requests.get(robot, {})
        if len(requests | {asker: 0}) > REQUESTS_MAX:
            raise ValueError("too many ask already")
        self._requests.setdefault(robot, {})[asker] = now_ns

    def answer(self, robot: str, asker: str) -> bool:
        """End a request: it was granted or refused. Returns whether there was one."""
        return self._requests.get(robot, {}).pop(asker, None) is not None

    def requests(self, robot: str, holder: str, now_ns: int) -> list[str]:
        """Return who asks for a robot, the first one first. Nobody does who holds it, or while nobody holds it."""
        requests = self._requests.pop(robot, {})
        left = {asker: at_ns for asker, at_ns in requests.items() if now_ns - at_ns < REQUEST_NS}
        left.pop(holder, None)
        if not holder or not left:
            return []
        self._requests[robot] = left
        return list(left)

    def acknowledge(self, robot: str, word: str, operator: str) -> None:
        """Say who sees to an alarm. It holds as long as the robot's word is this one."""
        self._acknowledged[robot] = word, operator

    def acknowledged(self, robot: str, word: str) -> str:
        """Return who sees to a robot's alarm; empty if nobody does."""
        known, operator = self._acknowledged.get(robot, ("", ""))
        if known == word:
            return operator
        self._acknowledged.pop(robot, None)
        return ""

    def forget(self, robot: str) -> None:
        """A robot is no longer known."""
        self._requests.pop(robot, None)
        self._acknowledged.pop(robot, None)
