"""Rows of the catalog, made by other processes."""

import asyncio
import re
import subprocess
import sys
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

from recorder.review.catalog.log_row import read_row
from recorder.upload import finished as rows
from recorder.upload.finished import RowError, row_maker
from tests.support.logs import gears, own_log, saved

ROOT = Path(__file__).parents[4]


def made(log: Path) -> bytes:
    async def make() -> bytes:
        return await row_maker("recorder.review.catalog")(log)

    return asyncio.run(make())


def test_a_process_makes_the_row_of_a_log(tmp_path: Path) -> None:
    log = saved(tmp_path / "a.mcap", own_log([gears(0, 3, 0)]))
    found = read_row(made(log), log.stat().st_size)
    assert (found.file, found.messages) == ("a.mcap", 3)


def absent_on_robots() -> list[str]:
    """The modules of this environment that the Debian package lacks."""
    pinned = (ROOT / "constraints-run.txt").read_text(encoding="utf-8")
    there = {normalized(name) for name in re.findall(r"^([\w.-]+)==", pinned, re.MULTILINE)}
    return [
        module
        for module, names in packages_distributions().items()
        if module.isidentifier() and not {normalized(name) for name in names} & {*there, "cruiser-gateway"}
    ]


def test_what_a_robot_has_installed_suffices(tmp_path: Path) -> None:
    log = saved(tmp_path / "a.mcap", own_log([gears(0, 3, 0)]))
    absent = absent_on_robots()
    assert "pyarrow" in absent
    run = (
        "import runpy, sys; names, *sys.argv = sys.argv[1:]; sys.modules.update(dict.fromkeys(names.split())); "
        "runpy.run_module('recorder.review.catalog', run_name='__main__')"
    )
    words = [sys.executable, "-c", run, " ".join(absent), "recorder.review.catalog", str(log)]
    done = subprocess.run(words, capture_output=True, check=False, timeout=60)
    assert (done.returncode, done.stderr.decode()) == (0, "")
    assert read_row(done.stdout, log.stat().st_size).messages == 3


def normalized(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def test_what_is_no_log_has_no_row(tmp_path: Path) -> None:
    log = saved(tmp_path / "a.mcap", b"no log")
    with pytest.raises(RowError, match="is no MCAP file"):
        made(log)


def test_a_row_that_takes_too_long_is_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rows, "ROW_S", 0.01)
    log = saved(tmp_path / "a.mcap", own_log([gears(0, 3, 0)]))
    with pytest.raises(RowError, match="given up"):
        made(log)
