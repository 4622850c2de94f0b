"""The remote stop from the operator's side, and the list of connected robots.

The stop is repeated until a reply shows that it arrived. It needs no lease, no reply and no state of the robot,
and goes out as a put and as a query. Anyone can reply in the robot's place. So a stop is believed only if all
replies agree, and the robot is seen at standstill with the stop latched. In signed mode only signed replies and
samples count, and a signed stop follows the unsigned one.
"""

from __future__ import annotations

import re
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from typing import Final

import msgspec

from gateway.authority.session import UNSIGNED, Unmet
from gateway.client.fleet import CONTRADICTION, contradict, read_reply, read_sample
from gateway.client.proof import Evidence, StopProof, stop_proof
from gateway.telemetry.samples import Arrival, Missed, Received
from gateway.zenoh.client import PendingQuery, RobotListener
from gateway.zenoh.operator import CommandPort
from schemas import keys
from schemas.codec import PayloadFault
from schemas.command_line import CommandError
from schemas.decisions import ArbiterState, Reply, SafetyState
from schemas.keys import login_operator
from schemas.messages import RobotState
from schemas.reasons import Reason
from schemas.settings import STANDSTILL_MPS, Settings
from schemas.subjects import BY_VERB, STOP_VERB

ROLL_REPEAT_S: Final = 0.5  # period of queries for connected robots
TIMEOUT_S: Final = 5.0  # their timeout
SETTLE_S: Final = 1.0  # the time after which no other robot is expected: nodes find each other by gossip in less
NAMES_SHOWN: Final = 10

ROLL_POLL_S: Final = 0.02


class RollCall:
    """Lists connected robots repeatedly: on a busy network some replies are late."""

    def __init__(self, port: CommandPort | RobotListener, root: str) -> None:
        self.robots: set[str] = set()
        self.is_answered = False
        self._port = port
        self._root = root
        self._links: frozenset[str] = frozenset()
        self._query: PendingQuery | None = None
        self._asked_s = self._changed_s = float("-inf")

    def step(self, now_s: float) -> set[str]:
        """Query when it is due. Return the robots that replied since the last step."""
        links = self._port.links()
        if links != self._links:
            # A lost link ends the query, and a new link was not queried.
            self._links, self._query, self.is_answered, self._changed_s = links, None, False, now_s
        if self._query is not None and self._query.is_over:
            self.is_answered = not self._query.timed_out
            self._query = None
        if self._query is None and links and now_s - self._asked_s >= ROLL_REPEAT_S:
            self._asked_s = now_s
            self._query = self._port.call_roll(TIMEOUT_S)
        if self._query is None:
            return set()
        names = {keys.robot_of_liveliness(self._root, received.key) for received in self._query.poll()}
        answered = {name for name in names if name is not None}
        if not answered <= self.robots:
            # A peer knows only part of the tokens while new ones arrive.
            self._changed_s = now_s
        self.robots |= answered
        return answered

    def is_complete(self, now_s: float) -> bool:
        """Return True if all nodes have replied, and no other robot has appeared for a while."""
        return self.is_answered and now_s - self._changed_s >= SETTLE_S


def who_is_there(settings: Settings, robot: str) -> str:
    """Return the other connected robots, as the end of an error; '' if this robot is connected."""
    deadline_s = time.monotonic() + SETTLE_S
    with CommandPort.open(settings, keys.ALL, login_operator()) as port:
        roll = RollCall(port, settings.robot.root)
        while (now_s := time.monotonic()) < deadline_s:
            roll.step(now_s)
            time.sleep(ROLL_POLL_S)
        if robot in roll.robots or not port.connected():
            return ""
    names = sorted(roll.robots, key=keys.in_order)
    more = f" and {len(names) - NAMES_SHOWN} more" if len(names) > NAMES_SHOWN else ""
    return f"; connected: {', '.join(names[:NAMES_SHOWN])}{more}" if names else "; no robot is connected"


STOP: Final = BY_VERB[STOP_VERB]

REPEAT_S: Final = 0.05  # the put is repeated this often
AT_LEAST_S: Final = 0.3  # shortest time of repeating, even after replies
ASK_S: Final = 0.25  # a query without any answer is put again after this time
POLL_S: Final = 0.005

REST_S: Final = (
    8.0  # from full speed to standby takes less: the ramp, a second of holding, half a second of disabling
)


class NotSentError(CommandError):
    """No session opened, so no stop was sent."""

    def __init__(self, cause: CommandError) -> None:
        super().__init__(f"no stop was sent: {cause}", cause.code)
        self.cause = cause


class StopReport(msgspec.Struct, frozen=True):
    """The outcome of a remote stop.

    Attributes:
        stopped: robots that replied that they stop, and are seen to stand with the stop latched.
        refused: robots that cannot stop, and why.
        unconfirmed: other robots that replied, and why they may not have stopped.
        silent: connected robots without a reply.
        linked: this end was connected to a Zenoh node.
        counted: all connected robots are known; else there may be more.
        unverified: further robots, and why their replies cannot be verified.
        reached_all: false if all were to be stopped with a certificate that can stop only one robot at a time.
        unfinished: stopped robots whose stop sequence did not end within the wait.
    """

    stopped: list[str]
    refused: dict[str, str]
    unconfirmed: dict[str, str]
    silent: list[str]
    linked: bool
    counted: bool = True
    unverified: dict[str, Unmet] = {}
    reached_all: bool = True
    unfinished: list[str] = []


Seen = tuple[int, str, SafetyState | RobotState | PayloadFault]
"""Time of reading (monotonic, ns), robot, and message or why it cannot be read."""


Look = Callable[[], Iterable[Seen | Missed]]
"""All believed samples since the last call, and where some may be missing."""

Doubt = Callable[[str], Unmet]  # the reason for which an answer of a robot cannot be verified
Told = Callable[[StopReport], None]  # gets the report before the end of the stop sequences


def stop_from_here(
    settings: Settings,
    robot: str,
    operator: str,
    timeout_s: float,
    stopped: Callable[[], bool] = lambda: False,
    *,
    wait: bool = False,
    told: Told = lambda _report: None,
) -> StopReport:
    """Stop a robot, several by a pattern, or all with ``keys.ALL``, over new sessions.

    Args:
        operator: if empty, the name of the grant, or else the login name.
        stopped: gives up when it returns True.
        wait: for the end of the stop sequences too.
        told: gets the report before that wait.
    """
    root = settings.robot.root
    with ExitStack() as stack:
        try:
            proof = stop_proof(settings)
            name = operator or (proof.name if proof is not None else "") or login_operator()
            port = stack.enter_context(CommandPort.open(settings, keys.chunk_of(robot), name))
        except CommandError as error:
            raise NotSentError(error) from error
        port.prover = proof
        listeners: list[RobotListener] = []

        def look() -> Iterator[Seen | Missed]:
            if not listeners:  # Only now: the stop has been sent.
                name = "" if robot == keys.ALL else robot
                listeners.append(stack.enter_context(RobotListener.open(settings, name)))
            if proof is not None:
                proof.meet(port)
            for one in _read(listeners[0].drain(), proof):
                if proof is not None and isinstance(one, tuple) and isinstance(one[2], SafetyState):
                    proof.sign(port, one[1], one[2].challenge)
                yield one

        stopping = _Stopping(port, root, robot, look, _unsigned if proof is None else proof.doubt)
        reached_all = proof is None or robot != keys.ALL or proof.may_stop_all
        report = msgspec.structs.replace(_settle(stopping, timeout_s, stopped), reached_all=reached_all)
        told(report)
        if not wait:
            return report
        end_s = time.monotonic() + REST_S
        while (unfinished := stopping.unfinished(report.stopped)) and not stopped() and time.monotonic() < end_s:
            stopping.hear()
            time.sleep(POLL_S)
        return msgspec.structs.replace(report, unfinished=unfinished)


def _unsigned(_robot: str) -> Unmet:
    return UNSIGNED


def _read(heard: Iterable[Arrival], proof: StopProof | None) -> Iterator[Seen | Missed]:
    for one in heard:
        now_ns = time.monotonic_ns()
        if isinstance(one, Missed):
            yield one
        elif isinstance(one, Received) and (proof is None or proof.believes(one)):
            sample = read_sample(one)
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
    doubt: Doubt = _unsigned,
) -> StopReport:
    """Stop a robot or several. Returns when all stand or cannot be stopped, or after the timeout.

    ``stopped`` gives up when it returns True; ``doubt`` says why a rejected reply cannot be verified.
    """
    return _settle(_Stopping(port, root, robot, look, doubt), timeout_s, stopped)


def _settle(stopping: _Stopping, timeout_s: float, stopped: Callable[[], bool]) -> StopReport:
    started_s = time.monotonic()
    while True:
        now_s = time.monotonic()
        stopping.step(now_s)
        elapsed_s = now_s - started_s
        if stopped() or elapsed_s >= timeout_s or (elapsed_s >= AT_LEAST_S and stopping.all_settled):
            break
        time.sleep(POLL_S)
    return stopping.report()


_UNCONFIRMED: Final = "its speed reads 0, not confirmed by feedback"


class _Sight:
    """Evidence that a robot is latched and at standstill.

    Attributes:
        rests: its newest state shows no stop sequence.
    """

    def __init__(self) -> None:
        self._latch, self._stand = Evidence(), Evidence()
        self._speed_mps: float | None = None
        self._says = False
        self._is_confirmed = True
        self._unreadable = ""
        self.rests = False

    def see(self, message: SafetyState | RobotState | PayloadFault, now_ns: int) -> None:
        if isinstance(message, PayloadFault):
            self._unreadable = message.detail
            return
        if isinstance(message, SafetyState):
            self._says = Reason.REMOTE_STOP in message.latched
            self._is_confirmed = message.rest_confirmed
            self.rests = message.state is ArbiterState.STANDBY
            evidence, holds = self._latch, self._says
        else:
            speeds = (message.speed_mps, message.rear_left_speed_mps, message.rear_right_speed_mps)
            self._speed_mps = max((abs(one) for one in speeds if one is not None), default=None)
            reads_zero = self._speed_mps is not None and self._speed_mps < STANDSTILL_MPS
            evidence, holds = self._stand, reads_zero and self._is_confirmed
        if holds:
            evidence.add(now_ns)
        else:
            evidence.clear()

    @property
    def doubt(self) -> str:
        """Why the robot may not have stopped; empty if it has."""
        if self._unreadable and not (self._latch.is_enough and self._stand.is_enough):
            return f"its state cannot be read: {self._unreadable}"
        if not self._latch.is_enough:
            return "its safety/state shows it too briefly" if self._says else "its safety/state does not show it"
        if self._speed_mps is None:
            return "its speed is unknown"
        if self._stand.is_enough:
            return ""
        if self._speed_mps >= STANDSTILL_MPS:
            return f"it moves at {self._speed_mps:.2f} m/s"
        return "it has stood too briefly" if self._is_confirmed else _UNCONFIRMED


class _Stopping:
    """A remote stop in progress: replies, samples, and in signed mode their proofs."""

    def __init__(self, port: CommandPort, root: str, robot: str, look: Look, doubt: Doubt = _unsigned) -> None:
        self._port = port
        self._look = look
        self._doubt = doubt
        self._answers: dict[str, Reply | str] = {}
        self._unverified: set[str] = set()
        self._sights: defaultdict[str, _Sight] = defaultdict(_Sight)
        self._replies: defaultdict[tuple[str, int], list[Reply | PayloadFault]] = defaultdict(list)
        self._contradicted: set[str] = set()
        self._robot = robot
        self._robot_of = re.compile(rf"{re.escape(root)}/({keys.ROBOT_PATTERN})/.*")
        is_one = "*" not in robot
        self._expected = {robot} if is_one else set()
        self._questions: list[tuple[int, PendingQuery]] = []
        self._asked = 0
        self._roll = None if is_one else RollCall(port, root)
        self._is_counted = is_one
        self._put_s = self._ask_s = float("-inf")
        self._linked = False

    @property
    def all_answered(self) -> bool:
        """All robots are known and have replied, and there is at least one."""
        return bool(self._answers) and self._is_counted and self._expected <= self._answers.keys()

    @property
    def all_settled(self) -> bool:
        """Nothing more can be learned: each robot has stopped, cannot stop, or has contradictory replies."""
        return self.all_answered and all(
            name in self._contradicted or not _agrees(answer) or not self._sights[name].doubt
            for name, answer in self._answers.items()
        )

    def step(self, now_s: float) -> None:
        self._linked = self._linked or self._port.connected()
        if now_s - self._put_s >= REPEAT_S:
            self._put_s = now_s
            self._port.put(STOP.verb, b"")
        if now_s - self._ask_s >= ASK_S and not self.all_answered:
            self._ask_s = now_s
            self._asked += 1
            question = self._port.begin(STOP.verb, b"", 1.0)
            self._questions = [*(one for one in self._questions if not one[1].is_over), (self._asked, question)]
        if self._roll is not None:
            self._expected |= self._roll.step(now_s)
            self._is_counted = self._roll.is_complete(now_s)
        self.hear()

    def hear(self) -> None:
        for number, question in self._questions:
            for received in question.poll():
                self._hear(self._robot_in(received), received, number)
            while question.rejected:
                self._unverified.add(self._robot_in(question.rejected.popleft()))
        for seen in self._look():
            if isinstance(seen, Missed):
                self._sights.clear()
            else:
                now_ns, name, message = seen
                self._sights[name].see(message, now_ns)

    def unfinished(self, robots: Iterable[str]) -> list[str]:
        """Return those robots whose stop sequence has not ended."""
        return [name for name in robots if not self._sights[name].rests]

    def report(self) -> StopReport:
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
        unverified = {name: self._doubt(name) for name in sorted(self._unverified - self._answers.keys())}
        silent = sorted(self._expected - self._answers.keys() - unverified.keys())
        return StopReport(
            stopped, refused, unconfirmed, silent, self._linked, self._is_counted, unverified=unverified
        )

    def _hear(self, robot: str, received: Received, question: int) -> None:
        """Store a reply to the question of this number."""
        reply = read_reply(STOP, received)
        replies = self._replies[robot, question]
        replies.append(reply)
        if contradict(replies):
            self._contradicted.add(robot)
        if isinstance(reply, Reply) or robot not in self._answers:
            self._answers[robot] = reply if isinstance(reply, Reply) else reply.detail

    def _robot_in(self, received: Received) -> str:
        match = self._robot_of.fullmatch(received.key)
        return match[1] if match is not None else self._robot


def _agrees(answer: Reply | str) -> bool:
    return isinstance(answer, Reply) and answer.ok
