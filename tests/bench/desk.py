"""The desk: from a pointer in a real browser to the frame on the bus; the cost of many robots and browsers."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from itertools import pairwise
from random import Random
from typing import Final

from playwright.sync_api import Browser, Page

from tests.bench.command_latency import DRIVE_ID, Road, Witness, on_the_road
from tests.bench.loads import Row
from tests.bench.processes import quantile
from tests.support.desk_client import DeskClient
from tests.support.processes.desk import become_ready, chromium, hold_pad, is_driven, take_control, wait_ready
from tests.support.processes.gateway import Running
from tests.support.processes.robots import name_of, robots
from tests.support.processes.usage import cpu_s, rss_bytes

ROBOTS: Final = 200
BROWSERS: Final = 10
HELD_S: Final = 0.4
TOLD_MAX_S: Final = 5.0

# Notes the browser's pointer events, in ms since 1970.
CLOCK: Final = """
window.pressed = [];
for (const kind of ["pointerdown", "pointerup"])
  addEventListener(kind, (event) => window.pressed.push([kind, performance.timeOrigin + event.timeStamp]), true);
"""
FRAMES: Final = """(seconds) => new Promise((resolve) => {
  const times = [];
  const step = (now) => {
    times.push(now);
    now - times[0] < 1000 * seconds ? requestAnimationFrame(step) : resolve(times);
  };
  requestAnimationFrame(step);
})"""


def latency(presses: int, kills: int) -> tuple[list[float], list[float], list[float]]:
    """Press and release again and again, then kill the browser that drives; ms to the first frame for each."""
    random = Random(1)  # noqa: S311 - places between two ticks
    down_ms: list[float] = []
    up_ms: list[float] = []
    with ExitStack() as stack:
        road = stack.enter_context(on_the_road())
        desk = stack.enter_context(Running("desk", "--listen", "127.0.0.1:0", "--connect", road.endpoint))
        address = desk.wait_says(r"desk: (http://\S+/)")[1]
        browser = stack.enter_context(chromium())
        page = _page(browser, address)
        # The first frame that moves follows the parking brake's release.
        with suppress(TimeoutError):
            _press(page, road.witness, random)
        while len(down_ms) < presses:
            # On a busy machine the robot may have stopped by its deadman: that is not what is measured.
            with suppress(TimeoutError):
                pressed = _press(page, road.witness, random)
                down_ms.append(pressed[0])
                up_ms.append(pressed[1])
        page.close()
        dead_ms = [_kill(browser, _page(browser, address), road) for _ in range(kills)]
    return sorted(down_ms), sorted(up_ms), sorted(dead_ms)


def crowd(seconds: float) -> tuple[float, float, int, list[float]]:
    """Share of a core, MB, bytes of the page, and ms between two frames, with many robots and browsers."""
    with ExitStack() as stack:
        endpoint = stack.enter_context(robots(ROBOTS))
        desk = stack.enter_context(Running("desk", "--listen", "127.0.0.1:0", "--connect", endpoint))
        address = desk.wait_says(r"desk: (http://\S+/)")[1]
        ended = threading.Event()
        readers = [threading.Thread(target=_read, args=(address, name_of(one), ended)) for one in range(BROWSERS)]
        for reader in readers:
            reader.start()
        try:
            time.sleep(2.0)
            begin_s, used_s = time.monotonic(), cpu_s(desk.process.pid)
            time.sleep(seconds)
            cpu = (cpu_s(desk.process.pid) - used_s) / (time.monotonic() - begin_s)
        finally:
            ended.set()
            for reader in readers:
                reader.join()
        memory_mb = rss_bytes(desk.process.pid) / 1e6
        page = stack.enter_context(chromium()).new_page()
        network, sizes = page.context.new_cdp_session(page), []
        network.send("Network.enable")
        network.on("Network.loadingFinished", lambda event: sizes.append(int(event["encodedDataLength"])))
        page.goto(address)
        page.locator("tr[data-robot]").nth(ROBOTS - 1).wait_for()
        times = page.evaluate(FRAMES, seconds)
    return cpu, memory_mb, sum(sizes), sorted(now - then for then, now in pairwise(times))


def rows(presses: int, kills: int, seconds: float) -> list[Row]:
    down_ms, up_ms, dead_ms = latency(presses, kills)
    cpu, memory_mb, page_bytes, frame_ms = crowd(seconds)
    return [
        (f"desk: pointer down to first frame that moves, p50 p99, of {presses}", _ms(down_ms), "p99 60 ms"),
        ("  pointer up to first slower frame, p50 p99", _ms(up_ms), "60 ms"),
        (f"  browser killed to first slower frame, p50 p99, of {kills}", _ms(dead_ms), "300 ms and a tick"),
        (
            f"  CPU of the desk, {ROBOTS} robots that move, {BROWSERS} browsers",
            f"{100 * cpu:.1f} % of a core, {memory_mb:.0f} MB",
            "under 50 %",
        ),
        (f"  frames of the page with {ROBOTS} robots, p50 p99", _ms(frame_ms), ""),
        ("  the page over the wire", f"{page_bytes / 1000:.0f} kB", "under 300 kB"),
    ]


def _page(browser: Browser, address: str) -> Page:
    page = browser.new_page(locale="en-GB")
    page.add_init_script(CLOCK)
    page.goto(f"{address}#/robot/cruiser-1")
    become_ready(page)
    take_control(page)
    return page


def _press(page: Page, witness: Witness, random: Random) -> tuple[float, float]:
    """Press for a moment. Returns ms from press and from release to their first frame."""
    if not is_driven(page):
        wait_ready(page)
        take_control(page)
    _until_frame(witness, time.monotonic(), lambda raw: raw == 0)
    time.sleep(0.1 + 0.05 * random.random())
    page.evaluate("window.pressed.length = 0")
    since = time.time() - time.monotonic()
    hold_pad(page)
    down_s = page.evaluate("window.pressed.at(-1)[1]") / 1000 - since
    moves_s, _ = _until_frame(witness, down_s, lambda raw: raw != 0)
    time.sleep(HELD_S + 0.05 * random.random())
    before = witness.seen[-20:]
    fastest = max(raw for _, can_id, raw in before if can_id == DRIVE_ID)
    page.mouse.up()
    up_s = page.evaluate("window.pressed.at(-1)[1]") / 1000 - since
    slower_s, _ = _until_frame(witness, up_s, lambda raw: raw < fastest)
    return 1000 * (moves_s - down_s), 1000 * (slower_s - up_s)


def _kill(browser: Browser, page: Page, road: Road) -> float:
    """Kill the browser while it drives. Returns ms until the robot slows down."""
    hold_pad(page)
    _until_frame(road.witness, time.monotonic(), lambda raw: raw != 0)
    time.sleep(1.0)
    fastest = max(raw for _, can_id, raw in road.witness.seen[-20:] if can_id == DRIVE_ID)
    processes = browser.new_browser_cdp_session().send("SystemInfo.getProcessInfo")["processInfo"]
    killed_s = time.monotonic()
    for process in processes:
        if process["type"] == "renderer":
            os.kill(int(process["id"]), signal.SIGKILL)
    slower_s, _ = _until_frame(road.witness, killed_s, lambda raw: raw < fastest)
    with suppress(Exception):
        page.close()
    return 1000 * (slower_s - killed_s)


def _until_frame(witness: Witness, since_s: float, holds: Callable[[int], bool]) -> tuple[float, int]:
    """Time and value of the first drive frame since then for which it holds."""
    end_s = time.monotonic() + TOLD_MAX_S
    place = max(0, len(witness.seen) - 400)
    while time.monotonic() < end_s:
        for at_s, can_id, raw in witness.seen[place:]:
            place += 1
            if at_s >= since_s and can_id == DRIVE_ID and holds(raw):
                return at_s, raw
        time.sleep(0.001)
    raise TimeoutError("no such frame")


def _read(address: str, robot: str, ended: threading.Event) -> None:
    with DeskClient(address) as client:
        client.send(**{"is": "look", "robot": robot})
        while not ended.is_set():
            with suppress(TimeoutError):
                client.receive(0.5)


def _ms(values: list[float]) -> str:
    return f"{quantile(values, 0.5):.1f} {quantile(values, 0.99):.1f} ms"
