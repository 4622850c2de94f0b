"""``cruiser review cut``: a part of a log, as a log."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Final

from recorder.cli.review.asking import add_logs, add_period, end_with, find, progress_bar
from recorder.cli.review.merge import describe
from recorder.cli.show import show
from recorder.review.cut import cut
from schemas.exit_codes import CommandError
from schemas.settings import Settings

EXAMPLE: Final = (
    "  cruiser review cut logs --from 03:04:05 --to 03:05:00 -o part.mcap\n"
    "  cruiser review cut logs --from -60 --topics '*/safety/*' --topics '*/state' -o part.mcap"
)
DESCRIPTION: Final = (
    "Writes a part of logs into a new one: the messages of a time, by their log times, and of some topics, with "
    "schemas, all metadata and all attachments. Nothing is overwritten. Exit code 2 if nothing is of that time or "
    "of those topics, 3 if something could not be "
    "read; the rest is in the new file."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags."""
    add_logs(parser)
    add_period(parser)
    parser.add_argument(
        "--topics",
        action="append",
        default=[],
        metavar="GLOB",
        help="topics, as a shell's patterns; * matches any part of one; may be given several times (default: all)",
    )
    parser.add_argument("-o", "--out", type=Path, required=True, metavar="FILE", help="the new file")


def run(arguments: argparse.Namespace, _settings: Settings, stopped: Callable[[], bool]) -> int:
    """Cut."""
    asked = find(arguments)
    with progress_bar("cutting", asked.bytes, stopped) as progress:
        try:
            joined = cut(asked.logs, arguments.out, asked.selection, arguments.topics, asked.faults, progress)
        except CommandError:
            # What cannot be read may be why.
            end_with(asked.faults)
            raise
    show(joined, describe(joined), as_json=arguments.json)
    return end_with(asked.faults)
