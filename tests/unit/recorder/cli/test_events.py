"""``cruiser review events``."""

import json
from pathlib import Path

import pytest

from schemas.command_line import ExitCode
from tests.support.commands import review
from tests.support.rigs import scenarios
from tests.support.rigs.scenarios import acted, recorded


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """A log in which the deadman stops the robot, and then all is refused."""
    path = tmp_path / "log.mcap"
    path.write_bytes(recorded(scenarios.stale_commands))
    return path


def test_json_is_an_object_a_line(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With the documented fields."""
    assert review("events", log, "--json") == ExitCode.OK
    records = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    fields = (
        "time since_s time_ns last_ns robot kind severity source text count reason operator holder request tick "
        "is_late is_stop cause"
    )
    assert {frozenset(record) for record in records} == {frozenset(fields.split())}
    (stop,) = (record for record in records if record["kind"] == "stop")
    event = next(one for one in acted(scenarios.stale_commands).events if one.reason.value == "deadman")
    assert stop["time_ns"] == event.time_ns
    assert stop["since_s"] == pytest.approx(3.318)
    assert stop["cause"] == "no acceptable drive command came in time"
