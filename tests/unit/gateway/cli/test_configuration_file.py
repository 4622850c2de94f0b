from pathlib import Path

import pytest
from hypothesis import HealthCheck, given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from gateway.cli.configuration_file import load_settings
from schemas.exit_codes import CommandError, ExitCode
from schemas.settings import Settings


def _written(directory: Path, content: bytes) -> str:
    file = directory / "robot.toml"
    file.write_bytes(content)
    return str(file)


def _complaint(file: str) -> str:
    try:
        load_settings(file, {}, {})
    except CommandError as error:
        return str(error)
    return "right"


def test_no_file_is_asked_for_none_is_read() -> None:
    """Without a path and without the variable there is no file, and an empty variable names none."""
    assert load_settings(None, {}, {}) == Settings()
    assert load_settings(None, {"CRUISER_CONFIG": ""}, {}) == Settings()


def test_an_empty_path_is_told_as_one() -> None:
    """An empty flag comes from a shell variable that is not set: it names no file, and no directory either."""
    with pytest.raises(CommandError, match=r"^--config names no file: its value is empty$") as caught:
        load_settings("", {}, {})
    assert caught.value.code is ExitCode.USAGE


def test_the_path_wins_over_the_variable(tmp_path: Path) -> None:
    """The variable names the file only where no path does."""
    file = _written(tmp_path, b"[can]\nchannel = 'vcan7'\n")
    assert load_settings(None, {"CRUISER_CONFIG": file}, {}).can.channel == "vcan7"
    assert load_settings(file, {"CRUISER_CONFIG": "/nowhere"}, {}).can.channel == "vcan7"


def test_a_byte_order_mark_does_no_harm(tmp_path: Path) -> None:
    """Windows editors begin a file with a byte order mark, and end lines with CR LF."""
    file = _written(tmp_path, b"\xef\xbb\xbf[can]\r\nchannel = 'vcan7'\r\n")
    assert load_settings(file, {}, {}).can.channel == "vcan7"


@pytest.mark.parametrize("name", ["missing.toml", ".", "a\0b"])
def test_a_file_that_cannot_be_read_is_one_clear_line(tmp_path: Path, name: str) -> None:
    """A missing file, a directory and an impossible name each end in one line that names the file."""
    with pytest.raises(CommandError, match="cannot read the configuration file") as caught:
        load_settings(f"{tmp_path}/{name}", {}, {})
    assert caught.value.code is ExitCode.USAGE
    assert str(caught.value).isprintable()


def test_a_file_that_is_not_utf8_names_the_line(tmp_path: Path) -> None:
    """A byte that is not UTF-8 is reported with its line."""
    with pytest.raises(CommandError, match=r"robot\.toml:2: not UTF-8 text \(byte 0xff\)"):
        load_settings(_written(tmp_path, b"[can]\nbus = '\xff'\n"), {}, {})


# The file is written anew for each example, so sharing its directory changes nothing.
@hypothesis_settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(content=st.binary() | st.text("canbus.=[]{}'\"\\\n #1,").map(str.encode))
def test_no_bytes_do_more_than_fail_with_one_line(tmp_path: Path, content: bytes) -> None:
    """Any bytes are either a configuration or one printable line that names the file."""
    message = _complaint(_written(tmp_path, content))
    assert message.isprintable()
    assert "robot.toml" in message or message == "right"
