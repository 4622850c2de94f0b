"""What holds for the tests that start processes."""

from collections.abc import Iterator
from multiprocessing.forkserver import ensure_running
from typing import Final

import pytest

import tests.support.processes.forked  # noqa: F401 - it tells what its process imports
from tests.support.processes.busy import PATIENT_DEADMAN_S


@pytest.fixture(scope="session", autouse=True)
def _patient_gateways() -> Iterator[None]:
    """A long deadman for every gateway, unless a test sets its own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CRUISER_COMMAND_DEADMAN_S", str(PATIENT_DEADMAN_S))
        yield


# Modules that our processes import.
FOREIGN_MODULES: Final = ("argparse", "gateway", "multiprocessing", "recorder")


@pytest.fixture
def beside_foreign_modules(
    tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> Iterator[None]:
    """A working directory with foreign Python files: no process may execute one."""
    directory = tmp_path_factory.mktemp("foreign")
    for name in FOREIGN_MODULES:
        (directory / f"{name}.py").write_text(
            f"open({str(directory / name)!r}, 'w').close()\nraise SystemExit('a foreign module was executed')\n"
        )
    # The tests' own process, which is no command.
    ensure_running()
    monkeypatch.chdir(directory)
    yield
    assert [path.name for path in directory.iterdir() if not path.suffix] == []
