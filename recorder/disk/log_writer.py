"""The writer's thread: carries effects out on files, whatever the disk does, while the loop goes on receiving.

When a write fails, the file is cut back to its last whole chunk and ended, and the next one begins with the chunk
that failed; or, where the disk fails to keep what it had taken, with all that it has not kept. That is held until
then, and when it is too much no more is written. What is not written waits, up to a bound; beyond that the oldest
messages go, and are told.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import Counter, deque
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Final

from recorder.disk.log_chain import LogChain
from recorder.disk.log_directory import SYNC_THREADS, LogDirectory
from recorder.disk.log_file import LogFile
from recorder.record.effects import CloseLog, FileEffect, OnLog, OpenLog, SyncLog, WriteChunk
from recorder.record.log_queue import LogQueue, Waiting, waiting
from recorder.record.notices import DiskBack, DiskFault, Ended, Lost, Notice, Opened
from recorder.record.prologue import Prologue
from schemas.exit_codes import CommandError

log = logging.getLogger(__name__)

QUEUE_BYTES: Final = 64 * 1024 * 1024
"""Messages that may wait for the disk, before compression: a minute and more of a saturated bus."""

UNKEPT_SHARE: Final = 0.5
"""So much of what may wait may have been written already, and not be kept by the disk yet."""

NOTICES_MAX: Final = 10_000

RETRY_MIN_S: Final = 0.2
"""First pause before a file is begun again after a fault that came at once again; it doubles up to..."""

RETRY_MAX_S: Final = 5.0

FAULT: Final = "fault"
"""Why a file is begun after another could not be written, as ``cruiser.continued`` has it."""

END_S: Final = 10.0
"""How long the end waits for a disk that gets on with nothing."""


class LogWriter:
    """Writes the files of several logs on a thread of its own, from its beginning to ``close``.

    Args:
        directory: where files go.
        library: who writes, for the files' headers.
        queue_bytes: messages that may wait, and be written but not kept yet, of all logs together.
    """

    def __init__(self, directory: LogDirectory, library: str, queue_bytes: int = QUEUE_BYTES) -> None:
        self._directory = directory
        self._library = library
        self._unkept_max = int(UNKEPT_SHARE * queue_bytes)
        self._waiting = LogQueue(queue_bytes)
        self._unkept_bytes = 0
        self._changed = threading.Condition()
        self._is_closing = False
        self._chains: dict[str, LogChain] = {}
        self._failed: deque[str] = deque()
        """Logs of which a sync has failed."""
        self._ending: dict[str, Waiting] = {}
        """At the end: the logs whose file is to be ended when all is written."""
        self._progress = 0
        """Changes with everything that the disk gets on with."""
        self._pause_s = 0.0
        self._is_faulty = False
        self._fault: BaseException | None = None
        self._notices: deque[Notice] = deque(maxlen=NOTICES_MAX)
        self._losses: dict[str, Lost] = {}
        self._left: deque[Path] = deque(maxlen=NOTICES_MAX)
        """Files with messages that could not be made whole."""
        self.path: str | None = None
        """The newest file with anything in it."""
        self.files = 0
        self.bytes = 0
        """Bytes of the files that are ended; ``files`` of them."""
        self.lost = 0
        """Messages that were received, and that the disk did not take."""
        self.is_hung = False
        """The disk did not answer at the end: what it was given last may be lost, too."""
        self._thread = threading.Thread(target=self._run, name="log writer", daemon=True)
        self._thread.start()

    @property
    def waiting_bytes(self) -> int:
        """Bytes of what waits for the disk."""
        return self._waiting.bytes

    @property
    def sizes(self) -> dict[str, int]:
        """Bytes of the present file of each log, as far as it is begun.

        A log that is not here waits for the disk to begin its file: to end it already would only add to it.
        """
        with self._changed:
            chains = list(self._chains.values())
        return {chain.name: file.size for chain in chains if (file := chain.file) is not None and chain.is_begun}

    @property
    def parts(self) -> frozenset[str]:
        """The names of the files that are being written, as they are now."""
        with self._changed:
            chains = list(self._chains.values())
        return frozenset(file.path.name for chain in chains if (file := chain.file) is not None)

    @property
    def unfinished(self) -> int:
        """Files with messages that could not be made whole, nor recovered since. Asks the disk."""
        return sum(path.exists() for path in self._left)

    def notices(self) -> Iterable[Notice]:
        """What became of the files since the last call."""
        with self._changed:
            losses, self._losses = self._losses, {}
        yield from losses.values()
        while self._notices:
            yield self._notices.popleft()

    def submit(self, doing: OnLog) -> None:
        """Have these carried out, in order. Never waits for the disk.

        Raises:
            Exception: the thread has ended by a fault of our own.
        """
        with self._changed:
            if self._fault is not None:
                raise self._fault
            chain = self._chains.setdefault(doing.log, LogChain(doing.log))
            for effect in doing.effects:
                self._waiting.put(waiting(doing.log, effect))
                if isinstance(effect, OpenLog):
                    chain.submitted += 1
                    chain.is_incident = effect.is_incident
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
                while self._waiting:
                    self._lose(self._waiting.take())
            log.error("the disk does not answer; the logs are not ended")
        elif self._fault is not None:
            raise self._fault

    def _trim(self) -> None:
        for one in self._waiting.trim(self._unkept_bytes):
            self._lose(one)

    def _lose(self, one: Waiting) -> None:
        """It is not written; the lock is held."""
        if not isinstance(one.effect, WriteChunk):
            return
        chunk, name = one.effect.chunk, one.log
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
            while (one := self._next()) is not None or self._ending:
                if one is None:
                    self._end_files()
                else:
                    self._carry_out(one)
                self._progress += 1
        except BaseException as error:  # noqa: BLE001 - the loop raises it
            self._fault = error
        finally:
            for chain in self._chains.values():
                unkept = self._leave(chain)
                with self._changed:
                    for one in unkept:
                        self._lose(one)
            self._directory.close()

    def _next(self) -> Waiting | None:
        """What is to be carried out now; None at the end."""
        with self._changed:
            while True:
                if self._failed:
                    # To look at a file is to be told.
                    return waiting(self._failed.popleft(), SyncLog())
                if self._waiting and isinstance(self._waiting.head.effect, WriteChunk) and not self._has_room():
                    self._changed.wait()
                    continue
                if self._waiting and self._is_stuck(self._waiting.head):
                    # It waits in the queue, not in hand: the oldest are the first to go, perhaps all of them.
                    self._pause()
                if self._waiting:
                    return self._waiting.take()
                if self._is_closing:
                    return None
                self._changed.wait()

    def _is_stuck(self, one: Waiting) -> bool:
        return self._is_faulty and isinstance(one.effect, WriteChunk) and self._chains[one.log].file is None

    def _has_room(self) -> bool:
        """Whether more may be written before the disk has kept some, which it is told to do where it is not so."""
        if self._unkept_bytes < self._unkept_max:
            return True
        chains = [chain for chain in self._chains.values() if chain.unkept_bytes]
        for chain in chains:
            chain.release()
        self._unkept_bytes = sum(chain.unkept_bytes for chain in chains)
        if self._unkept_bytes < self._unkept_max:
            return True
        for chain in chains:
            if chain.unkept_bytes and chain.file is not None:
                chain.file.sync()
        return False

    def _tell_synced(self, chain: LogChain, file: LogFile) -> None:
        """On a thread of the syncs: the disk has kept something, or failed to."""
        with self._changed:
            self._progress += 1
            if file.has_failed:
                self._failed.append(chain.name)
            self._changed.notify()

    def _put_back(self, ones: Iterable[Waiting]) -> None:
        """These wait again, as the oldest."""
        again = []
        with self._changed:
            for one in ones:
                if isinstance(one.effect, WriteChunk) and self._is_closing and self._pause_s > RETRY_MIN_S:
                    self._lose(one)
                else:
                    again.append(one)
            self._waiting.put_back(again)
            self._trim()

    def _carry_out(self, one: Waiting) -> None:
        chain, effect = self._chains[one.log], one.effect
        if isinstance(effect, OpenLog):
            self._open(chain, one, effect)
            return
        chain.prologue.take(effect)
        if isinstance(effect, CloseLog) and self._is_closing and chain.file is not None:
            self._ending[one.log] = one
            return
        if isinstance(effect, WriteChunk) and chain.file is None:
            self._begin(chain, chain.beginning_ns(effect), FAULT)
        self._settle(chain, one, self._write(chain, effect, one))

    def _open(self, chain: LogChain, one: Waiting, effect: OpenLog) -> None:
        ending = self._ending.pop(chain.name, None)
        again = self._leave(chain)
        if again:
            # What the file before could not keep goes into another one, before this one.
            self._put_back([*again, *([ending] if ending is not None else []), one])
            return
        chain.wanted = effect
        chain.opened += 1
        if effect.is_incident:
            chain.prologue = Prologue()
        self._begin(chain, effect.wall_ns)

    def _write(self, chain: LogChain, effect: FileEffect, one: Waiting) -> CommandError | None:
        """Write an effect into the present file, if there is one. Why the disk does not take it."""
        before = chain.unkept_bytes
        try:
            chain.write(effect, one)
        except CommandError as error:
            return error
        finally:
            self._unkept_bytes += chain.unkept_bytes - before
        return None

    def _settle(self, chain: LogChain, one: Waiting, error: CommandError | None) -> None:
        """After an effect was carried out, or not: what is to be written again waits again."""
        file, again = chain.file, []
        is_chunk, is_end = isinstance(one.effect, WriteChunk), isinstance(one.effect, CloseLog)
        if error is not None:
            log.error("%s; the log goes on in another file", error)
            self._fall_ill(str(error))
            again = self._leave(chain)
            if again and not is_chunk:
                again.append(one if is_end else waiting(chain.name, SyncLog()))
        elif file is not None and file.has_synced:
            file.has_synced = False
            self._get_well()
        if is_chunk and (file is None or error is not None):
            again.append(one)
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
        self._unkept_bytes = sum(chain.unkept_bytes for chain in self._chains.values())
        for one, error in zip(ending.values(), errors, strict=True):
            self._settle(self._chains[one.log], one, error)

    def _end_file(self, one: Waiting) -> CommandError | None:
        try:
            self._chains[one.log].write(CloseLog(), one)
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

    def _fall_ill(self, detail: str) -> None:
        for chain in self._chains.values():
            if chain.file is not None:
                # What it has kept until now says nothing of what is to come.
                chain.file.has_synced = False
        if not self._is_faulty:
            self._is_faulty = True
            self._notices.append(DiskFault(detail))

    def _get_well(self) -> None:
        self._pause_s = 0.0
        if self._is_faulty:
            self._is_faulty = False
            log.warning("the disk takes the logs again; %d messages are lost", self.lost)
            self._notices.append(DiskBack())

    def _begin(self, chain: LogChain, wall_ns: int, because: str = "") -> None:
        """Begin the file that is wanted, if the disk takes it."""
        try:
            file = chain.begin(self._directory, self._library, wall_ns, because)
        except CommandError as error:
            if self._pause_s <= RETRY_MIN_S:
                log.error("%s; trying on", error)  # noqa: TRY400 - a full disk is no bug
            self._fall_ill(str(error))
            return
        if file is not None:
            file.when_synced = partial(self._tell_synced, chain, file)
            log.info("writing %s", file.path)
            self._notices.append(Opened(chain.name, file.name))

    def _leave(self, chain: LogChain) -> list[Waiting]:
        """End the present file of a log, as well as can be. What the disk has not kept of it."""
        self._unkept_bytes -= chain.unkept_bytes
        file, unkept = chain.leave()
        if file is None:
            return []
        self._notices.append(Ended(chain.name, file.name, file.size))
        if file.is_left:
            self._left.append(file.path)
        if file.is_kept:
            if not chain.is_incident:
                self.path = str(file.path)
            self.files += 1
            self.bytes += file.size
        return unkept
