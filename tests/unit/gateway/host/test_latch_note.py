"""The file that keeps what is latched across a restart of the process."""

import json
import os
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from gateway.host.notes import LatchNote, RunNote
from schemas.reasons import Reason
from schemas.settings import GatewaySettings, Settings
from tests.support.waiting import wait_until

STOPPED = {Reason.REMOTE_STOP: "by ann", Reason.FRONT_BUMPER: ""}


@pytest.fixture
def open_note(tmp_path: Path) -> Callable[[], LatchNote]:
    """Open the note of one robot, as each start does."""
    settings = Settings(gateway=GatewaySettings(state_dir=str(tmp_path / "state")))
    return lambda: LatchNote.of(settings)


def closed(note: LatchNote) -> Path:
    """Close a note. Returns its path."""
    note.close()
    assert note.path is not None
    return note.path


def test_what_is_latched_is_there_after_a_restart_until_it_is_reset(open_note: Callable[[], LatchNote]) -> None:
    """In its order, with its details; also where the process ended long before the reset."""
    first = open_note()
    assert first.read() == {}
    first.follow(STOPPED)
    path = closed(first)
    assert path.stat().st_mode & 0o777 == 0o600
    second = open_note()
    assert list(second.read().items()) == list(STOPPED.items())
    second.follow(STOPPED)
    closed(second)
    third = open_note()
    assert third.read() == STOPPED
    third.follow({})
    assert not closed(third).exists()


def test_a_stop_by_the_guard_stands_in_the_note_of_the_guard_alone(open_note: Callable[[], LatchNote]) -> None:
    """Else two files would have to be removed for one reset."""
    note = open_note()
    note.follow({Reason.GUARD: "late"})
    assert not closed(note).exists()


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b'{"no such reason": ""}', b'{"remote_stop": 1}', b"\xff"])
def test_a_damaged_note_latches_a_stop_until_it_is_reset(
    open_note: Callable[[], LatchNote], content: bytes
) -> None:
    """Nobody knows what it held."""
    path = closed(open_note())
    path.parent.mkdir(parents=True)
    path.write_bytes(content)
    note = open_note()
    (said,) = note.read().items()
    assert said[0] is Reason.REMOTE_STOP
    assert f"{path}: it is damaged" in said[1]
    note.follow(dict([said]))
    closed(note)
    assert json.loads(path.read_bytes()) == {"remote_stop": said[1]}
    again = open_note()
    again.read()
    again.follow({})
    assert not closed(again).exists()


def test_a_note_that_cannot_be_written_is_said_once_and_holds_nobody_up(
    open_note: Callable[[], LatchNote], monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """To the loop, which goes on whatever the disk does, and in the log."""
    goes_on = threading.Event()

    def fail(_descriptor: int) -> None:
        goes_on.wait()
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", fail)
    note = open_note()
    assert note.follow(STOPPED) == ""  # It came back although the disk stalls.
    goes_on.set()
    said: list[str] = []

    def is_said() -> bool:
        said.append(note.follow(STOPPED))
        return said[-1] != ""

    wait_until(is_said)
    assert said[-1].endswith("No space left on device")
    assert caplog.messages == [said[-1]]
    assert note.follow(STOPPED) == ""
    note.close()


def test_of_more_changes_than_the_disk_writes_the_last_one_counts(
    open_note: Callable[[], LatchNote], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Anyone may stop a robot under ever other names, a hundred times a second."""
    note, goes_on, written = open_note(), threading.Event(), list[object]()

    def write(latched: object) -> None:
        goes_on.wait()
        written.append(latched)

    monkeypatch.setattr(note, "_write", write)
    for number in range(1000):
        note.follow({Reason.REMOTE_STOP: f"by {number}"})
    goes_on.set()
    note.close()
    assert len(written) < 4
    assert written[-1] == {"remote_stop": "by 999"}


def test_where_no_directory_is_given_nothing_is_kept() -> None:
    """The gateway warns of that at its start."""
    note = LatchNote.of(Settings(gateway=GatewaySettings(state_dir="")))
    assert note.read() == {}
    note.follow(STOPPED)
    note.close()
    assert note.path is None


def test_a_run_that_did_not_end_in_order_is_known_at_the_next_start(tmp_path: Path) -> None:
    """Row 'guard and gateway died together': nothing else tells the next gateway; an end in order does."""
    settings = Settings(gateway=GatewaySettings(state_dir=str(tmp_path / "state")))
    assert not RunNote.of(settings).begin()
    assert RunNote.of(settings).begin()
    RunNote.of(settings).end()
    assert not RunNote.of(settings).begin()
    assert not RunNote(None).begin()
