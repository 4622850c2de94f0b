"""The words of ``cruiser drive``, and of the other commands of an operator."""

import pytest

from gateway.cli import drive
from gateway.cli.verbs import PARK
from schemas.command_line import CommandError, ExitCode
from tests.support.commands import parsed, run_command


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (("--speed", "0.2", "--deadman", "1.5"), "longer than a deadman may be, 1 s"),
        (("--speed", "9"), "9 m/s is more than the chassis can do, 2.222 m/s"),
        (("--speed", "-2.3"), "-2.3 m/s is more than the chassis can do, 2.222 m/s"),
        (("--speed", "1", "--angle", "30"), "30 deg is more than the chassis can do, 24 deg"),
    ],
)
def test_what_cannot_be_asked_of_the_chassis_is_a_usage_error(
    words: tuple[str, ...], why: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Told before anything is asked of the robot."""
    with pytest.raises(SystemExit) as caught:
        parsed(drive, "cruiser-1", "--seconds", "1", *words)
    assert caught.value.code == ExitCode.USAGE
    assert why in capsys.readouterr().err


@pytest.mark.parametrize("words", [["--seconds", "1"], ["--speed", "1"], []])
def test_drive_without_a_terminal_wants_speed_and_seconds(words: list[str]) -> None:
    """It is a usage error before anything is connected."""
    with pytest.raises(CommandError) as caught:
        run_command(drive, "cruiser-1", *words)
    assert caught.value.code is ExitCode.USAGE


@pytest.mark.parametrize(
    "words",
    [
        ["Cruiser"],
        ["*"],
        ["cruiser-1", "--operator", "a/b"],
        ["cruiser-1", "--lease", "-1"],
        ["a", "--lease", "x"],
    ],
)
def test_what_cannot_be_a_name_or_a_lease_is_a_usage_error(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    """The parser says so."""
    with pytest.raises(SystemExit) as caught:
        parsed(PARK, *words)
    assert caught.value.code == ExitCode.USAGE
    assert "error: argument" in capsys.readouterr().err
