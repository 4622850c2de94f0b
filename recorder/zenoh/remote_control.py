"""The recorder's own keys on Zenoh: its verbs, its health, events and gaps, and a liveliness token.

A session of its own: the one that receives the robots' samples may have a long queue. Queries wait in a ring that
the loop drains; no Python of ours runs on Zenoh's threads.
"""

from __future__ import annotations

import logging
import re
import socket
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from threading import Semaphore
from typing import Any, Final

import msgspec
import zenoh

from recorder.record.admission import OrderAdmission, OrderNote, SignedOrder, refusal_text, text_of
from recorder.record.orders import OperatorRequest
from recorder.record.shards import shard_of
from recorder.zenoh.session import listen_beside, open_session
from schemas import codec, keys
from schemas.authority.statement import TEXT_MAX_BYTES
from schemas.authority.trust import Objection
from schemas.codec import PayloadFault
from schemas.decisions import StatementReply
from schemas.messages import Message
from schemas.printable import plain
from schemas.reasons import Reason
from schemas.recording import RecorderReply
from schemas.requests import Request
from schemas.settings import Settings
from schemas.subjects import AUTHORITY_CHUNK, RECORDER_BY_VERB, RECORDER_SUBJECTS, STATEMENT_REPLY_ENCODING
from schemas.versions import encoding_fault, names_schema

log = logging.getLogger(__name__)

QUERIES_WAITING: Final = 64
"""Requests that may wait between two passes of the loop; beyond it the oldest go."""

REQUESTS_PER_PASS: Final = 8

FOR_ALL: Final = frozenset({"status"})
"""Verbs that a query may send to every recorder at once. One query must not stop them all."""

REPLIES_WAITING: Final = 128
"""Replies that may wait for somebody's link; the zenoh package may wait 5 s for one that does not read."""

REQUEST_MAX_BYTES: Final = 4096

NAMESAKES_S: Final = 1.0
"""Time in which the start listens for other recorders: the links to them take their time."""

NAMESAKES_PAUSE_S: Final = 0.05
"""Pause between two queries for other recorders at the start."""

NAMESAKES_MAX: Final = 100


class RemoteControl:
    """The recorder on Zenoh, from its beginning to ``close``. Nothing here raises once it is open.

    Args:
        settings: of the session, the root, and the recorder's name.
        door: makes what judges orders in signed mode, for a recorder of this name; None lets everybody give them.
        save: keeps what the door has learnt across a restart; it may wait for the disk.

    Raises:
        CommandError: the session cannot be opened.
    """

    def __init__(
        self,
        settings: Settings,
        door: Callable[[str], OrderAdmission] | None = None,
        save: Callable[[OrderNote], None] = lambda _: None,
    ) -> None:
        self._root = settings.robot.root
        self.listen = listen_beside(settings.zenoh)
        """Where it listens."""
        self._session = open_session(settings.zenoh, self.listen)
        self.name = self._free_name(settings.recorder.name or host_name())
        """Its name: the one that is set, or with a number behind it where another recorder has that."""
        self._token = self._session.liveliness().declare_token(keys.of_recorder(self._root, self.name))
        self._shard = None
        if settings.recorder.shard:
            chunk = shard_of(settings.recorder.shard).chunk
            self._shard = self._session.liveliness().declare_token(keys.shard(self._root, self.name, chunk))
        self._queries = self._session.declare_queryable(
            keys.recorder_command(self._root, self.name, keys.ALL, keys.ALL),
            zenoh.handlers.RingChannel(QUERIES_WAITING),
            complete=True,
        )
        self._door = None if door is None else door(self.name)
        self._save = save
        self._statements_key = keys.of_recorder(self._root, self.name, AUTHORITY_CHUNK)
        self._statements = self._session.declare_queryable(
            self._statements_key, zenoh.handlers.RingChannel(QUERIES_WAITING), complete=True
        )
        self._replier = ThreadPoolExecutor(1, "replies")
        self._replies_waiting = Semaphore(REPLIES_WAITING)
        self._publishers = {
            subject.type: self._session.declare_publisher(
                keys.of_recorder(self._root, self.name, subject.name),
                encoding=subject.encoding,
                priority=getattr(zenoh.Priority, subject.qos.priority.value),
                congestion_control=zenoh.CongestionControl.DROP,
                express=subject.qos.express,
            )
            for subject in RECORDER_SUBJECTS
        }

    def publish(self, message: Message) -> None:
        """Publish a message under the recorder's own keys."""
        try:
            self._publishers[type(message)].put(codec.encode(message))
        except zenoh.ZError as error:
            log.debug("Zenoh does not take it: %s", error)

    def challenge(self) -> bytes:
        """The challenge that an order has to echo; empty in open mode."""
        return b"" if self._door is None else self._door.challenge(time.monotonic_ns())

    def drain(self) -> Iterator[OperatorRequest]:
        """The requests that have come in. Statements of the authority are taken over first."""
        self._take_statements()
        for _ in range(REQUESTS_PER_PASS):
            query = self._queries.try_recv()
            if query is None:
                return
            asked = self._asked(query)
            if asked is None:
                query.drop()
            else:
                yield asked

    def close(self) -> None:
        """Leave Zenoh."""
        self._replier.shutdown(cancel_futures=True)
        self._session.close()

    def _asked(self, query: zenoh.Query) -> OperatorRequest | None:
        operator, name = keys.parse_command(str(query.key_expr))
        verb = RECORDER_BY_VERB.get(name)
        if verb is None or not operator:
            return None
        payload = query.payload
        key = keys.recorder_command(self._root, self.name, operator, name)
        request: Request | PayloadFault
        attachment = b"" if query.attachment is None else query.attachment.to_bytes()
        if name not in FOR_ALL and str(query.key_expr) != key:
            request = PayloadFault(f"{name} must name one recorder, without a wildcard")
        elif payload is not None and len(payload) > REQUEST_MAX_BYTES:
            request = PayloadFault(f"a request has at most {REQUEST_MAX_BYTES} bytes")
        elif names_schema(named := str(query.encoding or "")) and named != verb.encoding:
            request = PayloadFault(encoding_fault(named, verb.encoding, "the recorder", "the client"))
        else:
            content = b"" if payload is None else payload.to_bytes()
            request = self._admitted(name, operator, content, attachment)

        def send(answer: RecorderReply) -> None:
            try:
                # Whether it waits for room on the link is what the query says.
                query.reply(key, msgspec.msgpack.encode(answer), encoding=verb.reply_encoding)
            except zenoh.ZError as error:
                log.debug("nobody waits for the reply any more: %s", error)

        def reply(answer: RecorderReply) -> None:
            self._off_the_loop(partial(send, answer))

        done = partial(self._off_the_loop, query.drop)
        return OperatorRequest(operator, request, reply, done)

    def _admitted(self, verb: str, operator: str, payload: bytes, attachment: bytes) -> Request | PayloadFault:
        """The request, or why it is not carried out."""
        request = codec.decode_request(RECORDER_BY_VERB[verb], payload)
        if self._door is None or isinstance(request, PayloadFault):
            return request
        order = SignedOrder(verb, operator, payload, attachment, request)
        refusal = self._door.judge(order, time.monotonic_ns(), int(time.time()))
        return request if refusal is None else PayloadFault(refusal_text(refusal))

    def _take_statements(self) -> None:
        for _ in range(REQUESTS_PER_PASS):
            query = self._statements.try_recv()
            if query is None:
                return
            self._off_the_loop(partial(self._reply_to_statement, query, self._show(query)))

    def _show(self, query: zenoh.Query) -> StatementReply:
        door = self._door
        if door is None:
            return _reply_of(None)
        before = door.note
        payload = query.payload
        # A longer one is refused for its length, wherever that is cut.
        text = b"" if payload is None else payload.to_bytes()[: TEXT_MAX_BYTES + 1]
        refusal = door.show(text, int(time.time()))
        if door.note is not before:
            self._replier.submit(self._save, door.note)
        return _reply_of(refusal)

    def _reply_to_statement(self, query: zenoh.Query, said: StatementReply) -> None:
        try:
            query.reply(self._statements_key, msgspec.msgpack.encode(said), encoding=STATEMENT_REPLY_ENCODING)
        except zenoh.ZError as error:
            log.debug("nobody waits for the reply any more: %s", error)
        query.drop()

    def _off_the_loop(self, work: Callable[[], None]) -> None:
        """Do what may wait for somebody's link on a thread that may."""
        if self._replies_waiting.acquire(blocking=False):
            self._replier.submit(self._reply, work)
        else:
            log.warning("nobody takes the replies; the newest ones are dropped")

    def _reply(self, work: Callable[[], None]) -> None:
        try:
            work()
        finally:
            self._replies_waiting.release()

    def _free_name(self, wanted: str) -> str:
        taken: set[str] = set()
        end_s = time.monotonic() + NAMESAKES_S
        while time.monotonic() < end_s:
            taken.update(self._others())
            time.sleep(NAMESAKES_PAUSE_S)
        numbered = [wanted, *(f"{wanted}-{number}" for number in range(2, NAMESAKES_MAX))]
        name = next((one for one in numbered if one not in taken), wanted)
        if name != wanted:
            log.warning("a recorder %s is there already; this one is %s", plain(wanted), plain(name))
        return name

    def _others(self) -> Iterator[str]:
        replies: Any = self._session.liveliness().get(
            keys.of_recorder(self._root, keys.ALL), zenoh.handlers.FifoChannel(NAMESAKES_MAX), timeout=NAMESAKES_S
        )
        for reply in replies:
            if reply.ok is not None:
                yield str(reply.ok.key_expr).rpartition("/")[2]


def _reply_of(refusal: Objection | None) -> StatementReply:
    """The reply to a statement. In open mode there is nothing to refuse."""
    if refusal is None:
        return StatementReply(ok=True, reason=Reason.NONE, detail="", cure="")
    detail, cure = refusal_text(refusal), text_of(refusal.reason).cure
    return StatementReply(ok=False, reason=refusal.reason, detail=detail, cure=cure)


def host_name() -> str:
    """The host's name as a chunk of a key."""
    return re.sub(r"[^a-z0-9-]+", "-", socket.gethostname().partition(".")[0].lower()).strip("-") or "recorder"
