"""Real-time scheduling, and logging that never blocks."""

import logging
import os
import threading

import pytest

from gateway.host import process
from gateway.host.process import LINES_WAITING, logging_aside

log = logging.getLogger("test")


def test_a_refusal_is_logged_and_changes_nothing(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def refuse(_pid: int, _policy: int, _parameter: os.sched_param) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    with caplog.at_level(logging.INFO):
        assert process.request_realtime(10) is False
    assert "no real-time scheduling" in caplog.text


def test_real_time_priority_is_what_the_system_says_whoever_gave_it(monkeypatch: pytest.MonkeyPatch) -> None:
    for policy, is_realtime in (
        (os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, True),
        (os.SCHED_RR, True),
        (os.SCHED_OTHER, False),
        (os.SCHED_BATCH | os.SCHED_RESET_ON_FORK, False),
    ):
        monkeypatch.setattr(os, "sched_getscheduler", lambda _pid, policy=policy: policy)
        assert process.has_realtime() is is_realtime


class StuckHandler(logging.Handler):
    """A stderr whose pipe is full until ``free`` is set."""

    def __init__(self) -> None:
        super().__init__()
        self.free = threading.Event()
        self.lines: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.free.wait(10)
        self.lines.append(record.getMessage())


def test_who_logs_is_not_held_by_a_full_pipe() -> None:
    stuck, root = StuckHandler(), logging.getLogger()
    before = root.handlers[:]
    root.handlers = [stuck]
    try:
        with logging_aside():
            for number in range(2 * LINES_WAITING):
                log.warning("line %d", number)
            assert stuck.lines == []
            stuck.free.set()
        assert root.handlers == [stuck]
    finally:
        root.handlers = before
    numbers = [int(line.removeprefix("line ")) for line in stuck.lines]
    # One more line fits after the writer has taken the first.
    assert numbers[:LINES_WAITING] == list(range(LINES_WAITING))
    assert numbers == sorted(numbers)
    assert LINES_WAITING <= len(numbers) <= LINES_WAITING + 1
