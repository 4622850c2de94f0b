"""The desk with many robots and many browsers: nothing breaks, and slow ones get the newest."""

from __future__ import annotations

import socket
import threading
from contextlib import ExitStack, suppress
from urllib.parse import urlparse

import pytest
from websockets.exceptions import ConnectionClosed

from tests.support.desk_client import TIMEOUT_S, DeskClient
from tests.support.processes.desk import chromium
from tests.support.processes.gateway import Running
from tests.support.processes.robots import name_of, robots
from tests.support.processes.usage import rss_bytes
from tests.support.waiting import wait_until

ROBOTS = 200
BROWSERS = 50
MEMORY_MAX_BYTES = 300 << 20  # of the desk's process; it takes 120 MB, half of it Python and Zenoh

pytestmark = pytest.mark.timeout(400)


def a_browser_that_reads_nothing(address: str) -> socket.socket:
    place = urlparse(address).netloc
    host, _, port = place.rpartition(":")
    stuck = socket.create_connection((host, int(port)))
    # With less, what came is dropped for want of memory, and sent again so late that reading it takes minutes.
    stuck.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 65_536)
    lines = [
        "GET /link HTTP/1.1",
        f"Host: {place}",
        f"Origin: http://{place}",
        "Connection: Upgrade",
        "Upgrade: websocket",
        "Sec-WebSocket-Version: 13",
        "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==",
    ]
    stuck.sendall("\r\n".join([*lines, "", ""]).encode())
    return stuck


@pytest.mark.night
def test_two_hundred_robots_and_fifty_browsers_on_one_desk() -> None:
    with ExitStack() as stack:
        endpoint = stack.enter_context(robots(ROBOTS))
        desk = stack.enter_context(Running("desk", "--listen", "127.0.0.1:0", "--connect", endpoint))
        address = desk.wait_says(r"desk: (http://\S+/)")[1]
        stuck = a_browser_that_reads_nothing(address)
        stack.callback(stuck.close)
        pages: list[DeskClient | None] = [None] * BROWSERS
        samples = [0] * BROWSERS
        ended = threading.Event()

        def read(number: int) -> None:
            robot = name_of(number % ROBOTS)
            while not ended.is_set():
                # One that a busy machine held up for seconds was cut off: it connects anew, as the page does.
                with suppress(ConnectionClosed, TimeoutError, OSError), DeskClient(address) as page:
                    pages[number] = page
                    page.send(**{"is": "look", "robot": robot})
                    while not ended.is_set():
                        message = page.receive()
                        samples[number] += message["is"] == "sample" and f"/{robot}/" in message["key"]

        readers = [threading.Thread(target=read, args=(number,)) for number in range(BROWSERS)]
        for reader in readers:
            reader.start()
        try:
            wait_until(lambda: all(page is not None and len(page.rows) == ROBOTS for page in pages))
            wait_until(lambda: min(samples) > 0)
            with chromium() as browser:
                shown = browser.new_page()
                shown.goto(address)
                shown.locator("tr[data-robot]").nth(ROBOTS - 1).wait_for()
                shown.goto(f"{address}#/robot/{name_of(7)}")
                shown.locator(".robot").first.wait_for()
                shown.close()
            # Who read nothing was cut off: what is left of it ends.
            stuck.settimeout(TIMEOUT_S)
            while stuck.recv(65_536):
                pass
            before = list(samples)
            wait_until(lambda: all(now > then for now, then in zip(samples, before, strict=True)))
        finally:
            ended.set()
            for reader in readers:
                reader.join()
        assert rss_bytes(desk.process.pid) < MEMORY_MAX_BYTES
        assert desk.stop() == 0
        assert [line for line in desk.said if "Traceback" in line] == []
