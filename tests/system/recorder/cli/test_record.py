"""``cruiser record`` as a process, with a small Zenoh peer."""

import json
import signal
import time
from functools import partial
from pathlib import Path

import pytest

from recorder.review.check import check_log
from recorder.review.info import read_info
from schemas.command_line import ExitCode
from schemas.messages import CanFrames, Gear
from tests.bench import recorder_kills
from tests.support.fakes.peer import Peer, free_endpoint
from tests.support.logs import logs_in
from tests.support.messages import MS, batch, feedback, gear, info, key_of, sample_of
from tests.support.processes.recorder import counts, heard, link, readable, recording
from tests.support.waiting import wait_until

FLUSH_S = 0.5


def publish(peer: Peer, count: int) -> None:
    start_ns = time.time_ns()
    for number in range(count):
        now_ns = start_ns + number * 20 * MS
        peer.put(sample_of(gear(number, now_ns)))
        frames = [(now_ns + one * 10 * MS, feedback(2 * number + one)) for one in range(2)]
        peer.put(sample_of(batch(number, frames)))


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_in_a_whole_file(tmp_path: Path, number: int) -> None:
    """It holds all samples and the robot's info."""
    endpoint = free_endpoint()
    words = ["-k", "fleet/**", "-o", str(tmp_path / "logs"), "--connect", endpoint, "--json"]
    with Peer(endpoint) as peer, recording(*words) as process:
        assert process.ready.startswith(f"record: waiting for samples of fleet/** into {tmp_path / 'logs'}; ")
        peer.answer(sample_of(info()))
        link(peer, tmp_path / "logs")
        publish(peer, 200)
        wait_until(lambda: all_written(tmp_path / "logs", 200))
        code, out, err = process.end(number)
    assert code == ExitCode.OK
    result = json.loads(out)
    found = read_info(Path(result["path"]))
    assert logs_in(tmp_path / "logs") == [Path(result["path"]).name]
    assert Path(result["path"]).name.startswith("cruiser-1-")
    checked = check_log(Path(result["path"]))
    assert checked.is_sound
    assert (checked.missed, checked.frames_lost) == (0, 0)
    assert counts(found)[key_of(Gear)] == 200
    assert counts(found)[key_of(CanFrames)] == 400
    assert found.variants == {"cruiser-1": "coarse"}
    assert result["keys"][key_of(Gear)]["written"] == 200
    assert (result["messages"], result["bytes"]) == (found.messages, found.bytes)
    assert result["channels"] == len(found.channels)
    assert "0 samples missed" in err
    assert "Traceback" not in err


def all_written(directory: Path, sent: int) -> bool:
    found = [counts(one) for one in readable(directory)]
    return [(one.get(key_of(Gear)), one.get(key_of(CanFrames))) for one in found] == [(sent, 2 * sent)]


def test_a_killed_recorder_leaves_all_but_the_last_moment(tmp_path: Path) -> None:
    """Any reader reads the part up to its end."""
    endpoint = free_endpoint()
    with Peer(endpoint) as peer, recording("-o", str(tmp_path), "--connect", endpoint) as process:
        link(peer, tmp_path)
        sent = old = 0
        start = time.monotonic()
        while time.monotonic() - start < 4 * FLUSH_S:
            peer.put(sample_of(gear(sent)))
            if time.monotonic() - start < 3 * FLUSH_S:
                old = sent
            sent += 1
            time.sleep(0.002)
        process.kill()
    (part,) = tmp_path.iterdir()
    assert part.name.endswith(".mcap.part")
    found = read_info(part)
    assert not found.whole
    assert all("footer" in fault or "cut off" in fault for fault in found.faults)
    assert counts(found)[key_of(Gear)] > old
    assert check_log(part).missed == 0


def test_a_recorder_that_is_there_first_waits_and_goes_on_after_a_cut(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    key = "fleet/cruiser-1/**"
    with recording("-k", key, "-o", str(tmp_path), "--connect", endpoint) as process:
        assert logs_in(tmp_path) == []
        for name in ("peer/0", "peer/1"):
            with Peer(endpoint) as peer:
                wait_until(partial(heard, peer, tmp_path, name))
        code, out, _ = process.end()
    assert code == ExitCode.OK
    path = Path(out.strip())
    assert path.name.startswith("cruiser-1-")
    assert {"fleet/cruiser-1/peer/0", "fleet/cruiser-1/peer/1"} <= set(counts(read_info(path)))


def test_without_a_sample_there_is_no_log(tmp_path: Path) -> None:
    words = ["-o", str(tmp_path), "--connect", free_endpoint(), "--json"]
    with recording(*words) as process:
        warning = process.read_line()
        code, out, err = process.end(signal.SIGINT)
    assert code == ExitCode.UNREACHABLE
    assert json.loads(out)["path"] is None
    assert warning.endswith("no Zenoh node is connected; retrying\n")
    assert err == "cruiser record: no sample received, so there is no log\n"
    assert logs_in(tmp_path) == []


def test_a_hangup_begins_a_new_file(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    with Peer(endpoint) as peer, recording("-o", str(tmp_path), "--connect", endpoint, "--json") as process:
        link(peer, tmp_path)
        sent = 0

        def is_rolled(files: int) -> bool:
            nonlocal sent
            peer.put(sample_of(gear(sent)))
            sent += 1
            time.sleep(0.001)
            return len(logs_in(tmp_path)) >= files

        for files in (2, 3):
            wait_until(partial(has_gear, tmp_path))
            process.signal(signal.SIGHUP)
            wait_until(partial(is_rolled, files))
        # What is still on its way is no loss of the hangup's.
        wait_until(lambda: sum(counts(one).get(key_of(Gear), 0) for one in readable(tmp_path)) == sent)
        code, out, _ = process.end()
    assert code == ExitCode.OK
    assert json.loads(out)["files"] == 3
    found = [read_info(path) for path in tmp_path.iterdir()]
    assert all(check_log(path).is_sound for path in tmp_path.iterdir())
    assert sum(counts(one).get(key_of(Gear), 0) for one in found) == sent


def has_gear(directory: Path) -> bool:
    return any(one.path.endswith(".part") and one.messages for one in readable(directory))


@pytest.mark.night
def test_recorders_killed_at_random_instants_lose_but_the_last_moment(tmp_path: Path) -> None:
    """No holes or duplicates. The bench measures the loss (``python -m tests.bench kills``)."""
    kills = recorder_kills.measure(4, tmp_path)
    assert (kills.holes, kills.doubled, kills.not_whole) == (0, 0, [])
    assert len(kills.lost_ms) == 4
    assert kills.left <= 2
    assert kills.sent > sum(kills.lost)
