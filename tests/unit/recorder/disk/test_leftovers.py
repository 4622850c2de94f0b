"""Recovery of unfinished logs."""

import errno
import logging
import os
import threading
from collections.abc import Iterable, Iterator
from io import BytesIO
from pathlib import Path
from types import SimpleNamespace
from typing import Any, BinaryIO

import pytest
from mcap.reader import make_reader

from recorder.disk import keeper
from recorder.disk.files import LogDirectory
from recorder.disk.keeper import (
    LeftoverThread,
    Recovery,
    RecoveryOutcome,
    recover,
    recover_leftovers,
)
from recorder.disk.log_names import lock
from recorder.record.actions import DiskBack, DiskRoom, Recovered
from recorder.record.signed_mode import LogSigner
from recorder.review.check import check_log
from tests.support.fakes.recording import failing
from tests.support.logs import flipped, logs_in, small_log
from tests.support.messages import WALL_NS

LOG = small_log()
SUMMARY = LOG.rindex(b"\x0f\x04\x00\x00\x00\x00\x00\x00\x00")
FULL = DiskRoom(has_room=False, has_incident_room=True)
ROOM = DiskRoom(has_room=True, has_incident_room=True)


def part(directory: Path, data: bytes, stem: str = "x") -> Path:
    path = directory / f"{stem}.mcap.part"
    path.write_bytes(data)
    return path


def messages(path: Path) -> int:
    return sum(1 for _ in make_reader(BytesIO(path.read_bytes()), validate_crcs=True).iter_messages())


BEHIND = b"\xffnobody knows"
DAMAGED = flipped(LOG)[:SUMMARY]


@pytest.mark.parametrize(
    ("data", "said", "kept"),
    [
        # outcome, messages, faults, bytes that were cut off
        (LOG[: SUMMARY + 3], ("recovered", 12, 0, 3), {}),
        (LOG, ("whole", 12, 0, 0), {}),
        (DAMAGED, ("damaged", 2, 1, 0), {"x.mcap.damaged": DAMAGED}),
        (LOG[:SUMMARY] + BEHIND, ("damaged", 12, 0, 13), {"x.mcap.rest": BEHIND}),
    ],
    ids=["torn", "whole but for its name", "damaged: what is good is copied", "more than torn behind the data"],
)
def test_a_part_is_made_whole(
    tmp_path: Path, data: bytes, said: tuple[str, int, int, int], kept: dict[str, bytes]
) -> None:
    path, log = part(tmp_path, data), tmp_path / "x.mcap"
    inode = path.stat().st_ino
    one = recover(path, "test")
    assert (one.outcome.value, one.messages, one.fault_count, one.cut_bytes) == said
    assert [Path(one.kept).name for _ in kept if one.kept] == [*kept]
    assert {name: (tmp_path / name).read_bytes() for name in logs_in(tmp_path) if name != log.name} == kept
    assert (log.stat().st_ino == inode) == ("x.mcap.damaged" not in kept)
    assert check_log(log).whole
    assert messages(log) == one.messages
    assert data != LOG or log.read_bytes() == LOG


def test_a_name_that_exists_gets_a_number(tmp_path: Path) -> None:
    (tmp_path / "x.mcap").write_text("mine")
    part(tmp_path, b"another's", "x-2")
    recovery = recover(part(tmp_path, LOG), "test")
    assert recovery.result == str(tmp_path / "x-3.mcap")
    assert (tmp_path / "x.mcap").read_text() == "mine"


def test_a_part_that_somebody_writes_is_not_touched(tmp_path: Path) -> None:
    log = LogDirectory(tmp_path).open("x", WALL_NS, "test")
    before = log.path.read_bytes()
    assert recover(log.path, "test").outcome is RecoveryOutcome.BUSY
    assert log.path.read_bytes() == before
    assert list(recover_leftovers([log.path], "test")) == []
    log.salvage()


def test_a_part_that_was_renamed_before_it_was_locked_is_not_touched(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = part(tmp_path, LOG[:SUMMARY])

    def late(descriptor: int) -> bool:
        path.rename(tmp_path / "x.mcap")
        part(tmp_path, b"new")
        return lock(descriptor)

    monkeypatch.setattr(keeper, "lock", late)
    assert recover(path, "test").outcome is RecoveryOutcome.BUSY
    assert path.read_bytes() == b"new"
    assert (tmp_path / "x.mcap").read_bytes() == LOG[:SUMMARY]


def test_a_log_that_is_no_part_keeps_its_name(tmp_path: Path) -> None:
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
    path = part(tmp_path, data)
    assert recover(path, "test").outcome is RecoveryOutcome.NOTHING
    assert logs_in(tmp_path) == ["x.mcap.part"]
    (recovery,) = recover_leftovers([path], "test")
    assert recovery.outcome is RecoveryOutcome.NOTHING
    assert (tmp_path / "x.mcap.damaged").read_bytes() == data
    assert logs_in(tmp_path) == ["x.mcap.damaged"]


def fail_late(stream: BinaryIO, kept: BinaryIO) -> None:
    kept.write(stream.read(3))
    failing(errno.EIO)()


def leaves(free: int) -> dict[str, Any]:
    """Knobs of a disk with this much space, on which nothing can be created."""
    usage = SimpleNamespace(free=free)
    return {"shutil.disk_usage": lambda _: usage, "copy_good": failing(errno.EIO), "_end_with": failing(errno.EIO)}


NO_ROOM = os.strerror(errno.ENOSPC)


@pytest.mark.parametrize(
    ("knobs", "data", "detail"),
    [
        ({"lock": failing(errno.ENOLCK)}, LOG[:SUMMARY], f"{os.strerror(errno.ENOLCK)}: {keeper.NO_LOCKS}"),
        ({"copy_good": failing(errno.ENOSPC)}, DAMAGED, NO_ROOM),
        ({"shutil.copyfileobj": fail_late}, LOG[:SUMMARY] + BEHIND, os.strerror(errno.EIO)),
        (leaves(SUMMARY - 1), DAMAGED, NO_ROOM),
        (leaves(len(BEHIND) - 1), LOG[:SUMMARY] + BEHIND, NO_ROOM),
    ],
    ids=["no locks", "a copy does not fit", "a rest does not fit", "no room for a copy", "no room for a rest"],
)
def test_what_fails_leaves_the_log_as_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, knobs: dict[str, Any], data: bytes, detail: str
) -> None:
    for step, knob in knobs.items():
        monkeypatch.setattr(f"recorder.disk.keeper.{step}", knob)
    path = part(tmp_path, data)
    recovery = recover(path, "test")
    assert (recovery.outcome, recovery.detail) == (RecoveryOutcome.FAILED, detail)
    assert logs_in(tmp_path) == ["x.mcap.part"]
    assert path.read_bytes() == data
    monkeypatch.undo()
    assert recover(path, "test").outcome in {RecoveryOutcome.RECOVERED, RecoveryOutcome.DAMAGED}


def test_a_log_whose_end_does_not_fit_stays_a_part(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write = os.pwrite

    def pwrite(file: int, data: bytes, offset: int) -> int:
        return write(file, data[:50], offset) if offset < SUMMARY + 100 else failing(errno.ENOSPC)()

    monkeypatch.setattr(os, "pwrite", pwrite)
    path = part(tmp_path, LOG[: SUMMARY + 3])
    assert recover(path, "test").outcome is RecoveryOutcome.FAILED
    assert path.read_bytes() == LOG[:SUMMARY]
    monkeypatch.undo()
    assert recover(path, "test").outcome is RecoveryOutcome.RECOVERED


def test_a_recovery_reaches_the_disk_before_the_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A power cut between leaves a part, which the next start recovers."""
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


def looked(directory: Path) -> LeftoverThread:
    thread = LeftoverThread(directory, "test")
    thread.wait(30)
    return thread


def test_a_start_recovers_every_part_and_says_so(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "whole.mcap").write_bytes(LOG)
    part(tmp_path, LOG[:SUMMARY], "a-20270115T080000Z.incident")
    part(tmp_path, DAMAGED, "b")
    part(tmp_path, b"", "c")
    part(tmp_path, LOG[:SUMMARY], os.fsdecode(b"d\xff\x1b[2J"))
    with caplog.at_level(logging.INFO):
        thread = looked(tmp_path)
    assert [one.messages for one in thread.recoveries] == [12, 2, 0, 12]
    names = {"a-20270115T080000Z.incident.mcap", "b.mcap", "b.mcap.damaged", "c.mcap.damaged", "whole.mcap"}
    assert {name for name in logs_in(tmp_path) if not name.startswith("d")} == names
    for line in ("recovered 12 messages", "recovered 2 messages", "cannot recover"):
        assert line in caplog.text
    assert list(thread.notices()) == [
        Recovered("a-20270115T080000Z.incident.mcap", 12),
        Recovered("b.mcap", 2),
        Recovered(r"d\udcff\x1b[2J.mcap", 12),
    ]
    assert list(thread.notices()) == []


def test_what_did_not_fit_is_recovered_when_there_is_room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(keeper, "_end_with", failing(errno.ENOSPC))
    part(tmp_path, LOG[:SUMMARY])
    thread = looked(tmp_path)
    for notice, tries in ((FULL, 1), (ROOM, 2)):
        thread.receive_notice(notice)
        thread.wait(30)
        assert [one.outcome for one in thread.recoveries] == [RecoveryOutcome.FAILED] * tries
    monkeypatch.undo()
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


def test_room_that_comes_during_a_look_is_not_missed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The first part has failed by then, and the second is still being read."""
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


def test_a_part_that_begins_after_the_start_is_no_leftover(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also without file locks."""
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
