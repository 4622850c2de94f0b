"""SQL over logs and datasets."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from recorder.cli import query as command
from recorder.mcap.writer import LogChannel
from recorder.reading.logs import Faults, find_logs
from recorder.reading.rows import Selection
from recorder.review.export import ExportRange, export_dataset, objects, read_manifest
from recorder.review.query import DatasetSource, LogSource, Source, answer, one_line_errors
from schemas.command_line import CommandError, ExitCode
from tests.support.commands import review
from tests.support.drives import FRAMES, drive_log
from tests.support.logs import numbered_log, saved
from tests.unit.recorder.review.test_columns import ALL, ALL_SCHEMA, channel


def logs_in(tmp_path: Path) -> list[Path]:
    return [
        saved(tmp_path / "1.mcap", drive_log()),
        saved(tmp_path / "2.mcap", drive_log(first=20, count=10)),
        saved(tmp_path / "3.mcap", drive_log("cruiser-2", count=5)),
    ]


def over(logs: list[Path]) -> LogSource:
    faults = Faults()
    return LogSource(find_logs(logs, faults), Selection(), faults)


def exported(logs: list[Path]) -> DatasetSource:
    directory = logs[0].parent / "it's [a] set"
    export_dataset(find_logs(logs, Faults()), directory, ExportRange(), Faults())
    manifest = read_manifest(directory)
    assert manifest is not None
    return DatasetSource(directory, manifest)


BOTH = (over, exported)


@pytest.fixture(scope="module", params=BOTH)
def source(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Source:
    made: Source = request.param(logs_in(tmp_path_factory.mktemp("logs")))
    return made


def ask(source: Source, sql: str) -> list[dict[str, Any]]:
    with answer(source, sql) as rows, one_line_errors():
        return [] if rows is None else [row for batch in rows for row in objects(batch)]


@pytest.mark.parametrize(
    ("sql", "expected"),
    [
        ("SELECT count(*) AS n FROM chassis_gear", [{"n": 35}]),
        ("SELECT count(*) AS n FROM CHASSIS_GEAR WHERE alive_counter < 3", [{"n": 9}]),
        (
            "SELECT robot, count(*) AS n, max(sequence) AS m FROM chassis_gear GROUP BY ALL ORDER BY robot",
            [{"robot": "cruiser-1", "n": 30, "m": 29}, {"robot": "cruiser-2", "n": 5, "m": 4}],
        ),
        (
            "SELECT gear_position, log_time FROM chassis_gear WHERE robot = 'cruiser-2' AND sequence = 1",
            [{"gear_position": "drive", "log_time": "2027-01-15T08:00:00.010000000Z"}],
        ),
        ("SELECT count(*) AS n FROM chassis_gear a JOIN chassis_gear b USING (robot, sequence)", [{"n": 35}]),
        ("SELECT DISTINCT bus, dlc FROM can_rx", [{"bus": "can0", "dlc": 8}]),
        ("SELECT count(*) AS n FROM can_rx WHERE log_time >= '2027-01-15'", [{"n": 3 * FRAMES}]),
        ("SELECT min(key) AS key FROM raw_sample WHERE robot IS NULL", [{"key": "fleet/cruiser-1/strange"}]),
        ("SELECT versions['cruiser-gateway'] AS v FROM gateway_info LIMIT 1", [{"v": "0.1.0"}]),
        ("SELECT kind FROM safety_event WHERE kind = 'latch' LIMIT 1", [{"kind": "latch"}]),
        ("SELECT count(*) AS n FROM safety_event_log WHERE robot = 'cruiser-1'", [{"n": 2}]),
        ("SELECT max(sequence) - min(sequence) - 40 AS n FROM chassis_gear", [{"n": -11}]),
        # A robot that was never driven has decided nothing.
        ("SELECT reason, count(*) FROM safety_decision GROUP BY reason", []),
        ("SELECT count(*) AS n FROM recorder_gap JOIN state USING (robot)", [{"n": 0}]),
    ],
)
def test_subjects_are_tables(source: Source, sql: str, expected: list[dict[str, Any]]) -> None:
    assert ask(source, sql) == expected


def test_a_whole_row_is_the_same_from_both(tmp_path: Path) -> None:
    of_logs, of_dataset = (make(logs_in(tmp_path)) for make in BOTH)
    for table in of_logs.tables:
        rows = sorted(map(repr, ask(of_logs, f"FROM {table.name}")))
        assert rows
        assert rows == sorted(map(repr, ask(of_dataset, f"FROM {table.name}")))
    assert of_logs.tables == of_dataset.tables


@pytest.mark.parametrize(
    ("sql", "code", "words"),
    [
        ("SELEC 1", ExitCode.USAGE, "syntax error"),
        ("SELECT * FROM chassis_gea", ExitCode.USAGE, 'Did you mean "chassis_gear"'),
        ("SELECT gear FROM chassis_gear", ExitCode.USAGE, "gear_position"),
        ("SELECT sequence || 1 + gear_position FROM chassis_gear", ExitCode.USAGE, "No function matches"),
        ("SELECT error('oh') FROM chassis_gear", ExitCode.FAILURE, "oh"),
        ("", ExitCode.OK, ""),
    ],
)
def test_wrong_sql_is_one_line(source: Source, sql: str, code: ExitCode, words: str) -> None:
    if not words:
        assert ask(source, sql) == []
        return
    with pytest.raises(CommandError) as caught:
        ask(source, sql)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
    assert caught.value.code in {code, ExitCode.USAGE}


def test_damage_is_told_once(tmp_path: Path) -> None:
    data = drive_log(count=200)
    log = saved(tmp_path / "1.mcap", data[: len(data) - 3000])
    faults = Faults()
    source = LogSource(find_logs([log], faults), Selection(), faults)
    rows = ask(source, "SELECT count(*) AS n FROM chassis_gear a, (SELECT 1 FROM chassis_gear LIMIT 1) b")
    assert rows[0]["n"] > 100
    assert len(faults.told) == len(set(faults.told)) >= 1


def test_others_topics_are_tables_too(tmp_path: Path) -> None:
    data = ALL(f_int32=5).SerializeToString()
    logs = [
        saved(tmp_path / "1.mcap", numbered_log([channel(ALL_SCHEMA)], [[(1, data)]])),
        saved(tmp_path / "2.mcap", numbered_log([channel(b"", "s", "cdr", "ros2msg")], [[(1, b"x")]])[:-30]),
    ]
    source = over(logs)
    assert ask(source, "SELECT f_int32 FROM t") == [{"f_int32": 5}]
    assert ask(source, "SELECT data FROM t_2") == [{"data": "eA=="}]


@pytest.mark.parametrize("make", BOTH)
def test_own_subjects_have_their_names_before_others(tmp_path: Path, make: Callable[[list[Path]], Source]) -> None:
    for number, topic in enumerate(("fleet/a/chassis/gear", "/state"), 1):
        other = LogChannel(1, topic, "s", b"", "jsonschema", "json")
        saved(tmp_path / f"{number}.mcap", numbered_log([other], [[(1, b'{"x": 1}')]]))
    logs = [tmp_path / "1.mcap", tmp_path / "2.mcap", saved(tmp_path / "3.mcap", drive_log(count=3))]
    source = make(logs)
    assert ask(source, "SELECT robot, count(*) n FROM chassis_gear GROUP BY ALL") == [
        {"robot": "cruiser-1", "n": 3}
    ]
    (other_gear,) = ask(source, "SELECT robot, topic, json FROM chassis_gear_2")
    assert other_gear == {"robot": "a", "topic": "chassis/gear", "json": '{"x": 1}'}
    assert ask(source, "SELECT speed_mps FROM state") == []
    assert ask(source, "SELECT json FROM state_2") == [{"json": '{"x": 1}'}]


@pytest.mark.parametrize("make", BOTH)
def test_robots_of_one_name_are_told_apart(tmp_path: Path, make: Callable[[list[Path]], Source]) -> None:
    data = [drive_log(count=3), drive_log(count=4).replace(b"fleet/cruiser-1", b"depot/cruiser-1")]
    logs = [saved(tmp_path / f"{place}.mcap", one) for place, one in enumerate(data)]
    assert ask(make(logs), "SELECT robot, count(*) AS n FROM chassis_gear GROUP BY robot ORDER BY robot") == [
        {"robot": "depot/cruiser-1", "n": 4},
        {"robot": "fleet/cruiser-1", "n": 3},
    ]


def test_a_statement_that_would_take_days_can_be_stopped(source: Source) -> None:
    looks = iter([False, False])
    sql = "SELECT sum(a.range % c.range) FROM range(1, 1000000) a, range(1, 1000000) b, range(1, 1000000) c"

    def read() -> None:
        with answer(source, sql, lambda: next(looks, True)) as rows:
            assert rows is not None
            rows.read_all()

    with pytest.raises(KeyboardInterrupt):
        read()


@pytest.mark.parametrize(
    "sql",
    [
        "COPY (SELECT 1) TO '{}/out.csv'",
        "SELECT * FROM '{}/secret.csv'",
        "SELECT * FROM read_text('{}/secret.csv')",
        "SELECT * FROM glob('{}/*')",
        "ATTACH '{}/x.db'",
        "EXPORT DATABASE '{}/all'",
        "SET enable_external_access = true",
        "SET allowed_directories = ['/']",
        "SELECT * FROM 'https://example.com/x.parquet'",
        "INSTALL httpfs",
        "SET autoinstall_known_extensions = true",
        "SET custom_extension_repository = 'http://example.com'",
    ],
)
def test_a_statement_sees_neither_files_nor_network(source: Source, tmp_path: Path, sql: str) -> None:
    (tmp_path / "secret.csv").write_text("secret\n1\n")
    with pytest.raises(CommandError):
        ask(source, sql.format(tmp_path))
    # EXPORT leaves an empty directory.
    assert [path.name for path in tmp_path.rglob("*") if path.is_file()] == ["secret.csv"]


# The command.


def test_the_pages_statement_takes_doubles_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
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
    monkeypatch.setattr(command, "SHOWN_MAX", 3)
    log = saved(tmp_path / "1.mcap", drive_log())
    assert review("query", "SELECT sequence FROM chassis_gear", log) == ExitCode.OK
    captured = capsys.readouterr()
    assert len(captured.out.splitlines()) == 4
    assert "only the first 3 rows" in captured.err
