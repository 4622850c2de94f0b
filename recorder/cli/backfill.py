"""``cruiser record backfill``: fill the holes of logs out of the logs of another recorder."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Final

import msgspec

from recorder.backfill.backfilling import fill_holes
from recorder.backfill.excerpt import LoggedBytes
from recorder.backfill.filling import Filled, Filling
from recorder.backfill.holes import HoleFinder, HoleKind
from recorder.cli.own_name import own_name
from recorder.cli.remote import order_proof
from recorder.cli.role import FETCHING, check_role
from recorder.cli.show import show
from recorder.disk.backfill_file import BackfillFiles
from recorder.disk.log_directory import safe_name
from recorder.disk.own_logs import OwnLogs
from recorder.reading.times import in_words
from recorder.zenoh.recorder_client import RecorderClient
from recorder.zenoh.session import key_matches
from schemas import keys
from schemas.arguments import add_zenoh_arguments, operator_name, recorder_name, robot_name, seconds
from schemas.exit_codes import CommandError, ExitCode
from schemas.operator_name import login_operator
from schemas.printable import plain
from schemas.settings import Settings

ABOUT: Final = "find what own logs lack, and fetch it from other recorders that have it"

EXAMPLE: Final = "  cruiser record backfill --connect tcp/10.0.0.5:7447 logs"

TIMEOUT_S: Final = 3.0
"""The time for which recorders are looked for."""

HOLES_SHOWN: Final = 200
"""Holes that are listed one by one; the rest are only counted."""

OTHERS_NAME: Final = "fleet"
"""Begins the name of a log of topics that are no known robot's."""


class Backfilled(msgspec.Struct, frozen=True):
    """The result of a backfill.

    Attributes:
        recorders: that answered.
        holes: the holes, and the messages that filled them.
        asked: messages that they sent; ``filled`` of them were missing.
        files: the logs of those.
        unread: logs that could not be read, or not wholly, and why.
        details: other remarks of the recorders.
    """

    recorders: list[str]
    holes: list[Filled]
    asked: int
    filled: int
    files: list[str]
    unread: list[str]
    details: list[str]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags."""
    parser.epilog = f"example:\n{EXAMPLE}"
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument(
        "logs", nargs="+", type=Path, metavar="LOG_OR_DIRECTORY", help="logs with holes; of a directory all logs"
    )
    parser.add_argument(
        "--recorder",
        type=recorder_name,
        default=None,
        metavar="NAME",
        help="whom to ask (every one that is there)",
    )
    parser.add_argument(
        "--robot", type=robot_name, default=None, metavar="NAME", help="whose holes (every robot's)"
    )
    parser.add_argument(
        "-k",
        "--key",
        dest="recorder.keys",
        metavar="KEY",
        action="append",
        help="a key expression that the logs' recorder records; may be repeated (all keys under the root)",
    )
    parser.add_argument("--dry-run", action="store_true", default=False, help="only tell the holes; ask nobody")
    parser.add_argument(
        "--operator", type=operator_name, default=None, metavar="NAME", help="who asks (the login name)"
    )
    parser.add_argument(
        "--timeout", type=seconds, default=TIMEOUT_S, metavar="S", help=f"how long to look ({TIMEOUT_S:g})"
    )
    add_zenoh_arguments(parser)
    parser.add_argument("--json", action="store_true", help="print the result as JSON")


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    """Find the holes, ask for what is missing, and write it beside the logs."""
    logs = OwnLogs(arguments.logs)
    if not logs.paths:
        raise CommandError(f"there is no log to fill: {plain('; '.join(logs.unread) or str(arguments.logs[0]))}")
    finder = HoleFinder()
    logs.each(finder.add)
    robots = {prefix: prefix.rpartition("/")[2] for prefix in finder.topics}
    holes = [hole for hole in finder.holes() if arguments.robot in {None, robots.get(_prefix(hole.topic, robots))}]
    expressions = settings.recorder.keys or [f"{settings.robot.root}/**"]
    filling = Filling(holes, lambda topic: any(key_matches(expression, topic) for expression in expressions))
    recorders: list[str] = []
    files: list[Path] = []
    details: list[str] = []
    if holes and not arguments.dry_run:
        logs.each(filling.hold)
        recorders, files, details = _ask(arguments, settings, stopped, logs, finder.topics, filling)
    result = Backfilled(
        recorders=recorders,
        holes=filling.results(),
        asked=filling.asked,
        filled=filling.written,
        files=list(map(str, files)),
        unread=logs.faults,
        details=details,
    )
    show(result, describe(result), as_json=arguments.json)
    return int(_code(result, was_asked=not arguments.dry_run))


def _ask(
    arguments: argparse.Namespace,
    settings: Settings,
    stopped: Callable[[], bool],
    logs: OwnLogs,
    topics: Mapping[str, set[str]],
    filling: Filling,
) -> tuple[list[str], list[Path], list[str]]:
    """Ask the other recorders, and write what is missing. Return who answered, the files, their other words."""
    check_role(settings.zenoh, FETCHING, "routers let recorders, operators and desks alone ask recorders")
    operator, proof = arguments.operator or login_operator(), order_proof(arguments, settings)
    library = f"cruiser-gateway {version('cruiser-gateway')}"
    with (
        closing(RecorderClient(settings.zenoh, settings.robot.root, operator, stopped, proof)) as client,
        closing(BackfillFiles(library)) as files,
    ):
        there = client.recorders(arguments.recorder or keys.ALL, arguments.timeout)
        directory = cache(logs.directory)

        def write(message: LoggedBytes, recorder: str) -> None:
            prefix = _prefix(message.channel.topic, topics)
            name = prefix.rpartition("/")[2] or OTHERS_NAME
            files.write(directory(f"{prefix}/"), safe_name(name), message, recorder)

        def learn() -> None:
            OwnLogs(files.parts()).each(filling.hold)

        others = _others(there, settings)
        recorders, details = fill_holes(filling, topics, others, client.backfill, write, learn, stopped)
        if not recorders and not stopped():
            raise CommandError(f"{plain(', '.join(there))} did not answer", ExitCode.UNREACHABLE)
        return recorders, files.finish(_about(recorders, filling)), details


def _others(names: Sequence[str], settings: Settings) -> list[str]:
    """The recorders without one's own, whose logs have the same holes; unless it is the only one."""
    own = own_name(settings)
    return [name for name in names if name != own] or list(names)


def _prefix(topic: str, prefixes: Iterable[str]) -> str:
    """Return the beginning of the keys of a topic's robot; empty if it is no known robot's."""
    return next((prefix for prefix in prefixes if topic.startswith(f"{prefix}/")), "")


def _about(recorders: Sequence[str], filling: Filling) -> dict[str, str]:
    """The metadata of the result."""
    results = filling.results()
    return {
        "recorders": ",".join(recorders),
        "holes": str(len(results)),
        "missing": str(sum(one.missing or 0 for one in results)),
        "asked_messages": str(filling.asked),
        "filled_messages": str(filling.written),
        "still_missing": str(sum(one.still_missing or 0 for one in results)),
        "unanswered_holes": str(sum(not one.is_answered for one in results)),
    }


def _code(result: Backfilled, *, was_asked: bool) -> ExitCode:
    if was_asked:
        is_fine = all(one.is_whole for one in result.holes)
    else:
        is_fine = not any(one.missing for one in result.holes)
    return ExitCode.OK if is_fine and not result.unread else ExitCode.PARTIAL


def describe(result: Backfilled) -> Iterator[str]:
    """Yield the result as lines for people."""
    yield from map(_describe_hole, result.holes[:HOLES_SHOWN])
    if len(result.holes) > HOLES_SHOWN:
        yield f"and {len(result.holes) - HOLES_SHOWN} more holes"
    still = sum(hole.still_missing or 0 for hole in result.holes)
    unanswered = sum(not hole.is_answered for hole in result.holes) if result.recorders else 0
    summary = f"{len(result.holes)} holes; {result.filled} messages filled, {still} samples still missing"
    if unanswered:
        summary += f", {unanswered} holes not wholly answered"
    yield summary
    yield from (f"not read: {text}" for text in result.unread)
    yield from (f"the recorder says: {text}" for text in result.details)
    yield from result.files


def _describe_hole(hole: Filled) -> str:
    length_s = (hole.to_ns - hole.from_ns) / 1e9
    missing = "an unknown number" if hole.missing is None else str(hole.missing)
    text = f"{hole.topic}  {in_words(hole.from_ns)}  {length_s:.3f} s  {_WHY[hole.kind]}: {missing} missing"
    still = "nothing known" if hole.still_missing is None else str(hole.still_missing)
    return f"{text}, {hole.filled} messages filled, {still} still missing"


_WHY: Final = {
    HoleKind.SEQUENCE: "gap",
    HoleKind.RESTART: "the gateway began anew",
    HoleKind.DROPPED: "dropped by the recorder",
    HoleKind.SILENCE: "silence",
}
