"""Every command of docs/authority.md, in order, each on its own machine, with real processes.

A machine is a home directory; all commands run in the directory that travels between them. Only hosts, ports and
the CAN bus differ from the page. A command that asks for a passphrase has a terminal.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import pytest

from tests.support.fakes.peer import free_endpoint
from tests.support.processes.installed import install
from tests.support.processes.terminal import Terminal
from tests.support.waiting import wait_until

ROOT: Final = Path(__file__).parents[2]
PAGE: Final = ROOT / "docs" / "authority.md"

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
        self._running: list[Terminal] = []
        self._chassis = free_endpoint().removeprefix("tcp/")
        self._router = free_endpoint().removeprefix("tcp/")
        self.start("robot", f"cruiser sim --listen {self._chassis}", " on 127")

    def run(self, machine: str, command: str) -> None:
        export = re.fullmatch(r"export ([A-Z_]+)=(.+)", command)
        if export is not None:
            home = str(self._home(machine))
            self._exports.setdefault(machine, {})[export[1]] = export[2].replace("~", home)
            return
        terminal = self._at_terminal(machine, command)
        code, shown = terminal.wait(), terminal.shows
        assert code == 0, (machine, command, shown)
        assert "Traceback" not in shown, (machine, command, shown)
        assert re.search(SAYS.get(command, ""), shown), (machine, command, shown)
        self._fingerprint = (re.findall(r"authority ([0-9a-f-]{39})", shown) or [self._fingerprint])[-1]

    def start(self, machine: str, command: str, says: str) -> Terminal:
        terminal = self._at_terminal(machine, f"exec {command}")
        self._running.append(terminal)
        wait_until(lambda: terminal.is_showing(says))
        assert terminal.process.poll() is None, (machine, command, terminal.shows)
        return terminal

    def repeat(self, machine: str, command: str, says: str) -> None:
        """Start a command that asks again and again, see that it works, and end it.

        A busy machine's robot may miss its first question, and the next is a minute away.
        """

        def has_said() -> bool:
            terminal = self.start(machine, command, "robot is connected|cruiser-1: ")
            assert terminal.end() == 0
            return re.search(says, terminal.shows) is not None

        wait_until(has_said)

    def end_all(self) -> None:
        for terminal in reversed(self._running):
            if terminal.process.poll() is None:
                terminal.kill()

    def _at_terminal(self, machine: str, command: str) -> Terminal:
        words = ["/usr/bin/env", "bash", "-c", self._here(command)]
        return Terminal(words, self.stick, self._environment(machine))

    def _here(self, command: str) -> str:
        command = command.replace("router.example:7447", self._router).replace("router.example", "127.0.0.1")
        command = command.replace("FINGERPRINT", self._fingerprint)
        if "cruiser gateway" in command:
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
