"""The desk's HTTP server: connections, the page, and messages between browsers and robots. Needs the extra 'desk'.

uvicorn, h11 and websockets process input as fast as it arrives. A few megabytes of tiny frames then block the loop
for seconds, and a robot that is driven through it stops by its deadman. So ``Door`` passes input on in portions.
Each WebSocket has its own rate; everything else, up to the end of a request, waits in one queue that serves peers
in turn.

One listener feeds all browsers, and one session carries their requests. All of it runs on one thread. Samples wait
in Zenoh's rings until the hub polls them.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import re
import resource
import socket
import ssl
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, cast

import msgspec
import uvicorn
from starlette.applications import Starlette
from starlette.datastructures import Headers, MutableHeaders
from starlette.middleware import Middleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.responses import RedirectResponse
from starlette.routing import BaseRoute, Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect

import gateway.desk
from gateway.cli.desk_logs import DeskLogs
from gateway.client.remote_stop import StopReport, stop_from_here
from gateway.desk import fleet_view, words
from gateway.desk.fleet_view import FleetView, reasons_in_words
from gateway.desk.words import BrowserOutbox, encode
from gateway.telemetry.samples import Received
from gateway.zenoh.client import DeskListener, PendingQuery
from gateway.zenoh.operator import CommandPort
from schemas import keys
from schemas.command_line import CommandError
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
from schemas.settings import Settings
from schemas.subjects import BY_VERB, STATEMENT_REPLY_ENCODING, STOP_VERB

log = logging.getLogger(__name__)

SOCKETS_MAX: Final = 128
PEER_SOCKETS_MAX: Final = 64  # WebSockets that are open, of all and of one peer
READ_BYTES: Final = 4096  # bytes that are read at a time. asyncio's own 256 KiB hold 43,000 frames.
REQUEST_BYTES: Final = 1024  # bytes of a request that are processed in one turn
TURNS_PER_S: Final = 100.0  # turns per second
TURNS_BURST_S: Final = 1.0  # turns for this time may be made up for after a pause: a page has twenty files
TURN_SHARE: Final = 0.2  # share of the time that turns may take

ACCEPTS: Final = 16
ACCEPTS_PAUSE_S: Final = 0.002  # pause after ACCEPTS connections
EXHAUSTED_S: Final = 1.0  # the pause after this process, or the machine, has run out of files or memory
UNREAD_S: Final = 60.0  # a peer that takes nothing of what it is sent for this time has gone
REQUEST_END: Final = re.compile(rb"\n\r?\n")

TOO_MUCH: Final = b"\x88\x02\x03\xf0"  # the frame that closes a WebSocket with code 1008, policy violation

TRY_AGAIN_LATER: Final = 1013
FULL: Final = "Too many pages are open from this address. Close one and try again."


class Door:
    """Accepts connections for an ASGI server, and is its outermost application."""

    def __init__(self, app: ASGIApp, listening: socket.socket) -> None:
        self._app = app
        self._listening = listening
        self.peers: Peers[_Connection] = Peers(most_connections(resource.getrlimit(resource.RLIMIT_NOFILE)[0]))
        self._sockets: Counter[str] = Counter()
        self._arriving: set[asyncio.Task[None]] = set()
        self.line = _Line()
        self.buffer = bytearray(READ_BYTES)  # shared by all connections: each copies its data out at once

    def open(
        self, make_protocol: Callable[[dict[str, Any]], asyncio.Protocol], context: ssl.SSLContext | None
    ) -> None:
        """Start to accept connections. ``make_protocol`` gets the state of its scopes."""
        self._make_protocol = make_protocol
        self._context = context
        self._listening.setblocking(False)  # noqa: FBT003 - the library's own
        asyncio.get_running_loop().add_reader(self._listening, self._accept)

    def close(self) -> None:
        asyncio.get_running_loop().remove_reader(self._listening)
        self._listening.close()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle a request, and tell its connection when the request is complete."""
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
            # A page can read the close code of an open socket, but no HTTP status.
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

    def _accept(self) -> None:
        loop = asyncio.get_running_loop()
        pause_s = ACCEPTS_PAUSE_S
        try:
            for _ in range(ACCEPTS):
                pause_s = max(pause_s, self.peers.pause_s(loop.time()))
                if pause_s > ACCEPTS_PAUSE_S:
                    break
                taken, (host, *_) = self._listening.accept()
                self._take_in(taken, peer_of(host), loop)
        except (BlockingIOError, ConnectionAbortedError, InterruptedError):
            return
        except OSError as error:
            log.warning("no connections accepted for a while: %s", error.strerror)
            pause_s = EXHAUSTED_S
        loop.remove_reader(self._listening)
        loop.call_later(pause_s, self._accept_again)

    def _accept_again(self) -> None:
        if self._listening.fileno() >= 0:
            asyncio.get_running_loop().add_reader(self._listening, self._accept)

    def _take_in(self, taken: socket.socket, peer: str, loop: asyncio.AbstractEventLoop) -> None:
        connection = _Connection(self, peer, taken, loop)
        gone = self.peers.enter(connection, peer, loop.time())
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
    """A queue of connections that are not WebSockets: one at a time, round-robin by peer."""

    def __init__(self) -> None:
        self._waiting: dict[str, deque[Callable[[], None]]] = {}
        self._rate = RateLimit(TURNS_PER_S, TURNS_BURST_S)
        self._is_going = False

    def join(self, peer: str, turn: Callable[[], None]) -> None:
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
    """One connection: received bytes wait here and go to the server's protocol in portions."""

    inner: asyncio.Protocol  # the server's protocol: of HTTP, and after it of a WebSocket

    def __init__(self, door: Door, peer: str, taken: socket.socket, loop: asyncio.AbstractEventLoop) -> None:
        self.peer = peer
        self._door = door
        self._socket = taken
        self._loop = loop
        self._transport: asyncio.Transport | None = None
        self._waiting = bytearray()
        self._frames: SocketFrames | None = None
        self._rate = RateLimit(SOCKET_BYTES_PER_S, SOCKET_BURST_S)
        self._is_held = False  # the server's protocol has paused reading
        self._is_due = False  # its turn is scheduled
        self._deadline: asyncio.TimerHandle | None = None

    def asks(self) -> None:
        """Note that a complete request has arrived."""
        self._drop_deadline()
        self._door.peers.asks(self)

    def rests(self) -> None:
        """Note that no request is in progress; the next must be complete within ``REQUEST_S``."""
        self._drop_deadline()
        self._deadline = self._loop.call_later(REQUEST_S, self.cut)
        self._door.peers.rests(self)

    def leave(self) -> None:
        self._drop_deadline()
        self._door.peers.leave(self)

    def cut(self) -> None:
        if self._transport is not None:
            self._transport.abort()
        else:
            # During the TLS handshake.
            with suppress(OSError):
                self._socket.shutdown(socket.SHUT_RDWR)

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Give the server's protocol a transport whose reading is controlled here."""
        self._transport = cast("asyncio.Transport", transport)
        self.inner.connection_made(cast("asyncio.Transport", _Way(self, self._transport)))

    def connection_lost(self, error: Exception | None) -> None:
        self.leave()
        self.inner.connection_lost(error)

    def pause_writing(self) -> None:
        self.inner.pause_writing()

    def resume_writing(self) -> None:
        self.inner.resume_writing()

    def get_buffer(self, sizehint: int) -> bytearray:  # noqa: ARG002 - the library's form
        return self._door.buffer

    def buffer_updated(self, nbytes: int) -> None:
        self._waiting += self._door.buffer[:nbytes]
        self._go_on(is_first=True)

    def hold(self, *, is_held: bool) -> None:
        """Pause or resume what the server's protocol gets."""
        self._is_held = is_held
        self._go_on()

    def become_socket(self, protocol: asyncio.Protocol) -> None:
        self.inner = protocol
        self._frames = SocketFrames()

    def _go_on(self, *, is_first: bool = False) -> None:
        """Pass data on when it is due, and read more only when nothing waits."""
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
            log.exception("closing a connection of %s: its data cannot be read", self.peer)
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

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401 - any attribute of the transport
        return getattr(self._transport, name)

    def pause_reading(self) -> None:
        self._connection.hold(is_held=True)

    def resume_reading(self) -> None:
        self._connection.hold(is_held=False)

    def set_protocol(self, protocol: asyncio.Protocol) -> None:
        """Switch to another protocol; uvicorn does so only for a WebSocket."""
        self._connection.become_socket(protocol)


POLL_S: Final = 0.01  # the period in which arrivals are taken from Zenoh, and sent on to who looks at their robot
ROWS_S: Final = 0.2  # period of the overview, sent even without changes as a sign of life

LATE_NS: Final = (
    1_000_000_000  # after a longer pause waiting states are outdated and dropped; newer ones follow at once
)

AGEING: Final = ("/state", "/gateway/health")

ASK_S: Final = 3.0  # the longest wait for the replies to a question
STOP_S: Final = 5.0

QUESTIONS_MAX: Final = 32  # questions of one browser that may be under way
REPLIES_MAX: Final = 64  # replies to one query that are passed on; more are a flood
STOPS_MAX: Final = 4  # pending stops per browser; further ones are sent, but their outcome is not tracked

STOP_THREADS: Final = 16

LOOK_NS: Final = (
    500_000_000  # shortest time between two histories for one browser: each takes milliseconds to make
)

SAMPLE_MAX_BYTES: Final = 65_536  # larger samples and replies are dropped; a gateway's have a few kilobytes

EVENT: Final = "safety/event"

CLOSE: Final = ("state", "safety/state", EVENT, "gateway/health")  # the subjects of a robot that is shown closely
REQUESTS: Final = {verb: (command.encoding, command.reply_encoding) for verb, command in sorted(BY_VERB.items())}

Stopper = Callable[[Settings, str, str, float], StopReport]


class Browser:
    """A connected browser.

    Attributes:
        questions: pending queries, by the browser's own numbers.
        stops: robots whose stop is being tracked for this browser.
        is_new_look: the history of its robot is still to be sent.
    """

    def __init__(self) -> None:
        self.outbox = BrowserOutbox()
        self.ready = asyncio.Event()
        self.questions: dict[int, PendingQuery] = {}
        self.replies: Counter[int] = Counter()
        self.stops: set[str] = set()
        self.is_new_look = False
        self.looked_ns: int | None = None

    def tell(self, message: words.ToBrowser) -> None:
        self.outbox.add(message)
        self.ready.set()


class Hub:
    """Carries samples to browsers, and their requests to robots."""

    def __init__(
        self,
        settings: Settings,
        listener: DeskListener,
        port: CommandPort,
        stopper: Stopper = stop_from_here,
        *,
        has_logs: bool = False,
    ) -> None:
        self._settings = settings
        self._root = settings.robot.root
        self._listener = listener
        self._port = port
        self._stopper = stopper
        self._has_logs = has_logs
        # A thread per pending stop: a silent robot delays no other stop.
        self._threads: Executor = ThreadPoolExecutor(STOP_THREADS, thread_name_prefix="stop")
        self._stopping: dict[str, set[Browser]] = {}
        self._view = FleetView(self._root)
        self._browsers: set[Browser] = set()
        self._now_ns = self._rows_ns = 0

    def join(self) -> Browser:
        """Add a browser, and send it the description of the desk and all rows."""
        browser = Browser()
        browser.tell(
            words.DeskHello(
                root=self._root,
                requests=REQUESTS,
                reasons=reasons_in_words(),
                statement_reply=STATEMENT_REPLY_ENCODING,
                period_s=fleet_view.PERIOD_NS / 1e9,
                has_logs=self._has_logs,
            )
        )
        rows, recorders = self._view.all_rows()
        browser.outbox.add_rows(rows, recorders, linked=self._listener.connected(), full=self._view.is_full)
        self._browsers.add(browser)
        return browser

    def leave(self, browser: Browser) -> None:
        self._browsers.discard(browser)

    async def run(self, ends: Callable[[], bool]) -> None:
        while not ends():
            self.step(time.monotonic_ns())
            await asyncio.sleep(POLL_S)

    def step(self, now_ns: int) -> None:
        """Process arrivals, and send each browser what it shows."""
        is_late = 0 < self._now_ns < now_ns - LATE_NS
        self._now_ns = now_ns
        self._carry_arrivals(is_late=is_late)
        for browser in self._browsers:
            self._carry_replies(browser)
            self._show_history(browser)
        if now_ns - self._rows_ns < ROWS_S * 1e9:
            return
        self._rows_ns = now_ns
        linked = self._listener.connected()
        self._view.update(now_ns, linked=linked)
        rows, recorders = self._view.changed_rows(now_ns)
        for browser in self._browsers:
            browser.outbox.add_rows(rows, recorders, linked=linked, full=self._view.is_full)
            browser.ready.set()
            robot = browser.outbox.robot
            for message in (self._view.histories.pose(robot), self._view.why(robot, now_ns)) if robot else ():
                if message is not None:
                    browser.tell(message)

    def receive(self, browser: Browser, data: bytes) -> None:
        """Process a browser's message. Errors are answered with a text."""
        try:
            self._process(browser, words.decode(data))
        except (msgspec.DecodeError, msgspec.ValidationError, RecursionError) as error:
            browser.tell(words.DeskRefused(f"the desk cannot read this message: {error}"))
        except (CommandError, ValueError) as error:
            browser.tell(words.DeskRefused(str(error)))

    def _process(self, browser: Browser, said: words.FromBrowser) -> None:
        match said:
            case words.BrowserLook(robot=robot):
                browser.outbox.look(robot)
                browser.is_new_look = bool(robot)
                self._show_history(browser)
            case words.BrowserDrive():
                key = keys.command(self._root, said.robot, said.operator, "drive")
                self._port.put_signed(key, "drive", said.payload, said.attachment)
            case words.BrowserStop():
                self._stop(browser, said)
            case words.BrowserAsk():
                if said.verb not in REQUESTS:
                    raise ValueError(f"unknown verb {said.verb!a}")
                key = keys.command(self._root, said.robot, said.operator, said.verb)
                self._ask(browser, said.number, key, BY_VERB[said.verb].encoding, said.payload, said.attachment)
            case words.BrowserAcknowledge():
                if not self._view.shows(said.robot):
                    raise ValueError(f"unknown robot {said.robot}")
                self._view.acknowledge(said.robot, said.word, said.operator)
            case words.BrowserShow():
                key = keys.authority(self._root, said.robot)
                self._ask(browser, said.number, key, "text/plain", said.statement, said.question)

    def _show_history(self, browser: Browser) -> None:
        """Send a browser the history of its robot, once, as soon as ``LOOK_NS`` allows."""
        is_early = browser.looked_ns is not None and self._now_ns - browser.looked_ns < LOOK_NS
        if not browser.is_new_look or is_early:
            return
        browser.is_new_look, browser.looked_ns = False, self._now_ns
        robot = browser.outbox.robot
        browser.tell(self._view.histories.of(robot, time.monotonic_ns()))
        for event in self._view.events(robot):
            browser.tell(_sample(EVENT, event))

    def _ask(
        self, browser: Browser, number: int, key: str, encoding: str, payload: bytes, attachment: bytes
    ) -> None:
        if len(browser.questions) >= QUESTIONS_MAX or number in browser.questions:
            raise ValueError("too many requests are pending: wait for their replies")
        question = PendingQuery()
        browser.questions[number] = question
        self._port.query(key, question, payload, encoding, attachment, ASK_S)

    def _stop(self, browser: Browser, said: words.BrowserStop) -> None:
        """Send the stop at once on the open session, and track its outcome on a separate one.

        Browsers that stop a robot whose stop is already being tracked get the same outcome.
        """
        robot = said.robot or keys.ALL
        self._port.put_signed(keys.command(self._root, robot, said.operator, STOP_VERB), STOP_VERB, b"", b"")
        if len(browser.stops | {robot}) > STOPS_MAX:
            fault = "the stop was sent; its outcome is not tracked, because too many stops are pending"
            browser.tell(words.DeskRefused(fault, stop=said.robot))
            return
        browser.stops.add(robot)
        if robot in self._stopping:
            self._stopping[robot].add(browser)
            return
        self._stopping[robot] = {browser}
        log.warning("%s stops %s", said.operator, said.robot or "all robots")
        loop = asyncio.get_running_loop()
        future = loop.run_in_executor(self._threads, self._stopper, self._settings, robot, said.operator, STOP_S)
        future.add_done_callback(lambda done: self._tell_stopped(robot, said.robot, done))

    def _tell_stopped(self, robot: str, named: str, done: asyncio.Future[StopReport]) -> None:
        """Send the outcome of a stop to all browsers that stopped this robot meanwhile."""
        outcome: words.DeskRefused | words.DeskStopped
        error = done.exception()
        if error is not None:
            outcome = words.DeskRefused(f"the outcome of the stop is unknown: {error}", stop=named)
        else:
            report = done.result()
            outcome = words.DeskStopped(
                named,
                report.stopped,
                report.refused,
                report.unconfirmed,
                report.silent,
                report.counted and report.linked,
            )
        for browser in self._stopping.pop(robot):
            browser.stops.discard(robot)
            browser.tell(outcome)

    def _carry_arrivals(self, *, is_late: bool) -> None:
        looked_at: dict[str, list[Browser]] = {}
        for browser in self._browsers:
            if browser.outbox.robot:
                looked_at.setdefault(browser.outbox.robot, []).append(browser)
        subjects = {f"{self._root}/{robot}/{name}": (robot, name) for robot in looked_at for name in CLOSE}
        for arrival in self._listener.drain():
            if isinstance(arrival, Received) and _size(arrival) > SAMPLE_MAX_BYTES:
                continue
            if is_late and isinstance(arrival, Received) and arrival.key.endswith(AGEING):
                continue
            self._view.receive(arrival)
            if not isinstance(arrival, Received) or arrival.key not in subjects:
                continue
            robot, name = subjects[arrival.key]
            sample = _sample(name, arrival)
            for browser in looked_at[robot]:
                browser.tell(sample)

    def _carry_replies(self, browser: Browser) -> None:
        for number, question in list(browser.questions.items()):
            for received in question.poll():
                browser.replies[number] += 1
                if browser.replies[number] > REPLIES_MAX or _size(received) > SAMPLE_MAX_BYTES:
                    continue
                browser.tell(
                    words.DeskReply(
                        number,
                        last=False,
                        key=received.key,
                        encoding=received.encoding,
                        payload=received.payload,
                        attachment=received.attachment,
                    )
                )
            if question.is_over:
                del browser.questions[number]
                del browser.replies[number]
                browser.tell(words.DeskReply(number, last=True))


def _size(received: Received) -> int:
    return len(received.key) + len(received.encoding) + len(received.payload) + len(received.attachment)


def _sample(subject: str, received: Received) -> words.DeskSample:
    return words.DeskSample(subject, received.key, received.encoding, received.payload, received.attachment)


PAGE: Final = Path(gateway.desk.__file__).parent / "page"

FOREIGN: Final = 4403
GONE_BY_LAG: Final = 4408
FAILED: Final = (
    1011  # WebSocket close codes: page of another server; browser does not read; message cannot be encoded
)

HEADERS: Final = {
    # Nothing but this server's own files, and no script in the page itself.
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-cache",
}

PING_S: Final = 2.0  # time to answer a ping


HEAD_BYTES: Final = 8192  # the longest head of a request


def make_app(hub: Hub, hosts: Sequence[str], logs: DeskLogs | None = None) -> Starlette:
    async def link(web: WebSocket) -> None:
        if not _is_own({"ws": "http", "wss": "https"}[web.url.scheme], web.headers):
            await web.close(FOREIGN)
            return
        await web.accept()
        await _serve(web, hub)

    return _make_site([WebSocketRoute("/link", link), *(logs.routes() if logs is not None else [])], hosts)


def make_logs_app(logs: DeskLogs, hosts: Sequence[str]) -> Starlette:
    return _make_site([Route("/", lambda _: RedirectResponse("/logs.html")), *logs.routes()], hosts)


async def _serve(web: WebSocket, hub: Hub) -> None:
    browser = hub.join()
    sending = asyncio.create_task(_send(web, browser))
    try:
        while True:
            message = await web.receive()
            if message["type"] == "websocket.disconnect":
                return
            hub.receive(browser, message.get("bytes") or b"")
    finally:
        hub.leave(browser)
        sending.cancel()
        with contextlib.suppress(asyncio.CancelledError, WebSocketDisconnect, RuntimeError):
            await sending


async def _send(web: WebSocket, browser: Browser) -> None:
    """Send what waits. While the browser does not read, waiting messages are merged or dropped."""
    code = GONE_BY_LAG
    try:
        while not browser.outbox.is_full:
            await browser.ready.wait()
            browser.ready.clear()
            for message in browser.outbox.take():
                await web.send_bytes(encode(message))
    except (OverflowError, TypeError, ValueError):
        # A page that is sent nothing more would show what was for what is.
        log.exception("a message to a browser cannot be encoded")
        code = FAILED
    await web.close(code)


class SecurityHeaders:
    """Adds default headers to each response."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        await self._app(scope, receive, send_with_headers)


def _make_site(routes: Sequence[BaseRoute], hosts: Sequence[str]) -> Starlette:
    """Make an application of these routes and the files of the page.

    A request with a Host header that is not in ``hosts`` is refused: its page's name points here (DNS rebinding).
    """
    return Starlette(
        routes=[*routes, Mount("/", StaticFiles(directory=PAGE, packages=[("schemas", "page")], html=True))],
        middleware=[
            Middleware(TrustedHostMiddleware, allowed_hosts=list(hosts), www_redirect=False),
            Middleware(SecurityHeaders),
        ],
    )


def _is_own(scheme: str, headers: Headers) -> bool:
    """Return True if the page comes from this server. Browsers always send the true origin."""
    return headers.get("origin") == f"{scheme}://{headers.get('host')}"


class _Server(uvicorn.Server):
    """A server that leaves signals to the command, and connections to the door."""

    def __init__(self, config: uvicorn.Config, door: Door) -> None:
        super().__init__(config)
        self._door = door

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        yield

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        self._door.open(self._protocol, self.config.ssl)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        self._door.close()
        await super().shutdown(sockets)

    def _protocol(self, state: dict[str, Any]) -> asyncio.Protocol:
        protocol: Callable[..., asyncio.Protocol] = self.config.http_protocol_class
        return protocol(config=self.config, server_state=self.server_state, app_state=state)


async def serve(
    app: Starlette,
    listening: socket.socket,
    ends: Callable[[], bool],
    certificate: tuple[Path, Path] | None = None,
    socket_bytes: int = 0,
) -> None:
    """Serve on a bound socket until ``ends()``.

    Args:
        certificate: files of the chain and its private key, PEM; None: plain HTTP.
        socket_bytes: the longest message over a WebSocket; 0: no WebSockets.
    """
    chain, key = certificate if certificate is not None else (None, None)
    door = Door(app, listening)
    server = _Server(
        uvicorn.Config(
            door,
            ws="websockets-sansio" if socket_bytes else "none",
            ws_max_size=socket_bytes,
            ws_ping_interval=PING_S,
            ws_ping_timeout=PING_S,
            ws_per_message_deflate=False,
            lifespan="off",
            access_log=False,
            log_config=None,
            server_header=False,
            date_header=False,
            timeout_graceful_shutdown=1,
            ssl_certfile=chain,
            ssl_keyfile=key,
            h11_max_incomplete_event_size=HEAD_BYTES,
        ),
        door,
    )

    async def end() -> None:
        while not ends():  # noqa: ASYNC110 - a signal sets it, not this loop
            await asyncio.sleep(0.1)
        server.should_exit = True

    async with asyncio.TaskGroup() as group:
        group.create_task(end())
        await server.serve([])
