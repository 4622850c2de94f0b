"""A minimal viewer: the client's side of Foxglove's WebSocket protocol.

Frames and operations: https://github.com/foxglove/ws-protocol/blob/main/docs/spec.md, under foxglove-sdk's name
for it.
"""

import base64
import json
import ssl
import struct
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from typing import Any, NamedTuple, Self

from websockets.sync.client import connect
from websockets.typing import Subprotocol

SUBPROTOCOL = Subprotocol("foxglove.sdk.v1")
CLIENT_MESSAGE_DATA, SERVICE_CALL = 1, 2  # opcodes of a client's frames: a published message, a call
DEADLINE_S = 20.0


class Advertised(NamedTuple):
    topic: str
    encoding: str
    schema_name: str
    schema_encoding: str
    schema: bytes


class ViewerMessage(NamedTuple):
    topic: str
    log_ns: int
    data: bytes


class FoxgloveClient:
    """A connection to a server; ``channels`` has the advertised ones by the server's ids."""

    def __init__(self, url: str, trust: ssl.SSLContext | None = None) -> None:
        self._stack = ExitStack()
        self._socket = connect(url, subprotocols=[SUBPROTOCOL], ssl=trust, max_size=None)
        self.info: dict[str, Any] = {}
        self.channels: dict[int, Advertised] = {}
        self.messages: list[ViewerMessage] = []
        self.said: list[dict[str, Any]] = []
        self._subscribed: dict[int, str] = {}
        self._wanted: Callable[[str], bool] = lambda _topic: False

    def __enter__(self) -> Self:
        self._stack.enter_context(self._socket)
        self.info = self.wait(lambda client: bool(client.said)).said.pop(0)
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    @property
    def topics(self) -> set[str]:
        return {channel.topic for channel in self.channels.values()}

    def subscribe(self, wanted: Callable[[str], bool] = lambda _topic: True) -> None:
        self._wanted = wanted
        self._subscribe(self.channels)

    def send(self, operation: dict[str, Any]) -> None:
        self._socket.send(json.dumps(operation))

    def publish(self, channel_id: int, payload: bytes) -> None:
        self._socket.send(struct.pack("<BI", CLIENT_MESSAGE_DATA, channel_id) + payload)

    def call(self, service_id: int, payload: bytes) -> None:
        self._socket.send(struct.pack("<BIII4s", SERVICE_CALL, service_id, 1, 4, b"json") + payload)

    def wait(self, is_there: Callable[["FoxgloveClient"], bool]) -> Self:
        end_s = time.monotonic() + DEADLINE_S
        while not is_there(self):
            left_s = end_s - time.monotonic()
            assert left_s > 0, (self.topics, len(self.messages), self.said)
            with suppress(TimeoutError):
                self._receive(left_s)
        return self

    def receive_for(self, span_s: float) -> None:
        end_s = time.monotonic() + span_s
        while (left_s := end_s - time.monotonic()) > 0:
            with suppress(TimeoutError):
                self._receive(left_s)

    def _receive(self, timeout_s: float) -> None:
        frame = self._socket.recv(timeout_s)
        if isinstance(frame, bytes):
            # The one kind that a server sends: a message of a subscription.
            _, subscription, log_ns = struct.unpack_from("<BIQ", frame)
            self.messages.append(ViewerMessage(self._subscribed[subscription], log_ns, frame[13:]))
            return
        operation: dict[str, Any] = json.loads(frame)
        if operation["op"] != "advertise":
            self.said.append(operation)
            return
        added = {
            one["id"]: Advertised(
                one["topic"],
                one["encoding"],
                one["schemaName"],
                one["schemaEncoding"],
                base64.b64decode(one["schema"]),
            )
            for one in operation["channels"]
        }
        self.channels |= added
        self._subscribe(added)

    def _subscribe(self, channels: dict[int, Advertised]) -> None:
        new = {channel_id: one.topic for channel_id, one in channels.items() if self._wanted(one.topic)}
        self._subscribed |= new
        if new:
            self.send({"op": "subscribe", "subscriptions": [{"id": one, "channelId": one} for one in new]})
