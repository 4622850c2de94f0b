"""Every way in which whoever holds the pad of a page lets go of it, or has it taken away."""

import os
import signal
import time
from collections.abc import Callable
from typing import Final

from playwright.sync_api import Page


def shut_the_lid(page: Page) -> None:
    """The laptop sleeps for two seconds: the page's processes stand still, then go on."""
    browser = page.context.browser
    assert browser is not None
    processes = browser.new_browser_cdp_session().send("SystemInfo.getProcessInfo")["processInfo"]
    renderers = [int(one["id"]) for one in processes if one["type"] == "renderer"]
    for pid in renderers:
        os.kill(pid, signal.SIGSTOP)
    time.sleep(2.0)
    for pid in renderers:
        os.kill(pid, signal.SIGCONT)


WAYS: Final[dict[str, Callable[[Page], object]]] = {
    "let go of the pointer": lambda page: page.mouse.up(),
    "a gesture of the system takes the touch away": lambda page: page.locator(".pad").evaluate(
        "pad => pad.dispatchEvent(new PointerEvent('pointercancel', {pointerId: 1, bubbles: true}))"
    ),
    "lose the capture": lambda page: page.locator(".pad").evaluate("pad => pad.releasePointerCapture(1)"),
    "lose the focus": lambda page: page.evaluate("dispatchEvent(new Event('blur'))"),
    "hide the page": lambda page: page.evaluate(
        "Object.defineProperty(document, 'hidden', {value: true});"
        "document.dispatchEvent(new Event('visibilitychange'))"
    ),
    "leave for the overview": lambda page: page.evaluate("location.hash = '#/'"),
    "close the page": lambda page: page.close(),
    "shut the lid": shut_the_lid,
    "a script blocks the page": lambda page: page.evaluate(
        "const end = performance.now() + 2000; while (performance.now() < end);"
    ),
}
