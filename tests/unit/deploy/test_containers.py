"""The image takes what is in the tree, and its services run commands that exist. No engine builds it here."""

import argparse
import fnmatch
import re
from importlib import import_module
from pathlib import Path

import pytest

from gateway.cli.main import COMMANDS

ROOT = Path(__file__).parents[3]
CONTAINERFILE = (ROOT / "deploy" / "Containerfile").read_text("utf-8")
SERVICES = re.findall(
    r"^  (\w+):\n    <<: \*cruiser\n(?:    .*\n)*?    command: \[(.+)\]$",
    (ROOT / "deploy" / "compose.yaml").read_text("utf-8"),
    flags=re.MULTILINE,
)


def test_what_is_copied_is_in_the_tree_and_let_through() -> None:
    """Each source of a COPY, from a context that has nothing else."""
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
    """From its last USER on; and it accepts no package whose hash is not written down."""
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
