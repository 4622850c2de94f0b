"""The desk's HTTP server: the page, and a WebSocket for each browser. Needs the extra 'desk'."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Final

import uvicorn
from starlette.applications import Starlette
from starlette.datastructures import MutableHeaders
from starlette.middleware import Middleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.routing import Mount, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect

import gateway.desk
from gateway.cli.desk_hub import Browser, Hub
from gateway.cli.desk_logs import DeskLogs
from gateway.desk.words import FROM_BROWSER_BYTES, encode

log = logging.getLogger(__name__)

PAGE: Final = Path(gateway.desk.__file__).parent / "page"

HEADERS: Final = {
    # Nothing but this desk's own files, and no script in the page itself.
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-cache",
}

PING_S: Final = 2.0
"""A browser that is not heard for this time after a ping is gone."""

FOREIGN: Final = 4403
GONE_BY_LAG: Final = 4408
FAILED: Final = 1011
"""Codes with which a WebSocket is closed: its page is another server's; it does not read; it cannot be served."""


class SecurityHeaders:
    """Adds the headers to each response that has no others of these names."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request."""

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        await self._app(scope, receive, send_with_headers)


def make_app(hub: Hub, hosts: Sequence[str], logs: DeskLogs | None = None) -> Starlette:
    """Make the application.

    Args:
        hub: where browsers are let in.
        hosts: names under which the desk is reached. A request with another Host header is refused: it comes
            from a page whose name was made to point here (DNS rebinding).
        logs: those that browsers may read, if any.
    """

    async def link(socket: WebSocket) -> None:
        if not _is_own(socket):
            await socket.close(FOREIGN)
            return
        await socket.accept()
        await _serve(socket, hub)

    return Starlette(
        routes=[
            WebSocketRoute("/link", link),
            *(logs.routes() if logs is not None else []),
            Mount("/", StaticFiles(directory=PAGE, html=True)),
        ],
        middleware=[
            Middleware(TrustedHostMiddleware, allowed_hosts=list(hosts), www_redirect=False),
            Middleware(SecurityHeaders),
        ],
    )


def _is_own(socket: WebSocket) -> bool:
    """Does the page that opens this WebSocket come from this very server? Browsers say so truly, and always."""
    scheme = {"ws": "http", "wss": "https"}[socket.url.scheme]
    return socket.headers.get("origin") == f"{scheme}://{socket.headers.get('host')}"


async def _serve(socket: WebSocket, hub: Hub) -> None:
    browser = hub.join()
    sending = asyncio.create_task(_send(socket, browser))
    try:
        while True:
            message = await socket.receive()
            if message["type"] == "websocket.disconnect":
                return
            hub.receive(browser, message.get("bytes") or b"")
            # Who says too much waits, and nobody else.
            await browser.turn.wait()
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


class _Server(uvicorn.Server):
    """A server that leaves the signals to the command."""

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Take no signals."""
        yield


async def serve(
    app: Starlette,
    listening: socket.socket,
    ends: Callable[[], bool],
    certificate: tuple[Path, Path] | None = None,
) -> None:
    """Serve on a socket until the end.

    Args:
        app: the application.
        listening: the socket, bound.
        ends: looked at a few times a second.
        certificate: files of the chain and its private key, PEM; without it HTTP is not encrypted.
    """
    chain, key = certificate if certificate is not None else (None, None)
    server = _Server(
        uvicorn.Config(
            app,
            ws="websockets-sansio",
            ws_max_size=FROM_BROWSER_BYTES,
            ws_ping_interval=PING_S,
            ws_ping_timeout=PING_S,
            ws_per_message_deflate=False,
            lifespan="off",
            access_log=False,
            log_config=None,
            server_header=False,
            date_header=False,
            timeout_graceful_shutdown=1,
            ssl_certfile=chain,
            ssl_keyfile=key,
        )
    )

    async def end() -> None:
        while not ends():  # noqa: ASYNC110 - a signal sets it, not this loop
            await asyncio.sleep(0.1)
        server.should_exit = True

    async with asyncio.TaskGroup() as group:
        group.create_task(end())
        await server.serve([listening])
