"""The desk: from a pointer in a real browser to the frame on the bus, and what many robots and browsers cost.

Chromium's clock and the witness's on the bus are the same machine's.

Usage: python -m tests.bench.desk [--robots N --browsers N], these for the crowd alone
"""

from __future__ import annotations

import argparse
import os
import signal
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from itertools import pairwise
from random import Random
from typing import Final

import msgspec
from playwright.sync_api import Browser, Page

from tests.bench.command_latency import DRIVE_ID, Road, Witness, on_the_road
from tests.bench.loads import Row, print_table
from tests.bench.processes import quantile
from tests.support.desk_client import DeskClient
from tests.support.processes.desk import chromium, hold_pad, is_driven, take_control, wait_ready
from tests.support.processes.gateway import Running
from tests.support.processes.robots import name_of, robots
from tests.support.processes.usage import cpu_s, rss_bytes

PRESSES: Final = 50
KILLS: Final = 5
CROWD_S: Final = 20.0
ROBOTS: Final = 200
BROWSERS: Final = 10
HELD_S: Final = 0.4
TOLD_MAX_S: Final = 5.0

CLOCK: Final = """
window.pressed = [];
for (const kind of ["pointerdown", "pointerup"])
  addEventListener(kind, (event) => window.pressed.push([kind, performance.timeOrigin + event.timeStamp]), true);
"""
"""Notes when the browser got the pointer, in ms since 1970."""

FRAMES: Final = """(seconds) => new Promise((resolve) => {
  const times = [];
  const step = (now) => {
    times.push(now);
    now - times[0] < 1000 * seconds ? requestAnimationFrame(step) : resolve(times);
  };
  requestAnimationFrame(step);
})"""


class DeskLatency(msgspec.Struct, frozen=True):
    """All in milliseconds and sorted.

    Attributes:
        down_ms: from the pointer's press to the first frame with a speed, of a robot that was driven a moment ago.
        up_ms: from its release to the first frame with a lower speed.
        dead_ms: from the death of the browser's process to the same.
    """

    down_ms: list[float]
    up_ms: list[float]
    dead_ms: list[float]


class Crowd(msgspec.Struct, frozen=True):
    """What many robots and browsers cost.

    Attributes:
        cpu: the desk's process, share of a core, with the browsers and all robots moving.
        memory_mb: resident.
        page_bytes: over the wire, for the first look at the page.
        frame_ms: between two frames of the overview in Chromium, sorted.
    """

    cpu: float
    memory_mb: float
    page_bytes: int
    frame_ms: list[float]


def latency(presses: int = PRESSES, kills: int = KILLS) -> DeskLatency:
    """Press and let go again and again, then kill the browser that drives."""
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
    return DeskLatency(sorted(down_ms), sorted(up_ms), sorted(dead_ms))


def crowd(seconds: float = CROWD_S, count: int = ROBOTS, browsers: int = BROWSERS) -> Crowd:
    """Many robots, and light browsers that each look at one of them."""
    with ExitStack() as stack:
        endpoint = stack.enter_context(robots(count))
        desk = stack.enter_context(Running("desk", "--listen", "127.0.0.1:0", "--connect", endpoint))
        address = desk.wait_says(r"desk: (http://\S+/)")[1]
        ended = threading.Event()
        readers = [threading.Thread(target=_read, args=(address, name_of(one), ended)) for one in range(browsers)]
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
        page.locator("tr[data-robot]").nth(count - 1).wait_for()
        times = page.evaluate(FRAMES, seconds)
    frame_ms = sorted(now - then for then, now in pairwise(times))
    return Crowd(cpu, memory_mb, sum(sizes), frame_ms)


def rows(presses: int = PRESSES, kills: int = KILLS, seconds: float = CROWD_S) -> list[Row]:
    """All of it."""
    timed = latency(presses, kills)
    return [
        (f"desk: pointer down to first frame that moves, p50 p99, of {presses}", _ms(timed.down_ms), "p99 60 ms"),
        ("  pointer up to first slower frame, p50 p99", _ms(timed.up_ms), "60 ms"),
        (f"  browser killed to first slower frame, p50 p99, of {kills}", _ms(timed.dead_ms), "300 ms and a tick"),
        *crowd_rows(seconds),
    ]


def crowd_rows(seconds: float = CROWD_S, count: int = ROBOTS, browsers: int = BROWSERS) -> list[Row]:
    """What the crowd costs."""
    crowded = crowd(seconds, count, browsers)
    return [
        (
            f"  CPU of the desk, {count} robots that move, {browsers} browsers",
            f"{100 * crowded.cpu:.1f} % of a core, {crowded.memory_mb:.0f} MB",
            "under 50 %",
        ),
        (f"  frames of the page with {count} robots, p50 p99", _ms(crowded.frame_ms), ""),
        ("  the page over the wire", f"{crowded.page_bytes / 1000:.0f} kB", "under 300 kB"),
    ]


def _page(browser: Browser, address: str) -> Page:
    page = browser.new_page(locale="en-GB")
    page.add_init_script(CLOCK)
    page.goto(f"{address}#/robot/cruiser-1")
    wait_ready(page)
    take_control(page)
    return page


def _press(page: Page, witness: Witness, random: Random) -> tuple[float, float]:
    """Press for a moment. Returns the times from press and release to their first frame, in ms."""
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
    """Kill the browser's process while it drives. Returns the time until the robot slows down, in ms."""
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
    """The time and value of the first drive frame since then for which it holds."""
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


def main() -> None:
    """Measure, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", type=int, help="the crowd alone, of so many")
    parser.add_argument("--browsers", type=int, default=BROWSERS)
    arguments = parser.parse_args()
    print_table(rows() if arguments.robots is None else crowd_rows(CROWD_S, arguments.robots, arguments.browsers))


if __name__ == "__main__":
    main()
