"""A client of a socketcand server as a driver of python-can.

Its words for frames are python-can's; the connection is ours. python-can's client connects by IPv4 alone, tries
for 10 s at full processor load, takes what has come for the whole answer, and the end of the stream for silence.
"""

from __future__ import annotations

import select
import socket
import time
from typing import Final

import can
from can.interfaces.socketcand.socketcand import (
    convert_ascii_message_to_can_message,
    convert_can_message_to_ascii_message,
)

CONNECT_TIMEOUT_S: Final = 1.0
HANDSHAKE_TIMEOUT_S: Final = 5.0
"""For each answer."""

MESSAGE_MAX_BYTES: Final = 512
"""A message without its end after this many bytes is dropped."""

_GREETING: Final = b"< hi >"
_READ_BYTES: Final = 4096


class SocketcandBus(can.BusABC):
    """A bus that a server shows over TCP.

    Attributes:
        stream: the connection.
    """

    def __init__(self, host: str, port: int, channel: str) -> None:
        """Connect, and open the bus.

        Raises:
            OSError: there is no server, or it does not answer.
            can.CanError: it answers otherwise.
        """
        try:
            self.stream = socket.create_connection((host, port), CONNECT_TIMEOUT_S)
        except (OSError, UnicodeError) as error:  # A host name that cannot be one is a UnicodeError.
            raise can.CanInitializationError(f"no server there: {error}") from error
        self._buffer = b""
        try:
            self._open(channel)
        except BaseException:
            self.stream.close()
            raise
        self.stream.settimeout(None)
        super().__init__(channel=channel)

    def _open(self, channel: str) -> None:
        if self._answer(_GREETING) != _GREETING:
            raise can.CanInitializationError("the server does not speak the socketcand protocol")
        for request in (f"< open {channel} >", "< rawmode >"):
            self.stream.sendall(request.encode())
            if (said := self._answer(b"< ")) != b"< ok >":
                raise can.CanInitializationError(f"the server answered {said.decode('ascii', 'replace')!r}")

    def _answer(self, start: bytes) -> bytes:
        """Return the next answer; what has come of it once it cannot be one that begins so."""
        end_s = time.monotonic() + HANDSHAKE_TIMEOUT_S
        while b">" not in self._buffer and self._buffer.startswith(start[: len(self._buffer)]):
            self.stream.settimeout(max(end_s - time.monotonic(), 0.001))
            try:
                self._read()
            except TimeoutError as error:
                raise TimeoutError(f"the server did not answer within {HANDSHAKE_TIMEOUT_S:g} s") from error
        answer, end, self._buffer = self._buffer.partition(b">")
        return answer + end

    def _read(self) -> None:
        data = self.stream.recv(_READ_BYTES)
        if not data:
            raise ConnectionError("the server closed the connection")
        self._buffer += data

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if b">" not in self._buffer:
            if not select.select([self.stream], [], [], timeout)[0]:
                return None, False
            self._read()
        line, end, rest = self._buffer.partition(b">")
        if not end and len(line) <= MESSAGE_MAX_BYTES:
            return None, False
        self._buffer = rest
        # What comes before the last '<' is a message whose end was lost.
        message = convert_ascii_message_to_can_message((line[max(line.rfind(b"<"), 0) :] + end).decode("ascii"))
        if message is None:
            raise ValueError(f"no message that is known: {line[:60]!r}")
        return message, False

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Hand a frame to the connection."""
        del timeout
        self.stream.sendall(convert_can_message_to_ascii_message(msg).encode("ascii"))

    def shutdown(self) -> None:
        """Hang up."""
        super().shutdown()
        self.stream.close()
