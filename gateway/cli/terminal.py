"""A terminal whose keys are read one by one, as they come."""

from __future__ import annotations

import os
import select
import termios
import tty
from contextlib import suppress
from types import TracebackType
from typing import Any, Final, Self

_READ_BYTES: Final = 1024


class Terminal:
    """A terminal without echo, lines and signals while the block runs; as it was afterwards."""

    def __init__(self, read_from: int) -> None:
        self._in = read_from
        self._saved: list[Any] = []

    def __enter__(self) -> Self:
        self._saved = termios.tcgetattr(self._in)
        changed = termios.tcgetattr(self._in)
        # Ctrl-C is a key like the others: it stops the robot first. Ctrl-S shall not hold up what is drawn.
        changed[tty.LFLAG] &= ~(termios.ICANON | termios.ECHO | termios.ISIG | termios.IEXTEN)
        changed[tty.IFLAG] &= ~(termios.IXON | termios.ICRNL)
        changed[tty.CC][termios.VMIN], changed[tty.CC][termios.VTIME] = 0, 0
        termios.tcsetattr(self._in, termios.TCSADRAIN, changed)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with suppress(termios.error):  # The terminal may have gone.
            # What was typed for the robot is no command for the shell.
            termios.tcsetattr(self._in, termios.TCSAFLUSH, self._saved)

    def read(self, timeout_s: float) -> bytes | None:
        """Return the typed bytes; none if nothing was typed in time; None once the terminal has gone."""
        try:
            if not select.select([self._in], [], [], timeout_s)[0]:
                return b""
            return os.read(self._in, _READ_BYTES) or None
        except OSError:
            return None
