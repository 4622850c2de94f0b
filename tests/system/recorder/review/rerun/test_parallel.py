"""Logs rerun by several processes."""

import os
from pathlib import Path

import pytest

from recorder.reading.logs import Faults, find_logs
from recorder.review.tasks import look, outcome_of, processes
from recorder.review.what_if import TriedSettings, rerun_tasks, run_task
from schemas.command_line import CommandError, ExitCode
from tests.support.commands import review
from tests.support.messages import MS
from tests.support.rigs.day import restful_day
from tests.support.waiting import wait_until


@pytest.fixture(scope="module")
def day_log() -> bytes:
    return restful_day(1, rounds=2).rig.log(lag_ns=MS)


@pytest.mark.usefixtures("beside_foreign_modules")
def test_the_command_says_the_same_with_several_processes(
    day_log: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for robot in ("a", "b"):
        # The attachments' checksums are wrong then.
        (tmp_path / f"{robot}.mcap").write_bytes(day_log.replace(b"cruiser-1", robot.encode() * 9))
    codes, said = zip(
        *[(review("rerun", tmp_path, f"--processes={count}"), capsys.readouterr()) for count in (1, 2)],
        strict=True,
    )
    assert codes == (ExitCode.PARTIAL, ExitCode.PARTIAL)
    assert said[0].out == said[1].out
    assert sorted(said[0].err.splitlines()) == sorted(said[1].err.splitlines())
    assert said[0].out.splitlines()[-1] == "0 of 2 logs decide otherwise"


def test_a_process_that_is_killed_is_one_clear_error() -> None:
    with processes(1) as pool, pytest.raises(CommandError, match="was killed"):
        outcome_of(pool.submit(os._exit, 9), lambda _: None)


def test_whoever_stops_it_does_not_wait(day_log: bytes, tmp_path: Path) -> None:
    path = tmp_path / "cruiser-1-20260102T030405Z.mcap"
    path.write_bytes(day_log)
    (task,) = rerun_tasks(find_logs([path], Faults()), TriedSettings(None, "", {}), Faults())
    with processes(1) as pool:
        futures = [pool.submit(run_task, task, look) for _ in range(8)]
        wait_until(futures[0].running)
    assert isinstance(futures[0].exception(), KeyboardInterrupt)
    assert futures[-1].cancelled()
