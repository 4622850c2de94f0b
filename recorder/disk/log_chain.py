"""The files of one log, one after the other, and what the disk has not said it keeps of the present one."""

from __future__ import annotations

from collections import deque

from recorder.disk.log_directory import LogDirectory
from recorder.disk.log_file import LogFile
from recorder.record.effects import FileEffect, OpenLog, WriteChunk, WriteMetadata
from recorder.record.log_queue import Waiting
from recorder.record.prologue import Prologue
from recorder.record.session import CONTINUED_NAME
from schemas.exit_codes import CommandError


class LogChain:
    """The files of one log.

    Args:
        name: of the log.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.prologue = Prologue()
        self.file: LogFile | None = None
        self.wanted: OpenLog | None = None
        """The file that is to be written, or to go on in another one after a fault; None if none is."""
        self.submitted = self.opened = 0
        self.is_incident = False
        self.unkept_bytes = 0
        """Of chunks that were written, and that the disk may not keep yet: they may have to be written again."""
        self._unkept: deque[tuple[int, Waiting]] = deque()
        """Those chunks, each with its end in the present file."""

    @property
    def is_begun(self) -> bool:
        """Whether the newest file that was asked for is being written."""
        return self.file is not None and self.opened == self.submitted

    def begin(self, directory: LogDirectory, library: str, wall_ns: int, because: str = "") -> LogFile | None:
        """Begin a file with all that those before it declared; None if none is wanted.

        Args:
            directory: where it goes.
            library: who writes.
            wall_ns: its beginning.
            because: why it goes on with what another one should have held, if it does.

        Raises:
            CommandError: the disk does not take it; nothing is left of it.
        """
        wanted = self.wanted
        if wanted is None:
            return None
        file = directory.open(wanted.name, wall_ns, library, is_incident=wanted.is_incident)
        try:
            file.begin(self.prologue.effects)
            if because:
                file.write(WriteMetadata(CONTINUED_NAME, {"because": because}))
        except CommandError:
            # Nobody was told of it.
            file.salvage()
            raise
        self.file = file
        return file

    def beginning_ns(self, first: WriteChunk) -> int:
        """When a file begins that goes on with this chunk: after a fault it is called by what is in it.

        An incident is called by what it is about, which its first messages come before.
        """
        start_ns = first.chunk.start_ns
        return max(start_ns, self.wanted.wall_ns) if self.is_incident and self.wanted is not None else start_ns

    def write(self, effect: FileEffect, one: Waiting) -> None:
        """Write an effect into the present file, if there is one.

        Args:
            effect: what is to be done...
            one: ...and how it waited: a chunk is held until the disk keeps it.

        Raises:
            CommandError: the disk does not take it.
        """
        if self.file is None:
            return
        self.file.write(effect)
        if isinstance(effect, WriteChunk):
            self._unkept.append((self.file.size, one))
            self.unkept_bytes += one.bytes
        self.release()

    def release(self) -> None:
        """Forget what the disk keeps by now."""
        kept_size = self.file.kept_size if self.file is not None else 0
        while self._unkept and self._unkept[0][0] <= kept_size:
            self.unkept_bytes -= self._unkept.popleft()[1].bytes

    def leave(self) -> tuple[LogFile | None, list[Waiting]]:
        """End the present file, as well as can be.

        Returns:
            The file, and what the disk has failed to keep of it.
        """
        file, self.file = self.file, None
        if file is None:
            return None, []
        file.salvage()
        unkept = [one for end, one in self._unkept if file.is_doubtful and end > file.kept_size]
        self._unkept.clear()
        self.unkept_bytes = 0
        return file, unkept
