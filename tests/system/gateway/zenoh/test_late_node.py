"""A node that joins a router late."""

from __future__ import annotations

from typing import Any

import pytest
import zenoh
from zenoh import ext

from gateway.zenoh import inbox as late_node
from gateway.zenoh.client import PendingQuery, open_local_router
from gateway.zenoh.inbox import Joined, LateInbox, LateNode, open_inbox
from gateway.zenoh.node import client_place, open_node
from schemas.codec import Sample
from schemas.settings import RobotSettings, Settings, ZenohSettings
from schemas.subjects import KEPT_FIRST
from schemas.zenoh_session import close_session, open_session
from tests.support.fakes.peer import free_endpoint
from tests.support.waiting import wait_until

CAUSE = "no answer from"


@pytest.fixture(autouse=True)
def soon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(late_node, "AGAIN_S", 0.01)


def info() -> bytes:
    return b"\x80"


def test_what_is_kept_waits_for_the_router() -> None:
    endpoint = free_endpoint()
    settings = Settings(robot=RobotSettings(name="r-1"), zenoh=ZenohSettings(mode="client", connect=[endpoint]))

    def join() -> Joined:
        node, place = open_node(settings)
        return node, open_inbox(settings, place)

    assert client_place(settings).connect == [endpoint]
    inbox = LateInbox()
    node = LateNode(join, inbox, CAUSE)
    for subject, payload in (("journal", b"\x01"), ("safety/event", b"\x02"), ("state", b"\x03")):
        node.publish(Sample(subject, payload))
    node.answer(info)
    assert (node.peers(), node.failures) == (0, 0)
    assert (inbox.drain(""), inbox.statements(), inbox.drops, inbox.inbox) == ([], [], 0, None)
    router = open_local_router(endpoint)
    peer = open_session(ZenohSettings(mode="client"), [endpoint], [])
    try:
        events: Any = ext.declare_advanced_subscriber(
            peer,
            "fleet/r-1/safety/event",
            zenoh.handlers.RingChannel(10),
            history=ext.HistoryConfig(detect_late_publishers=True),
        )
        states = peer.declare_subscriber("fleet/r-1/state", zenoh.handlers.RingChannel(10))
        wait_until(lambda: node.peers() == 1, lambda: node.answer(info))
        assert node.notes() == ()
        assert inbox.inbox is not None
        heard: list[bytes] = []

        def hear() -> None:
            while (sample := events.try_recv()) is not None:
                heard.append(sample.payload.to_bytes())

        wait_until(lambda: bool(heard), hear)
        assert heard == [b"\x02"]
        question, found = PendingQuery(), list[bytes]()
        peer.get(f"fleet/r-1/journal?{KEPT_FIRST}=0", question.handler, timeout=10)

        def ask() -> None:
            node.answer(info)
            found.extend(received.payload for received in question.poll())

        wait_until(lambda: found == [b"\x01"], ask)
        node.publish(Sample("state", b"\x04"))
        wait_until(lambda: (sample := states.try_recv()) is not None and sample.payload.to_bytes() == b"\x04")
    finally:
        inbox.close()
        node.close()
        close_session(peer)
        router.close()
