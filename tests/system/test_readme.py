"""Every command of the pages for newcomers, in order, in an empty home, by a user who is not root.

Chassis, gateway, recorder and demo are real processes. Only the ports differ from the pages.
"""

from __future__ import annotations

import os
import re
import shlex
import signal
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import msgspec
import pytest

from tests.support.fakes.peer import free_endpoint
from tests.support.nights import by_night
from tests.support.processes.installed import install
from tests.support.processes.nobody import NOBODY, become_nobody
from tests.support.processes.terminal import Terminal
from tests.support.waiting import wait_until

ROOT: Final = Path(__file__).parents[2]
PAGES: Final = ("README.md", "docs/tour.md", "docs/messages.md", "docs/install.md#Without the package")
"""In the order in which somebody reads them; of the last one section."""

ATTEMPTS: Final = 3


class Run(msgspec.Struct, frozen=True):
    """A command that ends by itself.

    Attributes:
        says: a regular expression for its output.
        first: commands to run before, until they succeed.
        drives: on a busy machine the guard may stop the robot, which is then reset and driven again.
        ended: running commands to end before, with Ctrl-C.
        beside: its output; only a command that names this waits for its end.
    """

    says: str
    codes: tuple[int, ...] = (0,)
    first: tuple[str, ...] = ()
    drives: bool = False
    ended: tuple[str, ...] = ()
    beside: str = ""


class Start(msgspec.Struct, frozen=True):
    """A command that runs until Ctrl-C, and ends with this code; ``stays``: to the end of the page."""

    says: str
    code: int = 0
    stays: bool = False


PICTURE: Final = (
    "TELEMETRY  CAN bus > frame > check and decode > message > sample > zenoh > recorder > MCAP > review"
)

COMMANDS: Final[dict[str, Run | Start | str]] = {
    "make demo": Run(r"second-operator gave the lease back(.|\n)*log: demo-log/", beside="demo-log"),
    "make demo-desk": "tests/system/gateway/cli/test_demo_desk.py runs it",
    # Five minutes.
    "cruiser sim": Start(r" on 127\.0\.0\.1:", stays=True),
    "cruiser gateway --interface socketcand --channel 127.0.0.1:29536": Start("gateway: ", stays=True),
    "cruiser watch cruiser-1": Start("cruiser-1"),
    "cruiser record -o logs": Start("record: waiting", stays=True),
    "cruiser drive cruiser-1": Start("hold to move"),
    "cruiser drive cruiser-1 --speed 0.5 --angle 10 --seconds 3": Run("driven for 3 s", drives=True),
    "cruiser stop cruiser-1": Run("cruiser-1: stopped, latched"),
    "cruiser why cruiser-1": Run("a remote stop was received", codes=(0, 1)),
    "cruiser reset cruiser-1": Run("cleared .*remote_stop"),
    "cruiser review events logs": Run("remote_stop", ended=("cruiser record -o logs",)),
    # A client.
    "import time": Run("", drives=True),
    PICTURE: "a picture",
    # The tour.
    "cruiser fault bumper front on": Run("ok", first=("cruiser record -o logs",)),
    "cruiser fault transmitter remote": Run("ok"),
    "cruiser fault sticks 0.8 15": Run("ok"),
    "cruiser fault checksum Auto_DriveFeedBack for 2s": Run("ok"),
    "cruiser fault slope 8": Run("ok"),
    "cruiser fault clear": Run("ok"),
    "cruiser review info logs": Run("cruiser-1", ended=("cruiser record -o logs",)),
    "cruiser reset cruiser-1 --json": Run("", first=("cruiser reset cruiser-1",)),
    # A recorder.
    "cruiser record status": Run("messages written", first=("cruiser record -o logs",)),
    "cruiser record mark -m 'it swerved'": Run("incident recorded"),
    "cruiser review recover FILE...": Run("whole"),
    # A log.
    "cruiser review events demo-log": Run("the front bumper was hit"),
    "cruiser review why demo-log --at 16.3": Run("stop"),
    "cruiser review rerun demo-log": Run("different: 0"),
    "cruiser review rerun demo-log --set command.speed_limit_mps=0.4": Run("decisions differ"),
    "cruiser review report demo-log -o report.html": Run(r"cruiser-1: \d+ drive.*the front bumper was hit"),
    "cruiser review check logs": Run("Auto_DriveFeedBack: frames with a wrong checksum", codes=(1,)),
    'cruiser review query "SELECT reason, count(*) FROM safety_decision GROUP BY reason" demo-log': Run(
        r"none +\d"
    ),
    "cruiser review export -o dataset demo-log": Run(""),
    "cruiser review replay demo-log --listen tcp/127.0.0.1:7450": Start("waiting for a subscriber", stays=True),
    "cruiser watch cruiser-1 --root replay --connect tcp/127.0.0.1:7450": Start("cruiser-1"),
    # A payload, on a robot.
    "import msgpack, zenoh": Start("'speed_mps'", code=-signal.SIGINT),
    "ip link set can0 up txqueuelen 10 type can bitrate 500000 restart-ms 100": "wants a robot's can0, and root",
    "cruiser gateway --robot cruiser-7": "wants a robot's can0; tests/socketcan has a vcan",
}
"""What becomes of each command of the pages; a text is the reason why it is not run here.

A block of a program is named by its first line.
"""


def _text(name: str) -> str:
    path, _, section = name.partition("#")
    page = (ROOT / path).read_text("utf-8")
    return page.partition(f"\n## {section}\n")[2].partition("\n## ")[0] if section else page


def commands(pages: tuple[str, ...] = PAGES) -> list[tuple[str, str]]:
    """The indented blocks outside of fences: each command, or a program's first line, with its text."""
    page = "\n".join(map(_text, pages))
    page = re.sub(r"^```.*?^```", "", page, flags=re.MULTILINE | re.DOTALL)
    found = []
    for block in re.findall(r"(?:^    .*\n)+", page, flags=re.MULTILINE):
        lines = [line[4:].rstrip() for line in block.splitlines()]
        if re.match(r"cruiser |make |# ", lines[0]):
            bare = [re.sub(r"(^|\s+)# .*", "", line).strip() for line in lines]
            found += [(line, line) for line in bare if line]
        else:
            found.append((lines[0].strip(), "\n".join(lines)))
    return found


def test_every_command_is_run_or_has_a_reason() -> None:
    """And no other is listed."""
    assert [name for name, _ in commands()] == list(COMMANDS)


def test_the_chinese_page_has_no_command_of_its_own() -> None:
    """Its commands are those of the English pages."""
    shown = {name for name, _ in commands(("docs/zh/README.md",))}
    assert shown
    assert shown <= set(COMMANDS)


# Settings of a program for a robot at another endpoint.
SETTINGS: Final = """\
import os
from gateway.cli.configuration_file import load_settings
SETTINGS = load_settings(None, os.environ, {})
"""


class Newcomer:
    """A user with an empty home and several terminals."""

    def __init__(self, home: Path) -> None:
        self.home = home
        self._become = become_nobody()
        self._running: dict[str, tuple[Start, Terminal]] = {}
        self._beside: dict[str, tuple[Run, Terminal]] = {}
        self._chassis = free_endpoint().removeprefix("tcp/")
        self._endpoint = free_endpoint()
        # Where the page says a port, or where the default is one.
        self._ports = {
            "127.0.0.1:29536": self._chassis,
            "tcp/127.0.0.1:7447": self._endpoint,
            "tcp/127.0.0.1:7450": free_endpoint(),
            'Robot.connect("cruiser-1")': 'Robot.connect("cruiser-1", settings=SETTINGS)',
        }

    def run(self, name: str, text: str, what: Run) -> None:
        """Run it to its end, or begin it beside what follows."""
        for one in what.ended:
            self.end(one)
        for one in what.first:
            self._succeed(one)
        terminal = self._start(text)
        if what.beside:
            self._beside[name] = (what, terminal)
            return
        self._finish(name, text, what, terminal)

    def _finish(self, name: str, text: str, what: Run, terminal: Terminal) -> None:
        code = terminal.wait()
        for _ in range(ATTEMPTS if what.drives else 0):
            if code in what.codes:
                break
            self._succeed("cruiser reset cruiser-1")
            terminal = self._start(text)
            code = terminal.wait()
        assert code in what.codes, (name, code, terminal.shows)
        assert re.search(what.says, terminal.shows), (name, terminal.shows)
        assert "Traceback" not in terminal.shows, (name, terminal.shows)

    def start(self, name: str, text: str, what: Start) -> None:
        terminal = self._start(text)
        self._running[name] = (what, terminal)
        wait_until(lambda: terminal.is_showing(what.says))
        assert terminal.process.poll() is None, (name, terminal.shows)
        if not what.stays:
            self.end(name)

    def end(self, name: str) -> None:
        what, terminal = self._running.pop(name)
        assert terminal.end() == what.code, (name, terminal.shows)

    def end_all(self) -> None:
        self._await("")
        for name in reversed(list(self._running)):
            self.end(name)

    def kill_all(self) -> None:
        for _, terminal in (*self._running.values(), *self._beside.values()):
            terminal.kill()

    def _succeed(self, name: str) -> None:
        what = COMMANDS.get(name)
        if isinstance(what, Start):
            self.start(name, name, what)
            return
        wait_until(lambda: self._start(name).wait() == 0)

    def _await(self, text: str) -> None:
        """Wait for the commands whose output is named here; for an empty text, for all."""
        for name, (what, terminal) in list(self._beside.items()):
            if not text or what.beside in text:
                self._finish(name, name, what, terminal)
                del self._beside[name]

    def _start(self, text: str) -> Terminal:
        self._await(text)
        text = text.replace("FILE...", shlex.join(map(str, sorted(self.home.glob("logs/*Z.mcap")))))
        for there, here in self._ports.items():
            text = text.replace(there, here)
        environment = {
            "HOME": str(self.home),
            "PATH": f"{self.home.parent / 'bin'}:/usr/bin:/bin",
            "PYTHONPATH": str(ROOT),
            "PYTHONDONTWRITEBYTECODE": "1",
            "TERM": "xterm",
            "COLUMNS": "200",
            "CRUISER_SIM_LISTEN": self._chassis,
        }
        if text.startswith("cruiser gateway"):
            environment["CRUISER_ZENOH_LISTEN"] = self._endpoint
        elif "--listen" not in text:
            # The demo has a robot of the same name, on a network of its own.
            environment["CRUISER_ZENOH_CONNECT"] = free_endpoint() if text.startswith("make") else self._endpoint
        words = shlex.split(text) if not text.startswith("import ") else [sys.executable, "-c", SETTINGS + text]
        if words[0] == "make":
            # The recipe as it is in a checkout, without the installation.
            words += ["-f", str(ROOT / "Makefile"), "-o", ".venv/demo", f"BIN={self.home.parent / 'bin'}"]
        return Terminal([*self._become, *words], self.home, environment)


@pytest.fixture
def newcomer() -> Iterator[Newcomer]:
    """In an empty home; the command is on the path, as after an installation."""
    # Not below pytest's own directory, which is its user's alone.
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        place.chmod(0o755)
        home = place / "home"
        home.mkdir()
        install(place / "bin")
        if os.getuid() == 0:
            os.chown(home, NOBODY, NOBODY)
        one = Newcomer(home)
        try:
            yield one
        finally:
            one.kill_all()


@pytest.mark.long
@pytest.mark.timeout(800)
@pytest.mark.parametrize(
    ("pages", "leaves"),
    [
        (PAGES[:1], {"demo-log", "logs"}),
        by_night(PAGES, {"dataset", "demo-log", "logs", "report.html"}),
    ],
    ids=["README", "all"],
)
def test_the_commands_of_the_page_do_what_it_says(
    newcomer: Newcomer, pages: tuple[str, ...], leaves: set[str]
) -> None:
    """One after the other."""
    for name, text in commands(pages):
        match COMMANDS[name]:
            case Run() as what:
                newcomer.run(name, text, what)
            case Start() as what:
                newcomer.start(name, text, what)
    newcomer.end_all()
    assert {path.name for path in newcomer.home.iterdir()} >= leaves
