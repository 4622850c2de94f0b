"""``cruiser review regress``: today's arbiter and settings against every minute of many logs."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from typing import Final

from recorder.cli.review.asking import add_logs, add_ray, end_with, find, progress_bar
from recorder.cli.review.rerun import add_jobs, add_tried_settings, describe, tried_settings, whole_number
from recorder.cli.show import show
from recorder.reading.times import in_words
from recorder.review.rerun.regress import NOT_IN_ITS_TURN, OtherwiseMinute, Regress, RegressSummary
from recorder.review.tasks import InThisProcess, processes, ray_cluster
from schemas.exit_codes import CommandError, ExitCode
from schemas.settings import Settings

EXAMPLE: Final = """\
  cruiser review regress logs                                     # does today's arbiter decide as it did?
  cruiser review regress logs --set command.deadman_s=0.2         # would it, with other settings?
  cruiser review regress logs --with /etc/cruiser/cruiser.toml --minutes 500 --json"""
DESCRIPTION: Final = (
    "Runs every minute of the logs again, each alone from its checkpoint or place of rest: with the settings of "
    "its run, compared with the log byte for byte; with --set or --with beside what it would have been. What is "
    "rare in the logs is run first, so --minutes and Ctrl-C leave the most telling part. Prints each minute that "
    "decides otherwise with what differs first, and how many were run, and were not, and why. Exit code 1 if some "
    "minute decides otherwise, 3 if not all could be read or run."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags."""
    add_logs(parser, json_help="print a JSON object a line, one for each minute that differs, then the sum")
    add_tried_settings(parser)
    parser.add_argument("--minutes", type=whole_number, metavar="N", help="run the N most novel minutes only")
    add_jobs(parser, "run in N processes at once")
    add_ray(parser)


def run(arguments: argparse.Namespace, _settings: Settings, stopped: Callable[[], bool]) -> int:
    """Run every minute."""
    tried = tried_settings(arguments)
    asked = find(arguments)
    is_whole = False
    regress = None
    try:
        with (
            progress_bar("running every minute again", asked.bytes, stopped, is_bounded=False) as progress,
            _pool(arguments) as (pool, jobs),
        ):
            regress = Regress(asked.logs, tried, asked.faults, pool, jobs, progress)
            regress.run(arguments.minutes)
            is_whole = True
    except KeyboardInterrupt:
        # What was run by then is the answer.
        if regress is None:
            raise
    summary = regress.summary
    if not summary.run and not summary.not_run:
        end_with(asked.faults)
        raise CommandError("there is no journal in it, so nothing can be run again", ExitCode.PARTIAL)
    for minute in regress.otherwise:
        show(minute, _describe(minute, arguments), as_json=arguments.json)
    show(summary, describe_sum(summary), as_json=arguments.json)
    ending = ExitCode(end_with(asked.faults))
    if summary.otherwise:
        return int(ExitCode.FAILURE)
    left_out = summary.not_run.keys() - ({NOT_IN_ITS_TURN} if is_whole else set())
    return int(ExitCode.PARTIAL if left_out else ending)


@contextmanager
def _pool(arguments: argparse.Namespace) -> Generator[tuple[Executor, int], None, None]:
    """Whoever runs the minutes, and how many at once."""
    if arguments.ray:
        with ray_cluster(arguments.ray) as cluster:
            yield cluster, cluster.processors
    elif arguments.jobs < 2:
        yield InThisProcess(), 1
    else:
        with processes(arguments.jobs) as pool:
            yield pool, arguments.jobs


def _describe(minute: OtherwiseMinute, arguments: argparse.Namespace) -> Iterator[str]:
    """Yield what differs first, where to ask why, and all that the other questions say of such a run."""
    run = minute.run
    yield from describe(run.result)
    if run.goes_on:
        yield "  run on from the minute before it, at whose end the robot would have been in another state"
    if run.first is not None:
        at = in_words(run.first.time_ns)
        yield f"  differs first: {at} {run.first.what}"
        yield f"    before: {run.first.before}"
        yield f"    after: {run.first.after}"
        logs = map(str, arguments.logs)
        yield "  " + shlex.join(["cruiser", "review", "why", *logs, "--robot", minute.robot, "--at", at])


def describe_sum(summary: RegressSummary) -> Iterator[str]:
    """Yield lines for people about how many minutes decide otherwise, and how many were not run, and why."""
    left_out = sum(summary.not_run.values())
    of = "minutes" if not left_out else "minutes that were run"
    yield f"{summary.otherwise:,} of {summary.run:,} {of} decide otherwise"
    if summary.other_rules:
        yield f"  {summary.other_rules:,} of them were made under other command rules: differences are expected"
    for reason, minutes in sorted(summary.not_run.items(), key=lambda one: -one[1]):
        yield f"  not run: {minutes:,} minutes: {reason}"
