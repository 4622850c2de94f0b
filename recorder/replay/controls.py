"""The keys of a terminal that pause, seek and end a replay, and a line that shows where it is."""

from __future__ import annotations

import os
import re
import select
import sys
import termios
import time
import tty
from contextlib import suppress
from enum import Enum
from types import TracebackType
from typing import Any, Final, Self, TextIO

from recorder.reading.times import in_words

SHOW_S: Final = 0.1

_KEY: Final = re.compile(rb"[ q]|\x1b[\[O][CD]")
"""Space, q, the arrows to the right and to the left in either of the two forms that terminals send."""

_READ_BYTES: Final = 64
_CLEAR: Final = "\r\x1b[K"


class Order(Enum):
    """An order of a person at the keyboard, by the last byte of the key."""

    PAUSE = b" "
    QUIT = b"q"
    ON = b"C"
    BACK = b"D"


def orders_of(typed: bytes) -> list[Order]:
    """Return what typed bytes ask for. A key that means nothing is passed over."""
    return [Order(key[-1:]) for key in _KEY.findall(typed)]


class ReplayControls:
    """The terminal while the block runs, as it was afterwards. Where there is none, nothing is read or shown.

    Args:
        takes_keys: keys may interfere.
        read_from: the terminal's keys.
        write_to: the destination of the line.
    """

    def __init__(self, *, takes_keys: bool, read_from: TextIO = sys.stdin, write_to: TextIO = sys.stderr) -> None:
        self._out = write_to
        self._shows = write_to.isatty()
        self.takes_keys = takes_keys and self._shows and read_from.isatty()
        self._in = read_from.fileno() if self.takes_keys else -1
        self._saved: list[Any] = []
        self._shown_s = 0.0

    def __enter__(self) -> Self:
        if self.takes_keys:
            self._saved = termios.tcgetattr(self._in)
            tty.setcbreak(self._in, termios.TCSADRAIN)  # Ctrl-C stays a signal.
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._shows:
            self._write(_CLEAR)
        if self.takes_keys:
            with suppress(termios.error):  # The terminal may have gone.
                # What was typed here is no command for the shell.
                termios.tcsetattr(self._in, termios.TCSAFLUSH, self._saved)

    def orders(self) -> list[Order]:
        """Return what was typed since the last call."""
        try:
            if not self.takes_keys or not select.select([self._in], [], [], 0)[0]:
                return []
            return orders_of(os.read(self._in, _READ_BYTES))
        except OSError:
            return [Order.QUIT]

    def show(self, time_ns: int | None, *, is_paused: bool) -> None:
        """Show where the replay is, in the log's time."""
        now_s = time.monotonic()
        if not self._shows or time_ns is None or now_s - self._shown_s < SHOW_S:
            return
        self._shown_s = now_s
        self._write(f"{_CLEAR}{in_words(time_ns)}{'  paused' if is_paused else ''}")

    def _write(self, text: str) -> None:
        with suppress(OSError):
            self._out.write(text)
            self._out.flush()
