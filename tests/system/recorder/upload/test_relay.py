"""The way to a store: paced, for its own process alone, and with no request lost."""

import asyncio
import socket
import time
from base64 import b64encode
from collections.abc import Awaitable, Callable
from contextlib import suppress
from urllib.parse import urlsplit

import pytest

from recorder.upload.relay import FILLER, LESS_URGENT, _yield_to_others, paced_way

SIZE = 100_000


async def echo(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """A server that says again all that it is told."""
    while data := await reader.read(65_536):
        writer.write(data)
        await writer.drain()
    writer.close()


def through(rate: int, talk: Callable[[str, int], Awaitable[None]]) -> None:
    """Talk to a relay of this rate, beside the echo's port."""

    async def run() -> None:
        server = await asyncio.start_server(echo, "127.0.0.1", 0)
        async with paced_way(rate) as url:
            await talk(url, server.sockets[0].getsockname()[1])
        server.close()

    asyncio.run(run())


def head(method: str, target: str, url: str) -> bytes:
    """A request as a library makes it."""
    parts = urlsplit(url)
    word = b64encode(f"{parts.username}:{parts.password}".encode()).decode()
    return f"{method} {target} HTTP/1.1\r\nProxy-Authorization: Basic {word}\r\n\r\n".encode()


def test_nothing_is_faster_than_the_rate_and_nothing_is_lost() -> None:
    """As TLS goes through: a tunnel of bytes."""

    async def talk(url: str, port: int) -> None:
        reader, writer = await asyncio.open_connection("127.0.0.1", urlsplit(url).port)
        writer.write(head("CONNECT", f"127.0.0.1:{port}", url))
        assert await reader.readuntil(b"\r\n\r\n") == b"HTTP/1.1 200 OK\r\n\r\n"
        data = bytes(number % 251 for number in range(SIZE))
        began_s = time.monotonic()
        writer.write(data)
        assert await reader.readexactly(SIZE) == data
        # No bound of how slow: that is the machine's affair.
        assert time.monotonic() - began_s >= SIZE / 500_000 - 0.15
        writer.close()

    through(500_000, talk)


def test_a_plain_request_goes_where_it_says() -> None:
    """A server of one's own, without TLS."""

    async def talk(url: str, port: int) -> None:
        reader, writer = await asyncio.open_connection("127.0.0.1", urlsplit(url).port)
        request = head("GET", f"http://127.0.0.1:{port}/bucket", url)
        writer.write(request + b"body")
        assert await reader.readexactly(len(request) + 4) == request + b"body"
        writer.close()

    through(10_000_000, talk)


@pytest.mark.parametrize(
    "request_head",
    [
        b"CONNECT 127.0.0.1:%d HTTP/1.1\r\n\r\n",
        b"CONNECT 127.0.0.1:%d HTTP/1.1\r\nProxy-Authorization: Basic Y3J1aXNlcjo=\r\n\r\n",
        b"x" * 70_000,
        b"",
    ],
)
def test_who_does_not_know_its_word_gets_nothing(request_head: bytes) -> None:
    """Other processes of the robot have no way out by it."""

    async def talk(url: str, port: int) -> None:
        reader, writer = await asyncio.open_connection("127.0.0.1", urlsplit(url).port)
        writer.write(request_head.replace(b"%d", str(port).encode()))
        writer.write_eof()
        with suppress(ConnectionResetError):
            assert await reader.read() == b""
        writer.close()

    through(10_000_000, talk)


@pytest.mark.parametrize("target", ["127.0.0.1:1", "nowhere.invalid:443", "127.0.0.1:none", "nonsense"])
def test_a_store_that_is_not_there_ends_the_connection(target: str) -> None:
    """The library tries again, or says so."""

    async def talk(url: str, _port: int) -> None:
        reader, writer = await asyncio.open_connection("127.0.0.1", urlsplit(url).port)
        writer.write(head("CONNECT", target, url))
        assert await reader.read() == b""
        writer.close()

    through(10_000_000, talk)


@pytest.mark.parametrize("family", [socket.AF_INET, socket.AF_INET6])
def test_what_it_sends_is_less_urgent_than_all_else(family: socket.AddressFamily) -> None:
    """For routers on the way, and in the queue of this machine; little of it is under way."""
    with socket.socket(family, socket.SOCK_STREAM) as one:
        _yield_to_others(one, 100_000)
        level, option = (
            (socket.IPPROTO_IP, socket.IP_TOS)
            if family == socket.AF_INET
            else (socket.IPPROTO_IPV6, socket.IPV6_TCLASS)
        )
        assert one.getsockopt(level, option) == LESS_URGENT
        assert one.getsockopt(socket.SOL_SOCKET, socket.SO_PRIORITY) == FILLER
        # Linux gives twice of what it is asked for, for its own use.
        assert one.getsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF) == 50_000
