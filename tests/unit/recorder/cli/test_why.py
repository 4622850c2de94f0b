"""``cruiser review why``."""

import json
import random
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import pytest
from mcap.writer import Writer

from recorder.cli import why
from recorder.reading.logs import Faults, LogFile
from recorder.reading.survey import Survey, survey
from schemas.command_line import CommandError, ExitCode
from tests.support.commands import review
from tests.support.drives import drive_messages, write_messages
from tests.support.logs import small_log
from tests.support.rigs import scenarios
from tests.support.rigs.scenarios import acted, recorded


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """A log in which the front bumper is hit."""
    path = tmp_path / "log.mcap"
    path.write_bytes(recorded(scenarios.front_bumper))
    return path


def test_the_last_stop_is_explained(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One sentence first; then each link with its time, relative and absolute."""
    assert review("why", log) == ExitCode.OK
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == (
        "cruiser-1 at 2.028 s, 2023-11-14 22:13:22.040 UTC: It was being stopped: the front bumper was hit."
    )
    (cause,) = (line for line in lines if line.split()[3:4] == ["cause"])
    assert " ".join(cause.split()) == "+0.000 s 22:13:22.040 cause Stopping: the front bumper was hit."
    assert any("Frame 0x18C4D9EF Auto_MileageAndBodyFeedback" in line for line in lines)


@pytest.mark.parametrize(
    "form", ["1.9", "-2.4", "22:13:21.912", "2023-11-14T22:13:21.912Z", "2023-11-14 22:13:21.912 UTC"]
)
def test_the_moment_has_every_form_of_a_time(form: str, log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Each is the same one: driving, and soon to be stopped."""
    assert review("why", log, f"--at={form}", "--json") == ExitCode.OK
    answer = json.loads(capsys.readouterr().out)
    assert answer["since_s"] == pytest.approx(1.9, abs=0.1)
    assert answer["state"] == "engaged"
    assert "later a stop began: the front bumper was hit" in answer["headline"]


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


def test_of_several_robots_one_is_to_be_named(tmp_path: Path, log: Path) -> None:
    """The names are told."""
    (tmp_path / "other.mcap").write_bytes(acted(scenarios.deadman).log(robot="cruiser-2"))
    with pytest.raises(CommandError, match="one of cruiser-1, cruiser-2") as refused:
        review("why", log, tmp_path / "other.mcap")
    assert refused.value.code is ExitCode.USAGE
    assert review("why", log, tmp_path / "other.mcap", "--robot", "cruiser-2") == ExitCode.OK
    with pytest.raises(CommandError, match="nothing of cruiser-3"):
        review("why", log, "--robot", "cruiser-3")


def test_a_log_that_tells_nothing_of_the_arbiter_is_a_failure(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 1, and it says so."""
    path = tmp_path / "log.mcap"
    path.write_bytes(small_log())
    assert review("why", path) == ExitCode.FAILURE
    assert "Not in the log: what the arbiter did then." in capsys.readouterr().out


@pytest.mark.parametrize("at", ["100", "2027-01-01T00:00:00Z", "-100"])
def test_a_moment_that_the_log_does_not_hold_is_a_failure(
    at: str, log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Before it or behind it: exit code 1, and no reason, no stop."""
    assert review("why", log, f"--at={at}", "--json") == ExitCode.FAILURE
    answer = json.loads(capsys.readouterr().out)
    assert (answer["state"], answer["reason"], answer["stop_ns"]) == (None, "none", None)
    assert answer["headline"].startswith("The log does not hold that moment: it ")
    (only,) = answer["chain"]
    assert only["text"].startswith("not in the log: that moment: the log goes from 2023-11-14 22:13:20")


@pytest.mark.parametrize(("size", "fault"), [(8, "ends without a footer"), (100, "is cut off within a record")])
def test_a_stub_says_that_it_is_one(size: int, fault: str, log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Nothing of a robot is left of it, since it is cut off: both are said, and the exit code is 3."""
    log.write_bytes(log.read_bytes()[:size])
    with pytest.raises(CommandError, match="nothing of a robot") as refused:
        review("why", log)
    assert refused.value.code is ExitCode.PARTIAL
    assert fault in capsys.readouterr().err


def test_a_whole_log_without_a_robot_is_a_failure(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """There is nothing wrong with it, and nothing to answer."""
    with log.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        writer.finish()
    for question in ("why", "events"):
        with pytest.raises(CommandError, match="nothing of a robot") as refused:
            review(question, log)
        assert refused.value.code is ExitCode.FAILURE
        assert capsys.readouterr() == ("", "")


def test_damage_never_raises(log: Path) -> None:
    """Bytes flipped anywhere: an answer, or one clear line."""
    data = log.read_bytes()
    chance = random.Random(7)  # noqa: S311 - the same damage each time
    for _ in range(15):
        damaged = bytearray(data[: chance.randrange(len(data) // 2, len(data))])
        for _ in range(chance.randrange(4)):
            damaged[chance.randrange(8, len(damaged))] ^= 1 << chance.randrange(8)
        log.write_bytes(damaged)
        # A robot's name may be damaged, too: then there are several, which is said in one line.
        with suppress(CommandError):
            assert review("why", log) in {ExitCode.PARTIAL, ExitCode.OK, ExitCode.FAILURE}


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
