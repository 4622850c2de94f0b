"""Requests to an application of this process, without a socket."""

import asyncio
from collections.abc import Mapping
from urllib.parse import unquote

import msgspec
from starlette.types import ASGIApp, Message

HOST = "127.0.0.1:8081"


class Answer(msgspec.Struct, frozen=True):
    """What came back; the names of headers are in small letters."""

    status: int
    headers: dict[str, str]
    body: bytes

    @property
    def text(self) -> str:
        return self.body.decode()


def ask(
    app: ASGIApp, path: str, headers: Mapping[str, str] | None = None, method: str = "GET", body: bytes = b""
) -> Answer:
    """Ask for a path, with its query, as a browser writes them."""
    return asyncio.run(asked(app, path, headers, method, body))


async def asked(
    app: ASGIApp, path: str, headers: Mapping[str, str] | None = None, method: str = "GET", body: bytes = b""
) -> Answer:
    """The same, of a loop that runs."""
    said: list[Message] = []
    sent: list[Message] = [{"type": "http.request", "body": body, "more_body": False}]

    async def receive() -> Message:
        if sent:
            return sent.pop()
        # The browser does not go away before it has its answer.
        never: asyncio.Future[Message] = asyncio.get_running_loop().create_future()
        return await never

    async def send(message: Message) -> None:
        said.append(message)

    place, _, query = path.partition("?")
    given = {"host": HOST, **(headers or {})}
    scope = {
        "type": "http",
        "http_version": "1.1",
        "method": method,
        "scheme": "http",
        "server": HOST.split(":"),
        "path": unquote(place),
        "raw_path": place.encode(),
        "query_string": query.encode(),
        "headers": [(name.lower().encode(), value.encode()) for name, value in given.items()],
    }
    await app(scope, receive, send)
    kept = {name.decode(): value.decode() for name, value in said[0]["headers"]}
    return Answer(said[0]["status"], kept, b"".join(one.get("body", b"") for one in said[1:]))
