"""The Containerfile's steps in a directory, and compose.yaml's commands, as a user who is not root.

No engine is needed: namespaces, volumes and base images are not tried. ``make test-image`` runs it with the Python
of .venv-tools, which has a YAML parser.
"""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import urllib.request
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, Final

import pytest
import yaml

from tests.support.fakes.peer import free_endpoint
from tests.support.processes.gateway import chassis
from tests.support.processes.nobody import NOBODY, become_nobody
from tests.support.provisioning import ProvisionedFleet
from tests.support.waiting import wait_until

ROOT: Final = Path(__file__).parents[2]
PREFIX: Final = "/opt/cruiser"
KEYS: Final = "/etc/cruiser"
STATE: Final = "/var/lib/cruiser"
LOGS: Final = "/var/lib/cruiser/logs"

TEXT: Final = (ROOT / "deploy" / "Containerfile").read_text("utf-8")
# Instructions and their words of each stage; the first is the base image.
STAGES: Final = [
    [line.partition(" ")[::2] for line in stage.replace("\\\n", " ").splitlines() if line and line[0].isupper()]
    for stage in re.split(r"^FROM ", TEXT, flags=re.MULTILINE)[1:]
]
COMPOSE: Final[dict[str, Any]] = yaml.safe_load((ROOT / "deploy" / "compose.yaml").read_text("utf-8"))
SERVICES: Final[dict[str, dict[str, Any]]] = COMPOSE["services"]

pytestmark = pytest.mark.timeout(900)


def test_every_service_is_what_compose_takes() -> None:
    """Its names exist; it writes to volumes and tmpfs alone."""
    volumes = {name for name, said in COMPOSE["volumes"].items() if said is None}
    for name, said in SERVICES.items():
        assert (ROOT / "deploy" / said["build"]["context"] / said["build"]["dockerfile"]).is_file()
        assert all(isinstance(word, str) for word in said["command"]), name
        assert set(said.get("depends_on", [])) <= set(SERVICES) - {name}
        named, places = zip(*(one.split(":")[:2] for one in said["volumes"]), strict=True)
        assert set(named) <= volumes
        assert KEYS in places
        assert set(places) <= {KEYS, STATE, LOGS}
        assert said["read_only"] is True
        assert (said["cap_drop"], said["security_opt"]) == (["ALL"], ["no-new-privileges:true"])
        assert not ("network_mode" in said and "ports" in said)
        assert re.fullmatch(r"[0-9]+s", said.get("stop_grace_period", "10s"))
    # Nobody but the recorder writes to its logs, and no other volume is shared.
    mounted = [one for said in SERVICES.values() for one in said["volumes"]]
    assert sorted(one.partition(":")[0] for one in mounted if not one.endswith(":ro")) == sorted(volumes)
    assert [one for one in mounted if one.endswith(":ro")] == [f"logs:{LOGS}:ro"]


@pytest.fixture(scope="module")
def place() -> Iterator[Path]:
    with tempfile.TemporaryDirectory() as folder:
        Path(folder).chmod(0o755)
        yield Path(folder)


@pytest.fixture(scope="module")
def image(place: Path) -> Path:
    """The environment of the first stage, with this test's Python."""
    work = place / "build"
    work.mkdir()
    for instruction, words in STAGES[0]:
        if instruction == "COPY":
            *sources, target = words.split()
            for source in sources:
                copy = shutil.copytree if (ROOT / source).is_dir() else shutil.copy
                copy(ROOT / source, work / target)
        elif instruction == "RUN":
            line = words.replace("python -m venv", f"{sys.executable} -m venv")
            line = line.replace(PREFIX, str(place / "opt"))
            subprocess.run(["/bin/sh", "-ec", line], cwd=work, check=True, env=clean())
    return place / "opt"


def clean() -> dict[str, str]:
    return {"PATH": os.environ["PATH"], "HOME": "/nonexistent"}


class Container:
    """A service of compose.yaml as a process, with directories for its volumes."""

    def __init__(self, image: Path, keys: Path, state: Path, words: list[str]) -> None:
        state.mkdir()
        # The volume of logs is one for all services.
        logs = state.parent / "logs"
        logs.mkdir(exist_ok=True)
        for path in (keys, *keys.iterdir(), state, logs):
            if os.getuid() == 0:
                os.chown(path, NOBODY, NOBODY)
        entry = dict(STAGES[-1])["ENTRYPOINT"]
        assert entry == '["cruiser"]'
        places = {KEYS: keys, LOGS: logs, STATE: state}
        given = [re.sub("|".join(places), lambda found: str(places[found[0]]), word) for word in words]
        self._said = state.parent / f"{state.name}.log"
        with self._said.open("w") as said:
            self.process = subprocess.Popen(
                [*become_nobody(), str(image / "bin" / "cruiser"), *given],
                stdin=subprocess.DEVNULL,
                stdout=said,
                stderr=subprocess.STDOUT,
                cwd=state,
                env=clean() | {"STATE_DIRECTORY": str(state)},
            )

    def wait_says(self, pattern: str) -> None:
        wait_until(lambda: re.search(pattern, self._said.read_text()) or self.process.poll() is not None)
        assert re.search(pattern, self._said.read_text()), self._said.read_text()

    def stop(self) -> int:
        """End it as an engine does. Returns the exit code."""
        self.process.send_signal(signal.SIGTERM)
        return self.process.wait(60)


@contextmanager
def container(image: Path, keys: Path, name: str, **instead: str) -> Iterator[Container]:
    """A service, with some words of its command replaced."""
    words = [instead.get(re.sub(r"\W", "_", word), word) for word in SERVICES[name]["command"]]
    running = Container(image, keys, keys.parent / f"state-{name}", words)
    try:
        yield running
    finally:
        running.process.kill()
        running.process.wait()


def test_the_services_are_a_fleet(image: Path, place: Path) -> None:
    """With the keys of its role each: a robot is seen and recorded through the router."""
    fleet = ProvisionedFleet(place / "fleet", free_endpoint().replace("tcp/", "tls/"))
    (place / "fleet").chmod(0o755)
    router, robot = fleet.let_in("router", "127.0.0.1"), fleet.let_in("robot", "cruiser-1")
    recorder, viewer = fleet.let_in("recorder", "depot"), fleet.let_in("viewer", "metrics")
    desk = fleet.let_in("desk", "desk.example")
    (viewer / "viewer.toml").rename(viewer / "metrics.toml")
    (robot / "robot.toml").rename(robot / "cruiser.toml")
    listen, page = (free_endpoint().removeprefix("tcp/") for _ in range(2))
    with ExitStack() as stack:
        _, address = stack.enter_context(chassis())
        with (robot / "cruiser.toml").open("a") as file:
            file.write(f'[can]\ninterface = "socketcand"\nchannel = "{address}"\n')
        running = {"router": stack.enter_context(container(image, router, "router"))}
        running["router"].wait_says("router: listens on")
        running["gateway"] = stack.enter_context(container(image, robot, "gateway"))
        running["recorder"] = stack.enter_context(container(image, recorder, "recorder"))
        running["metrics"] = stack.enter_context(container(image, viewer, "metrics", **{"0_0_0_0_9747": listen}))
        # Browsers of this machine want no TLS.
        running["desk"] = stack.enter_context(container(image, desk, "desk", **{"0_0_0_0_8443": page}))
        running["gateway"].wait_says("a Zenoh node is connected")
        running["recorder"].wait_says("writing .*cruiser-1")
        running["metrics"].wait_says(r"http://")
        running["desk"].wait_says(r"http://")
        with urllib.request.urlopen(f"http://{page}/", timeout=10) as shown:
            assert b"<html" in shown.read()
        with urllib.request.urlopen(f"http://{page}/logs/of/cruiser-1", timeout=10) as listed:
            assert b"cruiser-1-" in listed.read()
        assert set(running) == set(SERVICES)

        def is_up() -> bool:
            with urllib.request.urlopen(f"http://{listen}/metrics", timeout=10) as page:
                return b'cruiser_up{robot="cruiser-1"} 1.0' in page.read()

        wait_until(is_up)
        assert {name: one.stop() for name, one in reversed(running.items())} == dict.fromkeys(SERVICES, 0)


def test_a_service_without_its_keys_says_so_in_one_line(image: Path, place: Path) -> None:
    """As after the first 'docker compose up'."""
    for name in ("router", "recorder", "desk", "metrics"):
        empty = place / f"empty-{name}"
        (empty / "keys").mkdir(parents=True)
        empty.chmod(0o755)
        with container(image, empty / "keys", name) as running:
            assert running.process.wait(60) == 2
            assert (empty / f"state-{name}.log").read_text().count("\n") == 1
