"""A viewer, as small as it can be: the client's side of Foxglove's WebSocket protocol.

Frames and operations are those of https://github.com/foxglove/ws-protocol/blob/main/docs/spec.md, under the name
that foxglove-sdk gives the protocol.
"""

import base64
import json
import ssl
import struct
import time
from collections.abc import Callable
from contextlib import suppress
from types import TracebackType
from typing import Any, NamedTuple, Self, TypeAlias

from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

SUBPROTOCOL = Subprotocol("foxglove.sdk.v1")

MESSAGE_DATA = 1
"""The opcode of a server's frame: subscription, log time, payload."""

CLIENT_MESSAGE_DATA, SERVICE_CALL = 1, 2
"""Opcodes of a client's frames: what it publishes, and what it calls."""

DEADLINE_S = 20.0

Operation: TypeAlias = dict[str, Any]


class Advertised(NamedTuple):
    """A channel, as the server advertises it."""

    topic: str
    encoding: str
    schema_name: str
    schema_encoding: str
    schema: bytes


class ViewerMessage(NamedTuple):
    """A message, as it came."""

    topic: str
    log_ns: int
    data: bytes


class FoxgloveClient:
    """A connection to a server.

    Attributes:
        channels: what it advertises, by the server's ids.
    """

    def __init__(self, url: str, trust: ssl.SSLContext | None = None) -> None:
        self._connecting = connect(url, subprotocols=[SUBPROTOCOL], ssl=trust, max_size=None)
        self._socket: ClientConnection
        self.info: Operation = {}
        self.channels: dict[int, Advertised] = {}
        self.messages: list[ViewerMessage] = []
        self.said: list[Operation] = []
        self._subscribed: dict[int, str] = {}
        self._wanted: Callable[[str], bool] = lambda _topic: False

    def __enter__(self) -> Self:
        self._socket = self._connecting.__enter__()
        self._wait(lambda: bool(self.said))
        self.info = self.said.pop(0)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._connecting.__exit__(kind, error, trace)

    @property
    def topics(self) -> set[str]:
        return {channel.topic for channel in self.channels.values()}

    def subscribe(self, wanted: Callable[[str], bool] = lambda _topic: True) -> None:
        """Subscribe to these topics, and to those that are advertised later."""
        self._wanted = wanted
        self._subscribe(self.channels)

    def send(self, operation: Operation) -> None:
        """Send an operation."""
        self._socket.send(json.dumps(operation))

    def publish(self, channel_id: int, payload: bytes) -> None:
        self._socket.send(struct.pack("<BI", CLIENT_MESSAGE_DATA, channel_id) + payload)

    def call(self, service_id: int, payload: bytes) -> None:
        encoding = b"json"
        self._socket.send(struct.pack("<BIII", SERVICE_CALL, service_id, 1, len(encoding)) + encoding + payload)

    def wait(self, is_there: Callable[["FoxgloveClient"], bool]) -> Self:
        """Receive until this holds."""
        self._wait(lambda: is_there(self))
        return self

    def receive_for(self, span_s: float) -> None:
        """Receive what comes in this time."""
        end_s = time.monotonic() + span_s
        while (left_s := end_s - time.monotonic()) > 0:
            with suppress(TimeoutError):
                self._receive(left_s)

    def _wait(self, is_there: Callable[[], bool]) -> None:
        end_s = time.monotonic() + DEADLINE_S
        while not is_there():
            left_s = end_s - time.monotonic()
            assert left_s > 0, (self.topics, len(self.messages), self.said)
            with suppress(TimeoutError):
                self._receive(left_s)

    def _receive(self, timeout_s: float) -> None:
        frame = self._socket.recv(timeout_s)
        if isinstance(frame, bytes):
            opcode, subscription, log_ns = struct.unpack_from("<BIQ", frame)
            assert opcode == MESSAGE_DATA
            self.messages.append(ViewerMessage(self._subscribed[subscription], log_ns, frame[13:]))
            return
        operation: Operation = json.loads(frame)
        if operation["op"] != "advertise":
            self.said.append(operation)
            return
        added = {one["id"]: _advertised(one) for one in operation["channels"]}
        self.channels |= added
        self._subscribe(added)

    def _subscribe(self, channels: dict[int, Advertised]) -> None:
        new = {channel_id: one.topic for channel_id, one in channels.items() if self._wanted(one.topic)}
        self._subscribed |= new
        if new:
            self.send({"op": "subscribe", "subscriptions": [{"id": one, "channelId": one} for one in new]})


def _advertised(channel: Operation) -> Advertised:
    return Advertised(
        channel["topic"],
        channel["encoding"],
        channel["schemaName"],
        channel["schemaEncoding"],
        base64.b64decode(channel["schema"]),
    )
