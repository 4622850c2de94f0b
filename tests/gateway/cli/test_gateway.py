"""``cruiser gateway`` as a process, with a virtual chassis as a process."""

import signal
import socket
from collections.abc import Callable
from typing import Any

import msgpack
import pytest
import zenoh

from gateway.ports.zenoh_client import close_session, open_session
from schemas.dbc_files import dbc_text
from schemas.messages import Variant
from schemas.settings import ZenohSettings
from schemas.subjects import SUBJECTS, Pattern
from tests.gateway.cli.running import chassis, gateway, run
from tests.gateway.remote.fake_gateway import free_endpoint
from tests.gateway.remote.waiting import wait_until


class Listener:
    """Hears everything under ``fleet``, with Zenoh and MessagePack alone."""

    def __init__(self, endpoint: str) -> None:
        self.session = open_session(ZenohSettings(), [endpoint], [])
        self._subscriber = self.session.declare_subscriber("fleet/**", zenoh.handlers.RingChannel(100_000))
        self.latest: dict[str, dict[str, Any]] = {}
        self.encodings: dict[str, str] = {}

    def hear(self) -> None:
        """Take what has come."""
        while (sample := self._subscriber.try_recv()) is not None:
            key = str(sample.key_expr)
            self.latest[key] = msgpack.unpackb(sample.payload.to_bytes())
            self.encodings[key] = str(sample.encoding)

    def wait_for(self, key: str, condition: Callable[[dict[str, Any]], bool] = bool) -> dict[str, Any]:
        """Hear until the newest message of this key fulfils the condition."""
        wait_until(lambda: key in self.latest and condition(self.latest[key]), self.hear)
        return self.latest[key]

    def info(self, robot: str) -> dict[str, Any]:
        """What a query on a robot's gateway/info replies."""
        for reply in self.session.get(f"fleet/{robot}/gateway/info", timeout=10):
            assert reply.ok is not None
            payload: dict[str, Any] = msgpack.unpackb(reply.ok.payload.to_bytes())
            return payload
        raise AssertionError("nobody replied")

    def close(self) -> None:
        close_session(self.session)


@pytest.mark.parametrize("variant", ["coarse", "fine"])
def test_every_subject_is_published_as_the_table_says(variant: str) -> None:
    """All keys come with their encodings; info is answered; the token is there; SIGTERM ends it with 0."""
    endpoint = free_endpoint()
    with chassis("--variant", variant) as (_, address), gateway(address, endpoint, "--robot", "r-1") as running:
        listener = Listener(endpoint)
        try:
            for subject in SUBJECTS:
                if subject.pattern is Pattern.PUBLISHED:
                    key = f"fleet/r-1/{subject.name.format(bus='can0')}"
                    listener.wait_for(key)
                    assert listener.encodings[key] == subject.encoding
            state = listener.wait_for("fleet/r-1/state", lambda state: state["variant"] == variant)
            assert (state["mode"], state["gear_position"], state["bus_up"]) == ("stop", "park", True)
            health = listener.wait_for("fleet/r-1/gateway/health")
            assert sum(row["lost"] for row in health["feedback"]) == 0
            info = listener.info("r-1")
            assert (info["robot"], info["variant"], info["listen_only"]) == ("r-1", variant, True)
            assert info["dbc"] == dbc_text(Variant(variant))
            assert info["schemas"].keys() == {subject.schema_name for subject in SUBJECTS}
            tokens = [
                str(reply.ok.key_expr)
                for reply in listener.session.liveliness().get("fleet/*/gateway")
                if reply.ok
            ]
            assert tokens == ["fleet/r-1/gateway"]
        finally:
            listener.close()
        assert running.stop() == 0


def test_a_lost_chassis_comes_back() -> None:
    """The server goes: the state says so, nothing ends. It returns at the same place: frames come again."""
    endpoint = free_endpoint()
    with chassis() as (sim, address), gateway(address, endpoint) as running:
        listener = Listener(endpoint)
        try:
            listener.wait_for("fleet/cruiser-1/state", lambda state: state["bus_up"] and not state["silent"])
            sim.stop(signal.SIGKILL)
            state = listener.wait_for("fleet/cruiser-1/state", lambda state: not state["bus_up"])
            running.wait_says("the bus is lost")
            state = listener.wait_for("fleet/cruiser-1/state", lambda state: len(state["silent"]) == 10)
            assert (state["mode"], state["speed_mps"]) == ("undefined", None)
            listener.wait_for(
                "fleet/cruiser-1/gateway/health", lambda health: "no socketcand" in health["bus_detail"]
            )
            with chassis(listen=address):
                listener.wait_for("fleet/cruiser-1/state", lambda state: state["bus_up"] and not state["silent"])
                health = listener.wait_for("fleet/cruiser-1/gateway/health", lambda health: health["bus_up"])
                assert health["bus_losses"] == 1
                assert running.stop(signal.SIGINT) == 0
        finally:
            listener.close()


def test_a_lost_zenoh_node_comes_back() -> None:
    """A gateway that is connected to another node outlives it, and is heard again when the node returns."""
    router_endpoint, endpoint = free_endpoint(), free_endpoint()
    router = open_session(ZenohSettings(), [], [router_endpoint])
    with chassis() as (_, address), gateway(address, endpoint, "--connect", router_endpoint) as running:
        wait_until(lambda: bool(router.info.peers_zid()))
        close_session(router)
        listener = Listener(endpoint)
        try:
            listener.wait_for("fleet/cruiser-1/gateway/health", lambda health: health["zenoh_peers"] == 1)
            router = open_session(ZenohSettings(), [], [router_endpoint])
            wait_until(lambda: bool(router.info.peers_zid()))
            subscriber = router.declare_subscriber("fleet/*/state", zenoh.handlers.RingChannel(1))
            wait_until(lambda: subscriber.try_recv() is not None)
        finally:
            listener.close()
            close_session(router)
        assert running.stop() == 0


def test_two_robots_on_one_bench() -> None:
    """The second gateway connects to the first one's node; whoever connects there hears both."""
    endpoint = free_endpoint()
    with (
        chassis() as (_, one),
        chassis() as (_, other),
        gateway(one, endpoint, "--robot", "r-1"),
        gateway(other, "tcp/127.0.0.1:0", "--connect", endpoint, "--robot", "r-2"),
    ):
        listener = Listener(endpoint)
        try:
            listener.wait_for("fleet/r-1/state")
            listener.wait_for("fleet/r-2/state")
        finally:
            listener.close()


def test_faults_are_counted_by_kind_and_never_published_as_data() -> None:
    """Checksum faults and strangers on the bus appear in health, the silent frame in the state."""
    endpoint = free_endpoint()
    faults = [
        "checksum Auto_GearFeedBack",
        "foreign 123",
        "silence Auto_SpeakerFeedback",
        "skip Auto_DriveFeedBack",
    ]
    words = [word for fault in faults for word in ("--fault", f"1ms {fault}")]
    with chassis(*words) as (_, address), gateway(address, endpoint):
        listener = Listener(endpoint)
        try:
            health = listener.wait_for(
                "fleet/cruiser-1/gateway/health",
                lambda health: {"checksum", "unknown_identifier", "alive_lost"} <= health["faults"].keys(),
            )
            assert health["unknown_identifiers"].keys() == {"123"}
            state = listener.wait_for("fleet/cruiser-1/state", lambda state: len(state["silent"]) == 2)
            assert set(state["silent"]) == {"Auto_GearFeedBack", "Auto_SpeakerFeedback"}
            assert state["gear_position"] == "undefined"
            assert "fleet/cruiser-1/chassis/gear" not in listener.latest
        finally:
            listener.close()


def test_a_missing_bus_is_one_clear_line() -> None:
    """No server, no device: exit code 4 and one line that says what to do."""
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{taken.getsockname()[1]}"
        done = run(["gateway", "--interface", "socketcand", "--channel", address, "--listen", free_endpoint()])
    assert done.returncode == 4
    says = f"no socketcand server at {address}: [Errno 111] Connection refused (--wait-for-bus starts without it)"
    assert done.stderr.splitlines() == [f"cruiser gateway: {says}"]
    done = run(["gateway", "--channel", "nosuchcan", "--listen", free_endpoint()])
    assert done.returncode == 4
    assert len(done.stderr.splitlines()) == 1


def test_a_gateway_may_wait_for_its_bus() -> None:
    """With --wait-for-bus it starts, says that the bus is down, and goes on when the chassis appears."""
    endpoint = free_endpoint()
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{taken.getsockname()[1]}"
    with gateway(address, endpoint, "--wait-for-bus"):
        listener = Listener(endpoint)
        try:
            listener.wait_for("fleet/cruiser-1/state", lambda state: not state["bus_up"])
            with chassis(listen=address):
                listener.wait_for("fleet/cruiser-1/state", lambda state: state["bus_up"] and not state["silent"])
        finally:
            listener.close()


def test_an_endpoint_that_is_taken_is_one_clear_line() -> None:
    """A chosen endpoint that something else holds: exit code 4, one line, no traceback."""
    with chassis() as (_, address), socket.create_server(("127.0.0.1", 0)) as taken:
        endpoint = f"tcp/127.0.0.1:{taken.getsockname()[1]}"
        done = run(["gateway", "--interface", "socketcand", "--channel", address, "--listen", endpoint])
    assert done.returncode == 4
    assert len(done.stderr.splitlines()) == 1
    assert "Address already in use" in done.stderr


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--interface", "nosuch"], "nosuch"),
        (["--interface", "socketcand", "--channel", "x"], "HOST:PORT"),
        (["--variant", "rough"], "variant"),
        (["--robot", "Cruiser 1"], "robot.name"),
        (["--no-listen-only"], "listen_only"),
    ],
)
def test_a_wrong_flag_is_one_clear_line(words: list[str], says: str) -> None:
    """Exit code 2, and the line names what is wrong."""
    done = run(["gateway", "--listen", free_endpoint(), *words])
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
    assert says in done.stderr
