"""``cruiser record``: many robots and keys."""

import json
import re
from pathlib import Path

import pytest

from recorder.review.check import check_log
from recorder.review.info import LogInfo, read_info
from schemas.command_line import ExitCode
from schemas.messages import Gear
from tests.support.fakes.peer import Peer
from tests.support.logs import logs_in
from tests.support.messages import FakeSample, gear, key_of, sample_of
from tests.support.processes.recorder import Told, at, counts, recording, whole
from tests.support.waiting import wait_until


def put_until_told(peer: Peer, told: Told, keys: list[str], keys_heard: int) -> None:
    def condition() -> bool:
        for key in keys:
            peer.put(FakeSample(key, "zenoh/bytes", b"x"))
        return told.wait_for_health().keys >= keys_heard

    wait_until(condition)


def by_name(directory: Path) -> dict[str, LogInfo]:
    found = {re.sub(r"-\d{8}T\d{6}Z\.mcap$", "", path.name): read_info(path) for path in whole(directory)}
    assert len(found) == len(logs_in(directory))
    assert all(check_log(path).whole for path in whole(directory))
    return found


def of_robots(found: LogInfo) -> set[str]:
    return {topic for topic, count in counts(found).items() if count and "@recorder" not in topic}


@pytest.mark.night
def test_hundreds_of_robots_and_thousands_of_keys(peer: Peer, endpoint: str, tmp_path: Path) -> None:
    robots = [f"robot-{number}" for number in range(300)]
    keys = [f"fleet/{robot}/some/key-{number}" for robot in robots for number in range(10)]
    with recording(*at(tmp_path, endpoint), "--json") as process:
        told = Told(peer)
        put_until_told(peer, told, keys, len(keys))
        for number in range(3):
            for robot in robots:
                peer.put(sample_of(gear(number), robot))
        wait_until(lambda: told.wait_for_health().robots == len(robots))
        received = told.wait_for_health().received
        wait_until(lambda: told.wait_for_health().received == received)
        code, out, err = process.end()
    assert code == ExitCode.OK, err
    assert json.loads(out)["files"] == len(robots)
    found = by_name(tmp_path)
    assert set(found) == set(robots)
    for robot, one in found.items():
        assert len(of_robots(one)) == 11
        assert counts(one)[key_of(Gear, robot)] == 3
    assert all(check_log(path).missed == 0 for path in whole(tmp_path))


def test_more_robots_than_files_may_be_open_cost_no_log(peer: Peer, endpoint: str, tmp_path: Path) -> None:
    """Robots beyond the limit share a log."""
    robots = [f"robot-{number}" for number in range(250)]
    with recording(*at(tmp_path, endpoint), ulimit="-n 200") as process:
        told = Told(peer)
        put_until_told(peer, told, [f"fleet/{robot}/key" for robot in robots], len(robots))
        code, _, err = process.end()
    assert code == ExitCode.OK, err
    assert "Too many open files" not in err
    found = by_name(tmp_path)
    assert 10 < len(found) < 200
    assert "fleet" in found
    assert len({topic for one in found.values() for topic in of_robots(one)}) == len(robots)
