"""``cruiser record backfill``, against another recorder on a real Zenoh."""

import json
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path

import pytest
from mcap.reader import make_reader

from recorder.cli import backfill
from schemas.exit_codes import CommandError, ExitCode
from schemas.recorder_settings import RecorderSettings
from schemas.settings import Settings, ZenohSettings
from tests.support.backfill_logs import (
    CAMERA,
    GEAR,
    HEALTH,
    MS,
    START_NS,
    Row,
    gear_rows,
    log_of,
    row,
    rows_in,
    write,
)
from tests.support.commands import run_command
from tests.support.fakes.peer import Peer, free_endpoint
from tests.support.fakes.recorders import BackfillHost

ROWS = sorted(
    [
        *gear_rows(300),
        *(row(number, number * 1000, HEALTH) for number in range(30)),
        *(row(0, number * 700, CAMERA, b"%d" % number, lag_ms=3) for number in range(40)),
    ]
)
CUT = START_NS + 10_000 * MS, START_NS + 18_000 * MS
OWN = [one for one in ROWS if not CUT[0] < one.publish_ns < CUT[1]]
MISSING = [one for one in ROWS if one not in OWN]


@pytest.fixture
def endpoint() -> str:
    """Where the robot's recorder listens."""
    return free_endpoint()


@pytest.fixture
def depot(tmp_path: Path) -> Path:
    """A depot's directory; its log has a hole."""
    (tmp_path / "depot").mkdir()
    write(tmp_path / "depot" / "cruiser-1.mcap", log_of(OWN))
    return tmp_path / "depot"


@pytest.fixture
def host(endpoint: str, tmp_path: Path) -> Iterator[BackfillHost]:
    """The robot's recorder, which is writing its log."""
    (tmp_path / "robot").mkdir()
    write(tmp_path / "robot" / "cruiser-1.mcap.part", log_of(ROWS, is_finished=False))
    with BackfillHost(endpoint, tmp_path / "robot") as found:
        yield found


def run(endpoint: str, *words: str, recorder: RecorderSettings | None = None) -> int:
    """The command's exit code."""
    settings = Settings(
        zenoh=ZenohSettings(connect=[endpoint]), recorder=recorder or RecorderSettings(name="depot")
    )
    return run_command(backfill, "--timeout", "20", *words, settings=settings)


def filled(directory: Path) -> list[Row]:
    """What the backfill has written."""
    (path,) = directory.glob("*.backfill.mcap")
    return rows_in(path.read_bytes())


@pytest.mark.usefixtures("host")
def test_what_is_missing_is_written_beside_the_log(
    endpoint: str, depot: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 0; each hole is told; the second time nothing is missing."""
    assert run(endpoint, str(depot)) == ExitCode.OK
    assert sorted(filled(depot)) == MISSING
    (path,) = depot.glob("*.backfill.mcap")
    assert path.name == "cruiser-1-20270115T080010Z.backfill.mcap"
    (metadata,) = make_reader(BytesIO(path.read_bytes())).iter_metadata()
    assert metadata.metadata["recorders"] == "robot"
    assert metadata.metadata["filled_messages"] == str(len(MISSING))
    assert metadata.metadata["still_missing"] == metadata.metadata["unanswered_holes"] == "0"
    out = capsys.readouterr().out
    assert (
        f"{GEAR}  2027-01-15 08:00:10.000 UTC  8.000 s  gap: 79 missing, 79 messages filled, 0 still missing"
        in out
    )
    assert f"3 holes; {len(MISSING)} messages filled, 0 samples still missing" in out
    assert str(path) in out
    assert run(endpoint, str(depot)) == ExitCode.OK
    assert "0 holes" in capsys.readouterr().out


def test_pieces_that_get_lost_are_asked_for_again(
    endpoint: str, host: BackfillHost, depot: Path, tmp_path: Path
) -> None:
    """Nothing is missing in the end, and nothing is there twice."""
    rows = [row(number, number * 10, data=bytes(2000)) for number in range(2000)]
    write(tmp_path / "robot" / "big.mcap", log_of(rows))
    (tmp_path / "other").mkdir()
    write(tmp_path / "other" / "own.mcap", log_of(rows[:10] + rows[1900:]))
    (tmp_path / "robot" / "cruiser-1.mcap.part").unlink()
    host.drops = {2, 5, 9}
    assert run(endpoint, str(tmp_path / "other")) == ExitCode.OK
    assert filled(tmp_path / "other") == rows[10:1900]
    assert len(host.requests) > 4
    assert depot.exists()


@pytest.mark.usefixtures("host")
def test_what_nobody_has_is_a_partial_success(
    endpoint: str, depot: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 3, as JSON too."""
    lacking = [one for one in ROWS if one.topic != GEAR or not 120 <= one.sequence < 130]
    write(tmp_path / "robot" / "cruiser-1.mcap.part", log_of(lacking, is_finished=False))
    assert run(endpoint, "--json", str(depot)) == ExitCode.PARTIAL
    result = json.loads(capsys.readouterr().out)
    assert result["recorders"] == ["robot"]
    assert result["filled"] == len(MISSING) - 10
    holes = {(one["topic"], one["kind"]): one for one in result["holes"]}
    gap = holes[GEAR, "sequence"]
    assert (gap["missing"], gap["filled"], gap["still_missing"], gap["is_answered"]) == (79, 69, 10, True)
    assert holes["fleet/cruiser-1/**", "silence"]["still_missing"] is None


def test_a_dry_run_asks_nobody(
    endpoint: str, host: BackfillHost, depot: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 3 if anything is known to be missing; nothing is written."""
    assert run(endpoint, "--dry-run", str(depot)) == ExitCode.PARTIAL
    assert "79 missing, 0 messages filled" in capsys.readouterr().out
    assert host.requests == []
    assert [path.name for path in depot.iterdir()] == ["cruiser-1.mcap"]
    write(depot / "cruiser-1.mcap", log_of(ROWS))
    assert run(endpoint, "--dry-run", str(depot)) == ExitCode.OK


def test_only_the_robot_that_is_named_is_filled(endpoint: str, host: BackfillHost, depot: Path) -> None:
    """Another one's holes are left."""
    assert run(endpoint, "--robot", "cruiser-2", str(depot)) == ExitCode.OK
    assert host.requests == []
    assert run(endpoint, "--robot", "cruiser-1", str(depot)) == ExitCode.OK
    assert host.requests


@pytest.mark.usefixtures("host")
def test_only_what_is_recorded_here_is_filled(endpoint: str, depot: Path) -> None:
    """By the key expressions of the recorder's settings."""
    recorder = RecorderSettings(name="depot", keys=["fleet/*/chassis/**"])
    assert run(endpoint, str(depot), recorder=recorder) == ExitCode.OK
    assert {one.topic for one in filled(depot)} == {GEAR, HEALTH}


def test_without_a_recorder_nothing_is_filled(endpoint: str, depot: Path) -> None:
    """Exit code 4, and who does not answer."""
    with pytest.raises(CommandError, match="no Zenoh node answered") as caught:
        run(endpoint, "--timeout", "0.1", str(depot))
    assert caught.value.code == ExitCode.UNREACHABLE
    with Peer(endpoint):
        with pytest.raises(CommandError, match="no recorder answers") as caught:
            run(endpoint, "--timeout", "1", str(depot))
        assert caught.value.code == ExitCode.UNREACHABLE
        with pytest.raises(CommandError, match="recorder robot does not answer"):
            run(endpoint, "--timeout", "1", "--recorder", "robot", str(depot))


def test_without_a_log_nothing_can_be_filled(endpoint: str, tmp_path: Path) -> None:
    """One line, that names it."""
    with pytest.raises(CommandError, match=r"none\.mcap: No such file"):
        run(endpoint, str(tmp_path / "none.mcap"))


def test_a_log_that_cannot_be_read_is_told(endpoint: str, depot: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Exit code 3: nobody knows what it lacks."""
    write(depot / "cruiser-1.mcap", log_of(ROWS))
    assert run(endpoint, str(depot), str(depot / "none.mcap")) == ExitCode.PARTIAL
    assert "none.mcap: No such file" in capsys.readouterr().out


def test_a_logs_names_do_not_reach_the_terminal_as_commands(
    endpoint: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A key may hold anything."""
    write(tmp_path / "a\x1b[2J.mcap", b"no log")
    assert run(endpoint, "--dry-run", str(tmp_path)) == ExitCode.PARTIAL
    assert "\x1b" not in capsys.readouterr().out
