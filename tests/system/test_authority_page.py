"""Every command of docs/authority.md, in order, each on its own machine, with real processes.

A machine is a home directory; all commands run in the directory that travels between them. Only hosts, ports and
the CAN bus differ from the page. A command that asks for a passphrase has a terminal.
"""

from __future__ import annotations

import os
import pty
import re
import select
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import pytest

from tests.support.fakes.peer import free_endpoint
from tests.support.processes.installed import install
from tests.support.waiting import wait_until

ROOT: Final = Path(__file__).parents[2]
PAGE: Final = ROOT / "docs" / "authority.md"
TIMEOUT_S: Final = 60.0

# Commands that run to the end, and their first output.
STAYS: Final = {
    "cruiser router": r"listens on tls/127\.0\.0\.1",
    "cruiser gateway --config ~/.config/cruiser/robot.toml": "gateway: cruiser-1 listens on nothing",
}
# Commands that run until Ctrl-C, and their output.
REPEATS: Final = {
    "cruiser provision show revocations.statement --all --every 60": "cruiser-1: already has",
}
# Output of the other commands.
SAYS: Final = {
    "cruiser list": "cruiser-1 +(?!offline)[a-z]",
    "cruiser stop cruiser-1": "cruiser-1: stopped",
    "cruiser provision sign operator-ann.request --speed-limit 0.8 --hours 12": "at most 0.8 m/s",
    "cruiser provision show revocations.statement --all": "cruiser-1: accepted",
    "cruiser provision show robot-cruiser-1.bundle --robot cruiser-1": "cruiser-1: accepted",
    "cruiser provision show rotation.statement --all": "cruiser-1: accepted",
}
NOT_HERE: Final = {"cruiser drive cruiser-1": "wants somebody at the keys; tests/system has signed drives"}


def commands() -> list[tuple[str, str]]:
    """Machine and command of all indented blocks, each of which begins with its machine."""
    found: list[tuple[str, str]] = []
    for block in re.findall(r"(?:^    .*\n)+", PAGE.read_text("utf-8"), flags=re.MULTILINE):
        first, *lines = (line.strip() for line in block.splitlines())
        machine = re.match(r"# ([a-z0-9-]+)", first)
        assert machine is not None, first
        found += [(machine[1], line) for line in lines]
    return found


def test_what_is_expected_stands_on_the_page() -> None:
    """No expectation is left over."""
    assert {*STAYS, *REPEATS, *SAYS, *NOT_HERE} <= {command for _, command in commands()}


class Page:
    def __init__(self, place: Path) -> None:
        self.place = place
        self.stick = place / "stick"
        self.stick.mkdir()
        self._fingerprint = ""
        self._exports: dict[str, dict[str, str]] = {}
        self._running: list[tuple[subprocess.Popen[str], Path]] = []
        self._chassis = free_endpoint().removeprefix("tcp/")
        self._router = free_endpoint().removeprefix("tcp/")
        self.start("robot", f"cruiser sim --listen {self._chassis}", " on 127")

    def run(self, machine: str, command: str) -> None:
        export = re.fullmatch(r"export ([A-Z_]+)=(.+)", command)
        if export is not None:
            home = str(self._home(machine))
            self._exports.setdefault(machine, {})[export[1]] = export[2].replace("~", home)
            return
        code, shown = self._at_terminal(machine, command)
        assert code == 0, (machine, command, shown)
        assert "Traceback" not in shown, (machine, command, shown)
        assert re.search(SAYS.get(command, ""), shown), (machine, command, shown)
        self._fingerprint = (re.findall(r"authority ([0-9a-f-]{39})", shown) or [self._fingerprint])[-1]

    def start(self, machine: str, command: str, says: str) -> subprocess.Popen[str]:
        log = self.place / f"{len(self._running)}.log"
        with log.open("w") as output:
            process = subprocess.Popen(
                ["/usr/bin/env", "bash", "-c", f"exec {self._here(command)}"],
                cwd=self.stick,
                env=self._environment(machine),
                stdout=output,
                stderr=output,
                text=True,
            )
        self._running.append((process, log))
        wait_until(lambda: bool(re.search(says, log.read_text())) or process.poll() is not None)
        assert process.poll() is None, (machine, command, log.read_text())
        return process

    def repeat(self, machine: str, command: str, says: str) -> None:
        """Start a command that asks again and again, see that it works, and end it.

        A busy machine's robot may miss its first question, and the next is a minute away.
        """

        def has_said() -> bool:
            process = self.start(machine, command, "robot is connected|cruiser-1: ")
            _, log = self._running[-1]
            self.end(process)
            return re.search(says, log.read_text()) is not None

        wait_until(has_said)

    def end(self, process: subprocess.Popen[str]) -> None:
        process.send_signal(signal.SIGINT)
        assert process.wait(TIMEOUT_S) == 0

    def end_all(self) -> None:
        for process, _ in reversed(self._running):
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
                try:
                    process.wait(TIMEOUT_S)
                except subprocess.TimeoutExpired:
                    process.kill()
                    process.wait()

    def _at_terminal(self, machine: str, command: str) -> tuple[int, str]:
        master, slave = pty.openpty()
        process = subprocess.Popen(
            ["/usr/bin/env", "bash", "-c", self._here(command)],
            cwd=self.stick,
            env=self._environment(machine),
            stdin=slave,
            stdout=slave,
            stderr=slave,
            start_new_session=True,
        )
        os.close(slave)
        shown, answered, end_s = "", 0, time.monotonic() + TIMEOUT_S
        try:
            while time.monotonic() < end_s:
                if not select.select([master], [], [], 0.1)[0]:
                    continue
                try:
                    data = os.read(master, 65536)
                except OSError:  # the last one has left the terminal
                    break
                shown += data.decode(errors="replace")
                asked = len(re.findall(r"passphrase (?:for|of) [^\n]*: |once more: ", shown))
                while answered < asked:
                    os.write(master, b"correct horse\n")
                    answered += 1
            return process.wait(TIMEOUT_S), shown
        finally:
            if process.poll() is None:
                process.kill()
                process.wait()
            os.close(master)

    def _here(self, command: str) -> str:
        command = command.replace("router.example:7447", self._router).replace("router.example", "127.0.0.1")
        command = command.replace("FINGERPRINT", self._fingerprint)
        if command.startswith("cruiser gateway"):
            command += f" --interface socketcand --channel {self._chassis}"
        return command

    def _home(self, machine: str) -> Path:
        home = self.place / machine
        home.mkdir(exist_ok=True)
        return home

    def _environment(self, machine: str) -> dict[str, str]:
        return {
            "HOME": str(self._home(machine)),
            "PATH": f"{self.place / 'bin'}:/usr/bin:/bin",
            "PYTHONPATH": str(ROOT),
            "PYTHONDONTWRITEBYTECODE": "1",
            "TERM": "xterm",
            **self._exports.get(machine, {}),
        }


@pytest.fixture
def page(tmp_path: Path) -> Iterator[Page]:
    install(tmp_path / "bin")
    one = Page(tmp_path)
    try:
        yield one
    finally:
        one.end_all()


@pytest.mark.night
@pytest.mark.timeout(400)
def test_the_commands_of_the_page_do_what_it_says(page: Page) -> None:
    """From a first fleet to a stolen authority."""
    for machine, command in commands():
        if command in STAYS:
            page.start(machine, command, STAYS[command])
        elif command in REPEATS:
            page.repeat(machine, command, REPEATS[command])
        elif command not in NOT_HERE:
            page.run(machine, command)
