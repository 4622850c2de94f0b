"""The import rules: .importlinter has them, by folder, and this sees that none is without one."""

import configparser
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent

WORLD = {
    "gateway.can",
    "gateway.host",
    "gateway.zenoh",
    "recorder.replay",
    "recorder.zenoh",
}
"""Rooms that touch the world: clocks, threads, the bus, Zenoh. Whoever adds one says so here."""


def contracts() -> dict[str, set[str]]:
    """The modules that each contract of .importlinter binds, by the contract's name."""
    parser = configparser.ConfigParser()
    parser.read(ROOT / ".importlinter")
    return {
        section.rpartition(":")[2]: set(parser[section].get("source_modules", "").split())
        for section in parser.sections()
    }


def rooms() -> set[str]:
    """The folders and modules right below gateway and recorder."""
    return {
        f"{package}.{path.stem}"
        for package in ("gateway", "recorder")
        for path in (ROOT / package).iterdir()
        if path.suffix == ".py" or (path / "__init__.py").exists()
        if not path.stem.startswith("__")
    }


def test_the_import_contracts_hold() -> None:
    """The layers are exhaustive: a folder that stands in none breaks them."""
    linter = Path(sys.executable).with_name("lint-imports")
    outcome = subprocess.run([linter, "--no-cache"], cwd=ROOT, capture_output=True, text=True, check=False)
    assert outcome.returncode == 0, outcome.stdout


def test_every_room_has_a_contract_of_what_it_may_touch() -> None:
    """Pure, a reader of logs, at least without CAN and Zenoh, or of those that touch the world; one of these."""
    bound = contracts()
    kinds = [bound["pure"], bound["questions"], bound["world"], WORLD]
    assert {room: sum(room in kind for kind in kinds) for room in rooms()} == dict.fromkeys(rooms(), 1)


@pytest.mark.parametrize("module", ["time", "threading", "socket", "os", "zenoh", "can"])
def test_a_core_that_touched_the_world_would_be_seen(module: str) -> None:
    """The contract of the cores forbids what they would need for it."""
    parser = configparser.ConfigParser()
    parser.read(ROOT / ".importlinter")
    assert module in parser["importlinter:contract:pure"]["forbidden_modules"].split()
