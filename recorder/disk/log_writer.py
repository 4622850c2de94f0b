"""The writing thread and its queue: actions on the files of all logs, whatever the disk does meanwhile.

When a write fails, the file is cut back to its last whole chunk and ended, and the next one begins with the chunk
that failed; or, where the disk fails to keep what it had accepted, with all that it has not kept. That is held
until then, and when it is too much, writing ends. Unwritten data waits, up to a bound; beyond that the oldest
messages go, and are reported as lost.
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
    """Actions that wait, the oldest first."""

    def __init__(self, limit_bytes: int) -> None:
        self._limit_bytes = limit_bytes
        self._actions: deque[LogAction] = deque()
        self.bytes = 0  # memory of what waits
        self._misfits = 0  # chunks that can never fit, were everything else to go for them

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
        """Drop what is beyond the bound, and return it.

        First goes what can never fit. Then the oldest messages; and only when none is left, the metadata of single
        files. Which files there are, and what lasts, never goes.
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
        # Half of the bound may be what the disk has in hand.
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
"""Messages that may wait for the disk, before compression: a minute and more of a saturated bus."""

UNKEPT_SHARE: Final = 0.5
"""So much of what may wait may have been written already, and not be kept by the disk yet."""

NOTICES_MAX: Final = 10_000

RETRY_MIN_S: Final = 0.2
"""First pause before a file is begun again after a fault that came at once again; it doubles."""

RETRY_MAX_S: Final = 5.0  # the longest pause

FAULT: Final = "fault"
"""The reason in ``cruiser.continued`` of a file that was begun because another could not be written."""

END_S: Final = 10.0  # longest wait of the end for a disk that makes no progress


class _Chain:
    """The files of one log, one after the other."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.prologue = Prologue()
        self.file: PartFile | None = None
        self.wanted: OpenLog | None = None
        """The file that is to be written, or to be continued in another one after a fault; None if none is."""
        self.submitted = self.opened = 0  # files that were asked for, and of those the ones whose turn has come
        self.is_incident = False

    @property
    def is_begun(self) -> bool:
        """True if the newest file that was asked for is being written."""
        return self.file is not None and self.opened == self.submitted

    def beginning_ns(self, first: WriteChunk) -> int:
        """Time in the name of a file that begins with this chunk, after a fault.

        An incident's is the time of the incident, which its first messages come before.
        """
        start_ns = first.chunk.start_ns
        return max(start_ns, self.wanted.wall_ns) if self.is_incident and self.wanted is not None else start_ns


class LogWriter:
    """Writes the files of several logs on a thread of its own, from its beginning to ``close``.

    Args:
        queue_bytes: messages that may wait, and be written but not kept yet, of all logs together.
    """

    def __init__(self, directory: LogDirectory, library: str, queue_bytes: int = QUEUE_BYTES) -> None:
        self._directory = directory
        self._library = library
        self._unkept_max = int(UNKEPT_SHARE * queue_bytes)
        self._queue = LogQueue(queue_bytes)
        self._unkept_bytes = 0
        # Its lock is entered again where the writing thread, which holds it, looks through the files.
        self._changed = threading.Condition()
        self._is_closing = False
        self._chains: dict[str, _Chain] = {}
        self._failed: deque[str] = deque()  # logs of which a sync has failed
        self._ending: dict[str, LogAction] = {}
        """At the end: the logs whose file is to be ended when all is written."""
        self._progress = 0  # changes with everything that the disk gets on with
        self._pause_s = 0.0
        self._is_faulty = False
        self._fault: BaseException | None = None
        self._notices: deque[Notice] = deque(maxlen=NOTICES_MAX)
        self._losses: dict[str, Lost] = {}
        self._left: deque[Path] = deque(maxlen=NOTICES_MAX)  # files with messages that could not be made whole
        self.path: str | None = None  # the newest file with anything in it
        self.files = 0
        self.bytes = 0  # bytes of the files that are ended; ``files`` of them
        self.lost = 0  # messages that were received, and that the disk did not take or keep
        self.is_hung = False  # the disk did not answer at the end: what it was given last may be lost, too
        self._thread = threading.Thread(target=self._run, name="log writer", daemon=True)
        self._thread.start()

    @property
    def waiting_bytes(self) -> int:
        return self._queue.bytes

    @property
    def sizes(self) -> dict[str, int]:
        """Bytes of the present file of each log, as far as it is begun.

        A log that is not here waits for the disk to begin its file: to end it already would only add to it.
        """
        return {chain.name: file.size for chain, file in self._files() if chain.is_begun}

    @property
    def parts(self) -> frozenset[str]:
        """The names of the files that are being written, as they are now."""
        return frozenset(file.path.name for _, file in self._files())

    @property
    def unfinished(self) -> int:
        """Files with messages that could not be made whole, nor recovered since. Asks the disk."""
        return sum(path.exists() for path in self._left)

    def _files(self) -> list[tuple[_Chain, PartFile]]:
        """The files that are being written; on any thread."""
        with self._changed:
            return [(chain, file) for chain in self._chains.values() if (file := chain.file) is not None]

    def notices(self) -> Iterable[Notice]:
        with self._changed:
            losses, self._losses = self._losses, {}
        yield from losses.values()
        while self._notices:
            yield self._notices.popleft()

    def submit(self, actions: Iterable[LogAction]) -> None:
        """Have these applied, in order. Never waits for the disk."""
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
        """Have the disk take what waits, as long as it gets on with it; what it does not take is lost."""
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
            log.error("the disk does not answer; the logs are not ended")
        elif self._fault is not None:
            raise self._fault

    def _trim(self) -> None:
        for action in self._queue.trim(self._unkept_bytes):
            self._lose(action)

    def _lose(self, action: LogAction) -> None:
        """Report an action that is not applied as a loss; the lock is held."""
        if not isinstance(action, WriteChunk):
            return
        chunk, name = action.chunk, action.log
        if self._chains[name].is_incident:
            log.error("the disk takes too little: an incident lacks messages")
            return
        if not self.lost:
            log.error("the disk takes too little: the oldest messages that wait for it are lost")
        self.lost += sum(chunk.counts.values())
        before = self._losses.get(name, Lost(name, {}, chunk.start_ns, chunk.end_ns))
        # One for all that is lost of a log until it is asked for: however much that is, none is forgotten.
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
        """The action whose turn it is; None at the end."""
        with self._changed:
            while True:
                if self._failed:
                    # Any action on the file raises the failure.
                    return SyncLog(self._failed.popleft())
                if self._queue and isinstance(self._queue.head, WriteChunk) and not self._has_room():
                    self._changed.wait()
                    continue
                if self._queue and self._is_stuck(self._queue.head):
                    # It waits in the queue, not in hand: the oldest are the first to go, perhaps all of them.
                    self._pause()
                if self._queue:
                    return self._queue.take()
                if self._is_closing:
                    return None
                self._changed.wait()

    def _is_stuck(self, action: LogAction) -> bool:
        return self._is_faulty and isinstance(action, WriteChunk) and self._chains[action.log].file is None

    def _has_room(self) -> bool:
        """True if more may be written before the disk has kept some. Where it may not, asks for syncs."""
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
        """On a thread of the syncs: note that the disk has kept something, or failed to."""
        with self._changed:
            self._progress += 1
            if file.has_failed:
                self._failed.append(chain.name)
            self._changed.notify()

    def _put_back(self, actions: Iterable[LogAction]) -> None:
        """Have these wait again, as the oldest."""
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
            # What the file before could not keep goes into another one, before this one.
            self._put_back([*again, *([ending] if ending is not None else []), action])
            return
        chain.wanted = action
        chain.opened += 1
        if action.is_incident:
            of_log = self._chains.get(action.name)
            chain.prologue = of_log.prologue.copy() if of_log is not None else Prologue()
        self._begin(chain, action.wall_ns)

    def _write(self, chain: _Chain, action: LogAction) -> CommandError | None:
        """Apply an action to the present file, if there is one. Returns why the disk does not take it."""
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
        """After an action was applied, or not: have wait again what is to be written again."""
        file = chain.file
        again: list[LogAction] = []
        is_chunk, is_end = isinstance(action, WriteChunk), isinstance(action, CloseLog)
        if error is not None:
            log.error("%s; the log goes on in another file", error)
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
        """At the end, when all is written: end the files of many logs at once."""
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
        """Before a file is begun again: at once after the first fault, then ever more seldom."""
        end_s = time.monotonic() + self._pause_s
        while not self._is_closing and (left_s := end_s - time.monotonic()) > 0:
            self._changed.wait(left_s)
        self._pause_s = min(max(2 * self._pause_s, RETRY_MIN_S), RETRY_MAX_S)

    def _enter_fault(self, detail: str) -> None:
        for _, file in self._files():
            # What it has kept until now says nothing of what is to come.
            file.has_synced = False
        if not self._is_faulty:
            self._is_faulty = True
            self._notices.append(DiskFault(detail))

    def _clear_fault(self) -> None:
        self._pause_s = 0.0
        if self._is_faulty:
            self._is_faulty = False
            log.warning("the disk takes the logs again; %d messages are lost", self.lost)
            self._notices.append(DiskBack())

    def _begin(self, chain: _Chain, wall_ns: int, because: str = "") -> None:
        """Begin the file that is wanted, with all that those before it declared, if the disk takes it.

        Args:
            because: why it continues what another file should have held, if it does.
        """
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
                # Nobody knows of it yet.
                file.salvage()
                raise
        except CommandError as error:
            if self._pause_s <= RETRY_MIN_S:
                log.error("%s; trying on", error)  # noqa: TRY400 - a full disk is no bug
            self._enter_fault(str(error))
            return
        chain.file = file
        file.when_synced = partial(self._note_sync, chain, file)
        log.info("writing %s", file.path)
        self._notices.append(Opened(chain.name, file.name))

    def _leave(self, chain: _Chain) -> list[WriteChunk]:
        """End the present file of a log, as well as can be. Returns what the disk has not kept of it."""
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
