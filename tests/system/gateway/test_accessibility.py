"""The desk's page and the reports as axe-core judges them, in a real browser: WCAG 2.2, levels A and AA."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import Final, Literal

import pytest
from playwright.sync_api import Browser, Page

from gateway.client.fleet import WORDS
from tests.support.axe import assert_fits_a_small_phone, assert_for_everybody
from tests.support.desk_states import desk_of_all_states
from tests.support.nights import by_night, every_value
from tests.support.rigs.scenarios import front_bumper, recorded

LOG: Final = "needs-reset-20260102T030405Z.mcap"

REPORT_MS: Final = 100_000
"""A report is made when it is asked for; a busy machine takes its time."""


CUT: Final = """() => [...document.querySelectorAll(".band, .band *, .why, .why *, #link")]
    .filter((one) => !one.matches(".heard"))
    .filter((one) => one.scrollWidth > one.clientWidth + 1 && getComputedStyle(one).overflowX !== "visible"
        || one.getBoundingClientRect().right > innerWidth)
    .map((one) => one.outerHTML)"""


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A desk with robots in all states, and a log of one of them."""
    logs = tmp_path_factory.mktemp("logs")
    (logs / LOG).write_bytes(recorded(front_bumper))
    with desk_of_all_states(logs) as address:
        yield address


def overview(page: Page, address: str) -> None:
    """All robots; a stop of all, of which some did not come to rest."""
    page.goto(address)
    page.locator("tr[data-robot=telemetry]").wait_for()
    page.locator("#stop-all").click()
    page.locator("#stop-of- li").first.wait_for()


def wall(page: Page, address: str) -> None:
    page.goto(f"{address}#/wall")
    page.locator(".tile[data-robot=telemetry]").wait_for()


def robot(page: Page, address: str) -> None:
    """One that is latched, with its reasons and events, the keys unfolded; a stop of it."""
    page.goto(f"{address}#/robot/needs-reset")
    page.locator(".why li").first.wait_for()
    page.locator(".events .error").first.wait_for()
    page.locator("a[href^='#/logs?']").wait_for()
    page.locator("summary").click()
    page.keyboard.press("Escape")
    page.locator("#stop-of-needs-reset li").wait_for()


def kiosk(page: Page, address: str) -> None:
    """One that moves, for itself."""
    page.goto(f"{address}#/kiosk/driving")
    page.locator(".band .word", has_text=re.compile("driving|行驶中")).wait_for()


def report(page: Page, address: str) -> None:
    """A log's report, as the desk serves it."""
    page.goto(f"{address}reports/{LOG}", timeout=REPORT_MS)
    page.locator("html[data-drawn]").wait_for(state="attached")


@pytest.mark.parametrize(
    ("look", "theme", "language"),
    [
        *every_value((overview, wall, robot, kiosk), ("light", "dark"), ("en-GB", "zh-CN")),
        (report, "light", "en-GB"),
        by_night(report, "dark", "en-GB"),
    ],
    ids=lambda value: getattr(value, "__name__", value),
)
def test_every_page_is_for_everybody(
    look: Callable[[Page, str], None],
    theme: Literal["light", "dark"],
    language: str,
    address: str,
    running_browser: Browser,
) -> None:
    """Names for whoever hears the page, contrast for whoever sees badly, the keyboard for whoever has no mouse.

    At 320 pixels nobody scrolls sideways to read a line, or to reach a button (WCAG 1.4.10, reflow).
    """
    context = running_browser.new_context(locale=language, color_scheme=theme)
    try:
        page = context.new_page()
        look(page, address)
        assert_for_everybody(page)
        assert_fits_a_small_phone(page)
    finally:
        context.close()


def test_on_a_phone_stop_stays_under_the_thumb_and_no_warning_is_cut(
    address: str, running_browser: Browser
) -> None:
    """Whatever is said, whichever robot is shown, however far the page is scrolled."""
    with running_browser.new_context(viewport={"width": 360, "height": 640}, has_touch=True) as context:
        page = context.new_page()
        stops = []
        for look in ("#/", "#/wall", *(f"#/robot/{word.replace('_', '-')}" for word in WORDS)):
            page.goto(f"{address}{look}")
            if "robot" in look:
                page.locator(".band .word", has_text=re.compile(r"\w")).wait_for()
                assert page.evaluate(CUT) == []
            page.keyboard.press("Escape")
            page.mouse.wheel(0, 300)
            stops.append(page.locator("#stop-all").bounding_box())
        assert all(box == stops[0] for box in stops)
        assert stops[0] is not None
        assert stops[0]["y"] + stops[0]["height"] <= 640
