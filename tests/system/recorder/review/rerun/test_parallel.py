"""Logs run again by several processes."""

import os
from pathlib import Path

import pytest

from recorder.reading.configurations import Configurations
from recorder.reading.faults import Faults
from recorder.reading.logs import find_logs
from recorder.review.rerun.parallel import RerunTask, rerun_in_parallel, run_task
from recorder.review.rerun.segments import WHOLE
from recorder.review.tasks import outcome_of, processes
from schemas.exit_codes import CommandError, ExitCode
from tests.support.commands import review
from tests.support.waiting import wait_until
from tests.unit.recorder.review.rerun.test_parallel import LENGTH_NS, NAME, Change, alone, changed, day_log


@pytest.mark.night
def test_processes_do_it(tmp_path: Path) -> None:
    """Two robots at a time, in segments."""
    for robot in ("a", "b"):
        (tmp_path / f"{robot}-20260102T030405Z.mcap").write_bytes(
            day_log().replace(b"cruiser-1", robot.encode() * 9)
        )
    faults = Faults()
    logs = find_logs([tmp_path], faults)
    told: list[int] = []
    results = list(rerun_in_parallel(logs, faults, 2, segment_ns=LENGTH_NS, progress=told.append))
    assert results == alone(tmp_path)[0]
    assert [one.robot for one in results] == ["a" * 9, "b" * 9]
    assert sum(told) == pytest.approx(2 * sum(one.bytes for one in logs), rel=0.01)


@pytest.mark.usefixtures("beside_foreign_modules")
def test_the_command_says_the_same_with_several_processes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of each robot, in the order of their names; also of what is damaged."""
    for robot in ("a", "b"):
        # The attachments' checksums are wrong then.
        (tmp_path / f"{robot}.mcap").write_bytes(day_log().replace(b"cruiser-1", robot.encode() * 9))
    codes, said = zip(
        *[(review("rerun", tmp_path, f"--jobs={jobs}", "--json"), capsys.readouterr()) for jobs in (1, 2)],
        strict=True,
    )
    assert codes == (ExitCode.PARTIAL, ExitCode.PARTIAL)
    assert said[0].out == said[1].out
    assert sorted(said[0].err.splitlines()) == sorted(said[1].err.splitlines())
    assert len(said[0].out.splitlines()) == 2


def test_a_process_that_is_killed_is_one_clear_error() -> None:
    """No answer is not the answer that all is the same."""
    with processes(1) as pool, pytest.raises(CommandError, match="was killed"):
        outcome_of(pool.submit(os._exit, 9), lambda _: None)


def test_whoever_stops_it_does_not_wait(tmp_path: Path) -> None:
    """What runs ends in the midst of its reading, what waits is not begun."""
    path = changed(tmp_path / NAME, Change(1).nothing)
    faults = Faults()
    task = RerunTask("cruiser-1", find_logs([path], faults), Configurations([], []), WHOLE)
    with processes(1) as pool:
        futures = [pool.submit(run_task, task) for _ in range(8)]
        wait_until(futures[0].running)
    assert isinstance(futures[0].exception(), KeyboardInterrupt)
    assert futures[-1].cancelled()
