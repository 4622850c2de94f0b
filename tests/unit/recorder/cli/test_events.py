"""``cruiser review events``."""

import json
from pathlib import Path

import pytest

from schemas.command_line import CommandError, ExitCode
from tests.support.commands import review
from tests.support.logs import foreign_log, gears, own_log, saved
from tests.support.rigs import scenarios
from tests.support.rigs.scenarios import acted, recorded


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """A log in which the deadman stops the robot, and then all is refused."""
    path = tmp_path / "log.mcap"
    path.write_bytes(recorded(scenarios.stale_commands))
    return path


def test_a_table_for_people(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Time relative and absolute, severity, kind, cause, operator, and a sentence."""
    assert review("events", log) == ExitCode.OK
    lines = capsys.readouterr().out.splitlines()
    assert lines[1].split() == ["2023-11-14"]
    (stop,) = (line for line in lines if "  stop  " in line)
    assert stop.split()[:6] == ["3.318", "22:13:23.330", "cruiser-1", "warning", "stop", "deadman"]
    said = "stopping: no acceptable drive command came in time; none for 310 ms"
    assert stop.endswith(f"(operator-1)      {said}; 15 commands refused as too old, 1290 ms")
    (refused,) = (line for line in lines if "too_old" in line)
    assert "[30 times within 0.6 s]" in refused


def test_json_is_an_object_a_line(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With the documented fields."""
    assert review("events", log, "--json") == ExitCode.OK
    records = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    fields = (
        "time since_s time_ns last_ns robot kind severity source text count reason operator holder request tick "
        "is_late is_stop cause derived"
    )
    assert {frozenset(record) for record in records} == {frozenset(fields.split())}
    (stop,) = (record for record in records if record["kind"] == "stop")
    event = next(one for one in acted(scenarios.stale_commands).events if one.reason.value == "deadman")
    assert stop["time_ns"] == event.time_ns
    assert stop["since_s"] == pytest.approx(3.318)
    assert stop["cause"] == "no acceptable drive command came in time"


def test_time_and_kind_bound_what_is_told(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Each in its forms."""
    assert (
        review("events", log, "--json", "--kind", "stop", "--kind", "refusal", "--from", "3.1", "--to", "3.35")
        == 0
    )
    kinds = [json.loads(line)["kind"] for line in capsys.readouterr().out.splitlines()]
    assert kinds == ["refusal", "stop"]


def test_a_log_without_a_robot_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """An empty table would say that nothing happened; as it does where nothing of the wanted kind did."""
    path = saved(tmp_path / "foreign.mcap", foreign_log())
    for words in ((), ("--json",)):
        with pytest.raises(CommandError, match="nothing of a robot") as refused:
            review("events", path, *words)
        assert refused.value.code is ExitCode.FAILURE
        assert capsys.readouterr().out == ""
    own = saved(tmp_path / "own.mcap", own_log([gears(0, 3, 10)]))
    assert review("events", own, "--json", "--kind", "takeover") == ExitCode.OK
    assert capsys.readouterr().out == ""


def test_a_robot_that_is_not_in_the_logs_is_refused(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """An empty table would say that nothing happened; the names are told."""
    with pytest.raises(CommandError, match="nothing of cruiser-9, but of cruiser-1") as refused:
        review("events", log, "--robot", "cruiser-1", "--robot", "cruiser-9")
    assert refused.value.code is ExitCode.USAGE
    for name in ("cruiser-1", "cruiser-*", "*"):
        assert review("events", log, "--robot", name) == ExitCode.OK
        assert "deadman" in capsys.readouterr().out


def test_what_is_derived_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """In the table too."""
    path = tmp_path / "log.mcap"
    path.write_bytes(recorded(scenarios.deadman, "safety/event"))
    assert review("events", path, "--kind", "stop") == ExitCode.OK
    assert "[derived]" in capsys.readouterr().out
