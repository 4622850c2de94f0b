"""The note of a stop by the guard: there after any failure, and gone after a reset."""

import errno
import os
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from gateway.host.notes import STOP_NOTE_MAX_BYTES, NoteClearer, NoteWriter, StopNote
from schemas.settings import GatewaySettings, RobotSettings, Settings
from tests.support.waiting import wait_until


@pytest.fixture
def note(tmp_path: Path) -> StopNote:
    """None is there yet, nor its directory."""
    return StopNote(tmp_path / "state" / "fleet.cruiser-1.guard-stop")


def path_of(note: StopNote) -> Path:
    assert note.path is not None
    return note.path


def test_what_the_guard_said_is_read_with_its_times(note: StopNote) -> None:
    """Row 'kept on disk, with its words': cause and outcome, in one line."""
    assert note.read() == ""
    note.add("guard: the gateway is gone")
    note.add("guard: done: the robot stands")
    first, second = note.read().split("; ")
    assert first.endswith("+00:00 guard: the gateway is gone")
    assert second.endswith("+00:00 guard: done: the robot stands")
    assert [entry.name for entry in path_of(note).parent.iterdir()] == [path_of(note).name]


@pytest.mark.parametrize(
    "content", [b"", b"\0" * 100, b"2026-11-22T06:00:00+00:00 cut o", b"\xff\xfe\n", b"no time\n"]
)
def test_a_damaged_note_is_a_latch_that_says_so(note: StopNote, content: bytes) -> None:
    """Default deny; and nothing of it can break a line."""
    note.add("guard: the gateway is gone")
    path_of(note).write_bytes(content)
    assert ("is damaged" if content else "is empty: the disk was full") in note.read()


@pytest.mark.parametrize("make", [os.mkdir, os.mkfifo])
def test_a_note_that_cannot_be_read_is_a_latch_that_says_so(note: StopNote, make: Callable[[Path], None]) -> None:
    """Default deny; and a pipe would hold the start of the gateway up."""
    path_of(note).parent.mkdir()
    make(path_of(note))
    assert note.read() == f"the note {note.path} is no file"


@pytest.mark.parametrize(
    ("call", "number", "left"),
    [
        ("fsync", errno.EIO, "guard: the gateway is gone"),
        ("write", errno.ENOSPC, "is empty: the disk was full"),
    ],
)
def test_a_disk_that_fails_leaves_a_note_all_the_same(
    note: StopNote, monkeypatch: pytest.MonkeyPatch, call: str, number: int, left: str
) -> None:
    """There was a stop: whatever of its words is on the disk, it latches."""

    def fail(*_: object) -> int:
        raise OSError(number, os.strerror(number))

    with monkeypatch.context() as broken:
        broken.setattr(os, call, fail)
        with pytest.raises(OSError, match=os.strerror(number)):
            note.add("guard: the gateway is gone")
    assert left in note.read()


def test_a_note_stays_small(note: StopNote) -> None:
    """A guard that stops the robot again and again fills no disk, and what it did first is kept."""
    for number in range(100):
        note.add(f"guard: stop {number} {'x' * 60}")
    assert path_of(note).stat().st_size <= STOP_NOTE_MAX_BYTES
    assert "guard: stop 0 " in note.read()
    assert "damaged" not in note.read()


def test_the_note_is_where_the_settings_or_else_the_system_say() -> None:
    """The directory of systemd goes before the user's; each robot has a note of its own."""

    def path(state_dir: str = "auto", **environment: str) -> str:
        settings = Settings(
            robot=RobotSettings(root="depot/north", name="c-7"), gateway=GatewaySettings(state_dir=state_dir)
        )
        return str(StopNote.of(settings, environment).path)

    name = "depot.north.c-7.guard-stop"
    systemd, user = {"STATE_DIRECTORY": "/var/lib/cruiser/gateway:/other"}, {"HOME": "/home/x"}
    assert path(**systemd, **user) == f"/var/lib/cruiser/gateway/{name}"
    assert path(XDG_STATE_HOME="/state", **user) == f"/state/cruiser/{name}"
    assert path(**user) == f"/home/x/.local/state/cruiser/{name}"
    assert path("/given", **systemd) == f"/given/{name}"
    assert path("", **systemd) == path() == "None"


def test_why_no_note_can_be_kept_is_said(note: StopNote, monkeypatch: pytest.MonkeyPatch) -> None:
    """Off, a directory that cannot be made, and one that cannot be written to."""
    assert note.why_not() == ""
    assert path_of(note).parent.is_dir()
    assert "state_dir is empty" in StopNote(None).why_not()
    path_of(note).touch()
    assert "cannot be made: Not a directory" in StopNote(path_of(note) / "below" / "note").why_not()
    monkeypatch.setattr(os, "access", lambda *_: False)
    assert note.why_not() == f"{path_of(note).parent} cannot be written to"


def test_without_a_note_nothing_is_written_read_or_removed() -> None:
    """The setting is empty."""
    off = StopNote(None)
    off.add("guard: the gateway is gone")
    assert off.read() == ""
    off.clear()


def test_a_disk_that_stalls_holds_up_nobody(note: StopNote, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither the guard's thread nor the loop's; what waits is written in its order when the disk goes on."""
    goes_on, fsync = threading.Event(), os.fsync

    def stall(descriptor: int) -> None:
        assert goes_on.wait(20)
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", stall)
    complaints: list[str] = []
    writer = NoteWriter(note, complaints.append)
    writer.add("guard: first")
    writer.add("guard: second")
    assert note.read() == ""
    goes_on.set()
    writer.close()
    assert [line.partition(" ")[2] for line in note.read().split("; ")] == ["guard: first", "guard: second"]
    goes_on.clear()
    clearer = NoteClearer(note)
    clearer.follow(is_latched=True)
    clearer.follow(is_latched=False)
    clearer.follow(is_latched=False)
    goes_on.set()
    wait_until(lambda: note.read() == "")
    clearer.close()
    assert complaints == []


def test_a_note_that_cannot_be_written_or_removed_is_said(
    note: StopNote, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """The guard and the gateway go on."""

    def fail(*_words: object, **_named: object) -> None:
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr(Path, "mkdir", fail)
    monkeypatch.setattr(Path, "unlink", fail)
    complaints: list[str] = []
    writer = NoteWriter(note, complaints.append)
    writer.add("guard: first")
    writer.close()
    assert complaints == [f"the note {note.path} cannot be written: Read-only file system"]
    clearer = NoteClearer(note)
    clearer.follow(is_latched=True)
    clearer.follow(is_latched=False)
    clearer.close()
    assert "cannot be removed: Read-only file system" in caplog.text


def test_only_a_reset_removes_the_note(note: StopNote) -> None:
    """Neither that nothing was latched from the start on, nor that it is latched."""
    note.add("guard: the gateway is gone")
    clearer = NoteClearer(note)
    for is_latched in (False, False, True, True):
        clearer.follow(is_latched=is_latched)
    clearer.close()
    assert note.read()
    clearer.follow(is_latched=False)
    clearer.close()
    assert note.read() == ""
