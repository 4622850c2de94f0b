"""A browser's WebSocket at the desk: who cannot be served is cut off."""

import asyncio
from collections.abc import Callable
from typing import Any

from gateway.cli.desk_server import FAILED, Hub, _serve
from gateway.desk import words
from schemas.settings import Settings
from tests.support.fakes.desk import FakeCommandPort, FakeDeskListener

LONG_S = 30.0


class FakeSocket:
    """A browser that is silent until it is cut off."""

    def __init__(self) -> None:
        self.closed: asyncio.Future[int] = asyncio.get_running_loop().create_future()

    async def receive(self) -> dict[str, Any]:
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
