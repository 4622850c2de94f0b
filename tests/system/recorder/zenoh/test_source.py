"""Samples from a real Zenoh, on the loopback."""

import time
from collections.abc import Iterator
from contextlib import closing
from functools import partial

import pytest
import zenoh

from recorder.encoding.samples import ReceivedSample
from recorder.zenoh import source as zenoh_source
from recorder.zenoh.source import ZenohSource
from schemas import keys
from schemas.command_line import CommandError, ExitCode
from schemas.keys import DeclaredKeys
from schemas.settings import ZenohSettings
from schemas.subjects import BY_VERB
from tests.support.fakes.peer import Peer
from tests.support.messages import FakeSample, info, sample_of
from tests.support.waiting import wait_until


def source(endpoint: str, *expressions: str, queue: int = 1000) -> ZenohSource:
    return ZenohSource(ZenohSettings(connect=[endpoint]), expressions or ["fleet/**"], queue)


class Inbox:
    def __init__(self, origin: ZenohSource) -> None:
        self._origin = origin
        self.samples: list[ReceivedSample] = []

    def holds(self, key: str) -> bool:
        self.samples += self._origin.drain(1000)
        return any(sample.key == key for sample in self.samples)


def put_until(peer: Peer, sample: ReceivedSample, inbox: Inbox) -> None:
    def condition() -> bool:
        peer.put(sample)
        return inbox.holds(sample.key)

    wait_until(condition)


@pytest.fixture
def linked(endpoint: str) -> Iterator[tuple[Peer, ZenohSource]]:
    with Peer(endpoint) as peer, closing(source(endpoint)) as origin:
        put_until(peer, FakeSample("fleet/link", "zenoh/bytes", b""), Inbox(origin))
        yield peer, origin


def test_a_sample_arrives_as_it_was_sent(linked: tuple[Peer, ZenohSource]) -> None:
    peer, origin = linked
    inbox = Inbox(origin)
    before_ns = time.time_ns()
    sent = FakeSample("fleet/x/y", "application/msgpack;some.Schema/3", b"\x00\xff", b"attached")
    peer.put(sent)
    wait_until(lambda: inbox.holds("fleet/x/y"))
    (received,) = [sample for sample in inbox.samples if sample.key == "fleet/x/y"]
    assert (received.key, received.encoding) == (sent.key, sent.encoding)
    assert (received.payload, received.attachment, received.deleted) == (sent.payload, sent.attachment, False)
    assert abs(received.zenoh_time_ns - before_ns) < 10 * 10**9
    peer.delete("fleet/x/gone")
    wait_until(lambda: inbox.holds("fleet/x/gone"))
    assert inbox.samples[-1].deleted


def test_requests_are_not_recorded(linked: tuple[Peer, ZenohSource]) -> None:
    peer, origin = linked
    inbox = Inbox(origin)
    requests = {keys.command("fleet", "cruiser-1", "first", verb) for verb in BY_VERB}
    for key in requests:
        peer.put(FakeSample(key, "zenoh/bytes", b""))
    peer.put(FakeSample("fleet/cruiser-1/safety/decision", "zenoh/bytes", b""))
    wait_until(lambda: inbox.holds("fleet/cruiser-1/safety/decision"))
    assert not requests & {sample.key for sample in inbox.samples}


def test_a_query_is_answered_among_the_samples(linked: tuple[Peer, ZenohSource]) -> None:
    peer, origin = linked
    reply = sample_of(info())
    peer.answer(reply)
    inbox = Inbox(origin)

    def condition() -> bool:
        if not origin.is_asking:
            origin.ask(reply.key)
        return inbox.holds(reply.key)

    wait_until(condition)
    assert inbox.samples[-1].payload == reply.payload
    assert inbox.samples[-1].encoding == reply.encoding
    assert [sample.is_reply for sample in inbox.samples if sample.key == reply.key] == [True]
    wait_until(lambda: inbox.holds(reply.key) and not origin.is_asking)


def test_a_query_without_an_answer_ends_by_itself(linked: tuple[Peer, ZenohSource]) -> None:
    _, origin = linked
    for number in range(2 * zenoh_source.PENDING_MAX):
        origin.ask(f"fleet/r{number}/gateway/info")
    assert len(origin._pending) == zenoh_source.PENDING_MAX
    inbox = Inbox(origin)
    wait_until(lambda: inbox.holds("") or not origin.is_asking)
    assert not [sample for sample in inbox.samples if sample.key.endswith("info")]


def test_a_key_that_several_expressions_match_is_received_once(endpoint: str) -> None:
    expressions = ("fleet/a/*", "fleet/*/x", "fleet/a/x", "other/**", "other/deep/**")
    with Peer(endpoint) as peer, closing(source(endpoint, *expressions)) as origin:
        keys = ["fleet/a/x", "fleet/a/y", "fleet/b/x", "other/deep/z"]
        for key in keys:
            put_until(peer, FakeSample(key, "zenoh/bytes", b""), Inbox(origin))
        inbox = Inbox(origin)
        for key in [*keys, "other/last"]:
            peer.put(FakeSample(key, "zenoh/bytes", b"counted"))
        wait_until(lambda: inbox.holds("other/last") and inbox.holds("fleet/b/x") and inbox.holds("fleet/a/y"))
        counted = sorted(sample.key for sample in inbox.samples if sample.payload == b"counted")
        assert counted == sorted([*keys, "other/last"])


def test_ever_new_keys_are_not_remembered_without_end(endpoint: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(zenoh_source, "OWNED_KEY_LIMIT", 10)
    with closing(source(endpoint, "fleet/a/*", "fleet/*/x")) as origin:
        for number in range(100):
            assert str(origin._owner(zenoh.KeyExpr(f"fleet/a/{number}"))) == "fleet/a/*"
            assert str(origin._owner(zenoh.KeyExpr(f"fleet/{number}/x"))) == "fleet/*/x"
            assert 0 < len(origin._owners) <= 10


def test_samples_of_declared_keys_come_once_and_those_of_others_too(linked: tuple[Peer, ZenohSource]) -> None:
    peer, origin = linked
    origin._declared = DeclaredKeys(origin._session.declare_publisher, 3)
    names = [f"fleet/r{number}/state" for number in range(10)]
    inbox = Inbox(origin)
    for last in ("fleet/last/1", "fleet/last/2", "fleet/last/3"):
        for name in names:
            peer.put(FakeSample(name, "zenoh/bytes", b""))
        peer.put(FakeSample(last, "zenoh/bytes", b""))
        wait_until(partial(inbox.holds, last))
    assert sorted(sample.key for sample in inbox.samples if sample.key in names) == sorted(3 * names)


def test_a_client_without_a_router_is_told_so(endpoint: str) -> None:
    settings = ZenohSettings(mode="client", connect=[endpoint])
    with pytest.raises(CommandError, match="cannot open Zenoh") as caught:
        ZenohSource(settings, ["fleet/**"], 100)
    assert caught.value.code == ExitCode.UNREACHABLE
