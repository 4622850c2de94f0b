"""The desk's connections over raw sockets: no flood is read as it comes, and no peer takes all places."""

import asyncio
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, suppress

import pytest
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import PlainTextResponse
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket

from gateway.cli import desk_server as door
from gateway.cli.desk import listening_socket
from gateway.cli.desk_server import serve
from schemas.peers import FRAME_BYTES, PEER_CONNECTIONS_MAX, PIECES_MAX, SOCKET_BURST_S, SOCKET_BYTES_PER_S
from tests.support.waiting import wait_until

LONG_S = 20.0
UPGRADE = (
    b"GET /link HTTP/1.1\r\nHost: here\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n"
    b"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n"
)
GET = b"GET /hello HTTP/1.1\r\nHost: here\r\n\r\n"
MASK = b"\0\0\0\0"
PING = b"\x89\x80" + MASK
HELLO = b"\x82\x85" + MASK + b"hello"
REPLY = b"\x82\x05hello"


async def echo(link: WebSocket) -> None:
    await link.accept()
    while (message := await link.receive())["type"] != "websocket.disconnect":
        await link.send_bytes(message["bytes"])


async def body(request: Request) -> PlainTextResponse:
    return PlainTextResponse(str(len(await request.body())))


@pytest.fixture
def port() -> Iterator[int]:
    routes = [
        WebSocketRoute("/link", echo),
        Route("/hello", lambda _request: PlainTextResponse("hello")),
        Route("/body", body, methods=["POST"]),
    ]
    ended = threading.Event()
    listening = listening_socket("127.0.0.1", 0)
    number: int = listening.getsockname()[1]
    serving = threading.Thread(
        target=lambda: asyncio.run(serve(Starlette(routes=routes), listening, ended.is_set, None, 1000))
    )
    serving.start()
    yield number
    ended.set()
    serving.join()


def connect(port: int, source: str = "127.0.0.1") -> socket.socket:
    return socket.create_connection(("127.0.0.1", port), LONG_S, source_address=(source, 0))


def link(port: int) -> socket.socket:
    opened = connect(port)
    opened.sendall(UPGRADE)
    assert b" 101 " in until(opened, b"\r\n\r\n")
    return opened


def until(opened: socket.socket, end: bytes) -> bytes:
    got = b""
    while not got.endswith(end):
        piece = opened.recv(1)
        assert piece, got
        got += piece
    return got


def rest(opened: socket.socket) -> bytes:
    got = b""
    try:
        while piece := opened.recv(65_536):
            got += piece
    except ConnectionError:
        pass
    return got


def test_of_a_flood_of_frames_so_many_are_read_as_a_page_says(port: int) -> None:
    with closing(link(port)) as loud, closing(link(port)) as page:
        loud.settimeout(0.0)
        began_s, pongs, replies = time.monotonic(), 0, 0
        while time.monotonic() < began_s + 1.0 or not replies:
            for _ in range(10):
                try:
                    loud.send(PING * 10_000)
                except BlockingIOError:
                    break
            with suppress(BlockingIOError):
                pongs += len(loud.recv(1 << 20)) // 2
            page.sendall(HELLO)
            until(page, REPLY)
            replies += 1
        took_s = time.monotonic() - began_s
        assert pongs * FRAME_BYTES <= SOCKET_BYTES_PER_S * (SOCKET_BURST_S + took_s) + 16 * FRAME_BYTES


def test_connections_that_ask_for_nothing_keep_nobody_out(port: int) -> None:
    with ExitStack() as stack:
        half: list[socket.socket] = []
        while len(half) < 2 * PEER_CONNECTIONS_MAX:
            one = stack.enter_context(closing(connect(port)))
            one.send(b"GET / HTTP/1.1\r\nHost: here\r\n")
            half.append(one)
        for source in ("127.0.0.1", "127.0.0.2"):

            def answered(source: str = source) -> bool:
                # Who connects as fast as this test did waits a moment first.
                with closing(connect(port, source)) as asking:
                    try:
                        asking.sendall(GET)
                        return asking.recv(100).startswith(b"HTTP/1.1 200 ")
                    except ConnectionError:
                        return False

            wait_until(answered)


@pytest.mark.parametrize(
    "said",
    [
        b"",
        b"GET /hello HTTP/1.1\r\nHost: here\r\n",
        GET + b"GET /hello HTTP/1.1\r\nX: ",
        b"POST /body HTTP/1.1\r\nHost: here\r\nContent-Length: 5\r\n\r\nhell",
    ],
    ids=["nothing", "half a head", "half of a second head", "half a body"],
)
def test_a_request_has_a_time_to_be_whole_in(said: bytes, port: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(door, "REQUEST_S", 0.5)
    with closing(connect(port)) as slow:
        slow.sendall(said)
        slow.settimeout(0.05)
        end_s = time.monotonic() + LONG_S
        while time.monotonic() < end_s:
            try:
                if said != GET and not said.startswith(b"POST"):
                    slow.send(b"x")
                if not slow.recv(65_536):
                    return
            except TimeoutError:
                continue
            except ConnectionError:
                return
        raise AssertionError("it was never cut")


def test_a_socket_that_is_one_too_many_is_told_so(port: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(door, "PEER_SOCKETS_MAX", 1)
    first = link(port)
    with closing(link(port)) as refused:
        got = refused.recv(100)
        assert (got[0], got[2:4]) == (0x88, door.TRY_AGAIN_LATER.to_bytes(2))
        assert door.FULL.encode() in got
    first.close()

    def has_room() -> bool:
        with closing(link(port)) as page:
            page.sendall(HELLO)
            return page.recv(100) == REPLY

    wait_until(has_room)


def test_a_message_in_endless_pieces_is_refused(port: int) -> None:
    """Each piece is empty, and would be stored."""
    with closing(link(port)) as loud:
        loud.sendall(b"\x02\x80" + MASK + (b"\x00\x80" + MASK) * (PIECES_MAX + 1))
        assert rest(loud) == door.TOO_MUCH


def test_of_a_flood_of_requests_so_many_are_answered_as_there_are_turns(port: int) -> None:
    with ExitStack() as stack:
        flood = [stack.enter_context(closing(connect(port))) for _ in range(20)]
        began_s, answers, left = time.monotonic(), 0, dict.fromkeys(flood, GET * 200)
        for loud in flood:
            loud.settimeout(0.0)
        while time.monotonic() < began_s + 1.5 or not answers:
            for loud in flood:
                with suppress(BlockingIOError):
                    left[loud] = left[loud][loud.send(left[loud]) :]
                with suppress(BlockingIOError):
                    answers += loud.recv(65_536).count(b" 200 OK")
        took_s = time.monotonic() - began_s
        assert answers <= door.TURNS_PER_S * (door.TURNS_BURST_S + took_s) + 1
