"""Raw frames of logs in the order of time."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from recorder.reading.logs import Faults, find_logs
from recorder.reading.rows import Selection
from recorder.review import raw_frames
from recorder.review.raw_frames import FrameFormat, LoggedFrame, read_frames, write_frames
from schemas import codec
from schemas.messages import CanFrames
from tests.support.drives import FRAMES, drive_log
from tests.support.logs import Log, saved
from tests.support.messages import MS, SECOND, WALL_NS, FakeSample, batch, feedback


def read(paths: list[Path]) -> list[LoggedFrame]:
    """All frames of files."""
    faults = Faults()
    found = list(read_frames(find_logs(paths, faults), Selection(), faults))
    assert not faults, faults.told
    return found


def both_ways(bus: str = "can0") -> bytes:
    """Batches of both directions, whose frames lie between each other's."""
    log = Log()
    for number in range(4):
        for way, shift_ns in (("rx", 0), ("tx", 3 * MS)):
            start_ns = WALL_NS + number * 50 * MS
            frames = batch(number, [(start_ns + shift_ns + one * 10 * MS, feedback(one)) for one in range(5)])
            sample = FakeSample(f"fleet/cruiser-1/can/{bus}/{way}", CAN_FRAMES, codec.encode(frames))
            log.receive(sample, wall_ns=start_ns + 60 * MS + shift_ns)
    return log.close()


CAN_FRAMES = f"application/msgpack;cruiser.CanFrames/{CanFrames.version}"


def test_frames_of_both_ways_are_in_the_order_of_their_times(tmp_path: Path) -> None:
    """Batches come one after the other; their frames were mixed on the bus."""
    found = read([saved(tmp_path / "1.mcap", both_ways())])
    times = [logged.frame.time_ns for logged in found]
    assert len(times) == 40
    assert times == sorted(times)
    assert [logged.is_sent for logged in found] == [False, True] * 20


def test_a_frame_that_two_logs_hold_is_written_once(tmp_path: Path) -> None:
    """Though in one log two frames may be the same in every bit."""
    one = saved(tmp_path / "1.mcap", drive_log())
    assert len(read([one, saved(tmp_path / "2.mcap", drive_log(first=0, count=5))])) == FRAMES
    log = Log()
    log.receive(
        FakeSample("fleet/cruiser-1/can/can0/rx", CAN_FRAMES, codec.encode(batch(0, [(WALL_NS, feedback(1))] * 2)))
    )
    twice = log.close()
    assert len(read([saved(tmp_path / "3.mcap", twice)])) == 2
    assert len(read([saved(tmp_path / "3.mcap", twice), saved(tmp_path / "4.mcap", twice)])) == 2


def test_each_robot_has_a_file(tmp_path: Path) -> None:
    """All are ended, and what was out of order is counted."""
    found = read(
        [saved(tmp_path / "1.mcap", drive_log()), saved(tmp_path / "2.mcap", drive_log("cruiser-2", first=3))]
    )
    done = write_frames([*found, found[0]], tmp_path, FrameFormat.CANDUMP)
    paths = {robot: tmp_path / f"{robot}.log" for robot in ("cruiser-1", "cruiser-2")}
    assert {one.robot: (Path(one.path), one.frames, one.late) for one in done} == {
        "cruiser-1": (paths["cruiser-1"], FRAMES + 1, 1),
        "cruiser-2": (paths["cruiser-2"], FRAMES, 0),
    }
    assert {robot: len(path.read_text().splitlines()) for robot, path in paths.items()} == {
        "cruiser-1": FRAMES + 1,
        "cruiser-2": FRAMES,
    }


def test_frames_that_break_off_leave_no_file(tmp_path: Path) -> None:
    """Neither of the robot that was being written, nor of one before."""

    def frames() -> Iterator[LoggedFrame]:
        yield from found
        raise OSError(28, "No space left on device")

    found = read([saved(tmp_path / "1.mcap", drive_log()), saved(tmp_path / "2.mcap", drive_log("cruiser-2"))])
    out = tmp_path / "out"
    out.mkdir()
    with pytest.raises(OSError, match="No space left"):
        write_frames(frames(), out, FrameFormat.CANDUMP)
    assert not list(out.iterdir())


@pytest.mark.parametrize(("name", "value"), [("HORIZON_NS", 0), ("HELD_MAX", 3)])
def test_no_more_wait_than_may(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, value: int) -> None:
    """However the times are, all frames come out."""
    monkeypatch.setattr(raw_frames, name, value)
    assert len(read([saved(tmp_path / "1.mcap", both_ways())])) == 40


def test_only_the_wanted_time_is_read(tmp_path: Path) -> None:
    """By log time, as everywhere."""
    faults = Faults()
    logs = find_logs([saved(tmp_path / "1.mcap", both_ways())], faults)
    selection = Selection(from_ns=WALL_NS + 100 * MS, to_ns=WALL_NS + SECOND)
    assert len(list(read_frames(logs, selection, faults))) == 30
