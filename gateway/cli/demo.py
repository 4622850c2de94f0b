"""``cruiser demo``: chassis, gateway, recorder and two operators together, then what happened and was logged."""

from __future__ import annotations

import argparse
import json
import re
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Final

import msgspec
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from gateway.cli.child import Child
from gateway.cli.demo_drive import DemoDrive, TimelineEntry
from gateway.sim.links import LINKS
from schemas.exit_codes import CommandError, ExitCode
from schemas.settings import Settings

EXAMPLE = "  cruiser demo --seconds 40 --out demo-log"

SHORTEST_S: Final = 20.0
"""Stops, a reset, a stalled link and a second operator take their time."""

VIEWERS: Final = """\
open it with
  Foxglove or Lichtblick   "Open local file"; plot e.g. /{robot}/state.speed_mps
  PlotJuggler              drag the file into the window
  rerun                    rerun {path}
  mcap command             mcap info {path}"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags of ``cruiser demo``."""
    parser.add_argument(
        "--seconds", type=_seconds, default=30.0, metavar="N", help="about how long (default 30, at least 20)"
    )
    parser.add_argument(
        "--out", type=Path, default=Path("demo-log"), metavar="DIR", help="where the log goes (default demo-log)"
    )
    parser.add_argument(
        "--link",
        choices=[link.slug for link in LINKS],
        default=LINKS[0].slug,
        help="what the first operator's link is like (default %(default)s)",
    )
    parser.add_argument("--json", action="store_true", help="print the summary as JSON")


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    """Run the three, then say what was recorded."""
    recorded, timeline = _record(arguments, settings, stopped)
    path = Path(recorded["path"])
    info, check = _review("info", path), _review("check", path)
    summary = {
        "path": str(path),
        "incidents": [str(path.with_name(file)) for file in _incident_files(info)],
        "seconds": info["duration_s"],
        "frames": sum(row["frames"] for row in check["frames"]),
        "messages": info["messages"],
        "channels": len(info["channels"]),
        "bytes": info["bytes"],
        "frames_lost": check["frames_lost"],
        "samples_missed": check["missed"],
        "whole": check["whole"],
        "timeline": [msgspec.to_builtins(entry) for entry in timeline],
    }
    if arguments.json:
        sys.stdout.write(json.dumps(summary) + "\n")
    else:
        sys.stdout.write(describe(summary, f"{settings.robot.root}/{settings.robot.name}"))
    nothing_lost = summary["whole"] and not summary["frames_lost"] and not summary["samples_missed"]
    return int(ExitCode.OK if nothing_lost and summary["frames"] else ExitCode.FAILURE)


def describe(summary: dict[str, Any], robot: str) -> str:
    """The summary, for people."""
    timeline = "".join(
        f"{entry['at_s']:6.1f} s  {entry['who']:<15}  {entry['what']}\n" for entry in summary["timeline"]
    )
    return (
        f"{timeline}{summary['frames']} CAN frames in {summary['seconds']:.1f} s, {summary['frames_lost']} lost "
        "(by the alive counters in the log)\n"
        f"{summary['messages']} messages on {summary['channels']} channels, {summary['samples_missed']} missed, "
        f"{summary['bytes']} bytes\n"
        f"log: {summary['path']}\n"
        + "".join(f"incident: {path}\n" for path in summary["incidents"])
        + VIEWERS.format(path=summary["path"], robot=robot)
        + "\n"
    )


def _incident_files(info: dict[str, Any]) -> list[str]:
    """The file that keeps what came before and after an incident, as the log names it."""
    return [info["incident"]["file"]] if info["incident"] else []


def _seconds(text: str) -> float:
    seconds = float(text)
    if not SHORTEST_S <= seconds <= 86_400:
        raise argparse.ArgumentTypeError(f"must be from {SHORTEST_S:g} to 86400")
    return seconds


def _record(
    arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]
) -> tuple[dict[str, Any], list[TimelineEntry]]:
    """Run chassis, gateway, recorder and operators. Returns what the recorder says of its log, and what happened.

    All three read the configuration that the demo was given; only where they find each other is the demo's own.
    """
    robot = settings.robot
    endpoint = f"tcp/127.0.0.1:{_free_port()}"
    configuration = [] if arguments.config is None else ["--config", arguments.config]
    with ExitStack() as stack:
        chassis = stack.enter_context(Child("sim", [*configuration, "--listen", "127.0.0.1:0"]))
        ready = re.search(r" on (127\.0\.0\.1:\d+)", chassis.wait_ready())
        if ready is None:
            raise CommandError("the virtual chassis does not say where it is")
        bus = ["--interface", "socketcand", "--channel", ready[1]]
        # A stop by the guard in another run must not latch the demo's robot, nor the other way round.
        words = [*configuration, *bus, "--listen", endpoint]
        gateway = stack.enter_context(Child("gateway", words, CRUISER_GATEWAY_STATE_DIR=""))
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
        link = next(link for link in LINKS if link.slug == arguments.link)
        drive = DemoDrive(settings, endpoint.removeprefix("tcp/"), chassis.type, link)
        timeline = _drive(arguments.seconds, drive, [chassis, gateway, recorder], stopped)
        # The recorder ends first: what it has not heard by then was not meant for the log.
        result: dict[str, Any] = json.loads(recorder.end())
        gateway.end()
        chassis.end()
    return result, timeline


def _drive(
    seconds: float, drive: DemoDrive, children: Sequence[Child], stopped: Callable[[], bool]
) -> list[TimelineEntry]:
    """Let the operators drive on a thread of their own, and show how far they are."""
    columns = (TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn())
    begin_s = time.monotonic()
    with (
        ThreadPoolExecutor(1, "operators") as pool,
        Progress(
            *columns, console=Console(stderr=True), transient=True, redirect_stdout=False, redirect_stderr=False
        ) as progress,
    ):
        driven = pool.submit(drive.run, seconds, stopped)
        task = progress.add_task("chassis, gateway, recorder, operators", total=seconds)
        while not driven.done():
            progress.update(task, completed=min(time.monotonic() - begin_s, seconds))
            for child in children:
                child.check()
            time.sleep(0.1)
    return driven.result()


def _review(question: str, path: Path) -> dict[str, Any]:
    """What a question to the log is answered; that something is wrong or missing is an answer too."""
    command = [sys.executable, "-m", "gateway", "review", question, "--json", str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)  # noqa: S603 - our own command
    if not done.stdout:
        raise CommandError(f"the log cannot be read: {done.stderr.strip()}")
    answer: dict[str, Any] = json.loads(done.stdout)
    return answer


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port
