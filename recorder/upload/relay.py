"""The way to a store over the network, at a bounded rate: a proxy of this machine, for this process alone.

A library that uploads sends each part as fast as the link takes it, and fills the queues on the way, in which the
robot's commands wait too. So its connections lead through here. TLS stays between the library and the store. What
passes is paced, marked as less urgent than all else, and never more than a moment of it is under way.
"""

from __future__ import annotations

import asyncio
import secrets
import socket
import time
from base64 import b64encode
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager, suppress
from typing import Final, cast
from urllib.parse import urlsplit

from schemas.rate_limit import RateLimit

PIECE_BYTES: Final = 8192

HEAD_BYTES: Final = 65_536
"""The longest head of a request."""

UNDER_WAY_S: Final = 0.25
"""So much of the rate may be under way, in both directions: the length of the queue that this can fill."""

UNDER_WAY_MIN_BYTES: Final = 16_384

LESS_URGENT: Final = 0x04
"""The traffic class of RFC 8622, lower effort: routers that know it let everything else pass first."""

FILLER: Final = 1
"""The same for this machine's own queue: TC_PRIO_FILLER of Linux."""


class _Relay:
    """Connections of the library, and to each the one that belongs to it."""

    def __init__(self, up: RateLimit, down: RateLimit, token: bytes) -> None:
        self._up, self._down = up, down
        self._token = token
        self._ways: set[asyncio.Task[None]] = set()

    async def end(self) -> None:
        """Cut all connections: the library keeps some that it may need again."""
        ways = list(self._ways)
        for way in ways:
            way.cancel()
        await asyncio.gather(*ways, return_exceptions=True)
        # What was cut is closed in the loop's next round.
        await asyncio.sleep(0)

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Carry one connection to its end."""
        way = cast("asyncio.Task[None]", asyncio.current_task())
        self._ways.add(way)
        there: asyncio.StreamWriter | None = None
        try:
            head = await reader.readuntil(b"\r\n\r\n")
            if self._token not in head:
                return
            method, target, *_ = head.split(b" ", 2)
            if method == b"CONNECT":
                host, _, port = target.decode().rpartition(":")
                answers, there = await self._connect(host.strip("[]"), int(port))
                writer.write(b"HTTP/1.1 200 OK\r\n\r\n")
            else:
                url = urlsplit(target.decode())
                answers, there = await self._connect(url.hostname or "", url.port or 80)
                await _send(there, head, self._up)
            await asyncio.gather(_carry(reader, there, self._up), _carry(answers, writer, self._down))
        except (OSError, ValueError, asyncio.IncompleteReadError, asyncio.LimitOverrunError):
            # The library sees that its connection has ended, and tries again.
            pass
        except asyncio.CancelledError:
            # By ``end``, and nothing follows; Python 3.11 would say in the log that it was cancelled.
            pass
        finally:
            for one in (writer, there):
                if one is not None:
                    one.transport.abort()
            self._ways.discard(way)

    async def _connect(self, host: str, port: int) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        loop = asyncio.get_running_loop()
        failure: OSError = ConnectionError(f"{host} is nowhere")
        for family, _, _, _, address in await loop.getaddrinfo(host, port, type=socket.SOCK_STREAM):
            one = socket.socket(family, socket.SOCK_STREAM)
            try:
                _yield_to_others(one, self._up.per_s)
                one.setblocking(False)  # noqa: FBT003 - the library's own
                await loop.sock_connect(one, address)
                return await asyncio.open_connection(sock=one, limit=PIECE_BYTES)
            except OSError as error:
                one.close()
                failure = error
            except BaseException:
                one.close()
                raise
        raise failure


def _yield_to_others(one: socket.socket, bytes_per_s: float) -> None:
    """Before it is connected: little of it under way, and that less urgent than all else."""
    under_way = max(UNDER_WAY_MIN_BYTES, int(UNDER_WAY_S * bytes_per_s))
    one.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, under_way)
    one.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, under_way)
    with suppress(OSError):
        if one.family == socket.AF_INET6:
            one.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_TCLASS, LESS_URGENT)
        else:
            one.setsockopt(socket.IPPROTO_IP, socket.IP_TOS, LESS_URGENT)
        # Behind the class, which sets this too.
        one.setsockopt(socket.SOL_SOCKET, socket.SO_PRIORITY, FILLER)


async def _carry(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, pace: RateLimit) -> None:
    try:
        while piece := await reader.read(PIECE_BYTES):
            await _send(writer, piece, pace)
    finally:
        # One that has said all may still listen; but no HTTP client of these does.
        writer.close()


async def _send(writer: asyncio.StreamWriter, piece: bytes, pace: RateLimit) -> None:
    writer.write(piece)
    await writer.drain()
    await asyncio.sleep(pace.delay_s(len(piece), time.monotonic()))


@asynccontextmanager
async def paced_way(bytes_per_s: int) -> AsyncGenerator[str, None]:
    """The URL of a proxy of this rate, in each direction. Who does not know the URL gets nothing from it."""
    word = f"cruiser:{secrets.token_hex(16)}"
    relay = _Relay(RateLimit(bytes_per_s), RateLimit(bytes_per_s), b64encode(word.encode()))
    server = await asyncio.start_server(relay.serve, "127.0.0.1", 0, limit=HEAD_BYTES)
    try:
        yield f"http://{word}@127.0.0.1:{server.sockets[0].getsockname()[1]}"
    finally:
        server.close()
        await relay.end()
