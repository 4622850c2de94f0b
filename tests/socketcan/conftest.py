"""Fixtures for ``run``, which provides a kernel with CAN; a plain pytest skips this directory."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.socketcan.can_utils import Candump
from tests.socketcan.commands import FILTER, WHEEL_SPEEDS
from tests.socketcan.interface import Vcan
from tests.support.processes.busy import PATIENT_DEADMAN_S


@pytest.fixture(autouse=True)
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Gateways with the longest deadman: processes may be late here."""
    monkeypatch.setenv("CRUISER_COMMAND_DEADMAN_S", str(PATIENT_DEADMAN_S))


@pytest.fixture
def vcan() -> Iterator[Vcan]:
    with Vcan() as interface:
        yield interface


@pytest.fixture
def candump(vcan: Vcan, tmp_path: Path) -> Iterator[Candump]:
    with Candump(vcan.name, tmp_path / "candump.log") as dump:
        yield dump


@pytest.fixture
def witness(vcan: Vcan, tmp_path: Path) -> Iterator[Candump]:
    """Candump of the commands, and of the wheel speeds, 20 frames/s."""
    with Candump(vcan.name, tmp_path / "candump.log", FILTER, f"{WHEEL_SPEEDS:08X}:1FFFFFFF") as dump:
        yield dump
