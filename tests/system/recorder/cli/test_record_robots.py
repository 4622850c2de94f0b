"""``cruiser record``: more robots than open files."""

import re
from pathlib import Path

from recorder.review.check import check_log
from recorder.review.info import read_info
from schemas.command_line import ExitCode
from tests.support.fakes.peer import Peer
from tests.support.logs import logs_in
from tests.support.messages import FakeSample
from tests.support.processes.recorder import Told, at, counts, recording, whole
from tests.support.waiting import wait_until


def test_more_robots_than_files_may_be_open_cost_no_log(peer: Peer, endpoint: str, tmp_path: Path) -> None:
    """Robots beyond the limit share a log."""
    robots = [f"robot-{number}" for number in range(250)]
    with recording(*at(tmp_path, endpoint), ulimit="-n 200") as process:
        told = Told(peer)

        def are_heard() -> bool:
            for robot in robots:
                peer.put(FakeSample(f"fleet/{robot}/key", "zenoh/bytes", b"x"))
            return told.wait_for_health().keys >= len(robots)

        wait_until(are_heard)
        code, _, err = process.end()
    assert code == ExitCode.OK, err
    assert "Too many open files" not in err
    found = {re.sub(r"-\d{8}T\d{6}Z\.mcap$", "", path.name): read_info(path) for path in whole(tmp_path)}
    assert len(found) == len(logs_in(tmp_path))
    assert all(check_log(path).whole for path in whole(tmp_path))
    assert 10 < len(found) < 200
    assert "fleet" in found
    topics = {topic for one in found.values() for topic, number in counts(one).items() if number}
    assert len({topic for topic in topics if "@recorder" not in topic}) == len(robots)
