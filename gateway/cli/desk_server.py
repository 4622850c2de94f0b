"""The desk's HTTP server: the page, a WebSocket for each browser, and logs; and headers that keep other pages out.

Needs the extra 'desk'.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import uvicorn
from starlette.applications import Starlette
from starlette.datastructures import Headers, MutableHeaders
from starlette.middleware import Middleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.responses import RedirectResponse
from starlette.routing import BaseRoute, Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect

import gateway.desk
from gateway.cli.desk_door import Door
from gateway.cli.desk_hub import Browser, Hub
from gateway.cli.desk_logs import DeskLogs
from gateway.desk.words import encode

log = logging.getLogger(__name__)

PAGE: Final = Path(gateway.desk.__file__).parent / "page"

FOREIGN: Final = 4403
GONE_BY_LAG: Final = 4408
FAILED: Final = 1011
"""Codes with which a WebSocket is closed: its page is another server's; it does not read; it cannot be served."""

HEADERS: Final = {
    # Nothing but this server's own files, and no script in the page itself.
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


HEAD_BYTES: Final = 8192
"""The longest head of a request."""


def make_app(hub: Hub, hosts: Sequence[str], logs: DeskLogs | None = None) -> Starlette:
    """Make the application.

    Args:
        hub: where browsers are let in.
        hosts: names under which the desk is reached.
        logs: those that browsers may read, if any.
    """

    async def link(web: WebSocket) -> None:
        if not _is_own({"ws": "http", "wss": "https"}[web.url.scheme], web.headers):
            await web.close(FOREIGN)
            return
        await web.accept()
        await _serve(web, hub)

    return _make_site([WebSocketRoute("/link", link), *(logs.routes() if logs is not None else [])], hosts)


def make_logs_app(logs: DeskLogs, hosts: Sequence[str]) -> Starlette:
    """Make the application of a desk without robots, which is reached under these names."""
    return _make_site([Route("/", lambda _: RedirectResponse("/logs.html")), *logs.routes()], hosts)


async def _serve(web: WebSocket, hub: Hub) -> None:
    browser = hub.join()
    sending = asyncio.create_task(_send(web, browser))
    try:
        while True:
            message = await web.receive()
            if message["type"] == "websocket.disconnect":
                return
            hub.receive(browser, message.get("bytes") or b"")
    finally:
        hub.leave(browser)
        sending.cancel()
        with contextlib.suppress(asyncio.CancelledError, WebSocketDisconnect, RuntimeError):
            await sending


async def _send(web: WebSocket, browser: Browser) -> None:
    """Send what waits. While the browser does not read, more waits, and is merged or left out."""
    code = GONE_BY_LAG
    try:
        while not browser.outbox.is_full:
            await browser.ready.wait()
            browser.ready.clear()
            for message in browser.outbox.take():
                await web.send_bytes(encode(message))
    except (OverflowError, TypeError, ValueError):
        # A page that is sent nothing more would show what was for what is.
        log.exception("a message to a browser cannot be encoded")
        code = FAILED
    await web.close(code)


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


def _make_site(routes: Sequence[BaseRoute], hosts: Sequence[str]) -> Starlette:
    """Make an application: its routes, and below them the files of the page.

    Args:
        routes: those that come first.
        hosts: names under which it is reached. A request with another Host header is refused: it comes from a page
            whose name was made to point here (DNS rebinding).
    """
    return Starlette(
        routes=[*routes, Mount("/", StaticFiles(directory=PAGE, packages=[("schemas", "page")], html=True))],
        middleware=[
            Middleware(TrustedHostMiddleware, allowed_hosts=list(hosts), www_redirect=False),
            Middleware(SecurityHeaders),
        ],
    )


def _is_own(scheme: str, headers: Headers) -> bool:
    """Return True if the page that asks comes from this very server. Browsers say so truly, and always.

    Args:
        scheme: of the request, http or https.
        headers: of the request.
    """
    return headers.get("origin") == f"{scheme}://{headers.get('host')}"


class _Server(uvicorn.Server):
    """A server that leaves the signals to the command, and the connections to the door."""

    def __init__(self, config: uvicorn.Config, door: Door) -> None:
        super().__init__(config)
        self._door = door

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Take no signals."""
        yield

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Open the door."""
        await super().startup(sockets)
        self._door.open(self._protocol, self.config.ssl)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Close the door, and end what is open."""
        self._door.close()
        await super().shutdown(sockets)

    def _protocol(self, state: dict[str, Any]) -> asyncio.Protocol:
        protocol: Callable[..., asyncio.Protocol] = self.config.http_protocol_class
        return protocol(config=self.config, server_state=self.server_state, app_state=state)


async def serve(
    app: Starlette,
    listening: socket.socket,
    ends: Callable[[], bool],
    certificate: tuple[Path, Path] | None = None,
    socket_bytes: int = 0,
) -> None:
    """Serve on a socket until the end.

    Args:
        app: the application.
        listening: the socket, bound.
        ends: looked at a few times a second.
        certificate: files of the chain and its private key, PEM; without it HTTP is not encrypted.
        socket_bytes: the longest message over a WebSocket; 0 is for a page that opens none.
    """
    chain, key = certificate if certificate is not None else (None, None)
    door = Door(app, listening)
    server = _Server(
        uvicorn.Config(
            door,
            ws="websockets-sansio" if socket_bytes else "none",
            ws_max_size=socket_bytes,
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
            h11_max_incomplete_event_size=HEAD_BYTES,
        ),
        door,
    )

    async def end() -> None:
        while not ends():  # noqa: ASYNC110 - a signal sets it, not this loop
            await asyncio.sleep(0.1)
        server.should_exit = True

    async with asyncio.TaskGroup() as group:
        group.create_task(end())
        await server.serve([])
