"""Services without a valid certificate, or without a router: each waits, and logs the cure once."""

import os
import socket
import time
from collections.abc import Iterator
from contextlib import closing, nullcontext
from pathlib import Path

import pytest

from gateway.authority.enrolment import TransportRole
from gateway.provisioning.key_files import LEAF_DAYS
from gateway.zenoh.client import open_local_router
from gateway.zenoh.inbox import AGAIN_S
from schemas.command_line import ExitCode
from tests.support.fakes.peer import free_endpoint
from tests.support.nights import by_night, some_by_day
from tests.support.processes.gateway import Running, chassis
from tests.support.routers import router_process
from tests.support.secured import Network
from tests.support.waiting import wait_until

DAY_S = 86_400
ENDED = r"robot-tls\.pem ended 1\.0 days ago; 'cruiser provision renew robot'"


FUTURE_S = 2 * DAY_S

SERVICES = {
    "router": (TransportRole.ROUTER, "router: listens on "),
    "record": (TransportRole.RECORDER, "record: waiting for samples of "),
    "desk": (TransportRole.DESK, "desk: http://"),
    "metrics": (TransportRole.VIEWER, "metrics: http://"),
}
"""Services besides the gateway: role of the certificate, and the line that shows that it works."""


class Scene:
    """A router, a chassis, and a robot whose certificate ended yesterday."""

    def __init__(self, directory: Path, bus: str) -> None:
        self.network = Network(directory, free_endpoint().replace("tcp/", "tls/"))
        self.router = self.network.node(TransportRole.ROUTER, "127.0.0.1") / "router.json5"
        self.robot = self.certify(int(time.time()) - (LEAF_DAYS + 1) * DAY_S)
        file = self.robot / "robot.json5"
        self.words = ("--interface", "socketcand", "--channel", bus, "--zenoh-config", str(file))

    def certify(self, born_s: int | None = None) -> Path:
        """Issue a key and a certificate, with this date. Returns their directory."""
        return self.network.node(TransportRole.ROBOT, "cruiser-1", "cruiser-1", born_s)


@pytest.fixture
def scene(tmp_path: Path) -> Iterator[Scene]:
    with chassis() as (_, bus):
        scene = Scene(tmp_path, bus)
        with router_process(scene.router):
            yield scene


@pytest.fixture
def systemd(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[socket.socket]:
    """The service manager's end of its socket."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind(str(tmp_path / "notify"))
        listening.settimeout(30)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        yield listening


def test_a_gateway_watches_its_chassis_and_joins_with_another(scene: Scene, systemd: socket.socket) -> None:
    with Running("gateway", *scene.words) as gateway:
        gateway.wait_says(f"{ENDED}.*; the robot is off the network")
        gateway.wait_says("the bus is up")
        told: list[str] = []

        def hear() -> None:
            told.append(systemd.recv(1000).decode())

        wait_until(lambda: bool(told) and "off the network: " in told[-1] and "bus up" in told[-1], hear)
        assert told[0].startswith("WATCHDOG=1\nREADY=1\nSTATUS=standby")
        assert "'cruiser provision renew robot'" in told[-1]
        time.sleep(3 * AGAIN_S)
        assert len([line for line in gateway.said if "ended" in line]) == 1, gateway.said
        scene.certify()
        gateway.wait_says("the robot is on the network")
        wait_until(lambda: "STATUS=" in told[-1] and "off the network" not in told[-1], hear)
        assert gateway.stop() == ExitCode.OK


def test_a_recorder_waits_for_its_router(
    tmp_path: Path, systemd: socket.socket, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CRUISER_ZENOH_MODE", "client")
    endpoint = free_endpoint()
    words = ["--connect", endpoint, "--out", str(tmp_path / "logs")]
    away = rf"no answer from {endpoint}: check the router .*; off the network until then"

    status = f"STATUS=standby, off the network: cannot open Zenoh: no answer from {endpoint}"
    with Running("record", *words) as recorder:
        recorder.wait_says(away)
        assert status in systemd.recv(1000).decode()
        assert recorder.stop() == ExitCode.OK
        assert systemd.recv(1000).endswith(b"STATUS=")
    with Running("record", *words) as recorder:
        recorder.wait_says(away)
        assert status in systemd.recv(1000).decode()
        # It has tried again meanwhile.
        wait_until(lambda: systemd.recv(1000) == b"WATCHDOG=1")
        with closing(open_local_router(endpoint)):
            recorder.wait_says("record: waiting for samples of ")
            wait_until(lambda: systemd.recv(1000).endswith(b"STATUS="))
            assert len([line for line in recorder.said if "no answer from" in line]) == 1, recorder.said
            recorder.stop()


def test_by_hand_it_ends_with_the_same_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert "NOTIFY_SOCKET" not in os.environ
    monkeypatch.setenv("CRUISER_ZENOH_MODE", "client")
    endpoint = free_endpoint()
    with Running("record", "--connect", endpoint, "--out", str(tmp_path)) as recorder:
        recorder.wait_says(f"cruiser record: cannot open Zenoh: no answer from {endpoint}: check ")
        assert recorder.process.wait(30) == ExitCode.UNREACHABLE


@pytest.mark.parametrize("command", some_by_day([*SERVICES], len(SERVICES)))
@pytest.mark.parametrize(
    ("born_s", "says"),
    [
        (-(LEAF_DAYS + 1) * DAY_S, r" ended 1\.0 days ago; "),
        by_night(FUTURE_S, r" begins in \d\.\d days by this computer's"),
    ],
    ids=["ended", "not_begun"],
)
def test_every_other_service_waits_likewise(
    tmp_path: Path, systemd: socket.socket, command: str, born_s: int, says: str
) -> None:
    role, works = SERVICES[command]
    network = Network(tmp_path, free_endpoint().replace("tcp/", "tls/"))
    router = network.node(TransportRole.ROUTER, "127.0.0.1") / "router.json5"

    def certify(born_s: int | None = None) -> Path:
        return network.node(role, "127.0.0.1", born_s=born_s)

    place = certify(int(time.time()) + born_s)
    words = {
        "record": ["--out", str(tmp_path / "logs")],
        "desk": ["--listen", "127.0.0.1:0"],
        "metrics": ["--listen", "127.0.0.1:0"],
    }.get(command, [])
    with (
        nullcontext() if command == "router" else router_process(router),
        Running(command, "--zenoh-config", str(place / f"{role.value}.json5"), *words) as service,
    ):
        service.wait_says(rf"{role.value}-tls\.pem{says}")
        assert systemd.recv(1000).decode().partition("STATUS=")[2].startswith("standby, off the network: ")
        assert [systemd.recv(1000) for _ in range(2)] == [b"WATCHDOG=1"] * 2
        assert service.process.poll() is None
        assert len([line for line in service.said if "-tls.pem" in line]) == 1, service.said
        certify()
        service.wait_says(works)
        assert systemd.recv(1000).endswith(b"STATUS=")
        # A recorder to which nobody spoke says that there is no log.
        assert service.stop() == (ExitCode.UNREACHABLE if command == "record" else ExitCode.OK)


@pytest.mark.parametrize("command", ["stop", "list"])
@pytest.mark.usefixtures("systemd")
def test_a_command_that_asks_does_not_wait(tmp_path: Path, command: str) -> None:
    network = Network(tmp_path, free_endpoint().replace("tcp/", "tls/"))
    ended_s = int(time.time()) - (LEAF_DAYS + 1) * DAY_S
    place = network.node(TransportRole.OPERATOR, "ann", born_s=ended_s)
    words = ["cruiser-1"] if command == "stop" else []
    with Running(command, *words, "--zenoh-config", str(place / "operator.json5")) as asking:
        asking.wait_says(r"operator-tls\.pem ended 1\.0 days ago; ")
        assert asking.process.wait(30) == ExitCode.USAGE
