"""The directory of logs, and the note of uploaded ones."""

import errno
import os
import stat
import threading
from io import BytesIO
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader

from recorder.disk import files, log_names
from recorder.disk.files import (
    NAME,
    LogDirectory,
    PartFile,
    Prologue,
    SafeLogReader,
    UploadedLog,
    UploadNote,
    safe_name,
)
from recorder.disk.log_names import lock
from recorder.encoding.protobuf import descriptor_set
from recorder.mcap.writer import LogChannel, McapFile
from recorder.reading.rows import file_name
from recorder.record.actions import CloseLog, DeclareChannel, SyncLog, WriteAttachment, WriteChunk
from schemas.command_line import CommandError
from schemas.messages import Gear
from tests.support.fakes.recording import failing
from tests.support.logs import logs_in, sealed
from tests.support.messages import WALL_NS
from tests.support.reading import Read
from tests.support.waiting import wait_until

CHANNEL = LogChannel(1, "t", "cruiser.Gear", descriptor_set(Gear))
STEM = "cruiser-1-20270115T080000Z"


def chunk(number: int, data: bytes = b"") -> WriteChunk:
    return WriteChunk("x", sealed([(1, number, number, number, data)]))


def opened(path: Path) -> PartFile:
    log = LogDirectory(path).open("cruiser-1", WALL_NS, "test")
    log.write(DeclareChannel("x", CHANNEL))
    return log


def sequences(path: Path) -> list[int]:
    return [sequence for _, sequence, *_ in Read(path).messages]


def test_a_sync_reaches_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced: list[str] = []
    monkeypatch.setattr(os, "fdatasync", lambda _: synced.append("data"))
    monkeypatch.setattr(
        os, "fsync", lambda fd: synced.append("name" if stat.S_ISDIR(os.fstat(fd).st_mode) else "file")
    )
    log = opened(tmp_path)
    assert synced == ["name"]
    log.write(chunk(1))
    log.write(SyncLog("x"))
    wait_until(lambda: "data" in synced)
    log.write(CloseLog("x"))
    assert synced == ["name", "data", "file", "name"]


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    first, second = opened(tmp_path), opened(tmp_path)
    first.write(CloseLog("x"))
    third = opened(tmp_path)
    second.write(CloseLog("x"))
    assert logs_in(tmp_path) == [f"{STEM}-2.mcap", f"{STEM}-3.mcap.part", f"{STEM}.mcap"]
    third.write(CloseLog("x"))


@given(st.text(max_size=50))
def test_a_name_is_safe_on_any_system(text: str) -> None:
    name = safe_name(text)
    assert name
    assert not name.startswith(".")
    assert set(name) <= set("ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789._-")


@pytest.mark.parametrize(
    ("robot", "name"), [("-rf", "_rf"), ("--json", "_-json"), (".-o", "_o"), ("cruiser-1", "cruiser-1")]
)
def test_no_name_is_taken_for_an_option(robot: str, name: str) -> None:
    """``cruiser review info *.mcap`` expands to untrusted names."""
    assert safe_name(robot) == name
    assert not file_name(robot).startswith("-")


def test_a_name_is_no_longer_than_a_disk_takes(tmp_path: Path) -> None:
    directory = LogDirectory(tmp_path)
    logs = [directory.open("a" * 5000 + end, WALL_NS, "test", is_incident=True) for end in "xy"]
    for log in logs:
        log.write(CloseLog("x"))
    assert len({log.path for log in logs}) == 2
    assert all(log.path.name.startswith("aaa") and ".incident" in log.path.name for log in logs)


def test_a_directory_that_cannot_be_used_is_one_clear_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "logs").write_text("")
    with pytest.raises(CommandError, match=r"cannot write .*logs: (File exists|Not a directory)"):
        LogDirectory(tmp_path / "logs")
    with pytest.raises(CommandError, match="Not a directory"):
        LogDirectory(tmp_path / "logs" / "deeper")
    monkeypatch.setattr(os, "access", lambda *_: False)
    with pytest.raises(CommandError, match="no permission to write there"):
        LogDirectory(tmp_path)


def test_what_the_disk_does_not_take_leaves_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    directory = LogDirectory(tmp_path)
    for step in ("McapFile", "sync_directory", "sync_directory"):
        monkeypatch.setattr(files, step, failing(errno.EIO))
        with pytest.raises(CommandError, match=os.strerror(errno.EIO)):
            directory.open("x", WALL_NS, "test")
        monkeypatch.undo()
    log = opened(tmp_path)
    log.salvage()
    assert logs_in(tmp_path) == []
    assert not log.is_kept
    # A disk that is gone may not even say whether there is one: that is no fault of ours.
    monkeypatch.setattr(Path, "exists", failing(errno.EIO))
    assert not log.is_kept


def test_a_part_that_cannot_be_locked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as knobs:
        answers = iter([False, True])
        knobs.setattr(log_names, "lock", lambda _: next(answers))
        log = opened(tmp_path)
        assert log.path.name == f"{STEM}-2.mcap.part"
        log.salvage()
    monkeypatch.setattr(log_names, "lock", failing(errno.ENOLCK))
    log = opened(tmp_path)
    log.write(chunk(1))
    log.write(CloseLog("x"))
    assert sequences(log.path) == [1]


def test_no_file_takes_the_disk_for_itself(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file that is written all the time waits for its next sync behind the others."""
    monkeypatch.setattr(files, "SYNC_THREADS", 1)
    order: list[int] = []
    goes_on = threading.Semaphore(0)

    def keep(descriptor: int) -> None:
        order.append(os.fstat(descriptor).st_ino)
        assert goes_on.acquire(timeout=30)

    monkeypatch.setattr(os, "fdatasync", keep)
    directory = LogDirectory(tmp_path)
    busy, other = (directory.open(name, WALL_NS, "test") for name in "xy")
    numbers = [log.path.stat().st_ino for log in (busy, other)]
    busy.write(SyncLog("x"))
    wait_until(lambda: len(order) == 1)
    busy.write(SyncLog("x"))
    other.write(SyncLog("x"))
    goes_on.release(10)
    wait_until(lambda: len(order) == 3)
    assert order == [numbers[0], numbers[1], numbers[0]]
    busy.salvage()
    other.salvage()


def test_a_part_is_locked_until_it_is_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    got: list[bool] = []
    rename = Path.rename

    def rename_as_others_see_it(path: Path, target: Path) -> Path:
        with path.open("rb") as other:
            got.append(lock(other.fileno()))
        return rename(path, target)

    monkeypatch.setattr(Path, "rename", rename_as_others_see_it)
    log = opened(tmp_path)
    log.write(chunk(1))
    with log.path.open("rb") as other:
        assert not lock(other.fileno())
    log.write(CloseLog("x"))
    assert got == [False]
    with log.path.open("rb") as other:
        assert lock(other.fileno())


def test_names_without_end_cost_no_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the repeated attachments the oldest are dropped."""
    monkeypatch.setattr(files, "ATTACHMENTS_MAX", 3)
    prologue, stream = Prologue(), BytesIO()
    for number in (1, 2, 3, 1, 4):
        prologue.add(WriteAttachment("x", f"a/{number}", "text/plain", b"", number))
    file = McapFile(stream, "test")
    prologue.write_to(file)
    file.finish()
    assert [one.name for one in make_reader(BytesIO(stream.getvalue())).iter_attachments()] == [
        "a/3",
        "a/1",
        "a/4",
    ]


LOG = "cruiser-1-20270115T080000Z.mcap"


def line(name: str = LOG, size: int = 7, modified_ns: int = 1) -> UploadedLog:
    return UploadedLog(name, size, modified_ns, "00", "s3://logs", name)


def test_the_next_start_knows_what_was_safe(tmp_path: Path) -> None:
    reader = SafeLogReader(tmp_path)
    assert reader.read() == {}
    with UploadNote(tmp_path) as note:
        note.add(line())
        assert note.safe() == {LOG: (7, 1, "00")}
    assert reader.read() == SafeLogReader(tmp_path).read() == {LOG: (7, 1, "00")}


@pytest.mark.parametrize("torn", [b"", b"\n", b'{"file":"b', b"\xff\x00", b"[]\n", b'{"file":"b"}\n'])
def test_a_line_that_was_torn_costs_itself_alone(tmp_path: Path, torn: bytes) -> None:
    with UploadNote(tmp_path) as note:
        note.add(line("a"))
    with (tmp_path / NAME).open("ab") as stream:
        stream.write(torn)
    with UploadNote(tmp_path) as note:
        note.add(line("c"))
        assert note.safe() == {"a": (7, 1, "00"), "c": (7, 1, "00")}


def test_logs_that_are_gone_are_forgotten_once_they_are_many(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(files, "GONE_LINES", 3)
    with UploadNote(tmp_path) as note:
        for name in "abcd":
            note.add(line(name))
        note.forget({"a", "b"})
        assert set(note.safe()) == set("abcd")
        note.forget({"b"})
        assert set(note.safe()) == {"b"}
        note.add(line("e"))
    assert set(SafeLogReader(tmp_path).read()) == {"b", "e"}


def test_a_note_that_is_no_file_marks_nothing(tmp_path: Path) -> None:
    (tmp_path / NAME).mkdir()
    assert SafeLogReader(tmp_path).read() == {}
    with pytest.raises(CommandError, match="directory"):
        UploadNote(tmp_path)
