"""``cruiser review query``."""

import re
from pathlib import Path

import pytest

from recorder.cli import query
from schemas.command_line import ExitCode
from tests.support.commands import review
from tests.support.drives import drive_log
from tests.support.logs import saved


def test_a_statement_that_is_stopped_is_interrupted(tmp_path: Path) -> None:
    """Ctrl-C, once, while it reads."""
    with pytest.raises(KeyboardInterrupt):
        review(
            "query", "SELECT count(*) FROM chassis_gear", saved(tmp_path / "1.mcap", drive_log()), is_stopped=True
        )


def test_the_statement_of_the_page_takes_what_two_recorders_have_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each log is read as it is, so without it all is there twice."""
    page = (Path(__file__).parents[4] / "docs" / "review.md").read_text("utf-8")
    (once,) = re.findall(r"`(SELECT DISTINCT ON .*?)` takes", page)
    logs = [saved(tmp_path / name, drive_log()) for name in ("1.mcap", "2.mcap")]
    counts = []
    for part in ("SELECT *", once):
        assert review("query", "--csv", f"{part} FROM chassis_gear", *logs) == ExitCode.OK
        counts.append(len(capsys.readouterr().out.splitlines()) - 1)
    assert counts == [40, 20]


def test_a_long_answer_is_cut_for_people_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It says so."""
    monkeypatch.setattr(query, "SHOWN_MAX", 3)
    log = saved(tmp_path / "1.mcap", drive_log())
    assert review("query", "SELECT sequence FROM chassis_gear", log) == ExitCode.OK
    captured = capsys.readouterr()
    assert len(captured.out.splitlines()) == 4
    assert "only the first 3 rows" in captured.err
