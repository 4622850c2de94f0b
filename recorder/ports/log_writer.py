"""The writer's thread: carries effects out on files, whatever the disk does, while the loop goes on receiving.

When a write fails, the file is cut back to its last whole chunk and ended, and the next one begins with the chunk
that failed; or, where the disk fails to keep what it had taken, with all that it has not kept. While none can be
written, chunks wait, up to a bound; beyond that the oldest go, and are told.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Iterable
from typing import Final

import msgspec

from recorder.chunk import Chunk
from recorder.effects import CloseLog, FileEffect, OnLog, OpenLog, SyncLog, WriteChunk
from recorder.notices import DiskBack, DiskFault, Ended, Lost, Notice, Opened
from recorder.ports.log_directory import LogDirectory, LogFile
from recorder.prologue import Prologue
from schemas.exit_codes import CommandError

log = logging.getLogger(__name__)

QUEUE_BYTES: Final = 64 * 1024 * 1024
"""Messages that may wait for the disk, before compression: a minute and more of a saturated bus."""

UNKEPT_BYTES: Final = 16 * 1024 * 1024
"""Messages of one log that the disk has taken and may not keep yet, held so that they can be written again."""

NOTICES_MAX: Final = 10_000

RETRY_MIN_S: Final = 0.2
"""First pause before a file is begun again after a fault that came at once again; it doubles up to..."""

RETRY_MAX_S: Final = 5.0

END_S: Final = 10.0
"""How long the end waits for the disk."""


class _Chain:
    """The files of one log, one after the other."""

    def __init__(self) -> None:
        self.prologue = Prologue()
        self.file: LogFile | None = None
        self.wanted: OpenLog | None = None
        """The file that is to be written; after a fault the next one is called like it."""
        self.submitted = self.opened = 0
        self.unkept: deque[tuple[int, _Waiting]] = deque()
        """Chunks of the present file, each with its end, that the disk may not keep yet."""
        self._unkept_bytes = 0
        self.is_incident = False

    def write(self, file: LogFile, one: _Waiting, effect: FileEffect) -> None:
        """Write an effect into the present file.

        Raises:
            CommandError: the disk does not take it.
        """
        file.write(effect)
        if one.bytes:
            self.unkept.append((file.size, one))
            self._unkept_bytes += one.bytes
        while self.unkept and (self.unkept[0][0] <= file.kept_size or self._unkept_bytes > UNKEPT_BYTES):
            self._unkept_bytes -= self.unkept.popleft()[1].bytes

    def take_unkept(self, file: LogFile) -> list[_Waiting]:
        """What the disk has failed to keep of a file that is ended."""
        unkept = [one for end, one in self.unkept if file.is_doubtful and end > file.kept_size]
        self.unkept.clear()
        self._unkept_bytes = 0
        return unkept


class _Waiting(msgspec.Struct, frozen=True):
    """An effect in the queue, and the log that it is meant for."""

    log: str
    effect: OpenLog | FileEffect

    @property
    def bytes(self) -> int:
        return len(self.effect.chunk.records) if isinstance(self.effect, WriteChunk) else 0


class LogWriter:
    """Writes the files of several logs on a thread of its own, from its beginning to ``close``.

    Args:
        directory: where files go.
        library: who writes, for the files' headers.
        queue_bytes: messages that may wait.
    """

    def __init__(self, directory: LogDirectory, library: str, queue_bytes: int = QUEUE_BYTES) -> None:
        self._directory = directory
        self._library = library
        self._queue_bytes = queue_bytes
        self._waiting: deque[_Waiting] = deque()
        self.waiting_bytes = 0
        """Bytes of the messages that wait for the disk."""
        self._changed = threading.Condition()
        self._is_closing = False
        self._chains: dict[str, _Chain] = {}
        self._pause_s = 0.0
        self._is_faulty = False
        self._fault: BaseException | None = None
        self._notices: deque[Notice] = deque(maxlen=NOTICES_MAX)
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
    def sizes(self) -> dict[str, int]:
        """Bytes of the present file of each log, as far as it is begun."""
        with self._changed:
            chains = list(self._chains.items())
        return {
            name: file.size
            for name, chain in chains
            if (file := chain.file) is not None and chain.opened == chain.submitted
        }

    @property
    def parts(self) -> frozenset[str]:
        """The names of the files that are being written, as they are now."""
        with self._changed:
            chains = list(self._chains.values())
        return frozenset(file.path.name for chain in chains if (file := chain.file) is not None)

    def notices(self) -> Iterable[Notice]:
        """What became of the files since the last call."""
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
            chain = self._chains.setdefault(doing.log, _Chain())
            for effect in doing.effects:
                one = _Waiting(doing.log, effect)
                self._waiting.append(one)
                self.waiting_bytes += one.bytes
                if isinstance(effect, OpenLog):
                    chain.submitted += 1
                    chain.is_incident = effect.is_incident
            if self.waiting_bytes > self._queue_bytes:
                self._drop_oldest()
            self._changed.notify()

    def close(self) -> None:
        """Have the disk take what waits, as far as it does in END_S; what it does not is lost."""
        with self._changed:
            self._is_closing = True
            self._changed.notify()
        self._thread.join(END_S)
        if self._thread.is_alive():
            self.is_hung = True
            with self._changed:
                for one in self._waiting:
                    if isinstance(one.effect, WriteChunk):
                        self._lose(one.log, one.effect.chunk)
                self._waiting.clear()
            log.error("the disk does not answer; the logs are not ended")
        elif self._fault is not None:
            raise self._fault

    def _drop_oldest(self) -> None:
        kept: deque[_Waiting] = deque()
        while self._waiting and self.waiting_bytes > self._queue_bytes:
            one = self._waiting.popleft()
            self.waiting_bytes -= one.bytes
            if isinstance(one.effect, WriteChunk):
                self._lose(one.log, one.effect.chunk)
            elif not isinstance(one.effect, SyncLog):
                kept.append(one)
        self._waiting.extendleft(reversed(kept))

    def _lose(self, name: str, chunk: Chunk) -> None:
        counts = chunk.counts
        if self._chains[name].is_incident:
            log.error("the disk takes too little: an incident lacks messages")
            return
        if not self.lost:
            log.error("the disk takes too little: the oldest messages that wait for it are lost")
        self.lost += sum(counts.values())
        self._notices.append(Lost(name, counts, chunk.start_ns, chunk.end_ns))

    def _run(self) -> None:
        try:
            while (one := self._next()) is not None:
                self._carry_out(one)
        except BaseException as error:  # noqa: BLE001 - the loop raises it
            self._fault = error
        finally:
            for name, chain in self._chains.items():
                self._leave(name, chain)
            self._directory.close()

    def _next(self) -> _Waiting | None:
        with self._changed:
            while True:
                while not self._waiting and not self._is_closing:
                    self._changed.wait()
                if self._waiting and self._is_stuck(self._waiting[0]):
                    # It waits in the queue, not in hand: the oldest are the first to go, perhaps all of them.
                    self._pause()
                if self._waiting:
                    one = self._waiting.popleft()
                    self.waiting_bytes -= one.bytes
                    return one
                if self._is_closing:
                    return None

    def _is_stuck(self, one: _Waiting) -> bool:
        return self._is_faulty and isinstance(one.effect, WriteChunk) and self._chains[one.log].file is None

    def _put_back(self, ones: Iterable[_Waiting]) -> None:
        """These wait again, as the oldest."""
        with self._changed:
            for one in reversed(list(ones)):
                if isinstance(one.effect, WriteChunk) and self._is_closing and self._pause_s > RETRY_MIN_S:
                    self._lose(one.log, one.effect.chunk)
                    continue
                self._waiting.appendleft(one)
                self.waiting_bytes += one.bytes
            if self.waiting_bytes > self._queue_bytes:
                self._drop_oldest()

    def _carry_out(self, one: _Waiting) -> None:
        chain, effect = self._chains[one.log], one.effect
        if isinstance(effect, OpenLog):
            self._leave(one.log, chain)
            chain.wanted = effect
            if effect.is_incident:
                chain.prologue = Prologue()
            chain.opened += 1
            self._begin(one.log, chain)
            return
        chain.prologue.take(effect)
        if isinstance(effect, WriteChunk) and chain.file is None:
            self._begin(one.log, chain)
        again = self._write(one, chain, effect)
        if again:
            self._put_back(again)
        elif isinstance(effect, CloseLog):
            self._leave(one.log, chain)
            chain.wanted = None

    def _write(self, one: _Waiting, chain: _Chain, effect: FileEffect) -> list[_Waiting]:
        """Write an effect into the present file. What is to be written again, into another."""
        if chain.file is None:
            return [one] if isinstance(effect, WriteChunk) else []
        try:
            chain.write(chain.file, one, effect)
        except CommandError as error:
            log.error("%s; the log goes on in another file", error)  # noqa: TRY400 - a full disk is no bug
            self._fall_ill(str(error))
            again = self._leave(one.log, chain)
            if isinstance(effect, WriteChunk) or (again and isinstance(effect, CloseLog)):
                again.append(one)
            return again
        if chain.file.has_synced:
            chain.file.has_synced = False
            self._get_well()
        return []

    def _pause(self) -> None:
        """Before a file is begun again: at once after the first fault, then ever more seldom."""
        end_s = time.monotonic() + self._pause_s
        while not self._is_closing and (left_s := end_s - time.monotonic()) > 0:
            self._changed.wait(left_s)
        self._pause_s = min(max(2 * self._pause_s, RETRY_MIN_S), RETRY_MAX_S)

    def _fall_ill(self, detail: str) -> None:
        if not self._is_faulty:
            self._is_faulty = True
            self._notices.append(DiskFault(detail))

    def _get_well(self) -> None:
        self._pause_s = 0.0
        if self._is_faulty:
            self._is_faulty = False
            log.warning("the disk takes the logs again; %d messages are lost", self.lost)
            self._notices.append(DiskBack())

    def _begin(self, name: str, chain: _Chain) -> None:
        """Begin the file that is wanted, with all that those before it declared; if the disk takes it."""
        wanted = chain.wanted
        if wanted is None:
            return
        try:
            chain.file = self._directory.open(
                wanted.name, wanted.wall_ns, self._library, is_incident=wanted.is_incident
            )
            for effect in chain.prologue.effects:
                chain.file.write(effect)
        except CommandError as error:
            if self._pause_s <= RETRY_MIN_S:
                log.error("%s; trying on", error)  # noqa: TRY400 - a full disk is no bug
            self._fall_ill(str(error))
            if chain.file is not None:
                # Nobody was told of it.
                chain.file.salvage()
                chain.file = None
            return
        log.info("writing %s", chain.file.path)
        self._notices.append(Opened(name, chain.file.name))

    def _leave(self, name: str, chain: _Chain) -> list[_Waiting]:
        """End the present file of a log, as well as can be. What the disk has not kept of it."""
        file, chain.file = chain.file, None
        if file is None:
            return []
        file.salvage()
        unkept = chain.take_unkept(file)
        self._notices.append(Ended(name, file.name, file.size))
        if file.is_kept:
            if not chain.is_incident:
                self.path = str(file.path)
            self.files += 1
            self.bytes += file.size
        return unkept
