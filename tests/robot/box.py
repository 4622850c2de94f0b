"""The robot's computer in a box: user-mode Linux, an ordinary process group whose power can be cut."""

import itertools
import json
import os
import shutil
import signal
import subprocess
import time
from contextlib import suppress
from pathlib import Path
from typing import Final, Self

from tests.support.waiting import wait_until

MEMORY: Final = "1G"
UP_S: Final = 180.0
ENDS_S: Final = 60.0
COMMAND_S: Final = 180.0
READY: Final = "standby, bus up, guarded"


class Box:
    """The robot's computer, initially off; ``processor`` is the only one that it may use."""

    def __init__(self, image: Path, directory: Path, card: Path, processor: str) -> None:
        self.share = directory / "share"
        self._image = image
        self._group_file = directory / "box.pid"
        self._directory = directory
        self._card = card
        self._processor = processor
        self._process: subprocess.Popen[bytes] | None = None
        self._numbers = itertools.count()
        self._boots = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._process is not None:
            self.cut_power()

    @property
    def console(self) -> Path:
        return self._directory / f"console-{self._boots}"

    def boot(self) -> float:
        """Switch on, without waiting: see ``wait_up``. Returns the time, by time.monotonic()."""
        assert self._process is None
        self._boots += 1
        shutil.rmtree(self.share, ignore_errors=True)
        self.share.mkdir()
        wire = self._directory / "box.sock"
        wire.unlink(missing_ok=True)  # or the card is dead
        words = [
            *("nice", "-n", "-20", "taskset", "--cpu-list", self._processor, "linux.uml", f"mem={MEMORY}"),
            *(
                f"ubd0={self._image}",
                "root=/dev/ubda",
                "ro",
                "net.ifnames=0",
                f"uml_dir={self._directory / 'uml'}",
            ),
            *("umid=box", "con=null", "con0=null,fd:1", "con1=null", "ssl=null", f"box={self.share}"),
            f"vec0:transport=bess,dst={self._card},src={wire}",
        ]
        environment = {name: value for name, value in os.environ.items() if name != "TMPDIR"}
        environment["LD_PRELOAD"] = os.environ["ROBOT_XSTATE"]  # tests/socketcan/xstate.c says why
        if memory_forbids_execution():
            environment["TMPDIR"] = str(self._directory)
        begun_s = time.monotonic()
        with self.console.open("wb") as console:
            self._process = subprocess.Popen(
                words,
                stdin=subprocess.DEVNULL,
                stdout=console,
                stderr=subprocess.STDOUT,
                env=environment,
                start_new_session=True,
            )
        come_first(self._process.pid)
        # ``run`` ends what a test that was killed leaves.
        self._group_file.write_text(f"{self._process.pid}\n", "ascii")
        return begun_s

    def wait_up(self) -> None:
        process = self._process
        assert process is not None
        wait_until(lambda: (self.share / "up").exists() or process.poll() is not None, deadline_s=UP_S)
        assert process.poll() is None, self.console.read_text(errors="replace")[-3000:]

    def cut_power(self) -> float:
        """End all processes at once, as when the battery is pulled. Returns the time, by time.monotonic()."""
        assert self._process is not None
        os.killpg(self._process.pid, signal.SIGKILL)
        cut_s = time.monotonic()
        self._process.wait()
        self._forget()
        return cut_s

    def power_off(self) -> None:
        process = self._process
        assert process is not None
        self._put("systemctl poweroff")
        process.wait(ENDS_S)
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        self._forget()

    def run(self, command: str, *, check: bool = True, timeout_s: float = COMMAND_S) -> str:
        """Run a shell command as root and return its output. It delays all processes: not while it drives."""
        name = self._put(command)
        code = self.share / f"{name}.rc"
        wait_until(code.exists, deadline_s=timeout_s)
        printed = (self.share / f"{name}.out").read_text(encoding="utf-8", errors="replace")
        assert not check or int(code.read_text("ascii")) == 0, f"{command}: {printed}"
        return printed

    def wait_status(self, status: str = READY, deadline_s: float = 120.0) -> str:
        """Wait until the gateway's status begins with this text. Returns all of it."""
        command = f"""for i in $(seq {int(deadline_s)}); do
            status=$(systemctl show --property=StatusText --value cruiser-gateway)
            case $status in "{status}"*) echo "$status"; exit 0 ;; esac
            sleep 1
        done; echo "$status"; systemctl status cruiser-gateway
        journalctl -b -u cruiser-gateway | tail -40; df; exit 1"""
        return self.run(command, timeout_s=deadline_s * 3).strip()

    def journal(self, words: str) -> list[dict[str, str]]:
        # Without its text a field of bytes is a list.
        return [json.loads(line) for line in self.run(f"journalctl --output=json {words}").splitlines()]

    def fetch(self, inside: str) -> Path:
        """Copy a directory out of the box. Returns its copy."""
        target = self.share / f"copy-{next(self._numbers)}"
        target.mkdir()
        self.run(f"cp -r {inside}/. /run/box/{target.name}/")
        return target

    def _forget(self) -> None:
        self._process = None
        self._group_file.unlink()

    def _put(self, command: str) -> str:
        name = f"command-{next(self._numbers)}"
        new = self.share / f"{name}.new"
        new.write_text(command, encoding="utf-8")
        new.rename(self.share / f"{name}.sh")
        return name


def come_first(session: int) -> None:
    """Run a session's processes before others, where the kernel groups processes by session."""
    with suppress(OSError):
        Path(f"/proc/{session}/autogroup").write_text("-20", "ascii")


def memory_forbids_execution() -> bool:
    """Report whether /dev/shm, which user-mode Linux uses, is mounted noexec, as in many containers."""
    mounts = (line.split() for line in Path("/proc/mounts").read_text(encoding="utf-8").splitlines())
    return any(words[1] == "/dev/shm" and "noexec" in words[3].split(",") for words in mounts)  # noqa: S108
