"""A browser of the desk as light as can be: a WebSocket, and what came over it."""

from contextlib import ExitStack
from typing import Any, Self
from urllib.parse import urlparse

import msgspec
from websockets.sync.client import connect
from websockets.typing import Origin

TIMEOUT_S = 20.0


class DeskClient:
    """A page that decodes what it receives, and shows nothing; ``rows`` are those of the overview, by robot."""

    def __init__(self, address: str) -> None:
        self._place = urlparse(address).netloc
        self.rows: dict[str, dict[str, Any]] = {}
        self.recorders: list[str] = []
        self.full = False
        self.messages = self.size = 0

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            own = Origin(f"http://{self._place}")
            self._socket = stack.enter_context(connect(f"ws://{self._place}/link", origin=own, max_size=None))
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def send(self, **message: object) -> None:
        self._socket.send(msgspec.msgpack.encode(message))

    def receive(self, timeout_s: float = TIMEOUT_S) -> dict[str, Any]:
        data = self._socket.recv(timeout_s, decode=False)
        self.messages += 1
        self.size += len(data)
        message: dict[str, Any] = msgspec.msgpack.decode(data)
        if message["is"] == "rows":
            self.rows |= message["rows"]
            self.rows = {robot: row for robot, row in self.rows.items() if row is not None}
            if message["recorders"] is not None:
                self.recorders = [one["name"] for one in message["recorders"]]
            self.full = message["full"]
        return message
