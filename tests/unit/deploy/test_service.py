"""The systemd units run commands that exist, with settings that do; the gateway's leaves the guard alone."""

import argparse
import configparser
import re
from importlib import import_module
from pathlib import Path

import pytest

from gateway.chassis.cruiser import early_stop
from gateway.cli.configuration_file import load_settings
from gateway.cli.main import COMMANDS
from recorder.disk.files import NAME
from schemas.configuration import TomlSource, merge
from schemas.settings import GUARD_LATE_NS, HALT_LISTEN_NS, HALT_YIELD_NS, REST_TIMEOUT_NS, DeskSettings, Settings

DEPLOY = Path(__file__).parents[3] / "deploy"


def section(name: str) -> dict[str, str]:
    """A unit's service section; names as systemd spells them."""
    # Of a key that is given more than once this has the last.
    unit = configparser.ConfigParser(delimiters=["="], interpolation=None, strict=False)
    unit.optionxform = str  # type: ignore[assignment,method-assign]
    unit.read(DEPLOY / name, encoding="utf-8")
    return dict(unit["Service"])


@pytest.fixture
def service() -> dict[str, str]:
    return section("cruiser-gateway.service")


@pytest.mark.parametrize(("line", "command"), [("ExecStart", "gateway"), ("ExecStopPost", "halt")])
def test_its_commands_exist(service: dict[str, str], line: str, command: str) -> None:
    """With the same configuration file; a failed halt does not hide how the gateway ended."""
    program, *words = service[line].split()
    assert program == {"ExecStart": "", "ExecStopPost": "-"}[line] + "/opt/cruiser/bin/cruiser"
    assert words[:3] == [command, "--config", "/etc/cruiser/cruiser.toml"]
    parser = argparse.ArgumentParser()
    import_module(COMMANDS[command][0]).add_arguments(parser)
    # The interface may come later than the service.
    assert vars(parser.parse_args(words[3:])).get("gateway.wait_for_bus", True)


def test_the_guard_outlives_the_gateway(service: dict[str, str]) -> None:
    """Only the main process is ever killed, and a halt has time for a guard at work and for a remote control.

    'mixed' sends SIGKILL to all that is left once the main process is gone: to the guard, amid its stop.
    """
    assert service["KillMode"] == "process"
    assert service["OOMPolicy"] == "continue"
    assert int(service["TimeoutStopSec"]) * 1e9 > 2 * HALT_YIELD_NS + 2 * HALT_LISTEN_NS + REST_TIMEOUT_NS


def test_a_stop_by_the_guard_has_a_place_on_the_disk(service: dict[str, str]) -> None:
    """Row 'latched, also across a restart': the gateway, the guard and the halt are told the same directory.

    It lies apart from the recorder's, whose owner would be changed with it.
    """
    assert service["StateDirectory"] == "cruiser/gateway"
    assert int(service["LimitRTPRIO"]) >= Settings().gateway.realtime_priority + 1


def test_the_recorder_records_into_the_directory_that_it_may_write_to() -> None:
    """With the gateway's configuration file; it is always begun again, and a reload begins new files."""
    recorder = section("cruiser-recorder.service")
    program, *words = recorder["ExecStart"].split()
    assert (program, words[:3]) == (
        "/opt/cruiser/bin/cruiser",
        ["record", "--config", "/etc/cruiser/cruiser.toml"],
    )
    parser = argparse.ArgumentParser()
    import_module(COMMANDS["record"][0]).add_arguments(parser)
    directory = vars(parser.parse_args(words[3:]))["recorder.directory"]
    assert directory == f"/var/lib/{recorder['StateDirectory']}"
    assert recorder["Restart"] == "always"
    assert recorder["ExecReload"].split()[1:] == ["-HUP", "$MAINPID"]


def test_a_gateway_that_hangs_is_begun_again_after_its_guard_has_acted(service: dict[str, str]) -> None:
    """By the watchdog; a loop that is late for as long as floods have made it is not ended."""
    assert (service["Type"], service["Restart"]) == ("notify", "always")
    assert int(service["WatchdogSec"]) * 1e9 > 50 * GUARD_LATE_NS + 5e9
    assert int(service["TimeoutAbortSec"]) < int(service["TimeoutStopSec"])


def test_the_routers_command_exists() -> None:
    """With the directory that its first lines say how to fill; it comes back whatever ended it."""
    service = section("cruiser-router.service")
    program, command, *words = service["ExecStart"].split()
    assert (program, command) == ("/opt/cruiser/bin/cruiser", "router")
    parser = argparse.ArgumentParser()
    import_module(COMMANDS[command][0]).add_arguments(parser)
    assert vars(parser.parse_args(words))["authority.directory"] == "/etc/cruiser/router"
    assert service["Restart"] == "always"


def test_the_early_stop_begins_with_the_boot_and_with_each_can_interface() -> None:
    """Before anything that a boot waits for, with nothing but Python; it has time for its watch and for a stop."""
    early = section("cruiser-early-stop@.service")
    assert early["ExecStart"] == "/usr/bin/python3 -I -S -E /opt/cruiser/lib/early_stop.py %I"
    waits_ns = early_stop.APPEAR_S * 1e9 + early_stop.WATCH_NS + early_stop.GIVES_UP_NS
    assert int(early["RuntimeMaxSec"]) * 1e9 > waits_ns
    assert int(early["CPUSchedulingPriority"]) == Settings().gateway.realtime_priority + 1
    assert early["Environment"] == "STATE_DIRECTORY=/var/lib/cruiser/gateway"
    rule = (DEPLOY / "60-cruiser.rules").read_text(encoding="utf-8")
    assert 'ENV{SYSTEMD_WANTS}+="cruiser-early-stop@%k.service"' in rule


@pytest.mark.parametrize("name", ["desk", "metrics"])
def test_the_commands_for_a_fleet_exist(name: str) -> None:
    """With settings of their own: what serves a fleet is no robot's. They come back whatever ended them."""
    service = section(f"cruiser-{name}.service")
    program, command, *words = service["ExecStart"].split()
    assert (program, command) == ("/opt/cruiser/bin/cruiser", name)
    assert words == ["--config", f"/etc/cruiser/{name}.toml"]
    assert command in COMMANDS
    assert service["Restart"] == "always"
    assert (DEPLOY / f"etc/cruiser/{name}.toml").exists()


def test_the_desk_that_comes_along_is_for_this_machine_alone() -> None:
    """Where nobody has given it a certificate; and what its comments offer is right, too."""
    file = DEPLOY / "etc/cruiser/desk.toml"
    desk = load_settings(str(file), {}, {}).desk
    assert (desk.listen, desk.certificate, desk.key, desk.names) == ("127.0.0.1:8080", "", "", [])
    offered = re.sub(r'^# (?=\w+ = [\["])', "", file.read_text("utf-8"), flags=re.MULTILINE)
    offered = offered.replace('listen = "127.0.0.1:8080"\n', "")
    settings = merge(TomlSource("desk.toml", offered), {}, {})
    keys = "/etc/cruiser/desk/https.pem", "/etc/cruiser/desk/https.key"
    assert settings.desk == DeskSettings(
        "0.0.0.0:8443",
        *keys,
        ["desk.example"],
        logs=f"/var/lib/{section('cruiser-recorder.service')['StateDirectory']}",
    )
    assert settings.zenoh.config == "/etc/cruiser/desk/desk.json5"


def test_the_desk_may_read_the_logs_of_the_recorder() -> None:
    """Whose files are its group's to read, and its keys nobody's but its own."""
    desk, recorder = section("cruiser-desk.service"), section("cruiser-recorder.service")
    assert (desk["SupplementaryGroups"], recorder["UMask"]) == (recorder["Group"], "0027")
    assert "d /etc/cruiser/recorder   0700 " in (DEPLOY / "tmpfiles.conf").read_text("utf-8")


@pytest.mark.parametrize("file", sorted(DEPLOY.glob("etc/cruiser/*.toml")), ids=lambda file: file.name)
def test_the_settings_that_come_along_are_right(file: Path) -> None:
    """The product reads each."""
    load_settings(str(file), {}, {})


def test_the_upload_comes_after_everybody_else() -> None:
    """And reads the recorder's own directory, in which it may change one file."""
    unit = section("cruiser-upload.service")
    _, command, *words = unit["ExecStart"].split()
    parser = argparse.ArgumentParser()
    parser.add_argument("--config")
    import_module(COMMANDS[command][0]).add_arguments(parser)
    directory = vars(parser.parse_args(words))["recorder.directory"]
    assert directory == f"/var/lib/{section('cruiser-recorder.service')['StateDirectory']}"
    assert unit["ReadWritePaths"] == f"-{directory}/{NAME}"
    assert (unit["Nice"], unit["CPUSchedulingPolicy"], unit["IOSchedulingClass"]) == ("19", "idle", "idle")
