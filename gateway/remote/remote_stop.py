"""The remote stop from the operator's side: it is said again and again until it is known to have been heard.

It needs no lease, no answer and no state of the robot; it goes out as a put and as a query.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from typing import Final

import msgspec

from gateway.ports.zenoh_operator import CommandPort, Question
from gateway.remote.reply import read_reply
from gateway.telemetry.heard import Received
from schemas import keys
from schemas.decisions import Reply
from schemas.subjects import BY_VERB, STOP_VERB

STOP: Final = BY_VERB[STOP_VERB]

REPEAT_S: Final = 0.05
"""The put is repeated this often."""

AT_LEAST_S: Final = 0.3
"""It is repeated for this long, whoever has answered."""

ASK_S: Final = 0.25
"""A query without any answer is put again after this time."""

ROLL_S: Final = 0.5
"""How often it is asked who is connected, where all robots are to stop."""

SETTLE_S: Final = 1.0
"""A fleet is looked for at least this long: nodes find each other by gossip in less."""

POLL_S: Final = 0.005


class StopReport(msgspec.Struct, frozen=True):
    """What became of a remote stop.

    Attributes:
        stopped: the robots that answered that they stop.
        refused: what the others that answered said.
        silent: robots that are connected and did not answer.
        linked: this end was connected to a Zenoh node.
    """

    stopped: list[str]
    refused: dict[str, str]
    silent: list[str]
    linked: bool


def stop(
    port: CommandPort, root: str, robot: str, timeout_s: float, stopped: Callable[[], bool] = lambda: False
) -> StopReport:
    """Stop a robot, or all with ``keys.ALL``; returns once it is known who heard, or after the timeout.

    Raises:
        CommandError: the session is closed.
    """
    stopping = _Stopping(port, root, robot)
    started_s = time.monotonic()
    at_least_s = SETTLE_S if robot == keys.ALL else AT_LEAST_S
    while not stopped():
        now_s = time.monotonic()
        stopping.step(now_s)
        elapsed_s = now_s - started_s
        if elapsed_s >= timeout_s or (elapsed_s >= at_least_s and stopping.all_answered):
            break
        time.sleep(POLL_S)
    return stopping.report()


class _Stopping:
    """A remote stop that is under way."""

    def __init__(self, port: CommandPort, root: str, robot: str) -> None:
        self._port = port
        self._robot = robot
        self._robot_of = re.compile(rf"{re.escape(root)}/({keys.ROBOT_PATTERN})/.*")
        self._root = root
        self._answers: dict[str, Reply | str] = {}
        self._expected = set() if robot == keys.ALL else {robot}
        self._questions: list[Question] = []
        self._rolls: list[Question] = []
        self._put_s = self._ask_s = self._roll_s = float("-inf")
        self._linked = False

    @property
    def all_answered(self) -> bool:
        """Whoever is known to be there has answered, and somebody has."""
        return bool(self._answers) and self._expected <= self._answers.keys()

    def step(self, now_s: float) -> None:
        """Say it, and hear who answers."""
        self._linked = self._linked or self._port.connected()
        if now_s - self._put_s >= REPEAT_S:
            self._put_s = now_s
            self._port.put(STOP.verb, b"")
        if now_s - self._ask_s >= ASK_S and not self.all_answered:
            self._ask_s = now_s
            self._questions = [*(one for one in self._questions if not one.is_over), self._ask()]
        if self._robot == keys.ALL and now_s - self._roll_s >= ROLL_S:
            self._roll_s = now_s
            self._rolls = [*(one for one in self._rolls if not one.is_over), self._port.call_roll(1.0)]
        for question in self._questions:
            for received in question.poll():
                self._hear(received)
        for roll in self._rolls:
            for received in roll.poll():
                robot = keys.robot_of_liveliness(self._root, received.key)
                if robot is not None:
                    self._expected.add(robot)

    def report(self) -> StopReport:
        """Who answered, and who did not."""
        stopped = {name for name, answer in self._answers.items() if isinstance(answer, Reply) and answer.ok}
        refused = {
            name: answer if isinstance(answer, str) else f"{answer.reason.value}: {answer.detail}"
            for name, answer in sorted(self._answers.items())
            if name not in stopped
        }
        silent = sorted(self._expected - self._answers.keys())
        return StopReport(sorted(stopped), refused, silent, self._linked)

    def _ask(self) -> Question:
        return self._port.begin(STOP.verb, b"", 1.0)

    def _hear(self, received: Received) -> None:
        match = self._robot_of.fullmatch(received.key)
        robot = match[1] if match is not None else self._robot
        reply = read_reply(STOP, received)
        if isinstance(reply, Reply) or robot not in self._answers:
            self._answers[robot] = reply if isinstance(reply, Reply) else reply.detail
