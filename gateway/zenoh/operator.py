"""Zenoh for operators: commands to robots, statements of their authorities, and the states of their arbiters.

A slow subscriber starves everything else on its session, so the command session has no subscribers. No Python of
ours runs on Zenoh's threads: replies and samples wait until they are read.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator
from typing import Any, Final, Protocol, Self, TypeVar

import zenoh

from gateway.telemetry.samples import Missed, Received
from gateway.zenoh.client import PendingQuery, SessionOwner, ask_all, call_roll, declare_events, receive
from schemas import keys
from schemas.command_line import CommandError, ExitCode
from schemas.settings import Settings
from schemas.subjects import BY_NAME, BY_VERB, COMMAND_QOS
from schemas.zenoh_session import close_session, join

log = logging.getLogger(__name__)

STATES_WAITING: Final = 64  # queued safety states, 20 Hz and on change; beyond it the oldest are dropped

EVENTS_WAITING: Final = 4096


class Prover(Protocol):
    """Signs an operator's commands, and verifies replies."""

    def attach(self, verb: str, payload: bytes) -> bytes:
        """Return the attachment of a command; may be empty."""

    def is_reply(self, received: Received, request: bytes) -> bool:
        """Return True if it is the asked robot's reply to the request that had this attachment."""


Owner = TypeVar("Owner", bound=SessionOwner)


def _opened(settings: Settings, make: Callable[[zenoh.Session], Owner], *, commands: bool = False) -> Owner:
    """Open a session by the settings, and make its owner."""
    session = join(settings.zenoh, commands=commands)
    try:
        return make(session)
    except ValueError as error:
        close_session(session)
        raise CommandError(str(error), ExitCode.USAGE) from error


class CommandPort(SessionOwner):
    """Sends an operator's commands to one robot, or stops to several by a pattern. Owns its session."""

    def __init__(self, session: zenoh.Session, root: str, robot: str, operator: str) -> None:
        """Take a session of its own. Raises ValueError: a part of the keys is invalid."""
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
        # A reply to an express query is not batched, and most of a fleet's were dropped.
        self._asking_qos = self._qos | {"express": COMMAND_QOS.express and "*" not in robot}
        # The stub declares the matching status as a bool; it is an object, and always true.
        self._querier: Any = session.declare_querier(self._keys["acquire"])

    @classmethod
    def open(cls, settings: Settings, robot: str, operator: str, *, lasts: bool = False) -> Self:
        """Open a port; ``lasts`` takes longer, and reconnects if the link to a gateway's commands alone broke."""
        return _opened(
            settings, lambda session: cls(session, settings.robot.root, robot, operator), commands=lasts
        )

    def reaches(self) -> bool:
        """Return True if a node answers this robot's commands. Unknown for a port to all robots."""
        return bool(self._querier.matching_status.matching)

    def put(self, verb: str, payload: bytes) -> None:
        """Send a command, or drop it if the link is congested. Neither blocks nor raises."""
        self.put_signed(
            self._keys[verb], verb, payload, b"" if self.prover is None else self.prover.attach(verb, payload)
        )

    def put_signed(self, key: str, verb: str, payload: bytes, attachment: bytes) -> None:
        """Send under a given key with a given attachment, as ``put`` does."""
        encoding = BY_VERB[verb].encoding
        try:
            self._session.put(key, payload, encoding=encoding, attachment=attachment or None, **self._qos)
        except zenoh.ZError as error:
            log.debug("Zenoh did not accept %s: %s", verb, error)

    def begin(self, verb: str, payload: bytes, timeout_s: float) -> PendingQuery:
        """Send a query; poll it for the replies."""
        question, attachment = PendingQuery(), b""
        if (prover := self.prover) is not None:
            attachment = prover.attach(verb, payload)
            question = PendingQuery(lambda received: prover.is_reply(received, attachment))
        return self.query(self._keys[verb], question, payload, BY_VERB[verb].encoding, attachment, timeout_s)

    def show(self, statement: bytes, question: bytes, timeout_s: float) -> list[Received]:
        """Show a statement of the authority. Returns the replies, not verified."""
        return self.begin_to_show(statement, question, timeout_s).wait(timeout_s)

    def begin_to_show(self, statement: bytes, question: bytes, timeout_s: float) -> PendingQuery:
        """Show a statement of the authority, with a random question; poll for the replies."""
        return self.query(self._authority, PendingQuery(), statement, "text/plain", question, timeout_s)

    def query(
        self, key: str, question: PendingQuery, payload: bytes, encoding: str, attachment: bytes, timeout_s: float
    ) -> PendingQuery:
        """Send a query under a given key; the replies go to ``question``."""
        more = {"payload": payload, "encoding": encoding, "attachment": attachment or None, **self._asking_qos}
        return ask_all(self._session, key, question, timeout_s, **more)

    def ask(self, verb: str, payload: bytes, timeout_s: float) -> list[Received]:
        """Send a query, and return all replies; see ``PendingQuery.wait``."""
        return self.begin(verb, payload, timeout_s).wait(timeout_s)

    def call_roll(self, timeout_s: float) -> PendingQuery:
        return call_roll(self._session, self._roll, timeout_s)


class SafetyListener(SessionOwner):
    """Receives a robot's safety state, events, chassis state and gateway health. Owns its session."""

    def __init__(self, session: zenoh.Session, root: str, robot: str) -> None:
        """Subscribe on a session. Raises ValueError: a part of the keys is invalid."""
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
        self._events = declare_events(session, event, EVENTS_WAITING)

    @classmethod
    def open(cls, settings: Settings, robot: str) -> Self:
        return _opened(settings, lambda session: cls(session, settings.robot.root, robot))

    def drain(self) -> Iterator[Received | Missed]:
        """Yield the samples since the last call; none once the session is closed."""
        try:
            for subscriber in self._subscribers:
                yield from receive(subscriber.try_recv, STATES_WAITING)
            yield from receive(self._events.try_recv, EVENTS_WAITING)
        except zenoh.ZError as error:
            log.debug("Zenoh is closed: %s", error)


AGAIN_S: Final = 0.02
"""Pause before a query is sent again: a robot with many queries leaves some unanswered, which end at once."""


class StatementPort(SessionOwner):
    """Sends statements to robots and receives their answers."""

    def __init__(self, session: zenoh.Session, root: str) -> None:
        super().__init__(session)
        self._root = root

    @classmethod
    def open(cls, settings: Settings) -> Self:
        return cls(join(settings.zenoh), settings.robot.root)

    def robots(self, timeout_s: float) -> list[str]:
        replies = call_roll(self._session, keys.liveliness(self._root), timeout_s).wait(timeout_s, timeout_s)
        found = {keys.robot_of_liveliness(self._root, reply.key) for reply in replies}
        return sorted(robot for robot in found if robot is not None)

    def show(self, robot: str, text: bytes, question: bytes, timeout_s: float) -> Received | None:
        """Show a robot a statement, repeatedly until it answers. Returns its answer; None after the timeout."""
        deadline_s = time.monotonic() + timeout_s
        while (left_s := deadline_s - time.monotonic()) > 0:
            more = {"payload": text, "attachment": question, "congestion_control": zenoh.CongestionControl.DROP}
            asked = ask_all(self._session, keys.authority(self._root, robot), PendingQuery(), left_s, **more)
            if replies := asked.wait(left_s):
                return replies[0]
            time.sleep(AGAIN_S)
        return None
