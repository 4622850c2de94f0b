"""Notes that outlive the process: a stop by the guard, latches, the run, the mileage."""

import errno
import json
import os
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from gateway.host import notes
from gateway.host.notes import (
    STOP_NOTE_MAX_BYTES,
    LatchNote,
    MileageNote,
    NoteClearer,
    NoteWriter,
    RunNote,
    StopNote,
)
from schemas.reasons import Reason
from schemas.settings import GatewaySettings, RobotSettings, Settings
from tests.support.waiting import wait_until


@pytest.fixture
def note(tmp_path: Path) -> StopNote:
    return StopNote(tmp_path / "state" / "fleet.cruiser-1.guard-stop")


def path_of(note: StopNote) -> Path:
    assert note.path is not None
    return note.path


def test_what_the_guard_said_is_read_with_its_times(note: StopNote) -> None:
    assert note.read() == ""
    note.add("guard: the gateway is gone")
    note.add("guard: done: the robot stands")
    first, second = note.read().split("; ")
    assert first.endswith("+00:00 guard: the gateway is gone")
    assert second.endswith("+00:00 guard: done: the robot stands")
    assert [entry.name for entry in path_of(note).parent.iterdir()] == [path_of(note).name]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "is empty: the disk was full"),
        (os.mkfifo, "is no file"),  # One would hold the start of the gateway up.
        *(
            (one, "is damaged")
            for one in (b"\0" * 100, b"2026-11-22T06:00:00+00:00 cut o", b"\xff\n", b"no time\n")
        ),
    ],
)
def test_a_damaged_note_is_a_latch_that_says_so(
    note: StopNote, content: bytes | Callable[[Path], None], said: str
) -> None:
    """Default deny."""
    path_of(note).parent.mkdir()
    if isinstance(content, bytes):
        path_of(note).write_bytes(content)
    else:
        content(path_of(note))
    assert said in note.read()


@pytest.mark.parametrize(
    ("call", "number", "left"),
    [("fsync", errno.EIO, "guard: the gateway is gone"), ("write", errno.ENOSPC, "is empty: the disk was full")],
)
def test_a_disk_that_fails_leaves_a_note_all_the_same(
    note: StopNote, monkeypatch: pytest.MonkeyPatch, call: str, number: int, left: str
) -> None:
    def fail(*_: object) -> int:
        raise OSError(number, os.strerror(number))

    with monkeypatch.context() as broken:
        broken.setattr(os, call, fail)
        with pytest.raises(OSError, match=os.strerror(number)):
            note.add("guard: the gateway is gone")
    assert left in note.read()


def test_a_note_stays_small(note: StopNote) -> None:
    for number in range(100):
        note.add(f"guard: stop {number} {'x' * 60}")
    assert path_of(note).stat().st_size <= STOP_NOTE_MAX_BYTES
    assert "guard: stop 0 " in note.read()
    assert "damaged" not in note.read()


def test_the_note_is_where_the_settings_or_else_the_system_say() -> None:
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
    assert note.why_not() == ""
    assert path_of(note).parent.is_dir()
    assert "state_dir is empty" in StopNote(None).why_not()
    path_of(note).touch()
    assert "cannot be made: Not a directory" in StopNote(path_of(note) / "below" / "note").why_not()
    monkeypatch.setattr(os, "access", lambda *_: False)
    assert note.why_not() == f"{path_of(note).parent} cannot be written to"


def test_a_disk_that_stalls_holds_up_nobody(note: StopNote, monkeypatch: pytest.MonkeyPatch) -> None:
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


@pytest.mark.parametrize(
    ("latched", "is_kept"),
    [([False, False], True), ([True, True], True), ([False, True, False], False)],
    ids=["never latched", "latched still", "reset"],
)
def test_only_a_reset_removes_the_note(note: StopNote, latched: list[bool], *, is_kept: bool) -> None:
    note.add("guard: the gateway is gone")
    clearer = NoteClearer(note)
    for is_latched in latched:
        clearer.follow(is_latched=is_latched)
    clearer.close()
    assert bool(note.read()) is is_kept


def test_without_a_directory_nothing_is_kept() -> None:
    settings = Settings(gateway=GatewaySettings(state_dir=""))
    off, latched = StopNote.of(settings), LatchNote.of(settings)
    off.add("guard: the gateway is gone")
    latched.follow(STOPPED)
    latched.close()
    assert (off.read(), LatchNote.of(settings).read(), RunNote.of(settings).begin()) == ("", {}, False)
    off.remove()


STOPPED = {Reason.REMOTE_STOP: "by ann", Reason.FRONT_BUMPER: ""}


@pytest.fixture
def open_note(tmp_path: Path) -> Callable[[], LatchNote]:
    settings = Settings(gateway=GatewaySettings(state_dir=str(tmp_path / "state")))
    return lambda: LatchNote.of(settings)


def closed(note: LatchNote) -> Path:
    note.close()
    assert note.path is not None
    return note.path


def test_what_is_latched_is_there_after_a_restart_until_it_is_reset(open_note: Callable[[], LatchNote]) -> None:
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
    note = open_note()
    note.follow({Reason.GUARD: "late"})
    assert not closed(note).exists()


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b'{"no such reason": ""}', b'{"remote_stop": 1}', b"\xff"])
def test_a_damaged_note_latches_a_stop_until_it_is_reset(
    open_note: Callable[[], LatchNote], content: bytes
) -> None:
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
    """Anyone may stop a robot under changing names, a hundred times a second."""
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


def test_a_run_that_did_not_end_in_order_is_known_at_the_next_start(tmp_path: Path) -> None:
    """Row 'guard and gateway died together'."""
    settings = Settings(gateway=GatewaySettings(state_dir=str(tmp_path / "state")))
    assert not RunNote.of(settings).begin()
    assert RunNote.of(settings).begin()
    RunNote.of(settings).end()
    assert not RunNote.of(settings).begin()


@pytest.fixture
def start(tmp_path: Path) -> Callable[..., MileageNote]:
    def opened(name: str = "cruiser-1") -> MileageNote:
        settings = Settings(gateway=GatewaySettings(state_dir=str(tmp_path)), robot=RobotSettings(name=name))
        return MileageNote.of(settings)

    return opened


def drive(note: MileageNote, *mileages_km: float | None) -> list[str]:
    """Follow these mileages, each until it is written. Returns the questions."""
    asked = []
    for mileage_km in mileages_km:
        asked.append(note.follow(mileage_km))
        wait_until(lambda: note.path is not None and notes._read(note.path) == note._noted_km)
    return [one for one in asked if one]


@pytest.mark.parametrize(
    ("before_km", "then_km", "is_asked"),
    [(12.0, 12.0, False), (12.0, 13.0, False), (12.0, 13.001, True), (812.4, 3.0, True), (3.0, 0.0, True)],
)
def test_a_mileage_that_is_far_off_at_a_start_is_asked_about_once(
    start: Callable[..., MileageNote], before_km: float, then_km: float, *, is_asked: bool
) -> None:
    assert drive(start(), None, before_km) == []
    asked = drive(start(), None, then_km, then_km)
    assert len(asked) == is_asked
    assert all(f"reads {then_km:.1f} km, and read {before_km:.1f} km when" in one for one in asked)
    assert drive(start(), then_km) == []


def test_a_run_may_drive_as_far_as_it_likes_and_another_name_has_another_note(
    start: Callable[..., MileageNote],
) -> None:
    assert drive(start(), 5.0, *(5.0 + 0.1 * number for number in range(40)), 0.0, 0.4, 0.46) == []
    assert drive(start("cruiser-2"), 700.0) == []
    assert drive(start(), 0.5) == []
    assert len(drive(start(), 9.0)) == 1


@pytest.mark.parametrize("content", [b"", b"{}", b'"x"', b"\xff"])
def test_a_damaged_note_asks_nothing(start: Callable[..., MileageNote], tmp_path: Path, content: bytes) -> None:
    (tmp_path / "fleet.cruiser-1.mileage.json").write_bytes(content)
    assert drive(start(), 5.0) == []
    assert len(drive(start(), 9.0)) == 1
