"""Requests to a recorder over Zenoh, both ends: the client, and the recorder's own keys and liveliness token.

This session is separate from the one that receives the robots' samples, which may have a long queue. Queries wait
in a ring that the loop drains; no Python of ours runs on Zenoh's threads.
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

from recorder.record.orders import OperatorRequest
from recorder.zenoh.source import SMALL_BATCHES
from schemas import codec, keys
from schemas.codec import PayloadFault, encoding_fault, names_schema
from schemas.command_line import CommandError, ExitCode, plain
from schemas.messages import Message
from schemas.recording import RecorderReply
from schemas.requests import Request
from schemas.settings import Settings, ZenohSettings
from schemas.subjects import RECORDER_BY_VERB, RECORDER_CHUNK, RECORDER_SUBJECTS
from schemas.zenoh_session import close_session, is_connected, join, local_port, next_ports, place, reason, said_of

log = logging.getLogger(__name__)

CLIENT_REPLIES_WAITING: Final = 256  # more than there are recorders: a full channel would block Zenoh's thread
LONGEST_S: Final = 86_400.0  # Zenoh waits no longer than a day
POLL_S: Final = 0.002  # period of polling for replies


def _read(verb: str, sample: zenoh.Sample) -> RecorderReply | PayloadFault:
    named, known = str(sample.encoding), RECORDER_BY_VERB[verb].reply_encoding
    if named != known:
        return PayloadFault(
            f"the reply to {verb} is {encoding_fault(named, known, 'this program', 'the recorder')}"
        )
    read = codec.understand(RecorderReply, sample.payload.to_bytes())
    return read if isinstance(read, PayloadFault) else read.message


class RecorderClient:
    """A session that sends requests to recorders, until ``close``."""

    def __init__(
        self,
        settings: ZenohSettings,
        root: str,
        operator: str,
        stopped: Callable[[], bool] = lambda: False,
    ) -> None:
        self._root = root
        self._operator = operator
        self._stopped = stopped
        self._name = re.compile(rf"{re.escape(root)}/{RECORDER_CHUNK}/({keys.ROBOT_PATTERN})/.+")
        self._place = place(settings)
        self._session = join(settings)

    def ask(
        self, recorder: str, verb: str, request: Request, timeout_s: float
    ) -> Iterator[tuple[str, RecorderReply]]:
        """The replies to a request, each with its recorder."""
        try:
            replies: Any = self._session.get(
                keys.recorder_command(self._root, recorder, self._operator, verb),
                zenoh.handlers.FifoChannel(CLIENT_REPLIES_WAITING),
                payload=codec.encode(request),
                encoding=RECORDER_BY_VERB[verb].encoding,
                target=zenoh.QueryTarget.ALL,
                # Two recorders on different hosts may have one name, and so one key.
                consolidation=zenoh.ConsolidationMode.NONE,
                # Replies inherit it: a recorder must not wait for a client that does not read.
                congestion_control=zenoh.CongestionControl.DROP,
                timeout=min(timeout_s, LONGEST_S),
            )
        except zenoh.ZError as error:
            raise CommandError(f"cannot ask: {reason(str(error))}", ExitCode.UNREACHABLE) from error
        for sample in self._samples(replies):
            name = self._name.fullmatch(str(sample.key_expr))
            if name is None:
                continue  # Not a recorder of ours.
            reply = _read(verb, sample)
            if isinstance(reply, RecorderReply):
                yield name[1], reply
            elif names_schema(str(sample.encoding)):
                log.warning("recorder %s: %s", name[1], plain(reply.detail))

    def no_answer(self, name: str) -> CommandError:
        """The error that the recorder of this name, or for ALL any recorder, does not answer."""
        if not is_connected(self._session):
            who = f"no Zenoh node answered at {self._place}"
        else:
            who = "no recorder answers" if name == keys.ALL else f"recorder {name} does not answer"
        return CommandError(who, ExitCode.UNREACHABLE)

    def close(self) -> None:
        close_session(self._session)

    def _samples(self, replies: Any) -> Iterator[zenoh.Sample]:  # noqa: ANN401 - Zenoh's handlers have no common type
        """The replies until the end of the query."""
        try:
            while not self._stopped():
                reply = replies.try_recv()
                if reply is None:
                    time.sleep(POLL_S)
                elif reply.ok is not None:
                    yield reply.ok
        except zenoh.ZError:
            return  # The query has ended.


QUERIES_WAITING: Final = 64  # requests that may wait for the loop; the oldest beyond it are dropped
REQUESTS_PER_PASS: Final = 8
FOR_ALL: Final = frozenset({"status"})  # verbs that one query may send to every recorder
REPLIES_WAITING: Final = 128  # replies that may wait: zenoh may block 5 s for a client that does not read
REQUEST_MAX_BYTES: Final = 4096
NAMESAKES_S: Final = 1.0  # time of the search for other recorders at the start
NAMESAKES_PAUSE_S: Final = 0.05  # pause between two of its queries
NAMESAKES_MAX: Final = 100


class RemoteControl:
    """The recorder's own keys on Zenoh, until ``close``. Nothing here raises once it is open."""

    def __init__(self, settings: Settings) -> None:
        self._root = settings.robot.root
        self.listen = listen_beside(settings.zenoh)
        self._session = join(settings.zenoh, self.listen, own=SMALL_BATCHES)
        self.name = self._free_name(settings.recorder.name or host_name())
        """The configured name, with a number if another recorder has it."""
        self._token = self._session.liveliness().declare_token(keys.of_recorder(self._root, self.name))
        self._queries = self._session.declare_queryable(
            keys.recorder_command(self._root, self.name, keys.ALL, keys.ALL),
            zenoh.handlers.RingChannel(QUERIES_WAITING),
            complete=True,
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
        try:
            self._publishers[type(message)].put(codec.encode(message))
        except zenoh.ZError as error:
            log.debug("cannot publish: %s", error)

    def drain(self) -> Iterator[OperatorRequest]:
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
        self._replier.shutdown(cancel_futures=True)
        close_session(self._session)

    def _asked(self, query: zenoh.Query) -> OperatorRequest | None:
        operator, name = keys.parse_command(str(query.key_expr))
        verb = RECORDER_BY_VERB.get(name)
        if verb is None or not operator:
            return None
        payload = query.payload
        key = keys.recorder_command(self._root, self.name, operator, name)
        request: Request | PayloadFault
        if name not in FOR_ALL and str(query.key_expr) != key:
            request = PayloadFault(f"{name} must name one recorder, without a wildcard")
        elif payload is not None and len(payload) > REQUEST_MAX_BYTES:
            request = PayloadFault(f"a request has at most {REQUEST_MAX_BYTES} bytes")
        elif names_schema(named := str(query.encoding or "")) and named != verb.encoding:
            request = PayloadFault(encoding_fault(named, verb.encoding, "the recorder", "the client"))
        else:
            request = codec.decode_request(verb, b"" if payload is None else payload.to_bytes())

        def send(answer: RecorderReply) -> None:
            try:
                query.reply(key, msgspec.msgpack.encode(answer), encoding=verb.reply_encoding)
            except zenoh.ZError as error:
                log.debug("the client has stopped waiting for the reply: %s", error)
            query.drop()

        return OperatorRequest(operator, request, lambda answer: self._off_the_loop(partial(send, answer)))

    def _off_the_loop(self, work: Callable[[], None]) -> None:
        """Run work that may block on another thread."""
        if self._replies_waiting.acquire(blocking=False):
            self._replier.submit(work).add_done_callback(lambda _: self._replies_waiting.release())
        else:
            log.warning("clients do not read the replies; the newest ones are dropped")

    def _free_name(self, wanted: str) -> str:
        taken: set[str] = set()
        end_s = time.monotonic() + NAMESAKES_S
        while time.monotonic() < end_s:
            taken.update(self._others())
            time.sleep(NAMESAKES_PAUSE_S)
        numbered = [wanted, *(f"{wanted}-{number}" for number in range(2, NAMESAKES_MAX))]
        name = next((one for one in numbered if one not in taken), wanted)
        if name != wanted:
            log.warning("there is already a recorder %s; this one is %s", plain(wanted), plain(name))
        return name

    def _others(self) -> Iterator[str]:
        replies: Any = self._session.liveliness().get(
            keys.of_recorder(self._root, keys.ALL), zenoh.handlers.FifoChannel(NAMESAKES_MAX), timeout=NAMESAKES_S
        )
        for reply in replies:
            if reply.ok is not None:
                yield str(reply.ok.key_expr).rpartition("/")[2]


def host_name() -> str:
    return re.sub(r"[^a-z0-9-]+", "-", socket.gethostname().partition(".")[0].lower()).strip("-") or "recorder"


def listen_beside(settings: ZenohSettings) -> list[str]:
    """Return the endpoints of the second session: the next ports, or as ``local_port`` chooses."""
    try:
        return next_ports(said_of(settings).listen) or local_port(settings)
    except ValueError as error:
        raise CommandError(f"wrong Zenoh settings: to listen on: {error}", ExitCode.USAGE) from error
