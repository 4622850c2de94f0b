"""``cruiser record --shard``: several recorders share a fleet."""

import json
import signal
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path

import pytest

from recorder.review.info import read_info
from recorder.zenoh.source import Shard
from schemas import keys
from schemas.command_line import ExitCode
from tests.support.commands import review
from tests.support.fakes.peer import Peer
from tests.support.messages import ROOT, gear, sample_of
from tests.support.processes.recorder import Process, recording
from tests.support.waiting import wait_until

ROBOTS = [f"cruiser-{number}" for number in range(1, 13)]
TOTAL = 3
OWNED = {number: {one for one in ROBOTS if Shard(number, TOTAL).has(one)} for number in range(1, TOTAL + 1)}


@pytest.fixture
def fleet(endpoint: str) -> Iterator[threading.Event]:
    """Robots that publish until the event is set."""
    ended = threading.Event()

    def publish() -> None:
        sequence = 0
        while not ended.wait(0.02):
            for robot in ROBOTS:
                peer.put(sample_of(gear(sequence), robot))
            sequence += 1

    with Peer(endpoint) as peer, ThreadPoolExecutor() as pool:
        _tokens = [peer.session.liveliness().declare_token(keys.liveliness(ROOT, robot)) for robot in ROBOTS]
        pool.submit(publish)
        yield ended
        ended.set()


def robots_of(directory: Path, number: int) -> set[str]:
    return {path.name.rpartition("-")[0] for path in (directory / str(number)).glob("*.mcap*")}


def test_shards_share_a_fleet_and_none_takes_the_robots_of_another(
    endpoint: str, fleet: threading.Event, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with ExitStack() as stack:

        def shard(number: int) -> Process:
            words = (
                "--shard",
                f"{number}/{TOTAL}",
                "-o",
                str(tmp_path / str(number)),
                "--name",
                f"depot-{number}",
            )
            return stack.enter_context(recording(*words, "--connect", endpoint))

        shards = {number: shard(number) for number in OWNED}
        wait_until(lambda: all(robots_of(tmp_path, number) >= OWNED[number] for number in OWNED))
        shards[2].kill()
        died = len(list((tmp_path / "2").iterdir()))
        shards[2] = shard(2)
        wait_until(lambda: len(list((tmp_path / "2").iterdir())) >= died + len(OWNED[2]))
        fleet.set()
        ended = [one.end(signal.SIGTERM) for one in shards.values()]
    assert {code for code, *_ in ended} == {ExitCode.OK}
    assert {number: robots_of(tmp_path, number) for number in OWNED} == OWNED
    accounts = [read_info(path).completeness for path in tmp_path.glob("*/*.mcap")]
    assert sum(one.lost for account in accounts for one in account.values()) == 0
    review("check", "--json", *(tmp_path / str(number) for number in OWNED))
    between = json.loads(capsys.readouterr().out.splitlines()[-1])["between"]
    assert {one["robot"] for one in between} == {f"{ROOT}/{robot}" for robot in OWNED[2]}
