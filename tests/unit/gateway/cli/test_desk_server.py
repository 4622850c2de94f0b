"""A browser's WebSocket at the desk: who says too much waits, and who cannot be served is cut off."""

import asyncio
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import msgspec

from gateway.cli.desk_hub import SAID_MAX, Hub
from gateway.cli.desk_server import FAILED, _serve
from gateway.desk import words
from schemas.settings import Settings
from tests.support.fakes.desk import FakeCommandPort, FakeDeskListener
from tests.support.messages import SECOND

LONG_S = 30.0


class FakeSocket:
    """A browser that has said all its messages already, and then is silent until it is cut off."""

    def __init__(self, *messages: bytes) -> None:
        self.waiting = list(messages)
        self.closed: asyncio.Future[int] = asyncio.get_running_loop().create_future()

    async def receive(self) -> dict[str, Any]:
        if self.waiting:
            return {"type": "websocket.receive", "bytes": self.waiting.pop(0)}
        await self.closed
        return {"type": "websocket.disconnect"}

    async def send_bytes(self, _data: bytes) -> None:
        await asyncio.sleep(0)

    async def close(self, code: int) -> None:
        if not self.closed.done():
            self.closed.set_result(code)


async def wait_until(condition: Callable[[], bool]) -> None:
    """Let the others run until this is so."""
    while not condition():  # noqa: ASYNC110 - nobody tells
        await asyncio.sleep(0)


def make_hub() -> Hub:
    """A hub to which nothing comes but what browsers say."""
    return Hub(Settings(), FakeDeskListener(), FakeCommandPort())  # type: ignore[arg-type]


def test_a_flood_of_one_browser_is_read_in_portions() -> None:
    """A few messages in each period of the hub: all that others say and are sent comes in between."""

    async def scenario() -> None:
        hub = make_hub()
        look = msgspec.msgpack.encode({"is": "look", "robot": "cruiser-1"})
        socket = FakeSocket(*[look] * (10 * SAID_MAX))
        serving = asyncio.create_task(_serve(socket, hub))  # type: ignore[arg-type]
        for period in range(1, 4):
            left = (10 - period) * SAID_MAX
            await wait_until(lambda left=left: len(socket.waiting) <= left)  # type: ignore[misc]
            for _ in range(100):
                await asyncio.sleep(0)
            assert len(socket.waiting) == left
            hub.step(period * SECOND)
        serving.cancel()
        with suppress(asyncio.CancelledError):
            await serving

    asyncio.run(asyncio.wait_for(scenario(), LONG_S))


def test_a_browser_that_cannot_be_sent_a_message_is_cut_off() -> None:
    """So that its page says so: it would show what was for what is, and for ever."""

    async def scenario() -> None:
        hub = make_hub()
        socket = FakeSocket()
        serving = asyncio.create_task(_serve(socket, hub))  # type: ignore[arg-type]
        await wait_until(lambda: bool(hub._browsers))
        (browser,) = hub._browsers
        browser.tell(words.DeskReply(2**70, last=True))
        assert await socket.closed == FAILED
        await serving
        assert not hub._browsers

    asyncio.run(asyncio.wait_for(scenario(), LONG_S))
