"""Zenoh for programs that listen to robots and query them, and the router.

No Python of ours runs on Zenoh's threads: arrivals wait in ring channels until ``drain`` is called.
"""

from __future__ import annotations

import json
import time
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final, Self

import zenoh
from zenoh import ext

from gateway.telemetry.samples import Arrival, Missed, Received, TokenChange
from schemas import keys
from schemas.command_line import CommandError, ExitCode, plain
from schemas.decisions import SafetyEvent
from schemas.keys import DeclaredKeys
from schemas.messages import GatewayInfo
from schemas.recording import RecorderHealth
from schemas.settings import RobotSettings, Settings
from schemas.subjects import BY_NAME, BY_TYPE
from schemas.zenoh_session import (
    LISTEN,
    MODE,
    MULTICAST,
    base_configuration,
    close_session,
    enter,
    is_connected,
    is_loopback,
    join,
    open_configured,
    reason,
)

FURTHER_S: Final = 0.2
"""Time to wait for further replies after the first. A query to a single robot ends with its reply."""

POLL_S: Final = 0.002  # period at which replies are polled

SAMPLES_WAITING: Final = 16_384
"""Queued samples of one subscription; beyond it the oldest are dropped.

Enough for 400 robots during two seconds in which a busy computer holds up this process.
"""

EVENTS_OF_BEFORE: Final = 50  # earlier events of a robot that a new listener receives

EVENTS_PER_LOOK: Final = 256
"""Events of all robots that are taken at a time, some milliseconds of work; the others wait."""

REPLIES_WAITING: Final = 16_384
"""Queued replies to one query; beyond it the oldest are dropped. A fleet's stop has one per robot."""

_TIMEOUT: Final = b"Timeout"  # Zenoh's reply to a query that timed out


class PendingQuery:
    """A query under way. Its replies wait here, not in one of Zenoh's channels.

    A full FIFO channel blocks Zenoh's thread, and then the next query of this session for ever. A ring channel
    loses its content when the query ends.

    Attributes:
        rejected: replies that were not accepted; the owner removes them.
    """

    def __init__(self, accepts: Callable[[Received], bool] | None = None) -> None:
        """Begin without replies; those that ``accepts`` refuses go to ``rejected``."""
        self._accepts = accepts
        self.rejected: deque[Received] = deque(maxlen=REPLIES_WAITING)
        self.is_over = False
        self.timed_out = False  # it ended before all replies had arrived
        self._arrived: deque[zenoh.Reply] = deque(maxlen=REPLIES_WAITING)
        self._ended: list[None] = []
        # Runs on Zenoh's thread for Python callbacks, and never blocks it.
        self.handler: zenoh.handlers.Callback[zenoh.Reply] = zenoh.handlers.Callback(
            self._arrived.append, lambda: self._ended.append(None)
        )

    def poll(self) -> list[Received]:
        """Return the replies since the last call, a bounded number."""
        found: list[Received] = []
        # Read first, so that this poll has every reply from before the end.
        is_over = bool(self._ended)
        for _ in range(len(self._arrived)):
            reply = self._arrived.popleft()
            sample = reply.ok
            if sample is not None:
                received = received_of(sample)
                is_accepted = self._accepts is None or self._accepts(received)
                (found if is_accepted else self.rejected).append(received)
            elif reply.err is not None and reply.err.payload.to_bytes() == _TIMEOUT:
                self.timed_out = True
        self.is_over = is_over
        return found

    def wait(self, timeout_s: float, further_s: float = FURTHER_S) -> list[Received]:
        """Return all replies. After the first, wait ``further_s`` for others."""
        deadline_s = time.monotonic() + timeout_s
        replies: list[Received] = []
        while True:
            # Read first, so that the poll has every reply from before the end.
            is_over = self.is_over or time.monotonic() >= deadline_s
            found = self.poll()
            if found and not replies:
                deadline_s = min(deadline_s, time.monotonic() + further_s)
            replies += found
            if is_over:
                return replies
            time.sleep(POLL_S)


def links_of(session: zenoh.Session) -> frozenset[str]:
    """Return the connections to other nodes. A reconnection is another one."""
    return frozenset(f"{link.src} {link.dst}" for link in session.info.links())


def comes_true(condition: Callable[[], bool], timeout_s: float) -> bool:
    """Poll a condition until it holds. Returns False after the timeout."""
    deadline_s = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() >= deadline_s:
            return False
        time.sleep(POLL_S)
    return True


def declare_events(session: zenoh.Session, key: str, waiting: int) -> Any:  # noqa: ANN401 - Zenoh's
    """Subscribe to events, with earlier ones and recovery of lost ones."""
    return ext.declare_advanced_subscriber(
        session,
        key,
        zenoh.handlers.RingChannel(waiting),
        history=ext.HistoryConfig(detect_late_publishers=True, max_samples=EVENTS_OF_BEFORE),
        recovery=ext.RecoveryConfig(heartbeat=True, periodic_queries=None),
    )


def call_roll(session: zenoh.Session, key: str, timeout_s: float) -> PendingQuery:
    question = PendingQuery()
    session.liveliness().get(key, question.handler, timeout=timeout_s)
    return question


def ask_all(
    session: zenoh.Session,
    key: str,
    question: PendingQuery,
    timeout_s: float,
    **more: Any,  # noqa: ANN401 - as of Session.get
) -> PendingQuery:
    """Query all nodes that answer for a key; the replies go to ``question``."""
    every, none = zenoh.QueryTarget.ALL, zenoh.ConsolidationMode.NONE
    try:
        session.get(key, question.handler, target=every, consolidation=none, timeout=timeout_s, **more)
    except zenoh.ZError as error:
        raise CommandError(f"cannot send the query: {reason(str(error))}", ExitCode.UNREACHABLE) from error
    return question


def received_of(sample: zenoh.Sample) -> Received:
    """Copy a sample out of Zenoh."""
    attachment = b"" if sample.attachment is None else sample.attachment.to_bytes()
    return Received(str(sample.key_expr), str(sample.encoding), sample.payload.to_bytes(), attachment)


def receive(try_recv: Callable[[], zenoh.Sample | None], waiting: int) -> Iterator[Received | Missed]:
    """Yield the samples queued in a ring of this size, and no more, however fast others arrive."""
    for _ in range(waiting):
        if (sample := try_recv()) is None:
            return
        if sample.kind == zenoh.SampleKind.PUT:
            yield received_of(sample)
    yield Missed()


class SessionOwner:
    """Owns a session, and closes it at the end of a ``with``."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session

    def connected(self) -> bool:
        """Report whether a Zenoh node is directly connected. A peer's session opens without any."""
        return is_connected(self._session)

    def links(self) -> frozenset[str]:
        return links_of(self._session)

    def close(self) -> None:
        close_session(self._session)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_raised: object) -> None:
        self.close()


class RobotListener(SessionOwner):
    """Receives ``state``, ``safety/state``, ``gateway/health`` and liveliness tokens of one robot, or of all."""

    def __init__(self, session: zenoh.Session, robot: RobotSettings, name: str = "") -> None:
        """Subscribe to a robot, to several by ``*``, or to all. The listener owns the session."""
        super().__init__(session)
        self._declared = DeclaredKeys(session.declare_publisher)
        chunk = keys.chunk_of(name)
        # Without history: Zenoh would deliver the last health of a hanging gateway for ever.
        self._samples: tuple[Any, ...] = tuple(
            session.declare_subscriber(
                f"{robot.root}/{chunk}/{BY_NAME[subject].name}", zenoh.handlers.RingChannel(SAMPLES_WAITING)
            )
            for subject in ("state", "safety/state", "gateway/health")
        )
        self._info = f"{robot.root}/{chunk}/{BY_TYPE[GatewayInfo].name}"
        self._roll = keys.liveliness(robot.root, chunk)
        self._tokens = session.liveliness().declare_subscriber(
            self._roll, zenoh.handlers.RingChannel(SAMPLES_WAITING), history=True
        )

    @classmethod
    def open(cls, settings: Settings, name: str = "") -> Self:
        return cls(join(settings.zenoh), settings.robot, name)

    def call_roll(self, timeout_s: float) -> PendingQuery:
        return call_roll(self._session, self._roll, timeout_s)

    def ask_info(self, timeout_s: float) -> PendingQuery:
        """Query ``gateway/info``: each gateway replies, even if several have one name."""
        return ask_all(self._session, self._info, PendingQuery(), timeout_s)

    def drain(self) -> Iterator[Arrival]:
        """Yield a bounded number of arrivals since the last call."""
        for _ in range(SAMPLES_WAITING):
            if (token := self._tokens.try_recv()) is None:
                break
            yield TokenChange(str(token.key_expr), present=token.kind == zenoh.SampleKind.PUT)
        for subscriber in self._samples:
            for arrival in receive(subscriber.try_recv, SAMPLES_WAITING):
                if isinstance(arrival, Received):
                    self._declared.meet(arrival.key)
                yield arrival


class FleetListener(RobotListener):
    """Also receives the health of all recorders."""

    def __init__(self, session: zenoh.Session, robot: RobotSettings, name: str = "") -> None:
        super().__init__(session, robot, name)
        key = keys.of_recorder(robot.root, keys.ALL, BY_TYPE[RecorderHealth].name)
        health = session.declare_subscriber(key, zenoh.handlers.RingChannel(SAMPLES_WAITING))
        self._samples = (*self._samples, health)


class DeskListener(FleetListener):
    """Also receives the events of all robots, including earlier ones."""

    def __init__(self, session: zenoh.Session, robot: RobotSettings, name: str = "") -> None:
        super().__init__(session, robot, name)
        key = f"{robot.root}/{name or '*'}/{BY_TYPE[SafetyEvent].name}"
        self._events = declare_events(session, key, SAMPLES_WAITING)

    def drain(self) -> Iterator[Arrival]:
        """Yield a bounded number of arrivals since the last call; fewer of events, which take time to read."""
        yield from super().drain()
        yield from receive(self._events.try_recv, EVENTS_PER_LOOK)


ROUTER: Final = "router"


def open_router(file: Path, listen: list[str]) -> tuple[zenoh.Session, list[str]]:
    """Open a router on the file's endpoints or those given. Returns its session and its endpoints."""
    config = base_configuration(str(file))
    if json.loads(config.get_json(MODE)) != ROUTER:
        raise CommandError(
            f"{plain(str(file))} is not a router's: 'cruiser provision router' makes one", ExitCode.USAGE
        )
    enter(config, {MULTICAST: False})
    if listen:
        enter(config, {LISTEN: [*listen]})
    endpoints = json.loads(config.get_json(LISTEN))
    if not isinstance(endpoints, list) or not endpoints:
        raise CommandError(f"{plain(str(file))} names no endpoint to listen on: give --listen", ExitCode.USAGE)
    return open_configured(config, str(file)), list(map(str, endpoints))


def open_local_router(endpoint: str) -> zenoh.Session:
    """Open a router without keys for virtual robots on this computer."""
    if not is_loopback(endpoint):
        # Behind a router a gateway cannot see whether commands come from another computer.
        raise CommandError(
            f"{plain(endpoint)} can be reached from other computers, but virtual robots have no keys; "
            "give an endpoint on 127.0.0.1",
            ExitCode.USAGE,
        )
    config = base_configuration("")
    enter(config, {MODE: ROUTER, LISTEN: [endpoint], MULTICAST: False})
    return open_configured(config)
