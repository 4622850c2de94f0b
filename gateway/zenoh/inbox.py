"""Requests from Zenoh, and a node that joins it late.

No Python of ours runs on Zenoh's threads: requests wait in ring channels that the loop drains. If too many arrive,
those of the lease's holder go first and the oldest of the others are dropped and counted. The holder's requests
are recognised by the number of its lease: any client can use its name. Remote stops have separate rings, so that
no flood keeps one out; a key with a wildcard for its verb reaches them too, and counts as a stop.

A client's session needs its router to open. A thread retries, and the loop takes the session over once it is open.
Until then there are no requests, and published samples are stored for late joiners.
"""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final

import msgspec
import zenoh

from gateway.command.flow import PendingReply
from gateway.command.rulings import RawRequest
from gateway.telemetry.samples import KeptSamples
from gateway.zenoh.client import comes_true
from gateway.zenoh.node import ROBOT_RULES, ROBOT_VALUES, Replier, ZenohNode, ZenohPlace
from schemas import keys
from schemas.codec import Sample, encoding_fault, names_schema
from schemas.command_line import CommandError
from schemas.settings import DRIVES_PER_TICK, REQUEST_MAX_BYTES, STOPS_PER_TICK, VERBS_PER_TICK, Settings
from schemas.subjects import (
    BY_NAME,
    BY_VERB,
    COMMAND_CHUNK,
    DRIVE_VERB,
    SIGNED,
    STATEMENT_REPLY_ENCODING,
    STOP_VERB,
    TEXT_MAX_BYTES,
)
from schemas.zenoh_session import close_session, open_session, own_endpoint

if TYPE_CHECKING:
    # Loaded in signed mode alone.
    from gateway.authority.admission import StatementSieve

log = logging.getLogger(__name__)

# Queued requests between two ticks; beyond it the oldest are dropped, uncounted.
STOPS_WAITING: Final = 64
VERBS_WAITING: Final = 256
DRIVES_WAITING: Final = 1024

STATEMENTS_WAITING: Final = 128
"""Queued statements of an authority between two ticks, 1 ms of work; beyond it the oldest are dropped."""

ATTACHMENT_MAX_BYTES: Final = 128  # no proof is longer

Proof = Callable[[str, bytes, bytes], bool]

OWN_LINK_TIMEOUT_S: Final = 3.0  # time in which the gateway's own two sessions must be connected

PLAIN_REPLY: Final = BY_VERB[STOP_VERB].reply_encoding


class _Numbers(msgspec.Struct, frozen=True):
    """The fields that distinguish the holder's requests from a flood under its name."""

    lease: int
    seq: int | None = None


_NUMBERS: Final = msgspec.msgpack.Decoder(_Numbers)


class CommandInbox:
    """Queues requests for the loop. Nothing raises or blocks once it is open."""

    def __init__(
        self,
        session: zenoh.Session,
        settings: Settings,
        is_proven: Proof | None = None,
        sieve: StatementSieve[zenoh.Query] | None = None,
    ) -> None:
        """Subscribe on a session, which the inbox then owns.

        Args:
            is_proven: verifies that a request is the lease holder's; None where nothing is signed.
            sieve: chooses the statements to verify in a tick; None without an authority.
        """
        self.drops = 0  # requests dropped unread since the start, because too many arrived
        self._is_proven = is_proven
        self._session = session
        self._root, self._robot = settings.robot.root, settings.robot.name
        self._queries: dict[int, zenoh.Query] = {}
        self._last_handle = 0
        self._replier = Replier("command-replies")
        ring = zenoh.handlers.RingChannel
        stop, drive, verbs = (self._key(keys.ALL, verb) for verb in (STOP_VERB, DRIVE_VERB, keys.ALL))
        self._any_stop = zenoh.KeyExpr(stop)
        self._stop_puts = session.declare_subscriber(stop, ring(STOPS_WAITING))
        self._stop_queries = session.declare_queryable(stop, ring(STOPS_WAITING), complete=True)
        self._verbs = session.declare_queryable(verbs, ring(VERBS_WAITING), complete=True)
        self._drives = session.declare_subscriber(drive, ring(DRIVES_WAITING))
        self._sieve = sieve
        self._statements: Any = None
        if sieve is not None:
            authority = keys.authority(self._root, self._robot)
            self._statements = session.declare_queryable(authority, ring(STATEMENTS_WAITING), complete=True)

    @property
    def node(self) -> str:
        return str(self._session.zid())

    def drain(self, holder: str, lease: int = 0, after: int = -1) -> list[RawRequest]:
        """Return a bounded number of queued requests: stops first, the lease holder's before the others.

        Args:
            holder: the operator that holds the lease; empty if there is none.
            lease: its number. A request in the holder's name without it is not the holder's.
            after: the sequence of the last accepted drive; a drive not above it is a repetition.
        """
        # Everything in these rings counts as a stop, whatever its key: else other requests could displace it.
        stops, asked = (_take(ring.try_recv, STOPS_PER_TICK) for ring in (self._stop_puts, self._stop_queries))
        requests = [self._put(sample, STOP_VERB) for sample in stops]
        requests += [self._query(query, STOP_VERB) for query in asked]
        # With the chunk before it: a holder may have the name of a robot, or of the root.
        holders = f"/{COMMAND_CHUNK}/{holder}/" if holder else ""

        def is_holders(arrived: Any) -> bool:  # noqa: ANN401 - a sample or a query
            return (
                bool(holders)
                and holders in (key := str(arrived.key_expr))
                and _fits(arrived.payload, lease, after)
                and (self._is_proven is None or self._is_proven(key.rpartition("/")[2], *_bytes_of(arrived)))
            )

        verbs = self._newest(_take(self._verbs.try_recv, VERBS_WAITING), VERBS_PER_TICK, is_holders)
        # Queries for a stop, or for any verb, arrive in this ring too, and are in the stops' ring already.
        requests += [self._query(query) for query in verbs if not query.key_expr.intersects(self._any_stop)]
        drives = self._newest(_take(self._drives.try_recv, DRIVES_WAITING), DRIVES_PER_TICK, is_holders)
        requests += [self._put(sample) for sample in drives]
        return requests

    def statements(self) -> list[RawRequest]:
        """Return a bounded number of an authority's queued statements. Those not chosen get no answer."""
        if self._sieve is None:
            return []
        arrived = _take(self._statements.try_recv, STATEMENTS_WAITING)
        texts = ((_payload_of(query, TEXT_MAX_BYTES), query) for query in arrived)
        return [self._query(query) for query in self._sieve.choose(texts)]

    def reply(self, reply: PendingReply) -> None:
        query = self._queries.pop(reply.handle, None)
        if query is None:
            return
        asked = str(query.key_expr)
        operator, verb = keys.parse_command(asked)
        command = BY_VERB.get(reply.verb)
        # The query's key may have a wildcard for the robot, and a stop's for the verb too.
        is_named = reply.verb in {verb, STOP_VERB}
        key = self._key(operator, reply.verb) if operator and is_named and "*" not in reply.verb else asked
        if not reply.verb:
            key = keys.authority(self._root, self._robot)
        encoding = command.reply_encoding if command else PLAIN_REPLY if reply.verb else STATEMENT_REPLY_ENCODING
        self._replier.send(query, key, [reply.payload], encoding, reply.attachment)

    def close(self) -> None:
        self._queries.clear()
        self._replier.close()
        close_session(self._session)

    def _key(self, operator: str, verb: str) -> str:
        return keys.command(self._root, self._robot, operator, verb)

    def _newest(self, arrived: list[Any], most: int, is_holders: Callable[[Any], bool]) -> list[Any]:
        """Return the newest requests: at most ``most`` of the holder, and as many of all others."""
        if len(arrived) <= most:
            # All of them: none has to be read.
            return arrived
        own: deque[Any] = deque()
        others: deque[Any] = deque()
        for one in reversed(arrived):
            kind = own if is_holders(one) else others
            if len(kind) < most:
                kind.appendleft(one)
        self.drops += len(arrived) - len(own) - len(others)
        return [*own, *others]

    def _put(self, sample: zenoh.Sample, verb: str = "") -> RawRequest:
        operator, named = keys.parse_command(str(sample.key_expr))
        return _raw(0, verb or named, operator, sample)

    def _query(self, query: zenoh.Query, verb: str = "") -> RawRequest:
        self._last_handle += 1
        self._queries[self._last_handle] = query
        operator, named = keys.parse_command(str(query.key_expr))
        return _raw(self._last_handle, verb or named, operator, query)


def _raw(handle: int, verb: str, operator: str, arrived: zenoh.Sample | zenoh.Query) -> RawRequest:
    size = 0 if arrived.payload is None else len(arrived.payload)
    data, attachment = _bytes_of(arrived, REQUEST_MAX_BYTES if verb else TEXT_MAX_BYTES)
    # A stop's payload is never read, and not signed.
    payload = b"" if verb == STOP_VERB else data
    return RawRequest(handle, verb, operator, payload, size, version_fault(verb, arrived.encoding), attachment)


def version_fault(verb: str, encoding: zenoh.Encoding | None) -> str:
    """Describe why a request of another version, or of another verb's schema, cannot be read; empty if it can.

    A request that names no schema is judged by its fields alone; a stop is never judged.
    """
    command = BY_VERB.get(verb)
    if command is None or encoding is None or verb == STOP_VERB:
        return ""
    named = str(encoding)
    if named == command.encoding or not names_schema(named):
        return ""
    return encoding_fault(named, command.encoding, "the gateway", "the client")


def _bytes_of(arrived: zenoh.Sample | zenoh.Query, most: int = REQUEST_MAX_BYTES) -> tuple[bytes, bytes]:
    """Return payload and attachment. Oversized ones are not copied."""
    attachment = arrived.attachment
    return (
        _payload_of(arrived, most),
        b"" if attachment is None or len(attachment) > ATTACHMENT_MAX_BYTES else attachment.to_bytes(),
    )


def _payload_of(arrived: zenoh.Sample | zenoh.Query, most: int) -> bytes:
    payload = arrived.payload
    return b"" if payload is None or len(payload) > most else payload.to_bytes()


def _fits(payload: zenoh.ZBytes | None, lease: int, after: int) -> bool:
    """Check for this lease number and, if there is a sequence, that it is new."""
    if payload is None or not lease or len(payload) > REQUEST_MAX_BYTES:
        return False
    try:
        found = _NUMBERS.decode(payload.to_bytes())
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
        return False
    return found.lease == lease and (found.seq is None or found.seq > after)


def _take(try_recv: Callable[[], Any], most: int) -> list[Any]:
    taken = []
    for _ in range(most):
        arrived = try_recv()
        if arrived is None:
            break
        taken.append(arrived)
    return taken


def open_inbox(
    settings: Settings,
    place: ZenohPlace,
    is_proven: Proof | None = None,
    sieve: StatementSieve[zenoh.Query] | None = None,
) -> CommandInbox:
    """Open the command session, beside the telemetry session.

    It connects to the same endpoints, and to the telemetry session itself where that listens: so every node that
    connects there can reach it. A client reaches it through that session; a peer learns its endpoint there.
    """
    own = [own_endpoint(endpoint) for endpoint in place.listen]
    try:
        session = open_session(
            settings.zenoh, [*place.connect, *own], place.command_listen, own=ROBOT_VALUES, changes=ROBOT_RULES
        )
    except CommandError as error:
        listen = ", ".join(place.command_listen)
        on = f"; the command session listens on {listen} (zenoh.command_listen)" if listen else ""
        raise CommandError(f"{error}{on}", error.code) from error
    if own and not comes_true(lambda: place.node in map(str, session.info.peers_zid()), OWN_LINK_TIMEOUT_S):
        log.warning(
            "the command session is not connected to %s: clients that connect there can neither command nor stop "
            "this robot; check the certificate for outgoing connections",
            ", ".join(own),
        )
    return CommandInbox(session, settings, is_proven, sieve)


AGAIN_S: Final = 1.0  # pause between two attempts
CLOSE_TIMEOUT_S: Final = 3.0  # longest wait, when the gateway ends, for an attempt under way

Joined = tuple[ZenohNode, CommandInbox | None]


class LateInbox:
    """Stands for the inbox until there is one."""

    def __init__(self) -> None:
        self.inbox: CommandInbox | None = None

    @property
    def drops(self) -> int:
        return 0 if self.inbox is None else self.inbox.drops

    def drain(self, holder: str, lease: int = 0, after: int = -1) -> list[RawRequest]:
        return [] if self.inbox is None else self.inbox.drain(holder, lease, after)

    def statements(self) -> list[RawRequest]:
        return [] if self.inbox is None else self.inbox.statements()

    def reply(self, reply: PendingReply) -> None:
        if self.inbox is not None:
            self.inbox.reply(reply)

    def close(self) -> None:
        if self.inbox is not None:
            self.inbox.close()


class LateNode:
    """Stands for the gateway's node until a router answers. Only ``close`` may block; nothing raises."""

    warning: Final = ""

    def __init__(self, join: Callable[[], Joined], inbox: LateInbox | None, cause: str) -> None:
        """Begin to connect; ``inbox`` is None for a gateway that only listens."""
        self._join = join
        self._inbox = inbox
        self._node: ZenohNode | None = None
        self._joined: Joined | None = None
        self._kept = {
            name: KeptSamples(subject.qos.kept_bytes)
            for name, subject in BY_NAME.items()
            if subject.qos.kept_bytes
        }
        self._recent = {
            name: deque[Sample](maxlen=subject.qos.history)
            for name, subject in BY_NAME.items()
            if subject.qos.history and name not in SIGNED
        }
        self._cause = ""
        self._say(cause)
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._run, name="late-node", daemon=True)
        self._thread.start()

    @property
    def failures(self) -> int:
        return 0 if self._node is None else self._node.failures

    def notes(self) -> tuple[str, ...]:
        """Return why the robot is off the network; nothing once it is connected."""
        return () if self._node is not None else (f"off the network: {self._cause}",)

    def publish(self, sample: Sample) -> None:
        """Publish a sample, or store it if late joiners may ask for its subject."""
        if self._node is not None:
            self._node.publish(sample)
            return
        if sample.subject in self._kept:
            self._kept[sample.subject].add(sample.payload)
        if sample.subject in self._recent:
            self._recent[sample.subject].append(sample)

    def answer(self, reply: Callable[[], bytes]) -> None:
        """Answer queued queries; first take the node over if it has connected."""
        if self._node is None and self._joined is not None:
            self._node, inbox = self._joined
            self._node.resume(self._kept, [sample for samples in self._recent.values() for sample in samples])
            if self._inbox is not None and inbox is not None:
                self._node.disregard(inbox.node)
                self._inbox.inbox = inbox
            log.warning("the robot is on the network%s", f"; {self._node.warning}" if self._node.warning else "")
        if self._node is not None:
            self._node.answer(reply)

    def peers(self) -> int:
        return 0 if self._node is None else self._node.peers()

    def outside(self) -> tuple[str, ...]:
        return () if self._node is None else self._node.outside()

    def close(self) -> None:
        """Leave Zenoh, within a bounded time. Never raises. The inbox is closed separately."""
        self._ends.set()
        self._thread.join(CLOSE_TIMEOUT_S)
        if self._node is not None:
            self._node.close()
        elif self._joined is not None:
            _close(self._joined)

    def _run(self) -> None:
        while not self._ends.wait(AGAIN_S):
            try:
                joined = self._join()
            except CommandError as error:
                self._say(str(error))
                continue
            if self._ends.is_set():
                _close(joined)
            else:
                self._joined = joined
            return

    def _say(self, cause: str) -> None:
        if cause != self._cause:
            log.warning("%s; the robot is off the network and cannot be commanded; retrying", cause)
        self._cause = cause


def _close(joined: Joined) -> None:
    node, inbox = joined
    if inbox is not None:
        inbox.close()
    node.close()
