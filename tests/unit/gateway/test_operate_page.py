"""The commands of docs/operate.md, which somebody types at night, are commands that exist."""

import argparse
import re
import shlex
from importlib import import_module
from pathlib import Path

import pytest

from gateway.cli.main import COMMANDS

PAGE = (Path(__file__).parents[3] / "docs" / "operate.md").read_text("utf-8")
TYPED = re.compile(r"^    (?:.* -- |sudo )?cruiser (.*)$", re.MULTILINE)
NAMED = re.compile(r"`(?:sudo )?cruiser ([a-z][^`]*)`")


def lines() -> list[str]:
    """What stands after ``cruiser``, on lines of its own or in the text."""
    typed = [line.partition("  #")[0].partition(" | ")[0].strip() for line in TYPED.findall(PAGE)]
    return sorted({*typed, *(line.replace("\n", " ") for line in NAMED.findall(PAGE))})


@pytest.mark.parametrize("line", lines())
def test_the_command_exists_with_these_words(line: str) -> None:
    """A name alone stands for the command."""
    name, *words = shlex.split(line.replace("ROBOT", "cruiser-1"))
    assert name in COMMANDS
    if not words:
        return
    parser = argparse.ArgumentParser(exit_on_error=False)
    parser.add_argument("--config")
    import_module(COMMANDS[name][0]).add_arguments(parser)
    parser.parse_args(words)


def test_lines_of_each_kind_are_found() -> None:
    """As root, as a service's user, as anybody, and in the text."""
    wanted = {"doctor", "provision sign robot.request", "why ROBOT", "provision renew viewer"}
    assert wanted < set(lines())
    assert any(line.startswith("provision renew robot --directory /etc/cruiser/gateway") for line in lines())
