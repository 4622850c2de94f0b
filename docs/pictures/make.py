# SPDX-License-Identifier: Apache-2.0
"""Make the README's pictures: `make pictures`. Needs an idle machine, Chromium and a Chinese font.

On Debian: `apt-get install chromium fonts-wqy-microhei`.

- ``demo.svg``    the demo in a terminal, and why the robot stopped, as the commands print it
- ``report.png``  the top of the same demo's drive report
- ``desk.png``    the desk with a virtual fleet: the overview, and below it a robot that drives

Each PNG describes itself by its page's text; a test compares that, and the SVG's, with what is shown now.
"""

import io
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Final

from PIL import Image
from PIL.PngImagePlugin import PngInfo
from playwright.sync_api import FloatRect, Page, sync_playwright
from rich.console import Console
from rich.terminal_theme import MONOKAI
from rich.text import Text

PICTURES: Final = Path(__file__).parent
BROWSERS: Final = ("chromium", "chromium-browser", "google-chrome")
COLUMNS: Final = 138
WIDTH, HEIGHT = 1200, 1420
DESK_WIDTH, DESK_HEIGHT = 1200, 760
ROBOTS: Final = 4
DRIVE: Final = ("drive", "cruiser-1", "--speed", "0.6", "--angle", "18", "--seconds", "600", "--operator", "ann")
DRIVEN_MS: Final = 10_000  # how long the robot has driven in the picture
SETTLED_MS: Final = 1_000  # until the report has drawn its charts
DEADLINE_MS: Final = 300_000


def cruiser(*words: str, where: Path) -> str:
    """The output of a command."""
    command = [sys.executable, "-m", "gateway", *words]
    environment = os.environ | {"COLUMNS": str(COLUMNS), "PYTHONPATH": str(PICTURES.parents[1])}
    return subprocess.run(
        command, cwd=where, env=environment, stdout=subprocess.PIPE, text=True, check=True
    ).stdout


def terminal(screens: list[tuple[str, str]], title: str) -> str:
    """Commands and their output as an SVG that loads nothing: the viewer's own font serves."""
    console = Console(record=True, width=COLUMNS, file=io.StringIO(), force_terminal=True)
    for command, printed in screens:
        console.print(Text.assemble(("$ ", "bold green"), (command, "bold")))
        console.print(Text(printed))
    svg = console.export_svg(title=title, theme=MONOKAI)
    svg = re.sub(r"@font-face \{.*?\}\n?|<!--.*?-->\n?", "", svg, flags=re.DOTALL)
    return re.sub(r"[ \t]+$", "", svg.replace("Fira Code, monospace", "monospace"), flags=re.MULTILINE)


def chromium() -> str:
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        raise SystemExit("no Chromium: apt-get install chromium")
    return browser


def report(file: Path, picture: Path) -> None:
    """The drive report as a browser shows it in the light theme."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium(), args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": WIDTH, "height": HEIGHT}, color_scheme="light")
        page.goto(file.as_uri())
        page.wait_for_timeout(SETTLED_MS)
        save(Image.open(io.BytesIO(page.screenshot())), picture, page.inner_text("body"))
        browser.close()


def save(image: Image.Image, picture: Path, text: str) -> None:
    """Write a picture of few colours, with its text as its description."""
    described = PngInfo()
    described.add_text("Description", text, zip=True)
    image.convert("RGB").quantize(128).save(picture, optimize=True, pnginfo=described)


def desk(where: Path, picture: Path) -> None:
    """The desk of a virtual fleet: the overview, and below it a robot that drives."""
    words = ("demo", "--desk", "--no-browser", "--robots", str(ROBOTS))
    command = [sys.executable, "-m", "gateway", *words]
    environment = os.environ | {"PYTHONPATH": str(PICTURES.parents[1])}
    with subprocess.Popen(command, cwd=where, env=environment, stdout=subprocess.PIPE, text=True) as demo:
        try:
            address = re.search(r"http://\S+/", demo.stdout.readline() if demo.stdout else "")
            if address is None:
                raise SystemExit("the desk does not say where it is")
            with sync_playwright() as playwright:
                browser = playwright.chromium.launch(executable_path=chromium(), args=["--no-sandbox"])
                page = browser.new_page(
                    viewport={"width": DESK_WIDTH, "height": DESK_HEIGHT}, color_scheme="light"
                )
                page.set_default_timeout(DEADLINE_MS)
                _stopped(page, address[0])
                with subprocess.Popen([sys.executable, "-m", "gateway", *DRIVE], env=environment) as drive:
                    driven, below = _driven(page)
                    fleet, above = _fleet(page)
                    save(stacked(fleet, driven), picture, f"{above}\n{below}")
                    drive.send_signal(signal.SIGINT)
                browser.close()
        finally:
            demo.send_signal(signal.SIGINT)


def _stopped(page: Page, address: str) -> None:
    """Stop the last robot of the fleet, and return to the overview."""
    page.goto(f"{address}#/robot/cruiser-{ROBOTS}")
    page.locator(".band .word", has_text="ready").wait_for()
    page.get_by_role("button", name=f"STOP cruiser-{ROBOTS}").click()
    page.get_by_text("stopped and latched (measured)").wait_for()
    page.get_by_role("button", name="Close").click()
    page.get_by_role("link", name="Fleet").click()


def _driven(page: Page) -> tuple[bytes, str]:
    """The page of a robot that has driven for a while and still does, and its text."""
    driving = page.locator(".band .word", has_text="driving")
    while True:
        page.locator("tr", has_text="driving").get_by_role("link").click()
        page.wait_for_timeout(DRIVEN_MS)
        # Whoever looks at a picture holds no pad.
        page.locator(".drive").evaluate("panel => { panel.hidden = true; }")
        picture, text = page.screenshot(), page.inner_text("main")
        was_driving = driving.is_visible()
        page.get_by_role("link", name="Fleet").click()
        if was_driving:
            return picture, text


def _fleet(page: Page) -> tuple[bytes, str]:
    page.locator("tr", has_text="driving").wait_for()
    main = page.locator("main")
    box = main.bounding_box()
    if box is None:
        raise SystemExit("the desk shows nothing")
    clip: FloatRect = {"x": 0, "y": 0, "width": DESK_WIDTH, "height": box["y"] + box["height"]}
    return page.screenshot(clip=clip), main.inner_text()


def stacked(above: bytes, below: bytes) -> Image.Image:
    """One picture of two."""
    images = [Image.open(io.BytesIO(one)).convert("RGB") for one in (above, below)]
    both = Image.new("RGB", (DESK_WIDTH, sum(one.height for one in images)), "white")
    both.paste(images[0], (0, 0))
    both.paste(images[1], (0, images[0].height))
    return both


def main() -> None:
    """Run the demo for two pictures, and the virtual fleet for the third."""
    with tempfile.TemporaryDirectory() as folder:
        where = Path(folder)
        demo = cruiser("demo", "--seconds", "30", "--out", "demo-log", where=where)
        [stop] = re.findall(r"^ *([\d.]+) s +robot +stopping: the front bumper", demo, flags=re.MULTILINE)
        why = ("review", "why", "demo-log", "--at", stop)
        screens = [("make demo", demo.partition("open it in")[0]), (f"cruiser {' '.join(why)}", "")]
        screens[1] = (screens[1][0], cruiser(*why, where=where))
        (PICTURES / "demo.svg").write_text(terminal(screens, "Cruiser Gateway"), "utf-8")
        cruiser("review", "report", "demo-log", "-o", "report.html", where=where)
        report(where / "report.html", PICTURES / "report.png")
        desk(where, PICTURES / "desk.png")


if __name__ == "__main__":
    main()
