"""The run loop, with a source of its own and a real directory."""

import errno
import os
from collections.abc import Callable
from io import FileIO
from pathlib import Path

import pytest

from recorder.loop import Recorded, Recorder
from recorder.ports import log_directory
from recorder.ports.log_directory import LogDirectory
from recorder.review.info import read_info
from recorder.session import KeyCount, Plan, Session
from schemas.exit_codes import CommandError
from schemas.messages import GatewayInfo, Gear, Variant
from tests.recorder.fakes import PLAN, FakeSample, FakeSource, gear, info, key_of, logs_in, sample_of

INFO_KEY = key_of(GatewayInfo)


def record(source: FakeSource, directory: Path, plan: Plan = PLAN) -> Recorded:
    """Record all that a source brings."""
    return Recorder(Session(plan), source, LogDirectory(directory), "test").run(lambda: source.is_exhausted)


def test_a_recording_ends_in_a_whole_file(tmp_path: Path) -> None:
    """All samples are in it; the result says what and where."""
    source = FakeSource(sample_of(gear(number)) for number in (0, 1, 2, 5))
    recorded = record(source, tmp_path)
    assert recorded.path is not None
    assert recorded == Recorded(
        path=str(next(tmp_path.glob("*.mcap"))),
        messages=4,
        bytes=Path(recorded.path).stat().st_size,
        channels=1,
        keys={key_of(Gear): KeyCount(messages=4, missed=2, dropped=0)},
    )
    found = read_info(Path(recorded.path))
    assert found.whole
    assert found.messages == 4


def test_without_samples_there_is_no_file(tmp_path: Path) -> None:
    """Nothing is left of a recorder that waited in vain."""
    assert record(FakeSource(), tmp_path) == Recorded(path=None, messages=0, bytes=0, channels=0, keys={})
    assert logs_in(tmp_path) == []


def test_a_robot_is_asked_and_its_answer_recorded(tmp_path: Path) -> None:
    """Even if the recording ends before the answer is there."""
    source = FakeSource([sample_of(gear(0))], {INFO_KEY: [sample_of(info())]})
    recorded = record(source, tmp_path)
    assert INFO_KEY in source.asked
    found = read_info(Path(recorded.path or ""))
    assert found.variants == {"cruiser-1": "coarse"}
    assert len(found.attachments) == 2


def test_a_robot_that_did_not_know_its_variant_is_asked_at_the_end(tmp_path: Path) -> None:
    """It may know by then, and the DBC comes with it."""
    replies = [sample_of(info(Variant.UNKNOWN, dbc="")), sample_of(info())]
    source = FakeSource((sample_of(gear(number)) for number in range(5000)), {INFO_KEY: replies})
    found = read_info(Path(record(source, tmp_path).path or ""))
    assert source.asked == [INFO_KEY, INFO_KEY]
    assert found.variants == {"cruiser-1": "coarse"}
    assert len(found.attachments) == 2


def test_what_had_come_in_when_it_was_stopped_is_recorded(tmp_path: Path) -> None:
    """A signal loses nothing that was received."""
    source = FakeSource(sample_of(gear(number)) for number in range(5000))
    recorded = Recorder(Session(PLAN), source, LogDirectory(tmp_path), "test").run(lambda: True)
    assert recorded.messages == 5000


class FailingFile(FileIO):
    """A file on a disk with so much room; what is given back by a cut can be used again."""

    room = 4000

    def write(self, data: memoryview, /) -> int:  # type: ignore[override]  # the fewer types the clearer
        taken = data[: max(0, self.room - self.tell())]
        if not taken:
            raise OSError(errno.ENOSPC, "No space left on device")
        return super().write(taken)


@pytest.mark.parametrize("room", [1200, 4000, 20_000])
def test_a_full_disk_ends_the_recording_with_one_clear_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, room: int
) -> None:
    """It names the trouble and the file, and all chunks before can be read."""
    monkeypatch.setattr(log_directory, "FileIO", FailingFile)
    monkeypatch.setattr(FailingFile, "room", room)
    source = FakeSource(sample_of(gear(number)) for number in range(100_000))
    with pytest.raises(CommandError, match=r"No space left on device; the log until then is .*\.mcap") as caught:
        record(source, tmp_path, Plan("x", 1024, 10**9, "1"))
    (left,) = tmp_path.iterdir()
    assert str(caught.value).endswith(f"; the log until then is {left}")
    found = read_info(left)
    assert found.whole == (left.suffix == ".mcap")
    assert all("footer" in fault for fault in found.faults)
    assert "\n" not in str(caught.value)


def test_where_the_end_still_fits_the_log_is_whole_and_named_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only the chunk that was too much is lost; the error names the file as it is called at last."""
    monkeypatch.setattr(log_directory, "FileIO", FailingFile)
    monkeypatch.setattr(FailingFile, "room", 8000)
    source = FakeSource([sample_of(gear(0)), FakeSample("k", "x", os.urandom(20_000))])
    with pytest.raises(CommandError) as caught:
        record(source, tmp_path, Plan("x", 1, 10**9, "1"))
    (left,) = tmp_path.iterdir()
    assert left.suffix == ".mcap"
    assert str(caught.value).endswith(f"; the log until then is {left}")
    found = read_info(left)
    assert found.whole
    assert found.messages == 1


def test_a_fault_of_our_own_leaves_a_readable_file(tmp_path: Path) -> None:
    """Whatever ends the loop, the log is closed."""

    def stopped() -> Callable[[], bool]:
        passes = iter([False, False])
        return lambda: next(passes)

    source = FakeSource(sample_of(gear(number)) for number in range(3000))
    recorder = Recorder(Session(Plan("x", 1024, 10**9, "1")), source, LogDirectory(tmp_path), "test")
    with pytest.raises(StopIteration):
        recorder.run(stopped())
    (left,) = tmp_path.iterdir()
    assert left.suffix == ".mcap"
    assert read_info(left).messages > 2900
