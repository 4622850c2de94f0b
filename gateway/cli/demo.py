"""``cruiser demo``: chassis, gateway and recorder together, as three processes, then a summary of the log."""

from __future__ import annotations

import argparse
import json
import re
import socket
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from schemas.exit_codes import CommandError, ExitCode
from schemas.settings import RobotSettings, Settings

EXAMPLE = "  cruiser demo --seconds 20 --out demo-log"

READY_TIMEOUT_S: Final = 30.0
END_TIMEOUT_S: Final = 20.0
LINES_KEPT: Final = 50

HAND_DRIVE: Final = (
    (0.10, "transmitter remote"),
    (0.10, "sticks 0.8 0"),
    (0.25, "sticks 1.0 20"),
    (0.55, "sticks 1.0 -20"),
    (0.80, "bumper front on for 300ms"),
    (0.85, "sticks 0 0"),
    (0.95, "transmitter command"),
)
"""What happens to the chassis, by the share of the time: its hand transmitter drives it in a figure of eight.

The chassis does not stop at the bumper hit: stopping is the upper layer's duty, and the gateway only listens.
"""

VIEWERS: Final = """\
open it with
  Foxglove or Lichtblick   "Open local file"; plot e.g. /{robot}/state.speed_mps
  PlotJuggler              drag the file into the window
  rerun                    rerun {path}
  mcap command             mcap info {path}"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags of ``cruiser demo``."""
    parser.add_argument("--seconds", type=_seconds, default=10.0, metavar="N", help="how long (default 10)")
    parser.add_argument(
        "--out", type=Path, default=Path("demo-log"), metavar="DIR", help="where the log goes (default demo-log)"
    )
    parser.add_argument("--json", action="store_true", help="print the summary as JSON")


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    """Run the three, then say what was recorded."""
    recorded = _record(arguments, settings.robot, stopped)
    info = _review(Path(recorded["path"]))
    summary = {
        "path": recorded["path"],
        "seconds": info["duration_s"],
        "frames": sum(row["frames"] for row in info["frames"]),
        "messages": info["messages"],
        "channels": len(info["channels"]),
        "bytes": info["bytes"],
        "frames_lost": info["frames_lost"],
        "samples_missed": info["missed"],
        "whole": info["whole"],
    }
    if arguments.json:
        sys.stdout.write(json.dumps(summary) + "\n")
    else:
        sys.stdout.write(describe(summary, f"{settings.robot.root}/{settings.robot.name}"))
    nothing_lost = summary["whole"] and not summary["frames_lost"] and not summary["samples_missed"]
    return int(ExitCode.OK if nothing_lost and summary["frames"] else ExitCode.FAILURE)


def describe(summary: dict[str, Any], robot: str) -> str:
    """The summary, for people."""
    return (
        f"{summary['frames']} CAN frames in {summary['seconds']:.1f} s, {summary['frames_lost']} lost "
        "(by the alive counters in the log)\n"
        f"{summary['messages']} messages on {summary['channels']} channels, {summary['samples_missed']} missed, "
        f"{summary['bytes']} bytes\n"
        f"log: {summary['path']}\n" + VIEWERS.format(path=summary["path"], robot=robot) + "\n"
    )


def _seconds(text: str) -> float:
    seconds = float(text)
    if not 1 <= seconds <= 86_400:
        raise argparse.ArgumentTypeError("must be from 1 to 86400")
    return seconds


def _record(arguments: argparse.Namespace, robot: RobotSettings, stopped: Callable[[], bool]) -> dict[str, Any]:
    """Run chassis, gateway and recorder for the time. Returns what the recorder says of its log.

    All three read the configuration that the demo was given; only where they find each other is the demo's own.
    """
    endpoint = f"tcp/127.0.0.1:{_free_port()}"
    configuration = [] if arguments.config is None else ["--config", arguments.config]
    with ExitStack() as stack:
        chassis = stack.enter_context(Child("sim", [*configuration, "--listen", "127.0.0.1:0"]))
        ready = re.search(r" on (127\.0\.0\.1:\d+)", chassis.wait_ready())
        if ready is None:
            raise CommandError("the virtual chassis does not say where it is")
        bus = ["--interface", "socketcand", "--channel", ready[1]]
        gateway = stack.enter_context(Child("gateway", [*configuration, *bus, "--listen", endpoint]))
        gateway.wait_ready()
        recorder = stack.enter_context(
            Child(
                "record",
                [
                    *configuration,
                    *("-k", f"{robot.root}/{robot.name}/**", "-o", str(arguments.out)),
                    *("--connect", endpoint, "--json"),
                ],
            )
        )
        recorder.wait_ready()
        _drive(arguments.seconds, chassis, [chassis, gateway, recorder], stopped)
        # The recorder ends first: what it has not heard by then was not meant for the log.
        result: dict[str, Any] = json.loads(recorder.end())
        gateway.end()
        chassis.end()
    return result


def _drive(seconds: float, chassis: Child, children: Sequence[Child], stopped: Callable[[], bool]) -> None:
    """Let the time pass, with a progress bar, while the chassis is driven by hand."""
    to_come = deque(HAND_DRIVE)
    columns = (TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn())
    begin_s = time.monotonic()
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("chassis, gateway, recorder", total=seconds)
        while (elapsed_s := time.monotonic() - begin_s) < seconds and not stopped():
            progress.update(task, completed=elapsed_s)
            while to_come and elapsed_s >= to_come[0][0] * seconds:
                chassis.type(to_come.popleft()[1])
            for child in children:
                child.check()
            time.sleep(0.1)


def _review(path: Path) -> dict[str, Any]:
    command = [sys.executable, "-m", "gateway", "review", "info", "--json", str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)  # noqa: S603 - our own command
    if done.returncode not in {ExitCode.OK, ExitCode.PARTIAL}:
        raise CommandError(f"the log cannot be read: {done.stderr.strip()}")
    info: dict[str, Any] = json.loads(done.stdout)
    return info


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


class Child:
    """One of our own commands in a process of its own. It says that it is ready with its first line on stderr."""

    def __init__(self, name: str, words: Sequence[str]) -> None:
        self._name = name
        command = [sys.executable, "-m", "gateway", name, *words]
        self._process = subprocess.Popen(  # noqa: S603 - our own command
            # Ctrl-C is for the demo, which ends its children in their order.
            command,
            start_new_session=True,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self._said: deque[str] = deque(maxlen=LINES_KEPT)
        self._spoke = threading.Event()
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._process.poll() is None:
            self._process.kill()
        self._process.wait()
        self._thread.join()
        for stream in (self._process.stdin, self._process.stdout, self._process.stderr):
            if stream is not None:
                stream.close()

    def wait_ready(self) -> str:
        """Its first line.

        Raises:
            CommandError: it ended instead, or says nothing.
        """
        if not self._spoke.wait(READY_TIMEOUT_S):
            raise CommandError(f"{self._name} does not get ready")
        line = self._said[0] if self._said else ""
        if not line.startswith(f"{self._name}: "):
            self._process.wait()
            self._thread.join()
            self.check()
        return line

    def check(self) -> None:
        """Raise a CommandError if it has ended."""
        code = self._process.poll()
        if code is None:
            return
        self._thread.join()
        last = self._said[-1] if self._said else f"{self._name} ended with {code}"
        known = {exit_code.value for exit_code in ExitCode} - {ExitCode.OK.value}
        raise CommandError(last, ExitCode(code) if code in known else ExitCode.FAILURE)

    def type(self, line: str) -> None:
        """Type a line into it."""
        if self._process.stdin is not None:
            try:
                self._process.stdin.write(f"{line}\n")
                self._process.stdin.flush()
            except BrokenPipeError as error:
                raise CommandError(f"{self._name} has ended") from error

    def end(self) -> str:
        """Ask it to stop. Returns its stdout.

        Raises:
            CommandError: it ended before, or does not end.
        """
        self.check()
        self._process.terminate()
        try:
            # What it prints is short and waits in the pipe.
            self._process.wait(END_TIMEOUT_S)
            out = self._process.stdout.read() if self._process.stdout else ""
        except subprocess.TimeoutExpired as error:
            raise CommandError(f"{self._name} does not stop") from error
        if self._process.returncode != ExitCode.OK:
            self.check()
        return out

    def _listen(self) -> None:
        """Take what it says on stderr; its first line, or its end, is what others wait for."""
        for line in self._process.stderr or ():
            self._said.append(line.rstrip("\n"))
            self._spoke.set()
        self._spoke.set()
