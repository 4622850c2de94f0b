"""The desk (``make nightly``): each way to let go twenty times over, and a browser that is far away."""

import time
from collections.abc import Callable, Iterator
from itertools import pairwise

import pytest
from playwright.sync_api import Browser, Page

from schemas.settings import CommandSettings
from tests.support.processes.desk import DeskScene, desk_scene, drive, open_robot
from tests.support.processes.letting_go import WAYS
from tests.support.processes.tcp_link import TcpLink
from tests.support.waiting import wait_until

TIMES = 20
COMMAND = CommandSettings()


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DeskScene]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        with desk_scene() as scene:
            yield scene


def let_go_and_watch(scene: DeskScene, page: Page, let_go: Callable[[Page], object]) -> float:
    """Let go of a robot that is speeding up. Returns the seconds until it slows down."""
    let_go_ns = time.monotonic_ns()
    let_go(page)
    scene.wait_told_zero()
    bursts = [burst.at_ns for burst in scene.listener.bursts[:-1]]
    told = list(zip(bursts, scene.told_mps(), strict=False))
    faster_ns = [at_ns for (_, before), (at_ns, speed) in pairwise(told) if speed > before]
    return max(0.0, (faster_ns[-1] - let_go_ns) / 1e9)


@pytest.mark.timeout(600)
@pytest.mark.parametrize("way", WAYS)
def test_each_way_to_let_go_stops_the_robot_twenty_times(
    scene: DeskScene, running_browser: Browser, way: str
) -> None:
    """It speeds up no longer than the deadman and a tick; no drive begins by itself."""
    late = []
    for _ in range(TIMES):
        context = running_browser.new_context(locale="en-GB")
        try:
            page = open_robot(context, scene)
            drive(scene, page)
            late.append(let_go_and_watch(scene, page, WAYS[way]))
        finally:
            context.close()
    print(f"{way}: {min(late):.3f} to {max(late):.3f} s")  # noqa: T201 - a figure to look at
    assert max(late) <= COMMAND.deadman_s + 0.1


def test_a_browser_that_is_300_ms_away_drives_slowly_and_stops(scene: DeskScene, running_browser: Browser) -> None:
    """The speed is limited by the age of its commands, 600 ms."""
    with TcpLink(scene.address, lambda: 0.3) as link:
        context = running_browser.new_context(locale="en-GB")
        try:
            page = open_robot(context, scene, f"http://127.0.0.1:{link.port}/")
            drive(scene, page)
            wait_until(lambda: " ms" in page.locator(".now").inner_text())
            age_ms = int(page.locator(".now").inner_text().split("Link:")[1].split("ms")[0])
            assert age_ms >= 600
            page.mouse.up()
            scene.wait_told_zero()
        finally:
            context.close()
