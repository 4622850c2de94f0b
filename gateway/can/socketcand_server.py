"""The virtual CAN bus on a TCP port, by the socketcand text protocol.

The protocol is that of github.com/linux-can/socketcand, in raw mode::

    server  < hi >                              on connecting
    client  < open can0 >                       server  < ok >
    client  < rawmode >                         server  < ok >
    client  < send 18C4D1D0 8 1 4 0 0 0 0 0 5 >
    server  < frame 18C4D1EF 1700000000.000123 0104000000000005 >
    client  < echo >                            server  < echo >

An identifier of 3 digits is standard, one of 8 extended. As an extension, a client in any state may cause a fault
of the virtual chassis by ``< fault bumper front on >``; the answer is ``< ok >`` or ``< error reason >``. One
thread; every queue is bounded; only ``wait`` blocks.
"""

from __future__ import annotations

import contextlib
import logging
import re
import selectors
import socket
from collections.abc import Callable, Iterable
from enum import Enum
from typing import Final, NamedTuple

from gateway.chassis.frame import ERROR, EXTENDED, IDENTIFIER_MASK, REMOTE, STANDARD_MASK, Frame, hex_identifier

HI: Final = b"< hi >"
OK: Final = b"< ok >"
ECHO: Final = b"< echo >"

MAX_MESSAGE_BYTES: Final = 512  # a message without its end after this many bytes is dropped

_MAX_ERROR_CHARACTERS: Final = 300
_MAX_SHOWN_BYTES: Final = 60  # the part of a wrong message that an error repeats


class FaultAsked(NamedTuple):
    """A client's request for a fault, which is answered by OK or an error."""

    text: str


Event = bytes | Frame | FaultAsked
"""An answer for the client, a frame that it put on the bus, still without a time, or a requested fault."""


class _State(Enum):
    CONNECTED = "open a bus first: < open can0 >"
    OPENED = "choose a mode first: < rawmode >"
    RAW = "the bus is open and in raw mode"


_SEND: Final = re.compile(rb"([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8}) ([0-9A-Fa-f]{1,2})((?: [0-9A-Fa-f]{1,2}){0,8})")


class ServerConnection:
    """One client's protocol state. Any input gives events, never an exception; the buffer is bounded."""

    def __init__(self) -> None:
        self._state = _State.CONNECTED
        self._buffer = b""

    @property
    def is_raw(self) -> bool:
        """The client receives frames of the bus."""
        return self._state is _State.RAW

    def receive_bytes(self, data: bytes) -> list[Event]:
        """Return the events in the buffered and these bytes."""
        *messages, rest = (self._buffer + data).split(b">")
        events: list[Event] = []
        for message in messages:
            # Anything before the last '<' is noise, or a message whose end was lost.
            _, bracket, body = message.rpartition(b"<")
            if not bracket or len(body) > MAX_MESSAGE_BYTES:
                events.append(error_line("a message begins with '<' and ends with '>'"))
            else:
                events += self._message(body)
        # Keep only the first bytes of an overlong rest: enough to recognise it as overlong at its end.
        start = max(rest.rfind(b"<"), 0)
        self._buffer = rest[start : start + MAX_MESSAGE_BYTES + 2]
        return events

    def _message(self, body: bytes) -> list[Event]:
        word, _, rest = b" ".join(body.split()).partition(b" ")
        match word:
            case b"send":
                return [self._send(rest)]
            case b"echo":
                return [ECHO]
            case b"fault":
                return [FaultAsked(rest.decode("ascii", errors="replace"))]
            case b"open":
                return self._advance(_State.CONNECTED, _State.OPENED) if rest else [error_line("open what bus?")]
            case b"rawmode":
                return self._advance(_State.OPENED, _State.RAW)
            case _:
                return [error_line(f"unknown command {_shown(word)}")]

    def _advance(self, wanted: _State, following: _State) -> list[Event]:
        if self._state is not wanted:
            return [error_line(self._state.value)]
        self._state = following
        return [OK]

    def _send(self, rest: bytes) -> Event:
        if self._state is not _State.RAW:
            return error_line(self._state.value)
        match = _SEND.fullmatch(rest)
        if match is None:
            return error_line(f"cannot send {_shown(rest)}")
        can_id = int(match[1], 16)
        if can_id > (IDENTIFIER_MASK if len(match[1]) == 8 else STANDARD_MASK):
            return error_line(f"identifier {_shown(match[1])} is too large")
        can_id |= EXTENDED if len(match[1]) == 8 else 0
        length, data = int(match[2], 16), bytes(int(byte, 16) for byte in match[3].split())
        if length <= 8 and not data and length:
            # python-can's form of a remote frame, which the protocol does not define.
            return Frame(can_id | REMOTE, b"", remote_length=length)
        if length != len(data):
            return error_line(f"length {length} and {len(data)} bytes do not fit")
        return Frame(can_id, data)


def frame_line(frame: Frame) -> bytes | None:
    """Return the line of a frame; None for remote and FD frames, which the protocol does not have."""
    if frame.can_id & REMOTE or frame.fd_flags:
        return None
    time_s, remainder_ns = divmod(frame.wall_ns, 1_000_000_000)
    when = f"{time_s}.{remainder_ns // 1000:06d}"
    if frame.can_id & ERROR:
        return f"< error {frame.can_id & IDENTIFIER_MASK:03X} {when} >".encode("ascii")
    return f"< frame {hex_identifier(frame.can_id)} {when} {frame.data.hex().upper()} >".encode("ascii")


def error_line(reason: str) -> bytes:
    text = re.sub(r"[<>\s]+", " ", reason)[:_MAX_ERROR_CHARACTERS].strip()
    return f"< error {text} >".encode("ascii", errors="replace")


def _shown(data: bytes) -> str:
    return repr(data[:_MAX_SHOWN_BYTES].decode("ascii", errors="replace"))


_logger = logging.getLogger(__name__)

MAX_CLIENTS: Final = 64  # well below the 1024 descriptors that select() can watch

MAX_QUEUED_BYTES: Final = 1 << 20
"""Unread data above which a client is disconnected: about 25 s of nominal feedback."""

JOIN_NS: Final = 100_000_000
"""Delay from a client's handshake until it receives frames.

python-can's handshake reads up to 256 bytes once and expects exactly ``< ok >``: a frame in the same segment would
fail it. The kernel does not report when an answer has been read.
"""

_RECEIVE_BYTES: Final = 65_536

Inject = Callable[[str], str]
"""Causes the fault named by a text. Returns an error, or an empty text."""


class _Client:
    """A connection, and its unsent data."""

    def __init__(self, connection: socket.socket, name: str) -> None:
        self.connection = connection
        self.name = name
        self.protocol = ServerConnection()
        self.queued = bytearray()
        self.joins_ns: int | None = None
        self.watched = selectors.EVENT_READ


class SocketcandServer:
    """The bus. Each client receives the frames of the chassis and of the other clients, not its own."""

    def __init__(self, host: str, port: int) -> None:
        """Listen. Raises OSError: the address cannot be used."""
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        # socket.create_server sets SO_REUSEADDR where two servers cannot then share a port.
        self._listener = socket.create_server((host, port), family=family, backlog=16)
        self._listener.settimeout(0)
        # select() has microseconds; epoll's milliseconds would delay every frame by up to one.
        self._selector = selectors.SelectSelector()
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._clients: dict[socket.socket, _Client] = {}
        self._ready: list[tuple[selectors.SelectorKey, int]] = []

    @property
    def address(self) -> tuple[str, int]:
        """Host and port; the real port if 0 was requested."""
        host, port, *_ = self._listener.getsockname()
        return host, port

    @property
    def clients(self) -> int:
        return len(self._clients)

    def wait(self, timeout_s: float) -> None:
        """Wait for a client, at most this long."""
        self._ready = self._selector.select(timeout_s)

    def read(self, now_ns: int, wall_ns: int, inject: Inject) -> list[Frame]:
        """Handle the clients' requests, and return the frames that they put on the bus."""
        frames: list[Frame] = []
        for key, events in self._ready:
            client: _Client | None = key.data
            if client is None:
                self._accept()
                continue
            if events & selectors.EVENT_READ:
                frames += self._read_client(client, now_ns, wall_ns, inject)
            self._flush(client)
        self._ready = []
        return frames

    def send(self, frames: Iterable[Frame], now_ns: int) -> None:
        self._broadcast(frames, now_ns, None)

    def close(self) -> None:
        for client in list(self._clients.values()):
            self._drop_client(client, "the server ends")
        self._selector.close()
        self._listener.close()

    def _accept(self) -> None:
        try:
            connection, peer = self._listener.accept()
        except OSError:
            return  # The client has gone again.
        if len(self._clients) >= MAX_CLIENTS:
            with contextlib.suppress(OSError):
                connection.send(error_line(f"there are already {MAX_CLIENTS} clients"))
            connection.close()
            return
        connection.settimeout(0)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        client = _Client(connection, f"{peer[0]}:{peer[1]}")
        self._clients[connection] = client
        self._selector.register(connection, selectors.EVENT_READ, client)
        _logger.info("%s connected", client.name)
        client.queued += HI
        self._flush(client)

    def _read_client(self, client: _Client, now_ns: int, wall_ns: int, inject: Inject) -> list[Frame]:
        try:
            data = client.connection.recv(_RECEIVE_BYTES)
        except BlockingIOError:
            return []
        except OSError as error:
            self._drop_client(client, str(error))
            return []
        if not data:
            self._drop_client(client, "closed by the client")
            return []
        frames: list[Frame] = []
        for event in client.protocol.receive_bytes(data):
            if isinstance(event, Frame):
                frames.append(Frame(event.can_id, event.data, wall_ns, 0, event.remote_length))
            elif isinstance(event, FaultAsked):
                reason = inject(event.text)
                client.queued += error_line(reason) if reason else OK
            else:
                client.queued += event
        if client.protocol.is_raw and client.joins_ns is None:
            client.joins_ns = now_ns + JOIN_NS
        self._broadcast(frames, now_ns, client)
        return frames

    def _broadcast(self, frames: Iterable[Frame], now_ns: int, source: _Client | None) -> None:
        receivers = [
            client
            for client in self._clients.values()
            if client is not source and client.joins_ns is not None and now_ns >= client.joins_ns
        ]
        lines = [line for line in map(frame_line, frames) if line is not None] if receivers else []
        if not lines:
            return
        data = b"".join(lines)
        for client in receivers:
            client.queued += data
            self._flush(client)

    def _flush(self, client: _Client) -> None:
        """Send what the socket accepts, and wait for it to become writable if data is left."""
        if client.connection not in self._clients:
            return
        try:
            while client.queued:
                del client.queued[: client.connection.send(client.queued)]
        except BlockingIOError:
            if len(client.queued) > MAX_QUEUED_BYTES:
                self._drop_client(client, "it does not read")
                return
        except OSError as error:
            self._drop_client(client, str(error))
            return
        watched = selectors.EVENT_READ | (selectors.EVENT_WRITE if client.queued else 0)
        if watched != client.watched:
            client.watched = watched
            self._selector.modify(client.connection, watched, client)

    def _drop_client(self, client: _Client, reason: str) -> None:
        if self._clients.pop(client.connection, None) is None:
            return
        _logger.info("%s gone: %s", client.name, reason)
        self._selector.unregister(client.connection)
        client.connection.close()
