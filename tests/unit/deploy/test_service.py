"""The systemd units and the image run existing commands with valid settings, and leave the guard alone."""

import argparse
import configparser
import fnmatch
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
    """A unit's service section, in systemd's spelling."""
    # Of a key that is given more than once this has the last.
    unit = configparser.ConfigParser(delimiters=["="], interpolation=None, strict=False)
    unit.optionxform = str  # type: ignore[assignment,method-assign]
    unit.read(DEPLOY / name, encoding="utf-8")
    return dict(unit["Service"])


@pytest.fixture
def service() -> dict[str, str]:
    return section("cruiser-gateway.service")


LOGS = f"/var/lib/{section('cruiser-recorder.service')['StateDirectory']}"
ROBOT: dict[str, object] = {"config": "/etc/cruiser/cruiser.toml"}
UNITS: dict[str, tuple[str, dict[str, object]]] = {
    # The interface may come later than the service.
    "gateway ExecStart": ("gateway", ROBOT | {"gateway.wait_for_bus": True}),
    # A failed halt does not hide how the gateway ended.
    "gateway ExecStopPost": ("-halt", ROBOT),
    "recorder ExecStart": ("record", ROBOT | {"recorder.directory": LOGS}),
    "upload ExecStart": ("upload", {"recorder.directory": LOGS}),
    "router ExecStart": ("router", {"authority.directory": "/etc/cruiser/router"}),
    **{f"{name} ExecStart": (name, {"config": f"/etc/cruiser/{name}.toml"}) for name in ("desk", "metrics")},
}


@pytest.mark.parametrize("line", UNITS)
def test_its_command_exists(line: str) -> None:
    """With these flags; and all restart whatever ended them."""
    unit, _, entry = line.partition(" ")
    command, said = UNITS[line]
    service = section(f"cruiser-{unit}.service")
    program, *words = service[entry].split()
    assert [program, words[0]] == [
        f"{command[: command.startswith('-')]}/opt/cruiser/bin/cruiser",
        command.strip("-"),
    ]
    parser = argparse.ArgumentParser()
    parser.add_argument("--config")
    import_module(COMMANDS[words[0]][0]).add_arguments(parser)
    assert said.items() <= vars(parser.parse_args(words[1:])).items()
    assert (DEPLOY / str(said.get("config", "/etc/cruiser/cruiser.toml")).lstrip("/")).exists()
    assert service["Restart"] == "always"


def test_a_reload_begins_new_files_and_an_upload_comes_after_everybody_else() -> None:
    """It reads the recorder's directory, in which it may change one file."""
    recorder, unit = section("cruiser-recorder.service"), section("cruiser-upload.service")
    assert recorder["ExecReload"].split()[1:] == ["-HUP", "$MAINPID"]
    assert unit["ReadWritePaths"] == f"-{LOGS}/{NAME}"
    assert (unit["Nice"], unit["CPUSchedulingPolicy"], unit["IOSchedulingClass"]) == ("19", "idle", "idle")


def test_the_guard_outlives_the_gateway(service: dict[str, str]) -> None:
    """Only the main process is killed; 'mixed' would kill the guard amid its stop. A halt has time for both."""
    assert service["KillMode"] == "process"
    assert service["OOMPolicy"] == "continue"
    assert int(service["TimeoutStopSec"]) * 1e9 > 2 * HALT_YIELD_NS + 2 * HALT_LISTEN_NS + REST_TIMEOUT_NS


def test_a_stop_by_the_guard_has_a_place_on_the_disk(service: dict[str, str]) -> None:
    """Row 'latched, also across a restart': gateway, guard and halt share a directory, not the recorder's."""
    assert service["StateDirectory"] == "cruiser/gateway"
    assert int(service["LimitRTPRIO"]) >= Settings().gateway.realtime_priority + 1


def test_a_gateway_that_hangs_is_begun_again_after_its_guard_has_acted(service: dict[str, str]) -> None:
    """By the watchdog, which tolerates a loop as late as floods have made it."""
    assert (service["Type"], service["Restart"]) == ("notify", "always")
    assert int(service["WatchdogSec"]) * 1e9 > 50 * GUARD_LATE_NS + 5e9
    assert int(service["TimeoutAbortSec"]) < int(service["TimeoutStopSec"])


def test_the_early_stop_begins_with_the_boot_and_with_each_can_interface() -> None:
    """Before anything that a boot waits for, with Python alone, and with time for its watch and a stop."""
    early = section("cruiser-early-stop@.service")
    assert early["ExecStart"] == "/usr/bin/python3 -I -S -E /opt/cruiser/lib/early_stop.py %I"
    waits_ns = early_stop.APPEAR_S * 1e9 + early_stop.WATCH_NS + early_stop.GIVES_UP_NS
    assert int(early["RuntimeMaxSec"]) * 1e9 > waits_ns
    assert int(early["CPUSchedulingPriority"]) == Settings().gateway.realtime_priority + 1
    assert early["Environment"] == "STATE_DIRECTORY=/var/lib/cruiser/gateway"
    rule = (DEPLOY / "60-cruiser.rules").read_text(encoding="utf-8")
    assert 'ENV{SYSTEMD_WANTS}+="cruiser-early-stop@%k.service"' in rule


def test_the_desk_that_comes_along_is_for_this_machine_alone() -> None:
    """Without a certificate; and the settings in its comments are valid."""
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
        logs=LOGS,
    )
    assert settings.zenoh.config == "/etc/cruiser/desk/desk.json5"


def test_the_desk_may_read_the_logs_of_the_recorder() -> None:
    """By its group; nobody else reads the desk's keys."""
    desk, recorder = section("cruiser-desk.service"), section("cruiser-recorder.service")
    assert (desk["SupplementaryGroups"], recorder["UMask"]) == (recorder["Group"], "0027")
    assert "d /etc/cruiser/recorder   0700 " in (DEPLOY / "tmpfiles.conf").read_text("utf-8")


@pytest.mark.parametrize("file", sorted(DEPLOY.glob("etc/cruiser/*.toml")), ids=lambda file: file.name)
def test_the_settings_that_come_along_are_right(file: Path) -> None:
    load_settings(str(file), {}, {})


ROOT = Path(__file__).parents[3]
CONTAINERFILE = (ROOT / "deploy" / "Containerfile").read_text("utf-8")
SERVICES = re.findall(
    r"^  (\w+):\n    <<: \*cruiser\n(?:    .*\n)*?    command: \[(.+)\]$",
    (ROOT / "deploy" / "compose.yaml").read_text("utf-8"),
    flags=re.MULTILINE,
)


def test_what_is_copied_is_in_the_tree_and_let_through() -> None:
    """Each source of a COPY; the context has nothing else."""
    lines = (ROOT / ".dockerignore").read_text("utf-8").split()
    passes = [line.removeprefix("!") for line in lines if line.startswith("!")]
    sources = [
        name
        for line in re.findall(r"^COPY (?!--from)(.+) \S+$", CONTAINERFILE, re.MULTILINE)
        for name in line.split()
    ]
    assert lines[0] == "*"
    assert len(sources) == 7
    for name in sources:
        assert (ROOT / name).exists()
        assert any(fnmatch.fnmatch(name, each) for each in passes)


def test_the_image_runs_as_nobody_special() -> None:
    """From its last USER on; packages without a pinned hash are refused."""
    assert CONTAINERFILE.rpartition("USER ")[2].split()[0] == "cruiser"
    assert "--require-hashes --only-binary :all: --requirement constraints-run.txt" in CONTAINERFILE
    assert CONTAINERFILE.count("pip install") == 2
    assert "python:3.12-slim" in CONTAINERFILE


@pytest.mark.parametrize(("service", "command"), SERVICES)
def test_each_service_runs_a_command_that_exists(service: str, command: str) -> None:
    """With flags that it has."""
    name, *words = command.replace('"', "").split(", ")
    parser = argparse.ArgumentParser()
    parser.add_argument("--config")
    import_module(COMMANDS[name][0]).add_arguments(parser)
    parser.parse_args(words)
    assert name == {"recorder": "record"}.get(service, service)
    assert len(SERVICES) == 5, "the expression above finds all"
