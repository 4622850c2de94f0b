"""The door of a server of pages: connections, and what they say, are bounded before anything reads it.

The protocols of uvicorn, h11 and websockets read what they are given, as fast as it comes. A few megabytes of
the smallest frames keep a loop busy for seconds: a robot that is driven through it stops by its deadman. So they
are given portions. A WebSocket has a rate of its own: a page that drives waits for no other. All else, from the
first byte to the end of a request, waits in one line, where peers take turns.
"""

from __future__ import annotations

import asyncio
import logging
import re
import resource
import socket
import ssl
from collections import Counter, deque
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Final, cast

from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket

from schemas.peers import (
    PIECES_MAX,
    REQUEST_S,
    SOCKET_BURST_S,
    SOCKET_BYTES_PER_S,
    Peers,
    RateLimit,
    SocketFrames,
    most_connections,
    peer_of,
)

log = logging.getLogger(__name__)

SOCKETS_MAX: Final = 128
PEER_SOCKETS_MAX: Final = 64
"""WebSockets that are open, of all and of one peer."""

READ_BYTES: Final = 4096
"""Bytes that are read at a time. asyncio's own 256 KiB hold 43,000 frames."""

REQUEST_BYTES: Final = 1024
"""Bytes of a request that are read in a turn..."""

TURNS_PER_S: Final = 100.0
"""... turns in a second..."""

TURNS_BURST_S: Final = 1.0
"""... after a pause of this time so many more at once as there was time for: a page has twenty files..."""

TURN_SHARE: Final = 0.2
"""... and the part of the time that they may take."""

ACCEPTS: Final = 16
ACCEPTS_PAUSE_S: Final = 0.002
"""So many connections are accepted, then there is a pause."""

EXHAUSTED_S: Final = 1.0
"""The pause after this process, or the machine, has run out of files or memory."""

UNREAD_S: Final = 60.0
"""A peer that takes nothing of what it is sent for this time has gone."""

REQUEST_END: Final = re.compile(rb"\n\r?\n")

TOO_MUCH: Final = b"\x88\x02\x03\xf0"
"""The frame that closes a WebSocket with the code 1008: it broke a rule of this server."""

TRY_AGAIN_LATER: Final = 1013
FULL: Final = "Too many pages of this address are open here. Close one, and try again."
"""The code with which a WebSocket is refused, and its reason."""


class Door:
    """Takes connections in for an ASGI server, and is its outermost application.

    Args:
        app: the application inside.
        listening: the socket, bound.
    """

    def __init__(self, app: ASGIApp, listening: socket.socket) -> None:
        self._app = app
        self._listening = listening
        self._peers: Peers[_Connection] = Peers(most_connections(resource.getrlimit(resource.RLIMIT_NOFILE)[0]))
        self._sockets: Counter[str] = Counter()
        self._arriving: set[asyncio.Task[None]] = set()
        self.line = _Line()
        self.buffer = bytearray(READ_BYTES)
        """Of all connections: what is read is taken out at once."""

    def open(
        self, make_protocol: Callable[[dict[str, Any]], asyncio.Protocol], context: ssl.SSLContext | None
    ) -> None:
        """Take connections in from now on.

        Args:
            make_protocol: makes a protocol of the server, with what it puts into the state of its scopes.
            context: with it connections are TLS.
        """
        self._make_protocol = make_protocol
        self._context = context
        self._listening.setblocking(False)  # noqa: FBT003 - the library's own
        asyncio.get_running_loop().add_reader(self._listening, self._accept)

    def close(self) -> None:
        """Take nobody in any more."""
        asyncio.get_running_loop().remove_reader(self._listening)
        self._listening.close()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, and know of its connection that it has asked."""
        connection: _Connection = scope["state"]["connection"]
        if scope["type"] == "websocket":
            await self._answer_socket(connection, scope, receive, send)
            return

        async def receive_body() -> Message:
            message = await receive()
            if not message.get("more_body", False):
                connection.asks()
            return message

        # A body may take no longer than the head.
        has_body = any(name in {b"content-length", b"transfer-encoding"} for name, _ in scope["headers"])
        if not has_body:
            connection.asks()
        try:
            await self._app(scope, receive_body if has_body else receive, send)
        finally:
            connection.rests()

    async def _answer_socket(self, connection: _Connection, scope: Scope, receive: Receive, send: Send) -> None:
        peer = connection.peer
        if self._sockets[peer] >= PEER_SOCKETS_MAX or self._sockets.total() >= SOCKETS_MAX:
            # A page learns the code of one that was open, and no status.
            refused = WebSocket(scope, receive, send)
            await refused.accept()
            await refused.close(TRY_AGAIN_LATER, FULL)
            return
        self._sockets[peer] += 1
        connection.asks()
        try:
            await self._app(scope, receive, send)
        finally:
            self._sockets[peer] -= 1
            connection.rests()

    def leave(self, connection: _Connection) -> None:
        """A connection has ended."""
        self._peers.leave(connection)

    def asks(self, connection: _Connection) -> None:
        """A connection has asked for something."""
        self._peers.asks(connection)

    def rests(self, connection: _Connection) -> None:
        """A connection has been answered."""
        self._peers.rests(connection)

    def _accept(self) -> None:
        loop = asyncio.get_running_loop()
        pause_s = ACCEPTS_PAUSE_S
        try:
            for _ in range(ACCEPTS):
                pause_s = max(pause_s, self._peers.pause_s(loop.time()))
                if pause_s > ACCEPTS_PAUSE_S:
                    break
                taken, (host, *_) = self._listening.accept()
                self._take_in(taken, peer_of(host), loop)
        except (BlockingIOError, ConnectionAbortedError, InterruptedError):
            return
        except OSError as error:
            log.warning("nobody is let in for a while: %s", error.strerror)
            pause_s = EXHAUSTED_S
        loop.remove_reader(self._listening)
        loop.call_later(pause_s, self._accept_again)

    def _accept_again(self) -> None:
        if self._listening.fileno() >= 0:
            asyncio.get_running_loop().add_reader(self._listening, self._accept)

    def _take_in(self, taken: socket.socket, peer: str, loop: asyncio.AbstractEventLoop) -> None:
        connection = _Connection(self, peer, taken, loop)
        gone = self._peers.enter(connection, peer, loop.time())
        if gone is None:
            taken.close()
            return
        for one in gone:
            one.cut()
        taken.setblocking(False)  # noqa: FBT003 - the library's own
        taken.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, int(UNREAD_S * 1000))
        connection.rests()
        connection.inner = self._make_protocol({"connection": connection})
        arriving = loop.create_task(self._connect(taken, connection, loop))
        self._arriving.add(arriving)
        arriving.add_done_callback(self._arriving.discard)

    async def _connect(
        self, taken: socket.socket, connection: _Connection, loop: asyncio.AbstractEventLoop
    ) -> None:
        try:
            await loop.connect_accepted_socket(
                lambda: connection,
                taken,
                ssl=self._context,
                ssl_shutdown_timeout=REQUEST_S if self._context is not None else None,
            )
        except OSError:
            # It speaks no TLS, or has gone meanwhile.
            connection.leave()


class _Line:
    """Connections that are no WebSocket yet: one at a time, peers in turn, and those of a peer in turn."""

    def __init__(self) -> None:
        self._waiting: dict[str, deque[Callable[[], None]]] = {}
        self._rate = RateLimit(TURNS_PER_S, TURNS_BURST_S)
        self._is_going = False

    def join(self, peer: str, turn: Callable[[], None]) -> None:
        """Wait at the end of one's peer for the turn."""
        self._waiting.setdefault(peer, deque()).append(turn)
        if not self._is_going:
            self._is_going = True
            self._wait()

    def _wait(self) -> None:
        loop = asyncio.get_running_loop()
        loop.call_later(self._rate.delay_s(0, loop.time()), self._go)

    def _go(self) -> None:
        peer = next(iter(self._waiting))
        turns = self._waiting.pop(peer)
        turn = turns.popleft()
        if turns:
            self._waiting[peer] = turns
        loop = asyncio.get_running_loop()
        began_s = loop.time()
        turn()
        now_s = loop.time()
        self._rate.delay_s(max(1.0, (now_s - began_s) / TURN_SHARE * TURNS_PER_S), now_s)
        if self._waiting:
            self._wait()
        else:
            self._is_going = False


class _Connection(asyncio.BufferedProtocol):
    """One connection: what it says waits here, and goes on to the server's protocol in portions.

    Attributes:
        peer: whose it is.
        inner: the server's protocol: of HTTP, and after it of a WebSocket.
    """

    inner: asyncio.Protocol

    def __init__(self, door: Door, peer: str, taken: socket.socket, loop: asyncio.AbstractEventLoop) -> None:
        self.peer = peer
        self._door = door
        self._socket = taken
        self._loop = loop
        self._transport: asyncio.Transport | None = None
        self._waiting = bytearray()
        self._frames: SocketFrames | None = None
        self._rate = RateLimit(SOCKET_BYTES_PER_S, SOCKET_BURST_S)
        self._is_held = False
        """The server's protocol wants nothing more for now."""
        self._is_due = False
        """Its turn will come."""
        self._deadline: asyncio.TimerHandle | None = None

    def asks(self) -> None:
        """It has asked for something whole."""
        self._drop_deadline()
        self._door.asks(self)

    def rests(self) -> None:
        """Nothing that it has asked for is under way: the time until it does is bounded."""
        self._drop_deadline()
        self._deadline = self._loop.call_later(REQUEST_S, self.cut)
        self._door.rests(self)

    def leave(self) -> None:
        """Make room."""
        self._drop_deadline()
        self._door.leave(self)

    def cut(self) -> None:
        """End it at once."""
        if self._transport is not None:
            self._transport.abort()
        else:
            # In the midst of its TLS handshake.
            with suppress(OSError):
                self._socket.shutdown(socket.SHUT_RDWR)

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Give the server's protocol a transport whose reading is ours."""
        self._transport = cast("asyncio.Transport", transport)
        self.inner.connection_made(cast("asyncio.Transport", _Way(self, self._transport)))

    def connection_lost(self, error: Exception | None) -> None:
        """Tell the server's protocol, and make room."""
        self.leave()
        self.inner.connection_lost(error)

    def pause_writing(self) -> None:
        """Pass it on."""
        self.inner.pause_writing()

    def resume_writing(self) -> None:
        """Pass it on."""
        self.inner.resume_writing()

    def get_buffer(self, sizehint: int) -> bytearray:  # noqa: ARG002 - the library's form
        """Return a place for little."""
        return self._door.buffer

    def buffer_updated(self, nbytes: int) -> None:
        """Let it wait for its turn."""
        self._waiting += self._door.buffer[:nbytes]
        self._go_on(is_first=True)

    def hold(self, *, is_held: bool) -> None:
        """The server's protocol wants more from now on, or nothing."""
        self._is_held = is_held
        self._go_on()

    def become_socket(self, protocol: asyncio.Protocol) -> None:
        """It is a WebSocket from now on."""
        self.inner = protocol
        self._frames = SocketFrames()

    def _go_on(self, *, is_first: bool = False) -> None:
        """Read more only when nothing waits here."""
        if self._transport is None or self._transport.is_closing():
            return
        if self._is_held or self._waiting:
            self._transport.pause_reading()
        else:
            self._transport.resume_reading()
        if self._is_held or self._is_due or not self._waiting:
            return
        self._is_due = True
        if self._frames is None:
            self._door.line.join(self.peer, self._pass_on)
            return
        delay_s = self._rate.delay_s(0, self._loop.time())
        if is_first and not delay_s:
            # At once: a stop goes on before this loop, late as it may be, finds that its page has gone.
            self._pass_on()
        else:
            self._loop.call_later(delay_s, self._pass_on)

    def _pass_on(self) -> None:
        self._is_due = False
        if self._transport is None or self._transport.is_closing() or self._is_held:
            return
        if self._frames is None:
            # At most one request.
            end = REQUEST_END.search(self._waiting, 0, REQUEST_BYTES)
            count = end.end() if end else REQUEST_BYTES
        else:
            count, cost = self._frames.portion(self._waiting)
            self._rate.delay_s(cost, self._loop.time())
        portion = bytes(self._waiting[:count])
        del self._waiting[:count]
        try:
            self.inner.data_received(portion)
        except Exception:
            log.exception("a connection of %s is cut: what it said cannot be read", self.peer)
            self.cut()
            return
        if self._frames is not None and self._frames.pieces > PIECES_MAX:
            self._transport.write(TOO_MUCH)
            self._transport.close()
        self._go_on()

    def _drop_deadline(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None


class _Way:
    """A connection's transport, as the server's protocols see it."""

    def __init__(self, connection: _Connection, transport: asyncio.Transport) -> None:
        self._connection = connection
        self._transport = transport

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401 - whatever the transport has
        return getattr(self._transport, name)

    def pause_reading(self) -> None:
        """Give the protocol nothing more."""
        self._connection.hold(is_held=True)

    def resume_reading(self) -> None:
        """Give the protocol more, when it is its turn."""
        self._connection.hold(is_held=False)

    def set_protocol(self, protocol: asyncio.Protocol) -> None:
        """Speak with another protocol from now on: uvicorn does so for a WebSocket alone."""
        self._connection.become_socket(protocol)
