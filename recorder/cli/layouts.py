"""``cruiser review layouts``: layouts of viewers for a log."""

from __future__ import annotations

import argparse
import errno
import sys
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from typing import Final

import msgspec

from recorder.cli.asking import add_logs, end_with, find
from recorder.cli.show import show
from recorder.layouts.attached import RobotKeys, layouts
from recorder.review.info import robots_of
from schemas.command_line import CommandError, how_to_get, plain, short
from schemas.settings import Settings

EXAMPLE: Final = "  cruiser review layouts logs -o layouts"
DESCRIPTION: Final = (
    "Writes layouts of Foxglove and Lichtblick (JSON), PlotJuggler (XML) and rerun (a blueprint) for each robot "
    "of the logs. A recorder also attaches the first two to each log. The blueprint needs rerun's package (extra "
    "'rerun')."
)


class Written(msgspec.Struct, frozen=True):
    """A written layout; ``robot`` is the beginning of its keys."""

    robot: str
    path: str


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_logs(parser, json_help="print a JSON object a line, one for each file written")
    parser.add_argument(
        "-o", "--out", type=Path, default=Path(), metavar="DIRECTORY", help="write there; made if it is missing"
    )


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    asked = find(arguments, settings, stopped)
    robots = robots_of(asked.logs, asked.faults)
    if not robots:
        end_with(asked.faults)
        raise CommandError("the logs hold no topic of a robot, so there is no layout to write")
    try:
        arguments.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CommandError(f"cannot write in {plain(str(arguments.out))}: {error.strerror or error}") from error
    written: list[Written] = []
    for robot in robots:
        try:
            written += _write(robot, _name_of(robot, robots), arguments.out)
        except OSError as error:
            failure = f"cannot write in {plain(str(arguments.out))}: {error.strerror or error}"
            if error.errno != errno.ENAMETOOLONG:
                raise CommandError(failure) from error
            # Too long a name affects only its robot.
            asked.faults.add(f"no layout of {short(plain(robot.key))}: {failure}")
    for one in written:
        show(one, [f"{one.robot}: {one.path}"], as_json=arguments.json)
    if written and not any(one.path.endswith(".rbl") for one in written):
        sys.stderr.write(f"cruiser review: no blueprint, which needs rerun{how_to_get('rerun')}\n")
    return end_with(asked.faults)


def _write(robot: RobotKeys, name: str, directory: Path) -> list[Written]:
    paths = []
    for layout in layouts(robot):
        path = directory / f"{name}.{layout.name}"
        path.write_bytes(layout.data)
        paths.append(path)
    try:
        blueprint = import_module("recorder.layouts.rerun_blueprint")
    except ImportError:
        pass  # Reported at the end: the others work without it.
    else:
        path = directory / f"{name}.{blueprint.NAME}"
        blueprint.save_blueprint(robot, name, path)
        paths.append(path)
    return [Written(robot.key, str(path)) for path in paths]


def _name_of(robot: RobotKeys, robots: Sequence[RobotKeys]) -> str:
    """The beginning of the files' names, with the root for robots of one name under several roots."""
    name = robot.key.rpartition("/")[2]
    is_only = sum(other.key.rpartition("/")[2] == name for other in robots) == 1
    return name if is_only else robot.key.replace("/", "-")
