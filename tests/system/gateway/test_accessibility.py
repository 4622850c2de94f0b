"""The desk's page and the reports as axe-core judges them, in a real browser: WCAG 2.2, levels A and AA."""

from __future__ import annotations

import asyncio
import re
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import Final, Literal

import msgspec
import pytest
from playwright.sync_api import Browser, Page

from gateway.cli.desk_logs import DeskLogs
from gateway.cli.desk_server import Hub, make_app, serve
from gateway.client.fleet import WORDS
from gateway.client.remote_stop import StopReport
from gateway.desk.words import FROM_BROWSER_BYTES
from gateway.telemetry.samples import Arrival
from schemas import keys
from schemas.decisions import ArbiterState, Severity, StopPhase
from schemas.messages import Message, Mode
from schemas.reasons import Reason
from schemas.settings import Settings
from tests.support.axe import assert_fits_a_small_phone, assert_for_everybody
from tests.support.fakes.desk import FakeCommandPort, FakeDeskListener
from tests.support.messages import HEALTH, STANDBY, STATE, event, recorder_health
from tests.support.metrics import received
from tests.support.nights import by_night, every_value
from tests.support.rigs.scenarios import front_bumper, recorded

HOST: Final = "127.0.0.1"

TURNS: Final = 10  # the listener is asked a hundred times a second; robots publish ten times
EVENTS: Final = 20  # so many fill the list of a robot's events, and it scrolls
EVENTS_TURN: Final = 50  # what happened before its robot is known is not kept
_READY: Final = msgspec.structs.replace(STANDBY, lease_holder="", blocked_by=[Reason.NO_LEASE, Reason.NOT_ENGAGED])
_ENGAGED: Final = msgspec.structs.replace(
    STANDBY, state=ArbiterState.ENGAGED, engaged=True, link_age_s=0.02, travel_speed_limit_mps=1.5
)
_STANDS: Final = msgspec.structs.replace(STATE, speed_mps=0.0)
_LATCHED: Final = [Reason.FRONT_BUMPER, Reason.REMOTE_STOP]

STATES: Final[dict[str, tuple[Message, ...]]] = {
    "offline": (),
    "needs_reset": (_STANDS, msgspec.structs.replace(_READY, latched=_LATCHED, blocked_by=_LATCHED)),
    "bus_down": (msgspec.structs.replace(STATE, bus_up=False), _READY),
    "stopping": (STATE, msgspec.structs.replace(STANDBY, state=ArbiterState.STOPPING, stop_phase=StopPhase.RAMP)),
    "remote_control": (msgspec.structs.replace(_STANDS, mode=Mode.REMOTE), _READY),
    "blocked": (_STANDS, msgspec.structs.replace(_READY, blocked_by=[Reason.FEEDBACK_MISSING])),
    "driving": (STATE, _ENGAGED),
    "in_control": (_STANDS, _ENGAGED),
    "ready": (_STANDS, _READY),
    "telemetry": (_STANDS,),
}
"""Samples of a robot for each word, besides its health. The robot's name is the word."""

assert STATES.keys() == WORDS.keys()


class _EverythingAtOnce(FakeDeskListener):
    """All these robots and a recorder; the latched one has events."""

    def __init__(self) -> None:
        super().__init__()
        self._said = [(word.replace("_", "-"), one) for word, said in STATES.items() for one in (*said, HEALTH)]
        self._said.append(("depot", recorder_health()))
        severities = list(Severity)
        happened = [event(one, severity=severities[one % len(severities)]) for one in range(EVENTS)]
        self._happened = [received(one, "needs-reset") for one in happened]
        self._turn = 0

    def drain(self) -> Iterator[Arrival]:
        self._turn += 1
        if self._turn % TURNS == 0:
            # What is said again with an old time is old.
            now_ns = time.time_ns()
            said = ((msgspec.structs.replace(one, time_ns=now_ns), who) for who, one in self._said)
            self.waiting += [received(one, who) for one, who in said]
        if self._turn == EVENTS_TURN:
            self.waiting += self._happened
        yield from super().drain()


def _stop(_settings: Settings, robot: str, _operator: str, _timeout_s: float) -> StopReport:
    """Return success for one robot, and every outcome for all."""
    if robot != keys.ALL:
        return StopReport([robot], {}, {}, [], linked=True)
    blocked, held = {"blocked": "its bus is down"}, {"in-control": "its speed is unknown"}
    return StopReport(["ready"], blocked, held, ["offline"], linked=True)


@contextmanager
def desk_of_all_states(logs: Path) -> Iterator[str]:
    """Serve the desk with these logs. Yields its address."""
    ended = threading.Event()
    with ExitStack() as stack:
        listening = stack.enter_context(socket.create_server((HOST, 0)))
        hub = Hub(
            Settings(),
            _EverythingAtOnce(),  # type: ignore[arg-type]
            FakeCommandPort(),  # type: ignore[arg-type]
            _stop,
            has_logs=True,
        )
        app = make_app(hub, [HOST], stack.enter_context(closing(DeskLogs(logs))))

        async def work() -> None:
            async with asyncio.TaskGroup() as group:
                group.create_task(hub.run(ended.is_set))
                group.create_task(serve(app, listening, ended.is_set, socket_bytes=FROM_BROWSER_BYTES))

        serving = threading.Thread(target=asyncio.run, args=(work(),))
        stack.callback(serving.join)
        stack.callback(ended.set)
        serving.start()
        yield f"http://{HOST}:{listening.getsockname()[1]}/"


LOG: Final = "needs-reset-20260102T030405Z.mcap"

REPORT_MS: Final = 100_000  # a report is made when it is asked for; a busy machine takes its time


CUT: Final = """() => [...document.querySelectorAll(".band, .band *, .why, .why *, #link")]
    .filter((one) => !one.matches(".heard"))
    .filter((one) => one.scrollWidth > one.clientWidth + 1 && getComputedStyle(one).overflowX !== "visible"
        || one.getBoundingClientRect().right > innerWidth)
    .map((one) => one.outerHTML)"""


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    logs = tmp_path_factory.mktemp("logs")
    (logs / LOG).write_bytes(recorded(front_bumper))
    with desk_of_all_states(logs) as address:
        yield address


def overview(page: Page, address: str) -> None:
    """All robots, after a stop of all in which some did not come to rest."""
    page.goto(address)
    page.locator("tr[data-robot=telemetry]").wait_for()
    page.locator("#stop-all").click()
    page.locator("#stop-of- li").first.wait_for()


def wall(page: Page, address: str) -> None:
    page.goto(f"{address}#/wall")
    page.locator(".tile[data-robot=telemetry]").wait_for()


def robot(page: Page, address: str) -> None:
    """A latched robot with reasons and events, the keys unfolded, after a stop."""
    page.goto(f"{address}#/robot/needs-reset")
    page.locator(".why li").first.wait_for()
    page.locator(".events .error").first.wait_for()
    page.locator("a[href^='#/logs?']").wait_for()
    page.locator("summary").click()
    page.keyboard.press("Escape")
    page.locator("#stop-of-needs-reset li").wait_for()


def kiosk(page: Page, address: str) -> None:
    page.goto(f"{address}#/kiosk/driving")
    page.locator(".band .word", has_text=re.compile("driving|行驶中")).wait_for()


def report(page: Page, address: str) -> None:
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
    """WCAG 2.2: names, contrast, keyboard, and no sideways scrolling at 320 pixels (1.4.10)."""
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
