"""A TCP proxy on the loopback: a way back that stops on command, or is slow."""

import select
import socket
import threading
from contextlib import suppress
from typing import Final, Self

BUFFER_BYTES: Final = 65_536
"""Small, so that what is not read fills the way soon."""

SLOW_BYTES: Final = 64
"""Of a slow way so many are read at a time."""


class TcpProxy:
    """Forwards one connection to ``endpoint``, both ways until ``stall``; then nothing comes back from there.

    Attributes:
        slowness_s: a wait after each 64 bytes that come back from there; 0 for a fast way.
    """

    def __init__(self, endpoint: str, slowness_s: float = 0) -> None:
        self.slowness_s = slowness_s
        host, port = endpoint.removeprefix("tcp/").split(":")
        self._server = socket.create_server(("127.0.0.1", 0))
        self.endpoint = f"tcp/127.0.0.1:{self._server.getsockname()[1]}"
        self._target = (host, int(port))
        self._stalled = threading.Event()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._forward)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def stall(self) -> None:
        """Read nothing more of what the endpoint sends."""
        self._stalled.set()

    def close(self) -> None:
        self._ended.set()
        self._thread.join()
        self._server.close()

    def _forward(self) -> None:
        while not select.select([self._server], [], [], 0.01)[0]:
            if self._ended.is_set():
                return
        near = self._server.accept()[0]
        far = socket.socket()
        far.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
        far.connect(self._target)
        with near, far, suppress(ConnectionError):
            ways = {near: far, far: near}
            while not self._ended.is_set():
                open_ways = [near] if self._stalled.is_set() else list(ways)
                for source in select.select(open_ways, [], [], 0.01)[0]:
                    data = source.recv(SLOW_BYTES if self.slowness_s else BUFFER_BYTES)
                    if not data:
                        return
                    ways[source].sendall(data)
                    if source is far:
                        self._ended.wait(self.slowness_s)
