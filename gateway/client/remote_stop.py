"""The remote stop, and the roll of robots that it can reach.

Finds out which robots are connected.

The remote stop from the operator's side: it is said again and again until it is known to have been heard.

It needs no lease, no answer and no state of the robot; it goes out as a put and as a query. Anyone can answer the
query in the robot's place: so a stop is believed when all replies agree, and the robot is seen to stand, latched.
In signed mode only what the robots signed counts as known, and a signed stop follows the one without a proof. What
was answered and seen, and cannot be verified, is reported as such.
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

ROLL_REPEAT_S: Final = 0.5
"""The period in which it is asked who is connected."""

TIMEOUT_S: Final = 5.0
"""So long an answer to that is waited for, before it is asked anew."""

SETTLE_S: Final = 1.0
"""The time after which no other robot is expected: nodes find each other by gossip in less."""

NAMES_SHOWN: Final = 10

ROLL_POLL_S: Final = 0.02


class RollCall:
    """Asks again and again who is connected. On a busy network robots answer later than they follow each other."""

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
        if self._query is None and links and now_s - self._asked_s >= ROLL_REPEAT_S:
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
            time.sleep(ROLL_POLL_S)
        if robot in roll.robots or not port.connected():
            return ""
    names = sorted(roll.robots, key=keys.in_order)
    more = f" and {len(names) - NAMES_SHOWN} more" if len(names) > NAMES_SHOWN else ""
    return f"; connected: {', '.join(names[:NAMES_SHOWN])}{more}" if names else "; no robot is connected"


STOP: Final = BY_VERB[STOP_VERB]

REPEAT_S: Final = 0.05
"""The put is repeated this often."""

AT_LEAST_S: Final = 0.3
"""It is repeated for this long, whoever has answered."""

ASK_S: Final = 0.25
"""A query without any answer is put again after this time."""

POLL_S: Final = 0.005

REST_S: Final = 8.0
"""From full speed to standing by takes less: the ramp, a second of holding, half a second of disabling."""


class NotSentError(CommandError):
    """No session opened, so nothing was sent, and no robot is stopped."""

    def __init__(self, cause: CommandError) -> None:
        super().__init__(f"no stop was sent: {cause}", cause.code)
        self.cause = cause


class Unverified(msgspec.Struct, frozen=True):
    """The word of a robot, or of somebody in its place: in signed mode, and not verified.

    Attributes:
        stops: all answers are that it stops, and all that was received of it shows that it stands, latched.
        why: the reason for which they cannot be verified.
        cure: the way to make it succeed; empty if ``why`` has it.
    """

    stops: bool
    says: str
    why: str
    cure: str


class StopReport(msgspec.Struct, frozen=True):
    """The outcome of a remote stop.

    Attributes:
        stopped: the robots that answered that they stop, and are seen to stand, latched.
        refused: what those said that cannot stop.
        unconfirmed: why the others that answered are not known to have stopped.
        silent: robots that are connected and did not answer.
        linked: this end was connected to a Zenoh node.
        counted: it is known which robots are connected. Where it is not, there may be more than those named here.
        unverified: robots of which there is no verified answer, and another that cannot be verified.
        seen: the states of those that are silent, in words.
        reached_all: false where a stop of all at once was sent with a certificate that stops one robot alone.
        unfinished: robots that stopped, and whose stop sequence was waited for and not seen to end.
    """

    stopped: list[str]
    refused: dict[str, str]
    unconfirmed: dict[str, str]
    silent: list[str]
    linked: bool
    counted: bool = True
    unverified: dict[str, Unverified] = {}
    seen: dict[str, str] = {}
    reached_all: bool = True
    unfinished: list[str] = []


Seen = tuple[int, str, SafetyState | RobotState | PayloadFault]
"""When a sample was read, monotonic, in ns; the robot's name; its message, or why that cannot be read."""


class Unproven(msgspec.Struct, frozen=True):
    """A sample that cannot be verified."""

    seen: Seen


Look = Callable[[], Iterable[Seen | Missed | Unproven]]
"""All that robots have published since the last call, and where some of it may be missing."""

Doubt = Callable[[str], Unmet]
"""The reason for which an answer of a robot cannot be verified."""

Told = Callable[[StopReport], None]
"""Hears the report as soon as it is known, before the end of the stop sequences is waited for."""


def stop_from_here(
    settings: Settings,
    robot: str,
    operator: str,
    timeout_s: float,
    stopped: Callable[[], bool] = lambda: False,
    *,
    told: Told | None = None,
) -> StopReport:
    """Stop a robot, several by a pattern, or all with ``keys.ALL``, over sessions of our own.

    Args:
        settings: where the robots are, and in signed mode where keys and grant are.
        operator: who stops; if empty, the name of the grant, or else the login name.
        stopped: gives up when it turns true.
        told: with it the end of the stop sequences is waited for too.

    Raises:
        NotSentError: no session opens, or a name or an endpoint is not of its form.
        CommandError: the session ended after the stop was sent.
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

        def look() -> Iterator[Seen | Missed | Unproven]:
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
        if told is None:
            return report
        told(report)
        end_s = time.monotonic() + REST_S
        while (unfinished := stopping.unfinished(report.stopped)) and not stopped() and time.monotonic() < end_s:
            stopping.hear()
            time.sleep(POLL_S)
        return msgspec.structs.replace(report, unfinished=unfinished)


def _unsigned(_robot: str) -> Unmet:
    return UNSIGNED


def _read(heard: Iterable[Arrival], proof: StopProof | None) -> Iterator[Seen | Missed | Unproven]:
    for one in heard:
        now_ns = time.monotonic_ns()
        if isinstance(one, Missed):
            yield one
        sample = read_sample(one) if isinstance(one, Received) else None
        if sample is None or sample.parts.subject.type not in {SafetyState, RobotState}:
            continue
        if isinstance(sample.message, SafetyState | RobotState | PayloadFault):
            seen = now_ns, sample.parts.robot, sample.message
            is_believed = proof is None or (isinstance(one, Received) and proof.believes(one))
            yield seen if is_believed else Unproven(seen)


def stop(
    port: CommandPort,
    root: str,
    robot: str,
    timeout_s: float,
    look: Look,
    stopped: Callable[[], bool] = lambda: False,
    doubt: Doubt = _unsigned,
) -> StopReport:
    """Stop a robot, or several; returns once all stand or cannot be stopped, or after the timeout.

    Args:
        stopped: gives up when it turns true.
        doubt: why an answer that the port does not accept cannot be verified.

    Raises:
        CommandError: the session is closed.
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


_UNCONFIRMED: Final = "its speed reads 0, which no feedback has confirmed"


class _Sight:
    """The evidence that a robot is latched, and that it stands.

    Attributes:
        rests: no stop sequence is under way, by its newest state.
    """

    def __init__(self) -> None:
        self._latch, self._stand = Evidence(), Evidence()
        self._speed_mps: float | None = None
        self._says = False
        self._is_confirmed = True
        self._unreadable = ""
        self.rests = False

    def see(self, message: SafetyState | RobotState | PayloadFault, now_ns: int) -> None:
        """It published this."""
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
        """The reason for which it is not known to have stopped; empty if it is."""
        if self._unreadable and not (self._latch.is_enough and self._stand.is_enough):
            return f"it cannot be seen: {self._unreadable}"
        if not self._latch.is_enough:
            return "its safety/state says so too briefly" if self._says else "its safety/state does not say so"
        if self._speed_mps is None:
            return "its speed is not seen"
        if self._stand.is_enough:
            return ""
        if self._speed_mps >= STANDSTILL_MPS:
            return f"it is seen to move at {self._speed_mps:.2f} m/s"
        return "it is seen to stand too briefly" if self._is_confirmed else _UNCONFIRMED

    @property
    def words(self) -> str:
        """The newest of what was received, for a robot that answers nothing."""
        latched = "a remote stop is latched" if self._says else "no remote stop is latched"
        if self._speed_mps is None:
            return f"its states say: {latched}, and no speed"
        stands = "it stands" if self._is_confirmed else _UNCONFIRMED
        motion = stands if self._speed_mps < STANDSTILL_MPS else f"it moves at {self._speed_mps:.2f} m/s"
        return f"its states say: {latched}, and {motion}"


class _Testimony:
    """All that was answered and seen, either verified or not."""

    def __init__(self) -> None:
        self.answers: dict[str, Reply | str] = {}
        self._sights: defaultdict[str, _Sight] = defaultdict(_Sight)
        self._replies: defaultdict[tuple[str, int], list[Reply | PayloadFault]] = defaultdict(list)
        self._contradicted: set[str] = set()

    def hear(self, robot: str, received: Received, question: int) -> None:
        """A robot, or somebody in its place, replied to the question of this number."""
        reply = read_reply(STOP, received)
        replies = self._replies[robot, question]
        replies.append(reply)
        if contradict(replies):
            self._contradicted.add(robot)
        if isinstance(reply, Reply) or robot not in self.answers:
            self.answers[robot] = reply if isinstance(reply, Reply) else reply.detail

    def see(self, seen: Seen) -> None:
        """A robot published this."""
        now_ns, name, message = seen
        self._sights[name].see(message, now_ns)

    def miss(self) -> None:
        """Samples may be missing."""
        self._sights.clear()

    def is_settled(self, name: str) -> bool:
        """Nothing more is to be learned: it stands, cannot be stopped, or is answered for by two."""
        return name in self._contradicted or not _agrees(self.answers[name]) or not self._sights[name].doubt

    def refusal(self, name: str) -> str:
        """The reply of a robot that cannot stop, in words; empty if it can."""
        answer = self.answers[name]
        if name in self._contradicted or _agrees(answer):
            return ""
        return answer if isinstance(answer, str) else f"{answer.reason.value}: {answer.detail}"

    def doubt(self, name: str) -> str:
        """The reason for which a robot that agreed is not known to have stopped; empty if it is."""
        if name in self._contradicted:
            return CONTRADICTION
        doubt = self._sights[name].doubt
        return f"it replied that it stops, but {doubt}" if doubt else ""

    def rests(self, name: str) -> bool:
        """No stop sequence of the robot is under way."""
        return self._sights[name].rests

    def shows(self, name: str) -> str:
        """The states of a robot, in words; empty if none was received."""
        return self._sights[name].words if name in self._sights else ""


class _Stopping:
    """A remote stop that is under way."""

    def __init__(self, port: CommandPort, root: str, robot: str, look: Look, doubt: Doubt = _unsigned) -> None:
        self._port = port
        self._look = look
        self._doubt = doubt
        self._proven, self._unproven = _Testimony(), _Testimony()
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
        """It is known who is there, all of them have answered, and somebody has."""
        answers = self._proven.answers
        return bool(answers) and self._is_counted and self._expected <= answers.keys()

    @property
    def all_settled(self) -> bool:
        """Nothing more is to be learned of anybody."""
        return self.all_answered and all(map(self._proven.is_settled, self._proven.answers))

    def step(self, now_s: float) -> None:
        """Say it, and hear."""
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
        self.hear()

    def hear(self) -> None:
        """Hear who answers, and who stands."""
        for number, question in self._questions:
            for received in question.poll():
                self._proven.hear(self._robot_in(received), received, number)
            while question.rejected:
                received = question.rejected.popleft()
                self._unproven.hear(self._robot_in(received), received, number)
        for seen in self._look():
            match seen:
                case Missed():
                    self._proven.miss()
                    self._unproven.miss()
                case Unproven(one):
                    self._unproven.see(one)
                case _:
                    self._proven.see(seen)

    def unfinished(self, robots: Iterable[str]) -> list[str]:
        """Return those of these robots whose stop sequence is under way."""
        return [name for name in robots if not self._proven.rests(name)]

    def report(self) -> StopReport:
        """Return who answered, and who did not."""
        stopped: list[str] = []
        refused: dict[str, str] = {}
        unconfirmed: dict[str, str] = {}
        for name in sorted(self._proven.answers):
            if refusal := self._proven.refusal(name):
                refused[name] = refusal
            elif doubt := self._proven.doubt(name):
                unconfirmed[name] = doubt
            else:
                stopped.append(name)
        unverified = {
            name: self._word_of(name)
            for name in sorted(self._unproven.answers.keys() - self._proven.answers.keys())
        }
        silent = sorted(self._expected - self._proven.answers.keys() - unverified.keys())
        seen = {name: words for name in silent if (words := self._seen(name))}
        return StopReport(
            stopped, refused, unconfirmed, silent, self._linked, self._is_counted, unverified=unverified, seen=seen
        )

    def _word_of(self, name: str) -> Unverified:
        unproven, unmet = self._unproven, self._doubt(name)
        refusal, doubt = unproven.refusal(name), unproven.doubt(name)
        says = f"it replied that it is not stopped: {refusal}" if refusal else doubt
        stands = "it replied that it stops, and its states show that it stands, latched"
        return Unverified(not says, says or stands, unmet.text, unmet.cure)

    def _seen(self, name: str) -> str:
        words = self._proven.shows(name)
        if words:
            return words
        words = self._unproven.shows(name)
        return f"{words}, which cannot be verified: {self._doubt(name).text}" if words else ""

    def _ask(self) -> PendingQuery:
        return self._port.begin(STOP.verb, b"", 1.0)

    def _robot_in(self, received: Received) -> str:
        match = self._robot_of.fullmatch(received.key)
        return match[1] if match is not None else self._robot


def _agrees(answer: Reply | str) -> bool:
    return isinstance(answer, Reply) and answer.ok
