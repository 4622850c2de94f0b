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

from recorder.review.info import read_info
from recorder.zenoh.source import Shard
from schemas import keys
from schemas.command_line import ExitCode
from tests.support.fakes.peer import Peer
from tests.support.messages import ROOT, gear, sample_of
from tests.support.processes.recorder import Process, environment, recording
from tests.support.waiting import wait_until

ROBOTS = [f"cruiser-{number}" for number in range(1, 13)]
TOTAL = 3
OWNED = {number: {one for one in ROBOTS if Shard(number, TOTAL).has(one)} for number in range(1, TOTAL + 1)}


class Fleet:
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
        self._ended.set()
        self._thread.join()
        self._peer.close()


@pytest.fixture
def fleet(endpoint: str) -> Iterator[Fleet]:
    one = Fleet(endpoint)
    yield one
    one.close()


def shard(stack: ExitStack, endpoint: str, directory: Path, number: int) -> Process:
    words = ["--shard", f"{number}/{TOTAL}", "-o", str(directory / str(number)), "--name", f"depot-{number}"]
    return stack.enter_context(recording(*words, "--connect", endpoint))


def robots_of(directory: Path, number: int) -> set[str]:
    return {path.name.rpartition("-")[0] for path in (directory / str(number)).glob("*.mcap*")}


def test_shards_share_a_fleet_and_none_takes_the_robots_of_another(
    endpoint: str, fleet: Fleet, tmp_path: Path
) -> None:
    with ExitStack() as stack:
        shards = {number: shard(stack, endpoint, tmp_path, number) for number in OWNED}
        wait_until(lambda: all(robots_of(tmp_path, number) >= OWNED[number] for number in OWNED))
        shards[2].kill()
        died = len(list((tmp_path / "2").iterdir()))
        shards[2] = shard(stack, endpoint, tmp_path, 2)
        wait_until(lambda: len(list((tmp_path / "2").iterdir())) >= died + len(OWNED[2]))
        fleet.close()
        ended = [one.end(signal.SIGTERM) for one in shards.values()]
    assert {code for code, *_ in ended} == {ExitCode.OK}
    assert {number: robots_of(tmp_path, number) for number in OWNED} == OWNED
    accounts = [read_info(path).completeness for path in tmp_path.glob("*/*.mcap")]
    assert sum(one.lost for account in accounts for one in account.values()) == 0
    told = check(tmp_path)
    assert {one["robot"] for one in told} == {f"{ROOT}/{robot}" for robot in OWNED[2]}


def check(directory: Path) -> list[dict[str, str]]:
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
