"""``cruiser record`` as a process of its own, against a small Zenoh peer."""

import argparse
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import pytest

from recorder.cli import record
from recorder.review.info import LogInfo, read_info
from schemas.exit_codes import ExitCode
from schemas.messages import CanFrames, Gear
from tests.recorder.fakes import (
    MS,
    FakeSample,
    batch,
    feedback,
    gear,
    info,
    key_of,
    logs_in,
    sample_of,
    wait_until,
)
from tests.recorder.zenoh_peer import Peer, free_endpoint

CRUISER = str(Path(sys.executable).with_name("cruiser"))
FLUSH_S = 0.5


class Process:
    """A running recorder."""

    def __init__(self, command: Sequence[str], words: Sequence[str]) -> None:
        self._process = subprocess.Popen(
            [*command, "record", *words],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={"PATH": os.environ["PATH"], "HOME": os.environ.get("HOME", "/")},
        )
        self.ready = self._read_ready()

    def _read_ready(self) -> str:
        assert self._process.stderr is not None
        return self._process.stderr.readline()

    def end(self, number: int | None = signal.SIGTERM) -> tuple[int, str, str]:
        """Send a signal, wait; exit code, stdout and the rest of stderr."""
        if number is not None:
            self._process.send_signal(number)
        out, err = self._process.communicate(timeout=30)
        return self._process.returncode, out, err

    def kill(self) -> None:
        """Without a chance to do anything."""
        self.end(signal.SIGKILL)

    @property
    def is_running(self) -> bool:
        return self._process.poll() is None


@contextmanager
def recording(*words: str, command: Sequence[str] = (CRUISER,)) -> Iterator[Process]:
    """A recorder that does not outlive the test."""
    process = Process(command, words)
    try:
        yield process
    finally:
        if process.is_running:
            process.kill()


def link(peer: Peer, directory: Path) -> None:
    """Publish until the recorder has heard of it and opened its log."""

    def condition() -> bool:
        peer.put(FakeSample("fleet/cruiser-1/link", "zenoh/bytes", b""))
        return directory.exists() and bool(logs_in(directory))

    wait_until(condition)


def publish(peer: Peer, count: int) -> None:
    """Gear messages and batches of two frames each."""
    start_ns = time.time_ns()
    for number in range(count):
        now_ns = start_ns + number * 20 * MS
        peer.put(sample_of(gear(number, now_ns)))
        frames = [(now_ns + one * 10 * MS, feedback(2 * number + one)) for one in range(2)]
        peer.put(sample_of(batch(number, frames)))


def counts(found: LogInfo) -> dict[str, int]:
    """Messages by topic."""
    return {channel.topic: channel.messages for channel in found.channels}


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_in_a_whole_file(tmp_path: Path, number: int) -> None:
    """With all that was sent, the robot's answer, and the result on stdout."""
    endpoint = free_endpoint()
    words = ["-k", "fleet/**", "-o", str(tmp_path / "logs"), "--connect", endpoint, "--json"]
    with Peer(endpoint) as peer, recording(*words) as process:
        assert process.ready == f"record: waiting for samples of fleet/** into {tmp_path / 'logs'}\n"
        peer.answer(sample_of(info()))
        link(peer, tmp_path / "logs")
        publish(peer, 200)
        wait_until(lambda: all_written(tmp_path / "logs", 200))
        code, out, err = process.end(number)
    assert code == ExitCode.OK
    result = json.loads(out)
    found = read_info(Path(result["path"]))
    assert logs_in(tmp_path / "logs") == [Path(result["path"]).name]
    assert Path(result["path"]).name.startswith("fleet-")
    assert found.whole
    assert (found.missed, found.frames_lost) == (0, 0)
    assert counts(found)[key_of(Gear)] == 200
    assert counts(found)[key_of(CanFrames)] == 400
    assert found.variants == {"cruiser-1": "coarse"}
    assert result["keys"][key_of(Gear)] == {"messages": 200, "missed": 0, "dropped": 0}
    assert (result["messages"], result["bytes"]) == (found.messages, found.bytes)
    assert result["channels"] == len(found.channels)
    assert "0 samples missed" in err
    assert "Traceback" not in err


def all_written(directory: Path, sent: int) -> bool:
    """Are all gear messages and frames in the log, which is still being written?"""
    (part,) = directory.iterdir()
    found = counts(read_info(part))
    return (found.get(key_of(Gear)), found.get(key_of(CanFrames))) == (sent, 2 * sent)


def test_a_killed_recorder_leaves_all_but_the_last_moment(tmp_path: Path) -> None:
    """What was received longer ago than the setting is in the part, which any reader reads up to its end."""
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
    assert found.missed == 0


def test_a_recorder_that_is_there_first_waits_and_goes_on_after_a_cut(tmp_path: Path) -> None:
    """The gateway comes, goes and comes again; one file holds it all."""
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


def heard(peer: Peer, directory: Path, name: str) -> bool:
    """Publish; is it in the log?"""
    peer.put(FakeSample(f"fleet/cruiser-1/{name}", "zenoh/bytes", b""))
    time.sleep(0.05)
    return any(counts(read_info(path)).get(f"fleet/cruiser-1/{name}") for path in directory.iterdir())


def test_a_recording_may_end_by_itself(tmp_path: Path) -> None:
    """After --seconds; the path alone is on stdout."""
    endpoint = free_endpoint()
    with (
        Peer(endpoint) as peer,
        recording("-o", str(tmp_path), "--connect", endpoint, "--seconds", "2") as process,
    ):
        link(peer, tmp_path)
        code, out, _ = process.end(None)
    assert code == ExitCode.OK
    assert Path(out.strip()).suffix == ".mcap"


def test_without_a_sample_there_is_no_log(tmp_path: Path) -> None:
    """Nobody answered: exit code 4, a warning at once, one clear line at the end, and JSON that says so."""
    words = ["-o", str(tmp_path), "--connect", free_endpoint(), "--seconds", "0.2", "--json"]
    with recording(*words) as process:
        code, out, err = process.end(None)
    assert code == ExitCode.UNREACHABLE
    assert json.loads(out)["path"] is None
    warning, line = err.splitlines()
    assert warning.endswith("no Zenoh node is connected; trying on")
    assert line == "cruiser record: no sample came, so there is no log"
    assert logs_in(tmp_path) == []


def test_a_directory_that_cannot_be_is_one_clear_line(tmp_path: Path) -> None:
    """Exit code 1, before anything is recorded, no traceback."""
    (tmp_path / "file").write_text("")
    with recording("-o", str(tmp_path / "file"), "--connect", free_endpoint()) as process:
        code, out, err = process.end(None)
    assert code == ExitCode.FAILURE
    assert (out, err) == ("", "")
    assert process.ready == f"cruiser record: cannot write {tmp_path / 'file'}: File exists\n"


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["-k", "fleet//x"], "is no key expression"),
        (["--connect", "nonsense"], "wrong Zenoh settings"),
    ],
)
def test_wrong_words_are_a_usage_error(tmp_path: Path, words: list[str], complaint: str) -> None:
    """Exit code 2, one clear line."""
    with recording("-o", str(tmp_path), *words) as process:
        code, _, err = process.end(None)
    assert code == ExitCode.USAGE
    assert complaint in process.ready
    assert err == ""


@pytest.mark.parametrize("seconds", ["0", "-1", "inf", "nan", "soon"])
def test_a_time_must_be_a_time(seconds: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Exit code 2."""
    parser = argparse.ArgumentParser()
    record.add_arguments(parser)
    with pytest.raises(SystemExit) as caught:
        parser.parse_args([f"--seconds={seconds}"])
    assert caught.value.code == ExitCode.USAGE
    assert "--seconds" in capsys.readouterr().err


def test_flags_set_settings() -> None:
    """By their dotted names; a flag that is not given sets nothing."""
    parser = argparse.ArgumentParser()
    record.add_arguments(parser)
    given = vars(parser.parse_args(["-k", "a", "b", "-k", "c", "-o", "d", "--connect", "e", "--connect", "f"]))
    assert given["recorder.keys"] == ["a", "b", "c"]
    assert given["recorder.directory"] == "d"
    assert given["zenoh.connect"] == ["e", "f"]
    assert not {key for key, value in vars(parser.parse_args([])).items() if "." in key and value is not None}


@pytest.mark.parametrize(
    ("expressions", "name"),
    [
        (["fleet/cruiser-1/**"], "cruiser-1"),
        (["fleet/cruiser-1/state", "fleet/cruiser-1/chassis/*"], "cruiser-1"),
        (["fleet/cruiser-1"], "cruiser-1"),
        (["fleet/cruiser-1/**", "fleet/cruiser-2/**"], "fleet"),
        (["fleet/**"], "fleet"),
        (["fleet/*/state"], "fleet"),
        (["fleet/cr$*/state"], "fleet"),
        (["other/cruiser-1/**"], "fleet"),
    ],
)
def test_a_logs_name_begins_with_its_robot(expressions: list[str], name: str) -> None:
    """If the key expressions can match but one robot; else it is the fleet's."""
    assert record.log_name("fleet", expressions) == name


def test_a_full_disk_ends_the_recording_in_one_clear_line(tmp_path: Path) -> None:
    """Exit code 1, the log named and readable, no traceback. The shell bounds what a file may hold."""
    endpoint = free_endpoint()
    shell = ["sh", "-c", 'ulimit -f 32; exec "$0" "$@"', CRUISER]
    with Peer(endpoint) as peer, recording("-o", str(tmp_path), "--connect", endpoint, command=shell) as process:
        wait_until(partial(heard, peer, tmp_path, "small"))

        def is_over() -> bool:
            peer.put(FakeSample("fleet/cruiser-1/large", "zenoh/bytes", os.urandom(2000)))
            return not process.is_running

        wait_until(is_over)
        code, out, err = process.end(None)
    assert (code, out) == (ExitCode.FAILURE, "")
    (left,) = tmp_path.iterdir()
    assert err.splitlines()[-1] == (
        f"cruiser record: cannot write {tmp_path / left.stem.removesuffix('.mcap')}.mcap.part: File too large; "
        f"the log until then is {left}"
    )
    found = read_info(left)
    assert found.messages
    assert found.whole == (left.suffix == ".mcap")
