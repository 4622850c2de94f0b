"""A TCP server on the loopback that is far away: whatever goes through arrives later, in order."""

import asyncio
import socket
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress


@contextmanager
def far_tcp(port: int, delay_s: float) -> Iterator[int]:
    """Forward connections to a port of this machine, each way so late. Gives the port to connect to."""
    listening = socket.create_server(("127.0.0.1", 0))
    ready: Future[tuple[asyncio.AbstractEventLoop, asyncio.Event]] = Future()

    async def accept(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        there, back = await asyncio.open_connection("127.0.0.1", port)
        with suppress(asyncio.CancelledError):  # at the end
            await asyncio.gather(_carry(reader, back, delay_s), _carry(there, writer, delay_s))
        back.close()
        writer.close()

    async def serve() -> None:
        ended = asyncio.Event()
        server = await asyncio.start_server(accept, sock=listening)
        ready.set_result((asyncio.get_running_loop(), ended))
        await ended.wait()
        server.close()

    # On a thread of its own: a browser's driver has a loop on the test's.
    with ThreadPoolExecutor(1) as executor:
        serving = executor.submit(asyncio.run, serve())
        loop, ended = ready.result(10)
        try:
            yield listening.getsockname()[1]
        finally:
            loop.call_soon_threadsafe(ended.set)
            serving.result(10)


async def _carry(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, delay_s: float) -> None:
    loop = asyncio.get_running_loop()
    with suppress(ConnectionError, asyncio.CancelledError):
        while data := await reader.read(65_536):
            loop.call_later(delay_s, _write, writer, data)
        await asyncio.sleep(delay_s)
    writer.close()


def _write(writer: asyncio.StreamWriter, data: bytes) -> None:
    if not writer.is_closing():
        writer.write(data)
