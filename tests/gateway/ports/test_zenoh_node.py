"""The gateway's place on Zenoh."""

import socket
from collections.abc import Iterator

import msgpack
import pytest
import zenoh

from gateway.ports import zenoh_node
from gateway.ports.zenoh_client import close_session, open_session
from gateway.ports.zenoh_node import ZenohNode, open_node
from gateway.telemetry.sample import Sample
from schemas.exit_codes import CommandError, ExitCode
from schemas.settings import RobotSettings, Settings, ZenohSettings
from tests.gateway.remote.fake_gateway import free_endpoint
from tests.gateway.remote.waiting import wait_until


@pytest.fixture
def default_endpoint(monkeypatch: pytest.MonkeyPatch) -> str:
    """A default endpoint that belongs to this test alone."""
    endpoint = free_endpoint()
    monkeypatch.setattr(zenoh_node, "DEFAULT_ENDPOINT", endpoint)
    return endpoint


@pytest.fixture
def watcher(default_endpoint: str) -> Iterator[zenoh.Session]:
    """Another process's session, connected to the default endpoint."""
    session = open_session(ZenohSettings(), [default_endpoint], [])
    yield session
    close_session(session)


def settings(name: str) -> Settings:
    """The settings of a robot."""
    return Settings(robot=RobotSettings(name=name))


def test_the_second_gateway_joins_the_first(default_endpoint: str, watcher: zenoh.Session) -> None:
    """The port is taken by a Zenoh node: the second is reached through it, and both are heard there."""
    subscriber = watcher.declare_subscriber("fleet/*/state", zenoh.handlers.RingChannel(100))
    first, where = open_node(settings("r-1"))
    assert where == f"at {default_endpoint}"
    second, where = open_node(settings("r-2"))
    assert where == f"through the Zenoh node at {default_endpoint}"
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
    """One name is one robot; the second gateway says so and leaves, the first goes on."""
    first, _ = open_node(settings("r-1"))
    with pytest.raises(CommandError, match="r-1 is connected already") as error:
        open_node(settings("r-1"))
    assert error.value.code is ExitCode.REFUSED
    first.close()
    again, where = open_node(settings("r-1"))
    assert where == f"at {default_endpoint}"
    again.close()


def test_a_port_that_something_else_holds_is_told(default_endpoint: str) -> None:
    """What listens there does not speak Zenoh: the gateway says so instead of waiting for ever."""
    host, port = default_endpoint.removeprefix("tcp/").split(":")
    with (
        socket.create_server((host, int(port))),
        pytest.raises(CommandError, match="not by a Zenoh node") as error,
    ):
        open_node(settings("r-1"))
    assert error.value.code is ExitCode.UNREACHABLE


def test_health_is_there_for_those_who_come_late(watcher: zenoh.Session) -> None:
    """The last health is kept; whoever asks for the history of the key gets it at once."""
    node, _ = open_node(settings("r-1"))
    node.publish(Sample("gateway/health", msgpack.packb({"sequence": 7})))
    late = zenoh.ext.declare_advanced_subscriber(
        watcher,
        "fleet/r-1/gateway/health",
        zenoh.handlers.RingChannel(1),
        history=zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=1),
    )
    received: list[bytes] = []

    def hear() -> None:
        sample = late.try_recv()
        if sample is not None:
            received.append(sample.payload.to_bytes())

    wait_until(lambda: bool(received), hear)
    assert msgpack.unpackb(received[0]) == {"sequence": 7}
    node.close()


def test_queries_are_answered_a_bounded_number_at_a_time(watcher: zenoh.Session) -> None:
    """A crowd of queries cannot hold the loop: two are answered each time, the rest waits."""
    node, _ = open_node(settings("r-1"))
    wait_until(lambda: bool(watcher.info.peers_zid()))
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
    node.close()


def test_a_closed_session_is_a_count_not_an_exception(default_endpoint: str) -> None:
    """Whatever becomes of Zenoh, publishing never raises into the loop."""
    session = open_session(ZenohSettings(), [], [default_endpoint])
    node = ZenohNode(session, settings("r-1"))
    close_session(session)
    node.publish(Sample("state", b"\x80"))
    assert node.failures == 1
    node.close()
