"""The systemd unit runs commands that exist, with settings that do, and leaves the guard alone."""

import argparse
import configparser
from importlib import import_module
from pathlib import Path

import pytest

from gateway.cli.main import COMMANDS
from schemas.settings import HALT_LISTEN_NS, HALT_YIELD_NS, REST_TIMEOUT_NS

UNIT = Path(__file__).parent.parent.parent / "deploy" / "cruiser-gateway.service"


@pytest.fixture
def service() -> dict[str, str]:
    """The unit's service section; names as systemd spells them."""
    unit = configparser.ConfigParser(delimiters=["="], interpolation=None)
    unit.optionxform = str  # type: ignore[assignment,method-assign]
    unit.read(UNIT, encoding="utf-8")
    return dict(unit["Service"])


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
    """Only the main process is ever killed, and a halt has time for a guard at work and for a hand transmitter.

    'mixed' sends SIGKILL to all that is left once the main process is gone: to the guard, amid its stop.
    """
    assert service["KillMode"] == "process"
    assert service["OOMPolicy"] == "continue"
    assert int(service["TimeoutStopSec"]) * 1e9 > 2 * HALT_YIELD_NS + 2 * HALT_LISTEN_NS + REST_TIMEOUT_NS
