"""``cruiser review export``: logs in other forms."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import msgspec

from recorder.cli.asking import Asked, add_logs, add_period, end_with, find, progress_bar
from recorder.cli.show import show
from recorder.cli.spread import add_task_runner, task_runner
from recorder.reading.rows import Progress, Selection
from schemas.command_line import CommandError, ExitCode, needing_extra, plain
from schemas.settings import Settings

EXAMPLE: Final = """  cruiser review export -o dataset logs
  cruiser review export --format csv --topic 'chassis/*' -o tables logs
  cruiser review export --format ros2 -o bag log.mcap
  cruiser review export --format candump -o frames logs"""
DESCRIPTION: Final = (
    "Writes logs as a dataset of Parquet files (by topic, robot and date, with a manifest), as CSV, one file a "
    "topic, as a rosbag2 directory for ROS 2, or their raw frames as candump log, ASC or BLF, one file a robot. "
    "No file is overwritten. Exit code 3 if not all of a log could be read."
)

PARQUET: Final = "parquet"
ROS2: Final = "ros2"
FRAMES: Final = ("candump", "asc", "blf")
_SCHEME: Final = re.compile("[a-z][a-z0-9+.-]+:/")  # a network address as a path: ``s3:/bucket``


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_logs(parser, json_help="print what was written as JSON, an object a line")
    parser.add_argument("-o", "--out", type=Path, required=True, metavar="DIR", help="output directory")
    forms = (PARQUET, "csv", ROS2, *FRAMES)
    parser.add_argument("--format", choices=forms, default=PARQUET, help=f"default {PARQUET}")
    parser.add_argument(
        "--topic",
        action="append",
        default=[],
        metavar="PATTERN",
        help="only these topics, by their full names or without root and robot; may be repeated",
    )
    add_task_runner(parser)
    add_period(parser)


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    if arguments.format != PARQUET and (arguments.ray or arguments.processes):
        raise CommandError("--processes and --ray need --format parquet", ExitCode.USAGE)
    if _SCHEME.match(str(arguments.out)):
        raise CommandError(
            f"{plain(str(arguments.out))} is no directory: export to one, and copy it with the store's own tool "
            "(aws s3 sync, gsutil rsync, rclone)",
            ExitCode.USAGE,
        )
    asked = find(arguments, settings, stopped)
    # A cluster may have to start first.
    is_bounded = not arguments.ray
    with needing_extra(), progress_bar("exporting", asked.bytes, stopped, is_bounded=is_bounded) as progress:
        written = _EXPORTS[arguments.format](arguments, asked, progress)
    if not written:
        sys.stderr.write("cruiser review: nothing to write\n")
    for one in written:
        show(one, [describe(one)], as_json=arguments.json)
    return end_with(asked.faults)


def describe(one: Any) -> str:  # noqa: ANN401 - of modules that are imported late
    """A line for people about a file or a dataset."""
    about = msgspec.to_builtins(one)
    if "messages" in about:
        return f"{about['directory']}: {about['messages']} messages on {len(about['topics'])} topics"
    if "frames" in about:
        late = f", {about['late']} of them out of order" if about["late"] else ""
        return f"{about['path']}: {about['frames']} frames{late}"
    if "topic" in about:
        return f"{about['path']}: {about['rows']} rows"
    rows = sum(one["rows"] for one in about["inputs"])
    size = sum(part["bytes"] for part in about["files"])
    return f"{about['directory']}: {rows} rows in {len(about['files'])} files, {size / 1e6:.1f} MB"


def _dataset(arguments: argparse.Namespace, asked: Asked, progress: Progress) -> Sequence[Any]:
    from recorder.review import export  # noqa: PLC0415 - its libraries are an extra

    wanted = export.ExportRange(arguments.topic, asked.from_ns, asked.to_ns)
    runner = task_runner(arguments, asked)
    return [export.export_dataset(asked.logs, arguments.out, wanted, asked.faults, run=runner, progress=progress)]


def _csv(arguments: argparse.Namespace, asked: Asked, progress: Progress) -> Sequence[Any]:
    from recorder.review import export  # noqa: PLC0415 - its libraries are an extra

    wanted = export.ExportRange(arguments.topic, asked.from_ns, asked.to_ns)
    return export.export_csv(asked.logs, arguments.out, wanted, asked.faults, progress)


def _frames(arguments: argparse.Namespace, asked: Asked, progress: Progress) -> Sequence[Any]:
    from recorder.reading.rows import wants_of  # noqa: PLC0415
    from recorder.review.raw_frames import read_frames, write_frames  # noqa: PLC0415 - python-can takes a while

    out: Path = arguments.out
    selection = Selection(wants_of(arguments.topic), asked.from_ns, asked.to_ns)
    try:
        out.mkdir(parents=True, exist_ok=True)
        frames = read_frames(asked.logs, selection, asked.faults, progress)
        return write_frames(frames, out, arguments.format)
    except OSError as error:
        raise CommandError(f"cannot write {plain(str(out))}: {error.strerror or error}") from error


def _bag(arguments: argparse.Namespace, asked: Asked, progress: Progress) -> Sequence[Any]:
    from recorder.reading.rows import wants_of  # noqa: PLC0415 - as below
    from recorder.review.rosbag import export_bag  # noqa: PLC0415 - nobody else needs ROS

    selection = Selection(wants_of(arguments.topic), asked.from_ns, asked.to_ns)
    bag = export_bag(asked.logs, arguments.out, selection, asked.faults, progress)
    return [] if bag is None else [bag]


_EXPORTS: Final[dict[str, Callable[[argparse.Namespace, Asked, Progress], Sequence[Any]]]] = {
    PARQUET: _dataset,
    "csv": _csv,
    ROS2: _bag,
    **dict.fromkeys(FRAMES, _frames),
}
