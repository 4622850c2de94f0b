"""``cruiser review cut``: a part of a log, as a log."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

from recorder.cli.asking import JSON_HELP, add_period, end_with, find, log_place, progress_bar
from recorder.cli.show import show
from recorder.reading.times import in_words
from recorder.review.cut import CutLog, cut
from schemas.command_line import CommandError, ExitCode
from schemas.settings import Settings

EXAMPLE: Final = (
    "  cruiser review cut log.mcap --from 03:04:05 --to 03:05:00 -o part.mcap\n"
    "  cruiser review cut log.mcap --from -60 --topic '*/safety/*' --topic '*/state' -o part.mcap"
)
DESCRIPTION: Final = (
    "Writes a part of a log into a new one: the messages of a period, by their log times, and of some topics, "
    "with schemas, all metadata and all attachments. No file is overwritten. Exit code 2 if no message matches, "
    "3 if something could not be read; the rest is in the new file. It takes one file; 'mcap merge' joins "
    "several."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("logs", nargs=1, type=log_place, metavar="LOG", help="a file")
    parser.add_argument("--json", action="store_true", help=JSON_HELP)
    add_period(parser)
    parser.add_argument(
        "--topic",
        action="append",
        default=[],
        metavar="GLOB",
        help="topics, as a shell's patterns; * matches any part of one; may be given several times (default: all)",
    )
    parser.add_argument("-o", "--out", type=Path, required=True, metavar="FILE", help="the new file")


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    asked = find(arguments, settings, stopped)
    if len(asked.logs) > 1:
        raise CommandError(f"it takes one file, and {arguments.logs[0]} has {len(asked.logs)}", ExitCode.USAGE)
    [log] = asked.logs
    with progress_bar("cutting", asked.bytes, stopped) as progress:
        try:
            part = cut(log, arguments.out, asked.selection, arguments.topic, asked.faults, progress)
        except CommandError:
            # A read fault may be the cause.
            end_with(asked.faults)
            raise
    show(part, _lines(part), as_json=arguments.json)
    return end_with(asked.faults)


def _lines(part: CutLog) -> Iterator[str]:
    yield f"{part.path}: {part.messages} messages on {part.channels} channels, {part.bytes} bytes"
    if part.start_ns is not None and part.end_ns is not None:
        yield f"  {in_words(part.start_ns)} to {in_words(part.end_ns)}"
