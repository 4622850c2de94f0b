"""The service manager, systemd, as the loop reports to it: ready, alive, and in what state (sd_notify(3))."""

from __future__ import annotations

import socket
from collections.abc import Mapping
from typing import Final, Self

from schemas.command_line import plain

_SOCKET: Final = "NOTIFY_SOCKET"


class ServiceManager:
    """Sends datagrams to the socket that systemd names. Nothing blocks."""

    def __init__(self, address: str) -> None:
        """Send nothing yet.

        Args:
            address: a path, or an abstract name that begins with ``@``.
        """
        self._address = f"\0{address[1:]}" if address.startswith("@") else address
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
        self._socket.settimeout(0)
        self._is_ready = False
        self._status = ""

    @classmethod
    def of(cls, environment: Mapping[str, str]) -> Self | None:
        """The one that started this process; None if none wants to be told."""
        address = environment.get(_SOCKET, "")
        return cls(address) if address.startswith(("/", "@")) else None

    def alive(self, status: str) -> None:
        """The loop gets round: feed the watchdog. The first time says that the service is ready.

        Args:
            status: a line for people, sent where it has changed.
        """
        words = ["WATCHDOG=1"]
        if not self._is_ready:
            words.append("READY=1")
        if status != self._status:
            words.append(f"STATUS={plain(status)}")
        if self._send(words):
            self._is_ready, self._status = True, status

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def _send(self, words: list[str]) -> bool:
        try:
            self._socket.sendto("\n".join(words).encode(), self._address)
        except OSError:
            return False
        return True
