"""Samples from Zenoh, whose own threads fill its ring channels; no Python of ours runs on them.

If several recorders share a fleet, a robot's name alone decides its recorder: recorders need not know each other.
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterable, Iterator, Sequence
from hashlib import sha256
from typing import Any, Final, NamedTuple

import msgspec
import zenoh

from schemas import keys
from schemas.command_line import CommandError, ExitCode, plain
from schemas.keys import DeclaredKeys
from schemas.settings import OWNED_KEY_LIMIT, ZenohSettings
from schemas.subjects import KEPT_PIECE
from schemas.zenoh_session import Json, close_session, is_connected, join, reason, said_of

SHARD_PATTERN: Final = r"([1-9][0-9]{0,2})/([1-9][0-9]{0,2})"


class Shard(NamedTuple):
    """One of several recorders: ``number`` counts from 1 to ``total``."""

    number: int
    total: int

    def has(self, robot: str) -> bool:
        """True if the robot is this recorder's: by the SHA-256 of its name, as a number, modulo the total."""
        return int.from_bytes(sha256(robot.encode()).digest()) % self.total == self.number - 1


def shard_of(text: str) -> Shard:
    """Read ``NUMBER/COUNT``."""
    match = re.fullmatch(SHARD_PATTERN, text)
    if match is None or int(match[1]) > int(match[2]):
        raise CommandError(f"the shard is {text!r}, and should be such as 2/4: the second of four", ExitCode.USAGE)
    return Shard(int(match[1]), int(match[2]))


SMALL_BATCHES: Final[dict[str, Json]] = {"transport/link/tx/batch_size": 16_384}
"""The links' batches, both ways. A waiting sample holds its whole batch in memory: with Zenoh's own 64 KiB a
recorder of 300 robots grew to 1.4 GB. Less would leave senders too little for a stall."""

REPLY_TIMEOUT_S: Final = 2.0  # longest wait of a query for its reply

RING_SAMPLE_BYTES: Final = 3_200
"""Share of ``recorder.queue_bytes`` for a sample in Zenoh's ring of a key expression: 20,000 samples in 64 MB."""

DRAIN_BYTES: Final = 16_000_000  # approximate payloads of one ``drain``
PENDING_MAX: Final = 64  # queries in flight; beyond it the oldest is given up
TOKENS_WAITING: Final = 10_000
REPLIES_WAITING: Final = 4 * KEPT_PIECE  # replies to one query that may wait, also from gateways of the same name

_Samples = zenoh.Subscriber[zenoh.handlers.Handler[zenoh.Sample]]
_Replies = zenoh.handlers.Handler[zenoh.Reply]


class ZenohSample(msgspec.Struct, frozen=True, gc=False):
    """A ``ReceivedSample`` from Zenoh. Rarely needed properties are read on demand."""

    key: str
    encoding: str
    payload: bytes
    received: zenoh.Sample
    received_ns: int
    is_reply: bool = False

    @property
    def attachment(self) -> bytes:
        attachment = self.received.attachment
        return b"" if attachment is None else attachment.to_bytes()

    @property
    def zenoh_time_ns(self) -> int:
        timestamp = self.received.timestamp
        return 0 if timestamp is None else timestamp.get_time_as_ntp64().as_nanos()

    @property
    def source(self) -> tuple[str, int] | None:
        info = self.received.source_info
        return None if info is None else (str(info.source_id), info.source_sn)

    @property
    def deleted(self) -> bool:
        return self.received.kind == zenoh.SampleKind.DELETE


def _take(received: zenoh.Sample, *, is_reply: bool = False) -> ZenohSample:
    key, encoding = str(received.key_expr), str(received.encoding)
    return ZenohSample(key, encoding, received.payload.to_bytes(), received, time.time_ns(), is_reply)


class ZenohSource:
    """A Zenoh session that subscribes to key expressions. A key that matches several is received once."""

    def __init__(self, settings: ZenohSettings, key_expressions: Sequence[str], queue_samples: int) -> None:
        expressions = distinct(key_expressions)
        self._queue_samples = queue_samples
        self._pending: list[tuple[str, _Replies]] = []
        self.listen = said_of(settings).listen  # the endpoints that it listens on
        self._session = join(settings, self.listen, own=SMALL_BATCHES)
        self._declared = DeclaredKeys(self._session.declare_publisher)
        self._subscribers: dict[zenoh.KeyExpr, _Samples] = {}
        self._owners: dict[str, zenoh.KeyExpr] = {}
        self._tokens: Any = self._session.liveliness().declare_subscriber(
            keys.ANY_TOKEN, zenoh.handlers.RingChannel(TOKENS_WAITING), history=True
        )
        self.is_behind = False  # more had come in than the last ``drain`` returned
        self._overlap = have_overlap(expressions)
        self._subscribe(expressions)

    @property
    def is_asking(self) -> bool:
        return bool(self._pending)

    @property
    def query_room(self) -> int:
        return PENDING_MAX - len(self._pending)

    @property
    def is_connected(self) -> bool:
        return is_connected(self._session)

    def drain(self, limit: int) -> list[ZenohSample]:
        taken: list[ZenohSample] = []
        taken_bytes = 0
        self.is_behind = False
        meet = self._declared.meet
        for expression, subscriber in self._subscribers.items():
            receive = subscriber.try_recv
            for _ in range(limit):
                received = receive()
                if received is None:
                    break
                if not self._overlap or self._owner(received.key_expr) == expression:
                    sample = _take(received)
                    meet(sample.key)
                    taken.append(sample)
                    taken_bytes += len(sample.payload)
                    if taken_bytes > DRAIN_BYTES:
                        self.is_behind = True
                        break
            else:
                self.is_behind = True
        if self._pending:
            taken += self._replies()
        return taken

    def tokens_gone(self) -> Iterator[str]:
        while (token := self._tokens.try_recv()) is not None:
            if token.kind == zenoh.SampleKind.DELETE:
                yield str(token.key_expr)

    def ask(self, key: str, parameters: str = "") -> None:
        # Not a ring: it drops the reply when the query ends before it is read.
        replies: zenoh.handlers.FifoChannel[zenoh.Reply] = zenoh.handlers.FifoChannel(REPLIES_WAITING)
        handler = self._session.get(
            f"{key}?{parameters}" if parameters else key,
            replies,
            timeout=REPLY_TIMEOUT_S,
            target=zenoh.QueryTarget.BEST_MATCHING,
            # Several replies have one key, and all of them count.
            consolidation=zenoh.ConsolidationMode.NONE,
            # Replies inherit it: a blocked reply would delay the gateway's samples.
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.DATA_LOW,
        )
        self._pending = [*self._pending, (key, handler)][-PENDING_MAX:]

    def close(self) -> None:
        close_session(self._session)

    def _subscribe(self, expressions: Iterable[zenoh.KeyExpr]) -> None:
        """Subscribe to more expressions, none of which includes another."""
        for expression in expressions:
            self._subscribers[expression] = self._session.declare_subscriber(
                expression, zenoh.handlers.RingChannel(self._queue_samples)
            )

    def _replies(self) -> Iterator[ZenohSample]:
        waiting = []
        for key, handler in self._pending:
            try:
                for _ in range(REPLIES_WAITING):
                    reply = handler.try_recv()
                    if reply is None:
                        break
                    if reply.ok is not None and str(reply.ok.key_expr) == key:
                        yield _take(reply.ok, is_reply=True)
            except zenoh.ZError:
                continue  # The query has ended.
            waiting.append((key, handler))
        self._pending = waiting

    def _owner(self, key: zenoh.KeyExpr) -> zenoh.KeyExpr:
        """The first expression that matches the key: the samples of the other subscribers are copies."""
        text = str(key)
        owner = self._owners.get(text)
        if owner is None:
            owner = next(one for one in self._subscribers if one.intersects(key))
            if len(self._owners) >= OWNED_KEY_LIMIT:
                self._owners.clear()
            self._owners[text] = owner
        return owner


def distinct(texts: Sequence[str]) -> list[zenoh.KeyExpr]:
    """Return the key expressions, without those that another one includes."""
    expressions: list[zenoh.KeyExpr] = []
    for text in texts:
        try:
            one = zenoh.KeyExpr.autocanonize(text)
        except zenoh.ZError as error:
            raise CommandError(
                f"{plain(text)!r} is no key expression: {reason(str(error))}", ExitCode.USAGE
            ) from error
        if not any(other.includes(one) for other in expressions):
            expressions = [other for other in expressions if not one.includes(other)] + [one]
    return expressions


def have_overlap(expressions: Sequence[zenoh.KeyExpr]) -> bool:
    """Return True if a key may match two expressions."""
    return any(one.intersects(other) for index, one in enumerate(expressions) for other in expressions[:index])


ROBOT_SAMPLES: Final = 1_000
"""Samples of a robot that may wait per key expression: 1.4 s at full rate. A ring allocates all its memory."""

ROBOTS_MAX: Final = 20_000  # robots that are subscribed to: tokens are untrusted


class ShardedSource(ZenohSource):
    """A Zenoh session that subscribes to the keys of each robot when its gateway's liveliness token appears.

    Args:
        key_expressions: the keys to record of each robot; the robot's chunk is a robot or a wildcard.
    """

    def __init__(self, settings: ZenohSettings, key_expressions: Sequence[str], root: str, own: Shard) -> None:
        self._root, self._own = root, own
        self._expressions = [str(one) for one in distinct(key_expressions)]
        for expression in self._expressions:
            if of_robot(expression, root, "") is None:
                text = f"{expression!r} names no robot under {root}, so it cannot be split into shards"
                raise CommandError(text, ExitCode.USAGE)
        super().__init__(settings, [], ROBOT_SAMPLES)
        self._overlap = have_overlap(distinct(key_expressions))
        self._robots: set[str] = set()

    def tokens_gone(self) -> Iterator[str]:
        """Keys of the liveliness tokens lost since the last call, of the robots of this shard."""
        while (token := self._tokens.try_recv()) is not None:
            robot = keys.robot_of_liveliness(self._root, str(token.key_expr))
            if robot is None or not self._own.has(robot):
                continue
            if token.kind != zenoh.SampleKind.PUT:
                yield str(token.key_expr)
            elif robot not in self._robots and len(self._robots) < ROBOTS_MAX:
                self._robots.add(robot)
                self._subscribe(self._of(robot))

    def _of(self, robot: str) -> Iterator[zenoh.KeyExpr]:
        yield from distinct([one for text in self._expressions if (one := of_robot(text, self._root, robot))])


def of_robot(expression: str, root: str, robot: str) -> str | None:
    """Restrict a key expression to one robot; an empty name stands for any robot.

    Returns:
        A key expression under the robot's keys; empty if it is of other robots; None if it is of none.
    """
    if expression in {"**", f"{root}/**"}:
        return f"{root}/{robot}/**"
    chunk, _, rest = expression.removeprefix(f"{root}/").partition("/")
    if not expression.startswith(f"{root}/") or not rest or chunk.startswith("@"):
        return None
    if chunk == "**":
        return f"{root}/{robot}/**/{rest}"
    if robot and not zenoh.KeyExpr(chunk).includes(zenoh.KeyExpr(robot)):
        return ""
    return f"{root}/{robot}/{rest}"
