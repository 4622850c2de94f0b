"""``cruiser upload`` and a server that speaks S3."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from datetime import timedelta
from pathlib import Path
from typing import Any, Final

import obstore
import pytest
from obstore.store import S3Store

from recorder.cli import review
from recorder.cli import upload as command
from recorder.disk.files import NAME, SafeLogReader
from recorder.review.catalog.log_row import read_row
from recorder.upload.finished import ROW_SUFFIX
from schemas.command_line import CommandError, ExitCode
from schemas.settings import RecorderSettings, Settings, UploadSettings
from tests.support.commands import run_command
from tests.support.fakes.peer import free_endpoint
from tests.support.logs import gears, own_log, saved
from tests.support.rigs import scenarios
from tests.support.rigs.scenarios import recorded
from tests.support.waiting import wait_until

PROGRAM: Final = os.environ.get("S3_SERVER", "")

BUCKET: Final = "fleet-logs"


@contextmanager
def s3_server(port: int, scratch: Path) -> Iterator[None]:
    words = [PROGRAM, "-backend", "memory", "-host", f"127.0.0.1:{port}", "-initialbucket", BUCKET]
    with (scratch / "s3.log").open("ab") as said, subprocess.Popen(words, stdout=said, stderr=said) as server:
        try:
            wait_until(lambda: _answers(port))
            yield
        finally:
            server.kill()


def _answers(port: int) -> bool:
    with suppress(OSError), socket.create_connection(("127.0.0.1", port), 1):
        return True
    return False


SMALL = "cruiser-1-20270115T080000Z.mcap"
LARGE = "cruiser-1-20270115T090000Z.mcap"
INCIDENT = "cruiser-1-20270115T100000Z.incident.mcap"

RATE = 40_000_000  # never the limit


@pytest.fixture
def port(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "test")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "testtest")
    port = int(free_endpoint().rpartition(":")[2])
    with s3_server(port, tmp_path):
        yield port


@pytest.fixture
def logs(tmp_path: Path) -> Path:
    """Three logs, one of which takes three parts."""
    directory = tmp_path / "logs"
    ballast = [("ballast", os.urandom(11_000_000))]
    saved(directory / SMALL, own_log([gears(0, 3, 0)]))
    saved(directory / LARGE, own_log([gears(0, 3, 0)], attachments=ballast))
    saved(directory / INCIDENT, own_log([gears(0, 4, 0)]))
    return directory


def upload(logs: Path, port: int, *, read_back: bool = True, rate: int = RATE) -> int:
    settings = Settings(
        recorder=RecorderSettings(directory=str(logs)),
        upload=UploadSettings(f"s3://{BUCKET}/plant-1", options_of(port), "all", rate, read_back),
    )
    return run_command(command, "--once", settings=settings)


def options_of(port: int) -> dict[str, str | int | float | bool]:
    endpoint = f"http://127.0.0.1:{port}"
    return {"endpoint": endpoint, "region": "us-east-1", "virtual_hosted_style_request": False, "allow_http": True}


def held(port: int) -> dict[str, bytes]:
    options: dict[str, Any] = options_of(port)
    options.pop("allow_http")
    store = S3Store(BUCKET, client_options={"allow_http": True}, **options)
    names = [one["path"] for page in obstore.list(store) for one in page]
    return {name: bytes(obstore.get(store, name).bytes()) for name in names}


def check_all_there(logs: Path, port: int, verified: str) -> None:
    """Each log byte for byte, with manifest and row, and marked."""
    objects = held(port)
    assert len(objects) == 9
    for name in (SMALL, LARGE, INCIDENT):
        assert objects[f"plant-1/cruiser-1/{name}"] == (logs / name).read_bytes()
        found = json.loads(objects[f"plant-1/cruiser-1/{name}.json"])
        assert (found["state"], found["verified"]) == ("verified", verified)
        read_row(objects[f"plant-1/cruiser-1/{name}{ROW_SUFFIX}"], found["bytes"])
    assert set(SafeLogReader(logs).read()) == {SMALL, LARGE, INCIDENT}


@pytest.mark.parametrize("rate", [RATE, 0], ids=["paced", "unbounded"])
@pytest.mark.parametrize(("read_back", "verified"), [(True, "read back"), (False, "checksum")])
def test_logs_of_one_part_and_of_several_are_there_and_verified(
    logs: Path, port: int, *, read_back: bool, verified: str, rate: int
) -> None:
    """By S3's own checksum, also of several parts."""
    assert upload(logs, port, read_back=read_back, rate=rate) == ExitCode.OK
    check_all_there(logs, port, verified)
    # A robot whose note is lost sends nothing again.
    (logs / NAME).unlink()
    assert upload(logs, port, read_back=read_back, rate=rate) == ExitCode.OK
    check_all_there(logs, port, verified)


def test_another_log_of_the_same_name_is_not_overwritten(logs: Path, port: int, tmp_path: Path) -> None:
    """The server refuses the second manifest."""
    upload(logs, port)
    before = held(port)
    saved(tmp_path / "depot" / SMALL, own_log([gears(0, 9, 0)]))
    assert upload(tmp_path / "depot", port) == ExitCode.OK
    after = held(port)
    assert before.items() <= after.items()
    second = "plant-1/cruiser-1/" + SMALL.replace(".mcap", "-2.mcap")
    assert after.keys() - before.keys() == {second, f"{second}.json", f"{second}{ROW_SUFFIX}"}


@pytest.mark.parametrize("after_bytes", [100, 6_000_000, 11_500_000, 18_000_000])
def test_a_connection_that_is_lost_in_the_middle_only_holds_the_upload_up(
    logs: Path, port: int, after_bytes: int
) -> None:
    """In a request, in a part, while a log is read back."""
    with cut_link(port, after_bytes) as (other_port, has_cut):
        assert upload(logs, other_port) == ExitCode.OK
        assert has_cut.is_set()
    check_all_there(logs, port, "read back")


@pytest.mark.parametrize("after_bytes", [None, 2_000, 40_000])
def test_what_was_uploaded_is_found_and_asked_in_the_store(
    tmp_path: Path,
    port: int,
    after_bytes: int | None,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The answers are those about the file, also where a connection breaks."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    log = saved(tmp_path / "logs" / SMALL, recorded(scenarios.stale_commands))
    assert upload(log.parent, port) == ExitCode.OK
    with cut_link(port, after_bytes or 10**9) as (other_port, has_cut):
        settings = Settings(upload=UploadSettings(f"s3://{BUCKET}", options_of(other_port)))
        answers = []
        for place in (log, f"s3://{BUCKET}/plant-1/cruiser-1/{SMALL}"):
            capsys.readouterr()
            assert run_command(review, "why", place, "--json", settings=settings) == ExitCode.OK
            assert run_command(review, "events", place, "--json", settings=settings) == ExitCode.OK
            answers.append(capsys.readouterr().out)
        assert answers[0] == answers[1]
        words = ("find", "stops", f"s3://{BUCKET}/plant-1", "--reason=deadman", "--json")
        assert run_command(review, *words, settings=settings) == ExitCode.OK
        [found] = capsys.readouterr().out.splitlines()
        assert json.loads(found)["file"] == f"s3://{BUCKET}/plant-1/cruiser-1/{SMALL}"
        assert has_cut.is_set() == (after_bytes is not None)


def test_a_bucket_that_nobody_may_read_or_that_is_not_there_is_said(port: int) -> None:
    settings = Settings(upload=UploadSettings("", options_of(port)))
    with pytest.raises(CommandError, match="cannot list s3://none"):
        run_command(review, "events", "s3://none/plant-1", settings=settings)
    with pytest.raises(CommandError, match="there is no such object"):
        run_command(review, "events", f"s3://{BUCKET}/none.mcap", settings=settings)


def test_a_server_that_is_not_there_is_said(logs: Path, port: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("recorder.upload.uploader.REQUEST_S", timedelta(seconds=1))
    assert port
    nobody = int(free_endpoint().rpartition(":")[2])
    assert upload(logs, nobody) == ExitCode.UNREACHABLE
    assert SafeLogReader(logs).read() == {}


@contextmanager
def cut_link(port: int, after_bytes: int) -> Iterator[tuple[int, threading.Event]]:
    """A port that leads to another one, and cuts a connection once, after so many bytes."""
    has_cut = threading.Event()
    left = [after_bytes]

    def carry(source: socket.socket, sink: socket.socket) -> None:
        with suppress(OSError):
            while data := source.recv(16_384):
                left[0] -= len(data)
                if left[0] < 0 and not has_cut.is_set():
                    has_cut.set()
                    break
                sink.sendall(data)
        for one in (source, sink):
            with suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)
        # The other direction sees it by itself.
        sink.close()

    with closing(socket.create_server(("127.0.0.1", 0))) as server:

        def serve() -> None:
            with suppress(OSError):
                while True:
                    one, _ = server.accept()
                    there = socket.create_connection(("127.0.0.1", port))
                    for source, sink in ((one, there), (there, one)):
                        threading.Thread(target=carry, args=[source, sink], daemon=True).start()

        threading.Thread(target=serve, daemon=True).start()
        yield server.getsockname()[1], has_cut
        server.shutdown(socket.SHUT_RDWR)
