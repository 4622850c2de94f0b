"""``docs/examples/fleet.sh``: a fleet with keys, as ``make demo-fleet`` starts it."""

import os
import signal
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import pytest

from tests.support.fakes.peer import free_endpoint
from tests.support.processes.gateway import run
from tests.support.processes.installed import install
from tests.support.waiting import wait_until

SCRIPT: Final = Path(__file__).parents[2] / "docs" / "examples" / "fleet.sh"
TIMEOUT_S: Final = 200
ATTEMPTS: Final = 3

pytestmark = pytest.mark.timeout(3 * TIMEOUT_S)

# In this order: enrolled, refused, revoked.
SEEN: Final = (
    "cruiser-1  ready",
    "no Zenoh node answered",
    "cruiser-2 did not answer acquire",
    "cruiser-2: stopped, latched until a reset",
    "cleared remote_stop",
    "cruiser-1: accepted",
    "cruiser-2: accepted",
    "grant_revoked",
    "cruiser drive: ",
    "signed by archive, recorder",
    "all of it as it should be",
)


@pytest.fixture
def surroundings(tmp_path: Path) -> dict[str, str]:
    """The command on the path, a free port, and settings of another robot."""
    return os.environ | {
        "PATH": f"{install(tmp_path / 'bin')}:/usr/bin:/bin",
        "HOME": str(tmp_path),
        "PORT": free_endpoint().rpartition(":")[2],
        "PYTHONPATH": str(SCRIPT.parents[2]),
        "CRUISER_ROBOT_ROOT": "elsewhere",
        "CRUISER_ZENOH_CONNECT": "tcp/127.0.0.1:1",
    }


def play(place: Path, surroundings: Mapping[str, str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [str(SCRIPT), str(place)],
        env=surroundings,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=TIMEOUT_S,
        check=False,
    )


@pytest.mark.night
def test_a_fleet_is_driven_and_its_operator_locked_out(tmp_path: Path, surroundings: Mapping[str, str]) -> None:
    """Strangers get no answer; other settings change nothing; the log says who commanded."""
    for attempt in range(ATTEMPTS):
        done = play(tmp_path / f"fleet-{attempt}", surroundings)
        # On a busy machine a guard stops its robot, as it should.
        if done.returncode == 0 or not any(word in done.stdout for word in ("guard", "late", "deadman")):
            break
    assert done.returncode == 0, done.stdout
    place = -1
    for words in SEEN:
        place = done.stdout.find(words, place + 1)
        assert place >= 0, (words, done.stdout)
    files = tmp_path / f"fleet-{attempt}"
    keys = list(files.rglob("*.key"))
    assert keys
    assert [path for path in keys if path.stat().st_mode & 0o077] == []
    travelled = [*files.glob("*.request"), *files.glob("*.bundle")]
    assert travelled
    assert [path for path in travelled if b"PRIVATE KEY" in path.read_bytes()] == []


@pytest.mark.night
def test_a_fleet_that_is_held_serves_clients_until_ctrl_c(tmp_path: Path, surroundings: Mapping[str, str]) -> None:
    place, said = tmp_path / "fleet", tmp_path / "said"
    with said.open("w") as output:
        process = subprocess.Popen(
            [str(SCRIPT), "--hold", str(place)],
            env=surroundings,
            stdout=output,
            stderr=output,
            start_new_session=True,
        )
    operator = ["--config", str(place / "ann" / "operator.toml")]
    try:
        wait_until(lambda: "until Ctrl-C" in said.read_text() or process.poll() is not None)
        listed = run(["list", *operator])
        assert "2 ready" in listed.stdout, said.read_text()
        os.killpg(process.pid, signal.SIGINT)
        process.wait(60)
    finally:
        process.kill()
    assert process.returncode == 3
    assert run(["list", *operator, "--timeout", "1"]).returncode == 4


def test_a_directory_that_holds_something_is_left_alone(tmp_path: Path, surroundings: Mapping[str, str]) -> None:
    (tmp_path / "fleet").mkdir()
    done = play(tmp_path / "fleet", surroundings)
    assert done.returncode == 1
    assert "File exists" in done.stdout
    assert list((tmp_path / "fleet").iterdir()) == []
