"""Operators and recorders beside gateways of another version, from commits of the history (docs/operate.md)."""

import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from recorder.review.info import read_info
from tests.support.fakes.peer import free_endpoint
from tests.support.processes.gateway import Running, chassis, gateway, run
from tests.support.processes.recorder import counts
from tests.support.waiting import wait_until

ROOT = Path(__file__).parents[2]
SAME_SCHEMAS = ["e0a066f", "9d2c088"]  # commits; their logs are in tests/data/golden
OTHER_STATE = "b0e9a3b"  # has version 1 of SafetyState and of the request Drive
Tree = Callable[[str], Path]


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Tree:
    """The product at a commit; fails in a shallow clone."""
    made: dict[str, Path] = {"": ROOT}

    def at(commit: str) -> Path:
        if commit not in made:
            place = tmp_path_factory.mktemp(commit)
            command = [
                "git",
                "-C",
                str(ROOT),
                "archive",
                commit,
                "gateway",
                "recorder",
                "schemas",
                "pyproject.toml",
            ]
            packed = subprocess.run(command, check=True, capture_output=True).stdout
            subprocess.run(["tar", "--extract", "--directory", str(place)], input=packed, check=True)  # noqa: S607
            made[commit] = place
        return made[commit]

    return at


@contextmanager
def version(place: Path) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", str(place))
        patch.setenv("PYTHONSAFEPATH", "1")
        found = [sys.executable, "-c", "import gateway; print(gateway.__file__)"]
        assert subprocess.run(found, capture_output=True, text=True, check=True).stdout.startswith(f"{place}/")
        yield


@contextmanager
def robot(place: Path, directory: Path) -> Iterator[str]:
    """A gateway of a version on a virtual chassis. Yields its endpoint."""
    settings = directory / "robot.toml"
    settings.write_text("[gateway]\naccept_unguarded = true\n[command]\ndeadman_s = 0.5\n")
    endpoint = free_endpoint()
    with version(place), chassis() as (_, address), gateway(address, endpoint, "--config", str(settings)):
        yield endpoint


@contextmanager
def recording(endpoint: str, directory: Path) -> Iterator[list[Path]]:
    """A recorder of the current version. Yields its logs."""
    logs: list[Path] = []
    with Running("record", "--connect", endpoint, "--name", "small", "-o", str(directory)) as recorder:
        recorder.wait_says("writing ")
        yield logs
        assert recorder.stop() == 0, recorder.said
        logs.extend(directory.glob("*.mcap"))


def ask(*words: str) -> tuple[int, str]:
    done = run(words)
    assert "Traceback" not in done.stderr
    return done.returncode, done.stdout + done.stderr


@pytest.mark.parametrize("side", ["gateway", "others"])
@pytest.mark.parametrize("commit", SAME_SCHEMAS)
def test_versions_with_the_same_schemas_work_together(tree: Tree, tmp_path: Path, commit: str, side: str) -> None:
    """One side is the gateway, the other an operator and a recorder."""
    robots, others = (tree(commit), ROOT) if side == "gateway" else (ROOT, tree(commit))
    with robot(robots, tmp_path) as endpoint, version(others), recording(endpoint, tmp_path / "logs") as logs:
        there = ("--connect", endpoint)
        drive = ("drive", "--operator", "op", "cruiser-1", "--speed", "0.3", "--seconds", "1", *there)
        wait_until(lambda: ask(*drive)[0] == 0)
        assert ask("list", *there)[0] == 0
        assert ask("stop", "cruiser-1", *there) == (0, "cruiser-1: stopped, latched until a reset\n")
        assert ask("reset", "cruiser-1", *there)[0] == 0
    assert logs
    assert {"fleet/cruiser-1/safety/state", "fleet/cruiser-1/journal"} <= topics(tmp_path / "logs")


@pytest.mark.parametrize("side", ["gateway", "others"])
def test_versions_of_another_state_say_so_and_stop_all_the_same(tree: Tree, tmp_path: Path, side: str) -> None:
    """Both versions are named; the recorder stores what it cannot read."""
    robots, others = (tree(OTHER_STATE), ROOT) if side == "gateway" else (ROOT, tree(OTHER_STATE))
    with robot(robots, tmp_path) as endpoint, version(others), recording(endpoint, tmp_path / "logs") as logs:
        there = ("--connect", endpoint)
        wait_until(lambda: "bus can0 up" in ask("list", *there)[1])
        code, said = ask("drive", "--operator", "op", "cruiser-1", "--speed", "0.3", "--seconds", "1", *there)
        assert code == 4
        assert "SafetyState" in said
        assert {"1", "2"} <= set(re.findall(r"\b\d\b", said))
        code, said = ask("stop", "cruiser-1", *there)
        if side == "gateway":
            assert code == 3
            assert "it replied that it stops" in said
            assert "upgrade the robot's gateway" in said
        else:
            # That version believed the reply alone.
            assert (code, said) == (0, "cruiser-1: stopped, latched until a reset\n")
    assert logs
    assert "fleet/cruiser-1/safety/state/@raw" in topics(tmp_path / "logs")


def topics(logs: Path) -> set[str]:
    return {topic for path in logs.glob("*.mcap") for topic in counts(read_info(path))}
