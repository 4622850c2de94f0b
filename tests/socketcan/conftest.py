"""The fixtures of this directory, which a plain pytest passes by: ``run`` gives it a kernel with CAN."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.socketcan.can_utils import Candump
from tests.socketcan.commands import FILTER, LAMP_FEEDBACK
from tests.socketcan.interface import Vcan


@pytest.fixture(autouse=True)
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Gateways that wait for their operator as long as their settings allow: processes may be late here."""
    monkeypatch.setenv("CRUISER_COMMAND_DEADMAN_S", "0.5")
    monkeypatch.setenv("CRUISER_COMMAND_MAX_AGE_S", "1.0")


@pytest.fixture
def vcan() -> Iterator[Vcan]:
    """A CAN interface of the test's own."""
    with Vcan() as interface:
        yield interface


@pytest.fixture
def candump(vcan: Vcan, tmp_path: Path) -> Iterator[Candump]:
    """Somebody who writes down what is on it, from before anybody else is there."""
    with Candump(vcan.name, tmp_path / "candump.log") as dump:
        yield dump


@pytest.fixture
def witness(vcan: Vcan, tmp_path: Path) -> Iterator[Candump]:
    """Somebody who writes down the commands, and 20 frames/s of the chassis by which time is seen to pass."""
    with Candump(vcan.name, tmp_path / "candump.log", FILTER, LAMP_FEEDBACK) as dump:
        yield dump
