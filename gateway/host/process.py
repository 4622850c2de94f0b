"""Real-time scheduling, logging that never blocks, and sd_notify(3)."""

from __future__ import annotations

import ctypes
import logging
import os
import socket
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from logging.handlers import QueueHandler
from queue import Full, Queue
from typing import Final, Self

from schemas.command_line import plain

log = logging.getLogger(__name__)

# From <sys/mman.h> on Linux. ONFAULT locks pages as they are touched, instead of all of every stack at once.
MCL_CURRENT: Final = 1
MCL_FUTURE: Final = 2
MCL_ONFAULT: Final = 4


def request_realtime(priority: int) -> bool:
    """Request SCHED_FIFO for the calling thread, and locked memory; nothing at priority 0.

    Returns True if SCHED_FIFO was granted. A refusal of either is only logged.
    """
    if priority == 0:
        return False
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
    except OSError as error:
        log.info("no real-time scheduling: %s", error)
        return False
    if ctypes.CDLL(None, use_errno=True).mlockall(MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT) != 0:
        log.info("no locked memory: %s", os.strerror(ctypes.get_errno()))
    return True


def has_realtime() -> bool:
    """Report whether the calling thread has a real-time policy, from any source."""
    return os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK in {os.SCHED_FIFO, os.SCHED_RR}


LINES_WAITING: Final = 1000
"""Queued log lines; further ones are dropped, so that a full stderr pipe never blocks the loop."""

END_TIMEOUT_S: Final = 1.0  # longest wait at the end for a pipe that stays full


class _Aside(QueueHandler):
    def enqueue(self, record: logging.LogRecord) -> None:
        try:
            self.queue.put_nowait(record)
        except Full:
            return


@contextmanager
def logging_aside() -> Iterator[None]:
    """Log through a queue to the present handlers, meanwhile."""
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


_SOCKET: Final = "NOTIFY_SOCKET"


class ServiceManager:
    """Sends datagrams to systemd's notification socket. Nothing blocks."""

    def __init__(self, address: str) -> None:
        """Open a socket; the address is a path, or an abstract name that begins with ``@``."""
        self._address = f"\0{address[1:]}" if address.startswith("@") else address
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
        self._socket.settimeout(0)
        self._is_ready = False
        self._status = ""

    @classmethod
    def of(cls, environment: Mapping[str, str]) -> Self | None:
        """Return the manager of this process; None if it asked for no notifications."""
        address = environment.get(_SOCKET, "")
        return cls(address) if address.startswith(("/", "@")) else None

    def alive(self, status: str) -> None:
        """Feed the watchdog, and send a changed status. The first call also reports readiness."""
        words = ["WATCHDOG=1"]
        if not self._is_ready:
            words.append("READY=1")
        if status != self._status:
            words.append(f"STATUS={plain(status)}")
        if self._send(words):
            self._is_ready, self._status = True, status

    def close(self) -> None:
        self._socket.close()

    def _send(self, words: list[str]) -> bool:
        try:
            self._socket.sendto("\n".join(words).encode(), self._address)
        except OSError:
            return False
        return True
