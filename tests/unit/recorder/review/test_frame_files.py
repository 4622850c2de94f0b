"""Files of raw frames, as python-can's readers read them."""

import time
from datetime import datetime
from pathlib import Path

import can
import msgspec
import pytest

from recorder.review.raw_frames import FrameFile, FrameFormat, LoggedFrame
from schemas.command_line import CommandError
from schemas.messages import CanFrame

START_NS = 1_800_000_000_123_456_000
PLAIN = CanFrame(
    time_ns=START_NS,
    bus="can0",
    identifier=0x18C4D1EF,
    is_extended=True,
    is_remote=False,
    is_error=False,
    is_fd=False,
    bitrate_switch=False,
    error_state_indicator=False,
    dlc=8,
    data=bytes(range(8)),
)
CHANGES: list[dict[str, object]] = [
    {},
    {"identifier": 0x123, "is_extended": False},
    {"dlc": 0, "data": b""},
    {"bus": "can1", "dlc": 3, "data": b"\x01\x02\x03"},
    {"is_fd": True, "bitrate_switch": True, "error_state_indicator": True, "dlc": 64, "data": bytes(64)},
    {"is_fd": True, "dlc": 12, "data": bytes(12)},
    {"is_remote": True, "dlc": 4, "data": b""},
    {"identifier": 0x4, "is_extended": False, "is_error": True},
]
FRAMES = [
    LoggedFrame(
        "cruiser-1",
        number % 2 == 1,
        msgspec.structs.replace(PLAIN, time_ns=START_NS + number * 1_234_567_000, **change),
    )
    for number, change in enumerate(CHANGES)
]
READERS = {
    FrameFormat.CANDUMP: can.CanutilsLogReader,
    FrameFormat.ASC: can.ASCReader,
    FrameFormat.BLF: can.BLFReader,
}


def written(path: Path, form: FrameFormat, frames: list[LoggedFrame]) -> list[can.Message]:
    """What python-can's reader makes of the file."""
    file = FrameFile(path, form)
    for frame in frames:
        file.write(frame)
    file.close()
    how = {"relative_timestamp": False} if form is FrameFormat.ASC else {}
    with READERS[form](path, **how) as reader:
        return list(reader)


@pytest.mark.parametrize("form", FrameFormat)
def test_frames_come_back_as_they_were(tmp_path: Path, form: FrameFormat) -> None:
    """Identifier, data, kind, direction, bus and time, as far as the format says them."""
    found = written(tmp_path / f"x.{form.value}", form, FRAMES)
    assert len(found) == len(FRAMES)
    for logged, message in zip(FRAMES, found, strict=True):
        frame = logged.frame
        assert abs(message.timestamp - frame.time_ns / 1e9) < 2e-6
        assert message.is_error_frame == frame.is_error
        if frame.is_error:
            continue
        assert message.channel == (frame.bus if form is FrameFormat.CANDUMP else int(frame.bus[-1]))
        assert message.is_rx != logged.is_sent
        assert (message.arbitration_id, message.is_extended_id) == (frame.identifier, frame.is_extended)
        assert (message.is_remote_frame, message.is_fd) == (frame.is_remote, frame.is_fd)
        assert (message.bitrate_switch, message.error_state_indicator) == (
            frame.bitrate_switch,
            frame.error_state_indicator,
        )
        if frame.is_remote:
            assert message.dlc == (0 if form is FrameFormat.CANDUMP else frame.dlc)
        else:
            assert bytes(message.data) == frame.data


def test_every_bus_has_a_number_of_its_own(tmp_path: Path) -> None:
    """That of its name if it is free."""
    file = FrameFile(tmp_path / "x.blf", FrameFormat.BLF)
    for bus in ("can1", "front", "vcan1", "rear", "can300"):
        file.write(LoggedFrame("r", False, msgspec.structs.replace(PLAIN, bus=bus)))  # noqa: FBT003
    file.close()
    assert file.channels == {"can1": 1, "front": 0, "vcan1": 2, "rear": 3, "can300": 4}


def test_more_buses_than_a_format_can_tell_are_written_all_the_same(tmp_path: Path) -> None:
    """The last ones share a number."""
    frames = [
        LoggedFrame("r", False, msgspec.structs.replace(PLAIN, bus=f"bus-{number}x"))  # noqa: FBT003
        for number in range(300)
    ]
    assert len(written(tmp_path / "x.blf", FrameFormat.BLF, frames)) == 300


def test_a_name_of_a_bus_breaks_no_line(tmp_path: Path) -> None:
    """It may hold anything: a candump log has a frame a line, and words apart."""
    frames = [LoggedFrame("r", False, msgspec.structs.replace(PLAIN, bus=bus)) for bus in ("a b\n", "")]  # noqa: FBT003
    found = written(tmp_path / "x.log", FrameFormat.CANDUMP, frames)
    assert [message.channel for message in found] == ["a_b_", "can"]


@pytest.mark.parametrize("form", FrameFormat)
def test_what_is_there_is_not_overwritten(tmp_path: Path, form: FrameFormat) -> None:
    """It is refused, and stays."""
    path = tmp_path / "x"
    path.write_text("mine")
    with pytest.raises(CommandError, match="is there already"):
        FrameFile(path, form)
    assert path.read_text() == "mine"


def test_a_directory_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    """One line."""
    with pytest.raises(CommandError, match="cannot write"):
        FrameFile(tmp_path / "none" / "x", FrameFormat.ASC)


@pytest.mark.parametrize("form", FrameFormat)
def test_until_it_is_whole_a_file_has_not_its_name(tmp_path: Path, form: FrameFormat) -> None:
    """Half a file is not taken for all of a drive; of what is given up nothing stays."""
    for path in (tmp_path / "whole", tmp_path / "half"):
        file = FrameFile(path, form)
        for frame in FRAMES:
            file.write(frame)
        assert not path.exists()
        if path.name == "whole":
            file.close()
        else:
            file.discard()
    assert [path.name for path in tmp_path.iterdir()] == ["whole"]


@pytest.mark.parametrize("zone", ["UTC", "JST-9"])
def test_asc_and_blf_are_dated_by_their_frames(tmp_path: Path, zone: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not by the day of the export; in UTC wherever that is."""
    monkeypatch.setenv("TZ", zone)
    time.tzset()
    try:
        written(tmp_path / "x.asc", FrameFormat.ASC, FRAMES)
        [first, *_] = written(tmp_path / "x.blf", FrameFormat.BLF, FRAMES)
    finally:
        monkeypatch.undo()
        time.tzset()
    date = (tmp_path / "x.asc").read_text(encoding="utf-8").splitlines()[0]
    began = datetime.strptime(f"{date} +0000", "date %a %b %d %H:%M:%S.%f %Y %z")
    assert began.timestamp() == START_NS // 1_000_000_000 == int(first.timestamp)


@pytest.mark.parametrize("offset_ms", [0, 5, 50, 123, 999])
def test_times_of_an_asc_file_are_right_whenever_it_begins(tmp_path: Path, offset_ms: int) -> None:
    """python-can writes 5 ms as .5, which its reader takes for half a second."""
    time_ns = START_NS // 1_000_000_000 * 1_000_000_000 + offset_ms * 1_000_000
    frame = LoggedFrame("r", False, msgspec.structs.replace(PLAIN, time_ns=time_ns))  # noqa: FBT003
    [message] = written(tmp_path / "x.asc", FrameFormat.ASC, [frame])
    assert abs(message.timestamp - time_ns / 1e9) < 2e-6


@pytest.mark.parametrize("form", FrameFormat)
def test_a_file_that_cannot_be_named_leaves_nothing(tmp_path: Path, form: FrameFormat) -> None:
    """Somebody else has put one there meanwhile: it stays."""
    path = tmp_path / "x"
    file = FrameFile(path, form)
    file.write(FRAMES[0])
    path.write_text("mine")
    with pytest.raises(OSError, match="exist"):
        file.close()
    file.discard()
    assert [one.name for one in tmp_path.iterdir()] == ["x"]
    assert path.read_text() == "mine"
