"""A page in a real browser as axe-core judges it: WCAG 2.2, levels A and AA."""

from typing import Final

from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Page

RULES: Final = {
    "runOnly": {"type": "tag", "values": ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"]}
}


def assert_for_everybody(page: Page) -> None:
    """See that the page, as it is now, breaks none of the rules."""
    found = Axe().run(page, options=RULES)
    assert found.response["violations"] == [], found.generate_report()
