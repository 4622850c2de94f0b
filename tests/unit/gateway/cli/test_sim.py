"""The flags of ``cruiser sim`` and ``cruiser fault``."""

import pytest

from schemas.command_line import ExitCode
from tests.support.commands import in_process


@pytest.mark.parametrize(
    "flags",
    [
        ["--rate-multiplier", "1000"],
        ["--seconds", "0"],
        ["--seconds", "x"],
        ["--variant", "medium"],
        ["--slope", "-31"],
        ["--payload", "x"],
        ["--pedal-gain", "nan"],
        ["--stop-mode", "x"],
    ],
)
def test_a_flag_out_of_bounds_is_a_usage_error(flags: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    """Argparse says which."""
    with pytest.raises(SystemExit) as error:
        in_process("sim", *flags)
    assert error.value.code == ExitCode.USAGE
    assert flags[0] in capsys.readouterr().err


@pytest.mark.parametrize("command", ["sim", "fault"])
def test_the_help_shows_an_example_and_the_grammar(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Whoever asks sees every fault."""
    with pytest.raises(SystemExit) as error:
        in_process(command, "--help")
    assert error.value.code == 0
    shown = capsys.readouterr().out
    assert "example:" in shown
    assert "bumper front|rear|both on|off" in shown


def test_a_wrong_fault_is_a_usage_error_without_a_chassis(capsys: pytest.CaptureFixture[str]) -> None:
    """The words are judged before anybody is called."""
    assert in_process("fault", "--sim", "127.0.0.1:9", "bumpr") == ExitCode.USAGE
    assert capsys.readouterr().err == "cruiser fault: there is no fault 'bumpr'; did you mean 'bumper'?\n"
