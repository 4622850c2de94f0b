"""``cruiser review check``."""

import json
from pathlib import Path

import pytest
from msgspec.structs import replace

from schemas.command_line import ExitCode
from tests.support.commands import review
from tests.support.logs import GEAR_CHANNEL, foreign_log, gear_message, gears, own_log, saved


def test_a_sound_log_is_no_finding(whole: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Exit code 0; and the frames that were counted."""
    assert review("check", str(whole)) == ExitCode.OK
    out = capsys.readouterr().out
    assert "file: no fault found" in out
    assert "data: no loss detected" in out
    assert "Auto_GearFeedBack" in out


def test_findings_are_told_by_what_they_are_about(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Exit code 1."""
    data = own_log([gears(0, 3, 10), gears(5, 3, 100)])
    assert review("check", str(saved(tmp_path / "a.mcap", data[:-20]))) == ExitCode.FAILURE
    out = capsys.readouterr().out
    about_file, about_data = out.split("  data:")
    assert "the file is cut off within a record (1, first at byte" in about_file
    assert "fleet/cruiser-1/chassis/gear: samples missed, by the sequence (2, first at 1970-" in about_data


def test_what_is_missing_everywhere_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A stall of the link is found on every topic; three are named, and how many more there are."""
    channels = [replace(GEAR_CHANNEL, channel_id=one, topic=f"fleet/r-{one}/chassis/gear") for one in range(1, 8)]
    data = own_log(
        [[gear_message(sequence, at_ns, one) for one in range(1, 8)] for sequence, at_ns in ((0, 10), (5, 100))],
        channels,
    )
    assert review("check", str(saved(tmp_path / "a.mcap", data))) == ExitCode.FAILURE
    (line,) = (one for one in capsys.readouterr().out.splitlines() if "samples missed" in one)
    assert line.strip().startswith("samples missed, by the sequence (28, first at 1970-")
    names = ", ".join(f"fleet/r-{one}/chassis/gear" for one in (1, 2, 3))
    assert line.endswith(f": {names} and 4 more")


def test_json_is_an_object_a_line(whole: Path, cut: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """For programs."""
    assert review("check", "--json", str(whole), str(cut)) == ExitCode.FAILURE
    *files, together = map(json.loads, capsys.readouterr().out.splitlines())
    found = {Path(one["path"]).name: one for one in files}
    assert together == {"between": []}
    assert found["whole.mcap"]["findings"] == []
    assert {one["about"] for one in found["cut.mcap.part"]["findings"]} == {"file"}
    assert found["cut.mcap.part"]["messages"] == 12


def test_what_cannot_be_judged_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It is no finding."""
    data = foreign_log(encoding="cdr", schema=("p/msg/T", "ros2msg", b"int8 x"))
    assert review("check", str(saved(tmp_path / "a.mcap", data))) == ExitCode.OK
    assert "not read: messages of 1 channels" in capsys.readouterr().out


@pytest.mark.parametrize("is_cut", [False, True])
def test_where_no_message_can_be_read_nothing_is_claimed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], *, is_cut: bool
) -> None:
    """Of a file that is cut off in its only chunk, or has a bit flipped there."""
    data = bytearray(own_log([gears(0, 3, 10)]))
    at = data.index(b"\x28\xb5\x2f\xfd") + 20  # within the chunk: how a frame of zstd begins
    data[at] ^= 1
    log = saved(tmp_path / "a.mcap", bytes(data[:at] if is_cut else data))
    assert review("check", str(log)) == ExitCode.FAILURE
    out = capsys.readouterr().out
    assert ": 0 messages" in out
    assert "data: unknown, no message could be read" in out
    assert "no loss" not in out


def test_what_is_in_none_of_several_logs_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It is no finding about any of them: nobody recorded then, or another recorder did."""
    saved(tmp_path / "r-1.mcap", own_log([gears(0, 3, 10)]))
    saved(tmp_path / "r-2.mcap", own_log([gears(7, 3, 1_000_000_010)]))
    assert review("check", str(tmp_path)) == ExitCode.OK
    *_, head, line = capsys.readouterr().out.splitlines()
    assert head == "between the logs:"
    assert line.startswith("  fleet/cruiser-1: 4 samples of 1 keys between 1970-01-01")
    assert line.endswith("(r-1.mcap, then r-2.mcap)")


def test_incidents_are_checked_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Though all of them is in the logs."""
    for name in ("r-1.mcap", "r-2.incident.mcap"):
        saved(tmp_path / name, own_log([gears(0, 3, 10)]))
    assert review("check", str(tmp_path)) == ExitCode.OK
    assert "r-2.incident.mcap" in capsys.readouterr().out
