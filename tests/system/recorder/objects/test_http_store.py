"""Logs behind an HTTP server that is slow, refuses, disconnects, or changes its content."""

import asyncio
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import pytest

from recorder.objects import store as stores
from recorder.objects.address import StoreAddress, StoreError
from recorder.objects.store import ObstoreObjects
from recorder.upload.uploader import LogStore

DATA = bytes(range(250)) * 1000

MUCH_BYTES = 200_000_000
"""More than links and buffers hold of an answer that nobody reads."""

Answer = Callable[[BaseHTTPRequestHandler], bool]
"""Answers a request otherwise than a good server would; False if it is to be answered well."""


def well(_: BaseHTTPRequestHandler) -> bool:
    return False


@contextmanager
def served(
    answer: Answer = well, mark: Callable[[], str] = lambda: "one"
) -> Iterator[tuple[ObstoreObjects, list[str]]]:
    asked: list[str] = []
    is_over = threading.Event()

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def log_message(self, *_: object) -> None:
            """Log nothing."""

        def do_HEAD(self) -> None:
            self.head(200, len(DATA))

        def do_GET(self) -> None:
            asked.append(self.headers.get("Range", ""))
            if answer(self):
                return
            start, _, last = asked[-1].removeprefix("bytes=").partition("-")
            part = DATA[int(start) : int(last) + 1]
            self.head(206, len(part), f"bytes {start}-{last}/{len(DATA)}")
            self.wfile.write(part)

        def head(self, status: int, length: int, content_range: str = "") -> None:
            self.send_response(status)
            self.send_header("Content-Length", str(length))
            self.send_header("ETag", f'"{mark()}"')
            self.send_header("Last-Modified", "Mon, 23 Nov 2026 12:00:00 GMT")
            if content_range:
                self.send_header("Content-Range", content_range)
            self.end_headers()

        def wait(self) -> None:
            is_over.wait()
            self.close_connection = True

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads = True
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        place = StoreAddress(f"http://127.0.0.1:{server.server_address[1]}/logs")
        yield ObstoreObjects(place, {"allow_http": True}), asked
    finally:
        is_over.set()
        server.shutdown()
        server.server_close()


@pytest.fixture(autouse=True)
def _impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stores, "REQUEST_S", 1.0)


def silent(handler: Any) -> bool:  # noqa: ANN401 - the server's own class
    handler.wait()
    return True


def stalled(handler: Any) -> bool:  # noqa: ANN401
    handler.head(206, 1000, f"bytes 0-999/{len(DATA)}")
    handler.wfile.write(DATA[:500])
    handler.wait()
    return True


def whole(handler: Any) -> bool:  # noqa: ANN401
    handler.head(200, len(DATA))
    handler.wfile.write(DATA)
    return True


def refuse(status: int, handler: Any) -> bool:  # noqa: ANN401
    handler.head(status, 0)
    return True


@pytest.mark.parametrize(
    ("answer", "line"),
    [
        (silent, "."),
        (stalled, "."),
        (whole, "."),
        (partial(refuse, 403), "refuses it"),
        (partial(refuse, 401), "refuses it"),
        (partial(refuse, 404), "changed or removed"),
        (partial(refuse, 500), "500 Internal Server Error$"),
    ],
)
def test_a_server_that_does_not_answer_well_is_a_line(answer: Answer, line: str) -> None:
    with served(answer) as (objects, _), pytest.raises(StoreError, match=line) as raised:
        objects.read("a.mcap", 1000, 2000, "one")
    assert "\n" not in str(raised.value)


def test_a_connection_that_breaks_off_once_costs_another_request() -> None:
    """In the middle of a range."""
    cuts = [True]

    def cut(handler: BaseHTTPRequestHandler) -> bool:
        if not cuts:
            return False
        cuts.pop()
        handler.head(206, 1000, f"bytes 0-999/{len(DATA)}")  # type: ignore[attr-defined]
        handler.wfile.write(DATA[:500])
        handler.close_connection = True
        return True

    with served(cut) as (objects, asked):
        assert objects.read("a.mcap", 0, 1000, "one") == DATA[:1000]
        assert len(asked) >= 2


def test_an_answer_without_an_end_fills_no_memory() -> None:
    sent: list[int] = []

    def endless(handler: BaseHTTPRequestHandler) -> bool:
        handler.head(206, 1 << 40, f"bytes 0-999/{len(DATA)}")  # type: ignore[attr-defined]
        handler.close_connection = True
        with suppress(OSError):
            while sum(sent) < MUCH_BYTES:
                handler.wfile.write(DATA)
                sent.append(len(DATA))
        return True

    with served(endless) as (objects, _), pytest.raises(StoreError, match="sent more instead of 1000"):
        objects.read("a.mcap", 0, 1000, "one")
    with served(endless) as (objects, _):
        logs = LogStore(objects._place.url, {"allow_http": True})

        async def read_back() -> int:
            return len(b"".join([piece async for piece in logs.read_back("a.mcap", 1000)]))

        assert asyncio.run(read_back()) > 1000
    assert sum(sent) < MUCH_BYTES
