"""Lines that are typed, or piped in, while a command runs. Never blocks, never spins."""

from __future__ import annotations

import os
import select
import stat
from typing import Final

_READ_BYTES: Final = 4096
_MAX_LINE_BYTES: Final = 1024
"""A line that gets longer than this is given up."""


class TypedLines:
    """The lines of a terminal or a pipe; of anything else, none."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._buffer = b""
        self._open = _can_be_typed_into(descriptor)

    def read(self) -> list[str]:
        """The lines that are complete by now."""
        if not self._open or not self._is_ready():
            return []
        try:
            data = os.read(self._descriptor, _READ_BYTES)
        except OSError:
            data = b""  # The terminal has gone.
        if not data:
            self._open = False
            *lines, rest = [*self._buffer.split(b"\n"), b""]
        else:
            *lines, rest = (self._buffer + data).split(b"\n")
        self._buffer = rest[:_MAX_LINE_BYTES]
        return [text for line in lines if (text := line.decode("utf-8", errors="replace").strip())]

    def _is_ready(self) -> bool:
        # A process in the background that reads its terminal is stopped by SIGTTIN.
        if _is_in_background(self._descriptor):
            return False
        return bool(select.select([self._descriptor], [], [], 0)[0])


def _is_in_background(descriptor: int) -> bool:
    try:
        return os.tcgetpgrp(descriptor) != os.getpgrp()
    except OSError:
        return False  # A pipe, or a terminal that does not control this process: it stops nobody.


def _can_be_typed_into(descriptor: int) -> bool:
    try:
        return os.isatty(descriptor) or stat.S_ISFIFO(os.fstat(descriptor).st_mode)
    except OSError:
        return False  # The process was started without it.
