"""The gateway on Zenoh: publishers, the info queryable, the liveliness token.

No Python of ours runs on Zenoh's threads: queries wait in a ring channel that the loop drains.
"""

from __future__ import annotations

import itertools
import logging
import secrets
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from queue import Empty, Full, Queue
from typing import TYPE_CHECKING, Any, Final

import msgspec
import zenoh
from zenoh import ext

from gateway.telemetry.samples import KeptSamples
from gateway.zenoh.client import comes_true, links_of
from schemas import keys
from schemas.codec import Sample
from schemas.command_line import CommandError, ExitCode, plain
from schemas.settings import DEFAULT_ENDPOINT, Settings, zenoh_rules
from schemas.subjects import BY_NAME, KEPT_FIRST, SIGNED, SUBJECTS, Pattern, Qos, Subject
from schemas.zenoh_session import (
    ANY_LOCAL_PORT,
    CONNECT_TIMEOUT,
    Json,
    client_endpoints,
    close_session,
    is_allowed,
    is_connected,
    is_loopback,
    lease_in_force_ms,
    next_ports,
    open_session,
    said_of,
    with_free_ports,
)

if TYPE_CHECKING:
    # Loaded in signed mode alone.
    from gateway.authority.robot_authority import NameProof
    from gateway.authority.session import RobotSigner

log = logging.getLogger(__name__)

QUERIES_WAITING: Final = 16  # queued queries on gateway/info; beyond it the oldest are dropped

QUERIES_PER_TICK: Final = 2

SEQUENCE_MAX_DIGITS: Final = 10

MISS_HEARTBEAT_S: Final = 1.0
"""Period at which a subject with a history publishes its last sequence, so that readers notice a loss."""

REPLIES_WAITING: Final = 256  # queued replies; beyond it the newest are dropped and counted

BLOCK_MAX_US: Final = 20_000
"""A link that accepts nothing is closed after this time.

A reply has its query's congestion control, which may block, and Zenoh would block for 5 s. Everything else on that
link would wait too, the loop's own samples included.
"""

RECEIVES_BYTES: Final = 1 << 20
"""The largest message that a robot receives; Zenoh drops larger ones. Its own bound is 1 GiB.

A robot receives requests of up to 1 KiB, queries, and Zenoh's own protocol messages.
"""

ROBOT_VALUES: Final[dict[str, Json]] = {
    "transport/link/rx/max_message_size": RECEIVES_BYTES,
    # Time for a client's first connection. By default it would wait 10 s without an answer.
    CONNECT_TIMEOUT: {"router": -1, "peer": -1, "client": 2000},
}
"""A robot's defaults in Zenoh's configuration; the user's file takes precedence."""

ROBOT_RULES: Final[dict[str, Json]] = {
    "transport/link/tx/queue/congestion_control/block/wait_before_close": BLOCK_MAX_US
}

LOOK_S: Final = 0.05  # period at which the thread checks for the shutdown while no reply waits
REPLY_TIMEOUT_S: Final = 1.0  # wait at shutdown for replies under way
TOKEN_TIMEOUT_S: Final = 1.0  # time limit of the query for another gateway of our name
INFO_TIMEOUT_S: Final = 1.0  # a healthy gateway answers within a few ticks of 10 ms
INFO_QUESTIONS: Final = 3  # tries before a namesake counts as absent: among many queries one may be dropped
ANSWERS_MAX: Final = 64  # answers that are read to one query

QUESTION_BYTES: Final = 16
"""Random bytes attached to each query for a namesake: a gateway in signed mode signs its answer over them."""

NEIGHBOUR_TIMEOUT_S: Final = 3.0  # time in which a Zenoh node that holds our port must be connected


class Replier:
    """Sends replies on a separate thread: with its query's congestion control a reply may block."""

    def __init__(self, name: str) -> None:
        self.drops = 0  # replies that were not sent, because too many waited
        self._replies: Queue[tuple[zenoh.Query, str, list[bytes], str, bytes]] = Queue(REPLIES_WAITING)
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def send(
        self, query: zenoh.Query, key: str, payloads: list[bytes], encoding: str, attachment: bytes = b""
    ) -> None:
        """Queue one reply for each payload. Never waits."""
        try:
            self._replies.put_nowait((query, key, payloads, encoding, attachment))
        except Full:
            self.drops += 1
            log.debug("too many replies are queued: one is dropped")

    @property
    def waiting(self) -> int:
        return self._replies.qsize()

    def close(self) -> None:
        """Send the queued replies, within the time limit, and end."""
        self._ends.set()
        self._thread.join(REPLY_TIMEOUT_S)

    def _run(self) -> None:
        while True:
            try:
                query, key, payloads, encoding, attachment = self._replies.get(timeout=LOOK_S)
            except Empty:
                if self._ends.is_set():
                    return
                continue
            try:
                with query:
                    for payload in payloads:
                        query.reply(key, payload, encoding=encoding, attachment=attachment or None)
            except zenoh.ZError as error:
                log.debug("Zenoh did not accept a reply: %s", error)


class _Kept:
    """Stored samples of a subject, and the queries for them."""

    def __init__(self, session: zenoh.Session, key: str, subject: Subject) -> None:
        self.key = key
        self.encoding = subject.encoding
        self.samples = KeptSamples(subject.qos.kept_bytes)
        self.queries = session.declare_queryable(key, zenoh.handlers.RingChannel(QUERIES_WAITING), complete=True)


def _first(query: zenoh.Query) -> int:
    """Return the sequence of the first sample queried for; -1 if the query names none."""
    text = query.parameters.get(KEPT_FIRST) or ""
    return int(text) if text.isascii() and text.isdigit() and len(text) <= SEQUENCE_MAX_DIGITS else -1


class ZenohNode:
    """A gateway's Zenoh node. Nothing raises or blocks once it is open."""

    def __init__(
        self,
        session: zenoh.Session,
        settings: Settings,
        signer: RobotSigner | None = None,
        name_proof: NameProof | None = None,
    ) -> None:
        """Declare everything on a session, which the node then owns. Without a signer nothing is signed."""
        robot = settings.robot
        self._signer = signer
        self._name_proof = name_proof
        self.failures = 0
        self.warning = ""  # about its start, for people; may be empty
        self._session = session
        self._own: set[str] = set()
        self._puts: dict[str, Callable[..., Any]] = {}
        self._declared: list[Any] = []
        self._kept: dict[str, _Kept] = {}
        for subject in SUBJECTS:
            if subject.pattern is Pattern.PUBLISHED:
                bus = settings.can.bus if "{bus}" in subject.name else ""
                key = keys.build(robot.root, robot.name, subject, bus)
                publisher = _declare_publisher(session, key, subject)
                self._declared.append(publisher)
                self._puts[subject.name] = publisher.put
                if subject.qos.kept_bytes:
                    self._kept[subject.name] = kept = _Kept(session, key, subject)
                    self._declared.append(kept.queries)
        self._signed_keys = {name: keys.build(robot.root, robot.name, BY_NAME[name]) for name in SIGNED}
        info = BY_NAME["gateway/info"]
        self._info_encoding = info.encoding
        self._info_key = keys.build(robot.root, robot.name, info)
        self._queries = session.declare_queryable(
            self._info_key, zenoh.handlers.RingChannel(QUERIES_WAITING), complete=True
        )
        self._declared.append(self._queries)
        self.replier = Replier("node-replies")
        token = session.liveliness().declare_token(keys.liveliness(robot.root, robot.name))
        self._declared.append(token)

    def publish(self, sample: Sample) -> None:
        """Publish a sample without waiting. A congested link drops and counts it."""
        kept = self._kept.get(sample.subject)
        if kept is not None:
            kept.samples.add(sample.payload)
        try:
            if self._signer is None:
                self._puts[sample.subject](sample.payload)
            else:
                self._publish_signed(self._signer, sample)
        except zenoh.ZError as error:
            self._fail(error)

    def resume(self, kept: Mapping[str, KeptSamples], recent: Iterable[Sample]) -> None:
        """Take over the samples stored before there was a session, and publish recent ones for late joiners."""
        for name, samples in kept.items():
            self._kept[name].samples = samples
        for sample in recent:
            try:
                self._puts[sample.subject](sample.payload)
            except zenoh.ZError as error:
                self._fail(error)

    def notes(self) -> tuple[str, ...]:
        """Return nothing: the node is on the network."""
        return ()

    def peers(self) -> int:
        """Count the directly connected nodes, without our own."""
        info = self._session.info
        return sum(str(node) not in self._own for node in (*info.peers_zid(), *info.routers_zid()))

    def outside(self) -> tuple[str, ...]:
        """Return the remote ends of connections that leave this computer."""
        ends = (str(link.dst) for link in self._session.info.links())
        return tuple(sorted(end for end in ends if not is_loopback(end)))

    def disregard(self, node: str) -> None:
        """Leave a node of our own out of ``peers``."""
        self._own.add(node)

    def answer(self, reply: Callable[[], bytes]) -> None:
        """Answer queued queries on ``gateway/info`` and on stored samples, a bounded number of each."""
        for _ in range(QUERIES_PER_TICK):
            query = self._queries.try_recv()
            if query is None:
                break
            payload = reply()
            proof = self._proof_of_name(query, payload)
            self.replier.send(query, self._info_key, [payload], self._info_encoding, proof)
        for kept in self._kept.values():
            query = kept.queries.try_recv()
            if query is not None:
                payloads = kept.samples.piece(_first(query)) if _first(query) >= 0 else []
                self.replier.send(query, kept.key, payloads, kept.encoding)

    def close(self) -> None:
        self.replier.close()
        try:
            for declared in self._declared:
                declared.undeclare()
        except zenoh.ZError as error:
            log.debug("leaving Zenoh: %s", error)
        close_session(self._session)

    def _proof_of_name(self, query: zenoh.Query, payload: bytes) -> bytes:
        """Return the attachment that proves our name to a starting gateway; empty for other queries."""
        question = query.attachment
        if self._name_proof is None or question is None or len(question) != QUESTION_BYTES:
            return b""
        return self._name_proof.attachment(payload, question.to_bytes())

    def _publish_signed(self, signer: RobotSigner, sample: Sample) -> None:
        """Publish states with their signature, other samples unsigned."""
        key = self._signed_keys.get(sample.subject)
        if key is None:
            self._puts[sample.subject](sample.payload)
        else:
            attachment = signer.publication(key, BY_NAME[sample.subject].encoding, sample.payload)
            self._puts[sample.subject](sample.payload, attachment=attachment)

    def _fail(self, error: zenoh.ZError) -> None:
        self.failures += 1
        log.debug("Zenoh did not accept a sample: %s", error)


class ZenohPlace(msgspec.Struct, frozen=True):
    """The endpoints of a gateway on Zenoh."""

    node: str
    connect: list[str]
    listen: list[str] = []  # endpoints of its telemetry session; empty if it only dials out
    command_listen: list[str] = []
    is_client: bool = False  # its sessions are clients, which do not listen

    @property
    def outside(self) -> list[str]:
        """Endpoints that involve other computers."""
        return [one for one in (*self.listen, *self.command_listen, *self.connect) if not is_loopback(one)]

    def __str__(self) -> str:
        parts = [f"listens on {', '.join(self.listen) or 'nothing'}"]
        if self.command_listen:
            parts.append(f"for commands on {', '.join(self.command_listen)}")
        if self.connect:
            parts.append(f"{'is a client of' if self.is_client else 'connects to'} {', '.join(self.connect)}")
        return plain(", ".join(parts))


def open_node(
    settings: Settings, signer: RobotSigner | None = None, name_proof: NameProof | None = None
) -> tuple[ZenohNode, ZenohPlace]:
    """Open the gateway's node. Returns it and its endpoints; without signer and proof nothing is signed."""
    session, place = _open_session(settings)
    try:
        if place.connect:  # A neighbour is needed to check that our name is free.
            comes_true(lambda: bool(links_of(session)), NEIGHBOUR_TIMEOUT_S)
        warning = _check_name_is_free(session, settings, name_proof)
    except CommandError:
        close_session(session)
        raise
    node = ZenohNode(session, settings, signer, name_proof)
    node.warning = warning
    return node, place


def client_place(settings: Settings) -> ZenohPlace:
    """Return the endpoints of a gateway that is a client, before it has a session."""
    return ZenohPlace("", client_endpoints(settings.zenoh), is_client=True)


def _check_name_is_free(session: zenoh.Session, settings: Settings, name_proof: NameProof | None) -> str:
    """Refuse to start if another gateway has our name: the two robots would appear as one.

    The token of a gateway that has just died disappears within the lease, so it is looked for more than once. A
    token alone keeps no robot from starting, because any client can declare one: a gateway must also answer, and
    in signed mode prove that the name was granted to it. Returns a warning if no such gateway has the token.
    """
    robot = settings.robot
    key = keys.liveliness(robot.root, robot.name)
    deadline_s = time.monotonic() + 2 * lease_in_force_ms(settings.zenoh) / 1000
    while any(reply.ok is not None for reply in session.liveliness().get(key, timeout=TOKEN_TIMEOUT_S)):
        if time.monotonic() <= deadline_s:
            time.sleep(0.1)
            continue
        is_answered = False
        for _ in range(INFO_QUESTIONS):
            question = secrets.token_bytes(QUESTION_BYTES)
            answers = _ask_for_info(session, settings, question)
            is_answered = is_answered or bool(answers)
            if any(_is_namesake(answer, question, settings, name_proof) for answer in answers):
                raise CommandError(
                    f"a gateway named {robot.name} is already connected; choose another name with --robot",
                    ExitCode.REFUSED,
                )
        who = (
            "its owner does not prove that it was granted this name: this may be an attempt"
            if is_answered
            else "no gateway answers: it may be a gateway that hangs, or an attempt"
        )
        return (
            f"another node has declared the liveliness token of {robot.name}, but {who} to keep this robot off "
            "the network"
        )
    return ""


def _ask_for_info(session: zenoh.Session, settings: Settings, question: bytes) -> list[zenoh.Sample]:
    """Return all answers for the robot's name, without consolidation, so that none displaces another."""
    replies = session.get(
        keys.build(settings.robot.root, settings.robot.name, BY_NAME["gateway/info"]),
        attachment=question,
        target=zenoh.QueryTarget.ALL,
        consolidation=zenoh.ConsolidationMode.NONE,
        timeout=INFO_TIMEOUT_S,
    )
    answers = (reply.ok for reply in itertools.islice(replies, ANSWERS_MAX))
    return [answer for answer in answers if answer is not None]


def _is_namesake(answer: zenoh.Sample, question: bytes, settings: Settings, name_proof: NameProof | None) -> bool:
    """Return True if a gateway of this name gave the answer. In open mode every answer counts."""
    if settings.authority.mode != "signed":
        return True
    attachment = answer.attachment
    if name_proof is None or attachment is None:
        return False
    return name_proof.is_namesake(answer.payload.to_bytes(), attachment.to_bytes(), question, int(time.time()))


def _open_session(settings: Settings) -> tuple[zenoh.Session, ZenohPlace]:
    mode, connect, listen, _ = said_of(settings.zenoh)
    if mode == "client":
        place = client_place(settings)
        session = _open(settings, place.connect, [])
        return session, msgspec.structs.replace(place, node=str(session.zid()))
    if not connect and not listen:
        return _open_default(settings)
    commands = _command_listen(settings, listen)
    listen = with_free_ports(listen)
    session = _open(settings, connect, listen)
    return session, ZenohPlace(str(session.zid()), connect, listen, with_free_ports(commands))


def _open_default(settings: Settings) -> tuple[zenoh.Session, ZenohPlace]:
    given = settings.zenoh
    if not is_allowed(given, DEFAULT_ENDPOINT):
        raise CommandError(
            f"{plain(given.config)} does not allow the protocol of the default endpoint {DEFAULT_ENDPOINT}; "
            "give --listen or --connect",
            ExitCode.USAGE,
        )
    commands = _command_listen(settings, [DEFAULT_ENDPOINT])
    try:
        session = _open(settings, [], [DEFAULT_ENDPOINT])
        return session, ZenohPlace(str(session.zid()), [], [DEFAULT_ENDPOINT], commands)
    except CommandError as error:
        if error.code is ExitCode.USAGE:
            raise
    listen = with_free_ports([ANY_LOCAL_PORT])
    session = _join_neighbour(settings, listen)
    commands = with_free_ports(_command_listen(settings, [ANY_LOCAL_PORT]))
    return session, ZenohPlace(str(session.zid()), [DEFAULT_ENDPOINT], listen, commands)


def _command_listen(settings: Settings, listen: list[str]) -> list[str]:
    """Return the endpoints of the command session: those of the settings, or telemetry's port plus one."""
    if settings.gateway.listen_only:
        return []
    try:
        return list(settings.zenoh.command_listen) or next_ports(listen)
    except ValueError as error:
        raise CommandError(
            f"wrong Zenoh settings: to listen on: {error}; commands use the next port, unless "
            "zenoh.command_listen names another endpoint",
            ExitCode.USAGE,
        ) from error


def _open(settings: Settings, connect: list[str], listen: list[str]) -> zenoh.Session:
    # Zenoh drops part of what this session publishes, by the interface of each link.
    egress = zenoh_rules(settings.zenoh.profiles, settings.robot.root, settings.robot.name)
    return open_session(settings.zenoh, connect, listen, own=ROBOT_VALUES, changes=ROBOT_RULES | egress)


def _join_neighbour(settings: Settings, listen: list[str]) -> zenoh.Session:
    """Connect to the Zenoh node that holds our port, as with several robots on one bench."""
    session = _open(settings, [DEFAULT_ENDPOINT], listen)
    if comes_true(lambda: is_connected(session), NEIGHBOUR_TIMEOUT_S):
        return session
    close_session(session)
    raise CommandError(
        f"{DEFAULT_ENDPOINT} is taken, but not by a Zenoh node; choose another with --listen", ExitCode.UNREACHABLE
    )


def _declare_publisher(
    session: zenoh.Session, key: str, subject: Subject
) -> zenoh.Publisher | ext.AdvancedPublisher:
    qos: Qos = subject.qos
    how: dict[str, Any] = {
        "encoding": subject.encoding,
        "congestion_control": zenoh.CongestionControl.DROP,
        "priority": getattr(zenoh.Priority, qos.priority.value),
        "express": qos.express,
    }
    if not qos.history:
        return session.declare_publisher(key, **how)
    misses = ext.MissDetectionConfig(heartbeat=MISS_HEARTBEAT_S, sporadic_heartbeat=None)
    return ext.declare_advanced_publisher(
        session,
        key,
        cache=ext.CacheConfig(qos.history),
        sample_miss_detection=misses if qos.history > 1 else None,
        publisher_detection=True,
        **how,
    )
