"""``cruiser review report``."""

import json
import re
import shlex
import sys
from html import unescape
from pathlib import Path

import pytest

from recorder.review.report import account
from schemas.command_line import CommandError, ExitCode
from tests.support.commands import review
from tests.support.drives import drive_messages, drives_over, write_messages
from tests.support.rigs import scenarios
from tests.support.rigs.scenarios import recorded


@pytest.fixture(autouse=True)
def _in_a_directory_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def ask(*words: object) -> int:
    try:
        return review("report", *words)
    except CommandError as error:
        sys.stderr.write(f"cruiser: {error}\n")
        return int(error.code)


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return write_messages(tmp_path / "a.mcap", drive_messages(60))


def test_a_drive_that_is_not_drawn_has_a_command_that_draws_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(account, "DRAWN_MAX", 1)
    write_messages(tmp_path / "a b.mcap", drives_over(3, 3), robots=["r-1"])
    assert ask("a b.mcap", "--json") == ExitCode.OK
    (robot,) = json.loads(capsys.readouterr().out)["robots"]
    assert [one["stops"] for one in robot["drives"]] == [1, 1, 1]
    assert ask("a b.mcap", "-o", "r.html") == ExitCode.OK
    commands = re.findall("<code>cruiser review report (.*?)</code>", (tmp_path / "r.html").read_text())
    assert len(commands) == 2
    words = shlex.split(unescape(commands[1]))
    assert ask(*words) == ExitCode.OK
    assert ask(*words[:-2], "--json") == ExitCode.OK
    (alone,) = json.loads(capsys.readouterr().out.rpartition("written: ")[2].partition("\n")[2])["robots"]
    assert len(alone["drives"]) == 1
    assert alone["drives"][0]["start_ns"] == robot["drives"][1]["start_ns"]
    assert alone["stops"] == {"front_bumper": 1}


def test_each_stop_has_its_reason_as_why_words_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a.mcap").write_bytes(recorded(scenarios.front_bumper))
    assert ask(tmp_path / "a.mcap", "-o", "r.html") == ExitCode.OK
    html = (tmp_path / "r.html").read_text()
    capsys.readouterr()
    assert review("why", tmp_path / "a.mcap", "--json") == ExitCode.OK
    answer = json.loads(capsys.readouterr().out)
    block = html.partition('<details class="why">')[2].partition("</details>")[0]
    page_says = unescape(re.sub("<[^>]*>", " ", block))
    assert answer["headline"] in page_says
    assert len(answer["chain"]) > 5
    for link in answer["chain"]:
        assert link["text"][1:] in page_says
