"""Many robots on one session, as little of each as a stop and a list need."""

import threading
from collections.abc import Callable, Iterator
from itertools import count
from typing import Any, Self

import msgspec
import zenoh

from schemas import codec, keys
from schemas.decisions import Reply
from schemas.messages import Message
from schemas.reasons import Reason
from schemas.settings import ZenohSettings
from schemas.subjects import BY_TYPE, BY_VERB
from schemas.zenoh_session import close_session, open_session
from tests.support.fakes.peer import free_endpoint
from tests.support.messages import HEALTH, ROOT, STANDBY, STATE

STOP = BY_VERB["stop"]
STOPS = msgspec.msgpack.encode(Reply(ok=True, reason=Reason.NONE, detail="", cure=""))
LEASE_MS = 10_000  # a machine that is busy with a thousand robots must not lose the link to them
# A robot that has received the stop and stands.
PUBLISHED = (
    msgspec.structs.replace(STANDBY, latched=[Reason.REMOTE_STOP]),
    msgspec.structs.replace(STATE, speed_mps=0.0, rear_left_speed_mps=0.0, rear_right_speed_mps=0.0),
)
PERIOD_S = 0.05
ROUNDS = 40  # different states, two seconds long; then they repeat


class FakeFleet:
    """Robots that have a liveliness token and answer a stop.

    Attributes:
        publishes: each publishes 20 times a second that it is latched and stands.
        moves: each publishes states that change, and its health once a second.
    """

    def __init__(self, count: int, *, publishes: bool = False, moves: bool = False) -> None:
        self.publishes, self.moves = publishes or moves, moves
        self.listen = free_endpoint()
        self.names = [f"robot-{number:04}" for number in range(count)]

    def __enter__(self) -> Self:
        self._session = open_session(ZenohSettings(lease_ms=LEASE_MS), [], [self.listen])
        self._declared: list[Any] = []
        for name in self.names:
            self._declared.append(self._session.liveliness().declare_token(keys.liveliness(ROOT, name)))
            key = keys.command(ROOT, name, keys.ALL, "stop")
            handler = zenoh.handlers.Callback(_stopping(name), indirect=False)
            self._declared.append(self._session.declare_queryable(key, handler, complete=True))
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._publish)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._closing.set()
        self._thread.join()
        close_session(self._session)

    def _publish(self) -> None:
        turns = count()
        while self.publishes and not self._closing.wait(PERIOD_S):
            for message in _moving(next(turns) % ROUNDS) if self.moves else PUBLISHED:
                subject, payload = BY_TYPE[type(message)], codec.encode(message)
                for name in self.names:
                    self._session.put(keys.build(ROOT, name, subject), payload, encoding=subject.encoding)


def _moving(turn: int) -> Iterator[Message]:
    yield msgspec.structs.replace(STATE, speed_mps=round(0.02 * turn, 3), sequence=turn)
    yield msgspec.structs.replace(STANDBY, sequence=turn)
    if turn * PERIOD_S % 1 == 0:
        yield HEALTH


def _stopping(name: str) -> Callable[[zenoh.Query], None]:
    def answer(query: zenoh.Query) -> None:
        operator, verb = keys.parse_command(str(query.key_expr))
        with query:
            query.reply(keys.command(ROOT, name, operator, verb), STOPS, encoding=STOP.reply_encoding)

    return answer
