"""Logs that their recorder could not finish."""

import errno
import logging
import os
import shutil
import threading
from collections.abc import Iterable, Iterator
from io import BytesIO
from pathlib import Path
from types import SimpleNamespace
from typing import BinaryIO

import pytest
from mcap.reader import make_reader

from recorder.disk import keeper
from recorder.disk.files import LogDirectory, lock
from recorder.disk.keeper import (
    LeftoverThread,
    Recovery,
    RecoveryOutcome,
    read_entries,
    recover,
    recover_leftovers,
)
from recorder.record.actions import DiskBack, DiskRoom, Recovered
from recorder.record.retention import LogSigner
from recorder.review.check import check_log
from tests.support.logs import logs_in, small_log
from tests.support.messages import WALL_NS

LOG = small_log()
SUMMARY = LOG.rindex(b"\x0f\x04\x00\x00\x00\x00\x00\x00\x00")
FULL = DiskRoom(has_room=False, has_incident_room=True)
ROOM = DiskRoom(has_room=True, has_incident_room=True)


def part(directory: Path, data: bytes, stem: str = "x") -> Path:
    """A log that was left."""
    path = directory / f"{stem}.mcap.part"
    path.write_bytes(data)
    return path


def messages(path: Path) -> int:
    """How many messages the mcap package reads."""
    return sum(1 for _ in make_reader(BytesIO(path.read_bytes()), validate_crcs=True).iter_messages())


def attachments(path: Path) -> list[str]:
    """The names of a log's attachments."""
    return [one.name for one in make_reader(BytesIO(path.read_bytes())).iter_attachments()]


def flipped(data: bytes) -> bytes:
    """The log with a wrong bit within its first chunk."""
    place = data.index(b"\x04\x00\x00\x00zstd") + 30
    return data[:place] + bytes([data[place] ^ 4]) + data[place + 1 :]


def test_a_killed_recorders_log_is_made_whole_in_place(tmp_path: Path) -> None:
    """The same file under its proper name; nothing else is left."""
    path = part(tmp_path, LOG[: SUMMARY + 3])
    inode = path.stat().st_ino
    recovery = recover(path, "test")
    assert (recovery.outcome, recovery.messages, recovery.cut_bytes) == (RecoveryOutcome.RECOVERED, 12, 3)
    assert logs_in(tmp_path) == ["x.mcap"]
    assert (tmp_path / "x.mcap").stat().st_ino == inode
    assert check_log(tmp_path / "x.mcap").whole
    assert messages(tmp_path / "x.mcap") == 12


def test_a_whole_part_is_but_renamed(tmp_path: Path) -> None:
    """Its recorder was killed between the last write and the new name."""
    assert recover(part(tmp_path, LOG), "test").outcome is RecoveryOutcome.WHOLE
    assert (tmp_path / "x.mcap").read_bytes() == LOG


def test_a_name_that_exists_gets_a_number(tmp_path: Path) -> None:
    """Neither a log nor a part that will be one is overwritten."""
    (tmp_path / "x.mcap").write_text("mine")
    part(tmp_path, b"another's", "x-2")
    recovery = recover(part(tmp_path, LOG), "test")
    assert recovery.result == str(tmp_path / "x-3.mcap")
    assert (tmp_path / "x.mcap").read_text() == "mine"


def test_a_part_that_somebody_writes_is_not_touched(tmp_path: Path) -> None:
    """The lock of a living recorder tells; when it is gone, so is the lock."""
    log = LogDirectory(tmp_path).open("x", WALL_NS, "test")
    before = log.path.read_bytes()
    assert recover(log.path, "test").outcome is RecoveryOutcome.BUSY
    assert log.path.read_bytes() == before
    assert list(recover_leftovers([log.path], "test")) == []
    log.salvage()


def test_a_part_that_was_renamed_before_it_was_locked_is_not_touched(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its recorder has just ended it, and perhaps another one began a part of that name."""
    path = part(tmp_path, LOG[:SUMMARY])

    def late(descriptor: int) -> bool:
        path.rename(tmp_path / "x.mcap")
        part(tmp_path, b"new")
        return lock(descriptor)

    monkeypatch.setattr(keeper, "lock", late)
    assert recover(path, "test").outcome is RecoveryOutcome.BUSY
    assert path.read_bytes() == b"new"
    assert (tmp_path / "x.mcap").read_bytes() == LOG[:SUMMARY]


def test_where_there_are_no_locks_nothing_is_touched(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody could tell whether its recorder lives."""

    def none(_descriptor: int) -> bool:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(keeper, "lock", none)
    path = part(tmp_path, LOG[:SUMMARY])
    recovery = recover(path, "test")
    assert recovery.outcome is RecoveryOutcome.FAILED
    assert recovery.detail == f"No locks available: {keeper.NO_LOCKS}"
    assert path.read_bytes() == LOG[:SUMMARY]


def test_a_damaged_log_is_kept_as_it_is_beside_what_is_good_in_it(tmp_path: Path) -> None:
    """Nothing of value is deleted."""
    data = flipped(LOG)[:SUMMARY]
    recovery = recover(part(tmp_path, data), "test")
    assert (recovery.outcome, recovery.fault_count, recovery.messages) == (RecoveryOutcome.DAMAGED, 1, 2)
    assert logs_in(tmp_path) == ["x.mcap", "x.mcap.damaged"]
    assert (tmp_path / "x.mcap.damaged").read_bytes() == data
    assert recovery.kept == str(tmp_path / "x.mcap.damaged")
    assert check_log(tmp_path / "x.mcap").whole
    assert messages(tmp_path / "x.mcap") == 2


def test_what_is_cut_off_and_more_than_torn_is_kept(tmp_path: Path) -> None:
    """Here something that is no record."""
    recovery = recover(part(tmp_path, LOG[:SUMMARY] + b"\xffnobody knows"), "test")
    assert (recovery.outcome, recovery.messages) == (RecoveryOutcome.DAMAGED, 12)
    assert (tmp_path / "x.mcap.rest").read_bytes() == b"\xffnobody knows"
    assert check_log(tmp_path / "x.mcap").whole


def test_a_log_that_is_no_part_keeps_its_name(tmp_path: Path) -> None:
    """By hand any log can be made whole; a damaged one makes room."""
    path = tmp_path / "log.mcap"
    path.write_bytes(LOG[:SUMMARY])
    assert recover(path, "test").result == str(path)
    assert check_log(path).whole
    path.write_bytes(flipped(LOG))
    recovery = recover(path, "test")
    assert (recovery.result, recovery.kept) == (str(path), str(tmp_path / "log.mcap.damaged"))
    assert check_log(path).whole


@pytest.mark.parametrize("data", [b"", b"\x89MC", bytes(3000), b"something else"])
def test_a_part_without_anything_is_set_aside_at_a_start(tmp_path: Path, data: bytes) -> None:
    """As it is, so that the next start does not try it again; by hand it is left where it is."""
    path = part(tmp_path, data)
    assert recover(path, "test").outcome is RecoveryOutcome.NOTHING
    assert logs_in(tmp_path) == ["x.mcap.part"]
    (recovery,) = recover_leftovers([path], "test")
    assert recovery.outcome is RecoveryOutcome.NOTHING
    assert (tmp_path / "x.mcap.damaged").read_bytes() == data
    assert logs_in(tmp_path) == ["x.mcap.damaged"]


def fail_to(name: str, monkeypatch: pytest.MonkeyPatch, number: int = errno.ENOSPC) -> None:
    """Let a step of the recovery meet a full disk, or another fault."""

    def full(*_arguments: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(keeper, name, full)


def test_a_copy_that_does_not_fit_leaves_the_log_as_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And nothing of the copy."""
    fail_to("copy_good", monkeypatch)
    data = flipped(LOG)[:SUMMARY]
    recovery = recover(part(tmp_path, data), "test")
    assert (recovery.outcome, recovery.detail) == (RecoveryOutcome.FAILED, "No space left on device")
    assert logs_in(tmp_path) == ["x.mcap.part"]
    assert (tmp_path / "x.mcap.part").read_bytes() == data


@pytest.mark.parametrize(
    ("data", "needed"), [(flipped(LOG)[:SUMMARY], SUMMARY), (LOG[:SUMMARY] + b"\xffnobody knows", 13)]
)
def test_what_does_not_fit_beside_the_log_is_not_begun(
    data: bytes, needed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A copy or rest that filled the disk in vain would have whole logs deleted for it, time and again."""
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=needed - 1))
    fail_to("copy_good", monkeypatch, errno.EIO)
    fail_to("_finish", monkeypatch, errno.EIO)
    path = part(tmp_path, data)
    assert recover(path, "test").detail == "No space left on device"
    assert logs_in(tmp_path) == ["x.mcap.part"]
    assert path.read_bytes() == data
    monkeypatch.undo()
    assert recover(path, "test").outcome is RecoveryOutcome.DAMAGED


def test_a_rest_that_cannot_be_kept_leaves_the_log_as_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And nothing of the rest: each further try would leave one more."""

    def fail_late(stream: BinaryIO, kept: BinaryIO) -> None:
        kept.write(stream.read(3))
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(shutil, "copyfileobj", fail_late)
    data = LOG[:SUMMARY] + b"\xffnobody knows"
    path = part(tmp_path, data)
    assert recover(path, "test").detail == "Input/output error"
    assert logs_in(tmp_path) == ["x.mcap.part"]
    assert path.read_bytes() == data


class FullDisk:
    """Takes so many bytes of each file's end, and 50 of them at once."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, room: int) -> None:
        write = os.pwrite
        sizes: dict[int, int] = {}

        def pwrite(file: int, data: bytes, offset: int) -> int:
            begin = sizes.setdefault(file, offset)
            if offset - begin >= room:
                raise OSError(errno.ENOSPC, "No space left on device")
            return write(file, data[:50], offset)

        monkeypatch.setattr(os, "pwrite", pwrite)


def test_a_log_whose_end_does_not_fit_stays_a_part(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Cut back to its last whole record, to be recovered when there is room."""
    FullDisk(monkeypatch, 100)
    path = part(tmp_path, LOG[: SUMMARY + 3])
    assert recover(path, "test").outcome is RecoveryOutcome.FAILED
    assert path.read_bytes() == LOG[:SUMMARY]
    monkeypatch.undo()
    assert recover(path, "test").outcome is RecoveryOutcome.RECOVERED


def test_a_recovery_reaches_the_disk_before_the_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A power cut between the two leaves a part, which the next start recovers."""
    steps: list[str] = []
    fsync = os.fsync
    rename = Path.rename

    def note_sync(descriptor: int) -> None:
        steps.append("directory" if Path(f"/proc/self/fd/{descriptor}").resolve().is_dir() else "file")
        fsync(descriptor)

    def note_name(path: Path, target: Path) -> Path:
        steps.append("name")
        return rename(path, target)

    monkeypatch.setattr(os, "fsync", note_sync)
    monkeypatch.setattr(Path, "rename", note_name)
    recover(part(tmp_path, LOG[:SUMMARY]), "test")
    assert steps == ["file", "name", "directory"]


def test_a_start_recovers_every_part_and_says_so(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """With the count of messages; what is whole already is left alone."""
    (tmp_path / "whole.mcap").write_bytes(LOG)
    part(tmp_path, LOG[:SUMMARY], "a")
    part(tmp_path, flipped(LOG)[:SUMMARY], "b")
    part(tmp_path, b"", "c")
    with caplog.at_level(logging.INFO):
        thread = LeftoverThread(tmp_path, "test")
        thread.wait(30)
    assert [one.messages for one in thread.recoveries] == [12, 2, 0]
    assert logs_in(tmp_path) == ["a.mcap", "b.mcap", "b.mcap.damaged", "c.mcap.damaged", "whole.mcap"]
    assert "recovered 12 messages" in caplog.text
    assert "recovered 2 messages" in caplog.text
    assert "cannot recover" in caplog.text


def test_what_is_left_later_is_recovered_when_it_is_looked_for_again(tmp_path: Path) -> None:
    """A part that its recorder is still writing is locked, and left alone."""
    thread = LeftoverThread(tmp_path, "test")
    thread.wait(30)
    part(tmp_path, LOG[:SUMMARY], "a")
    held = part(tmp_path, LOG[:SUMMARY], "b")
    with held.open("rb") as stream:
        assert lock(stream.fileno())
        thread.look_again()
        thread.wait(30)
    assert logs_in(tmp_path) == ["a.mcap", "b.mcap.part"]
    assert [one.messages for one in thread.recoveries] == [12]


def test_what_was_recovered_is_told_to_the_recording_and_nothing_else(tmp_path: Path) -> None:
    """Of a part in which nothing can be read nobody says that it is whole now; nor does a name rule a terminal."""
    part(tmp_path, LOG[:SUMMARY], "a-20270115T080000Z.incident")
    part(tmp_path, flipped(LOG)[:SUMMARY], "b")
    part(tmp_path, b"", "c")
    part(tmp_path, LOG[:SUMMARY], os.fsdecode(b"d\xff\x1b[2J"))
    thread = LeftoverThread(tmp_path, "test")
    thread.wait(30)
    assert list(thread.notices()) == [
        Recovered("a-20270115T080000Z.incident.mcap", 12),
        Recovered("b.mcap", 2),
        Recovered(r"d\udcff\x1b[2J.mcap", 12),
    ]
    assert list(thread.notices()) == []
    assert len(thread.recoveries) == 4


def test_what_cannot_be_recovered_now_is_told_by_nobody(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is as it was."""
    fail_to("copy_good", monkeypatch)
    part(tmp_path, flipped(LOG)[:SUMMARY])
    thread = LeftoverThread(tmp_path, "test")
    thread.wait(30)
    assert list(thread.notices()) == []
    assert [one.outcome for one in thread.recoveries] == [RecoveryOutcome.FAILED]


def test_what_did_not_fit_is_recovered_when_there_is_room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither before, nor again after that: where nothing has failed, room is no reason to look."""
    fail_to("_finish", monkeypatch)
    part(tmp_path, LOG[:SUMMARY])
    thread = LeftoverThread(tmp_path, "test")
    thread.wait(30)
    monkeypatch.undo()
    thread.receive_notice(FULL)
    thread.wait(30)
    assert logs_in(tmp_path) == ["x.mcap.part"]
    thread.receive_notice(ROOM)
    thread.wait(30)
    assert logs_in(tmp_path) == ["x.mcap"]
    assert list(thread.notices()) == [Recovered("x.mcap", 12)]
    assert check_log(tmp_path / "x.mcap").whole
    part(tmp_path, LOG[:SUMMARY], "later")
    thread.receive_notice(ROOM)
    thread.wait(30)
    assert "later.mcap.part" in logs_in(tmp_path)
    thread.receive_notice(DiskBack())
    thread.wait(30)
    assert logs_in(tmp_path) == ["later.mcap", "x.mcap"]


def test_a_try_that_fails_again_waits_for_the_next_room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One try for each time that there is room: it reads the whole log."""
    fail_to("_finish", monkeypatch)
    part(tmp_path, LOG[:SUMMARY])
    thread = LeftoverThread(tmp_path, "test")
    for tries in (1, 2, 3):
        thread.wait(30)
        assert list(thread.notices()) == []
        assert [one.outcome for one in thread.recoveries] == [RecoveryOutcome.FAILED] * tries
        thread.receive_notice(ROOM)


def test_room_that_comes_during_a_look_is_not_missed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The first part has failed by then, and the second is still being read: one more look follows."""
    reads, goes_on = threading.Event(), threading.Event()

    def late(path: Path, library: str, *, set_aside: bool, signer: LogSigner | None) -> Recovery:
        if path.name.startswith("a") and not goes_on.is_set():
            return Recovery(str(path), RecoveryOutcome.FAILED, str(path), detail="No space left on device")
        reads.set()
        assert goes_on.wait(30)
        return recover(path, library, set_aside=set_aside, signer=signer)

    monkeypatch.setattr(keeper, "recover", late)
    for stem in "ab":
        part(tmp_path, LOG[:SUMMARY], stem)
    thread = LeftoverThread(tmp_path, "test")
    assert reads.wait(30)
    thread.receive_notice(ROOM)
    goes_on.set()
    thread.wait(30)
    told = list(thread.notices())
    thread.wait(30)
    told += thread.notices()
    assert told == [Recovered("b.mcap", 12), Recovered("a.mcap", 12)]
    assert logs_in(tmp_path) == ["a.mcap", "b.mcap"]


def test_an_incident_stays_one(tmp_path: Path) -> None:
    """Whole, with a number, with a rest or set aside: nobody deletes it for want of room."""
    stem = "a-20270115T080000Z.incident"
    (tmp_path / f"{stem}.mcap").write_bytes(LOG)
    part(tmp_path, flipped(LOG)[:SUMMARY], stem)
    (tmp_path / f"{stem}-3.mcap").write_bytes(LOG)
    part(tmp_path, LOG[:SUMMARY] + b"\xffnobody knows", f"{stem}-3")
    part(tmp_path, b"", f"{stem}-4")
    thread = LeftoverThread(tmp_path, "test")
    thread.wait(30)
    assert len(logs_in(tmp_path)) == 7
    entries = read_entries(tmp_path)
    assert len(entries) == 7
    assert all(entry.is_incident for entry in entries)


def test_a_part_that_begins_after_the_start_is_no_leftover(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where there are no locks too: what this recorder itself writes is not recovered under its hands."""
    part(tmp_path, LOG[:SUMMARY], "old")
    goes_on = threading.Event()
    recover_all = keeper.recover_leftovers

    def late(parts: Iterable[Path], library: str, signer: LogSigner | None) -> Iterator[Recovery]:
        assert goes_on.wait(30)
        return recover_all(parts, library, signer)

    monkeypatch.setattr(keeper, "recover_leftovers", late)
    thread = LeftoverThread(tmp_path, "test")
    part(tmp_path, LOG[:SUMMARY], "new")
    goes_on.set()
    thread.wait(30)
    assert logs_in(tmp_path) == ["new.mcap.part", "old.mcap"]
