"""A radio uplink on the loopback: one queue for all connections, a rate, and the delays of a row of links.

What a sender has not got rid of waits in its own buffers, as before a modem: nothing is lost.
"""

import asyncio
import socket
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from random import Random
from typing import Final

from tests.support.links import LinkProfile

CHUNK_BYTES: Final = 1400
"""A packet: others get their turn behind it."""

TURN_S: Final = 0.005
"""The period in which packets are sent on: a busy machine gives no shorter one."""

LATER_S: Final = 1e-5
"""What is sent after something arrives after it: of calls for one time the event loop knows no order."""

BURST_S: Final = 0.05
"""After a pause no more is made up for than this time's."""

RECEIVE_BYTES: Final = 8192
"""The receive buffer towards the sender, which the system doubles: what waits shall wait at the sender."""


class PacedLink:
    """The uplink from whoever connects to it to a port of this machine.

    Attributes:
        up_bytes: so many have been carried from those who connect, and ``down_bytes`` to them.
    """

    def __init__(self, target: int, profile: LinkProfile, up_bytes_per_s: float, queue_packets: int) -> None:
        """Nothing is carried yet.

        Args:
            profile: the delay of each packet either way; none overtakes another.
            up_bytes_per_s: the rate upwards; down there is no limit.
            queue_packets: the places in the modem's queue, each for a packet of up to ``CHUNK_BYTES``.
        """
        self.up_bytes = self.down_bytes = 0
        self._target = target
        self._profile = profile
        self._rate = up_bytes_per_s
        self._places = asyncio.Semaphore(queue_packets)
        self._queue: deque[tuple[asyncio.StreamWriter, bytes]] = deque()
        self._random = Random(1)  # noqa: S311 - the same link each time
        self._listening = socket.socket()
        self._listening.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BYTES)
        # Else the loopback's segments are larger than the buffer, and each waits for a delayed acknowledgement.
        self._listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_MAXSEG, CHUNK_BYTES)
        self._listening.bind(("127.0.0.1", 0))
        self._listening.listen()
        self.port = int(self._listening.getsockname()[1])

    async def serve(self, ended: asyncio.Event) -> None:
        """Carry until this is set."""
        server = await asyncio.start_server(self._accept, sock=self._listening, limit=CHUNK_BYTES)
        pump = asyncio.create_task(self._pump())
        await ended.wait()
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
            allowed = min(allowed + (now_s - before_s) * self._rate, self._rate * BURST_S)
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
                arrives_s = max(arrives_s + LATER_S, now_s + self._profile.delay_s(self._random))
                loop.call_at(arrives_s, _write_all, sent)

    async def _down(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        loop = asyncio.get_running_loop()
        arrives_s = loop.time()
        while data := await reader.read(65_536):
            self.down_bytes += len(data)
            arrives_s = max(arrives_s + LATER_S, loop.time() + self._profile.delay_s(self._random))
            loop.call_at(arrives_s, _write, writer, data)
        await asyncio.sleep(max(0.0, arrives_s - loop.time()))
        writer.close()


@contextmanager
def paced_link(
    target: int, profile: LinkProfile, up_bytes_per_s: float, queue_packets: int = 12
) -> Iterator[PacedLink]:
    """A link that carries until the end, on a thread of its own."""
    link = PacedLink(target, profile, up_bytes_per_s, queue_packets)
    ready: Future[tuple[asyncio.AbstractEventLoop, asyncio.Event]] = Future()

    async def serve() -> None:
        ended = asyncio.Event()
        ready.set_result((asyncio.get_running_loop(), ended))
        await link.serve(ended)

    with ThreadPoolExecutor(1) as executor:
        serving = executor.submit(asyncio.run, serve())
        loop, ended = ready.result(10)
        try:
            yield link
        finally:
            loop.call_soon_threadsafe(ended.set)
            serving.result(10)


def _write_all(sent: dict[asyncio.StreamWriter, bytearray]) -> None:
    for writer, data in sent.items():
        _write(writer, bytes(data))


def _write(writer: asyncio.StreamWriter, data: bytes) -> None:
    if not writer.is_closing():
        writer.write(data)
