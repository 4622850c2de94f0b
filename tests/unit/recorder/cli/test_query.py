"""``cruiser review query``."""

import argparse
import json
import re
from pathlib import Path

import pytest

from recorder.cli import query, review
from schemas.command_line import CommandError, ExitCode
from schemas.settings import Settings
from tests.support.drives import drive_log
from tests.support.logs import saved


def run(question: str, *words: str | Path, is_stopped: bool = False) -> int:
    """The command's exit code."""
    parser = argparse.ArgumentParser()
    review.add_arguments(parser)
    return review.run(parser.parse_args([question, *map(str, words)]), Settings(), lambda: is_stopped)


def test_a_statement_that_is_stopped_is_interrupted(tmp_path: Path) -> None:
    """Ctrl-C, once, while it reads."""
    with pytest.raises(KeyboardInterrupt):
        run("query", "SELECT count(*) FROM chassis_gear", saved(tmp_path / "1.mcap", drive_log()), is_stopped=True)


@pytest.fixture(params=["log", "dataset"])
def asked(request: pytest.FixtureRequest, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Path:
    """A log, or a dataset of it."""
    log = saved(tmp_path / "1.mcap", drive_log())
    if request.param == "log":
        return log
    assert run("export", "-o", tmp_path / "out", log) == ExitCode.OK
    capsys.readouterr()
    return tmp_path / "out"


def test_people_get_a_table(asked: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With a head, aligned."""
    sql = "SELECT gear_position, count(*) AS n, max(alive_counter) / 2 AS x FROM chassis_gear GROUP BY ALL"
    assert run("query", sql, asked) == ExitCode.OK
    assert capsys.readouterr().out == "  gear_position  n   x\n  drive          20  7.5\n"


def test_options_may_stand_anywhere(asked: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Also between the statement and the log; what is no option is told."""
    sql = "SELECT count(*) AS n FROM chassis_gear"
    for words in (("--json", sql, asked), (sql, "--json", asked), (sql, asked, "--json")):
        assert run("query", *words) == ExitCode.OK
        assert capsys.readouterr().out == '{"n":20}\n'
    with pytest.raises(SystemExit):
        run("query", sql, "--nothing", asked)
    assert "unrecognized arguments: --nothing" in capsys.readouterr().err


def test_columns_of_one_name_are_kept_apart(asked: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The later ones get a number that nobody has."""
    sql = "SELECT 1 AS a, 2 AS a, 3 AS a_1, 4 AS a FROM chassis_gear LIMIT 1"
    assert run("query", "--json", sql, asked) == ExitCode.OK
    assert json.loads(capsys.readouterr().out) == {"a": 1, "a_2": 2, "a_1": 3, "a_3": 4}


def test_programs_get_json_or_csv(asked: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """An object a line; a head and lines."""
    sql = "SELECT sequence, log_time, data FROM can_rx LIMIT 2"
    assert run("query", "--json", sql, asked) == ExitCode.OK
    first, _ = map(json.loads, capsys.readouterr().out.splitlines())
    assert first == {"sequence": 0, "log_time": "2027-01-15T08:00:00.000000000Z", "data": "AQQAAAAAAAU="}
    assert run("query", "--csv", sql, asked) == ExitCode.OK
    assert capsys.readouterr().out.splitlines()[:2] == [
        '"sequence","log_time","data"',
        '0,"2027-01-15T08:00:00.000000000Z","0104000000000005"',
    ]


def test_the_statement_of_the_page_takes_what_two_recorders_have_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each log is read as it is, so without it all is there twice."""
    page = (Path(__file__).parents[4] / "docs" / "review.md").read_text("utf-8")
    (once,) = re.findall(r"`(SELECT DISTINCT ON .*?)` takes", page)
    logs = [saved(tmp_path / name, drive_log()) for name in ("1.mcap", "2.mcap")]
    counts = []
    for part in ("SELECT *", once):
        assert run("query", "--csv", f"{part} FROM chassis_gear", *logs) == ExitCode.OK
        counts.append(len(capsys.readouterr().out.splitlines()) - 1)
    assert counts == [40, 20]


def test_an_empty_answer_is_one(asked: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """For people in words, in CSV as a head alone."""
    sql = "SELECT sequence FROM chassis_gear WHERE sequence < 0"
    assert run("query", sql, asked) == ExitCode.OK
    assert capsys.readouterr().out == "  no rows\n"
    assert run("query", "--csv", sql, asked) == ExitCode.OK
    assert capsys.readouterr().out == '"sequence"\n'


def test_tables_are_listed(asked: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With their topics, columns, types and units; or as JSON."""
    assert run("query", "--tables", asked) == ExitCode.OK
    out = capsys.readouterr().out
    assert "chassis_gear: fleet/cruiser-1/chassis/gear\n" in out
    assert ["time_ns", "int64", "ns"] in [line.split() for line in out.splitlines()]
    assert run("query", "--tables", "--json", asked) == ExitCode.OK
    assert {json.loads(line)["name"] for line in capsys.readouterr().out.splitlines()} >= {"can_rx", "raw_sample"}


def test_a_long_answer_is_cut_for_people_alone(
    asked: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It says so."""
    monkeypatch.setattr(query, "SHOWN_MAX", 3)
    assert run("query", "SELECT sequence FROM chassis_gear", asked) == ExitCode.OK
    captured = capsys.readouterr()
    assert len(captured.out.splitlines()) == 4
    assert "only the first 3 rows" in captured.err


def test_a_statement_and_a_log_are_wanted(asked: Path) -> None:
    """Exit code 2."""
    with pytest.raises(CommandError, match="give a statement") as caught:
        run("query", asked)
    assert caught.value.code == ExitCode.USAGE


def test_of_a_dataset_the_statement_says_the_time(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """--from is of logs."""
    assert run("export", "-o", tmp_path / "out", saved(tmp_path / "1.mcap", drive_log())) == ExitCode.OK
    with pytest.raises(CommandError, match="WHERE log_time"):
        run("query", "--from", "1", "SELECT 1", tmp_path / "out")
    capsys.readouterr()


def test_a_damaged_log_is_partial(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What can be read is in the answer; exit code 3."""
    log = saved(tmp_path / "1.mcap", drive_log(count=200)[:-200])
    assert run("query", "SELECT count(*) AS n FROM chassis_gear", log) == ExitCode.PARTIAL
    captured = capsys.readouterr()
    assert "200" in captured.out
    assert "byte" in captured.err


def test_what_a_log_holds_does_not_rule_the_terminal(asked: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A text may hold anything; a long one is cut."""
    assert run("query", "SELECT chr(27) || '[2J' AS a, repeat('x', 99) AS b", asked) == ExitCode.OK
    out = capsys.readouterr().out
    assert "\x1b" not in out
    assert "xxx..." in out


def test_csv_does_not_rule_the_terminal_either(asked: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """In a cell or in a column's name; what no terminal obeys is as it was."""
    sql = """SELECT chr(27) || '[2J' || chr(155) || chr(13) || chr(8238) AS "a\x1b", 'Gr\u00fc\u00dfe,\n' AS b"""
    assert run("query", "--csv", sql, asked) == ExitCode.OK
    expected = '"a\\x1b","b"\n"\\x1b[2J\\x9b\\r\\u202e","Gr\u00fc\u00dfe,\n"\n'
    assert capsys.readouterr().out == expected


def test_files_are_out_of_reach_unless_they_are_allowed(asked: Path, tmp_path: Path) -> None:
    """By --allow-files."""
    sql = f"COPY (SELECT 1 AS a) TO '{tmp_path}/a.csv'"
    with pytest.raises(CommandError, match="--allow-files"):
        run("query", sql, asked)
    assert not (tmp_path / "a.csv").exists()
    assert run("query", "--allow-files", sql, asked) == ExitCode.OK
    assert (tmp_path / "a.csv").read_text().split() == ["a", "1"]


@pytest.mark.parametrize("explain", ["", "EXPLAIN ANALYZE "])
def test_a_statement_does_not_write_into_the_dataset_that_it_reads(tmp_path: Path, explain: str) -> None:
    """DuckDB lets a statement write wherever it lets it read."""
    run("export", "-o", tmp_path / "out", saved(tmp_path / "1.mcap", drive_log()))
    manifest = tmp_path / "out" / "manifest.json"
    before = manifest.read_bytes()
    with pytest.raises(CommandError, match=r"not a SELECT.*--allow-files"):
        run("query", f"{explain}COPY (SELECT 1 AS a) TO '{manifest}' (FORMAT csv)", tmp_path / "out")
    assert manifest.read_bytes() == before


def test_a_dataset_is_asked_alone(tmp_path: Path) -> None:
    """Beside logs it would be left out without a word."""
    log = saved(tmp_path / "1.mcap", drive_log())
    run("export", "-o", tmp_path / "out", log)
    with pytest.raises(CommandError, match="a dataset is asked alone") as caught:
        run("query", "SELECT 1", log, tmp_path / "out")
    assert caught.value.code is ExitCode.USAGE


def test_of_a_damaged_log_a_wrong_statement_tells_the_damage_too(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A table may be missing because of it."""
    with pytest.raises(CommandError, match="does not exist"):
        run("query", "SELECT * FROM odometry_of_others", saved(tmp_path / "1.mcap", drive_log()[:400]))
    assert "the file is cut off" in capsys.readouterr().err
