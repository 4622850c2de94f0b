"""Reports in a real browser: moments in the address, drives that are played, reasons of stops, an overview."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page

from schemas.command_line import ExitCode
from tests.support.commands import review
from tests.support.drives import drive_messages, drives_over, write_messages
from tests.support.logs import saved
from tests.support.messages import SECOND, WALL_NS
from tests.support.nights import by_night
from tests.support.rigs import scenarios
from tests.support.rigs.scenarios import recorded
from tests.support.waiting import wait_until

pytestmark = pytest.mark.long

DEADLINE_MS = 120_000
PHONE = {"width": 390, "height": 844}


@pytest.fixture
def page(running_browser: Browser) -> Iterator[Page]:
    """A page without a network. One that complains in the console fails the test."""
    context = running_browser.new_context(offline=True)
    context.set_default_timeout(DEADLINE_MS)
    found = context.new_page()
    said: list[str] = []
    found.on("console", lambda message: said.append(message.text))
    found.on("pageerror", lambda error: said.append(str(error)))
    yield found
    context.close()
    assert said == []


def report_of(log: Path) -> Path:
    page = log.with_name("report.html")
    assert review("report", log, "-o", page) == ExitCode.OK
    return page


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The report of a drive of 10 s that goes round a bend, of two robots."""
    log = tmp_path_factory.mktemp("drive") / "a.mcap"
    return report_of(write_messages(log, drive_messages(201), robots=["r-1", "r-2"]))


def opened(page: Page, file: Path, address: str = "") -> None:
    """Open a report there, and wait until it is drawn."""
    page.goto(file.as_uri() + address)
    page.locator("html[data-drawn]").wait_for(state="attached")


def moment(page: Page, number: int = 0) -> str:
    """The time that a player shows."""
    return page.locator(f"#player-{number} a").inner_text()


def pose(page: Page, number: int = 0) -> list[float]:
    """Where the robot's outline is: x and y in metres, and heading in radians."""
    said = page.locator(f"#drive-{number} .robot").get_attribute("data-pose") or ""
    return [float(word) for word in said.split()]


def shown(page: Page, number: int = 0) -> list[str]:
    """The first and the last time of the charts."""
    return (page.locator(f"#time-{number}").get_attribute("data-range") or "").split()


@pytest.mark.parametrize(
    ("address", "number"),
    [
        ("#t=2027-01-15T08:00:04.500Z&robot=r-2", 1),
        by_night("#robot=r-1&t=2027-01-15T08:00:04.500Z", 0),
        by_night("#t=2027-01-15T08:00:04.500Z", 0),
        by_night("#t=2027-01-15T16:00:04.500%2B08:00", 0),
        by_night("#t=2027-01-15 08:00:04.500 UTC", 0),
        by_night(f"#t={WALL_NS // SECOND + 4}.5", 0),
    ],
)
def test_an_address_with_a_time_opens_there(page: Page, drive: Path, address: str, number: int) -> None:
    """In ISO 8601, as UTC where it names no zone, or since 1970: player, outline and line are there.

    Where there are several robots, the address names one, and the others stay at their beginning.
    """
    opened(page, drive, address)
    assert moment(page, number) == "08:00:04.500"
    x_m, y_m, heading_rad = pose(page, number)
    assert x_m > 0
    assert y_m > 0
    assert heading_rad > 0
    assert (page.locator(f"#drive-{number} .now").get_attribute("d") or "").startswith("M")
    assert page.locator("#note").is_hidden()
    wait_until(lambda: page.evaluate("scrollY") > 0)
    if "robot" in address:
        assert moment(page, 1 - number) == "08:00:00.000"


@pytest.mark.parametrize(
    ("address", "said"),
    [
        by_night("#t=yesterday", "The address has no valid time: yesterday"),
        by_night("#t=%E0%A4%A", "The address has no valid time: %E0%A4%A"),
        by_night("#t=2027-01-15T08:00:04Z&robot=r-9", "This report has no drive of r-9."),
        by_night(
            "#t=2027-01-16T00:00:00Z",
            "This report does not cover 2027-01-16T00:00:00.000Z. The nearest moment is shown.",
        ),
        ("#t=<img src=x onerror=alert(1)>", "The address has no valid time: <img src=x onerror=alert(1)>"),
    ],
)
def test_an_address_that_leads_nowhere_is_said_so(page: Page, drive: Path, address: str, said: str) -> None:
    """In a line, and nothing of the address is markup."""
    opened(page, drive, address)
    assert page.locator("#note").text_content() == said


def test_an_events_link_leads_to_its_moment_and_back(page: Page, drive: Path) -> None:
    """The address has it, and its row is marked; the way back is the browser's."""
    opened(page, drive)
    row = page.locator("#drive-1 tr[data-ms]", has_text="front_bumper").first
    clock = row.locator("a").inner_text()
    row.locator("a").click()
    page.locator("#player-1 a", has_text=clock).wait_for()
    assert page.evaluate("location.hash") == f"#t=2027-01-15T{clock}Z&robot=r-2"
    assert row.get_attribute("aria-current") == "time"
    page.go_back()
    wait_until(lambda: page.evaluate("location.hash") == "")


def test_the_keys_move_the_moment_and_write_the_address(page: Page, drive: Path) -> None:
    """A second, ten with shift, to the ends; as text for who hears it."""
    opened(page, drive)
    page.locator("#player-0 input").focus()
    for key, clock in (
        ("ArrowRight", "08:00:01.000"),
        ("ArrowUp", "08:00:02.000"),
        ("ArrowLeft", "08:00:01.000"),
        ("Shift+ArrowRight", "08:00:10.000"),
        ("Home", "08:00:00.000"),
        ("ArrowLeft", "08:00:00.000"),
        ("End", "08:00:10.000"),
        ("Shift+ArrowLeft", "08:00:00.000"),
        ("PageUp", "08:00:10.000"),
        ("ArrowDown", "08:00:09.000"),
    ):
        page.keyboard.press(key)
        assert moment(page) == clock
    wait_until(lambda: page.evaluate("location.hash") == "#t=2027-01-15T08:00:09.000Z&robot=r-1")
    said = page.locator("#player-0 input").get_attribute("aria-valuetext") or ""
    assert said == "08:00:09.000 UTC, 1.00 m/s · 10.0° · auto · engaged · operator-1"


def test_a_drive_plays_pauses_and_ends(page: Page, drive: Path) -> None:
    """At sixteen times its speed; the outline moves on the path, and one robot plays at a time."""
    opened(page, drive)
    here = pose(page)
    page.locator("#player-0 select").select_option("16")
    page.locator("#player-0 input").focus()
    page.keyboard.press(" ")
    wait_until(lambda: moment(page) == "08:00:10.000")
    assert page.locator("#player-0 button").inner_text() == "Play"
    assert here == [0.0, 0.0, 0.0]
    assert pose(page) != here
    page.locator("#player-0 select").select_option("1")
    page.locator("#player-0 button").click()  # from the beginning again
    page.locator("#player-1 button").click()
    wait_until(lambda: moment(page, 1) > "08:00:00.000")
    assert moment(page) < "08:00:10.000"
    assert page.locator("#player-0 button").inner_text() == "Play"
    page.locator("#player-1 button").click()
    stood = moment(page, 1)
    page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    assert moment(page, 1) == stood


def test_a_phone_needs_no_sideways_scrolling(page: Page, tmp_path: Path) -> None:
    """With a reason open; what is wide scrolls in its own box."""
    bumper = report_of(saved(tmp_path / "a.mcap", recorded(scenarios.front_bumper)))
    page.set_viewport_size(PHONE)  # type: ignore[arg-type]
    opened(page, bumper, "#t=1700000002")
    page.locator("details.why summary").first.click()
    assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
    box = page.locator("#player-0 input").bounding_box()
    assert box is not None
    assert box["width"] > PHONE["width"] / 3


def test_many_days_begin_with_an_overview(page: Page, tmp_path: Path) -> None:
    """A drive is a row; its link leads to its section, which is drawn when it comes near, over its own seconds."""
    opened(page, report_of(write_messages(tmp_path / "a.mcap", drives_over(25, 36))))
    rows = page.locator(".overview tbody tr")
    assert rows.count() == 36
    assert [one.inner_text() for one in page.locator("h2").all()[:2]] == ["cruiser-1", "Drives"]
    assert page.locator(".overview details").count() == 6
    assert page.locator("section.drive").count() == 30
    last = rows.last.locator("td:nth-child(2) a")
    number = (last.get_attribute("href") or "").rpartition("-")[2]
    assert page.locator(f"#time-{number} canvas").count() == 0
    last.click()
    page.locator(f"#time-{number} canvas").first.wait_for()
    from_text, to_text = shown(page, int(number))
    assert from_text[:13] == to_text[:13] == "2027-02-08T15"
