"""Questions to logs as processes."""

import asyncio
import os
import resource
from contextlib import suppress
from pathlib import Path

import pytest

from gateway.cli import desk_logs as jobs
from gateway.cli.desk_logs import ask_review
from recorder.cli.review import QUESTIONS
from tests.support.processes.gateway import children
from tests.support.rigs.scenarios import front_bumper, recorded


def test_a_question_that_takes_too_long_is_given_up() -> None:
    before = children(os.getpid())
    done = asyncio.run(ask_review(["info", "/dev/zero"], seconds=0.05))
    assert (done.code, done.output) == (None, b"")
    assert done.fault == "no answer within 0 s: use 'cruiser review info'"
    assert children(os.getpid()) <= before  # one of another test may have ended

    async def go_away() -> None:
        await asyncio.wait_for(ask_review(["info", "/dev/zero"]), 0.05)

    with pytest.raises(TimeoutError):
        asyncio.run(go_away())
    assert children(os.getpid()) <= before  # one of another test may have ended


def test_where_no_process_can_be_started_the_answer_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.executable", "/nowhere/python")
    done = asyncio.run(ask_review(["info", "/dev/zero"]))
    assert (done.code, done.output) == (None, b"")
    assert done.fault == "cannot start a process: No such file or directory"


def test_a_sandbox_that_forbids_priorities_gets_its_answer(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The desk's systemd unit is one."""

    def refuse(*_words: int) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "setpriority", refuse)
    (tmp_path / "a.mcap").write_bytes(recorded(front_bumper))
    assert asyncio.run(ask_review(["events", str(tmp_path)])).code == 0


@pytest.mark.usefixtures("beside_foreign_modules")
def test_an_answer_has_its_code_its_output_and_its_faults() -> None:
    done = asyncio.run(ask_review(["riddle"]))
    assert (done.code, done.output) == (2, b"")
    assert all(name in done.fault for name in QUESTIONS)


def test_an_answer_is_read_to_a_bound(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jobs, "SAID_BYTES", 10)
    (tmp_path / "a.mcap").write_bytes(recorded(front_bumper))
    done = asyncio.run(ask_review(["events", str(tmp_path), "--json"]))
    assert (done.code, len(done.output)) == (0, 10)


@pytest.mark.parametrize(("mib", "is_made"), [(2048, True), (16, False)])
def test_a_question_takes_so_much_memory_and_no_more(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mib: int, *, is_made: bool
) -> None:
    monkeypatch.setattr(jobs, "JOB_BYTES", mib << 20)
    log, report = tmp_path / "a.mcap", tmp_path / "report.html"
    log.write_bytes(recorded(front_bumper))
    done = asyncio.run(ask_review(["report", str(log), "-o", str(report)]))
    assert (done.code == 0) is is_made
    assert done.output or done.fault
    assert report.is_file() is is_made


def test_a_question_has_a_low_priority_and_so_much_processor_time() -> None:
    before = children(os.getpid())

    async def look() -> tuple[int, tuple[int, int]]:
        asking = asyncio.create_task(ask_review(["info", "/dev/zero"], seconds=7.0))
        try:
            while not (new := children(os.getpid()) - before):  # noqa: ASYNC110 - nothing says when it has started
                await asyncio.sleep(0)
            (child,) = new
            while resource.prlimit(child, resource.RLIMIT_CPU)[0] < 0:  # noqa: ASYNC110 - nor when it is bounded
                await asyncio.sleep(0)
            return os.getpriority(os.PRIO_PROCESS, child), resource.prlimit(child, resource.RLIMIT_CPU)
        finally:
            asking.cancel()
            with suppress(asyncio.CancelledError):
                await asking

    assert asyncio.run(asyncio.wait_for(look(), 60)) == (jobs.NICENESS, (7, 7 + int(jobs.END_S)))


def test_a_question_that_is_ended_from_outside_is_no_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jobs, "module_command", lambda *_: ("/bin/sh", "-c", "echo half; kill -XCPU $$"))
    done = asyncio.run(ask_review(["info"]))
    assert (done.code, done.output) == (None, b"")
    assert "was ended by signal" in done.fault
