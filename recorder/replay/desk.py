"""Whoever watches a replay at a terminal: keys that interfere, and a line that shows where it is."""

from __future__ import annotations

import os
import select
import sys
import termios
import time
from contextlib import suppress
from types import TracebackType
from typing import Any, Final, Self, TextIO

from recorder.reading.times import in_words
from recorder.replay.run import Order

ORDERS: Final = {b" ": Order.PAUSE, b"q": Order.QUIT, b"\x1b[C": Order.ON, b"\x1b[D": Order.BACK}
"""What the keys send: space, q, the arrows to the right and to the left."""

APPLICATION_ARROWS: Final = (b"\x1bO", b"\x1b[")
"""Some terminals send arrows so; it means the same."""

SHOW_S: Final = 0.1

_LOCAL_FLAGS: Final = 3
_CHARACTERS: Final = 6
_READ_BYTES: Final = 64
_CLEAR: Final = "\r\x1b[K"


def orders_of(typed: bytes) -> list[Order]:
    """What typed bytes ask for. A key that means nothing is passed over."""
    typed = typed.replace(*APPLICATION_ARROWS)
    orders = []
    while typed:
        for keys, order in ORDERS.items():
            if typed.startswith(keys):
                orders.append(order)
                typed = typed[len(keys) :]
                break
        else:
            typed = typed[1:]
    return orders


class TerminalClock:
    """The machine's clocks."""

    def monotonic_ns(self) -> int:
        """For due times."""
        return time.monotonic_ns()

    def wall_ns(self) -> int:
        """Since 1970."""
        return time.time_ns()

    def sleep(self, duration_ns: int) -> None:
        """Wait."""
        time.sleep(max(0, duration_ns) / 1e9)


class KeyboardDesk:
    """The terminal while the block runs, as it was afterwards. Where there is none, nothing is read or shown.

    Args:
        takes_keys: keys may interfere.
        read_from: the terminal's keys.
        write_to: where the line goes.
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
            changed = termios.tcgetattr(self._in)
            # Ctrl-C stays a signal.
            changed[_LOCAL_FLAGS] &= ~(termios.ICANON | termios.ECHO)
            changed[_CHARACTERS][termios.VMIN], changed[_CHARACTERS][termios.VTIME] = 0, 0
            termios.tcsetattr(self._in, termios.TCSADRAIN, changed)
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
        """What was typed since the last call."""
        if not self.takes_keys:
            return []
        try:
            if not select.select([self._in], [], [], 0)[0]:
                return []
            return orders_of(os.read(self._in, _READ_BYTES))
        except OSError:
            return [Order.QUIT]

    def show(self, time_ns: int | None, *, is_paused: bool) -> None:
        """Where the replay is."""
        now_s = time.monotonic()
        if not self._shows or time_ns is None or now_s - self._shown_s < SHOW_S:
            return
        self._shown_s = now_s
        self._write(f"{_CLEAR}{in_words(time_ns)}{'  paused' if is_paused else ''}")

    def _write(self, text: str) -> None:
        with suppress(OSError):
            self._out.write(text)
            self._out.flush()
