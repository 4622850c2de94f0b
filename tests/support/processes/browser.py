"""A real browser, without a window and without a network."""

import json
import os
import shutil
import subprocess
from pathlib import Path
from typing import Final

import msgspec
import pytest

NAMES: Final = ("chromium", "google-chrome")
"""What it may be called. Another program is named by ``TEST_BROWSER``."""

FLAGS: Final = (
    "--headless=new",
    "--disable-gpu",
    "--disable-dev-shm-usage",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--hide-scrollbars",
    "--enable-logging=stderr",
    # Whatever asks for a name gets none.
    "--host-resolver-rules=MAP * ~NOTFOUND",
    # Time goes as fast as the page can, and stops when it has nothing more to do.
    "--virtual-time-budget=10000",
)

DEADLINE_S: Final = 100


class Opened(msgspec.Struct):
    """A page as the browser had it at the end.

    Attributes:
        console: what the page wrote there, and what the browser complained about.
        requests: the addresses that the browser asked for in the page's name.
    """

    dom: str
    console: list[str]
    requests: list[str]


def browser() -> str:
    """Return its place; without one the test is skipped. Ubuntu's is a snap, which opens no file of a test."""
    found = [os.environ.get("TEST_BROWSER", ""), *map(shutil.which, NAMES)]
    for program in found:
        if program and "/snap/" not in program:
            return program
    pytest.skip("no Chromium is here (Debian: chromium)")


def open_page(page: Path, scratch: Path) -> Opened:
    """Open a page, let it run, and see what has become of it."""
    net_log = scratch / "net.json"
    done = _run(scratch, "--dump-dom", f"--log-net-log={net_log}", page.as_uri())
    console = [line for line in done.stderr.splitlines() if ":CONSOLE:" in line]
    return Opened(done.stdout, console, _requests(net_log))


def take_picture(page: Path, scratch: Path, width: int, height: int, *, dark: bool = False) -> bytes:
    """The page as PNG; ``scratch`` is the browser's own."""
    shot = scratch / "shot.png"
    colours = ["--blink-settings=preferredColorScheme=0"] if dark else []
    _run(scratch, f"--window-size={width},{height}", f"--screenshot={shot}", *colours, page.as_uri())
    return shot.read_bytes()


def _run(scratch: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    sandbox = ["--no-sandbox"] if os.geteuid() == 0 else []
    return subprocess.run(
        [browser(), *FLAGS, *sandbox, f"--user-data-dir={scratch / 'profile'}", *arguments],
        capture_output=True,
        text=True,
        check=True,
        timeout=DEADLINE_S,
    )


def _requests(net_log: Path) -> list[str]:
    """What was asked for by a page; what the browser asks for of itself has no such initiator."""
    log = json.loads(net_log.read_text())
    found = []
    for event in log["events"]:
        params = event.get("params", {})
        if "url" in params and params.get("initiator", "not an origin") != "not an origin":
            found.append(params["url"])
    return found
