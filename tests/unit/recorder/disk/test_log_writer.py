"""A log survives any fault of the disk: writer, files and recovery, on a directory that fails on demand."""

import errno
import os
import shutil
import stat
import threading
import time
from collections.abc import Callable, Iterable
from functools import partial
from io import FileIO
from pathlib import Path
from typing import Final

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from recorder.disk import files, log_writer
from recorder.disk.files import LogDirectory, PartFile
from recorder.disk.keeper import RecoveryOutcome, recover
from recorder.disk.log_writer import LogQueue, LogWriter
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
    """A file whose disk fails while ``error`` is set, and can hang."""

    error = 0
    goes_on = threading.Event()

    def write(self, data: memoryview, /) -> int:  # type: ignore[override]  # the fewer types the clearer
        assert FaultyFile.goes_on.wait(30)
        if FaultyFile.error:
            raise OSError(FaultyFile.error, os.strerror(FaultyFile.error))
        return super().write(data)


@pytest.fixture(autouse=True)
def _disk(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(files, "FileIO", FaultyFile)
    monkeypatch.setattr(log_writer, "RETRY_MIN_S", 0.01)
    monkeypatch.setattr(log_writer, "RETRY_MAX_S", 0.02)
    monkeypatch.setattr(FaultyFile, "error", 0)
    FaultyFile.goes_on.set()


@pytest.fixture
def writer(tmp_path: Path) -> LogWriter:
    return LogWriter(LogDirectory(tmp_path), "test")


def chunk(number: int, size: int = 100, at_ns: int = WALL_NS) -> WriteChunk:
    return WriteChunk("x", sealed([(1, number, at_ns, at_ns, os.urandom(size))]))


def on_log(actions: Iterable[LogAction], log: str = "x") -> list[LogAction]:
    return [msgspec.structs.replace(action, log=log) for action in actions]


def end(writer: LogWriter, *actions: LogAction) -> None:
    writer.submit(on_log([*actions, CloseLog("x")]))
    writer.close()


def is_written(writer: LogWriter) -> bool:
    return bool(writer.sizes) and not writer._queue


def file_of(writer: LogWriter) -> PartFile:
    file = writer._chains["x"].file
    assert file is not None
    return file


def is_kept(writer: LogWriter) -> bool:
    file = writer._chains["x"].file
    return file is not None and file.has_synced and file.kept_size == file.size


def sequences(path: Path) -> list[int]:
    return [sequence for _, sequence, *_ in Read(path).messages]


def names(path: Path) -> list[str]:
    found = Read(path)
    return [one.name for one in found.metadata] + [one.name for one in found.attachments]


def files_of(directory: Path) -> dict[str, list[int]]:
    for path in directory.rglob("*.part"):
        assert recover(path, "test").outcome in {RecoveryOutcome.RECOVERED, RecoveryOutcome.WHOLE}
    return {path.name: sequences(path) for path in sorted(directory.rglob("*.mcap"), key=lambda path: path.stem)}


def all_sequences(directory: Path) -> list[int]:
    return sorted(number for found in files_of(directory).values() for number in found)


SURVIVED = """
a quiet life                | begin 1 sync 2 end                                          | 1 2
a full disk                 | begin 1 written full 2 sync left well 3 end                 | 1 / 2 3
a disk that fails           | begin 1 written broken 2 sync left well 3 end               | 1 / 2 3
a bad start                 | broken begin 1 faulty well told-back end                    | 1
a read-only disk            | begin 1 written readonly 2 sync left well 3 end             | 1 / 2 3
what is taken and not kept  | begin 1 sync kept forgets 2 3 sync 4 told remembers 5 end   | 1 / 2 3 4 5
the same at the end         | begin 1 sync kept forgets 2 3 close faulty remembers closed | 1 / 2 3
a failed sync and a silence | stalls forgets begin 1 sync asked answers faulty remembers kept end | 1
a slow sync                 | stalls begin 1 sync asked 2 sync 3 sync written answers kept end | 1 2 3
no room for the end         | begin 1 written full end                                    | 1
a disk that is gone         | broken begin {} end                                         | -20
a disk that hangs           | hangs begin {} sync goes-on end                             | {}
more than can ever wait     | full begin {} faulty large 20 well end                      | {} 20 -1
a kill                      | begin 1 sync kept 2 written killed                          | 1 2
a kill in a write           | begin 1 sync kept 2 written torn                            | 1 2
a power cut                 | begin 1 sync kept 2 written cut                             | 1
a move of its directory     | begin 1 written moved 2 end                                 | 1 2
another name                | begin 1 written renamed end                                 | 1
""".replace("{}", " ".join(map(str, range(20))))
"""What happens, and the messages of each file that is left; last, how many are lost."""

SAID: Final = {
    "a quiet life": [Opened, Ended],
    "a bad start": [DiskFault, Opened, DiskBack, Ended],
    "a failed sync and a silence": [DiskBack, Ended],
}

LOGS, ELSEWHERE, LEFT = "logs", "elsewhere", "left"
"""Where a log is begun, where it may be moved, and what is left of it when its recorder is gone."""


def leave(logs: Path, writer: LogWriter, then: Callable[[Path], object] = lambda _: None) -> None:
    (left,) = logs.iterdir()
    copy = logs.with_name(LEFT) / left.name
    copy.parent.mkdir()
    shutil.copy(left, copy)
    then(copy)
    end(writer)
    shutil.rmtree(logs)


def tear(path: Path) -> None:
    with path.open("ab") as stream:
        stream.write(b"\x06\x10\x00")


def play(logs: Path, writer: LogWriter, disk: SlowDisk, steps: str) -> None:
    """Play a script: chunks by number, actions, disk states, and waits."""

    def told(*, is_faulty: bool) -> None:
        wait_until(lambda: writer.submit([SyncLog("x")]) or writer._is_faulty is is_faulty)  # type: ignore[func-returns-value]

    words: dict[str, Callable[[], object]] = {
        "begin": lambda: writer.submit(on_log(BEGIN)),
        "sync": lambda: writer.submit([SyncLog("x")]),
        "close": lambda: writer.submit([CloseLog("x")]),
        "large": lambda: writer.submit([chunk(100, 20_000)]),
        "full": lambda: setattr(FaultyFile, "error", errno.ENOSPC),
        "broken": lambda: setattr(FaultyFile, "error", errno.EIO),
        "readonly": lambda: setattr(FaultyFile, "error", errno.EROFS),
        "well": lambda: setattr(FaultyFile, "error", 0),
        "hangs": FaultyFile.goes_on.clear,
        "goes-on": FaultyFile.goes_on.set,
        "forgets": lambda: setattr(disk, "fails", True),
        "remembers": lambda: setattr(disk, "fails", False),
        "stalls": disk.goes_on.clear,
        "answers": disk.goes_on.set,
        "asked": lambda: wait_until(lambda: bool(disk.asked) and not writer._queue),
        "written": lambda: wait_until(partial(is_written, writer)),
        "kept": lambda: wait_until(partial(is_kept, writer)),
        "left": lambda: wait_until(lambda: writer.files == 1),
        "faulty": lambda: wait_until(lambda: writer._is_faulty),
        "told": lambda: told(is_faulty=True),
        "told-back": lambda: told(is_faulty=False),
        "killed": lambda: leave(logs, writer),
        "torn": lambda: leave(logs, writer, tear),
        "cut": lambda: leave(logs, writer, lambda path: os.truncate(path, file_of(writer).kept_size)),
        "moved": lambda: logs.rename(logs.with_name(ELSEWHERE)),
        "renamed": lambda: (logs / f"{STEM}.mcap.part").rename(logs / f"{STEM}.mcap"),
        "end": lambda: end(writer),
        "closed": writer.close,
    }
    for step in steps.split():
        if step.isdigit():
            writer.submit([chunk(int(step))])
        else:
            words[step]()


@pytest.mark.parametrize("row", SURVIVED.strip().splitlines(), ids=lambda row: row.partition(" |")[0].strip())
def test_a_log_survives(tmp_path: Path, disk: SlowDisk, row: str) -> None:
    """No message is lost unreported, or duplicated."""
    name, steps, left = (part.strip() for part in row.split("|"))
    logs = tmp_path / LOGS
    writer = LogWriter(LogDirectory(logs), "test", queue_bytes=15_000)
    play(logs, writer, disk, steps)
    is_here = logs.exists() and "renamed" not in steps
    assert not is_here or writer.unfinished == len(list(logs.glob("*.part")))
    assert "moved" not in steps or not [*tmp_path.rglob("*.part")], "it is ended where it is now"
    messages, _, lost = left.partition("-")
    wanted = [[int(number) for number in file.split()] for file in messages.split("/") if file.strip()]
    found = files_of(tmp_path)
    assert found == dict(zip((f"{STEM}.mcap", f"{STEM}-2.mcap"), wanted, strict=False))
    assert writer.lost == int(lost or 0)
    assert not is_here or writer.unfinished == 0
    if is_here:
        assert (writer.path or "").removesuffix(".part") == (str(logs / [*found][-1]) if found else "")
    said = SAID.get(name, [])
    assert [type(one) for one in writer.notices()][-len(said) or 10**6 :] == said


def test_the_next_file_repeats_what_lasts(tmp_path: Path, writer: LogWriter) -> None:
    end(writer, *BEGIN, chunk(1), CloseLog("x"), OpenLog("x", "x", WALL_NS), chunk(2))
    first, second = tmp_path / f"{STEM}.mcap", tmp_path / f"{STEM}-2.mcap"
    assert (sequences(first), sequences(second)) == ([1], [2])
    assert names(first) == ["cruiser", "cruiser.once", "a.dbc"]
    assert names(second) == ["cruiser", "a.dbc"]


def test_the_size_is_that_of_the_file_that_is_asked_for(writer: LogWriter) -> None:
    writer.submit(on_log([*BEGIN, chunk(1)]))
    wait_until(lambda: writer.sizes.get("x", 0) > 100)
    writer._chains["x"].submitted += 1
    assert writer.sizes == {}
    writer.close()


def test_while_the_disk_takes_nothing_memory_is_bounded_and_losses_are_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(log_writer, "NOTICES_MAX", 3)
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
    lost, *others = writer.notices()
    assert isinstance(lost, Lost)
    assert (lost.counts, lost.first_ns) == ({1: writer.lost}, WALL_NS)
    assert Ended in map(type, others)


def test_a_directory_that_vanishes_is_made_again(tmp_path: Path) -> None:
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


@pytest.mark.parametrize(("fails", "kept", "lost"), [(False, [1], 0), (True, [], 1)])
def test_a_fault_of_our_own_is_raised_where_the_loop_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, disk: SlowDisk, *, fails: bool, kept: list[int], lost: int
) -> None:
    writer = LogWriter(LogDirectory(tmp_path), "test")
    writer.submit(on_log([*BEGIN, chunk(1)]))
    wait_until(lambda: not writer._queue and writer._unkept_bytes > 100)
    disk.fails = fails
    monkeypatch.setattr(writer, "_apply", lambda _: 1 / 0)
    writer.submit(on_log([SyncLog("x")]))
    wait_until(lambda: not writer._thread.is_alive())
    for step in (partial(writer.submit, on_log([chunk(3)])), writer.close):
        with pytest.raises(ZeroDivisionError):
            step()
    assert (all_sequences(tmp_path), writer.lost) == (kept, lost)


def test_an_incident_begins_with_what_its_log_has_declared(tmp_path: Path, writer: LogWriter) -> None:
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


def test_what_may_be_written_again_is_bounded_over_all_logs(tmp_path: Path, disk: SlowDisk) -> None:
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


def test_a_file_begun_after_a_fault_is_called_by_what_is_in_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, writer: LogWriter
) -> None:
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
    """Together the syncs take far longer than the wait for a hung disk."""
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


def test_an_incident_is_called_by_what_it_is_about_after_a_fault_too(tmp_path: Path, writer: LogWriter) -> None:
    FaultyFile.error = errno.ENOSPC
    opening = OpenLog("x", "x", WALL_NS, is_incident=True)
    writer.submit(on_log([opening, BEGIN[-1], chunk(1, at_ns=WALL_NS - 30 * SECOND)], "x!"))
    wait_until(lambda: writer._is_faulty)
    FaultyFile.error = 0
    writer.submit(on_log([CloseLog("x")], "x!"))
    writer.close()
    assert logs_in(tmp_path) == [f"{STEM}.incident.mcap"]


def test_the_end_does_not_wait_for_a_disk_that_does_not_answer(
    monkeypatch: pytest.MonkeyPatch, writer: LogWriter
) -> None:
    FaultyFile.goes_on.clear()
    monkeypatch.setattr(log_writer, "END_S", 0.05)
    end(writer, *BEGIN, *(chunk(number) for number in range(20)))
    assert (writer.is_hung, writer.lost) == (True, 20)
    FaultyFile.goes_on.set()
    writer._thread.join(30)


def chunk_of(size: int) -> WriteChunk:
    return WriteChunk("x", sealed([(1, 0, WALL_NS, WALL_NS, bytes(max(0, size - 31)))]))


def queue_of(limit_bytes: int, *actions: LogAction) -> LogQueue:
    queue = LogQueue(limit_bytes)
    for action in actions:
        queue.put(action)
    return queue


def left(queue: LogQueue) -> list[LogAction]:
    return [queue.take() for _ in range(len(queue))]


def test_what_can_never_fit_goes_before_everything_else() -> None:
    small = [chunk_of(200) for _ in range(5)]
    large = chunk_of(5000)
    queue = queue_of(2000, *small[:3], large, *small[3:])
    assert queue.trim(0) == [large]
    assert left(queue) == small


def test_the_oldest_messages_go_first_and_what_is_said_of_files_last() -> None:
    """Opening, closing and lasting metadata stay."""
    opened, end, sync = OpenLog("x", "x", WALL_NS), CloseLog("x"), SyncLog("x")
    once = WriteMetadata("x", "cruiser.completeness", {"t": "1" * 500})
    lasting = WriteMetadata("x", "cruiser", {"t": "1" * 500}, lasts=True)
    attachment = WriteAttachment("x", "a.dbc", "text/plain", bytes(500), WALL_NS)
    first, second = chunk_of(300), chunk_of(300)
    actions: list[LogAction] = [opened, lasting, attachment, first, sync, second, once, end]
    queue = queue_of(3000, *actions)
    assert queue.trim(0) == []
    assert queue.trim(3000 - queue.bytes + 300) == [first]
    assert queue.trim(3000) == [sync, second, once]
    assert left(queue) == [opened, lasting, attachment, end]


@given(
    st.lists(
        st.sampled_from([SyncLog("x"), CloseLog("x"), chunk_of(50), chunk_of(400), chunk_of(3000)]), max_size=40
    ),
    st.integers(0, 3000),
)
def test_nothing_goes_without_need_and_the_order_stays(actions: list[LogAction], other_bytes: int) -> None:
    queue = queue_of(4000, *actions)
    dropped = queue.trim(other_bytes)
    bound = queue.bytes
    there = left(queue)
    assert queue.bytes == 0
    assert sorted(map(id, dropped + there)) == sorted(map(id, actions))
    assert [one for one in actions if isinstance(one, CloseLog)] == [
        one for one in there if isinstance(one, CloseLog)
    ]
    ones = [one for one in there if not isinstance(one, CloseLog)]
    assert bound <= 4000 - other_bytes or not ones
    if dropped:
        needed = bound + min(one.bytes for one in dropped[-1:])
        assert needed > 4000 - other_bytes
