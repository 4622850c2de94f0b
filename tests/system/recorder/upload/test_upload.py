"""``cruiser upload`` as a process: a kill costs only time."""

import os
import signal
import subprocess
from pathlib import Path

import pytest

from recorder.disk.files import SafeLogReader
from schemas.command_line import ExitCode, module_command
from tests.support.logs import gears, own_log, saved
from tests.support.waiting import wait_until

LOG = "cruiser-1-20270115T080000Z.mcap"


def words(logs: Path, store: Path, rate: int, *more: str) -> list[str]:
    program = module_command("gateway", "upload", "--logs", str(logs), "--store", f"file://{store}")
    return [*program, "--rate", str(rate), *more]


@pytest.mark.usefixtures("beside_foreign_modules")
def test_what_is_killed_in_the_middle_is_done_again(tmp_path: Path) -> None:
    logs, store = tmp_path / "logs", tmp_path / "store"
    data = own_log([gears(0, 3, 0)], attachments=[("ballast", os.urandom(2_000_000))])
    saved(logs / LOG, data)
    manifest = store / "cruiser-1" / f"{LOG}.json"
    with subprocess.Popen(words(logs, store, 10_000)) as process:
        wait_until(manifest.exists)
        process.kill()
    assert not (store / "cruiser-1" / LOG).exists()
    assert b'"state":"uploading"' in manifest.read_bytes()
    done = subprocess.run(words(logs, store, 0, "--once"), check=False)
    assert done.returncode == ExitCode.OK
    assert (store / "cruiser-1" / LOG).read_bytes() == data
    assert b'"state":"verified"' in manifest.read_bytes()
    assert set(SafeLogReader(logs).read()) == {LOG}


def test_a_library_that_aborts_when_python_ends_makes_no_failure_of_an_upload(tmp_path: Path) -> None:
    """As obstore does sometimes on a busy machine."""
    logs, store = tmp_path / "logs", tmp_path / "store"
    saved(logs / LOG, own_log([gears(0, 3, 0)]))
    aborts = "import atexit, os, runpy; atexit.register(os.abort); runpy.run_module('gateway', None, '__main__')"
    interpreter, _, _, _, *command = words(logs, store, 0, "--once", "--json")
    done = subprocess.run([interpreter, "-c", aborts, *command], stdout=subprocess.PIPE, text=True, check=False)
    assert done.returncode == ExitCode.OK
    assert '"uploaded":1' in done.stdout


def test_it_ends_in_the_middle_when_it_is_told_to(tmp_path: Path) -> None:
    logs, store = tmp_path / "logs", tmp_path / "store"
    saved(logs / LOG, own_log([gears(0, 3, 0)], attachments=[("ballast", os.urandom(2_000_000))]))
    with subprocess.Popen(words(logs, store, 100, "--json"), stdout=subprocess.PIPE, text=True) as process:
        wait_until((store / "cruiser-1" / f"{LOG}.json").exists)
        process.send_signal(signal.SIGTERM)
        assert process.stdout is not None
        said = process.stdout.read()
    assert process.returncode == ExitCode.OK
    assert f'"waiting":["{LOG}"]' in said
