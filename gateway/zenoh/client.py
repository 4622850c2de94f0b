"""Opens Zenoh sessions, and listens to robots: what a command at the other end needs.

No Python of ours runs on Zenoh's threads: what arrives waits in ring channels until ``drain`` is called.
"""

from __future__ import annotations

import json
import logging
import socket
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final, Self

import msgspec
import zenoh
from zenoh import ext

from gateway.telemetry.received import Arrival, Missed, Received, TokenChange
from schemas import keys
from schemas.decisions import SafetyEvent
from schemas.declared_keys import DeclaredKeys
from schemas.exit_codes import CommandError, ExitCode
from schemas.messages import GatewayInfo
from schemas.printable import plain
from schemas.recording import RecorderHealth
from schemas.settings import DEFAULT_ENDPOINT, RobotSettings, Settings, ZenohSettings
from schemas.subjects import BY_NAME, BY_TYPE
from schemas.zenoh_link import (
    LEASE,
    PROTOCOLS,
    Json,
    SessionError,
    ZenohChoice,
    allows,
    finds_router,
    reason,
    said,
    session_settings,
    split_endpoint,
    with_port,
)

log = logging.getLogger(__name__)

FURTHER_S: Final = 0.2
"""Who else answers has so long after the first reply. The reply of a robot that is alone ends the question."""

POLL_S: Final = 0.002
"""Period at which replies are looked for."""

SAMPLES_WAITING: Final = 16_384
"""Samples of one subscription that may wait to be drained; beyond it the oldest go.

Those of 400 robots in two seconds: a process on a busy machine is held up, and shall not lose any.
"""

EVENTS_OF_BEFORE: Final = 50
"""The number of earlier events of a robot that a new listener receives."""

EVENTS_PER_LOOK: Final = 256
"""Events of all robots that are taken at a time, some milliseconds to read; the others wait for the next look."""

REPLIES_WAITING: Final = 16_384
"""Replies to one question that may wait to be polled; beyond it the oldest go. A fleet's stop has one a robot."""

_TIMEOUT: Final = b"Timeout"
"""Zenoh's own reply to a query whose time is over."""

ROBOT_RECEIVES_BYTES: Final = 1 << 20
"""The largest message that a robot receives; Zenoh drops a larger one while it arrives. Its own bound is 1 GiB.

What a robot receives are requests of up to 1 KiB, questions, and what nodes tell each other of the network.
"""

ROBOT_CONNECTS_MS: Final = {"router": -1, "peer": -1, "client": 2000}
"""A robot's client tries so long to connect when it opens, by mode. Without it: 10 s where no answer comes."""

_CONNECT_TIMEOUT: Final = "connect/timeout_ms"
_MAX_MESSAGE: Final = "transport/link/rx/max_message_size"
_WAIT_BEFORE_CLOSE: Final = "transport/link/tx/queue/congestion_control/block/wait_before_close"


def open_session(
    settings: ZenohSettings,
    connect: list[str],
    listen: list[str],
    block_max_us: int | None = None,
    changes: Mapping[str, Json] | None = None,
) -> zenoh.Session:
    """Open a session.

    A peer's session opens although nobody answers, and goes on trying in the background. Where none are given
    here, it connects to the endpoints of the Zenoh configuration file. It listens on those given here and on no
    others. ``block_max_us`` is a robot's: it cuts off whoever takes nothing for this time while somebody waits to
    send to it (Zenoh's own is 5 s), and a client's session gives its router up after a bounded time. ``changes``
    are entries of Zenoh's configuration by path, over all else.

    Raises:
        CommandError: an endpoint or the configuration file is wrong, the client finds nobody to connect to, or an
            endpoint to listen on is taken.
    """
    config = _configuration(settings, connect, listen)
    _enter(config, changes or {})
    if block_max_us is not None:
        config.insert_json5(_WAIT_BEFORE_CLOSE, str(block_max_us))
        if _of_file(config, _MAX_MESSAGE) is None:
            config.insert_json5(_MAX_MESSAGE, str(ROBOT_RECEIVES_BYTES))
        if _of_file(base_configuration(settings), _CONNECT_TIMEOUT) is None:
            config.insert_json5(_CONNECT_TIMEOUT, json.dumps(ROBOT_CONNECTS_MS))
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise SessionError("cannot open Zenoh", str(error), settings.config) from error


def open_towards_robots(settings: ZenohSettings) -> zenoh.Session:
    """Open the session of a command that only talks to robots. It listens on nothing.

    A Zenoh router passes nothing from one peer to another (measured with 1.10.2): who finds a router becomes its
    client, unless the settings say which mode it is to be.

    Raises:
        CommandError: see ``open_session``.
    """
    endpoints, said = client_endpoints(settings), said_of(settings)
    session = open_session(settings, endpoints, [])
    if said.mode != "peer" or said.is_mode_given or not finds_router(session.info, time.sleep):
        return session
    close_session(session)
    client = msgspec.structs.replace(settings, mode="client", given=settings.given | {"mode"})
    return open_session(client, endpoints, [])


def client_endpoints(settings: ZenohSettings) -> list[str]:
    """Where a command that only talks to robots connects.

    Raises:
        CommandError: the configuration file is wrong.
    """
    return said_of(settings).connect or [DEFAULT_ENDPOINT]


def said_of(settings: ZenohSettings) -> ZenohChoice:
    """Return the entries of a session: from the settings, or else from the Zenoh configuration file.

    Raises:
        CommandError: the configuration file is wrong.
    """
    config = base_configuration(settings)
    return said(settings, lambda path: _of_file(config, path))


def is_allowed(settings: ZenohSettings, endpoint: str) -> bool:
    """Do the protocols that the configuration file allows include that of this endpoint?

    Raises:
        CommandError: the configuration file is wrong.
    """
    return allows(_of_file(base_configuration(settings), PROTOCOLS), endpoint)


def with_free_ports(listen: list[str]) -> list[str]:
    """The endpoints, with a port that is free in place of 0, so that it can be told and connected to.

    Raises:
        CommandError: an address is not one of this machine.
    """
    return [_with_free_port(one) if ":0" in one else one for one in listen]


def _with_free_port(endpoint: str) -> str:
    try:
        protocol, host, port = split_endpoint(endpoint)
    except ValueError:
        return endpoint
    if port:
        return endpoint
    kind = socket.SOCK_DGRAM if protocol in ("udp", "quic") else socket.SOCK_STREAM
    try:
        family, *_, address = socket.getaddrinfo(host.strip("[]"), 0, type=kind)[0]
        with socket.socket(family, kind) as probe:
            probe.bind(address)
            return with_port(endpoint, probe.getsockname()[1])
    except OSError as error:
        raise CommandError(f"cannot listen on {plain(endpoint)}: {error}", ExitCode.UNREACHABLE) from error


def lease_in_force_ms(settings: ZenohSettings) -> int:
    """The lease of a session of these settings, which the configuration file may say.

    Raises:
        CommandError: the configuration file is wrong.
    """
    return int(json.loads(_configuration(settings, [], []).get_json(LEASE)))


def close_session(session: zenoh.Session) -> None:
    """Leave Zenoh. Never raises."""
    try:
        session.close()
    except zenoh.ZError as error:  # The session is of no use any more either way.
        log.debug("closing Zenoh: %s", error)


def _configuration(settings: ZenohSettings, connect: list[str], listen: list[str]) -> zenoh.Config:
    config = base_configuration(settings)
    _enter(config, session_settings(settings, connect, listen, lambda path: _of_file(config, path) is not None))
    return config


def _enter(config: zenoh.Config, entries: Mapping[str, Json]) -> None:
    for path, value in entries.items():
        try:
            config.insert_json5(path, json.dumps(value))
        except zenoh.ZError as error:
            shown = plain(json.dumps(value))
            raise CommandError(
                f"Zenoh does not take {path} = {shown}: {reason(str(error))}", ExitCode.USAGE
            ) from error


def _of_file(config: zenoh.Config, path: str) -> Json:
    """Return the configuration file's entry; None if there is none, or if it is Zenoh's own start value."""
    value: Json = json.loads(config.get_json(path))
    return None if value == json.loads(zenoh.Config().get_json(path)) else value


def base_configuration(settings: ZenohSettings) -> zenoh.Config:
    """The user's Zenoh file, or Zenoh's own start values.

    Raises:
        CommandError: the file is wrong.
    """
    if not settings.config:
        return zenoh.Config()
    try:
        return zenoh.Config.from_file(settings.config)
    except zenoh.ZError as error:
        raise CommandError(
            f"Zenoh configuration file {plain(settings.config)!r}: {reason(str(error))}", ExitCode.USAGE
        ) from error


def place(settings: ZenohSettings) -> str:
    """Where a command connects, in words."""
    return ", ".join(map(plain, client_endpoints(settings)))


class PendingQuery:
    """A query that is under way. Its replies wait here, and not in one of Zenoh's own channels.

    A FIFO channel that is full holds up Zenoh's thread, and then the next query of this session waits for ever. A
    ring channel loses what is in it when the query ends.

    Attributes:
        handler: to be given to the query.
        rejected: replies that are not of whom they should be; to be taken out by whoever wants them.
        is_over: no further reply will come.
        timed_out: it ended before everybody who was asked had answered.
    """

    def __init__(self, accepts: Callable[[Received], bool] | None = None) -> None:
        """No reply has come yet.

        Args:
            accepts: is a reply of whom it should be? One that is not counts as none.
        """
        self._accepts = accepts
        self.rejected: deque[Received] = deque(maxlen=REPLIES_WAITING)
        self.is_over = False
        self.timed_out = False
        self._arrived: deque[zenoh.Reply] = deque(maxlen=REPLIES_WAITING)
        self._ended: list[None] = []
        # On a thread of Zenoh's for Python alone, which waits for nothing here.
        self.handler: zenoh.handlers.Callback[zenoh.Reply] = zenoh.handlers.Callback(
            self._arrived.append, lambda: self._ended.append(None)
        )

    def poll(self) -> list[Received]:
        """The replies that have come since the last time, a bounded number."""
        found: list[Received] = []
        # Looked at first: what came before the end is in this poll.
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
        """All replies. After the first, others have ``further_s`` to come."""
        deadline_s = time.monotonic() + timeout_s
        replies: list[Received] = []
        while True:
            # Asked first: what came before the end is then among what is polled.
            is_over = self.is_over or time.monotonic() >= deadline_s
            found = self.poll()
            if found and not replies:
                deadline_s = min(deadline_s, time.monotonic() + further_s)
            replies += found
            if is_over:
                return replies
            time.sleep(POLL_S)


def links_of(session: zenoh.Session) -> frozenset[str]:
    """The connections to other nodes. One that is lost and made anew is another."""
    return frozenset(f"{link.src} {link.dst}" for link in session.info.links())


def call_roll(session: zenoh.Session, key: str, timeout_s: float) -> PendingQuery:
    """Ask for the liveliness tokens under a key."""
    question = PendingQuery()
    session.liveliness().get(key, question.handler, timeout=timeout_s)
    return question


def received_of(sample: zenoh.Sample) -> Received:
    """A sample, out of Zenoh's hands."""
    attachment = b"" if sample.attachment is None else sample.attachment.to_bytes()
    return Received(str(sample.key_expr), str(sample.encoding), sample.payload.to_bytes(), attachment)


def receive(try_recv: Callable[[], zenoh.Sample | None], waiting: int) -> Iterator[Received | Missed]:
    """The samples that wait in a ring. They end, however fast more come.

    Args:
        try_recv: the ring's.
        waiting: how many it has room for. Where so many are found, others may have been lost.
    """
    for _ in range(waiting):
        if (sample := try_recv()) is None:
            return
        if sample.kind == zenoh.SampleKind.PUT:
            yield received_of(sample)
    yield Missed()


class SessionOwner:
    """Owns a session: leaves Zenoh with ``close``, or at the end of a ``with``."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session

    def connected(self) -> bool:
        """Is any Zenoh node connected directly? A peer's session is open although none is."""
        info = self._session.info
        return bool(info.peers_zid() or info.routers_zid())

    def links(self) -> frozenset[str]:
        """The connections to other nodes."""
        return links_of(self._session)

    def close(self) -> None:
        """Leave Zenoh."""
        close_session(self._session)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_raised: object) -> None:
        self.close()


class RobotListener(SessionOwner):
    """Receives ``state``, ``safety/state``, ``gateway/health`` and liveliness tokens of one robot, or of all."""

    def __init__(self, session: zenoh.Session, robot: RobotSettings, name: str = "") -> None:
        """Subscribe on a session, which the listener then owns.

        Args:
            session: an open session.
            robot: where the root is.
            name: the robot, or several by ``*``; empty for all of them.
        """
        super().__init__(session)
        self._declared = DeclaredKeys(session.declare_publisher)
        chunk = keys.chunk_of(name)
        # Without history: Zenoh's threads would hand out the last health of a gateway that hangs, for ever.
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
        """Open a session to where the settings say, and listen.

        Raises:
            CommandError: see ``open_session``.
        """
        return cls(open_towards_robots(settings.zenoh), settings.robot, name)

    def call_roll(self, timeout_s: float) -> PendingQuery:
        """Ask for the liveliness tokens; the robots that have one are heard by ``drain`` as well."""
        return call_roll(self._session, self._roll, timeout_s)

    def ask_info(self, timeout_s: float) -> PendingQuery:
        """Ask for ``gateway/info``: each gateway replies, also where several have one name."""
        question = PendingQuery()
        self._session.get(
            self._info,
            question.handler,
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=timeout_s,
        )
        return question

    def drain(self) -> Iterator[Arrival]:
        """Yield the arrivals since the last call, a bounded number: more may come meanwhile."""
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
    """Receives the health of all recorders too."""

    def __init__(self, session: zenoh.Session, robot: RobotSettings, name: str = "") -> None:
        """Subscribe on a session, which the listener then owns; see ``RobotListener``."""
        super().__init__(session, robot, name)
        key = keys.of_recorder(robot.root, keys.ALL, BY_TYPE[RecorderHealth].name)
        health = session.declare_subscriber(key, zenoh.handlers.RingChannel(SAMPLES_WAITING))
        self._samples = (*self._samples, health)


class DeskListener(FleetListener):
    """Receives the events of all robots too, and those of before."""

    def __init__(self, session: zenoh.Session, robot: RobotSettings, name: str = "") -> None:
        """Subscribe on a session, which the listener then owns; see ``RobotListener``."""
        super().__init__(session, robot, name)
        events = ext.declare_advanced_subscriber(
            session,
            f"{robot.root}/{name or '*'}/{BY_TYPE[SafetyEvent].name}",
            zenoh.handlers.RingChannel(SAMPLES_WAITING),
            history=ext.HistoryConfig(detect_late_publishers=True, max_samples=EVENTS_OF_BEFORE),
            recovery=ext.RecoveryConfig(heartbeat=True, periodic_queries=None),
        )
        self._events = events

    def drain(self) -> Iterator[Arrival]:
        """Yield the arrivals since the last call, a bounded number; of events a small one, since all are read."""
        yield from super().drain()
        yield from receive(self._events.try_recv, EVENTS_PER_LOOK)
