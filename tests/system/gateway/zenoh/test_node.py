"""The gateway's Zenoh node."""

import socket
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Final

import pytest
import zenoh

from gateway.zenoh import node as zenoh_node
from gateway.zenoh.node import ZenohNode, open_node
from schemas.codec import Sample
from schemas.command_line import CommandError, ExitCode
from schemas.settings import RobotSettings, Settings, ZenohSettings
from schemas.subjects import KEPT_PIECE
from schemas.zenoh_session import close_session, open_session
from tests.support.fakes.peer import free_endpoint
from tests.support.processes.tcp_link import TcpLink
from tests.support.waiting import wait_until

BIG_REPLIES: Final = 16
BIG_REPLY: Final = bytes(8_000_000)  # far more than sockets hold


@pytest.fixture
def default_endpoint(monkeypatch: pytest.MonkeyPatch) -> str:
    endpoint = free_endpoint()
    monkeypatch.setattr(zenoh_node, "DEFAULT_ENDPOINT", endpoint)
    return endpoint


@pytest.fixture
def watcher(default_endpoint: str) -> Iterator[zenoh.Session]:
    session = open_session(ZenohSettings(), [default_endpoint], [])
    yield session
    close_session(session)


@pytest.fixture
def node(watcher: zenoh.Session) -> Iterator[ZenohNode]:
    """The node of r-1, which the watcher has met."""
    opened, _ = open_node(settings("r-1"))
    wait_until(lambda: bool(watcher.info.peers_zid()))
    yield opened
    opened.close()


def settings(name: str) -> Settings:
    return Settings(robot=RobotSettings(name=name))


def test_the_second_gateway_joins_the_first(default_endpoint: str, watcher: zenoh.Session) -> None:
    subscriber = watcher.declare_subscriber("fleet/*/state", zenoh.handlers.RingChannel(100))
    first, place = open_node(settings("r-1"))
    assert (place.connect, place.listen) == ([], [default_endpoint])
    second, place = open_node(settings("r-2"))
    assert place.connect == [default_endpoint]
    assert all(one.startswith("tcp/127.0.0.1:") for one in (*place.listen, *place.command_listen))
    heard: set[str] = set()

    def publish_and_hear() -> None:
        for node in (first, second):
            node.publish(Sample("state", b"\x80"))
        while (sample := subscriber.try_recv()) is not None:
            heard.add(str(sample.key_expr))

    wait_until(lambda: heard == {"fleet/r-1/state", "fleet/r-2/state"}, publish_and_hear)
    assert (first.failures, second.failures) == (0, 0)
    second.close()
    first.close()


def test_a_second_gateway_of_the_same_name_is_refused(default_endpoint: str) -> None:
    first, _ = open_node(settings("r-1"))
    with ThreadPoolExecutor(1) as thread:
        second = thread.submit(open_node, settings("r-1"))
        wait_until(second.done, lambda: first.answer(lambda: b"info"))
    with pytest.raises(CommandError, match="r-1 is already connected") as error:
        second.result()
    assert error.value.code is ExitCode.REFUSED
    first.close()
    again, place = open_node(settings("r-1"))
    assert place.listen == [default_endpoint]
    assert again.warning == ""
    again.close()


def test_a_token_that_no_gateway_stands_behind_keeps_nobody_from_starting(default_endpoint: str) -> None:
    """Any client can declare it."""
    stranger = open_session(ZenohSettings(), [], [default_endpoint])
    with stranger.liveliness().declare_token("fleet/r-1/gateway"):
        node, _ = open_node(settings("r-1"))
        assert node.warning.startswith("another node has declared the liveliness token of r-1")
        node.close()
    close_session(stranger)


def test_a_port_that_something_else_holds_is_told(default_endpoint: str) -> None:
    host, port = default_endpoint.removeprefix("tcp/").split(":")
    with (
        socket.create_server((host, int(port))),
        pytest.raises(CommandError, match="but not by a Zenoh node") as error,
    ):
        open_node(settings("r-1"))
    assert error.value.code is ExitCode.UNREACHABLE


@pytest.mark.parametrize(
    ("listen", "fault"), [("garbage", "is not an endpoint"), ("unixsock-stream//run/r.sock", "has no port")]
)
def test_what_is_no_place_for_two_sessions_is_told(listen: str, fault: str) -> None:
    with pytest.raises(CommandError, match=rf"to listen on: .*{fault}.*zenoh\.command_listen names") as error:
        open_node(Settings(zenoh=ZenohSettings(listen=[listen])))
    assert error.value.code is ExitCode.USAGE


def test_a_health_of_before_is_not_kept(watcher: zenoh.Session, node: ZenohNode) -> None:
    """Zenoh must not deliver it: a hanging gateway would look healthy."""
    node.publish(Sample("gateway/health", b"before"))
    # Zenoh's caches answer beneath this chunk, with samples of the key itself.
    history = watcher.get("fleet/r-1/gateway/health/@adv/**?_anyke", timeout=20)
    assert [reply for reply in history if reply.ok is not None] == []


def test_queries_are_answered_a_bounded_number_at_a_time(watcher: zenoh.Session, node: ZenohNode) -> None:
    replies = [watcher.get("fleet/r-1/gateway/info", timeout=20) for _ in range(5)]
    answered: list[int] = []

    def reply() -> bytes:
        answered[-1] += 1
        return b"\x80"

    def answer() -> None:
        answered.append(0)
        node.answer(reply)

    wait_until(lambda: sum(answered) == 5, answer)
    assert max(answered) <= zenoh_node.QUERIES_PER_TICK
    for handler in replies:
        assert [reply.ok is not None for reply in handler] == [True]


def test_who_takes_nothing_holds_nobody_else_up(default_endpoint: str) -> None:
    """Its link is closed long before Zenoh's own 5 s."""
    patient = Settings(robot=RobotSettings(name="r-1"), zenoh=ZenohSettings(lease_ms=60_000))
    node, _ = open_node(patient)
    other = open_session(ZenohSettings(), [default_endpoint], [])
    with TcpLink(default_endpoint) as proxy:
        stuck = open_session(patient.zenoh, [proxy.endpoint], [])
        wait_until(lambda: bool(stuck.info.peers_zid() and other.info.peers_zid()) and node.peers() == 2)
        proxy.is_stalled = True
        handlers = [stuck.get("fleet/r-1/gateway/info", timeout=60) for _ in range(2)]
        taken: list[bytes] = []

        def big() -> bytes:
            taken.append(BIG_REPLY)
            return BIG_REPLY

        wait_until(lambda: len(taken) == len(handlers), lambda: node.answer(big))
        asked = other.get("fleet/r-1/gateway/info", timeout=2)
        taken.clear()

        def small() -> bytes:
            taken.append(b"")
            return b"small"

        wait_until(lambda: bool(taken), lambda: node.answer(small))
        assert [reply.ok.payload.to_bytes() for reply in asked if reply.ok is not None] == [b"small"]
        proxy.close()
        close_session(stuck)
    close_session(other)
    node.close()


def test_what_is_kept_is_given_piece_by_piece(watcher: zenoh.Session, node: ZenohNode) -> None:
    for number in range(3 * KEPT_PIECE):
        node.publish(Sample("journal", b"%d" % number))

    def ask(parameters: str) -> list[bytes]:
        asked = watcher.get(
            f"fleet/r-1/journal{parameters}",
            timeout=20,
            consolidation=zenoh.ConsolidationMode.NONE,
            congestion_control=zenoh.CongestionControl.DROP,
        )
        with ThreadPoolExecutor(1) as pool:
            listening = pool.submit(lambda: list(asked))
            wait_until(listening.done, lambda: node.answer(lambda: b""))
        return [reply.ok.payload.to_bytes() for reply in listening.result() if reply.ok is not None]

    assert ask("?first=5") == [b"%d" % number for number in range(5, 5 + KEPT_PIECE)]
    assert ask(f"?first={3 * KEPT_PIECE - 1}") == [b"%d" % (3 * KEPT_PIECE - 1)]
    for parameters in ("", "?first=-1", "?first=x", "?first=" + "9" * 5000, "?first=4294967296", "?first=\u0665"):
        assert ask(parameters) == []


def test_a_closed_session_is_a_count_not_an_exception(default_endpoint: str) -> None:
    session = open_session(ZenohSettings(), [], [default_endpoint])
    node = ZenohNode(session, settings("r-1"))
    close_session(session)
    node.publish(Sample("state", b"\x80"))
    assert node.failures == 1
    node.close()
