"""A bad link over TCP on the loopback: delay, a limited rate and queue upwards, a slow or stalled way back.

What a sender cannot send waits in its own buffers, as before a modem: nothing is lost.
"""

from __future__ import annotations

import asyncio
import re
import socket
from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from typing import Final, Self

CHUNK_BYTES: Final = 1400  # a packet: other connections get their turn behind it
TURN_S: Final = 0.005  # the period in which packets are forwarded; a busy machine reaches no shorter one
LATER_S: Final = 1e-5  # keeps the order: asyncio does not order calls for the same time
BURST_S: Final = 0.05  # after a pause the rate makes up for this time at most
RECEIVE_BYTES: Final = 8192  # towards the sender; the system doubles it, and the rest waits at the sender
WIDE: Final = 1e9


class TcpLink:
    """Carries connections to a port of this machine.

    Attributes:
        port, endpoint: where to connect instead.
        up_bytes, down_bytes: carried from those who connect, and to them.
        is_stalled: nothing more is read of what comes back.
    """

    def __init__(
        self,
        target: str,
        delay_s: Callable[[], float] = float,
        *,
        up_bytes_per_s: float = WIDE,
        down_bytes_per_s: float = WIDE,
        queue_packets: int = 12,
    ) -> None:
        """Carry to the port in ``target``; ``delay_s`` draws each packet's delay, and none overtakes another."""
        self.up_bytes = self.down_bytes = 0
        self.is_stalled = False
        self._target = re.findall(r":(\d+)", target)[0]
        self._delay_s = delay_s
        self._up_rate, self._down_rate = up_bytes_per_s, down_bytes_per_s
        self._places = asyncio.Semaphore(queue_packets)
        self._queue: deque[tuple[asyncio.StreamWriter, bytes]] = deque()
        self._listening = socket.socket()
        self._listening.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BYTES)
        # Else the loopback's segments are larger than the buffer, and each waits for a delayed acknowledgement.
        self._listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_MAXSEG, CHUNK_BYTES)
        self._listening.bind(("127.0.0.1", 0))
        self._listening.listen()
        self.port = int(self._listening.getsockname()[1])
        self.endpoint = f"tcp/127.0.0.1:{self.port}"
        self._ended = asyncio.Event()
        # On a thread of its own: a browser's driver has a loop on the test's.
        self._executor = ThreadPoolExecutor(1)

    def __enter__(self) -> Self:
        ready: Future[asyncio.AbstractEventLoop] = Future()
        self._serving = self._executor.submit(asyncio.run, self._serve(ready))
        self._loop = ready.result(10)
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Break all connections, and accept no more."""
        if not self._serving.done():
            self._loop.call_soon_threadsafe(self._ended.set)
        self._serving.result(10)
        self._executor.shutdown()

    async def _serve(self, ready: Future[asyncio.AbstractEventLoop]) -> None:
        server = await asyncio.start_server(self._accept, sock=self._listening, limit=CHUNK_BYTES)
        pump = asyncio.create_task(self._pump())
        ready.set_result(asyncio.get_running_loop())
        await self._ended.wait()
        server.close()
        pump.cancel()
        with suppress(asyncio.CancelledError):
            await pump

    async def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        there, back = await asyncio.open_connection("127.0.0.1", self._target)
        with suppress(asyncio.CancelledError, ConnectionError):  # at the end
            await asyncio.gather(self._up(reader, back), self._down(there, writer))
        for one in (back, writer):
            one.close()
            if self._ended.is_set():
                # The loop ends: it would not wait until what is unsent has gone, and leave the socket open.
                one.transport.abort()

    async def _up(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while data := await reader.read(CHUNK_BYTES):
            # Those who wait get their turns in the order in which they came.
            await self._places.acquire()
            self._queue.append((writer, data))
        writer.close()

    async def _pump(self) -> None:
        """Send what the rate allows, turn by turn; what goes in one turn arrives together."""
        loop = asyncio.get_running_loop()
        before_s = arrives_s = loop.time()
        allowed = 0.0
        while True:
            await asyncio.sleep(TURN_S)
            now_s = loop.time()
            allowed = min(allowed + (now_s - before_s) * self._up_rate, self._up_rate * BURST_S)
            before_s = now_s
            sent: dict[asyncio.StreamWriter, bytearray] = {}
            while self._queue and allowed > 0:
                writer, data = self._queue.popleft()
                allowed -= len(data)
                self._places.release()
                self.up_bytes += len(data)
                sent.setdefault(writer, bytearray()).extend(data)
            if not self._queue:
                allowed = min(allowed, 0.0)
            if sent:
                arrives_s = max(arrives_s + LATER_S, now_s + self._delay_s())
                loop.call_at(arrives_s, _write, sent)

    async def _down(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        loop = asyncio.get_running_loop()
        arrives_s = loop.time()
        most = min(65_536, int(self._down_rate * BURST_S))
        while data := await reader.read(most):
            if self.is_stalled:
                await self._ended.wait()
            self.down_bytes += len(data)
            arrives_s = max(arrives_s + LATER_S, loop.time() + self._delay_s())
            loop.call_at(arrives_s, _write, {writer: data})
            await asyncio.sleep(len(data) / self._down_rate)
        await asyncio.sleep(max(0.0, arrives_s - loop.time()))
        writer.close()


def _write(sent: Mapping[asyncio.StreamWriter, bytes | bytearray]) -> None:
    for writer, data in sent.items():
        if not writer.is_closing():
            writer.write(bytes(data))
