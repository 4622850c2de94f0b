"""The thread that keeps the directory of logs within its limits, on a real directory."""

import errno
import hashlib
import logging
import os
import threading
from collections.abc import Collection, Iterator
from contextlib import closing, contextmanager
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
    """A log of the recorder's; the greater its start, the younger. Returns its name."""
    name = f"cruiser-1-20270115T{start:06}Z{kind}{suffix}"
    (directory / name).write_bytes(bytes(size))
    return name


class Looks:
    """A keeper that has begun, and what it has said so far. It does not look while somebody holds ``blind``."""

    def __init__(self, keeper: DiskKeeper, looked: list[int], blind: threading.Lock) -> None:
        self.blind = blind
        self._keeper = keeper
        self._looked = looked
        self.notices: list[Notice] = []

    def has_said(self, notice: Notice) -> bool:
        """Has it said this by now?"""
        self.notices += self._keeper.notices()
        return notice in self.notices

    def look_twice(self) -> None:
        """Wait until all that is there now has been looked at."""
        count = len(self._looked)
        wait_until(lambda: len(self._looked) >= count + 2)
        self.notices += self._keeper.notices()


@contextmanager
def kept(
    directory: Path, limits: DiskLimits, monkeypatch: pytest.MonkeyPatch, own: frozenset[str] = frozenset()
) -> Iterator[Looks]:
    """A keeper that looks all the time."""
    looked: list[int] = []
    blind = threading.Lock()
    look = DiskKeeper._look

    def note(keeper: DiskKeeper) -> None:
        try:
            with blind:
                look(keeper)
        finally:
            looked.append(1)

    monkeypatch.setattr(disk_keeper, "LOOK_S", 0.01)
    monkeypatch.setattr(DiskKeeper, "_look", note)
    with closing(DiskKeeper(directory, limits, lambda: own)) as keeper:
        yield Looks(keeper, looked, blind)


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
    """Whole, being written, or recovered; what is an incident stays one whatever became of it."""
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
def test_what_a_recorder_does_not_call_so_is_neither_counted_nor_deleted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    """Whatever else is in the directory is somebody's."""
    (tmp_path / name).write_bytes(bytes(5000))
    assert read_entries(tmp_path) == []
    with kept(tmp_path, DiskLimits(budget_bytes=1000), monkeypatch) as looks:
        looks.look_twice()
    assert looks.notices == []
    assert logs_in(tmp_path) == [name]


def test_the_oldest_logs_go_for_the_budget(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As few as it takes, each is told; incidents and what is being written never go."""
    incident = log(tmp_path, 1, kind=".incident")
    part = log(tmp_path, 2, suffix=".mcap.part")
    first, second, third = (log(tmp_path, start) for start in (3, 4, 5))
    with kept(tmp_path, DiskLimits(budget_bytes=4000), monkeypatch) as looks:
        wait_until(lambda: looks.has_said(Deleted(first, 1000)))
        looks.look_twice()
        assert logs_in(tmp_path) == sorted([incident, part, second, third])
        assert (looks._keeper.use.used, looks._keeper.use.incidents) == (4000, 1000)
        assert not looks._keeper.use.has_mark_room, "a quarter of the budget is used by incidents"
        newest = log(tmp_path, 6, 1500)
        wait_until(lambda: looks.has_said(Deleted(third, 1000)))
    assert logs_in(tmp_path) == sorted([incident, part, newest])
    assert looks.notices == [Deleted(name, 1000) for name in (first, second, third)]


def test_when_nothing_may_go_it_says_so_and_when_there_is_room_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Once each: for logs and for incidents."""
    incident = log(tmp_path, 1, 5000, kind=".incident")
    with kept(tmp_path, DiskLimits(budget_bytes=4000), monkeypatch) as looks:
        wait_until(lambda: looks.has_said(DiskRoom(has_room=False, has_incident_room=False)))
        looks.look_twice()
        (tmp_path / incident).unlink()
        wait_until(lambda: looks.has_said(DiskRoom(has_room=True, has_incident_room=True)))
    assert len(looks.notices) == 2


def test_the_floor_is_a_tenth_of_a_small_disk_at_most(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A stick of 1 GB can be recorded on although the floor in force is larger than it."""

    class Stick:
        f_frsize, f_blocks, f_bavail = 4096, 250_000, 26_000

    monkeypatch.setattr(os, "statvfs", lambda _: Stick)
    name = log(tmp_path, 1)
    with kept(tmp_path, DiskLimits(floor_bytes=10**12), monkeypatch) as looks:
        looks.look_twice()
        assert looks.notices == []
        assert looks._keeper.use.has_mark_room
        assert looks._keeper.use.free == 26_000 * 4096
        monkeypatch.setattr(Stick, "f_bavail", 24_999)
        wait_until(lambda: looks.has_said(DiskRoom(has_room=False, has_incident_room=True)))
        assert logs_in(tmp_path) == [name], "to delete all would not be enough"
        monkeypatch.setattr(Stick, "f_bavail", 26_000)
        wait_until(lambda: looks.has_said(DiskRoom(has_room=True, has_incident_room=True)))


def test_what_is_being_written_is_ended_so_that_it_may_go(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is asked for again as long as that is so."""
    part = log(tmp_path, 2, 500_000, suffix=".mcap.part")
    own = frozenset({part})
    roll = DiskRoom(has_room=True, has_incident_room=True, roll=True)
    with kept(tmp_path, DiskLimits(budget_bytes=400_000), monkeypatch, own) as looks:
        wait_until(lambda: looks.has_said(roll))
        (tmp_path / part).rename(tmp_path / part.removesuffix(".part"))
        wait_until(lambda: looks.has_said(DiskRoom(has_room=True, has_incident_room=True)))
    assert looks.notices[0] == roll
    assert Deleted(part.removesuffix(".part"), 500_000) in looks.notices
    assert logs_in(tmp_path) == []


def test_a_log_that_cannot_be_deleted_counts_and_others_go_in_its_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """It is tried again later, and warned of but once."""
    stuck = log(tmp_path, 1)
    others = [log(tmp_path, start) for start in (2, 3, 4)]
    is_held = True
    tries: list[str] = []
    unlink = Path.unlink

    def refuse(path: Path) -> None:
        tries.append(path.name)
        (failing(errno.EROFS) if is_held and path.name == stuck else unlink)(path)

    monkeypatch.setattr(Path, "unlink", refuse)
    monkeypatch.setattr(disk_keeper, "RETRY_S", 0.05)
    with (
        caplog.at_level(logging.WARNING),
        kept(tmp_path, DiskLimits(budget_bytes=2000), monkeypatch) as looks,
    ):
        wait_until(lambda: looks.has_said(Deleted(others[1], 1000)))
        looks.look_twice()
        assert logs_in(tmp_path) == [stuck, others[2]]
        log(tmp_path, 5)
        wait_until(lambda: len(logs_in(tmp_path)) == 2)
        assert stuck in logs_in(tmp_path)
        is_held = False
        starts = iter(range(6, 100_000))

        def is_gone() -> bool:
            log(tmp_path, next(starts))
            return looks.has_said(Deleted(stuck, 1000))

        wait_until(is_gone)
    assert tries.count(stuck) > 1
    assert caplog.text.count("cannot delete") == 1
    assert "Read-only file system" in caplog.text


def test_when_all_are_held_recording_stops_and_goes_on_once_they_can_go(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A disk that was read-only for a while must not cost the logs that come after."""
    names = [log(tmp_path, start) for start in range(1, 5)]
    is_held = True
    unlink = Path.unlink

    def refuse(path: Path) -> None:
        (failing(errno.EROFS) if is_held else unlink)(path)

    monkeypatch.setattr(Path, "unlink", refuse)
    monkeypatch.setattr(disk_keeper, "RETRY_S", 0.5)
    with kept(tmp_path, DiskLimits(budget_bytes=2500), monkeypatch) as looks:
        wait_until(lambda: looks.has_said(DiskRoom(has_room=False, has_incident_room=True)))
        is_held = False
        wait_until(lambda: looks.has_said(DiskRoom(has_room=True, has_incident_room=True)))
        looks.look_twice()
    assert logs_in(tmp_path) == names[2:]


def test_a_log_that_somebody_else_deletes_is_none_of_ours(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Between the look and the deletion: nothing is told, and it is no fault."""
    name = log(tmp_path, 1, 5000)
    unlink = Path.unlink

    def late(path: Path) -> None:
        unlink(path)
        unlink(path)

    monkeypatch.setattr(Path, "unlink", late)
    with kept(tmp_path, DiskLimits(budget_bytes=1000), monkeypatch) as looks:
        wait_until(lambda: logs_in(tmp_path) == [])
        looks.look_twice()
        assert looks.notices == []
    assert "cannot delete" not in caplog.text
    assert not (tmp_path / name).exists()


def test_a_directory_that_vanishes_ends_no_looking(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever writes there tells of it; when it is there again, its limits hold."""
    directory = tmp_path / "logs"
    directory.mkdir()
    with kept(directory, DiskLimits(budget_bytes=1000), monkeypatch) as looks:
        looks.look_twice()
        directory.rmdir()
        looks.look_twice()
        assert looks.notices == []
        directory.mkdir()
        name = log(directory, 1, 5000)
        wait_until(lambda: looks.has_said(Deleted(name, 5000)))


@pytest.mark.parametrize("is_made_again", [False, True])
def test_that_the_directory_was_moved_is_told_and_what_is_written_in_it_ended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, is_made_again: bool
) -> None:
    """Once: what comes next is begun where it belongs. To make room in the new one nothing is asked for."""
    directory = tmp_path / "logs"
    directory.mkdir()
    part = log(directory, 1, suffix=".mcap.part")
    with kept(directory, DiskLimits(), monkeypatch, frozenset({part})) as looks:
        looks.look_twice()
        assert looks.notices == []
        directory.rename(tmp_path / "elsewhere")
        if is_made_again:
            directory.mkdir()
        wait_until(lambda: looks.has_said(DiskRoom(has_room=True, has_incident_room=True, roll=True)))
        looks.look_twice()
    assert looks.notices == [Moved(str(directory)), DiskRoom(has_room=True, has_incident_room=True, roll=True)]


def test_a_directory_that_was_moved_with_nothing_being_written_is_no_matter(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nor one in which all that is being written is there already."""
    directory = tmp_path / "logs"
    directory.mkdir()
    with kept(directory, DiskLimits(), monkeypatch) as looks:
        looks.look_twice()
        directory.rename(tmp_path / "elsewhere")
        directory.mkdir()
        looks.look_twice()
        assert looks.notices == []
    fresh = tmp_path / "fresh"
    fresh.mkdir()
    part = log(fresh, 1, suffix=".mcap.part")
    with kept(directory, DiskLimits(), monkeypatch, frozenset({part})) as looks:
        looks.look_twice()
        with looks.blind:
            directory.rename(tmp_path / "again")
            fresh.rename(directory)
        looks.look_twice()
        assert [one for one in looks.notices if isinstance(one, DiskRoom)] == []


def test_the_end_does_not_wait_for_a_disk_that_does_not_answer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A network file system may hang for ever."""
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
    """Note that a log of this length and with these bytes is safe elsewhere."""
    modified_ns = (directory / name).stat().st_mtime_ns
    with UploadNote(directory) as note:
        note.add(UploadedLog(name, size, modified_ns, hashlib.sha256(data).hexdigest(), "", ""))


def test_what_an_upload_has_marked_goes_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An incident, too; and a mark for a file that was changed since counts for nothing."""
    old, changed, incident = log(tmp_path, 80000), log(tmp_path, 80001), log(tmp_path, 80002, kind=".incident")
    mark(tmp_path, changed, 999)
    mark(tmp_path, incident, 1000)
    with kept(tmp_path, DiskLimits(budget_bytes=2500), monkeypatch) as looks:
        wait_until(lambda: looks.has_said(Deleted(incident, 1000)))
        looks.look_twice()
    assert {old, changed} < set(logs_in(tmp_path))


def test_a_mark_counts_for_what_the_recorder_has_seen_itself(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """A log of other bytes stays, whatever is said of it, and then nothing else is believed that is said."""
    incident, old, safe = log(tmp_path, 80000, kind=".incident"), log(tmp_path, 80001), log(tmp_path, 80002)
    mark(tmp_path, incident, 1000, b"of somebody who has not read it")
    mark(tmp_path, safe, 1000)
    with kept(tmp_path, DiskLimits(budget_bytes=2500), monkeypatch) as looks:
        wait_until(lambda: looks.has_said(Deleted(old, 1000)))
        looks.look_twice()
    assert {incident, safe} < set(logs_in(tmp_path))
    assert [one.message for one in caplog.records if "no upload is believed" in one.message] == [
        f"{incident} is not what an upload says of it: until the next start no upload is believed"
    ]
