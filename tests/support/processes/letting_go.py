"""Every way in which whoever holds the pad of a page lets go of it, or has it taken away."""

import os
import signal
import time
from collections.abc import Callable, Sequence
from typing import Final

from playwright.sync_api import Page


def let_go_of_the_pointer(page: Page) -> None:
    page.mouse.up()


def cancel_the_pointer(page: Page) -> None:
    """The system takes the touch away, for a gesture of its own."""
    page.locator(".pad").evaluate(
        "pad => pad.dispatchEvent(new PointerEvent('pointercancel', {pointerId: 1, bubbles: true}))"
    )


def lose_the_capture(page: Page) -> None:
    page.locator(".pad").evaluate("pad => pad.releasePointerCapture(1)")


def lose_the_focus(page: Page) -> None:
    page.evaluate("dispatchEvent(new Event('blur'))")


def hide_the_page(page: Page) -> None:
    page.evaluate("Object.defineProperty(document, 'hidden', {value: true})")
    page.evaluate("document.dispatchEvent(new Event('visibilitychange'))")


def leave_for_the_overview(page: Page) -> None:
    page.evaluate("location.hash = '#/'")


def close_the_page(page: Page) -> None:
    page.close()


def shut_the_lid(page: Page) -> None:
    """The laptop sleeps for two seconds: none of the page's processes runs, then all go on as they were."""
    browser = page.context.browser
    assert browser is not None
    processes = browser.new_browser_cdp_session().send("SystemInfo.getProcessInfo")["processInfo"]
    renderers = [int(one["id"]) for one in processes if one["type"] == "renderer"]
    for pid in renderers:
        os.kill(pid, signal.SIGSTOP)
    time.sleep(2.0)
    for pid in renderers:
        os.kill(pid, signal.SIGCONT)


def block_the_page(page: Page) -> None:
    """A script of the page hangs for two seconds."""
    page.evaluate("const end = performance.now() + 2000; while (performance.now() < end);")


WAYS: Final[Sequence[Callable[[Page], None]]] = (
    let_go_of_the_pointer,
    cancel_the_pointer,
    lose_the_capture,
    lose_the_focus,
    hide_the_page,
    leave_for_the_overview,
    close_the_page,
    shut_the_lid,
    block_the_page,
)
