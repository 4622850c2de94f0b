"""The clients of docs/examples in Rust and TypeScript drive robots in open mode and in signed mode.

In signed mode through a router, with the files that ``cruiser provision`` makes. ``make drive-clients`` builds the
clients, and says where they are: ``RUST_CLIENT``, and ``BRIDGE`` from WebSocket to Zenoh.
"""

import json
import os
import shutil
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Self

import msgspec
import pytest
import zenoh

from tests.support.fakes.peer import free_endpoint
from tests.support.fakes.robot import FakeRobot
from tests.support.processes import gateway as commands
from tests.support.processes.gateway import Running, chassis
from tests.support.provisioning import ProvisionedFleet
from tests.support.waiting import wait_until

EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"
ROBOT = "fleet/cruiser-1"
CLIENTS = pytest.mark.parametrize("client", ["rust", "typescript"])

STANDS = {"no_lease", "not_engaged"}
"""Reasons for which an idle robot stands."""

Done = subprocess.CompletedProcess[str]


def run(*words: str) -> Done:
    return subprocess.run(
        words, cwd=EXAMPLES / "typescript", capture_output=True, text=True, timeout=60, check=False
    )


@contextmanager
def bridge(*words: str) -> Iterator[str]:
    """Zenoh's bridge for WebSockets, started with these words; yields where it listens."""
    place = free_endpoint().removeprefix("tcp/")
    words = (os.environ["BRIDGE"], "--ws-port", place, *words)
    said: list[str] = []
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as process:
        assert process.stdout is not None
        try:
            for line in process.stdout:
                said.append(line)
                if "Finished loading plugins" in line:
                    break
            assert process.poll() is None, said
            yield f"ws/{place}"
        finally:
            process.kill()


def drive_open(client: str, endpoint: str) -> Done:
    if client == "rust":
        return run(os.environ["RUST_CLIENT"], endpoint, ROBOT)
    with bridge("--mode", "client", "--connect", endpoint) as place:
        return run("npm", "start", "--silent", "--", place, ROBOT)


def drive_signed(client: str, directory: Path) -> Done:
    if client == "rust":
        return run(os.environ["RUST_CLIENT"], str(directory), ROBOT)
    with bridge("--config", str(directory / "operator.json5")) as place:
        return run("npm", "start", "--silent", "--", place, ROBOT, str(directory))


class SignedRobot:
    def __init__(self, fleet: ProvisionedFleet, gateway: Running) -> None:
        self.fleet = fleet
        self.gateway = gateway


@pytest.fixture
def signed(tmp_path: Path) -> Iterator[SignedRobot]:
    endpoint = free_endpoint().replace("tcp/", "tls/")
    fleet = ProvisionedFleet(tmp_path / "fleet", endpoint)
    router, robot = fleet.let_in("router", "127.0.0.1"), fleet.let_in("robot", "cruiser-1")
    with Running("router", "--directory", str(router)) as running, chassis() as (_, address):
        running.wait_says("listens on")
        bus = ["--interface", "socketcand", "--channel", address]
        with Running("gateway", "--config", str(robot / "robot.toml"), *bus) as gateway:
            gateway.wait_says("a Zenoh node is connected")
            yield SignedRobot(fleet, gateway)


def wait_until_ready(operator: Path) -> None:

    def is_ready() -> bool:
        words = ["watch", "cruiser-1", "--seconds", "0.5", "--json", "--config", str(operator / "operator.toml")]
        states = [json.loads(line)["safety"] for line in commands.run(words).stdout.splitlines()]
        return any(state is not None and not set(state["blocked_by"]) - STANDS for state in states)

    wait_until(is_ready)


@CLIENTS
def test_a_client_drives_a_robot_in_open_mode(client: str) -> None:
    with FakeRobot() as fake:
        done = drive_open(client, fake.listen)
        assert done.returncode == 0, done
        assert done.stdout.endswith("driven\n")
        assert max(one.output_speed_mps for one in fake.accepted("drive")) == 0.5
        assert fake.accepted("release")


@CLIENTS
def test_a_client_drives_a_robot_in_signed_mode(client: str, signed: SignedRobot) -> None:
    ann = signed.fleet.let_in("operator", "ann")
    wait_until_ready(ann)
    done = drive_signed(client, ann)
    assert done.returncode == 0, done
    assert done.stdout.endswith("driven\n")
    signed.gateway.wait_says("ann has acquired the lease as operator")
    signed.gateway.wait_says("engaged: the chassis reads auto")
    signed.gateway.wait_says("ann gave the lease back")


@CLIENTS
@pytest.mark.parametrize(
    ("files", "says"),
    [
        (("authority.json", "operator.key", "operator.grant"), "grant is of another authority"),
        (("operator.key", "operator.grant"), "it is not signed by the authority that is known here"),
    ],
    ids=["it trusts another authority", "another authority granted it"],
)
def test_a_client_of_another_authority_gets_no_lease(
    client: str, signed: SignedRobot, tmp_path: Path, files: tuple[str, ...], says: str
) -> None:
    ann = signed.fleet.let_in("operator", "ann")
    other = ProvisionedFleet(tmp_path / "other").let_in("operator", "ann")
    for name in files:
        shutil.copy(other / name, ann / name)
    done = drive_signed(client, ann)
    assert done.returncode == 1, done
    assert says in done.stdout + done.stderr
    assert not [line for line in signed.gateway.said if "lease" in line]


class Impostor:
    """A compromised robot that poses as another, unsigned, and with what that one signed earlier.

    Attributes:
        asked: the keys of received queries, with the size of each proof in bytes.
    """

    def __init__(self, directory: Path, own: str) -> None:
        self._own = own
        config = zenoh.Config.from_file(str(directory / "robot.json5"))
        config.insert_json5("access_control", '{"enabled": false}')
        self._session = zenoh.open(config)
        self._states = self._session.declare_publisher(f"{ROBOT}/safety/state")
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._speak)
        self._kept: zenoh.Sample
        self.asked: dict[str, int] = {}

    def __enter__(self) -> Self:
        for key in (f"{ROBOT}/@auth", f"{ROBOT}/@cmd/*/*"):
            self._session.declare_queryable(key, self._reply, complete=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._is_over.set()
        self._thread.join()
        self._session.close()

    def keep(self, sample: zenoh.Sample) -> None:
        self._kept = sample

    def _reply(self, query: zenoh.Query) -> None:
        key = str(query.key_expr)
        self.asked[key] = len(query.attachment or b"")
        said = {
            "ok": key.endswith("@auth"),
            "reason": "busy",
            "detail": "forged",
            "cure": "none",
            "own": self._own,
        }
        with query:
            query.reply(key, msgspec.msgpack.encode(said), attachment=b"\1" * 73)
            query.reply_err(b"forged")

    def _speak(self) -> None:
        forged = msgspec.msgpack.decode(self._kept.payload.to_bytes())
        forged |= {"engaged": False, "challenge": bytes(8), "sequence": forged["sequence"] + 1000}
        while not self._is_over.wait(0.02):
            self._states.put(msgspec.msgpack.encode(forged), attachment=self._kept.attachment)
            self._states.put(self._kept.payload, encoding=self._kept.encoding, attachment=self._kept.attachment)


@CLIENTS
def test_a_client_believes_no_impostor(client: str, signed: SignedRobot) -> None:
    """Verbs under the lease carry the holder's tag too, so that no flood delays them (docs/authority.md)."""
    ann, other = signed.fleet.let_in("operator", "ann"), signed.fleet.let_in("robot", "cruiser-2")
    wait_until_ready(ann)
    config = zenoh.Config.from_file(str(ann / "operator.json5"))
    with zenoh.open(config) as session:
        states = session.declare_subscriber(f"{ROBOT}/safety/state", zenoh.handlers.RingChannel(1))
        impostor = Impostor(other, (signed.fleet.place / "cruiser-1" / "robot.grant").read_text())
        impostor.keep(states.recv())
        with impostor:
            wait_until(lambda: "forged" in errors_of(session))
            impostor.asked.clear()
            done = drive_signed(client, ann)
    assert done.returncode == 0, done
    assert done.stdout.endswith("driven\n")
    assert {key.rpartition("/")[2]: size for key, size in impostor.asked.items()} == {
        "@auth": 16,
        "acquire": 89,
        "engage": 105,
        "unpark": 105,
        "release": 105,
    }


def errors_of(session: zenoh.Session) -> set[str]:
    replies = session.get(f"{ROBOT}/@auth", target=zenoh.QueryTarget.ALL, timeout=1.0)
    return {reply.err.payload.to_string() for reply in replies if reply.err is not None}


@CLIENTS
def test_a_client_is_refused_what_its_grant_lacks(client: str, signed: SignedRobot) -> None:
    done = drive_signed(client, signed.fleet.let_in("operator", "bea", "--verbs", "acquire,renew,release"))
    assert done.returncode == 1, done
    assert "Cure: get a grant that does" in done.stdout + done.stderr
    wait_until(lambda: any("bea has acquired" in line for line in signed.gateway.said))
    assert not [line for line in signed.gateway.said if "engaged" in line]
