"""The thread that keeps the directory of logs within its limits, on a real directory."""

import errno
import hashlib
import os
import threading
from collections.abc import Collection
from contextlib import closing
from pathlib import Path

import msgspec
import pytest

from recorder.disk import keeper as disk_keeper
from recorder.disk.files import SafeLogs, UploadedLog, UploadNote
from recorder.disk.keeper import DiskKeeper, read_entries
from recorder.record.actions import Deleted, DiskRoom, Moved, Notice
from recorder.record.retention import DiskLimits, LogEntry
from tests.support.fakes.recording import failing
from tests.support.logs import logs_in
from tests.support.waiting import wait_until


def log(directory: Path, start: int, size: int = 1000, kind: str = "", suffix: str = ".mcap") -> str:
    name = f"cruiser-1-20270115T{start:06}Z{kind}{suffix}"
    (directory / name).write_bytes(bytes(size))
    return name


class Keeper(DiskKeeper):
    """A keeper without a thread: the test calls its looks."""

    def _run(self) -> None:
        """Leave it to the test."""

    def look(self) -> list[Notice]:
        self._look()
        return list(self.notices())


FULL = DiskRoom(has_room=False, has_incident_room=True)
ROOM = DiskRoom(has_room=True, has_incident_room=True)
ROLL = DiskRoom(has_room=True, has_incident_room=True, roll=True)


@pytest.mark.parametrize(
    ("name", "started", "is_incident", "is_open"),
    [
        ("cruiser-1-20270115T080000Z.mcap", "20270115T080000Z", False, False),
        ("cruiser-1-20270115T080000Z-2.mcap", "20270115T080000Z", False, False),
        ("cruiser-1-20270115T080000Z.mcap.part", "20270115T080000Z", False, True),
        ("cruiser-1-20270115T080000Z.mcap.damaged", "20270115T080000Z", False, False),
        ("cruiser-1-20270115T080000Z.mcap.rest", "20270115T080000Z", False, False),
        ("cruiser-1-20270115T080000Z.incident.mcap", "20270115T080000Z", True, False),
        ("cruiser-1-20270115T080000Z.incident-2.mcap", "20270115T080000Z", True, False),
        ("cruiser-1-20270115T080000Z.incident-2-2.mcap", "20270115T080000Z", True, False),
        ("cruiser-1-20270115T080000Z.incident.mcap.part", "20270115T080000Z", True, True),
        ("cruiser-1-20270115T080000Z.incident.mcap.damaged", "20270115T080000Z", True, False),
        ("a-20200101T000000Z-20270115T080000Z.mcap", "20270115T080000Z", False, False),
    ],
)
def test_the_names_that_a_recorder_gives_are_its_own(
    tmp_path: Path, name: str, started: str, *, is_incident: bool, is_open: bool
) -> None:
    (tmp_path / name).write_bytes(bytes(7))
    number = 2 if "-2.mcap" in name else 1
    robot = name.removesuffix(".mcap").rpartition("-")[0] if name.startswith("a-") else "cruiser-1"
    expected = LogEntry(name, 7, started, number, robot, is_incident=is_incident, is_open=is_open)
    (entry,), (own,) = read_entries(tmp_path), read_entries(tmp_path, {name})
    assert msgspec.structs.replace(entry, age_s=0.0) == expected
    assert own.is_own


@pytest.mark.parametrize(
    "name",
    [
        "notes.txt",
        "cruiser-1.mcap",
        "20270115T080000Z.mcap",
        "cruiser-1-20270115T080000Z.mcap.bak",
        "cruiser-1-20270115T080000.mcap",
        "holiday 2-20270115T080000Z.mcap",
        "cruiser-1-20270115T080000Z.mcap\n",
        os.fsdecode(b"cruiser-\xff-20270115T080000Z.mcap"),
    ],
)
def test_what_a_recorder_does_not_call_so_is_neither_counted_nor_deleted(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(bytes(5000))
    assert read_entries(tmp_path) == []
    assert Keeper(tmp_path, DiskLimits(budget_bytes=1000)).look() == []
    assert logs_in(tmp_path) == [name]


def test_the_oldest_logs_go_for_the_budget(tmp_path: Path) -> None:
    incident = log(tmp_path, 1, kind=".incident")
    part = log(tmp_path, 2, suffix=".mcap.part")
    first, second, third = (log(tmp_path, start) for start in (3, 4, 5))
    keeper = Keeper(tmp_path, DiskLimits(budget_bytes=4000))
    assert (keeper.look(), keeper.look()) == ([Deleted(first, 1000)], [])
    assert logs_in(tmp_path) == sorted([incident, part, second, third])
    assert (keeper.use.used, keeper.use.incidents) == (4000, 1000)
    assert not keeper.use.has_mark_room, "a quarter of the budget is used by incidents"
    newest = log(tmp_path, 6, 1500)
    assert keeper.look() == [Deleted(second, 1000), Deleted(third, 1000)]
    assert logs_in(tmp_path) == sorted([incident, part, newest])


def test_the_floor_is_a_tenth_of_a_small_disk_at_most(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A stick of 1 GB can be used, although the configured floor is larger."""

    class Stick:
        f_frsize, f_blocks, f_bavail = 4096, 250_000, 26_000

    monkeypatch.setattr(os, "statvfs", lambda _: Stick)
    name = log(tmp_path, 1)
    keeper = Keeper(tmp_path, DiskLimits(floor_bytes=10**12))
    for free, said in ((26_000, []), (24_999, [FULL]), (24_999, []), (26_000, [ROOM])):
        monkeypatch.setattr(Stick, "f_bavail", free)
        assert keeper.look() == said
        assert keeper.use.free == free * 4096
    assert logs_in(tmp_path) == [name], "to delete all would not be enough"
    assert keeper.use.has_mark_room


def test_what_is_being_written_is_ended_so_that_it_may_go(tmp_path: Path) -> None:
    part = log(tmp_path, 2, 500_000, suffix=".mcap.part")
    keeper = Keeper(tmp_path, DiskLimits(budget_bytes=400_000), lambda: {part})
    assert [keeper.look(), keeper.look()] == [[ROLL], [ROLL]]
    (tmp_path / part).rename(tmp_path / part.removesuffix(".part"))
    assert keeper.look() == [Deleted(part.removesuffix(".part"), 500_000), ROOM]
    assert logs_in(tmp_path) == []


def test_a_log_that_cannot_be_deleted_counts_and_others_go_in_its_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    names = [log(tmp_path, start) for start in (1, 2, 3)]
    held, unlink = {names[0]}, Path.unlink

    def refuse(path: Path) -> None:
        (failing(errno.EROFS) if path.name in held else unlink)(path)

    monkeypatch.setattr(Path, "unlink", refuse)
    keeper = Keeper(tmp_path, DiskLimits(budget_bytes=2000))
    assert [keeper.look(), keeper.look()] == [[], [Deleted(names[1], 1000)]]
    held.add(names[2])
    log(tmp_path, 4, 2000)
    held.add("cruiser-1-20270115T000004Z.mcap")
    assert [keeper.look(), keeper.look()] == [[], [FULL]]
    held.clear()
    monkeypatch.setattr(disk_keeper, "RETRY_S", 0)
    keeper._stuck = dict.fromkeys(keeper._stuck, 0.0)
    first, second, *_, last = keeper.look()
    assert (first, second, last) == (Deleted(names[0], 1000), Deleted(names[2], 1000), ROOM)
    assert [caplog.text.count(f"cannot delete {name}: Read-only") for name in names] == [1, 0, 1]


def test_a_log_that_somebody_else_deletes_is_none_of_ours(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    log(tmp_path, 1, 5000)
    monkeypatch.setattr(Path, "unlink", failing(errno.ENOENT))
    assert Keeper(tmp_path, DiskLimits(budget_bytes=1000)).look() == []
    assert "cannot delete" not in caplog.text


def test_a_directory_that_vanishes_ends_no_looking(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(disk_keeper, "LOOK_S", 0.01)
    directory = tmp_path / "logs"
    with closing(DiskKeeper(directory, DiskLimits(budget_bytes=1000))) as keeper:
        wait_until(lambda: keeper._place is None)
        directory.mkdir()
        name = log(directory, 1, 5000)
        wait_until(lambda: Deleted(name, 5000) in keeper.notices())


@pytest.mark.parametrize(
    ("is_written", "is_made_again", "is_there", "said"),
    [
        (True, False, False, [Moved, DiskRoom]),
        (True, True, False, [Moved, DiskRoom]),
        # Nothing is being written, or all of it is there already: that is no matter.
        (False, True, False, []),
        (True, True, True, []),
    ],
)
def test_that_the_directory_was_moved_is_told_and_what_is_written_in_it_ended(
    tmp_path: Path, *, is_written: bool, is_made_again: bool, is_there: bool, said: list[type[Notice]]
) -> None:
    directory = tmp_path / "logs"
    directory.mkdir()
    part = log(directory, 1, suffix=".mcap.part")
    keeper = Keeper(directory, DiskLimits(), lambda: {part} if is_written else ())
    assert keeper.look() == []
    directory.rename(tmp_path / "elsewhere")
    if is_made_again:
        directory.mkdir()
    if is_there:
        log(directory, 1, suffix=".mcap.part")
    for expected in (said, []):
        keeper._look_for_own()
        notices = list(keeper.notices())
        assert [type(one) for one in notices] == expected
        assert not expected or notices[1] == ROLL


def test_the_end_does_not_wait_for_a_disk_that_does_not_answer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked, goes_on = threading.Event(), threading.Event()

    def hang(_directory: Path, _own: Collection[str], _safe: SafeLogs) -> list[LogEntry]:
        asked.set()
        assert goes_on.wait(60)
        return []

    monkeypatch.setattr(disk_keeper, "read_entries", hang)
    monkeypatch.setattr(disk_keeper, "END_S", 0.01)
    keeper = DiskKeeper(tmp_path, DiskLimits())
    assert asked.wait(30)
    keeper.close()
    assert keeper._thread.is_alive()
    goes_on.set()
    keeper._thread.join(30)
    assert not keeper._thread.is_alive()


def mark(directory: Path, name: str, size: int, data: bytes = bytes(1000)) -> None:
    modified_ns = (directory / name).stat().st_mtime_ns
    with UploadNote(directory) as note:
        note.add(UploadedLog(name, size, modified_ns, hashlib.sha256(data).hexdigest(), "", ""))


def test_what_an_upload_has_marked_goes_first(tmp_path: Path) -> None:
    old, changed, incident = log(tmp_path, 80000), log(tmp_path, 80001), log(tmp_path, 80002, kind=".incident")
    mark(tmp_path, changed, 999)
    mark(tmp_path, incident, 1000)
    assert Keeper(tmp_path, DiskLimits(budget_bytes=2500)).look() == [Deleted(incident, 1000)]
    assert {old, changed} < set(logs_in(tmp_path))


def test_a_mark_counts_for_what_the_recorder_has_seen_itself(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """A log with other bytes stays, and the note is not trusted any more."""
    incident, old, safe = log(tmp_path, 80000, kind=".incident"), log(tmp_path, 80001), log(tmp_path, 80002)
    mark(tmp_path, incident, 1000, b"of somebody who has not read it")
    mark(tmp_path, safe, 1000)
    keeper = Keeper(tmp_path, DiskLimits(budget_bytes=2500))
    assert [keeper.look(), keeper.look()] == [[], [Deleted(old, 1000)]]
    assert {incident, safe} < set(logs_in(tmp_path))
    assert [one.message for one in caplog.records if "uploads are ignored" in one.message] == [
        f"{incident} differs from its upload: uploads are ignored until the next start"
    ]
