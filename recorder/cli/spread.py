"""The flags --processes and --ray: where the tasks of a question run. Only some questions have them."""

from __future__ import annotations

import argparse
import os
from typing import Final

from recorder.cli.asking import Asked
from recorder.review.tasks import TaskRunner
from schemas.arguments import whole_number

LITTLE_BYTES: Final = 4_000_000  # logs of fewer bytes in total are read faster than another process starts


def add_task_runner(parser: argparse.ArgumentParser) -> None:
    group = parser.add_mutually_exclusive_group()
    group.add_argument(
        "--processes",
        type=whole_number(1, 10_000),
        metavar="N",
        help="logs at a time, each in a process of its own (default: one a processor, or one for little)",
    )
    group.add_argument("--ray", metavar="ADDRESS", help="run on a Ray cluster: ray://HOST:PORT")


def task_runner(arguments: argparse.Namespace, asked: Asked) -> TaskRunner:
    """The runner that --processes and --ray choose."""
    most = len(os.sched_getaffinity(0)) if asked.bytes > LITTLE_BYTES else 1
    return TaskRunner(arguments.processes or most, arguments.ray or "")
