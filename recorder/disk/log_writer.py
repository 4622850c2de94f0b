"""The writing thread and its queue: actions on the files of all logs.

After a failed write the file is cut back to its last whole chunk and ended, and the next file begins with the
chunk that failed. After a failed sync it begins with all chunks that were not synced; these stay in memory until
they are, and writing pauses when they reach a limit. Unwritten data waits in a bounded queue: beyond the bound the
oldest messages are dropped, and reported as lost.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Final

from recorder.disk.files import SYNC_THREADS, LogDirectory, PartFile, Prologue
from recorder.record.actions import (
    CloseLog,
    DiskBack,
    DiskFault,
    Ended,
    LogAction,
    Lost,
    Notice,
    Opened,
    OpenLog,
    SyncLog,
    WriteChunk,
    WriteMetadata,
)
from recorder.record.robot_log import CONTINUED_NAME
from schemas.command_line import CommandError


class LogQueue:
    """Waiting actions, the oldest first."""

    def __init__(self, limit_bytes: int) -> None:
        self._limit_bytes = limit_bytes
        self._actions: deque[LogAction] = deque()
        self.bytes = 0  # memory of the waiting actions
        self._misfits = 0  # chunks that can never fit

    def __len__(self) -> int:
        return len(self._actions)

    @property
    def head(self) -> LogAction:
        return self._actions[0]

    def put(self, action: LogAction) -> None:
        self._actions.append(action)
        self._count(action, 1)

    def put_back(self, actions: Iterable[LogAction]) -> None:
        for action in reversed(list(actions)):
            self._actions.appendleft(action)
            self._count(action, 1)

    def take(self) -> LogAction:
        action = self._actions.popleft()
        self._count(action, -1)
        return action

    def trim(self, other_bytes: int) -> list[LogAction]:
        """Drop actions beyond the bound, and return them.

        In order: chunks that can never fit, the oldest messages, metadata of single files. Opening and closing of
        files, and lasting metadata, are never dropped.
        """
        most = self._limit_bytes - other_bytes
        dropped: list[LogAction] = []
        if self.bytes > most and self._misfits:
            dropped += self._drop(most, self._is_misfit)
        if self.bytes > most:
            dropped += self._drop(most, lambda action: isinstance(action, WriteChunk | SyncLog))
        if self.bytes > most:
            dropped += self._drop(most, lambda action: isinstance(action, WriteMetadata) and not action.lasts)
        return dropped

    def _is_misfit(self, action: LogAction) -> bool:
        # Written but unsynced chunks may take half of the bound.
        return action.bytes > self._limit_bytes // 2 and isinstance(action, WriteChunk)

    def _count(self, action: LogAction, sign: int) -> None:
        self.bytes += sign * action.bytes
        self._misfits += sign * self._is_misfit(action)

    def _drop(self, most: int, may_go: Callable[[LogAction], bool]) -> list[LogAction]:
        dropped: list[LogAction] = []
        kept: list[LogAction] = []
        kept_bytes = 0
        while self._actions and self.bytes + kept_bytes > most:
            action = self.take()
            if may_go(action):
                dropped.append(action)
            else:
                kept.append(action)
                kept_bytes += action.bytes
        self.put_back(kept)
        return dropped


log = logging.getLogger(__name__)

QUEUE_BYTES: Final = 64 * 1024 * 1024
"""Messages that may wait for the disk, before compression: over a minute of a saturated bus."""

UNKEPT_SHARE: Final = 0.5  # Share of the queue limit that may be written but not yet synced.
NOTICES_MAX: Final = 10_000
RETRY_MIN_S: Final = 0.2  # first pause before a file is begun again after a repeated fault; it doubles
RETRY_MAX_S: Final = 5.0  # the longest pause
FAULT: Final = "fault"  # the reason in ``cruiser.continued`` of a file begun after another's fault
END_S: Final = 10.0  # at the end, longest wait for a disk that makes no progress


class _Chain:
    """The successive files of one log."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.prologue = Prologue()
        self.file: PartFile | None = None
        self.wanted: OpenLog | None = None
        """The file to write, or to continue in another one after a fault."""
        self.submitted = self.opened = 0  # files requested, and begun
        self.is_incident = False

    @property
    def is_begun(self) -> bool:
        """True if the newest requested file is being written."""
        return self.file is not None and self.opened == self.submitted

    def beginning_ns(self, first: WriteChunk) -> int:
        """Time in the name of a file that begins with this chunk after a fault; an incident keeps its own time."""
        start_ns = first.chunk.start_ns
        return max(start_ns, self.wanted.wall_ns) if self.is_incident and self.wanted is not None else start_ns


class LogWriter:
    """Writes the files of several logs on its own thread until ``close``.

    Args:
        queue_bytes: limit of the messages of all logs that wait, or are written but not synced.
    """

    def __init__(self, directory: LogDirectory, library: str, queue_bytes: int = QUEUE_BYTES) -> None:
        self._directory = directory
        self._library = library
        self._unkept_max = int(UNKEPT_SHARE * queue_bytes)
        self._queue = LogQueue(queue_bytes)
        self._unkept_bytes = 0
        # Reentrant: the writing thread may hold it when it looks through the files.
        self._changed = threading.Condition()
        self._is_closing = False
        self._chains: dict[str, _Chain] = {}
        self._failed: deque[str] = deque()  # logs with a failed sync
        self._ending: dict[str, LogAction] = {}  # at the end: logs whose file is ended when all is written
        self._progress = 0  # changes with every progress of the disk
        self._pause_s = 0.0
        self._is_faulty = False
        self._fault: BaseException | None = None
        self._notices: deque[Notice] = deque(maxlen=NOTICES_MAX)
        self._losses: dict[str, Lost] = {}
        self._left: deque[Path] = deque(maxlen=NOTICES_MAX)  # files with messages that could not be finished
        self.path: str | None = None  # the newest file with messages
        self.files = 0
        self.bytes = 0  # total size of the ended files; ``files`` of them
        self.lost = 0  # messages that were received and not stored
        self.is_hung = False  # the disk did not respond at the end: the data written last may be lost, too
        self._thread = threading.Thread(target=self._run, name="log writer", daemon=True)
        self._thread.start()

    @property
    def waiting_bytes(self) -> int:
        return self._queue.bytes

    @property
    def sizes(self) -> dict[str, int]:
        """Size of each log's current file, if the disk has begun it."""
        return {chain.name: file.size for chain, file in self._files() if chain.is_begun}

    @property
    def parts(self) -> frozenset[str]:
        """The current names of the open files."""
        return frozenset(file.path.name for _, file in self._files())

    @property
    def unfinished(self) -> int:
        """Number of files with messages that were neither finished nor recovered since. Accesses the disk."""
        return sum(path.exists() for path in self._left)

    def _files(self) -> list[tuple[_Chain, PartFile]]:
        """The open files; callable on any thread."""
        with self._changed:
            return [(chain, file) for chain in self._chains.values() if (file := chain.file) is not None]

    def notices(self) -> Iterable[Notice]:
        with self._changed:
            losses, self._losses = self._losses, {}
        yield from losses.values()
        while self._notices:
            yield self._notices.popleft()

    def submit(self, actions: Iterable[LogAction]) -> None:
        """Queue actions, in order. Never waits for the disk."""
        with self._changed:
            if self._fault is not None:
                raise self._fault
            for action in actions:
                chain = self._chains.get(action.log)
                if chain is None:
                    chain = self._chains[action.log] = _Chain(action.log)
                if isinstance(action, OpenLog):
                    chain.submitted += 1
                    chain.is_incident = action.is_incident
                self._queue.put(action)
            self._trim()
            self._changed.notify()

    def close(self) -> None:
        """Write the waiting actions while the disk makes progress; the rest is lost."""
        with self._changed:
            self._is_closing = True
            self._changed.notify()
        while self._thread.is_alive() and not self.is_hung:
            before = self._progress
            self._thread.join(END_S)
            self.is_hung = self._thread.is_alive() and self._progress == before
        if self.is_hung:
            with self._changed:
                while self._queue:
                    self._lose(self._queue.take())
            log.error("the disk does not respond; the logs are not finished")
        elif self._fault is not None:
            raise self._fault

    def _trim(self) -> None:
        for action in self._queue.trim(self._unkept_bytes):
            self._lose(action)

    def _lose(self, action: LogAction) -> None:
        """Report a dropped action as a loss; the lock is held."""
        if not isinstance(action, WriteChunk):
            return
        chunk, name = action.chunk, action.log
        if self._chains[name].is_incident:
            log.error("the disk is too slow: an incident lacks messages")
            return
        if not self.lost:
            log.error("the disk is too slow: the oldest waiting messages are lost")
        self.lost += sum(chunk.counts.values())
        before = self._losses.get(name, Lost(name, {}, chunk.start_ns, chunk.end_ns))
        # One notice sums up a log's losses until it is read: bounded memory, and no loss is forgotten.
        self._losses[name] = Lost(
            name,
            dict(Counter(before.counts) + Counter(chunk.counts)),
            min(before.first_ns, chunk.start_ns),
            max(before.last_ns, chunk.end_ns),
        )

    def _run(self) -> None:
        try:
            while (action := self._next()) is not None or self._ending:
                if action is None:
                    self._end_files()
                else:
                    self._apply(action)
                self._progress += 1
        except BaseException as error:  # noqa: BLE001 - the loop raises it
            self._fault = error
        finally:
            for chain in self._chains.values():
                unkept = self._leave(chain)
                with self._changed:
                    for chunk in unkept:
                        self._lose(chunk)
            self._directory.close()

    def _next(self) -> LogAction | None:
        """The next action; None at the end."""
        with self._changed:
            while True:
                if self._failed:
                    # Any action on the file raises the failure.
                    return SyncLog(self._failed.popleft())
                if self._queue and isinstance(self._queue.head, WriteChunk) and not self._has_room():
                    self._changed.wait()
                    continue
                if self._queue and self._is_faulty:
                    head = self._queue.head
                    # A chunk without a file waits in the queue, so that it may be dropped as the oldest.
                    if isinstance(head, WriteChunk) and self._chains[head.log].file is None:
                        self._pause()
                if self._queue:
                    return self._queue.take()
                if self._is_closing:
                    return None
                self._changed.wait()

    def _has_room(self) -> bool:
        """True if more may be written before the next sync. Starts syncs if not."""
        if self._unkept_bytes < self._unkept_max:
            return True
        files = [file for _, file in self._files() if file.unkept_bytes]
        for file in files:
            file.release()
        self._unkept_bytes = sum(file.unkept_bytes for file in files)
        if self._unkept_bytes < self._unkept_max:
            return True
        for file in files:
            if file.unkept_bytes:
                file.sync()
        return False

    def _note_sync(self, chain: _Chain, file: PartFile) -> None:
        """On a sync thread: note the end of a sync."""
        with self._changed:
            self._progress += 1
            if file.has_failed:
                self._failed.append(chain.name)
            self._changed.notify()

    def _put_back(self, actions: Iterable[LogAction]) -> None:
        """Put actions back to the front of the queue."""
        again = []
        with self._changed:
            for action in actions:
                if isinstance(action, WriteChunk) and self._is_closing and self._pause_s > RETRY_MIN_S:
                    self._lose(action)
                else:
                    again.append(action)
            self._queue.put_back(again)
            self._trim()

    def _apply(self, action: LogAction) -> None:
        chain = self._chains[action.log]
        if isinstance(action, OpenLog):
            self._open(chain, action)
            return
        chain.prologue.add(action)
        if isinstance(action, CloseLog) and self._is_closing and chain.file is not None:
            self._ending[chain.name] = action
            return
        if isinstance(action, WriteChunk) and chain.file is None:
            self._begin(chain, chain.beginning_ns(action), FAULT)
        self._settle(chain, action, self._write(chain, action))

    def _open(self, chain: _Chain, action: OpenLog) -> None:
        ending = self._ending.pop(chain.name, None)
        again: list[LogAction] = [*self._leave(chain)]
        if again:
            # The unsynced chunks of the previous file go into another one, before this one.
            self._put_back([*again, *([ending] if ending is not None else []), action])
            return
        chain.wanted = action
        chain.opened += 1
        if action.is_incident:
            of_log = self._chains.get(action.name)
            chain.prologue = of_log.prologue.copy() if of_log is not None else Prologue()
        self._begin(chain, action.wall_ns)

    def _write(self, chain: _Chain, action: LogAction) -> CommandError | None:
        """Apply an action to the current file, if there is one. Returns the error, if any."""
        file = chain.file
        if file is None:
            return None
        before = file.unkept_bytes
        try:
            file.write(action)
        except CommandError as error:
            return error
        finally:
            self._unkept_bytes += file.unkept_bytes - before
        return None

    def _settle(self, chain: _Chain, action: LogAction, error: CommandError | None) -> None:
        """After an action: queue again what has to be written again."""
        file = chain.file
        again: list[LogAction] = []
        is_chunk, is_end = isinstance(action, WriteChunk), isinstance(action, CloseLog)
        if error is not None:
            log.error("%s; the log continues in another file", error)
            self._enter_fault(str(error))
            again += self._leave(chain)
            if again and not is_chunk:
                again.append(action if is_end else SyncLog(chain.name))
        elif file is not None and file.has_synced:
            file.has_synced = False
            self._clear_fault()
        if is_chunk and (file is None or error is not None):
            again.append(action)
        if again:
            self._put_back(again)
        elif is_end:
            self._leave(chain)
            chain.wanted = None

    def _end_files(self) -> None:
        """At the end, when all is written: end all files at once."""
        ending, self._ending = self._ending, {}
        with ThreadPoolExecutor(SYNC_THREADS, "log end") as pool:
            errors = list(pool.map(self._end_file, ending.values()))
        self._unkept_bytes = sum(file.unkept_bytes for _, file in self._files())
        for action, error in zip(ending.values(), errors, strict=True):
            self._settle(self._chains[action.log], action, error)

    def _end_file(self, action: LogAction) -> CommandError | None:
        file = self._chains[action.log].file
        try:
            if file is not None:
                file.write(action)
        except CommandError as error:
            return error
        finally:
            self._progress += 1
        return None

    def _pause(self) -> None:
        """Wait before a file is begun again: not after the first fault, then ever longer."""
        end_s = time.monotonic() + self._pause_s
        while not self._is_closing and (left_s := end_s - time.monotonic()) > 0:
            self._changed.wait(left_s)
        self._pause_s = min(max(2 * self._pause_s, RETRY_MIN_S), RETRY_MAX_S)

    def _enter_fault(self, detail: str) -> None:
        for _, file in self._files():
            # Earlier syncs do not show that the fault is over.
            file.has_synced = False
        if not self._is_faulty:
            self._is_faulty = True
            self._notices.append(DiskFault(detail))

    def _clear_fault(self) -> None:
        self._pause_s = 0.0
        if self._is_faulty:
            self._is_faulty = False
            log.warning("logs can be written again; %d messages were lost", self.lost)
            self._notices.append(DiskBack())

    def _begin(self, chain: _Chain, wall_ns: int, because: str = "") -> None:
        """Begin the wanted file with the prologue. ``because``: why it continues another file, if it does."""
        wanted = chain.wanted
        if wanted is None:
            return
        try:
            file = self._directory.open(wanted.name, wall_ns, self._library, is_incident=wanted.is_incident)
            try:
                file.begin(chain.prologue)
                if because:
                    file.write(WriteMetadata(chain.name, CONTINUED_NAME, {"because": because}))
            except CommandError:
                file.salvage()
                raise
        except CommandError as error:
            if self._pause_s <= RETRY_MIN_S:
                log.error("%s; retrying", error)  # noqa: TRY400 - a full disk is no bug
            self._enter_fault(str(error))
            return
        chain.file = file
        file.when_synced = partial(self._note_sync, chain, file)
        log.info("writing %s", file.path)
        self._notices.append(Opened(chain.name, file.name))

    def _leave(self, chain: _Chain) -> list[WriteChunk]:
        """End the current file of a log as far as possible. Returns its unsynced chunks."""
        file, chain.file = chain.file, None
        if file is None:
            return []
        self._unkept_bytes -= file.unkept_bytes
        unkept = file.salvage()
        if file.is_removed and file.kept_counts:
            if not chain.is_incident:
                with self._changed:
                    self.lost += file.kept_counts.total()
            span_ns = file.kept_from_ns, file.kept_to_ns
            self._notices.append(Lost(chain.name, dict(file.kept_counts), *span_ns, file.name))
        self._notices.append(Ended(chain.name, file.name, file.size))
        if file.is_left:
            self._left.append(file.path)
        if file.is_kept:
            if not chain.is_incident:
                self.path = str(file.path)
            self.files += 1
            self.bytes += file.size
        return unkept
