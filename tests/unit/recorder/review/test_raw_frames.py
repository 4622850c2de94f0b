"""Raw frames of logs in the order of time, and their files as python-can's readers read them."""

import time
from collections.abc import Iterator
from pathlib import Path

import can
import pytest
from msgspec.structs import replace

from recorder.reading.logs import Faults, find_logs
from recorder.reading.rows import Selection
from recorder.review import raw_frames
from recorder.review.raw_frames import WRITERS, LoggedFrame, read_frames, write_frames
from schemas import codec
from schemas.messages import CanFrames
from tests.support.drives import FRAMES, drive_log
from tests.support.logs import Log, saved
from tests.support.messages import MS, WALL_NS, FakeSample, batch, can_frame, feedback, sample_of


def read(paths: list[Path]) -> list[LoggedFrame]:
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
    log.receive(sample_of(batch(0, [(WALL_NS, feedback(1))] * 2)))
    twice = log.close()
    assert len(read([saved(tmp_path / "3.mcap", twice)])) == 2
    assert len(read([saved(tmp_path / "3.mcap", twice), saved(tmp_path / "4.mcap", twice)])) == 2


def test_each_robot_has_a_file(tmp_path: Path) -> None:
    """All are ended, and what was out of order is counted."""
    logs = {"1.mcap": drive_log(), "2.mcap": drive_log("cruiser-2", first=3)}
    found = read([saved(tmp_path / name, data) for name, data in logs.items()])
    done = write_frames([*found, found[0]], tmp_path)
    paths = {robot: tmp_path / f"{robot}.log" for robot in ("cruiser-1", "cruiser-2")}
    assert {one.robot: (Path(one.path), one.frames, one.late) for one in done} == {
        "cruiser-1": (paths["cruiser-1"], FRAMES + 1, 1),
        "cruiser-2": (paths["cruiser-2"], FRAMES, 0),
    }
    assert {robot: len(path.read_text().splitlines()) for robot, path in paths.items()} == {
        "cruiser-1": FRAMES + 1,
        "cruiser-2": FRAMES,
    }


@pytest.mark.parametrize("form", WRITERS)
def test_frames_that_break_off_leave_no_file(tmp_path: Path, form: str) -> None:
    """Neither of the robot that was being written, nor of one before."""

    def frames() -> Iterator[LoggedFrame]:
        yield from found
        raise OSError(28, "No space left on device")

    found = read([saved(tmp_path / "1.mcap", drive_log()), saved(tmp_path / "2.mcap", drive_log("cruiser-2"))])
    out = tmp_path / "out"
    out.mkdir()
    with pytest.raises(OSError, match="No space left"):
        write_frames(frames(), out, form)
    assert not list(out.iterdir())


@pytest.mark.parametrize(("name", "value"), [("HORIZON_NS", 0), ("HELD_MAX", 3)])
def test_no_more_wait_than_may(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, value: int) -> None:
    """However the times are, all frames come out."""
    monkeypatch.setattr(raw_frames, name, value)
    assert len(read([saved(tmp_path / "1.mcap", both_ways())])) == 40


# Files.

START_NS = 1_800_000_000_123_456_000
CHANGES: list[dict[str, object]] = [
    {},
    {"identifier": 0x123, "is_extended": False},
    {"dlc": 0, "data": b""},
    {"bus": "can1", "dlc": 3, "data": b"\x01\x02\x03"},
    {"bus": "a b\n"},
    {"bus": ""},
    {"is_fd": True, "bitrate_switch": True, "error_state_indicator": True, "dlc": 64, "data": bytes(64)},
    {"is_fd": True, "dlc": 12, "data": bytes(12)},
    {"is_remote": True, "dlc": 4, "data": b""},
    {"identifier": 0x4, "is_extended": False, "is_error": True},
]
READERS = {"candump": can.CanutilsLogReader, "asc": can.ASCReader, "blf": can.BLFReader}


@pytest.mark.parametrize("form", WRITERS)
@pytest.mark.parametrize("zone", ["UTC", "JST-9"])
@pytest.mark.parametrize("offset_ms", [0, 5, 999])
def test_frames_come_back_as_they_were(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, form: str, zone: str, offset_ms: int
) -> None:
    """Identifier, data, kind, direction, bus and time, wherever it is, as far as the form says them."""
    frames = [
        replace(can_frame(time_ns=START_NS + offset_ms * MS + number * 1_234_567_000), **change)
        for number, change in enumerate(CHANGES)
    ]
    sent = [LoggedFrame("cruiser-1", number % 2 == 1, frame) for number, frame in enumerate(frames)]
    monkeypatch.setenv("TZ", zone)
    time.tzset()
    try:
        [file] = write_frames(sent, tmp_path, form)
        with READERS[form](file.path, **({"relative_timestamp": False} if form == "asc" else {})) as reader:
            found = list(reader)
    finally:
        monkeypatch.undo()
        time.tzset()
    assert len(found) == len(sent)
    for logged, message in zip(sent, found, strict=True):
        frame = logged.frame
        assert abs(message.timestamp - frame.time_ns / 1e9) < 2e-6
        assert message.is_error_frame == frame.is_error
        if frame.is_error:
            continue
        # A bus may be called anything: a candump log has a frame a line, and words apart.
        name = {"a b\n": "a_b_", "": "can"}.get(frame.bus, frame.bus)
        assert message.channel == (name if form == "candump" else int(name == "can1"))
        assert message.is_rx != logged.is_sent
        assert (message.arbitration_id, message.is_extended_id) == (frame.identifier, frame.is_extended)
        assert (message.is_remote_frame, message.is_fd) == (frame.is_remote, frame.is_fd)
        flags = frame.bitrate_switch, frame.error_state_indicator
        assert (message.bitrate_switch, message.error_state_indicator) == flags
        assert frame.is_remote or bytes(message.data) == frame.data
