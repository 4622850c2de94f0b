"""What holds for every test."""

import gc
import itertools
import os
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

from tests.support.logs import small_log

# How long an example takes says how busy the machine is. `make nightly` looks thirty times as far.
settings.register_profile("daily", deadline=None, max_examples=10)
settings.register_profile("nightly", deadline=None, max_examples=300)
settings.load_profile("daily")

# The product does not let Python look for garbage at each 700 objects either; it took a tenth of the tests' time.
gc.set_threshold(100_000, 50, 50)

# Started in the background of a shell, this process ignores Ctrl-C, and so would all that a test starts.
signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.hookimpl(optionalhook=True)  # pytest-xdist is not everywhere.
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:  # noqa: ANN401 - of pytest-xdist
    """With ``--dist loadfile`` spread system tests one by one."""
    if config.getoption("dist") != "loadfile":
        return None
    from tests.support.spreading import Spreading  # noqa: PLC0415 - it needs pytest-xdist

    return Spreading(config, log)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Put tests marked ``long`` first; by day leave out those marked ``night`` (``tests/support/nights.py``)."""
    items.sort(key=lambda item: item.get_closest_marker("long") is None)
    # Where pytest runs without the plugin of Hypothesis, as in the user-mode kernel, there is no such option.
    if config.getoption("--hypothesis-profile", None) == "nightly":
        return
    left_out = [item for item in items if item.get_closest_marker("night")]
    if left_out:
        config.hook.pytest_deselected(items=left_out)
        items[:] = [item for item in items if not item.get_closest_marker("night")]


def pytest_collection_finish() -> None:
    """Keep collected items out of garbage collection."""
    gc.freeze()


def pytest_unconfigure() -> None:
    """Let libraries that count their objects find them gone: DuckDB reports 77 lines of leftovers."""
    gc.unfreeze()


@pytest.fixture(scope="session")
def _states(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Unused directories; a new `tmp_path` would make pytest scan those of all tests before."""
    home = tmp_path_factory.mktemp("states")
    return (home / str(number) for number in itertools.count())


@pytest.fixture(autouse=True)
def _state_of_its_own(_states: Iterator[Path], monkeypatch: pytest.MonkeyPatch) -> None:
    """A guard's stop in one test is latched in no other."""
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    monkeypatch.setenv("XDG_STATE_HOME", str(next(_states)))


@pytest.fixture(autouse=True)
def _scheduled_as_before() -> Iterator[None]:
    """A test process with real-time priority would delay the robots of all others."""
    before = os.sched_getscheduler(0)
    yield
    after = os.sched_getscheduler(0)
    if after != before:
        os.sched_setscheduler(0, before, os.sched_param(0))
    assert after == before


@pytest.fixture(scope="module")
def running_browser() -> Iterator[Any]:
    """One Chromium for all tests of a module; each has its own context."""
    from tests.support.processes.desk import chromium  # noqa: PLC0415 - it needs playwright

    with chromium() as running:
        yield running


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=16m", "tmpfs", str(disk)]
    if os.geteuid() or subprocess.run(mount, check=False, capture_output=True).returncode:
        pytest.skip("a file system can be mounted by root alone")
    try:
        yield disk
    finally:
        subprocess.run(["umount", str(disk)], check=True)  # noqa: S607 - wherever the system has it


@pytest.fixture
def whole(tmp_path: Path) -> Path:
    path = tmp_path / "whole.mcap"
    path.write_bytes(small_log())
    return path


@pytest.fixture
def cut(tmp_path: Path) -> Path:
    path = tmp_path / "cut.mcap.part"
    path.write_bytes(small_log()[:-200])
    return path
