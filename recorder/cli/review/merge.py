"""``cruiser review merge``: several logs in one."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

from recorder.cli.review.asking import add_logs, end_with, find, progress_bar
from recorder.cli.show import show
from recorder.reading.times import in_words
from recorder.review.joining.joining import Joined
from recorder.review.merge import merge
from schemas.settings import Settings

EXAMPLE: Final = "  cruiser review merge robot-logs depot-logs -o all.mcap"
DESCRIPTION: Final = (
    "Puts logs together into a new one, in the order of their log times: all messages, each once where several "
    "logs hold it (the same topic, publish time, sequence and data), all metadata and all attachments. Nothing is "
    "overwritten. Exit code 3 if something could not be read; the rest is in the new file."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags."""
    add_logs(parser)
    parser.add_argument("-o", "--out", type=Path, required=True, metavar="FILE", help="the new file")


def run(arguments: argparse.Namespace, _settings: Settings, stopped: Callable[[], bool]) -> int:
    """Merge."""
    asked = find(arguments)
    with progress_bar("merging", asked.bytes, stopped) as progress:
        joined = merge(asked.logs, arguments.out, asked.faults, progress)
    show(joined, describe(joined), as_json=arguments.json)
    return end_with(asked.faults)


def describe(joined: Joined) -> Iterator[str]:
    """Yield lines for people about a new file."""
    yield f"{joined.path}: {joined.messages} messages on {joined.channels} channels, {joined.bytes} bytes"
    if joined.start_ns is not None and joined.end_ns is not None:
        yield f"  {in_words(joined.start_ns)} to {in_words(joined.end_ns)}"
    if len(joined.sources) > 1:
        yield f"  of {len(joined.sources)} files; {joined.duplicates} messages were in them more than once"
