import argparse
import os
import pkgutil
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from gateway.cli import configuration_file
from gateway.cli.configuration_file import OWN_FILES, load_settings, settings_file, unread_file
from gateway.cli.main import COMMANDS
from schemas.command_line import CommandError, ExitCode
from schemas.settings import AuthoritySettings, Settings


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


def test_the_path_wins_over_the_variable(tmp_path: Path) -> None:
    # As editors on Windows write it.
    file = _written(tmp_path, b"\xef\xbb\xbf[can]\r\nchannel = 'vcan7'\r\n")
    assert load_settings(None, {"CRUISER_CONFIG": file}, {}).can.channel == "vcan7"
    assert load_settings(file, {"CRUISER_CONFIG": "/nowhere"}, {}).can.channel == "vcan7"
    assert load_settings(None, {}, {}) == load_settings(None, {"CRUISER_CONFIG": ""}, {}) == Settings()
    with pytest.raises(CommandError, match=r"^--config is empty: it must name a file$") as caught:
        load_settings("", {}, {})
    assert caught.value.code is ExitCode.USAGE


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("missing.toml", None, "cannot read the configuration file"),
        (".", None, "cannot read the configuration file"),
        ("a\0b", None, "cannot read the configuration file"),
        ("robot.toml", b"[can]\nbus = '\xff'\n", r"robot\.toml:2: not UTF-8 text \(byte 0xff\)"),
        ("robot.json5", None, r"for --zenoh-config; --config takes a settings file: .*robot\.toml"),
    ],
)
def test_a_file_that_cannot_be_read_is_one_clear_line(
    tmp_path: Path, name: str, content: bytes | None, says: str
) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(CommandError, match=says) as caught:
        load_settings(f"{tmp_path}/{name}", {}, {})
    assert caught.value.code is ExitCode.USAGE
    assert str(caught.value).isprintable()


# The file is written anew for each example, so sharing its directory changes nothing.
@hypothesis_settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(content=st.binary() | st.text("canbus.=[]{}'\"\\\n #1,").map(str.encode))
def test_no_bytes_do_more_than_fail_with_one_line(tmp_path: Path, content: bytes) -> None:
    message = _complaint(_written(tmp_path, content))
    assert message.isprintable()
    assert "robot.toml" in message or message == "right"


def test_a_fifo_is_not_waited_for(tmp_path: Path) -> None:
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)
    with pytest.raises(CommandError, match=r"cannot read the configuration file .* it is a FIFO"):
        load_settings(str(fifo), {}, {})
    with pytest.raises(CommandError, match="is a FIFO"):
        load_settings(None, {}, {"zenoh.config": str(fifo)})


# A settings file that somebody forgot to name.


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working directory without files, and no home or system directory."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(configuration_file, "SYSTEM_FILE", tmp_path / "etc" / "cruiser.toml")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    return tmp_path


def _unread(command: str, environ: dict[str, str] | None = None, connect: str = "") -> str:
    given = environ or {}
    settings = load_settings(None, given, {"zenoh.connect": [connect]} if connect else {})
    return unread_file(command, None, given, settings)


def _connects(command: str) -> bool:
    parser = argparse.ArgumentParser()
    pkgutil.resolve_name(COMMANDS[command][0]).add_arguments(parser)
    return "--connect ENDPOINT" in parser.format_help()


def test_every_command_that_connects_has_a_settings_file_of_its_users() -> None:
    """Without one it would silently run in open mode beside it."""
    assert set(OWN_FILES) == {command for command in COMMANDS if _connects(command)}


@pytest.mark.parametrize(
    ("command", "name"), [(command, name) for command in OWN_FILES for name in OWN_FILES[command]]
)
def test_a_settings_file_that_was_not_named_is_found_in_the_working_directory(
    place: Path, command: str, name: str
) -> None:
    assert _unread(command) == ""
    (place / name).write_text("")
    assert _unread(command) == name
    others = [one for one in OWN_FILES if name not in OWN_FILES[one]]
    assert [one for one in others if _unread(one)] == []


@pytest.mark.parametrize(
    ("place_of_keys", "environment"),
    [
        ("home/.config/cruiser", {}),
        ("xdg/cruiser", {"XDG_CONFIG_HOME": "{place}/xdg"}),
        ("keys", {"CRUISER_AUTHORITY_DIRECTORY": "{place}/keys"}),
    ],
)
def test_a_settings_file_that_was_not_named_is_found_beside_the_keys(
    place: Path, place_of_keys: str, environment: dict[str, str]
) -> None:
    (place / "robot.toml").mkdir()
    file = place / place_of_keys / "robot.toml"
    file.parent.mkdir(parents=True)
    file.write_text("")
    given = {name: value.format(place=place) for name, value in environment.items()}
    assert _unread("gateway", given) == str(file)


def test_what_is_started_by_hand_on_a_robot_reads_the_settings_of_its_services(place: Path) -> None:
    file = place / "etc" / "cruiser.toml"
    assert [command for command in COMMANDS if settings_file(command, None, {})] == []
    file.parent.mkdir()
    file.write_text('[robot]\nname = "depot-3"\n[can]\nchannel = "can5"\n')
    (place / "robot.toml").write_text("")
    reading = {command for command in COMMANDS if settings_file(command, None, {}) == str(file)}
    assert reading == {"doctor", "gateway", "record"}
    assert settings_file("record", None, {}, "status") is None
    assert settings_file("gateway", None, {"CRUISER_CONFIG": ""}) is None
    assert settings_file("gateway", None, {"CRUISER_CONFIG": "a.toml"}) == "a.toml"
    assert settings_file("gateway", "b.toml", {"CRUISER_CONFIG": "a.toml"}) == "b.toml"
    settings = load_settings(str(file), {}, {"can.channel": "can6"})
    assert (settings.robot.name, settings.can.channel) == ("depot-3", "can6")
    assert unread_file("gateway", str(file), {}, settings) == ""


def test_nothing_is_said_to_whoever_stated_what_they_want(place: Path) -> None:
    for name in ("robot.toml", "operator.toml"):
        (place / name).write_text("")
    assert unread_file("gateway", "robot.toml", {}, Settings()) == ""
    assert _unread("gateway", {"CRUISER_CONFIG": ""}) == ""
    assert _unread("gateway", {"CRUISER_AUTHORITY_MODE": "open"}) == ""
    assert unread_file("gateway", None, {}, Settings(authority=AuthoritySettings(mode="signed"))) == ""
    assert _unread("list", connect="tcp/10.0.0.5:7447") == ""
    assert _unread("gateway", connect="tcp/10.0.0.5:7447") == "robot.toml"
