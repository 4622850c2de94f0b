"""Answers requests for a backfill out of a directory of logs.

On a thread of its own: it must not hold up a recorder. Logs come and go meanwhile: parts grow and are renamed, old
logs are deleted. What cannot be read is left out, and the answer says so.
"""

from __future__ import annotations

import logging
import os
import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from queue import Empty, Full, Queue
from typing import BinaryIO, Final

import msgspec

from recorder.backfill.excerpt import Excerpt, LogCopy
from recorder.disk.log_directory import PART_SUFFIX, SUFFIX
from recorder.mcap.log_map import EARLY_NS, LATE_NS, LogMap
from schemas.printable import plain
from schemas.recording import Backfill, BackfillPiece

log = logging.getLogger(__name__)

REQUESTS_WAITING: Final = 4
"""Requests that may wait besides the one at work; beyond it they are refused."""

REQUEST_S: Final = 30.0
"""The time limit of one request; the rest of its answer has to be requested again."""

CHUNKS_REMEMBERED: Final = 200_000
"""Chunks of logs whose place is remembered for the next request: a day of a robot, some tens of MB at most."""

END_S: Final = 5.0
"""The wait at shutdown for an answer that is under way: the disk, or a link, may hang."""

PAUSE_S: Final = 0.001
"""After each chunk the thread leaves the interpreter to the recorder for so long."""

IDLE_S: Final = 0.2
"""The period in which the thread looks for the shutdown."""

Reply = Callable[[BackfillPiece], None]
Done = Callable[[], None]


class _Request(msgspec.Struct, frozen=True):
    request: Backfill
    reply: Reply
    done: Done


class BackfillServer:
    """Answers from its beginning to ``close``.

    Args:
        directory: the place of the logs.
        matches: True if a key expression matches a topic.
        clock_s: the time, for how long a request takes.
    """

    def __init__(
        self,
        directory: Path,
        matches: Callable[[str, str], bool],
        clock_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._directory = directory
        self._matches = matches
        self._clock_s = clock_s
        self._charts: OrderedDict[tuple[int, int], LogMap] = OrderedDict()
        self._waiting: Queue[_Request] = Queue(REQUESTS_WAITING)
        self._is_closed = threading.Event()
        self._thread = threading.Thread(target=self._run, name="backfill", daemon=True)
        self._thread.start()

    def submit(self, request: Backfill, reply: Reply, done: Done) -> None:
        """Take a request; this never waits.

        Args:
            request: the requested range.
            reply: called for each piece, on the server's thread, and may wait for the link; or at once, if the
                request is refused.
            done: called after the last one, whatever happened.
        """
        if request.from_ns >= request.to_ns:
            _refuse(request, reply, done, "there is no time from from_ns to to_ns")
        elif self._is_closed.is_set():
            _refuse(request, reply, done, "the recorder is ending")
        else:
            try:
                self._waiting.put_nowait(_Request(request, reply, done))
            except Full:
                _refuse(request, reply, done, "busy")

    def close(self) -> None:
        """End the answer that is under way, and refuse those that wait."""
        self._is_closed.set()
        self._thread.join(END_S)
        while (waiting := self._next(0)) is not None:
            _refuse(waiting.request, waiting.reply, waiting.done, "the recorder is ending")

    def _next(self, timeout_s: float) -> _Request | None:
        try:
            return self._waiting.get(timeout=timeout_s) if timeout_s else self._waiting.get_nowait()
        except Empty:
            return None

    def _run(self) -> None:
        while not self._is_closed.is_set():
            waiting = self._next(IDLE_S)
            if waiting is None:
                continue
            try:
                self._answer(waiting.request, waiting.reply)
            except Exception:
                # Whatever is wrong with one answer, the recorder goes on, and so does this thread.
                log.exception("a backfill of %s failed", plain(waiting.request.key))
            finally:
                waiting.done()

    def _answer(self, request: Backfill, reply: Reply) -> None:
        end_s = self._clock_s() + REQUEST_S

        def is_expired() -> bool:
            return self._is_closed.wait(PAUSE_S) or self._clock_s() >= end_s

        faults: list[str] = []
        logs: list[LogCopy] = []
        for path in self._paths():
            try:
                found = self._copy(path, request, is_expired)
            except FileNotFoundError:
                continue  # Deleted meanwhile: to make room is the recorder's right.
            except OSError as error:
                faults.append(f"{path.name}: {error.strerror or error}")
                continue
            if found is None:
                continue
            if not found.chart.is_complete:
                reply(_last(request, "there was no time to look through the logs; ask again"))
                return
            logs.append(found)
        excerpt = Excerpt(logs, lambda topic: self._matches(request.key, topic), request, is_expired)
        excerpt.faults += faults
        for piece in excerpt.pieces():
            reply(piece)

    def _paths(self) -> list[Path]:
        """The logs of the directory, the oldest first."""
        found: list[tuple[int, Path]] = []
        for path in [*self._directory.glob(f"*{SUFFIX}"), *self._directory.glob(f"*{PART_SUFFIX}")]:
            with suppress(FileNotFoundError):  # It has just become whole, or was deleted.
                found.append((path.stat().st_mtime_ns, path))
        return [path for _, path in sorted(found)]

    def _copy(self, path: Path, request: Backfill, is_expired: Callable[[], bool]) -> LogCopy | None:
        """The log there with its map, unless nothing in it can be of that time."""
        with _open(path) as stream:
            status = os.fstat(stream.fileno())
            if status.st_mtime_ns < request.from_ns - EARLY_NS:
                return None
            chart = self._chart((status.st_dev, status.st_ino))
            if not chart.is_complete:
                # Its first chunk tells when it begins: no need to go through one that begins later.
                chart.read_on(stream, status.st_size, is_expired, chunks_max=1)
                if len(chart) and chart.start_ns > request.to_ns + LATE_NS:
                    return None
            chart.read_on(stream, status.st_size, is_expired)
        return LogCopy(path.name, lambda: _open(path), chart)

    def _chart(self, file: tuple[int, int]) -> LogMap:
        """The map of a file, as far as it is known; the newest are remembered."""
        chart = self._charts.pop(file, None) or LogMap()
        self._charts[file] = chart
        while len(self._charts) > 1 and sum(map(len, self._charts.values())) > CHUNKS_REMEMBERED:
            self._charts.popitem(last=False)
        return chart


def _open(path: Path) -> BinaryIO:
    """A log, which may have become whole meanwhile and lost the end of its name."""
    try:
        return path.open("rb")
    except FileNotFoundError:
        if not path.name.endswith(PART_SUFFIX):
            raise
        return path.with_name(path.name.removesuffix(PART_SUFFIX) + SUFFIX).open("rb")


def _refuse(request: Backfill, reply: Reply, done: Done, detail: str) -> None:
    try:
        reply(msgspec.structs.replace(_last(request, detail), ok=False))
    finally:
        done()


def _last(request: Backfill, detail: str) -> BackfillPiece:
    return BackfillPiece(ok=True, detail=detail, mcap=b"", messages=0, next_ns=request.from_ns, is_last=True)
