"""``cruiser record --shard``: several recorders share a fleet."""

import json
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from recorder.record.shards import preference
from recorder.review.info import read_info
from schemas import keys
from schemas.exit_codes import ExitCode
from tests.support.fakes.peer import Peer, free_endpoint
from tests.support.messages import ROOT, gear, sample_of
from tests.support.processes.recorder import Process, environment, recording
from tests.support.waiting import wait_until

ROBOTS = [f"cruiser-{number}" for number in range(1, 13)]
TOTAL = 3
OWNED = {number: {one for one in ROBOTS if preference(one, TOTAL)[0] == number} for number in range(1, TOTAL + 1)}


class Fleet:
    """Robots that publish their gear, each its own sequence, until it is closed."""

    def __init__(self, endpoint: str) -> None:
        self._peer = Peer(endpoint)
        liveliness = self._peer.session.liveliness()
        self._tokens = [liveliness.declare_token(keys.liveliness(ROOT, robot)) for robot in ROBOTS]
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._publish)
        self._thread.start()

    def _publish(self) -> None:
        sequence = 0
        while not self._ended.wait(0.02):
            for robot in ROBOTS:
                self._peer.put(sample_of(gear(sequence), robot))
            sequence += 1

    def close(self) -> None:
        """Fall silent."""
        self._ended.set()
        self._thread.join()
        self._peer.close()


@pytest.fixture
def endpoint() -> str:
    """Where the fleet listens."""
    return free_endpoint()


@pytest.fixture
def fleet(endpoint: str) -> Iterator[Fleet]:
    """The robots."""
    one = Fleet(endpoint)
    yield one
    one.close()


def shard(stack: ExitStack, endpoint: str, directory: Path, number: int) -> Process:
    """One of the recorders."""
    words = ["--shard", f"{number}/{TOTAL}", "-o", str(directory / str(number)), "--name", f"depot-{number}"]
    return stack.enter_context(recording(*words, "--connect", endpoint))


def robots_of(directory: Path, number: int, pattern: str = "*.mcap*") -> set[str]:
    """The robots of which a recorder has logs."""
    return {path.name.rpartition("-")[0] for path in (directory / str(number)).glob(pattern)}


def test_shards_share_a_fleet_and_take_over_from_one_that_dies(
    endpoint: str, fleet: Fleet, tmp_path: Path
) -> None:
    """Each robot is in the logs of one; those of a killed one go on in the others', and what is lost is told."""
    with ExitStack() as stack:
        shards = {number: shard(stack, endpoint, tmp_path, number) for number in OWNED}
        wait_until(lambda: all(robots_of(tmp_path, number) >= OWNED[number] for number in OWNED))
        shards[2].kill()
        left = {number: OWNED[number] | {one for one in OWNED[2] if _next(one) == number} for number in (1, 3)}
        wait_until(lambda: all(robots_of(tmp_path, number) >= left[number] for number in left))
        # It comes back, makes its logs whole, and has its robots again; the others let go of them.
        shards[2] = shard(stack, endpoint, tmp_path, 2)
        moved = {number: left[number] - OWNED[number] for number in left}
        wait_until(lambda: all(_whole(tmp_path, number) >= moved[number] for number in moved))
        fleet.close()
        ended = [one.end(signal.SIGTERM) for one in shards.values()]
    assert {code for code, *_ in ended} == {ExitCode.OK}
    assert {number: robots_of(tmp_path, number) for number in left} == left
    assert robots_of(tmp_path, 2) == OWNED[2]
    accounts = [read_info(path).completeness for path in tmp_path.glob("*/*.mcap")]
    assert sum(one.lost for account in accounts for one in account.values()) == 0
    told = check(tmp_path)
    assert {one["robot"] for one in told} == {f"{ROOT}/{robot}" for robot in OWNED[2]}
    assert all(Path(one["before"]).parent.name == "2" for one in told)


def _next(robot: str) -> int:
    """Whose robot it is without the second shard."""
    return next(number for number in preference(robot, TOTAL) if number != 2)


def _whole(directory: Path, number: int) -> set[str]:
    return robots_of(directory, number, "*.mcap")


def check(directory: Path) -> list[dict[str, str]]:
    """What is in none of the shards' logs."""
    places = [str(directory / str(number)) for number in OWNED]
    done = subprocess.run(
        [sys.executable, "-m", "gateway", "review", "check", "--json", *places],
        capture_output=True,
        text=True,
        check=False,
        env=environment(),
    )
    between: list[dict[str, str]] = json.loads(done.stdout.splitlines()[-1])["between"]
    return between


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["--shard", "5/4"], "such as 2/4"),
        (["--shard", "two"], "recorder.shard"),
        (["--shard", "1/2", "-k", "elsewhere/**"], "names none"),
    ],
)
def test_a_shard_that_is_none_is_refused(words: list[str], why: str, tmp_path: Path) -> None:
    """What is wrong is said, and nothing is recorded."""
    done = subprocess.run(
        [sys.executable, "-m", "gateway", "record", *words, "-o", str(tmp_path), "--connect", free_endpoint()],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
        env=environment(),
    )
    assert done.returncode == ExitCode.USAGE
    assert why in done.stderr
