"""Requests to recorders, on a real Zenoh on the loopback."""

from collections.abc import Iterator
from contextlib import closing

import pytest

from recorder.zenoh.remote_control import RecorderClient
from schemas import keys
from schemas.recording import RecorderReply, Status
from schemas.settings import ZenohSettings
from tests.support.fakes.peer import Peer, free_endpoint
from tests.support.fakes.recorders import a_reply, answering
from tests.support.waiting import wait_until

ANSWER_S = 0.5


class Both:
    def __init__(self, peer: Peer, client: RecorderClient) -> None:
        self.peer = peer
        self.client = client

    def ask(self, recorder: str = keys.ALL) -> list[tuple[str, RecorderReply]]:
        return list(self.client.ask(recorder, "status", Status(), ANSWER_S))

    def names(self) -> list[str]:
        return sorted(name for name, _ in self.ask())

    def names_heard_after(self, asked: list[str]) -> set[str]:
        heard: set[str] = set()

        def hear() -> bool:
            was_asked, names = bool(asked), self.names()
            heard.update(names)
            return was_asked and bool(names)

        wait_until(hear)
        return heard


@pytest.fixture
def both() -> Iterator[Both]:
    endpoint = free_endpoint()
    with (
        Peer(endpoint) as peer,
        closing(RecorderClient(ZenohSettings(connect=[endpoint]), "fleet", "operator-1")) as client,
    ):
        yield Both(peer, client)


@pytest.mark.parametrize(
    ("name", "payload"),
    [
        *((name, a_reply()) for name in ("\x1b[2J", "Depot", "a b", "\N{RIGHT-TO-LEFT OVERRIDE}x")),
        *(("liar", payload) for payload in (b"", b"\xc1", b"\x80", a_reply()[:-1], b"\x00" * 100_000)),
    ],
)
def test_who_is_not_called_as_a_recorder_or_talks_like_none_is_none(both: Both, name: str, payload: bytes) -> None:
    with answering(both.peer, name, payload, payload) as asked, answering(both.peer, "depot", a_reply()):
        assert both.names_heard_after(asked) == {"depot"}


def test_a_time_longer_than_zenoh_knows_is_a_long_time(both: Both) -> None:
    with answering(both.peer, "depot", a_reply()):
        wait_until(lambda: both.names() == ["depot"])
        assert [name for name, _ in both.client.ask("depot", "status", Status(), 1e300)] == ["depot"]
