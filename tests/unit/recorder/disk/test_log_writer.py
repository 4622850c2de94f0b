"""The writer's thread, on a real directory and on a disk that fails on demand."""

import errno
import os
import shutil
import stat
import threading
import time
from collections.abc import Iterable
from functools import partial
from io import FileIO
from pathlib import Path

import msgspec
import pytest

from recorder.disk import files, log_writer
from recorder.disk.files import LogDirectory
from recorder.disk.keeper import RecoveryOutcome, recover
from recorder.disk.log_writer import LogWriter
from recorder.encoding.protobuf import descriptor_set
from recorder.mcap.writer import LogChannel
from recorder.record.actions import (
    CloseLog,
    DeclareChannel,
    DiskBack,
    DiskFault,
    Ended,
    LogAction,
    Lost,
    Opened,
    OpenLog,
    SyncLog,
    WriteAttachment,
    WriteChunk,
    WriteMetadata,
)
from schemas.messages import Gear
from tests.support.fakes.recording import SlowDisk
from tests.support.logs import logs_in, sealed
from tests.support.messages import SECOND, WALL_NS
from tests.support.reading import Read
from tests.support.waiting import wait_until

STEM = "x-20270115T080000Z"
BEGIN: list[LogAction] = [
    OpenLog("x", "x", WALL_NS),
    WriteMetadata("x", "cruiser", {"robots": "cruiser-1"}, lasts=True),
    WriteMetadata("x", "cruiser.once", {}),
    WriteAttachment("x", "a.dbc", "text/plain", b"dbc", WALL_NS),
    DeclareChannel("x", LogChannel(1, "t", "cruiser.Gear", descriptor_set(Gear))),
]


class FaultyFile(FileIO):
    """A file whose disk fails while ``error`` says so, waits, and takes no more than ``room`` of all files."""

    error = 0
    written = 0
    room = 10**9
    goes_on = threading.Event()

    def write(self, data: memoryview, /) -> int:  # type: ignore[override]  # the fewer types the clearer
        assert FaultyFile.goes_on.wait(30)
        if FaultyFile.error:
            raise OSError(FaultyFile.error, os.strerror(FaultyFile.error))
        if FaultyFile.written + len(data) > FaultyFile.room:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        FaultyFile.written += len(data)
        return super().write(data)


@pytest.fixture(autouse=True)
def _disk(monkeypatch: pytest.MonkeyPatch) -> None:
    """The disk of every log here; without long pauses."""
    monkeypatch.setattr(files, "FileIO", FaultyFile)
    monkeypatch.setattr(log_writer, "RETRY_MIN_S", 0.01)
    monkeypatch.setattr(log_writer, "RETRY_MAX_S", 0.02)
    for knob, value in (("error", 0), ("written", 0), ("room", 10**9)):
        monkeypatch.setattr(FaultyFile, knob, value)
    FaultyFile.goes_on.set()


@pytest.fixture
def writer(tmp_path: Path) -> LogWriter:
    """A writer of logs in a directory of their own."""
    return LogWriter(LogDirectory(tmp_path), "test")


def chunk(number: int, size: int = 100, at_ns: int = WALL_NS) -> WriteChunk:
    """A chunk of one message."""
    return WriteChunk("x", sealed([(1, number, at_ns, at_ns, os.urandom(size))]))


def on_log(actions: Iterable[LogAction], log: str = "x") -> list[LogAction]:
    """The actions, on a log."""
    return [msgspec.structs.replace(action, log=log) for action in actions]


def end(writer: LogWriter, *actions: LogAction) -> None:
    """These actions, and the end of the log and of the writer."""
    writer.submit(on_log([*actions, CloseLog("x")]))
    writer.close()


def is_written(writer: LogWriter) -> bool:
    """Whether all that was submitted is in a file."""
    return bool(writer.sizes) and not writer._queue


def is_kept(writer: LogWriter) -> bool:
    """Whether all that is in the file of x is on the disk."""
    file = writer._chains["x"].file
    return file is not None and file.has_synced and file.kept_size == file.size


def sequences(path: Path) -> list[int]:
    """The messages of a whole file."""
    return [sequence for _, sequence, *_ in Read(path).messages]


def names(path: Path) -> list[str]:
    """The metadata and attachments of a file, by name."""
    found = Read(path)
    return [one.name for one in found.metadata] + [one.name for one in found.attachments]


def test_actions_become_a_file(tmp_path: Path, writer: LogWriter) -> None:
    """In order; the result says what was written."""
    writer.submit(on_log([*BEGIN, chunk(1), SyncLog("x")]))
    end(writer, chunk(2))
    path = tmp_path / f"{STEM}.mcap"
    assert sequences(path) == [1, 2]
    assert (writer.path, writer.files, writer.bytes, writer.lost) == (str(path), 1, path.stat().st_size, 0)


def test_the_next_file_repeats_what_lasts(tmp_path: Path, writer: LogWriter) -> None:
    """So that it can be read alone; no message is in both."""
    end(writer, *BEGIN, chunk(1), CloseLog("x"), OpenLog("x", "x", WALL_NS), chunk(2))
    first, second = tmp_path / f"{STEM}.mcap", tmp_path / f"{STEM}-2.mcap"
    assert (sequences(first), sequences(second)) == ([1], [2])
    assert names(first) == ["cruiser", "cruiser.once", "a.dbc"]
    assert names(second) == ["cruiser", "a.dbc"]


def test_the_size_is_that_of_the_file_that_is_asked_for(writer: LogWriter) -> None:
    """A file that is still waiting to be begun has none, whatever the one before came to."""
    writer.submit(on_log([*BEGIN, chunk(1)]))
    wait_until(lambda: writer.sizes.get("x", 0) > 100)
    writer._chains["x"].submitted += 1
    assert writer.sizes == {}
    writer.close()


@pytest.mark.parametrize("error", [errno.ENOSPC, errno.EIO])
def test_after_a_fault_the_log_goes_on_in_another_file(tmp_path: Path, error: int, writer: LogWriter) -> None:
    """The chunk that failed is the first of it; nothing is lost or doubled."""
    writer.submit(on_log([*BEGIN, chunk(1)]))
    wait_until(partial(is_written, writer))
    FaultyFile.error = error
    writer.submit(on_log([chunk(2), SyncLog("x")]))
    wait_until(lambda: writer.files == 1)
    FaultyFile.error = 0
    end(writer, chunk(3))
    assert writer.lost == 0
    kept = sorted(tmp_path.iterdir())
    assert [path.name for path in kept] == [f"{STEM}-2.mcap", f"{STEM}.mcap.part"]
    assert sequences(kept[0]) == [2, 3]
    assert names(kept[0]) == ["cruiser", "cruiser.continued", "a.dbc"]


def test_while_the_disk_takes_nothing_memory_is_bounded_and_losses_are_counted(tmp_path: Path) -> None:
    """The oldest go; the next file says how many there were. No files are left behind by the tries."""
    writer = LogWriter(LogDirectory(tmp_path), "test", queue_bytes=1000)
    FaultyFile.error = errno.ENOSPC
    writer.submit(on_log(BEGIN))
    wait_until(lambda: writer._is_faulty)
    for number in range(100):
        writer.submit(on_log([chunk(number), SyncLog("x")]))
        assert writer.waiting_bytes <= 1000
    wait_until(lambda: writer.lost >= 90)
    assert logs_in(tmp_path) in ([], [f"{STEM}.mcap.part"])
    FaultyFile.error = 0
    end(writer)
    kept = sequences(tmp_path / f"{STEM}.mcap")
    # One may be in hand while later ones go.
    assert kept[1:] == list(range(101 - len(kept), 100))
    assert len(kept) == 100 - writer.lost
    notices = list(writer.notices())
    assert sum(one.counts[1] for one in notices if isinstance(one, Lost)) == writer.lost
    kinds = [type(one) for one in notices if not isinstance(one, Lost)]
    assert (kinds[:2], kinds[-1]) == ([DiskFault, Opened], Ended)


def test_the_disk_is_said_to_be_back_when_it_has_kept_something(tmp_path: Path, writer: LogWriter) -> None:
    """Once: who is told of a fault is told of its end."""
    FaultyFile.error = errno.EIO
    writer.submit(on_log([*BEGIN, chunk(1)]))
    wait_until(lambda: writer._is_faulty)
    FaultyFile.error = 0
    number = 2
    while writer._is_faulty:
        writer.submit(on_log([chunk(number), SyncLog("x")]))
        number += 1
        wait_until(lambda: not writer._queue)
    end(writer)
    assert [type(one) for one in writer.notices()] == [DiskFault, Opened, DiskBack, Ended]
    assert sequences(tmp_path / f"{STEM}.mcap") == list(range(1, number))


@pytest.mark.parametrize("ends", [False, True])
def test_what_the_disk_fails_to_keep_is_written_again(
    tmp_path: Path, writer: LogWriter, disk: SlowDisk, *, ends: bool
) -> None:
    """Into the next file; the one before is cut back to what was kept. Nothing is lost or there twice."""
    writer.submit(on_log([*BEGIN, chunk(1), SyncLog("x")]))
    wait_until(partial(is_kept, writer))
    disk.fails = True
    writer.submit(on_log([chunk(2), chunk(3), *([CloseLog("x")] if ends else [SyncLog("x"), chunk(4)])]))

    def is_told() -> bool:
        writer.submit(on_log([] if ends else [SyncLog("x")]))
        return writer._is_faulty

    wait_until(is_told)
    disk.fails = False
    if ends:
        writer.close()
    else:
        end(writer, chunk(5))
    assert all_sequences(tmp_path) == list(range(1, 4 if ends else 6))
    assert writer.lost == 0


def test_several_logs_are_written_at_once(tmp_path: Path, writer: LogWriter) -> None:
    """Each into files of its own, with its own prologue; an incident is called one."""
    writer.submit(on_log([*BEGIN, chunk(1)]))
    writer.submit(on_log([OpenLog("y", "y", WALL_NS, is_incident=True), *BEGIN[1:], chunk(2)], "y!"))
    writer.submit(on_log([chunk(3)]))
    writer.submit(on_log([chunk(4), CloseLog("x")], "y!"))
    end(writer)
    incident = tmp_path / "y-20270115T080000Z.incident.mcap"
    assert (sequences(tmp_path / f"{STEM}.mcap"), sequences(incident)) == ([1, 3], [2, 4])
    assert writer.path == str(tmp_path / f"{STEM}.mcap")
    assert list(writer.notices()) == [
        Opened("x", f"{STEM}.mcap"),
        Opened("y!", incident.name),
        Ended("y!", incident.name, incident.stat().st_size),
        Ended("x", f"{STEM}.mcap", (tmp_path / f"{STEM}.mcap").stat().st_size),
    ]


def test_a_directory_that_vanishes_is_made_again(tmp_path: Path) -> None:
    """The log goes on in another file, and what was not yet on the disk is the first of it."""
    directory = tmp_path / "logs"
    writer = LogWriter(LogDirectory(directory), "test")
    writer.submit(on_log([*BEGIN, chunk(1), SyncLog("x")]))
    wait_until(partial(is_written, writer))
    shutil.rmtree(directory)
    number = 2
    while not directory.exists():
        writer.submit(on_log([chunk(number), SyncLog("x")]))
        wait_until(lambda: not writer._queue)
        number += 1
    end(writer, chunk(number))
    found = sequences(next(directory.glob("*.mcap")))
    assert found == list(range(writer.lost + 1, number + 1))


@pytest.mark.parametrize("is_incident", [False, True])
def test_what_is_removed_with_a_log_is_lost(tmp_path: Path, writer: LogWriter, *, is_incident: bool) -> None:
    """It is told; of an incident it does not count, for the log may have it."""
    begin = [OpenLog("x", "x", WALL_NS, is_incident=is_incident), *BEGIN[1:]]
    writer.submit(on_log([*begin, chunk(1), chunk(2), SyncLog("x")]))

    wait_until(partial(is_kept, writer))
    (part,) = tmp_path.iterdir()
    part.unlink()
    end(writer, chunk(3))
    (left,) = tmp_path.iterdir()
    assert sequences(left) == [3]
    assert writer.lost == (0 if is_incident else 2)
    first, last = chunk(1).chunk, chunk(2).chunk
    lost = Lost("x", {1: 2}, first.start_ns, last.end_ns, part.name.removesuffix(".part"))
    assert [notice for notice in writer.notices() if isinstance(notice, Lost)] == [lost]


def test_the_end_does_not_wait_for_a_disk_that_takes_nothing(tmp_path: Path, writer: LogWriter) -> None:
    """What waits is lost, and counted."""
    FaultyFile.error = errno.EIO
    end(writer, *BEGIN, *(chunk(number) for number in range(20)))
    assert (writer.lost, writer.files, writer.path) == (20, 0, None)
    assert logs_in(tmp_path) == []


def test_who_submits_never_waits_for_the_disk(tmp_path: Path, writer: LogWriter) -> None:
    """Neither for a sync nor for a write."""
    FaultyFile.goes_on.clear()
    for number in range(50):
        writer.submit(on_log([*(BEGIN if not number else []), chunk(number), SyncLog("x")]))
    assert not FaultyFile.goes_on.is_set()
    FaultyFile.goes_on.set()
    end(writer)
    assert sequences(tmp_path / f"{STEM}.mcap") == list(range(50))


def test_a_fault_of_our_own_is_raised_where_the_loop_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, writer: LogWriter
) -> None:
    """A thread that dies in silence would be a recorder that records nothing; the file is ended."""
    writer.submit(on_log([*BEGIN, chunk(1)]))
    wait_until(lambda: not writer._queue)
    monkeypatch.setattr(writer, "_apply", lambda _: 1 / 0)
    writer.submit(on_log([chunk(2)]))
    wait_until(lambda: not writer._thread.is_alive())
    with pytest.raises(ZeroDivisionError):
        writer.submit(on_log([chunk(3)]))
    with pytest.raises(ZeroDivisionError):
        writer.close()
    assert sequences(tmp_path / f"{STEM}.mcap") == [1]


def test_of_an_incident_whose_file_waits_too_the_loss_is_no_logs(tmp_path: Path) -> None:
    """The log itself has what the incident lacks: it is not counted as lost."""
    writer = LogWriter(LogDirectory(tmp_path), "test", queue_bytes=1000)
    FaultyFile.error = errno.ENOSPC
    writer.submit(on_log([*BEGIN, chunk(0)]))
    wait_until(lambda: writer._is_faulty)
    opening = OpenLog("x", "x", WALL_NS, is_incident=True)
    writer.submit(on_log([opening, *BEGIN[1:], *(chunk(number) for number in range(1, 100))], "x!"))
    FaultyFile.error = 0
    writer.submit(on_log([CloseLog("x")], "x!"))
    end(writer)
    lost = [one for one in writer.notices() if isinstance(one, Lost)]
    assert {one.log for one in lost} <= {"x"}
    assert writer.lost == sum(one.counts[1] for one in lost) <= 1
    assert sequences(tmp_path / f"{STEM}.incident.mcap")[-1] == 99


def test_the_newest_log_is_told_and_no_incident(tmp_path: Path, writer: LogWriter) -> None:
    """Not even the second incident of one second."""
    writer.submit(on_log([*BEGIN, chunk(1), CloseLog("x")]))
    for number in (2, 3):
        opening = OpenLog("x", "x", WALL_NS, is_incident=True)
        writer.submit(on_log([opening, *BEGIN[1:], chunk(number), CloseLog("x")], "x!"))
    writer.close()
    assert logs_in(tmp_path) == [f"{STEM}.incident-2.mcap", f"{STEM}.incident.mcap", f"{STEM}.mcap"]
    assert (writer.path, writer.files) == (str(tmp_path / f"{STEM}.mcap"), 3)


def test_a_chunk_larger_than_the_queue_costs_no_others(tmp_path: Path) -> None:
    """While the disk takes nothing, what can never wait goes, and not for it all that can."""
    writer = LogWriter(LogDirectory(tmp_path), "test", queue_bytes=10_000)
    FaultyFile.error = errno.ENOSPC
    writer.submit(on_log([*BEGIN, *(chunk(number) for number in range(10))]))
    wait_until(lambda: writer._is_faulty)
    writer.submit(on_log([chunk(10, 20_000), chunk(11)]))
    FaultyFile.error = 0
    end(writer)
    assert writer.lost == 1
    assert sequences(tmp_path / f"{STEM}.mcap") == [*range(10), 11]


def test_a_file_that_takes_no_channel_is_neither_left_nor_told(tmp_path: Path, writer: LogWriter) -> None:
    """The header fits and what follows does not: who waits for an ended file does not wait for that one."""
    writer.submit(on_log([*BEGIN, chunk(1)]))
    wait_until(partial(is_written, writer))
    FaultyFile.room = FaultyFile.written + 500
    writer.submit(on_log([chunk(2, 5000)]))
    wait_until(lambda: writer._pause_s > log_writer.RETRY_MIN_S)
    FaultyFile.room = 10**9
    end(writer)
    told = [one for one in writer.notices() if isinstance(one, Opened | Ended)]
    assert {one.file for one in told} == {name.removesuffix(".part") for name in logs_in(tmp_path)}
    assert [type(one) for one in told] == [Opened, Ended] * (len(told) // 2)


def test_an_incident_begins_with_what_its_log_has_declared(tmp_path: Path, writer: LogWriter) -> None:
    """Whether a file of the log is open or not; and with nothing of the incident before it."""
    writer.submit(on_log(BEGIN[1:], "y"))
    for number in range(2):
        about = WriteMetadata("x", f"incident {number}", {}, lasts=True)
        opening = OpenLog("y!", "y", WALL_NS, is_incident=True)
        writer.submit(on_log([opening, about, chunk(number), CloseLog("x")], "y!"))
    writer.close()
    first, second = tmp_path / "y-20270115T080000Z.incident.mcap", tmp_path / "y-20270115T080000Z.incident-2.mcap"
    assert names(first) == ["cruiser", "incident 0", "a.dbc"]
    assert names(second) == ["cruiser", "incident 1", "a.dbc"]
    assert (sequences(first), sequences(second)) == ([0], [1])


def all_sequences(directory: Path) -> list[int]:
    """The messages of all files, those that are parts made whole."""
    for path in directory.glob("*.part"):
        assert recover(path, "test").outcome in {RecoveryOutcome.RECOVERED, RecoveryOutcome.WHOLE}
    return sorted(number for path in directory.glob("*.mcap") for number in sequences(path))


def test_a_disk_that_hangs_and_then_fails_loses_nothing_untold(tmp_path: Path, disk: SlowDisk) -> None:
    """What it has taken and may not keep is held; when that is too much no more is written, and waits."""
    writer = LogWriter(LogDirectory(tmp_path), "test", queue_bytes=20_000)
    writer.submit(on_log([*BEGIN, chunk(0), SyncLog("x")]))
    wait_until(lambda: writer._chains["x"].file is not None and writer._chains["x"].file.kept_size > 0)
    disk.goes_on.clear()
    for number in range(1, 100):
        writer.submit(on_log([chunk(number, 1000), SyncLog("x")]))
        assert writer.waiting_bytes + writer._unkept_bytes <= 20_000 + 2000
    wait_until(lambda: writer._unkept_bytes >= 10_000)
    disk.fails = True
    disk.goes_on.set()
    wait_until(lambda: writer._is_faulty)
    disk.fails = False
    end(writer, chunk(100))
    found = all_sequences(tmp_path)
    assert found == sorted(set(found)), "nothing is there twice"
    assert len(found) == 101 - writer.lost
    assert 0 < writer.lost < 95
    assert sum(one.counts[1] for one in writer.notices() if isinstance(one, Lost)) == writer.lost


def test_what_may_be_written_again_is_bounded_over_all_logs(tmp_path: Path, disk: SlowDisk) -> None:
    """However many there are. When the disk gets on, so do they, though nobody asks it to keep anything."""
    disk.goes_on.clear()
    writer = LogWriter(LogDirectory(tmp_path), "test", queue_bytes=40_000)
    for log in range(30):
        writer.submit(on_log([OpenLog(f"x{log}", f"x{log}", WALL_NS), BEGIN[-1], chunk(log, 1000)], f"x{log}"))
    wait_until(lambda: bool(disk.asked))
    assert 20_000 <= writer._unkept_bytes < 20_000 + 1500
    disk.goes_on.set()
    wait_until(lambda: not writer._queue)
    for log in range(30):
        writer.submit(on_log([CloseLog("x")], f"x{log}"))
    writer.close()
    assert (writer.lost, writer._unkept_bytes) == (0, 0)
    assert all_sequences(tmp_path) == list(range(30))


def test_a_sync_that_fails_before_a_silence_is_seen(tmp_path: Path, writer: LogWriter, disk: SlowDisk) -> None:
    """What it did not keep is written again, and kept, though nothing more comes."""
    disk.goes_on.clear()
    disk.fails = True
    writer.submit(on_log([*BEGIN, chunk(1), SyncLog("x")]))
    wait_until(lambda: bool(disk.asked) and not writer._queue)
    disk.goes_on.set()
    wait_until(lambda: writer._is_faulty)
    disk.fails = False
    wait_until(partial(is_kept, writer))
    end(writer)
    assert [type(one) for one in writer.notices()][-2:] == [DiskBack, Ended]
    assert all_sequences(tmp_path) == [1]


def test_a_file_begun_after_a_fault_is_called_by_what_is_in_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, writer: LogWriter
) -> None:
    """Its first message, and not the beginning of the file before; so many faults use up no names."""
    monkeypatch.setattr(files, "NAMESAKES_MAX", 2)
    writer.submit(on_log(BEGIN))
    for number in range(5):
        writer.submit(on_log([chunk(1000 * number, at_ns=WALL_NS + (2 * number + 1) * SECOND)]))
        wait_until(lambda: not writer._queue and bool(writer.sizes))
        FaultyFile.error = errno.ENOSPC
        writer.submit(on_log([chunk(1000 * number + 1, at_ns=WALL_NS + (2 * number + 2) * SECOND)]))
        wait_until(lambda: not writer.sizes)
        FaultyFile.error = 0
        wait_until(lambda: bool(writer.sizes))
    end(writer)
    assert all_sequences(tmp_path) == sorted(1000 * number + one for number in range(5) for one in range(2))
    assert logs_in(tmp_path) == [f"x-20270115T0800{second:02}Z.mcap" for second in (0, 2, 4, 6, 8, 10)]


def test_the_end_waits_for_a_slow_disk_that_gets_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, writer: LogWriter
) -> None:
    """Each sync takes its time, and all of them far more than what the end waits for one that does nothing."""
    for log in range(60):
        writer.submit(on_log([OpenLog(f"x{log}", f"x{log}", WALL_NS), BEGIN[-1], chunk(log)], f"x{log}"))
    wait_until(lambda: not writer._queue)
    fsync = os.fsync

    def slow(descriptor: int) -> None:
        time.sleep(0.05)
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", slow)
    monkeypatch.setattr(log_writer, "END_S", 1.0)
    for log in range(60):
        writer.submit(on_log([chunk(100 + log), CloseLog("x")], f"x{log}"))
    writer.close()
    assert (writer.is_hung, writer.lost, writer.files) == (False, 0, 60)
    assert all_sequences(tmp_path) == [*range(60), *range(100, 160)]


def test_at_the_end_all_is_written_before_files_are_ended_several_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, writer: LogWriter
) -> None:
    """A disk takes several syncs in about the time of one; what is written by then a kill does not take."""
    FaultyFile.goes_on.clear()
    for log in range(4):
        opening = OpenLog("x", f"x{log}", WALL_NS)
        writer.submit(on_log([opening, BEGIN[-1], chunk(log), CloseLog("x")], f"x{log}"))
    together = threading.Barrier(4, timeout=30)
    waited: list[int] = []
    fsync = os.fsync

    def sync(descriptor: int) -> None:
        if stat.S_ISREG(os.fstat(descriptor).st_mode):
            waited.append(len(writer._queue))
            together.wait()
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", sync)
    with writer._changed:
        writer._is_closing = True
    FaultyFile.goes_on.set()
    writer.close()
    assert waited == [0] * 4
    assert all_sequences(tmp_path) == [0, 1, 2, 3]


def test_at_the_end_what_the_disk_fails_to_keep_is_written_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, writer: LogWriter, disk: SlowDisk
) -> None:
    """Of each log, and of the file before the last one too."""
    fails = iter([True] * 3)
    write_end = files.PartFile._sync_all

    def sync_all(file: files.PartFile) -> None:
        disk.fails = next(fails, False)
        write_end(file)

    monkeypatch.setattr(files.PartFile, "_sync_all", sync_all)
    with writer._changed:
        writer._is_closing = True
        for log in range(3):
            opening = OpenLog(f"x{log}", f"x{log}", WALL_NS)
            writer.submit(on_log([opening, BEGIN[-1], chunk(10 * log), CloseLog("x")], f"x{log}"))
            writer.submit(on_log([opening, chunk(10 * log + 1), CloseLog("x")], f"x{log}"))
    writer.close()
    assert not writer.is_hung
    assert all_sequences(tmp_path) == [0, 1, 10, 11, 20, 21]
    assert writer.lost == 0


def test_however_much_is_lost_none_of_it_is_forgotten(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Who asks seldom what became of the files is told all the same: once for each log."""
    monkeypatch.setattr(log_writer, "NOTICES_MAX", 3)
    writer = LogWriter(LogDirectory(tmp_path), "test", queue_bytes=1000)
    FaultyFile.error = errno.ENOSPC
    writer.submit(on_log(BEGIN))
    wait_until(lambda: writer._is_faulty)
    for number in range(100):
        writer.submit(on_log([chunk(number)]))
    (lost,) = [one for one in writer.notices() if isinstance(one, Lost)]
    assert lost.counts == {1: writer.lost}
    assert lost.first_ns == WALL_NS
    assert writer.lost > 80
    writer.close()


def test_what_a_fault_of_our_own_leaves_unkept_is_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, writer: LogWriter, disk: SlowDisk
) -> None:
    """The disk fails as well: nobody writes it again any more."""
    writer.submit(on_log([*BEGIN, chunk(1), chunk(2)]))
    wait_until(lambda: not writer._queue and writer._unkept_bytes > 200)
    disk.fails = True
    monkeypatch.setattr(writer, "_apply", lambda _: 1 / 0)
    writer.submit(on_log([SyncLog("x")]))
    with pytest.raises(ZeroDivisionError):
        writer.close()
    assert (writer.lost, logs_in(tmp_path)) == (2, [])


def test_an_incident_is_called_by_what_it_is_about_after_a_fault_too(tmp_path: Path, writer: LogWriter) -> None:
    """Its first messages came long before."""
    FaultyFile.error = errno.ENOSPC
    opening = OpenLog("x", "x", WALL_NS, is_incident=True)
    writer.submit(on_log([opening, BEGIN[-1], chunk(1, at_ns=WALL_NS - 30 * SECOND)], "x!"))
    wait_until(lambda: writer._is_faulty)
    FaultyFile.error = 0
    writer.submit(on_log([CloseLog("x")], "x!"))
    writer.close()
    assert logs_in(tmp_path) == [f"{STEM}.incident.mcap"]


def test_a_file_that_could_not_be_made_whole_is_counted_until_it_is(tmp_path: Path, writer: LogWriter) -> None:
    """Without room for its end it is a part, which somebody may recover later."""
    writer.submit(on_log([*BEGIN, chunk(1)]))
    wait_until(partial(is_written, writer))
    FaultyFile.error = errno.ENOSPC
    end(writer)
    assert writer.unfinished == 1
    assert all_sequences(tmp_path) == [1]
    assert writer.unfinished == 0


def test_the_end_does_not_wait_for_a_disk_that_does_not_answer(
    monkeypatch: pytest.MonkeyPatch, writer: LogWriter
) -> None:
    """It says so, and what still waits is counted as lost: silence must not look like success."""
    FaultyFile.goes_on.clear()
    monkeypatch.setattr(log_writer, "END_S", 0.05)
    end(writer, *BEGIN, *(chunk(number) for number in range(20)))
    assert (writer.is_hung, writer.lost) == (True, 20)
    FaultyFile.goes_on.set()
    writer._thread.join(30)
