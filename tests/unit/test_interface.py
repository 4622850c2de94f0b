"""Flags, columns and metrics change by intention only."""

import re
from pkgutil import resolve_name

import pytest

from gateway.cli.main import COMMANDS
from recorder.cli.review import QUESTIONS
from tests.support.interface import DIRECTORY, FILES, text_of

PLACES = {name: place for name, (place, _) in COMMANDS.items()}
PLACES |= {f"review {question}": place for question, (place, _) in QUESTIONS.items()}


@pytest.mark.parametrize("name", FILES)
def test_the_interface_is_as_it_was(name: str) -> None:
    """If it has to change: ``python -m tests.support.interface``, and a line in CHANGELOG."""
    assert text_of(name) == (DIRECTORY / name).read_text(encoding="utf-8")


@pytest.mark.parametrize("name", PLACES)
def test_the_examples_of_a_help_use_flags_that_exist(name: str) -> None:
    flag = r"(?<![\w-])--?[a-z][a-z-]*"
    blocks = (DIRECTORY / "commands.txt").read_text("utf-8").split("\n\n")
    own = {one for block in blocks if block.startswith(f"cruiser {name}") for one in re.findall(flag, block)}
    lines = re.findall(rf"cruiser {name} ([^|&\n]*)", resolve_name(PLACES[name]).EXAMPLE)
    assert {one for line in lines for one in re.findall(flag, line)} - {"--help"} <= own
