"""A robot without contact to the page, in a real browser: any process between them dies or hangs."""

import re
import signal
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page

from tests.support.nights import every_value
from tests.support.processes.desk import DeskScene, desk_scene, drive, open_robot
from tests.support.processes.gateway import Running
from tests.support.waiting import wait_until

LOST = re.compile(
    r"No contact with cruiser-1 for (\d+\.\d) s\. It may be moving\. Look at it; use the button on the robot\."
)
LONG_S = 4.0  # the page goes on saying so, with the time; long enough for the desk and Zenoh to give each other up


def lost_s(page: Page) -> float:
    """Return how long the page says that it has no contact; 0 if it does not."""
    found = LOST.search(page.locator("main").inner_text())
    return float(found[1]) if found else 0.0


def assert_nothing_old_is_shown(page: Page) -> None:
    """Only STOP, no driver, and no value of the robot."""
    text = page.locator("main").inner_text()
    assert "You are driving" not in text
    assert "m/s" not in text.replace("Speed, m/s", "")
    assert not page.locator(".pad, .why, .facts").filter(visible=True).count()
    assert not page.locator("main button:visible, main input:visible").count()
    assert page.get_by_role("button", name="STOP cruiser-1").is_enabled()


def victim(scene: DeskScene, name: str) -> Running:
    running = getattr(scene, name)
    assert isinstance(running, Running)
    return running


@pytest.mark.parametrize(
    ("name", "number"), every_value(["gateway", "desk", "router"], [signal.SIGKILL, signal.SIGSTOP])
)
def test_a_robot_that_is_not_heard_is_nobody_s(
    name: str, number: signal.Signals, running_browser: Browser, tmp_path: Path
) -> None:
    """The page judges by its own clock: no process between it and the robot has to notice anything."""
    with desk_scene(routed=tmp_path) as scene, running_browser.new_context() as context:
        page = open_robot(context, scene)
        drive(scene, page)
        victim(scene, name).process.send_signal(number)
        wait_until(lambda: lost_s(page) > 0)
        assert_nothing_old_is_shown(page)
        wait_until(lambda: lost_s(page) > LONG_S)
        assert_nothing_old_is_shown(page)
        if number is signal.SIGSTOP:
            victim(scene, name).process.send_signal(signal.SIGCONT)
            # It is shown again; nobody drives on by themselves.
            wait_until(lambda: lost_s(page) == 0)
            page.get_by_text("You are no longer driving: no contact with cruiser-1").wait_for()
            assert not page.locator(".pad.live").count()
        scene.wait_told_zero()


NOTE_WHETHER_IT_IS_SHOWN = """() => {
    const robot = document.querySelector(".robot");
    const note = () => { window.wasShown ||= !robot.classList.contains("lost"); };
    new MutationObserver(note).observe(robot, {attributes: true});
}"""


def test_what_waited_in_a_desk_that_hung_is_not_what_the_robot_does(
    running_browser: Browser, tmp_path: Path
) -> None:
    with desk_scene(routed=tmp_path) as scene, running_browser.new_context() as context:
        page = open_robot(context, scene)
        scene.desk.process.send_signal(signal.SIGSTOP)
        wait_until(lambda: lost_s(page) > 0)
        scene.gateway.process.send_signal(signal.SIGKILL)
        page.evaluate(NOTE_WHETHER_IT_IS_SHOWN)
        # Before the page gives its connection up.
        wait_until(lambda: lost_s(page) > 2.2)
        scene.desk.process.send_signal(signal.SIGCONT)
        page.locator("#link", has_text=re.compile("^connected$")).wait_for()
        wait_until(lambda: lost_s(page) > 2 * LONG_S)
        assert not page.evaluate("window.wasShown")


@pytest.mark.night
def test_what_is_shown_again_after_a_pause_is_all_of_it(running_browser: Browser) -> None:
    with desk_scene() as scene, running_browser.new_context() as context:
        page = context.new_page()
        page.goto(scene.address)
        word = page.locator("tr[data-robot=cruiser-1] .pill")
        word.get_by_text("ready").wait_for()
        scene.desk.process.send_signal(signal.SIGSTOP)
        wait_until(lambda: word.inner_text() == "offline")
        scene.desk.process.send_signal(signal.SIGCONT)
        word.get_by_text("ready").wait_for()
        page.get_by_text("No contact with the desk").wait_for(state="hidden")
