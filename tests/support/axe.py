"""A page in a real browser: as axe-core judges it by WCAG 2.2, levels A and AA, and on a small phone."""

from typing import Final

from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Page

from tests.support.waiting import wait_until

RULES: Final = {
    "runOnly": {"type": "tag", "values": ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"]}
}


def assert_for_everybody(page: Page) -> None:
    """The page as it is now breaks no rule."""
    found = Axe().run(page, options=RULES)
    assert found.response["violations"] == [], found.generate_report()


def assert_fits_a_small_phone(page: Page) -> None:
    """At 320 pixels the page reflows, with no button outside (WCAG 1.4.10)."""
    page.set_viewport_size({"width": 320, "height": 640})
    # The page may still be laid out for the width of before.
    wait_until(lambda: page.evaluate("document.documentElement.scrollWidth") <= 320)
    outside = "[...document.querySelectorAll('button')].filter(one => one.getBoundingClientRect().right > 320)"
    assert page.evaluate(f"{outside}.map(one => one.innerText)") == []
