"""``cruiser review find``."""

import json
import shlex
from pathlib import Path

import pytest

from recorder.cli import asking, catalogs
from recorder.reading.rows import Progress
from recorder.review.catalog.directory import CATALOG_NAME
from schemas.command_line import ExitCode
from tests.support.commands import review
from tests.support.drives import drive_messages, drives_over, write_messages


@pytest.fixture
def logs(tmp_path: Path) -> Path:
    directory = tmp_path / "logs"
    directory.mkdir()
    write_messages(directory / "cruiser-1-a.mcap", drive_messages(60))
    write_messages(directory / "cruiser-2-b.mcap", drives_over(3, 3), robots=("cruiser-2",))
    return directory


def test_json_is_an_object_a_line_that_says_how_to_go_on(logs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert review("find", "stops", logs, "--robot=cruiser-1", "--json") == ExitCode.OK
    (answer,) = map(json.loads, capsys.readouterr().out.splitlines())
    assert (answer["robot"], answer["kind"], answer["reason"]) == ("cruiser-1", "stop", "front_bumper")
    assert answer["file"] == f"{logs}/cruiser-1-a.mcap"
    assert review(*shlex.split(answer["why"])[2:]) == ExitCode.OK
    assert "front bumper" in capsys.readouterr().out
    assert review(*shlex.split(answer["report"])[2:]) == ExitCode.OK
    page, _, moment = answer["link"].partition("#t=")
    assert f'href="#t={moment.partition("&")[0]}' in Path(page).read_text()


def test_a_log_that_takes_too_long_is_given_up_and_keeps_no_other_out(
    logs: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    slow = (logs / "cruiser-1-a.mcap").stat().st_size
    with monkeypatch.context() as patched:
        in_time = asking.in_time

        def hurry(size: int, progress: Progress) -> Progress:
            patched.setattr(asking, "BUDGET_S", -1.0 if size == slow else 30.0)
            return in_time(size, progress)

        patched.setattr(catalogs, "in_time", hurry)
        assert review("find", "stops", logs, "--json") == ExitCode.PARTIAL
        said = capsys.readouterr()
        assert len(said.out.splitlines()) == 3
        assert "cruiser-1-a.mcap: given up after" in said.err
    for code, answers in ((ExitCode.PARTIAL, 3), (ExitCode.OK, 4)):
        assert review("find", "stops", logs, "--json") == code
        assert len(capsys.readouterr().out.splitlines()) == answers
        (logs / CATALOG_NAME).unlink()


def test_a_place_in_a_store_is_searched_as_a_directory_is(logs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert review("find", "stops", logs, "--reason=front_bumper", "--json") == ExitCode.OK
    here = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    (logs / CATALOG_NAME).unlink()
    assert review("find", "stops", f"file://{logs}", "--reason=front_bumper", "--json") == ExitCode.OK
    told = capsys.readouterr()
    there = [json.loads(line) for line in told.out.splitlines()]
    assert "2 logs of" in told.err
    assert [one["file"] for one in there] == [f"file://{one['file']}" for one in here]
    own = ("file", "link", "report", "why")
    assert [{key: one[key] for key in one if key not in own} for one in there] == [
        {key: one[key] for key in one if key not in own} for one in here
    ]
    assert review(*shlex.split(there[0]["why"])[2:]) == ExitCode.OK
    capsys.readouterr()
    assert review("find", "stops", f"file://{logs}") == ExitCode.OK
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 1 + len(here)
    assert lines[1].endswith(there[0]["file"])
