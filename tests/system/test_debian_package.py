"""The scripts of the Debian package never touch a robot that moves."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.system.recorder.upload.test_row import absent_on_robots

ROOT = Path(__file__).parents[2]
SCRIPTS = ROOT / "deploy" / "debian"
MOVES, FAILS = 5, 1
EXTRAS_ON_ROBOTS = ("obstore", "prometheus_client", "starlette", "uvicorn", "websockets")


class Machine:
    """A machine with the package, as its scripts see one: their paths lead into a directory."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.calls = root / "calls"
        self.calls.touch()
        for place in ("sys/class/net/can0", "sys/class/net/eth0", "run/systemd/system", "opt/cruiser/lib", "bin"):
            (root / place).mkdir(parents=True)
        (root / "sys/class/net/can0/type").write_text("280\n", "ascii")
        (root / "sys/class/net/eth0/type").write_text("1\n", "ascii")
        (root / "opt/cruiser/lib/early_stop.py").touch()
        self.program("find", "exit 0")
        self.set()

    def set(self, *, look: int = 0, status: str = "standby, bus up, guarded") -> None:
        """What a look at the bus finds, and the gateway's status; empty if it is dead."""
        self.program("python3", f"exit {look}")
        self.program(
            "systemctl",
            f'case "$1" in show) echo "{status}" ;; is-active) [ "$3" != cruiser-router.service ] ;; esac',
        )

    def program(self, name: str, text: str) -> None:
        path = self.root / "bin" / name
        path.write_text(f'#!/bin/sh\necho "{name} $*" >>"{self.calls}"\n{text}\n', "ascii")
        path.chmod(0o755)

    def run(self, script: str, *words: str) -> subprocess.CompletedProcess[str]:
        text = (SCRIPTS / script).read_text("utf-8")
        for place in ("/sys/class/net", "/run/", "/opt/cruiser"):
            text = text.replace(place, f"{self.root}{place}")
        return subprocess.run(
            ["/bin/sh", "-c", text, script, *words],
            env={"PATH": f"{self.root / 'bin'}:/usr/bin:/bin"},
            capture_output=True,
            text=True,
            check=False,
        )

    @property
    def stopped(self) -> list[str]:
        calls = self.calls.read_text("ascii").splitlines()
        return [call.removeprefix("systemctl stop ") for call in calls if call.startswith("systemctl stop ")]


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path)


@pytest.mark.parametrize("action", ["upgrade", "failed-upgrade", "remove", "deconfigure"])
@pytest.mark.parametrize(
    "state",
    [
        {"look": MOVES},
        {"look": MOVES, "status": ""},
        {"status": "engaged, bus up, guarded"},
        {"status": "stopping, no bus: gone, not guarded"},
    ],
    ids=lambda state: str(sorted(state)),
)
def test_while_the_robot_moves_nothing_is_changed(machine: Machine, action: str, state: dict[str, object]) -> None:
    """One clear line, whether the gateway lives or not, by the old script and the new."""
    machine.set(**state)  # type: ignore[arg-type] # each by its name
    done = machine.run("prerm", action, "1.0")
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1
    assert "Stop the robot, then try again" in done.stderr
    assert machine.stopped == []


def test_what_was_refused_is_not_done_a_moment_later(machine: Machine) -> None:
    """Dpkg asks the new package's script too, when the robot may stand. The next upgrade works."""
    machine.set(look=MOVES)
    assert machine.run("prerm", "upgrade", "1.0").returncode == 1
    machine.set()
    done = machine.run("prerm", "failed-upgrade", "0.9", "1.0")
    assert (done.returncode, done.stderr, machine.stopped) == (1, "", [])
    assert machine.run("prerm", "failed-upgrade", "0.9", "1.0").returncode == 0, "an old script that is broken"
    assert machine.stopped


@pytest.mark.parametrize(
    "state", [{}, {"status": ""}, {"look": FAILS}, {"status": "listening only, bus up"}], ids=str
)
def test_while_it_stands_the_services_are_stopped(machine: Machine, state: dict[str, object]) -> None:
    """Running ones, the gateway first; also where the look fails: a broken package can be replaced."""
    machine.set(**state)  # type: ignore[arg-type] # each by its name
    assert machine.run("prerm", "upgrade", "1.0").returncode == 0
    running = [f"cruiser-{name}.service" for name in ("gateway", "recorder", "desk", "metrics", "upload")]
    assert machine.stopped == running
    assert (machine.root / "run/cruiser-restart").read_text("ascii").split() == running
    assert "--look can0\n" in machine.calls.read_text("ascii")


def test_what_ran_is_started_again(machine: Machine) -> None:
    """Once, by the script of the package that came or stayed."""
    for name in ("systemd-sysusers", "systemd-tmpfiles", "udevadm"):
        machine.program(name, "exit 0")
    machine.run("prerm", "upgrade", "1.0")
    assert machine.run("postinst", "configure", "0.9").returncode == 0
    started = [call for call in machine.calls.read_text("ascii").splitlines() if "systemctl start" in call]
    running = [f"cruiser-{name}.service" for name in ("desk", "gateway", "metrics", "recorder", "upload")]
    assert started == [f"systemctl start {' '.join(running)}"]
    assert not (machine.root / "run/cruiser-restart").exists()
    machine.run("prerm", "remove")
    assert not (machine.root / "run/cruiser-restart").exists()


@pytest.mark.parametrize("script", sorted(SCRIPTS.iterdir()), ids=lambda path: path.name)
def test_a_shell_reads_each_script(script: Path) -> None:
    """Debian's own, not bash."""
    assert subprocess.run(["/bin/sh", "-n", script], check=False).returncode == 0


HELP = """
import sys
names, *words = sys.argv[1:]
sys.modules.update(dict.fromkeys(names.split()))
from gateway.cli.main import COMMANDS, main
from recorder.cli.review import QUESTIONS
for words in [[command] for command in COMMANDS] + [["review", question] for question in QUESTIONS]:
    try:
        code = main([*words, "--help"])
    except SystemExit as end:
        code = end.code
    except BaseException as error:
        code = repr(error)
    if code:
        print(*words, code, file=sys.stderr)
"""


def test_every_command_explains_itself_without_the_extras() -> None:
    """Also if it needs a library that is missing: the demo has no extra, a robot three of them."""
    words = [sys.executable, "-P", "-c", HELP, " ".join([*absent_on_robots(), *EXTRAS_ON_ROBOTS])]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
