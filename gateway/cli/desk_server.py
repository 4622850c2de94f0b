"""The desk's HTTP server: the page, a WebSocket for each browser, and logs. Needs the extra 'desk'."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from starlette.applications import Starlette
from starlette.responses import RedirectResponse
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

import gateway.desk
from gateway.cli.desk_hub import Browser, Hub
from gateway.cli.desk_logs import DeskLogs
from gateway.desk.words import encode
from schemas.web.server import is_own, make_site

log = logging.getLogger(__name__)

PAGE: Final = Path(gateway.desk.__file__).parent / "page"

FOREIGN: Final = 4403
GONE_BY_LAG: Final = 4408
FAILED: Final = 1011
"""Codes with which a WebSocket is closed: its page is another server's; it does not read; it cannot be served."""


def make_app(hub: Hub, hosts: Sequence[str], logs: DeskLogs | None = None) -> Starlette:
    """Make the application.

    Args:
        hub: where browsers are let in.
        hosts: names under which the desk is reached.
        logs: those that browsers may read, if any.
    """

    async def link(socket: WebSocket) -> None:
        if not is_own({"ws": "http", "wss": "https"}[socket.url.scheme], socket.headers):
            await socket.close(FOREIGN)
            return
        await socket.accept()
        await _serve(socket, hub)

    return make_site([WebSocketRoute("/link", link), *(logs.routes() if logs is not None else [])], hosts, PAGE)


def make_logs_app(logs: DeskLogs, hosts: Sequence[str]) -> Starlette:
    """Make the application of a desk without robots, which is reached under these names."""
    return make_site([Route("/", lambda _: RedirectResponse("/logs.html")), *logs.routes()], hosts, PAGE)


async def _serve(socket: WebSocket, hub: Hub) -> None:
    browser = hub.join()
    sending = asyncio.create_task(_send(socket, browser))
    try:
        while True:
            message = await socket.receive()
            if message["type"] == "websocket.disconnect":
                return
            hub.receive(browser, message.get("bytes") or b"")
    finally:
        hub.leave(browser)
        sending.cancel()
        with contextlib.suppress(asyncio.CancelledError, WebSocketDisconnect, RuntimeError):
            await sending


async def _send(socket: WebSocket, browser: Browser) -> None:
    """Send what waits. While the browser does not read, more waits, and is merged or left out."""
    code = GONE_BY_LAG
    try:
        while not browser.outbox.is_full:
            await browser.ready.wait()
            browser.ready.clear()
            for message in browser.outbox.take():
                await socket.send_bytes(encode(message))
    except (OverflowError, TypeError, ValueError):
        # A page that is sent nothing more would show what was for what is.
        log.exception("a message to a browser cannot be encoded")
        code = FAILED
    await socket.close(code)
