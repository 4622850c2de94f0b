"""A robot, a desk, and real browsers on it; somebody on the bus writes down what the chassis is told."""

import os
import shutil
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import pytest
from playwright.sync_api import Browser, BrowserContext, Page, sync_playwright
from playwright.sync_api import TimeoutError as PlaywrightTimeoutError

from gateway.can.open_bus import open_bus
from gateway.chassis.cruiser.frames import TARGET_SPEED, load
from gateway.chassis.layout import Decoded, FrameDecoder
from schemas.messages import Variant
from schemas.settings import CanSettings
from tests.support.fakes.peer import free_endpoint
from tests.support.processes.gateway import Running, chassis
from tests.support.processes.guard import Burst, Listener
from tests.support.waiting import wait_until

ATTEMPTS = 5

NAMES = ("chromium", "google-chrome")  # of browsers; ``TEST_BROWSER`` names another program
FLAGS = (
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    # Whatever asks for a name gets none, but for this machine's own.
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
)


class DeskScene:
    """A robot on a served bus, and a desk that shows it; ``router`` is the process between them, if any."""

    def __init__(
        self, stack: ExitStack, *words: str, desk_words: Sequence[str] = (), routed: Path | None = None
    ) -> None:
        """Start all; ``words`` are the gateway's. With a directory for its files, a router too."""
        self.endpoint = free_endpoint()
        self.router: Running | None = None
        if routed is not None:
            for mode in ("router", "client"):
                (routed / f"{mode}.json5").write_text(f'{{mode: "{mode}"}}')
            routing = ("--zenoh-config", str(routed / "router.json5"), "--listen", self.endpoint)
            self.router = stack.enter_context(Running("router", *routing))
            self.router.wait_says("^router: ")
        _, self.bus = stack.enter_context(chassis())
        place = ("--listen",) if routed is None else ("--zenoh-config", str(routed / "client.json5"), "--connect")
        bus = ("--interface", "socketcand", "--channel", self.bus)
        self.gateway = stack.enter_context(Running("gateway", *bus, *place, self.endpoint, *words))
        self.gateway.wait_says("^gateway: ")
        self.listener = Listener(open_bus(CanSettings(interface="socketcand", channel=self.bus)))
        stack.callback(self.listener.close)
        where = ("--listen", "127.0.0.1:0", "--connect", self.endpoint)
        self.desk = stack.enter_context(Running("desk", *where, *desk_words))
        self.address = self.desk.wait_says(r"desk: (http://127\.0\.0\.1:\d+/)")[1]
        self._decoder = FrameDecoder(load(Variant.COARSE))
        self._told_mps: list[float] = []

    def told_mps(self) -> list[float]:
        self._told_mps += map(self._speed, self.listener.bursts[len(self._told_mps) : -1])
        return self._told_mps

    @property
    def is_told_to_move(self) -> bool:
        return bool(self.told_mps()) and self.told_mps()[-1] != 0

    def wait_told_zero(self) -> None:
        """Wait until the commanded speed is zero, and see that it stays so for a second."""
        wait_until(lambda: not self.is_told_to_move)
        stood, end_s = len(self.told_mps()), time.monotonic() + 1.0
        wait_until(lambda: time.monotonic() > end_s)
        assert max(map(abs, self.told_mps()[stood:]), default=0.0) == 0

    def _speed(self, burst: Burst) -> float:
        read = [one.signals for one in map(self._decoder.decode, burst.frames) if isinstance(one, Decoded)]
        return next((float(signals[TARGET_SPEED]) for signals in read if TARGET_SPEED in signals), 0.0)


@contextmanager
def desk_scene(*words: str, desk_words: Sequence[str] = (), routed: Path | None = None) -> Iterator[DeskScene]:
    with ExitStack() as stack:
        yield DeskScene(stack, *words, desk_words=desk_words, routed=routed)


def browser() -> str:
    """The browser's path; without one the test is skipped. Ubuntu's snap opens no file of a test."""
    found = [os.environ.get("TEST_BROWSER", ""), *map(shutil.which, NAMES)]
    for program in found:
        if program and "/snap/" not in program:
            return program
    pytest.skip("no Chromium is here (Debian: chromium)")


@contextmanager
def profile(browser: Browser, *harmless: str, **options: object) -> Iterator[BrowserContext]:
    """A user who has chosen a name. Errors in the console fail the test, but for those with such a text."""
    errors: list[str] = []
    context = browser.new_context(**{"locale": "en-GB", **options})  # type: ignore[arg-type]
    context.add_init_script("try { localStorage.setItem('operator_asked', 'yes'); } catch {}")
    context.on("weberror", lambda error: errors.append(str(error.error)))
    context.on("console", lambda message: errors.append(message.text) if message.type == "error" else None)
    yield context
    context.close()
    assert [one for one in errors if not any(text in one for text in harmless)] == []


@contextmanager
def chromium() -> Iterator[Browser]:
    sandbox = ["--no-sandbox"] if os.geteuid() == 0 else []
    with sync_playwright() as playwright:
        running = playwright.chromium.launch(executable_path=browser(), args=[*FLAGS, *sandbox])
        try:
            yield running
        finally:
            running.close()


def open_robot(context: BrowserContext | Browser, scene: DeskScene, address: str = "") -> Page:
    """The robot's page, once it can be driven."""
    page = context.new_page()
    page.goto(f"{address or scene.address}#/robot/cruiser-1")
    become_ready(page)
    return page


def become_ready(page: Page) -> None:
    """Wait until the robot can be driven; reset a stop that a busy machine has caused."""
    band = page.locator(".band")
    wait_until(lambda: is_ready(page) or band.get_by_role("button", name="Reset").is_visible())
    if not is_ready(page):
        print(band.inner_text(), page.locator(".events").first.inner_text())  # noqa: T201 - whoever reads the figures wants it
        reset(page)


def is_ready(page: Page) -> bool:
    return page.locator(".band .word", has_text="ready").is_visible()


def wait_ready(page: Page) -> None:
    page.locator(".band .word", has_text="ready").wait_for()


def take_control(page: Page) -> None:
    """Engage from the page; again where a busy machine let the deadman expire at once."""
    button = page.locator("button:visible:enabled", has_text="Take control")
    for _ in range(ATTEMPTS):
        button.click()
        wait_until(lambda: is_engaged(page) or button.count())
        if is_engaged(page):
            return
    raise AssertionError(f"the robot was not engaged: {page.locator('.drive').inner_text()}")


def reset(page: Page) -> None:
    """Press the band's Reset until the robot is ready."""
    button = page.locator(".band").get_by_role("button", name="Reset")

    def press() -> None:
        # It goes when the robot is cured.
        with suppress(PlaywrightTimeoutError):
            button.click(timeout=1000)

    wait_until(lambda: is_ready(page), press)


def is_engaged(page: Page) -> bool:
    """This page drives, and counts what is pressed from now on."""
    return is_driven(page) and page.get_by_text("You are driving.").is_visible()


def is_driven(page: Page) -> bool:
    return page.locator(".robot.driving").count() > 0


def hold_pad(page: Page, forward: float = 0.8) -> None:
    box = page.locator(".pad").bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] * (1 - forward) / 2)
    page.mouse.down()


def drive(scene: DeskScene, page: Page, key: str = "", forward: float = 0.8) -> None:
    """Hold the pad, or a key, until the robot moves; again where a busy machine stalls the browser."""
    for _ in range(ATTEMPTS):
        if not is_driven(page):
            take_control(page)
        if key:
            page.keyboard.down(key)
        else:
            hold_pad(page, forward)
        with suppress(TimeoutError):
            wait_until(lambda: scene.is_told_to_move or not is_driven(page), deadline_s=6.0)
        if scene.is_told_to_move:
            return
        if key:
            page.keyboard.up(key)
        else:
            page.mouse.up()
        wait_until(lambda: "0.00 m/s" in page.locator(".now").inner_text())
    raise AssertionError("the robot never moved")


def texts(page: Page, selector: str) -> Sequence[str]:
    return page.locator(selector).all_text_contents()
