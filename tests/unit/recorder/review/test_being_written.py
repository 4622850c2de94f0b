"""A log that is being written, to every question: that it has no end yet is no fault."""

import fcntl
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from recorder.reading.logs import Faults, LogFile, find_logs
from recorder.reading.rows import Selection, read_rows
from recorder.reading.survey import survey
from recorder.review.columns import read_batches
from recorder.review.events import read_events
from recorder.review.query import topics_of
from recorder.review.report.gather import read_report
from recorder.review.why import explain
from tests.support.messages import ROBOT
from tests.support.rigs.recorded import RecordedRig

QUESTIONS: dict[str, Callable[[Sequence[LogFile], Faults], object]] = {
    "rows": lambda logs, faults: list(read_rows(logs, Selection(lambda _: True), faults)),
    "columns": lambda logs, faults: list(read_batches(logs[0], Selection(lambda _: True), faults)),
    "topics": lambda logs, faults: topics_of(logs[0], faults),
    "events": lambda logs, faults: list(read_events(logs, Selection(), faults)),
    "why": lambda logs, faults: explain(ROBOT, logs, survey(logs, faults), None, faults),
    "report": lambda logs, faults: read_report(logs, Selection(), faults),
}


@pytest.fixture(scope="module")
def data() -> bytes:
    """A log that ends within a record, as one does that is being written."""
    rig, _ = RecordedRig.driving()
    rig.rest_after(1.0)
    log = rig.log()
    return log[: len(log) * 9 // 10]


@pytest.mark.parametrize("question", QUESTIONS)
def test_a_log_that_is_being_written_is_not_damaged(question: str, data: bytes, tmp_path: Path) -> None:
    """While a recorder holds its lock; without one, its recorder has died."""
    path = tmp_path / "log.mcap.part"
    path.write_bytes(data)
    with path.open("rb") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        growing = Faults()
        QUESTIONS[question](find_logs([path], growing), growing)
    assert growing.told == []
    left = Faults()
    QUESTIONS[question](find_logs([path], left), left)
    assert left
