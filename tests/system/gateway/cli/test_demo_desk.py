"""``cruiser demo`` and ``cruiser demo --desk``, as a user starts and ends them."""

import json
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from urllib.request import urlopen

import pytest

from gateway.client.robot import Robot
from schemas.command_line import CommandError
from schemas.settings import Settings, ZenohSettings
from tests.support.desk_client import DeskClient
from tests.support.fakes.peer import free_endpoint
from tests.support.nights import by_night
from tests.support.processes.gateway import Running, children
from tests.support.processes.holding import hold
from tests.support.waiting import wait_until

TWO = ["cruiser-1", "cruiser-2"]


def descendants(pid: int) -> set[int]:
    found = children(pid)
    return found.union(*map(descendants, found))


def gateway_of(robot: str, pid: int) -> int:
    commands = {one: Path(f"/proc/{one}/cmdline").read_bytes().split(b"\0") for one in descendants(pid)}
    return next(one for one, words in commands.items() if b"--robot" in words and robot.encode() in words)


def is_running(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@contextmanager
def started(*words: str) -> Iterator[Running]:
    """Run a command that starts others. A test that fails leaves none of them behind."""
    with Running(*words) as running:
        try:
            yield running
        finally:
            if running.process.poll() is None:
                running.stop(signal.SIGINT)


def end(running: Running, number: signal.Signals = signal.SIGINT) -> None:
    """Press Ctrl-C. All processes end, in good order."""
    processes = descendants(running.process.pid)
    assert len(processes) >= 3 * len(TWO)
    assert running.stop(number) == 0
    wait_until(lambda: not any(Path(f"/proc/{one}").exists() for one in processes))


@pytest.mark.parametrize(
    ("words", "count"),
    [
        by_night(("demo", "--seconds", "60"), 4),
        (
            (
                "demo",
                "--desk",
                "--robots",
                "1",
                "--no-browser",
                "--listen",
                "127.0.0.1:0",
                "--endpoint",
                "ENDPOINT",
            ),
            5,
        ),
    ],
    ids=["demo", "demo-desk"],
)
def test_nothing_goes_on_without_the_command_that_started_it(
    words: tuple[str, ...], count: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    endpoint = free_endpoint()
    with Running(*(endpoint if word == "ENDPOINT" else word for word in words)) as running:
        wait_until(lambda: len(descendants(running.process.pid)) >= count)
        processes = descendants(running.process.pid)
    try:
        wait_until(lambda: not any(map(is_running, processes)))
    finally:
        for process in filter(is_running, processes):
            os.kill(process, signal.SIGKILL)


def logs_of(robot: str, desk: str) -> list[str]:
    """Return the logs of a robot that a desk lists, also those in progress."""
    with urlopen(f"{desk}find?search=logs") as answer:  # noqa: S310 - the desk says http
        head, *found = map(json.loads, answer)
    names = [*head["uncataloged"], *(Path(one["file"]).name for one in found)]
    return [name for name in names if name.startswith(f"{robot}-")]


@pytest.mark.usefixtures("beside_foreign_modules")
def test_the_demo_shows_a_fleet_on_the_desk_and_opens_the_browser(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened, out = tmp_path / "opened", tmp_path / "out"
    browser = tmp_path / "browser"
    browser.write_text(f"#!{sys.executable}\nimport sys\nopen({str(opened)!r}, 'w').write(sys.argv[1])\n")
    browser.chmod(0o755)
    endpoint = free_endpoint()
    words = ["--robots", "2", "--out", str(out), "--listen", "127.0.0.1:0", "--endpoint", endpoint]
    there = Settings(zenoh=ZenohSettings(mode="client", connect=[endpoint]))
    monkeypatch.setenv("BROWSER", f"{browser} %s")
    with started("demo", "--desk", *words) as demo:
        wait_until(lambda: (opened.exists() and opened.read_text() != "") or demo.process.poll() is not None)
        with DeskClient(opened.read_text()) as page:
            while sorted(page.rows) != TWO or not page.recorders:
                page.receive()
            with (
                Robot.connect("cruiser-1", "test", there) as robot,
                suppress(CommandError),
                robot.lease() as lease,
            ):
                wait_until(lambda: lease.is_engaged, lambda: hold(robot, lease, 0.3))
                # Its gateway dies: the demo goes on, and the desk shows what the guard has done.
                os.kill(gateway_of("cruiser-1", demo.process.pid), signal.SIGKILL)
                while page.rows["cruiser-1"]["reasons"] != ["guard"]:
                    page.receive()
        wait_until(lambda: logs_of("cruiser-1", opened.read_text()))
        # The terminal is closed.
        end(demo, signal.SIGHUP)
    assert list(out.glob("**/*.mcap"))
