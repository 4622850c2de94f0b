"""A TCP relay on the loopback that delays what it carries: a link as bad radio makes it."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Callable
from queue import SimpleQueue
from typing import Final, Self

BUFFER_BYTES: Final = 65_536


class Relay:
    """Carries every connection to a place, both ways.

    Attributes:
        endpoint: the address to connect to instead, as HOST:PORT.
    """

    def __init__(self, host: str, port: int, delay_s: Callable[[], float]) -> None:
        """Carry connections to a place.

        Args:
            delay_s: draws how long the next piece takes, either way; pieces keep their order.
        """
        self._delay_s = delay_s
        self._target = (host, port)
        self._server = socket.create_server(("127.0.0.1", 0))
        self.endpoint = f"127.0.0.1:{self._server.getsockname()[1]}"
        self._sockets: list[socket.socket] = [self._server]
        threading.Thread(target=self._accept, name="relay", daemon=True).start()

    def close(self) -> None:
        for one in self._sockets:
            with contextlib.suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)
            one.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_raised: object) -> None:
        self.close()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):  # That is how it is closed.
            while True:
                near = self._server.accept()[0]
                far = socket.create_connection(self._target)
                self._sockets += [near, far]
                for source, sink in ((near, far), (far, near)):
                    sink.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                    threading.Thread(target=self._carry, args=(source, sink), name="relay", daemon=True).start()

    def _carry(self, source: socket.socket, sink: socket.socket) -> None:
        under_way: SimpleQueue[tuple[float, bytes]] = SimpleQueue()
        threading.Thread(target=self._deliver, args=(under_way, source, sink), name="relay", daemon=True).start()
        due_s = 0.0
        with contextlib.suppress(OSError):
            while data := source.recv(BUFFER_BYTES):
                due_s = max(due_s, time.monotonic() + self._delay_s())
                under_way.put((due_s, data))
        under_way.put((due_s, b""))

    def _deliver(
        self, under_way: SimpleQueue[tuple[float, bytes]], source: socket.socket, sink: socket.socket
    ) -> None:
        with contextlib.suppress(OSError):
            while True:
                due_s, data = under_way.get()
                if not data:
                    break
                time.sleep(max(0.0, due_s - time.monotonic()))
                sink.sendall(data)
        for one in (source, sink):
            with contextlib.suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)
