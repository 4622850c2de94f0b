"""``cruiser review info``."""

import json
import os
from io import BytesIO, TextIOWrapper
from pathlib import Path

import pytest

from gateway.cli.main import main
from recorder.review.info import CATALOG_NAME
from schemas.command_line import CommandError, ExitCode
from tests.support.commands import review
from tests.support.logs import Log, foreign_log, gears, own_log, saved
from tests.support.messages import FakeSample


def test_a_whole_log_is_described(whole: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """For people, in lines; exit code 0."""
    assert review("info", str(whole)) == ExitCode.OK
    out = capsys.readouterr().out
    assert f"{whole}: whole" in out
    assert "robot cruiser-1, variant coarse" in out
    assert "fleet/cruiser-1/chassis/gear" in out
    assert "nothing was lost, as its recorder says" in out


def test_what_was_lost_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As the recorder says itself."""
    account = {"fleet/x": json.dumps({"sent": 9, "received": 5, "written": 5, "lost_link": 4})}
    path = saved(tmp_path / "a.mcap", own_log([gears(0, 2, 5)], metadata=[("cruiser.completeness", account)]))
    assert review("info", str(path)) == ExitCode.OK
    words = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["fleet/x", "9", "5", "5", "-", "0", "4", "0", "0", "0", "0"] in words


def test_json_is_an_object_a_line_and_one_for_all(
    whole: Path, cut: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """For programs."""
    assert review("info", "--json", str(whole), str(cut)) == ExitCode.PARTIAL
    first, second, together = map(json.loads, capsys.readouterr().out.splitlines())
    by_name = {Path(one["path"]).name: one for one in (first, second)}
    assert {name: one["whole"] for name, one in by_name.items()} == {"whole.mcap": True, "cut.mcap.part": False}
    assert first["messages"] == second["messages"] == 12
    assert (together["files"], together["whole"], together["messages"]) == (2, 1, 24)


def test_a_partial_log_is_shown_as_far_as_it_goes(cut: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Exit code 3, what is wrong, and how it was read."""
    assert review("info", str(cut)) == ExitCode.PARTIAL
    out = capsys.readouterr().out
    assert "NOT WHOLE" in out
    assert "read record by record" in out
    assert "fault: byte" in out
    assert "fleet/cruiser-1/chassis/gear" in out


def test_a_directory_is_shown_with_a_total(whole: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Each of its logs, then all together."""
    saved(whole.with_name("foreign.mcap"), foreign_log())
    assert review("info", str(whole.parent)) == ExitCode.OK
    out = capsys.readouterr().out
    assert "2 files, 2 of them whole" in out
    assert "22 messages" in out
    assert "1 robot: cruiser-1" in out


def test_a_directory_is_a_line_for_each_log(whole: Path, cut: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A file that is named is told in full."""
    assert review("info", str(whole.parent)) == ExitCode.PARTIAL
    first, second, *_ = sorted(capsys.readouterr().out.splitlines()[:2], reverse=True)
    assert first.startswith(f"{whole}: whole, robot cruiser-1, from 2027-01-15 08:00:00.000 UTC, ")
    assert first.endswith(", 12 messages, 0 lost")
    assert second.startswith(f"{cut}: NOT WHOLE, robot cruiser-1, ")


def test_a_directory_of_many_robots_is_told_of_some(
    tmp_path: Path, cut: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """By their names; the total is of these, and so is the exit code. Without names it shows the first of them."""
    for number in range(1, 16):
        log = Log()
        log.receive(FakeSample(f"fleet/depot-{number}/state", "x", b""))
        saved(tmp_path / f"{number}.mcap", log.close())
    saved(tmp_path / cut.name, cut.read_bytes())
    assert review("info", str(tmp_path), "--robot", "depot-1*", "--robot", "depot-2") == ExitCode.OK
    *lines, total, _, robots = capsys.readouterr().out.splitlines()
    assert len(lines) == 8
    assert total.startswith("8 files, 8 of them whole")
    assert robots == "  8 robots: depot-1, depot-2, depot-10, depot-11, depot-12, depot-13, depot-14, depot-15"
    assert review("info", str(tmp_path)) == ExitCode.PARTIAL
    assert capsys.readouterr().out.splitlines()[-1].endswith("depot-11 and 4 more")
    with pytest.raises(CommandError, match="nothing of depot-3\\?, but of cruiser-1, depot-1, ") as refused:
        review("info", str(tmp_path), "--robot", "depot-3?")
    assert refused.value.code is ExitCode.USAGE


def test_a_directory_is_told_alike_with_a_catalog_and_without_one(
    whole: Path, cut: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """For people and for programs, and with the same exit code."""
    saved(whole.with_name("foreign.mcap"), foreign_log())
    saved(whole.with_name("empty.mcap"), own_log([]))
    saved(whole.with_name("whole-1.incident.mcap"), whole.read_bytes())
    words = [
        ("info", str(whole.parent)),
        ("info", "--json", str(whole.parent)),
        ("info", str(cut), str(cut.parent)),
    ]
    before = [(review(*one), capsys.readouterr()) for one in words]
    assert review("find", "logs", str(whole.parent)) == ExitCode.PARTIAL
    capsys.readouterr()
    assert (whole.parent / CATALOG_NAME).exists()
    assert [(review(*one), capsys.readouterr()) for one in words] == before


def test_one_file_that_is_none_is_an_error(tmp_path: Path) -> None:
    """Exit code 1, one line."""
    with pytest.raises(CommandError, match="No such file") as caught:
        review("info", str(tmp_path / "none.mcap"))
    assert caught.value.code == ExitCode.FAILURE


def test_a_logs_names_do_not_reach_the_terminal_as_commands(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A key may hold anything."""
    log = Log()
    log.receive(FakeSample("k/\x1b[2J\x07", "x", b""))
    assert review("info", str(saved(tmp_path / "log.mcap", log.close()))) == ExitCode.OK
    assert "\x1b" not in capsys.readouterr().out


def test_a_log_of_absurd_times_is_described(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Times reach further than the calendar."""
    log = Log()
    log.receive(FakeSample("k", "x", b""), wall_ns=2**63 - 1)
    assert review("info", str(saved(tmp_path / "log.mcap", log.close()))) == ExitCode.OK
    assert "2262-" in capsys.readouterr().out


@pytest.mark.parametrize("option", [[], ["--json"]])
def test_a_name_that_is_no_text_is_escaped(
    tmp_path: Path, option: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    """A file system takes any bytes."""
    path = saved(tmp_path / os.fsdecode(b"\xff.mcap"), own_log([gears(0, 2, 5)]))
    assert review("info", *option, path) == ExitCode.OK
    assert r"\udcff.mcap" in capsys.readouterr().out
    assert review("check", *option, path) == ExitCode.OK


def test_a_terminal_may_lack_characters(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """They are escaped."""
    stream = BytesIO()
    monkeypatch.setattr("sys.stdout", TextIOWrapper(stream, "latin-1"))
    log = saved(
        tmp_path / "a.mcap", own_log([gears(0, 2, 5)], metadata=[("cruiser.recorder", {"name": "\u901f"})])
    )
    assert main(["review", "info", str(log.rename(tmp_path / "\u901f.mcap"))]) == ExitCode.OK
    assert rb"\u901f.mcap: whole" in stream.getvalue()
