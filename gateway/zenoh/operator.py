"""Zenoh for operators: commands to robots, statements of their authorities, and what their arbiters say.

A subscriber that is slow starves whatever else is on its session, so commands share theirs with no subscriber. No
Python of ours runs on Zenoh's threads: replies and samples wait until they are asked for.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator
from typing import Any, Final, Protocol, Self, TypeVar

import zenoh
from zenoh import ext

from gateway.telemetry.samples import Missed, Received
from gateway.zenoh.client import EVENTS_OF_BEFORE, PendingQuery, SessionOwner, ask_all, call_roll, receive
from schemas import keys
from schemas.command_line import CommandError, ExitCode
from schemas.settings import Settings
from schemas.subjects import BY_NAME, BY_VERB, COMMAND_QOS
from schemas.zenoh_session import close_session, join

log = logging.getLogger(__name__)

STATES_WAITING: Final = 64
"""Safety states, 20 Hz and on change, that may wait; beyond it the oldest go."""

EVENTS_WAITING: Final = 4096


class Prover(Protocol):
    """Proves an operator's commands, and knows whose a reply is."""

    def attach(self, verb: str, payload: bytes) -> bytes:
        """The attachment of a command; empty if there is none."""

    def is_reply(self, received: Received, request: bytes) -> bool:
        """Return True if it is the asked robot's reply to the request that had this attachment."""


Owner = TypeVar("Owner", bound=SessionOwner)


def _opened(settings: Settings, make: Callable[[zenoh.Session], Owner]) -> Owner:
    """Make the owner of a session to where the settings say."""
    session = join(settings.zenoh)
    try:
        return make(session)
    except ValueError as error:
        close_session(session)
        raise CommandError(str(error), ExitCode.USAGE) from error


class CommandPort(SessionOwner):
    """Sends the commands of an operator to one robot, or stops to several by a pattern. Owns its session."""

    def __init__(self, session: zenoh.Session, root: str, robot: str, operator: str) -> None:
        """Use a session that nothing else uses. Raises ValueError: a part of the keys is not of its form."""
        super().__init__(session)
        self.operator = operator
        self.prover: Prover | None = None
        self._authority = keys.authority(root, robot)
        self._keys = {verb: keys.command(root, robot, operator, verb) for verb in BY_VERB}
        self._roll = keys.liveliness(root, robot)
        self._qos: dict[str, Any] = {
            "priority": getattr(zenoh.Priority, COMMAND_QOS.priority.value),
            "congestion_control": zenoh.CongestionControl.DROP,
            "express": COMMAND_QOS.express,
        }
        # A reply is as express as its question, and then has a batch of its own: most of a fleet's were dropped.
        self._asking_qos = self._qos | {"express": COMMAND_QOS.express and "*" not in robot}
        # Its stub says that the matching status is a bool; it is an object, and always true.
        self._querier: Any = session.declare_querier(self._keys["acquire"])

    @classmethod
    def open(cls, settings: Settings, robot: str, operator: str) -> Self:
        """Open a session to where the settings say."""
        return _opened(settings, lambda session: cls(session, settings.robot.root, robot, operator))

    def reaches(self) -> bool:
        """Return True if somebody answers this robot's commands. For a port to all robots Zenoh cannot know."""
        return bool(self._querier.matching_status.matching)

    def put(self, verb: str, payload: bytes) -> None:
        """Send without waiting for anything. It goes out or is dropped: this neither blocks nor raises."""
        self.put_signed(
            self._keys[verb], verb, payload, b"" if self.prover is None else self.prover.attach(verb, payload)
        )

    def put_signed(self, key: str, verb: str, payload: bytes, attachment: bytes) -> None:
        """Send under a key of one's own, with its proof, and as ``put`` does."""
        encoding = BY_VERB[verb].encoding
        try:
            self._session.put(key, payload, encoding=encoding, attachment=attachment or None, **self._qos)
        except zenoh.ZError as error:
            log.debug("Zenoh did not take %s: %s", verb, error)

    def begin(self, verb: str, payload: bytes, timeout_s: float) -> PendingQuery:
        """Ask, and come back for the replies later."""
        prover = self.prover
        if prover is None:
            return self.query(self._keys[verb], PendingQuery(), payload, BY_VERB[verb].encoding, b"", timeout_s)
        attachment = prover.attach(verb, payload)
        question = PendingQuery(lambda received: prover.is_reply(received, attachment))
        return self.query(self._keys[verb], question, payload, BY_VERB[verb].encoding, attachment, timeout_s)

    def show(self, statement: bytes, question: bytes, timeout_s: float) -> list[Received]:
        """Show a statement of the authority. Returns the replies that came, not verified."""
        return self.begin_to_show(statement, question, timeout_s).wait(timeout_s)

    def begin_to_show(self, statement: bytes, question: bytes, timeout_s: float) -> PendingQuery:
        """Show a statement of the authority, with a drawn question, and come back for the replies later."""
        return self.query(self._authority, PendingQuery(), statement, "text/plain", question, timeout_s)

    def query(
        self, key: str, question: PendingQuery, payload: bytes, encoding: str, attachment: bytes, timeout_s: float
    ) -> PendingQuery:
        """Ask under a key of one's own; the replies are the question's."""
        more = {"payload": payload, "encoding": encoding, "attachment": attachment or None, **self._asking_qos}
        return ask_all(self._session, key, question, timeout_s, **more)

    def ask(self, verb: str, payload: bytes, timeout_s: float) -> list[Received]:
        """Ask, and wait for all replies; after the first, others have ``FURTHER_S`` to come."""
        return self.begin(verb, payload, timeout_s).wait(timeout_s)

    def call_roll(self, timeout_s: float) -> PendingQuery:
        """Ask for the liveliness tokens of the robots that are connected."""
        return call_roll(self._session, self._roll, timeout_s)


class SafetyListener(SessionOwner):
    """A listener to a robot's arbiter, its state and its gateway's health. Owns its session."""

    def __init__(self, session: zenoh.Session, root: str, robot: str) -> None:
        """Subscribe on a session. Raises ValueError: a part of the keys is not of its form."""
        super().__init__(session)
        state, event, chassis, health = (
            keys.build(root, robot, BY_NAME[name])
            for name in ("safety/state", "safety/event", "state", "gateway/health")
        )
        # Without history: an old tick is worse than none.
        self._subscribers: tuple[Any, ...] = tuple(
            session.declare_subscriber(key, zenoh.handlers.RingChannel(STATES_WAITING))
            for key in (state, chassis, health)
        )
        self._events: Any = ext.declare_advanced_subscriber(
            session,
            event,
            zenoh.handlers.RingChannel(EVENTS_WAITING),
            history=ext.HistoryConfig(detect_late_publishers=True, max_samples=EVENTS_OF_BEFORE),
            recovery=ext.RecoveryConfig(heartbeat=True, periodic_queries=None),
        )

    @classmethod
    def open(cls, settings: Settings, robot: str) -> Self:
        """Open a session to where the settings say, and listen."""
        return _opened(settings, lambda session: cls(session, settings.robot.root, robot))

    def drain(self) -> Iterator[Received | Missed]:
        """Return the samples that have arrived since the last call; none once it is closed."""
        try:
            for subscriber in self._subscribers:
                yield from receive(subscriber.try_recv, STATES_WAITING)
            yield from receive(self._events.try_recv, EVENTS_WAITING)
        except zenoh.ZError as error:
            log.debug("Zenoh is closed: %s", error)


AGAIN_S: Final = 0.02
"""A robot that many ask leaves some queries unanswered, and these end at once. They are sent again after this."""


class StatementPort(SessionOwner):
    """The session that sends statements to robots and receives their answers."""

    def __init__(self, session: zenoh.Session, root: str) -> None:
        """Use a session, which the port then owns."""
        super().__init__(session)
        self._root = root

    @classmethod
    def open(cls, settings: Settings) -> Self:
        """Open a session to where the settings say."""
        return cls(join(settings.zenoh), settings.robot.root)

    def robots(self, timeout_s: float) -> list[str]:
        """The robots that are connected, by their liveliness tokens."""
        replies = call_roll(self._session, keys.liveliness(self._root), timeout_s).wait(timeout_s, timeout_s)
        found = {keys.robot_of_liveliness(self._root, reply.key) for reply in replies}
        return sorted(robot for robot in found if robot is not None)

    def show(self, robot: str, text: bytes, question: bytes, timeout_s: float) -> Received | None:
        """Show a robot a statement, again and again until it answers. Returns its answer; None if none comes."""
        deadline_s = time.monotonic() + timeout_s
        while (left_s := deadline_s - time.monotonic()) > 0:
            more = {"payload": text, "attachment": question, "congestion_control": zenoh.CongestionControl.DROP}
            asked = ask_all(self._session, keys.authority(self._root, robot), PendingQuery(), left_s, **more)
            if replies := asked.wait(left_s):
                return replies[0]
            time.sleep(AGAIN_S)
        return None
