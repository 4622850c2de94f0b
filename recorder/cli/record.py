"""``cruiser record``: write what is said on Zenoh into an MCAP log."""

from __future__ import annotations

import argparse
import re
import signal
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from importlib.metadata import version
from pathlib import Path
from types import FrameType
from typing import Final

import msgspec

from recorder.loop import Recorded, Recorder
from recorder.ports.leftovers import LeftoverThread
from recorder.ports.log_directory import LogDirectory
from recorder.ports.zenoh_source import RING_SAMPLES, ZenohSource
from recorder.session import Plan, Session
from schemas import keys
from schemas.arguments import add_zenoh_arguments, ending_after, seconds
from schemas.exit_codes import CommandError, ExitCode
from schemas.settings import Settings

EXAMPLE: Final = "  cruiser record -k 'fleet/cruiser-1/**' -o logs"

LEFTOVERS_S: Final = 5.0
"""How long the end waits for the recovery of logs that an earlier recorder left; the next start goes on."""

FLEET_NAME: Final = "fleet"
"""Begins the name of a log that may hold several robots."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags."""
    # It runs for hours, and who looks into its log wants to see links come and go.
    parser.set_defaults(log_level="info")
    parser.add_argument(
        "-k",
        "--key",
        dest="recorder.keys",
        metavar="KEY",
        nargs="+",
        action="extend",
        help="key expressions to record (all keys under the root)",
    )
    parser.add_argument("-o", "--out", dest="recorder.directory", metavar="DIR", help="where the log goes (.)")
    add_zenoh_arguments(parser)
    parser.add_argument("--seconds", type=seconds, metavar="N", help="stop after this long (at SIGINT or SIGTERM)")
    parser.add_argument("--json", action="store_true", help="print the result as JSON")


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    """Record until stopped; print the log's path."""
    recorder = settings.recorder
    expressions = recorder.keys or [f"{settings.robot.root}/**"]
    release = version("cruiser-gateway")
    directory = LogDirectory(Path(recorder.directory))
    session = Session(
        Plan(
            name=log_name(settings.robot.root, expressions),
            chunk_bytes=recorder.chunk_bytes,
            flush_ns=round(recorder.flush_s * 1e9),
            version=release,
            rotate_bytes=recorder.rotate_bytes,
            rotate_ns=round(recorder.rotate_s * 1e9),
        )
    )
    library = f"cruiser-gateway {release}"
    with closing(ZenohSource(settings.zenoh, expressions, RING_SAMPLES)) as source:
        sys.stderr.write(f"record: waiting for samples of {', '.join(expressions)} into {recorder.directory}\n")
        sys.stderr.flush()
        leftovers = LeftoverThread(Path(recorder.directory), library)
        recorded = Recorder(session, source, directory, library).run(
            ending_after(stopped, arguments.seconds, time.monotonic), hangups()
        )
    leftovers.wait(LEFTOVERS_S)
    return _report(recorded, as_json=arguments.json)


def hangups() -> Callable[[], bool]:
    """Whether SIGHUP has come since the last call: it begins a new file, as services take it."""
    came = False

    def handle(_number: int, _frame: FrameType | None) -> None:
        nonlocal came
        came = True

    def has_come() -> bool:
        nonlocal came
        before, came = came, False
        return before

    signal.signal(signal.SIGHUP, handle)
    return has_come


def log_name(root: str, expressions: Sequence[str]) -> str:
    """How the log's name begins: with the robot, if the expressions can match but one."""
    pattern = re.compile(rf"{re.escape(root)}/({keys.ROBOT_PATTERN})(/.*)?")
    matches = [pattern.fullmatch(expression) for expression in expressions]
    robots = {match[1] if match else FLEET_NAME for match in matches}
    return robots.pop() if len(robots) == 1 else FLEET_NAME


def _report(recorded: Recorded, *, as_json: bool) -> int:
    if as_json:
        sys.stdout.write(msgspec.json.encode(recorded).decode() + "\n")
    elif recorded.path is not None:
        sys.stdout.write(f"{recorded.path}\n")
    if recorded.path is None:
        if recorded.lost:
            raise CommandError(f"the disk took no log; {recorded.lost} messages are lost")
        raise CommandError("no sample came, so there is no log", ExitCode.UNREACHABLE)
    missed = sum(count.missed for count in recorded.keys.values())
    files = f", in {recorded.files} files" if recorded.files > 1 else ""
    lost = f"; the disk did not take {recorded.lost} messages" if recorded.lost else ""
    sys.stderr.write(
        f"record: {recorded.messages} messages on {recorded.channels} channels, {recorded.bytes} bytes, "
        f"{missed} samples missed{files}{lost}\n"
    )
    return int(ExitCode.PARTIAL if recorded.lost else ExitCode.OK)
