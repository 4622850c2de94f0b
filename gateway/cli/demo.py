"""``cruiser demo``: chassis, gateway, recorder and two operators together, then what happened and was logged."""

from __future__ import annotations

import argparse
import json
import logging
import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Final

import msgspec

from gateway.cli import demo_desk
from gateway.cli.child import CRUISER, Child, address_of, free_port, fresh, load
from gateway.cli.demo_drive import HELD_UP, DemoDrive, TimelineEntry
from gateway.client.refusal import RobotError, Unreachable
from gateway.sim.links import LINKS
from schemas.arguments import seconds
from schemas.exit_codes import CommandError, ExitCode
from schemas.settings import Settings
from schemas.zenoh_link import ANY_LOCAL_PORT

EXAMPLE = """\
  cruiser demo --seconds 40 --out demo-log
  cruiser demo --desk
  cruiser demo --desk --robots 10 --patrol 3"""

OUT: Final = Path("demo-log")

SHORTEST_S: Final = 20.0
"""Stops, a reset, a stalled link and a second operator take their time."""

LONGEST_S: Final = 86_400

ATTEMPTS: Final = 10

VIEWERS: Final = """\
open it with
  Foxglove or Lichtblick   "Open local file"; plot e.g. "{robot}/state".speed_mps
  PlotJuggler              drag the file into the window
  rerun                    rerun {path}
  mcap command             mcap info {path}"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags of ``cruiser demo``."""
    parser.add_argument(
        "--seconds",
        type=seconds,
        metavar="N",
        help="about how long (default 30, at least 20); with --desk until Ctrl-C if left out",
    )
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help=f"where the log goes, or DIR-2 and so on if that holds something ({OUT}, or {demo_desk.OUT})",
    )
    parser.add_argument(
        "--link",
        choices=[link.slug for link in LINKS],
        default=LINKS[0].slug,
        help="what the first operator's link is like (default %(default)s)",
    )
    parser.add_argument("--json", action="store_true", help="print the summary as JSON")
    parser.add_argument(
        "--desk", action="store_true", help="instead: a virtual fleet and the desk, and the browser on it"
    )
    demo_desk.add_arguments(parser.add_argument_group("with --desk"))


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    """Run the demo that was asked for.

    Raises:
        CommandError: it is to be too short, or a part of it ends by itself.
    """
    if arguments.desk:
        return demo_desk.run(arguments, settings, stopped)
    arguments.seconds = 30.0 if arguments.seconds is None else arguments.seconds
    if not SHORTEST_S <= arguments.seconds <= LONGEST_S:
        raise CommandError(f"--seconds: must be from {SHORTEST_S:g} to {LONGEST_S:g}", ExitCode.USAGE)
    return _record_demo(arguments, settings, stopped)


def _record_demo(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    """Run the three, as often as a busy machine needs, then say what was recorded."""
    if arguments.log_level == "warning":
        # What the operators' library warns of is what is shown here, and the timeline has it.
        logging.getLogger("gateway.client").setLevel(logging.ERROR)
    directory = fresh(arguments.out or OUT)
    sys.stderr.write(
        f"demo: starts chassis, gateway and recorder; two operators drive for about {arguments.seconds:g} s; "
        f"the log goes to {directory}\n"
    )
    for attempt in range(1, ATTEMPTS + 1):
        timeline: list[TimelineEntry] = []

        def tell(entry: TimelineEntry, timeline: list[TimelineEntry] = timeline) -> None:
            timeline.append(entry)
            if not arguments.json:
                sys.stdout.write(f"{entry.at_s:6.1f} s  {entry.who:<15}  {entry.what}\n")
                sys.stdout.flush()

        path, problem = _record(arguments, settings, stopped, directory, tell)
        if problem is None:
            break
        if not _is_held_up(problem) or stopped():
            raise CommandError(f"{problem}. The log: {path}", problem.code)
        kept = fresh(directory.parent / f"{directory.name}-interrupted")
        directory.rename(kept)
        interrupted = f"{problem}. That happens on a busy machine: {load()}. The log until then is in {kept}"
        if attempt == ATTEMPTS:
            raise CommandError(f"interrupted {ATTEMPTS} times, at last: {interrupted}", problem.code)
        sys.stderr.write(f"demo: interrupted: {interrupted}. Once more, {attempt + 1} of {ATTEMPTS}\n")
    info, check = _review("info", path), _review("check", path)
    summary = {
        "path": str(path),
        "incidents": [str(path.with_name(one["file"])) for one in info["incidents"]],
        "seconds": info["duration_s"],
        "frames": sum(row["frames"] for row in check["frames"]),
        "messages": info["messages"],
        "channels": len(info["channels"]),
        "bytes": info["bytes"],
        "frames_lost": check["frames_lost"],
        "samples_missed": check["missed"],
        "whole": check["whole"],
        "timeline": [msgspec.to_builtins(entry) for entry in sorted(timeline, key=lambda entry: entry.at_s)],
    }
    if arguments.json:
        sys.stdout.write(json.dumps(summary) + "\n")
    else:
        sys.stdout.write(describe(summary, f"{settings.robot.root}/{settings.robot.name}"))
    # What is late on a busy machine counts as lost: the summary says so, and it is no failure of the demo.
    return int(ExitCode.OK if summary["whole"] and summary["frames"] else ExitCode.FAILURE)


def describe(summary: dict[str, Any], robot: str) -> str:
    """The summary, for people."""
    lost = summary["frames_lost"] or summary["samples_missed"]
    return (
        f"{summary['frames']} CAN frames in {summary['seconds']:.1f} s, {summary['frames_lost']} lost "
        "(by the alive counters in the log)\n"
        f"{summary['messages']} messages on {summary['channels']} channels, {summary['samples_missed']} missed, "
        f"{summary['bytes']} bytes\n"
        + (f"what is late counts as lost, and on a busy machine much is late: {load()}\n" if lost else "")
        + f"log: {summary['path']}\n"
        + "".join(f"incident: {path}\n" for path in summary["incidents"])
        + VIEWERS.format(path=summary["path"], robot=robot)
        + "\n"
    )


def _is_held_up(problem: CommandError) -> bool:
    """Report whether a busy machine explains the problem, so that another attempt may succeed."""
    return problem.reason in HELD_UP if isinstance(problem, RobotError) else isinstance(problem, Unreachable)


def _record(
    arguments: argparse.Namespace,
    settings: Settings,
    stopped: Callable[[], bool],
    directory: Path,
    tell: Callable[[TimelineEntry], None],
) -> tuple[Path, CommandError | None]:
    """Run chassis, gateway, recorder and operators. Returns the log, and what interrupted the drive.

    All three read the configuration that the demo was given; only where they find each other is the demo's own.
    """
    robot = settings.robot
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    configuration = [] if arguments.config is None else ["--config", arguments.config]
    with ExitStack() as stack:
        chassis = stack.enter_context(Child("sim", [*configuration, "--listen", "127.0.0.1:0"]))
        bus = ["--interface", "socketcand", "--channel", address_of(chassis)]
        # A stop by the guard in another run must not latch the demo's robot, nor the other way round.
        words = [*configuration, *bus, "--listen", endpoint]
        # The port after that of a free endpoint may be taken.
        own = {"CRUISER_GATEWAY_STATE_DIR": "", "CRUISER_ZENOH_COMMAND_LISTEN": ANY_LOCAL_PORT}
        gateway = stack.enter_context(Child("gateway", words, environment=os.environ | own))
        gateway.wait_ready()
        recorder = stack.enter_context(
            Child(
                "record",
                [
                    *configuration,
                    *("-k", f"{robot.root}/{robot.name}/**", "-o", str(directory)),
                    *("--connect", endpoint, "--json"),
                ],
            )
        )
        recorder.wait_ready()
        link = next(link for link in LINKS if link.slug == arguments.link)
        drive = DemoDrive(settings, endpoint.removeprefix("tcp/"), chassis.type, link, stopped)
        problem = _drive(arguments.seconds, drive, [chassis, gateway, recorder], tell)
        # The recorder ends first: what it has not heard by then was not meant for the log.
        result: dict[str, Any] = json.loads(recorder.end())
        gateway.end()
        chassis.end()
    return Path(result["path"] or directory), problem


def _drive(
    seconds: float,
    drive: DemoDrive,
    children: Sequence[Child],
    tell: Callable[[TimelineEntry], None],
) -> CommandError | None:
    """Let the operators drive on a thread of their own, and report events. Returns what interrupted them."""
    try:
        observer = drive.observe()
    except CommandError as error:
        return error
    with observer, ThreadPoolExecutor(1, "operators") as pool:
        driven = pool.submit(drive.run, observer, seconds)
        is_over = False
        while not is_over:
            # Once more after the end.
            is_over = driven.done()
            for entry in drive.take(observer):
                tell(entry)
            for child in children:
                child.check()
            time.sleep(0.1)
    problem = driven.exception()
    if problem is not None and not isinstance(problem, CommandError):
        raise problem
    return problem


def _review(question: str, path: Path) -> dict[str, Any]:
    """Return the answer to a question about the log; that something is wrong or missing is an answer too."""
    command = [*CRUISER, "review", question, "--json", str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)  # noqa: S603 - our own command
    if not done.stdout:
        raise CommandError(f"the log cannot be read: {done.stderr.strip()}")
    answer: dict[str, Any] = json.loads(done.stdout)
    return answer
