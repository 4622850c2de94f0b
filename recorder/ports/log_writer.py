"""The writer's thread: carries effects out on files, whatever the disk does, while the loop goes on receiving.

When a write fails, the file is cut back to its last whole chunk and ended, and the next one begins with the chunk
that failed. While none can be written, chunks wait, up to QUEUE_BYTES; beyond that the oldest go, and are counted.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Iterable
from typing import Final

from recorder.chunk import Chunk
from recorder.effects import CloseLog, FileEffect, OpenLog, SyncLog, WriteChunk, WriteMetadata
from recorder.ports.log_directory import LogDirectory, LogFile
from recorder.prologue import Prologue
from schemas.exit_codes import CommandError

log = logging.getLogger(__name__)

QUEUE_BYTES: Final = 64 * 1024 * 1024
"""Messages that may wait for the disk, before compression: a minute and more of a saturated bus."""

RETRY_MIN_S: Final = 0.2
"""First pause before a file is begun again after a fault that came at once again; it doubles up to..."""

RETRY_MAX_S: Final = 5.0

END_S: Final = 10.0
"""How long the end waits for the disk."""

LOST_NAME: Final = "cruiser.lost"
"""The metadata record of the file after a loss: how many messages the disk did not take."""


class LogWriter:
    """Writes files on a thread of its own, from its beginning to ``close``.

    Args:
        directory: where files go.
        library: who writes, for the files' headers.
        queue_bytes: messages that may wait.
    """

    def __init__(self, directory: LogDirectory, library: str, queue_bytes: int = QUEUE_BYTES) -> None:
        self._directory = directory
        self._library = library
        self._queue_bytes = queue_bytes
        self._waiting: deque[OpenLog | FileEffect] = deque()
        self._waiting_bytes = 0
        self._changed = threading.Condition()
        self._is_closing = False
        self._prologue = Prologue()
        self._file: LogFile | None = None
        self._wanted: OpenLog | None = None
        """The file that is to be written; after a fault the next one is called like it."""
        self._submitted = self._opened = 0
        self._pause_s = 0.0
        self._untold = 0
        self._fault: BaseException | None = None
        self.path: str | None = None
        """The newest file with anything in it."""
        self.files = 0
        self.bytes = 0
        """Bytes of the files that are ended; ``files`` of them."""
        self.lost = 0
        """Messages that were received, and that the disk did not take."""
        self._thread = threading.Thread(target=self._run, name="log writer", daemon=True)
        self._thread.start()

    @property
    def size(self) -> int:
        """Bytes of the present file; 0 as long as it is not begun."""
        file = self._file
        return file.size if file is not None and self._opened == self._submitted else 0

    def submit(self, effects: Iterable[OpenLog | FileEffect]) -> None:
        """Have these carried out, in order. Never waits for the disk.

        Raises:
            Exception: the thread has ended by a fault of our own.
        """
        with self._changed:
            if self._fault is not None:
                raise self._fault
            for effect in effects:
                self._waiting.append(effect)
                if isinstance(effect, WriteChunk):
                    self._waiting_bytes += len(effect.chunk.records)
                elif isinstance(effect, OpenLog):
                    self._submitted += 1
            if self._waiting_bytes > self._queue_bytes:
                self._drop_oldest()
            self._changed.notify()

    def close(self) -> None:
        """Have the disk take what waits, as far as it does in END_S; what it does not is lost."""
        with self._changed:
            self._is_closing = True
            self._changed.notify()
        self._thread.join(END_S)
        if self._thread.is_alive():
            log.error("the disk does not answer; the log is not ended")
        elif self._fault is not None:
            raise self._fault

    def _drop_oldest(self) -> None:
        kept: deque[OpenLog | FileEffect] = deque()
        while self._waiting and self._waiting_bytes > self._queue_bytes:
            effect = self._waiting.popleft()
            if isinstance(effect, WriteChunk):
                self._waiting_bytes -= len(effect.chunk.records)
                self._lose(effect.chunk)
            elif not isinstance(effect, SyncLog):
                kept.append(effect)
        self._waiting.extendleft(reversed(kept))

    def _lose(self, chunk: Chunk) -> None:
        count = sum(len(entries) // 2 for entries in chunk.index.values())
        if not self._untold:
            log.error("the disk takes nothing: the oldest messages that wait for it are lost")
        self.lost += count
        self._untold += count

    def _run(self) -> None:
        try:
            while (effect := self._next()) is not None:
                self._carry_out(effect)
        except BaseException as error:  # noqa: BLE001 - the loop raises it
            self._fault = error
        finally:
            if self._file is not None:
                self._leave()

    def _next(self) -> OpenLog | FileEffect | None:
        with self._changed:
            while not self._waiting and not self._is_closing:
                self._changed.wait()
            if self._file is None and self._waiting and isinstance(self._waiting[0], WriteChunk):
                # It waits in the queue, not in hand: the oldest are the first to go.
                self._pause()
            if not self._waiting:
                return None
            effect = self._waiting.popleft()
            if isinstance(effect, WriteChunk):
                self._waiting_bytes -= len(effect.chunk.records)
            return effect

    def _put_back(self, effect: WriteChunk) -> None:
        """A chunk waits again, as the oldest."""
        with self._changed:
            if self._is_closing and self._pause_s > RETRY_MIN_S:
                self._lose(effect.chunk)
                return
            self._waiting.appendleft(effect)
            self._waiting_bytes += len(effect.chunk.records)
            if self._waiting_bytes > self._queue_bytes:
                self._drop_oldest()

    def _carry_out(self, effect: OpenLog | FileEffect) -> None:
        if isinstance(effect, OpenLog):
            self._wanted = effect
            self._opened += 1
            self._begin()
            return
        self._prologue.take(effect)
        if isinstance(effect, WriteChunk) and self._file is None:
            self._begin()
        try:
            if self._file is not None:
                self._file.write(effect)
                if self._file.has_synced:
                    self._pause_s = 0.0
            elif isinstance(effect, WriteChunk):
                self._put_back(effect)
        except CommandError as error:
            log.error("%s; the log goes on in another file", error)  # noqa: TRY400 - a full disk is no bug
            self._leave()
            if isinstance(effect, WriteChunk):
                self._put_back(effect)
        if isinstance(effect, CloseLog):
            self._leave()
            self._wanted = None

    def _pause(self) -> None:
        """Before a file is begun again: at once after the first fault, then ever more seldom."""
        end_s = time.monotonic() + self._pause_s
        while not self._is_closing and (left_s := end_s - time.monotonic()) > 0:
            self._changed.wait(left_s)
        self._pause_s = min(max(2 * self._pause_s, RETRY_MIN_S), RETRY_MAX_S)

    def _begin(self) -> None:
        """Begin the file that is wanted, with all that those before it declared; if the disk takes it."""
        if self._wanted is None:
            return
        try:
            self._file = self._directory.open(self._wanted.name, self._wanted.wall_ns, self._library)
            for effect in self._prologue.effects:
                self._file.write(effect)
            if self._untold:
                told, self._untold = self._untold, 0
                log.warning("the disk takes the log again; %d messages are lost", told)
                self._file.write(WriteMetadata(LOST_NAME, {"messages": str(told)}))
        except CommandError as error:
            if self._pause_s <= RETRY_MIN_S:
                log.error("%s; trying on", error)  # noqa: TRY400 - a full disk is no bug
            self._leave()
            return
        log.info("writing %s", self._file.path)

    def _leave(self) -> None:
        """End the present file, as well as can be."""
        file, self._file = self._file, None
        if file is None:
            return
        file.salvage()
        if file.is_kept:
            self.path = str(file.path)
            self.files += 1
            self.bytes += file.size
