"""``cruiser view``: robots live in Foxglove and Lichtblick. It commands nothing."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Final

from recorder.layouts.attached import RobotKeys, layouts
from recorder.zenoh.source import ZenohSource
from schemas import keys
from schemas.arguments import add_zenoh_arguments, ending_after, robot_name, seconds
from schemas.command_line import (
    CommandError,
    ExitCode,
    add_certificate_arguments,
    address,
    certificate_files,
    needing_extra,
    plain,
)
from schemas.settings import Settings
from schemas.subjects import SUBJECTS, Pattern
from schemas.zenoh_session import place

if TYPE_CHECKING:
    from recorder.view import LiveChannels, ViewLoop

EXAMPLE: Final = """\
  cruiser view                                    all robots, at ws://127.0.0.1:8765
  cruiser view cruiser-1 --layouts layouts        one robot, and the layouts to import
  cruiser view --root replay                      what 'cruiser review replay' publishes"""

LISTEN: Final = ("127.0.0.1", 8765)  # the port that viewers propose

TIMEOUT_S: Final = 5.0

QUEUE_SAMPLES: Final = 1000  # samples of a subject that may wait; the oldest beyond it are dropped


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("robots", nargs="*", type=robot_name, metavar="ROBOT", help="the robots (default: all)")
    parser.add_argument(
        "--listen",
        type=address,
        default=LISTEN,
        metavar="ADDRESS:PORT",
        help=f"address for viewers (default {LISTEN[0]}:{LISTEN[1]}: this machine only); port 0: a free port",
    )
    add_certificate_arguments(parser)
    parser.add_argument(
        "--layouts",
        type=Path,
        metavar="DIRECTORY",
        help="write each robot's layouts to this directory; it is created if missing",
    )
    parser.add_argument(
        "--timeout",
        type=seconds,
        default=TIMEOUT_S,
        metavar="S",
        help=f"time to wait for the robots (default {TIMEOUT_S:g})",
    )
    parser.add_argument("--seconds", type=seconds, metavar="N", help="duration")
    add_zenoh_arguments(parser)


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    with needing_extra():
        from recorder.view import LiveChannels, ViewLoop, ViewServer  # noqa: PLC0415 - needs the extra 'live'
    host, port = arguments.listen
    certificate = certificate_files(arguments.certificate, arguments.certificate_key, host, "viewers")
    shown = ", ".join(arguments.robots) or "all robots"
    ends = ending_after(stopped, arguments.seconds, time.monotonic)
    wanted = expressions(settings.robot.root, arguments.robots)
    with (
        ViewServer(f"cruiser: {shown}", host, port, certificate) as server,
        closing(ZenohSource(settings.zenoh, wanted, QUEUE_SAMPLES)) as source,
    ):
        channels = LiveChannels(server, version("cruiser-gateway"))
        loop = ViewLoop(source, server, channels, partial(_write_layouts, arguments.layouts))
        where = place(settings.zenoh)
        _wait(loop, channels, source, arguments, where, ends)
        missing = ", ".join(sorted(set(arguments.robots) - channels.robots))
        _tell(f"{server.where}, {shown} at {where}{missing and f'; not there yet: {missing}'}")
        loop.run(ends)
    if channels.left_out:
        _tell(f"{channels.left_out} samples were too large to show")
    return int(ExitCode.OK)


def expressions(root: str, robots: Sequence[str]) -> list[str]:
    """The keys of all subjects of these robots, or of all robots; no wildcards that a router may deny people."""
    published = [subject.name.format(bus=keys.ALL) for subject in SUBJECTS if subject.pattern is Pattern.PUBLISHED]
    return [f"{root}/{robot}/{name}" for robot in robots or [keys.ALL] for name in published]


def _wait(
    loop: ViewLoop,
    channels: LiveChannels,
    source: ZenohSource,
    arguments: argparse.Namespace,
    place: str,
    ends: Callable[[], bool],
) -> None:
    """Wait for the named robots, or for any Zenoh node. Later robots are shown, too."""
    end_s = time.monotonic() + arguments.timeout
    wanted = set(arguments.robots)

    def is_there() -> bool:
        return wanted <= channels.robots if wanted else source.is_connected

    loop.run(lambda: is_there() or ends() or time.monotonic() >= end_s)
    if wanted & channels.robots or is_there() or ends():
        return
    missing = (
        f"no sample of {' or '.join(sorted(wanted))} received" if source.is_connected else "no Zenoh node answered"
    )
    cure = "; 'cruiser list' shows the robots" if source.is_connected else ""
    raise CommandError(f"{missing} within {arguments.timeout:g} s at {place}{cure}", ExitCode.UNREACHABLE)


def _write_layouts(directory: Path | None, robot: RobotKeys) -> None:
    """Write a robot's layouts as ``cruiser review layouts`` does; again when its bus becomes known."""
    if directory is None:
        return
    try:
        directory.mkdir(parents=True, exist_ok=True)
        for layout in layouts(robot):
            (directory / f"{robot.key.rpartition('/')[2]}.{layout.name}").write_bytes(layout.data)
    except OSError as error:
        raise CommandError(f"cannot write in {plain(str(directory))}: {error.strerror or error}") from error


def _tell(text: str) -> None:
    sys.stderr.write(f"view: {text}\n")
    sys.stderr.flush()
