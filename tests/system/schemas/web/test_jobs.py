"""Questions to logs as processes of their own."""

import asyncio
from pathlib import Path

import pytest

from recorder.cli.review.command import QUESTIONS
from schemas.web import jobs
from schemas.web.jobs import ask_review
from tests.support.rigs.scenarios import front_bumper, recorded


def children() -> set[str]:
    """The processes that this one has started."""
    return {
        child for task in Path("/proc/self/task").iterdir() for child in (task / "children").read_text().split()
    }


def test_a_question_that_takes_too_long_is_given_up() -> None:
    """It says so, and no process is left; nor is one where whoever asked went away."""
    before = children()
    done = asyncio.run(ask_review(["info", "/dev/zero"], seconds=0.05))
    assert (done.code, done.output) == (None, b"")
    assert done.fault == "no answer within 0 s: ask 'cruiser review info' itself"
    assert children() <= before  # one of another test may have ended

    async def go_away() -> None:
        await asyncio.wait_for(ask_review(["info", "/dev/zero"]), 0.05)

    with pytest.raises(TimeoutError):
        asyncio.run(go_away())
    assert children() <= before  # one of another test may have ended


def test_where_no_process_can_be_started_the_answer_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is one that whoever asked can show, and nothing that ends a server."""
    monkeypatch.setattr("sys.executable", "/nowhere/python")
    done = asyncio.run(ask_review(["info", "/dev/zero"]))
    assert (done.code, done.output) == (None, b"")
    assert done.fault == "no process can be started: No such file or directory"


@pytest.mark.usefixtures("beside_foreign_modules")
def test_an_answer_has_its_code_its_output_and_its_faults() -> None:
    """Those of a question that does not exist: a line that names all."""
    done = asyncio.run(ask_review(["riddle"]))
    assert (done.code, done.output) == (2, b"")
    assert all(name in done.fault for name in QUESTIONS)


def test_an_answer_is_read_to_a_bound(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The rest goes nowhere, and holds up nothing."""
    monkeypatch.setattr(jobs, "SAID_BYTES", 10)
    (tmp_path / "a.mcap").write_bytes(recorded(front_bumper))
    done = asyncio.run(ask_review(["events", str(tmp_path), "--json"]))
    assert (done.code, len(done.output)) == (0, 10)


def test_a_file_is_written_to_a_bound(tmp_path: Path) -> None:
    """What would be longer is not there at all, and a line says why."""
    log, part = tmp_path / "a.mcap", tmp_path / "part.mcap"
    log.write_bytes(recorded(front_bumper))
    done = asyncio.run(ask_review(["cut", str(log), "-o", str(part)], file_bytes=10_000))
    assert done.code
    assert "File too large" in done.fault
    assert not part.exists()
