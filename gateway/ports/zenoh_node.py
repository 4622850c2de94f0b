"""The gateway on Zenoh: publishers, the info queryable, the liveliness token.

No Python of ours runs on Zenoh's threads: queries wait in a ring channel that the loop drains.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from queue import SimpleQueue
from typing import Any, Final

import zenoh
from zenoh import ext

from gateway.ports.zenoh_client import (
    client_endpoints,
    close_session,
    lease_in_force_ms,
    mode_in_force,
    open_session,
    place,
    says_listen,
)
from gateway.telemetry.sample import Sample
from schemas import keys
from schemas.exit_codes import CommandError, ExitCode
from schemas.settings import DEFAULT_ENDPOINT, Settings, ZenohSettings
from schemas.subjects import BY_NAME, SUBJECTS, Pattern, Qos, Subject
from schemas.zenoh_link import ANY_LOCAL_PORT

log = logging.getLogger(__name__)

QUERIES_WAITING: Final = 16
"""Queries on gateway/info that may wait; beyond it the oldest go."""

QUERIES_PER_TICK: Final = 2

MISS_HEARTBEAT_S: Final = 1.0
"""How often a subject with a history says how far it is, so that who lost the last sample notices."""

REPLY_TIMEOUT_S: Final = 1.0
"""How long the end waits for replies that are under way."""

TOKEN_TIMEOUT_S: Final = 1.0
"""How long the question may take whether a gateway of our name is there."""

NEIGHBOUR_TIMEOUT_S: Final = 3.0
"""A Zenoh node that holds our port is connected within this time, or it is none."""


class Replier:
    """Sends replies on a thread of its own: each has its query's congestion control, and may wait for seconds."""

    def __init__(self, name: str) -> None:
        self._replies: SimpleQueue[tuple[zenoh.Query, str, bytes, str] | None] = SimpleQueue()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def send(self, query: zenoh.Query, key: str, payload: bytes, encoding: str) -> None:
        """Reply to a query, soon."""
        self._replies.put((query, key, payload, encoding))

    @property
    def waiting(self) -> int:
        """Replies that wait to be sent."""
        return self._replies.qsize()

    def close(self) -> None:
        """Send what waits, for a while, and end."""
        self._replies.put(None)
        self._thread.join(REPLY_TIMEOUT_S)

    def _run(self) -> None:
        while (waiting := self._replies.get()) is not None:
            query, key, payload, encoding = waiting
            try:
                with query:
                    query.reply(key, payload, encoding=encoding)
            except zenoh.ZError as error:
                log.debug("Zenoh did not take a reply: %s", error)


class ZenohNode:
    """A gateway's place on Zenoh. Nothing here raises or blocks once it is open.

    Attributes:
        failures: samples that Zenoh did not take.
        replier: sends the replies to queries.
    """

    def __init__(self, session: zenoh.Session, settings: Settings) -> None:
        robot = settings.robot
        self.failures = 0
        self._session = session
        self._own: set[str] = set()
        self._puts: dict[str, Callable[[bytes], Any]] = {}
        self._declared: list[Any] = []
        for subject in SUBJECTS:
            if subject.pattern is Pattern.PUBLISHED:
                bus = settings.can.bus if "{bus}" in subject.name else ""
                key = keys.build(robot.root, robot.name, subject, bus)
                publisher = _declare_publisher(session, key, subject)
                self._declared.append(publisher)
                self._puts[subject.name] = publisher.put
        info = BY_NAME["gateway/info"]
        self._info_encoding = info.encoding
        self._info_key = keys.build(robot.root, robot.name, info)
        self._queries = session.declare_queryable(
            self._info_key, zenoh.handlers.RingChannel(QUERIES_WAITING), complete=True
        )
        self._declared.append(self._queries)
        self.replier = Replier("info-replies")
        token = session.liveliness().declare_token(keys.liveliness(robot.root, robot.name))
        self._declared.append(token)

    def publish(self, sample: Sample) -> None:
        """Hand a sample to Zenoh. It goes out, or is dropped and counted by the link; this never waits."""
        try:
            self._puts[sample.subject](sample.payload)
        except zenoh.ZError as error:
            self._fail(error)

    def peers(self) -> int:
        """Nodes connected directly, but for our own."""
        info = self._session.info
        return sum(str(node) not in self._own for node in (*info.peers_zid(), *info.routers_zid()))

    def disregard(self, node: str) -> None:
        """This node is one of our own: who is connected is everybody else."""
        self._own.add(node)

    def answer(self, reply: Callable[[], bytes]) -> None:
        """Answer the queries on ``gateway/info`` that wait, a bounded number."""
        for _ in range(QUERIES_PER_TICK):
            query = self._queries.try_recv()
            if query is None:
                return
            self.replier.send(query, self._info_key, reply(), self._info_encoding)

    def close(self) -> None:
        """Leave Zenoh. Never raises."""
        self.replier.close()
        try:
            for declared in self._declared:
                declared.undeclare()
        except zenoh.ZError as error:
            log.debug("leaving Zenoh: %s", error)
        close_session(self._session)

    def _fail(self, error: zenoh.ZError) -> None:
        self.failures += 1
        log.debug("Zenoh did not take a sample: %s", error)


def open_node(settings: Settings) -> tuple[ZenohNode, str]:
    """Open the gateway's node. Returns it and where it is, in words.

    Raises:
        CommandError: an endpoint is taken by something that is not Zenoh, or cannot be used; or a gateway of the
            same name is there.
    """
    session, where = _open_session(settings.zenoh)
    try:
        _check_name_is_free(session, settings)
    except CommandError:
        close_session(session)
        raise
    return ZenohNode(session, settings), where


def _check_name_is_free(session: zenoh.Session, settings: Settings) -> None:
    """Two gateways of one name would publish two robots as one that is in two places.

    The token of a gateway that has just died goes within the lease, so it is looked for more than once.
    """
    key = keys.liveliness(settings.robot.root, settings.robot.name)
    deadline_s = time.monotonic() + 2 * lease_in_force_ms(settings.zenoh) / 1000
    while any(reply.ok is not None for reply in session.liveliness().get(key, timeout=TOKEN_TIMEOUT_S)):
        if time.monotonic() > deadline_s:
            raise CommandError(
                f"a gateway of the name {settings.robot.name} is connected already; choose another with --robot",
                ExitCode.REFUSED,
            )
        time.sleep(0.1)


def _open_session(zenoh_settings: ZenohSettings) -> tuple[zenoh.Session, str]:
    connect = list(zenoh_settings.connect)
    if mode_in_force(zenoh_settings) == "client":
        return open_session(
            zenoh_settings, client_endpoints(zenoh_settings), []
        ), f"client of {place(zenoh_settings)}"
    if zenoh_settings.listen or says_listen(zenoh_settings):
        session = open_session(zenoh_settings, connect, zenoh_settings.listen)
        return session, f"at {', '.join(zenoh_settings.listen) or 'the endpoints of ' + zenoh_settings.config}"
    try:
        return open_session(zenoh_settings, connect, [DEFAULT_ENDPOINT]), f"at {DEFAULT_ENDPOINT}"
    except CommandError as error:
        if error.code is ExitCode.USAGE:
            raise
    return _join_neighbour(zenoh_settings, connect), f"through the Zenoh node at {DEFAULT_ENDPOINT}"


def _join_neighbour(zenoh_settings: ZenohSettings, connect: list[str]) -> zenoh.Session:
    """Another Zenoh node holds our port: several robots on one bench. Connect to it."""
    session = open_session(zenoh_settings, [*connect, DEFAULT_ENDPOINT], [ANY_LOCAL_PORT])
    deadline_s = time.monotonic() + NEIGHBOUR_TIMEOUT_S
    while time.monotonic() < deadline_s:
        if session.info.peers_zid() or session.info.routers_zid():
            return session
        time.sleep(0.02)
    close_session(session)
    raise CommandError(
        f"{DEFAULT_ENDPOINT} is taken, and not by a Zenoh node; choose another with --listen", ExitCode.UNREACHABLE
    )


def _declare_publisher(
    session: zenoh.Session, key: str, subject: Subject
) -> zenoh.Publisher | ext.AdvancedPublisher:
    qos: Qos = subject.qos
    priority: zenoh.Priority = getattr(zenoh.Priority, qos.priority.value)
    if not qos.history:
        return session.declare_publisher(
            key,
            encoding=subject.encoding,
            congestion_control=zenoh.CongestionControl.DROP,
            priority=priority,
            express=qos.express,
        )
    return ext.declare_advanced_publisher(
        session,
        key,
        encoding=subject.encoding,
        congestion_control=zenoh.CongestionControl.DROP,
        priority=priority,
        express=qos.express,
        cache=ext.CacheConfig(qos.history),
        sample_miss_detection=(
            ext.MissDetectionConfig(heartbeat=MISS_HEARTBEAT_S, sporadic_heartbeat=None)
            if qos.history > 1
            else None
        ),
        publisher_detection=True,
    )
