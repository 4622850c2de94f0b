"""The remote stop from the operator's side: it is said again and again until it is known to have been heard.

It needs no lease, no answer and no state of the robot; it goes out as a put and as a query. Anyone can answer the
query in the robot's place: so a stop is believed when all replies agree, and the robot is seen to stand, latched.
In signed mode only what the robots signed counts of all this, and a signed stop follows the one without a proof.
"""

from __future__ import annotations

import re
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from typing import Final

import msgspec

from gateway.client.evidence import Evidence
from gateway.client.link_proof import StopProof, stop_proof
from gateway.client.payloads import CONTRADICTION, contradict, read_reply, read_sample
from gateway.client.roll import RollCall
from gateway.telemetry.received import Arrival, Missed, Received
from gateway.zenoh.client import PendingQuery, RobotListener
from gateway.zenoh.operator import CommandPort
from schemas import keys
from schemas.codec import PayloadFault
from schemas.decisions import Reply, SafetyState
from schemas.messages import RobotState
from schemas.operator_name import login_operator
from schemas.reasons import Reason
from schemas.settings import STANDSTILL_MPS, Settings
from schemas.subjects import BY_VERB, STOP_VERB

STOP: Final = BY_VERB[STOP_VERB]

REPEAT_S: Final = 0.05
"""The put is repeated this often."""

AT_LEAST_S: Final = 0.3
"""It is repeated for this long, whoever has answered."""

ASK_S: Final = 0.25
"""A query without any answer is put again after this time."""

POLL_S: Final = 0.005


class StopReport(msgspec.Struct, frozen=True):
    """The outcome of a remote stop.

    Attributes:
        stopped: the robots that answered that they stop, and are seen to stand, latched.
        refused: what those said that cannot stop.
        unconfirmed: why the others that answered are not known to have stopped.
        silent: robots that are connected and did not answer.
        linked: this end was connected to a Zenoh node.
        counted: it is known which robots are connected. Where it is not, there may be more than those named here.
    """

    stopped: list[str]
    refused: dict[str, str]
    unconfirmed: dict[str, str]
    silent: list[str]
    linked: bool
    counted: bool = True


Seen = tuple[int, str, SafetyState | RobotState | PayloadFault]
"""When a sample was read, monotonic, in ns; the robot's name; its message, or why that cannot be read."""

Look = Callable[[], Iterable[Seen | Missed]]
"""All that robots have published since the last call, and where some of it may be missing."""


def stop_from_here(
    settings: Settings, robot: str, operator: str, timeout_s: float, stopped: Callable[[], bool] = lambda: False
) -> StopReport:
    """Stop a robot, or all with ``keys.ALL``, over sessions of our own.

    Args:
        settings: where the robots are, and in signed mode where keys and grant are.
        robot: its name.
        operator: who stops; if empty, the name of the grant, or else the login name.
        timeout_s: how long to wait.
        stopped: gives up when it turns true.

    Raises:
        CommandError: a name or an endpoint is not of its form.
    """
    root, proof = settings.robot.root, stop_proof(settings)
    name = operator or (proof.name if proof is not None else "") or login_operator()
    with ExitStack() as stack:
        port = stack.enter_context(CommandPort.open(settings, robot, name))
        port.prover = proof
        listeners: list[RobotListener] = []

        def look() -> Iterator[Seen | Missed]:
            if not listeners:  # Only now: the stop has been sent.
                name = "" if robot == keys.ALL else robot
                listeners.append(stack.enter_context(RobotListener.open(settings, name)))
            if proof is not None:
                proof.meet(port)
            for one in _read(listeners[0].drain(), proof):
                if proof is not None and not isinstance(one, Missed) and isinstance(one[2], SafetyState):
                    proof.sign(port, one[1], one[2].challenge)
                yield one

        return stop(port, root, robot, timeout_s, look, stopped)


def _read(heard: Iterable[Arrival], proof: StopProof | None) -> Iterator[Seen | Missed]:
    for one in heard:
        now_ns = time.monotonic_ns()
        if isinstance(one, Missed):
            yield one
        is_believed = isinstance(one, Received) and (proof is None or proof.believes(one))
        sample = read_sample(one) if isinstance(one, Received) and is_believed else None
        if sample is None or sample.parts.subject.type not in {SafetyState, RobotState}:
            continue
        if isinstance(sample.message, SafetyState | RobotState | PayloadFault):
            yield now_ns, sample.parts.robot, sample.message


def stop(
    port: CommandPort,
    root: str,
    robot: str,
    timeout_s: float,
    look: Look,
    stopped: Callable[[], bool] = lambda: False,
) -> StopReport:
    """Stop a robot, or all with ``keys.ALL``; returns once all stand or cannot be stopped, or after the timeout.

    Args:
        port: to the robot, or to all.
        root: of the keys.
        robot: its name.
        timeout_s: how long to wait.
        look: at what the robots publish.
        stopped: gives up when it turns true.

    Raises:
        CommandError: the session is closed.
    """
    stopping = _Stopping(port, root, robot, look)
    started_s = time.monotonic()
    while not stopped():
        now_s = time.monotonic()
        stopping.step(now_s)
        elapsed_s = now_s - started_s
        if elapsed_s >= timeout_s or (elapsed_s >= AT_LEAST_S and stopping.all_settled):
            break
        time.sleep(POLL_S)
    return stopping.report()


class _Sight:
    """The evidence that a robot is latched, and that it stands."""

    def __init__(self) -> None:
        self._latch, self._stand = Evidence(), Evidence()
        self._speed_mps: float | None = None
        self._says = False
        self._unreadable = ""

    def see(self, message: SafetyState | RobotState | PayloadFault, now_ns: int) -> None:
        """It published this."""
        if isinstance(message, PayloadFault):
            self._unreadable = message.detail
            return
        if isinstance(message, SafetyState):
            self._says = Reason.REMOTE_STOP in message.latched
            evidence, holds = self._latch, self._says
        else:
            speeds = (message.speed_mps, message.rear_left_speed_mps, message.rear_right_speed_mps)
            self._speed_mps = max((abs(one) for one in speeds if one is not None), default=None)
            evidence, holds = self._stand, self._speed_mps is not None and self._speed_mps < STANDSTILL_MPS
        if holds:
            evidence.add(now_ns)
        else:
            evidence.clear()

    @property
    def doubt(self) -> str:
        """The reason for which it is not known to have stopped; empty if it is."""
        if self._unreadable and not (self._latch.is_enough and self._stand.is_enough):
            return f"it cannot be seen: {self._unreadable}"
        if not self._latch.is_enough:
            return "its safety/state says so too briefly" if self._says else "its safety/state does not say so"
        if self._speed_mps is None:
            return "its speed is not seen"
        if self._stand.is_enough:
            return ""
        stands = self._speed_mps < STANDSTILL_MPS
        return "it is seen to stand too briefly" if stands else f"it is seen to move at {self._speed_mps:.2f} m/s"


class _Stopping:
    """A remote stop that is under way."""

    def __init__(self, port: CommandPort, root: str, robot: str, look: Look) -> None:
        self._port = port
        self._look = look
        self._sights: defaultdict[str, _Sight] = defaultdict(_Sight)
        self._replies: defaultdict[tuple[str, int], list[Reply | PayloadFault]] = defaultdict(list)
        self._contradicted: set[str] = set()
        self._robot = robot
        self._robot_of = re.compile(rf"{re.escape(root)}/({keys.ROBOT_PATTERN})/.*")
        self._answers: dict[str, Reply | str] = {}
        self._expected = set() if robot == keys.ALL else {robot}
        self._questions: list[tuple[int, PendingQuery]] = []
        self._asked = 0
        self._roll = RollCall(port, root) if robot == keys.ALL else None
        self._is_counted = robot != keys.ALL
        self._put_s = self._ask_s = float("-inf")
        self._linked = False

    @property
    def all_answered(self) -> bool:
        """It is known who is there, all of them have answered, and somebody has."""
        return bool(self._answers) and self._is_counted and self._expected <= self._answers.keys()

    @property
    def all_settled(self) -> bool:
        """Nothing more is to be learned: each of them stands, cannot be stopped, or is answered for by two."""
        return self.all_answered and all(
            name in self._contradicted or not _agrees(answer) or not self._sights[name].doubt
            for name, answer in self._answers.items()
        )

    def step(self, now_s: float) -> None:
        """Say it, and hear who answers."""
        self._linked = self._linked or self._port.connected()
        if now_s - self._put_s >= REPEAT_S:
            self._put_s = now_s
            self._port.put(STOP.verb, b"")
        if now_s - self._ask_s >= ASK_S and not self.all_answered:
            self._ask_s = now_s
            self._asked += 1
            self._questions = [*(one for one in self._questions if not one[1].is_over), (self._asked, self._ask())]
        if self._roll is not None:
            self._expected |= self._roll.step(now_s)
            self._is_counted = self._roll.is_complete(now_s)
        for number, question in self._questions:
            for received in question.poll():
                self._hear(received, number)
        for seen in self._look():
            if isinstance(seen, Missed):
                self._sights.clear()
            else:
                now_ns, name, message = seen
                self._sights[name].see(message, now_ns)

    def report(self) -> StopReport:
        """Return who answered, and who did not."""
        stopped: list[str] = []
        refused: dict[str, str] = {}
        unconfirmed: dict[str, str] = {}
        for name, answer in sorted(self._answers.items()):
            doubt = self._sights[name].doubt
            if name in self._contradicted:
                unconfirmed[name] = CONTRADICTION
            elif not _agrees(answer):
                refused[name] = answer if isinstance(answer, str) else f"{answer.reason.value}: {answer.detail}"
            elif doubt:
                unconfirmed[name] = f"it replied that it stops, but {doubt}"
            else:
                stopped.append(name)
        silent = sorted(self._expected - self._answers.keys())
        return StopReport(stopped, refused, unconfirmed, silent, self._linked, self._is_counted)

    def _ask(self) -> PendingQuery:
        return self._port.begin(STOP.verb, b"", 1.0)

    def _hear(self, received: Received, question: int) -> None:
        match = self._robot_of.fullmatch(received.key)
        robot = match[1] if match is not None else self._robot
        reply = read_reply(STOP, received)
        replies = self._replies[robot, question]
        replies.append(reply)
        if contradict(replies):
            self._contradicted.add(robot)
        if isinstance(reply, Reply) or robot not in self._answers:
            self._answers[robot] = reply if isinstance(reply, Reply) else reply.detail


def _agrees(answer: Reply | str) -> bool:
    return isinstance(answer, Reply) and answer.ok
