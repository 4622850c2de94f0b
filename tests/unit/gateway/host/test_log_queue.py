"""Logging that never holds who logs."""

import logging
import threading

from gateway.host.process import LINES_WAITING, logging_aside

log = logging.getLogger("test")


class StuckHandler(logging.Handler):
    """A stderr whose pipe is full, until it is let go."""

    def __init__(self) -> None:
        super().__init__()
        self.free = threading.Event()
        self.lines: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.free.wait(10)
        self.lines.append(record.getMessage())


def test_who_logs_is_not_held_by_a_full_pipe() -> None:
    """What waits is bounded; the rest is lost; all that waited comes out in its order."""
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
    # The writer takes the first when it comes to it: one more finds room, whichever it is.
    assert numbers[:LINES_WAITING] == list(range(LINES_WAITING))
    assert numbers == sorted(numbers)
    assert LINES_WAITING <= len(numbers) <= LINES_WAITING + 1
