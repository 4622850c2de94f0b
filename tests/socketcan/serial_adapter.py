"""A kernel CAN interface on a serial line (slcan), whose adapter is the test."""

import fcntl
import os
import pty
import struct
import subprocess
import termios
import tty
from typing import Final, Self

import pytest

_N_SLCAN: Final = struct.pack("@i", 17)
_SIOCGIFNAME: Final = 0x8910
_READ_BYTES: Final = 1 << 16
_FILLING: Final = b"x" * 64


class SerialAdapter:
    """An interface whose sent frames are read here. While its line is full of ``_FILLING`` frames wait."""

    def __init__(self) -> None:
        self._adapter, self._line = pty.openpty()
        for end in (self._adapter, self._line):
            tty.setraw(end)
            os.set_blocking(end, False)
        self._received = b""

    def __enter__(self) -> Self:
        if "SOCKETCAN_OWN_KERNEL" not in os.environ:
            pytest.skip("a kernel gives serial adapters to its first network namespace, which is the user's here")
        self._fill()
        fcntl.ioctl(self._line, termios.TIOCSETD, _N_SLCAN)
        self.name = fcntl.ioctl(self._line, _SIOCGIFNAME, bytes(40)).partition(b"\0")[0].decode("ascii")
        assert not _set(self.name, "up"), self.name
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._adapter)
        os.close(self._line)

    @property
    def frames(self) -> list[tuple[int, bytes]]:
        """Extended frames sent so far. Reading them frees the line."""
        try:
            while True:
                self._received += os.read(self._adapter, _READ_BYTES)
        except BlockingIOError:
            pass
        whole = self._received.replace(_FILLING[:1], b"").split(b"\r")[:-1]
        assert all(line.startswith(b"T") for line in whole), whole
        return [(int(line[1:9], 16), bytes.fromhex(line[10:].decode("ascii"))) for line in whole]

    def report(self, state: str, *, receive_errors: int, send_errors: int) -> None:
        """Report the controller's state ``a``, ``w``, ``p`` or ``b``, and its error counters."""
        os.write(self._adapter, f"s{state}{receive_errors:03d}{send_errors:03d}\r".encode("ascii"))

    def restart(self) -> None:
        assert (_set(self.name, "down"), _set(self.name, "up")) == (0, 0)

    def _fill(self) -> None:
        try:
            while True:
                os.write(self._line, _FILLING)
        except BlockingIOError:
            pass


def _set(name: str, state: str) -> int:
    return subprocess.run(["ip", "link", "set", name, state], check=False, timeout=30).returncode
