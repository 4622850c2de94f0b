"""Requests from Zenoh: a session of their own, three kinds of rings, and the replies.

No Python of ours runs on Zenoh's threads: requests wait in ring channels that the loop drains. Where too many
come, those of the lease's holder go first and the oldest of the others are dropped and counted. Remote stops have
rings of their own, so that no flood keeps one out.
"""

from __future__ import annotations

import json
import logging
from collections import deque
from collections.abc import Callable
from typing import Any, Final

import zenoh

from gateway.command.flow import PendingReply
from gateway.command.request import RawRequest
from gateway.ports.zenoh_client import (
    base_configuration,
    client_endpoints,
    close_session,
    mode_in_force,
    open_session,
)
from gateway.ports.zenoh_node import BLOCK_MAX_US, Replier
from schemas import keys
from schemas.settings import (
    DEFAULT_ENDPOINT,
    DRIVES_PER_TICK,
    REQUEST_MAX_BYTES,
    STOPS_PER_TICK,
    VERBS_PER_TICK,
    Settings,
    ZenohSettings,
)
from schemas.subjects import BY_VERB, COMMAND_CHUNK, STOP_VERB
from schemas.zenoh_link import ANY_LOCAL_PORT, LISTEN

log = logging.getLogger(__name__)

STOPS_WAITING: Final = 64
VERBS_WAITING: Final = 256
DRIVES_WAITING: Final = 1024
"""Requests that may wait between two ticks; beyond it the oldest go, uncounted."""

PLAIN_REPLY: Final = BY_VERB[STOP_VERB].reply_encoding

DRIVE: Final = "drive"


class CommandInbox:
    """Where requests wait for the loop. Nothing here raises or blocks once it is open.

    Attributes:
        drops: requests that were dropped unread since the start, because too many came.
    """

    def __init__(self, session: zenoh.Session, settings: Settings) -> None:
        """Subscribe on a session, which the inbox then owns."""
        self.drops = 0
        self._session = session
        self._root, self._robot = settings.robot.root, settings.robot.name
        self._queries: dict[int, zenoh.Query] = {}
        self._last_handle = 0
        self._replier = Replier("command-replies")
        ring = zenoh.handlers.RingChannel
        stop, drive, verbs = (self._key(keys.ALL, verb) for verb in (STOP_VERB, DRIVE, keys.ALL))
        self._stop_puts = session.declare_subscriber(stop, ring(STOPS_WAITING))
        self._stop_queries = session.declare_queryable(stop, ring(STOPS_WAITING), complete=True)
        self._verbs = session.declare_queryable(verbs, ring(VERBS_WAITING), complete=True)
        self._drives = session.declare_subscriber(drive, ring(DRIVES_WAITING))

    @property
    def node(self) -> str:
        """The session's identifier."""
        return str(self._session.zid())

    def drain(self, holder: str) -> list[RawRequest]:
        """The requests that wait, stops first, a bounded number; the holder's of the lease before others'."""
        requests = [self._put(sample) for sample in _take(self._stop_puts.try_recv, STOPS_PER_TICK)]
        requests += [self._query(query) for query in _take(self._stop_queries.try_recv, STOPS_PER_TICK)]
        verbs = self._newest(self._verbs.try_recv, VERBS_WAITING, VERBS_PER_TICK, holder)
        # A wildcard query for a stop reaches this ring too; the stops' own has it already.
        requests += [self._query(query) for query in verbs if not str(query.key_expr).endswith(f"/{STOP_VERB}")]
        drives = self._newest(self._drives.try_recv, DRIVES_WAITING, DRIVES_PER_TICK, holder)
        requests += [self._put(sample) for sample in drives]
        return requests

    def reply(self, reply: PendingReply) -> None:
        """Answer who waits for it."""
        query = self._queries.pop(reply.handle, None)
        if query is None:
            return
        asked = str(query.key_expr)
        operator, verb = keys.parse_command(asked)
        command = BY_VERB.get(reply.verb)
        # The query's own key may hold a wildcard for the robot.
        key = self._key(operator, verb) if operator and verb == reply.verb and "*" not in verb else asked
        self._replier.send(query, key, [reply.payload], command.reply_encoding if command else PLAIN_REPLY)

    def close(self) -> None:
        """Leave Zenoh. Never raises."""
        self._queries.clear()
        self._replier.close()
        close_session(self._session)

    def _key(self, operator: str, verb: str) -> str:
        return keys.command(self._root, self._robot, operator, verb)

    def _newest(self, try_recv: Callable[[], Any], waiting: int, most: int, holder: str) -> list[Any]:
        """The newest of what waits, at most so many of the holder and so many of all others."""
        own: deque[Any] = deque(maxlen=most)
        others: deque[Any] = deque(maxlen=most)
        taken = 0
        # With the chunk before it: a holder may be called like a robot, or like the root.
        holders = f"/{COMMAND_CHUNK}/{holder}/"
        for arrived in _take(try_recv, waiting):
            taken += 1
            (own if holder and holders in str(arrived.key_expr) else others).append(arrived)
        self.drops += taken - len(own) - len(others)
        return [*own, *others]

    def _put(self, sample: zenoh.Sample) -> RawRequest:
        operator, verb = keys.parse_command(str(sample.key_expr))
        return _raw(0, verb, operator, sample.payload)

    def _query(self, query: zenoh.Query) -> RawRequest:
        self._last_handle += 1
        self._queries[self._last_handle] = query
        operator, verb = keys.parse_command(str(query.key_expr))
        return _raw(self._last_handle, verb, operator, query.payload)


def _raw(handle: int, verb: str, operator: str, payload: zenoh.ZBytes | None) -> RawRequest:
    size = 0 if payload is None else len(payload)
    # What is larger than any request is not even copied.
    data = b"" if payload is None or size > REQUEST_MAX_BYTES or verb == STOP_VERB else payload.to_bytes()
    return RawRequest(handle, verb, operator, data, size)


def _take(try_recv: Callable[[], Any], most: int) -> list[Any]:
    taken = []
    for _ in range(most):
        arrived = try_recv()
        if arrived is None:
            break
        taken.append(arrived)
    return taken


def open_inbox(settings: Settings) -> CommandInbox:
    """Open the session for commands, beside that for telemetry.

    Raises:
        CommandError: an endpoint cannot be used.
    """
    connect, listen = command_endpoints(settings.zenoh)
    return CommandInbox(open_session(settings.zenoh, connect, listen, BLOCK_MAX_US), settings)


def command_endpoints(settings: ZenohSettings) -> tuple[list[str], list[str]]:
    """Where the session for commands connects and listens.

    It connects to where the telemetry session listens, so that whoever reaches that one is told of this one, and
    listens on a port of its own on the same addresses.
    """
    if mode_in_force(settings) == "client":
        return client_endpoints(settings), []
    first = list(settings.listen) or _file_endpoints(settings) or [DEFAULT_ENDPOINT]
    connect = [*settings.connect, *(_loopback(endpoint) for endpoint in first)]
    if settings.command_listen:
        return connect, list(settings.command_listen)
    free = [f"{address}:0" for address, colon, _ in (endpoint.rpartition(":") for endpoint in first) if colon]
    return connect, list(dict.fromkeys(free)) or [ANY_LOCAL_PORT]


def _file_endpoints(settings: ZenohSettings) -> list[str]:
    """The endpoints that the user's Zenoh file says to listen on: a list, or one for each mode."""
    said = json.loads(base_configuration(settings).get_json(LISTEN)) if settings.config else []
    if isinstance(said, dict):
        said = said.get("peer") or []
    return [said] if isinstance(said, str) else list(said)


def _loopback(endpoint: str) -> str:
    """The endpoint as this machine reaches it: every address includes the loopback one."""
    return endpoint.replace("/0.0.0.0:", "/127.0.0.1:").replace("/[::]:", "/[::1]:")
