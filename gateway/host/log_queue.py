"""Logging that never holds who logs: lines wait in a queue, and a thread of their own writes them."""

from __future__ import annotations

import logging
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from logging.handlers import QueueHandler
from queue import Full, Queue
from typing import Final

LINES_WAITING: Final = 1000
"""Beyond it lines are lost: a full pipe behind stderr must not hold the loop."""


END_TIMEOUT_S: Final = 1.0
"""A pipe that stays full does not keep the process from ending."""


class _Aside(QueueHandler):
    def enqueue(self, record: logging.LogRecord) -> None:
        try:
            self.queue.put_nowait(record)
        except Full:
            return


@contextmanager
def logging_aside() -> Iterator[None]:
    """Meanwhile what is logged goes through a queue to the handlers that there are."""
    root = logging.getLogger()
    handlers = root.handlers[:]
    waiting: Queue[logging.LogRecord | None] = Queue(LINES_WAITING)
    writer = threading.Thread(target=_write, args=(waiting, handlers), name="log-writer", daemon=True)
    root.handlers = [_Aside(waiting)]
    writer.start()
    try:
        yield
    finally:
        root.handlers = handlers
        with suppress(Full):
            waiting.put(None, timeout=END_TIMEOUT_S)
        writer.join(END_TIMEOUT_S)


def _write(waiting: Queue[logging.LogRecord | None], handlers: list[logging.Handler]) -> None:
    while (record := waiting.get()) is not None:
        for handler in handlers:
            if record.levelno >= handler.level:
                handler.handle(record)
