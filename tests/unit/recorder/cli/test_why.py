"""``cruiser review why``."""

import json
from collections.abc import Sequence
from pathlib import Path

import pytest

from recorder.cli import why
from recorder.reading.logs import Faults, LogFile
from recorder.reading.survey import Survey, survey
from schemas.command_line import ExitCode
from tests.support.commands import review
from tests.support.drives import drive_messages, write_messages
from tests.support.rigs import scenarios
from tests.support.rigs.scenarios import acted, recorded


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """A log in which the front bumper is hit."""
    path = tmp_path / "log.mcap"
    path.write_bytes(recorded(scenarios.front_bumper))
    return path


def test_json_holds_the_chain_as_data(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Each link with its step, its sentence, its times and its numbers."""
    assert review("why", log, "--json") == ExitCode.OK
    answer = json.loads(capsys.readouterr().out)
    assert (answer["robot"], answer["reason"], answer["state"]) == ("cruiser-1", "front_bumper", "stopping")
    event = next(one for one in acted(scenarios.front_bumper).events if one.reason.value == "front_bumper")
    assert answer["stop_ns"] == event.time_ns
    (shown,) = (link for link in answer["chain"] if link["step"] == "evidence")
    assert set(shown) == {"step", "text", "time_ns", "data", "time", "since_s", "from_at_s"}
    assert (shown["data"]["signal"], shown["data"]["value"]) == ("FrontBumper", 1)
    assert shown["data"]["bytes"].startswith("0139300001")


def test_of_a_robot_that_is_named_the_others_logs_are_not_opened(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """There may be hundreds of them."""
    opened: list[str] = []

    def noted(logs: Sequence[LogFile], faults: Faults) -> Survey:
        opened.extend(log.path.name for log in logs)
        return survey(logs, faults)

    monkeypatch.setattr(why, "survey", noted)
    for name in ("cruiser-1", "cruiser-2"):
        write_messages(tmp_path / f"{name}.mcap", drive_messages(20), robots=(name,))
    assert review("why", tmp_path, "--robot", "cruiser-2") == ExitCode.OK
    assert opened == ["cruiser-2.mcap"]
