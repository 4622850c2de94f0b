"""The recorder's own keys, on a real Zenoh on the loopback."""

import threading
from collections.abc import Iterator
from contextlib import ExitStack, closing
from typing import Any

import msgspec
import pytest
import zenoh

from recorder.record.orders import OperatorRequest
from recorder.zenoh import remote_control
from recorder.zenoh.remote_control import RemoteControl
from schemas.codec import PayloadFault
from schemas.recording import (
    Mark,
    RecorderReply,
    Status,
)
from schemas.requests import Request
from schemas.settings import RecorderSettings, Settings, ZenohSettings
from schemas.subjects import RECORDER_BY_VERB
from schemas.zenoh_session import join
from tests.support.fakes.peer import Peer, free_endpoint
from tests.support.messages import recorder_health
from tests.support.newer import newer
from tests.support.waiting import wait_until

A_REPLY = RecorderReply(ok=True, detail="", files=[], health=recorder_health())


def settings(endpoint: str, name: str = "bench") -> Settings:
    return Settings(zenoh=ZenohSettings(connect=[endpoint]), recorder=RecorderSettings(name=name))


class Client:
    def __init__(self, endpoint: str) -> None:
        self._session = join(ZenohSettings(connect=[endpoint]))
        self._waiting: list[Any] = []

    def ask(
        self,
        key: str,
        payload: bytes | None = b"",
        encoding: str | None = None,
    ) -> Any:  # noqa: ANN401 - Zenoh's own handler
        return self._session.get(
            key,
            zenoh.handlers.FifoChannel(16),
            payload=payload,
            encoding=encoding,
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=60.0,
        )

    def tokens(self) -> set[str]:
        replies: Any = self._session.liveliness().get(
            "fleet/@recorder/*", zenoh.handlers.FifoChannel(16), timeout=1.0
        )
        return {str(reply.ok.key_expr) for reply in replies if reply.ok is not None}

    def close(self) -> None:
        self._session.close()


class Pair:
    def __init__(self, control: RemoteControl, client: Client) -> None:
        self.control = control
        self.client = client
        self.asked: list[OperatorRequest] = []
        wait_until(lambda: bool(self.take("status")))

    def key(self, verb: str, operator: str = "operator-1", recorder: str = "bench") -> str:
        return f"fleet/@recorder/{recorder}/@cmd/{operator}/{verb}"

    def take(self, verb: str, payload: bytes | None = b"", operator: str = "operator-1") -> list[OperatorRequest]:
        self.client.ask(self.key(verb, operator), payload)
        return list(self.control.drain())

    def next(self) -> OperatorRequest:
        def has_come() -> bool:
            self.asked += self.control.drain()
            return bool(self.asked)

        wait_until(has_come)
        return self.asked.pop(0)

    def settle(self) -> None:
        self.client.ask(self.key("mark", "last"))
        while self.next().operator != "last":
            pass
        self.asked.clear()


@pytest.fixture(autouse=True)
def _alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(remote_control, "NAMESAKES_S", 0.01)


@pytest.fixture
def endpoint() -> Iterator[str]:
    place = free_endpoint()
    with Peer(place):
        yield place


@pytest.fixture
def pair(endpoint: str) -> Iterator[Pair]:
    with closing(RemoteControl(settings(endpoint))) as control, closing(Client(endpoint)) as client:
        one = Pair(control, client)
        one.settle()
        yield one


STATUS, MARK = (RECORDER_BY_VERB[verb].encoding for verb in ("status", "mark"))


@pytest.mark.parametrize(
    ("verb", "payload", "encoding", "request_"),
    [
        ("status", b"", None, Status()),
        ("status", None, STATUS, Status()),
        ("mark", msgspec.msgpack.encode({}), None, Mark()),
        ("mark", msgspec.msgpack.encode({"text": "bump", "robot": "cruiser-1"}), MARK, Mark("bump", "cruiser-1")),
        # What is none is a fault that can be answered: nothing raises, and nothing large is even read.
        ("status", b"\xc1", None, ""),
        ("mark", b"\x00\xff", None, ""),
        ("mark", msgspec.msgpack.encode({"text": 5}), None, ""),
        ("mark", msgspec.msgpack.encode({"txt": ""}), None, ""),
        ("mark", msgspec.msgpack.encode({"text": "x" * 1001}), None, ""),
        ("mark", b"\x00" * 5000, None, "a request has at most 4096 bytes"),
        # The payload of another version is not read, though it may be one of this version's.
        ("status", b"", newer(STATUS), "and the recorder knows 1: upgrade the recorder"),
        ("mark", msgspec.msgpack.encode({}), newer(MARK), "and the recorder knows 1: upgrade the recorder"),
    ],
)
def test_a_request_comes_in_with_who_asks(
    pair: Pair, verb: str, payload: bytes | None, encoding: str | None, request_: Request | str
) -> None:
    pair.client.ask(pair.key(verb), payload, encoding)
    asked = pair.next()
    assert asked.operator == "operator-1"
    if isinstance(request_, str):
        assert isinstance(asked.request, PayloadFault)
        assert asked.request.detail.endswith(request_)
    else:
        assert asked.request == request_
    asked.reply(A_REPLY)


@pytest.mark.parametrize(
    "key",
    [
        "fleet/@recorder/bench/@cmd/operator-1/dance",
        "fleet/@recorder/bench/@cmd/*/status",
        "fleet/@recorder/bench/@cmd/operator-1/*",
        "fleet/@recorder/bench/@cmd/" + "a" * 65 + "/status",
        "fleet/@recorder/bench/@cmd/\x1b[2J/status",
    ],
)
def test_what_has_no_verb_or_no_operator_is_not_answered(pair: Pair, key: str) -> None:
    replies = pair.client.ask(key)
    pair.client.ask(pair.key("mark", "after"))
    assert pair.next().operator == "after"
    assert [reply for reply in replies if reply.ok is not None] == []


@pytest.mark.parametrize("recorder", ["*", "be*", "**"])
@pytest.mark.parametrize("verb", [verb for verb in RECORDER_BY_VERB if verb != "status"])
def test_one_query_does_not_mark_every_recorder(pair: Pair, verb: str, recorder: str) -> None:
    pattern = recorder.replace("be*", "be$*")
    pair.client.ask(pair.key(verb, recorder=pattern), msgspec.msgpack.encode({}))
    asked = pair.next()
    assert isinstance(asked.request, PayloadFault)
    assert asked.request.detail == f"{verb} must name one recorder, without a wildcard"
    asked.reply(A_REPLY)


class HungQuery:
    """A query whose reply blocks until the test releases it."""

    payload = attachment = encoding = None

    def __init__(self, key: str) -> None:
        self.key_expr = key
        self.said: list[str] = []
        self.goes_on = threading.Event()

    def reply(self, _key: str, _payload: bytes, encoding: str) -> None:
        assert self.goes_on.wait(60), encoding
        self.said.append("reply")

    def drop(self) -> None:
        self.said.append("done")


def test_who_does_not_read_holds_up_no_loop(pair: Pair) -> None:
    """The reply waits on another thread."""
    query: Any = HungQuery(pair.key("status"))
    asked = pair.control._asked(query)
    assert asked is not None
    asked.reply(A_REPLY)
    assert query.said == []
    query.goes_on.set()
    wait_until(lambda: query.said == ["reply", "done"])


def is_over(replies: Any) -> bool:  # noqa: ANN401 - Zenoh's own handler
    try:
        replies.try_recv()
    except zenoh.ZError:
        return True
    return False


def test_of_too_many_requests_the_oldest_go(pair: Pair) -> None:
    count = 2 * remote_control.QUERIES_WAITING
    replies = [pair.client.ask(pair.key("status", f"op-{number}")) for number in range(count)]
    pair.client.ask(pair.key("mark", "last"))
    wait_until(lambda: is_over(replies[0]))
    taken: list[str] = []

    def has_last() -> bool:
        batch = [asked.operator for asked in pair.control.drain()]
        assert len(batch) <= remote_control.REQUESTS_PER_PASS
        taken.extend(batch)
        return "last" in taken

    wait_until(has_last)
    assert "op-0" not in taken
    assert taken == [*sorted(taken[:-1], key=lambda name: int(name[3:])), "last"]


def test_recorders_of_one_name_are_told_apart(
    endpoint: str, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Links take longer on a busy machine.
    monkeypatch.setattr(remote_control, "NAMESAKES_S", 3.0)
    with ExitStack() as stack:
        client = stack.enter_context(closing(Client(endpoint)))
        first = RemoteControl(settings(endpoint))
        wait_until(lambda: client.tokens() == {"fleet/@recorder/bench"})
        second = stack.enter_context(closing(RemoteControl(settings(endpoint))))
        assert (first.name, second.name) == ("bench", "bench-2")
        wait_until(lambda: len(client.tokens()) == 2)
        third = stack.enter_context(closing(RemoteControl(settings(endpoint))))
        assert third.name == "bench-3"
        first.close()
        wait_until(lambda: client.tokens() == {"fleet/@recorder/bench-2", "fleet/@recorder/bench-3"})
        again = stack.enter_context(closing(RemoteControl(settings(endpoint))))
        assert again.name == "bench"
    assert "there is already a recorder bench; this one is bench-2" in caplog.text
