"""``cruiser review rerun``: the recorded frames and requests through today's arbiter."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Final

from recorder.cli.review.asking import Asked, add_logs, add_ray, end_with, find, progress_bar, table
from recorder.cli.show import show
from recorder.reading.rows import Progress
from recorder.reading.times import in_words
from recorder.review.rerun.counterfactual import (
    Journey,
    StopMade,
    StopMoved,
    WhatIfResult,
    what_if_logs,
)
from recorder.review.rerun.minutes import verdict_in_words
from recorder.review.rerun.parallel import SEGMENT_NS, rerun_in, rerun_in_parallel
from recorder.review.rerun.player import RerunResult
from recorder.review.rerun.tried_settings import TriedSettings
from recorder.review.tasks import ray_cluster
from schemas.command_rules import COMMAND_RULES, rules_notice
from schemas.exit_codes import CommandError, ExitCode
from schemas.printable import plain
from schemas.settings import Settings

EXAMPLE: Final = """\
  cruiser review rerun logs
  cruiser review rerun logs --set command.speed_limit_mps=1.2"""
DESCRIPTION: Final = (
    "Gives the arbiter of this version the recorded frames and requests again, at the recorded times. Decisions, "
    "events, states and sent frames must come out byte for byte; whatever differs is listed, with exit code 1. "
    "So it ends too for a run that was made under other command rules, and says so first. "
    "A run whose beginning is not in the log is run again from where the gateway was at rest; exit code 3 if a "
    "run is not all there. With --set or --with the run is shown as it would have been with other settings: "
    "decisions, distance and time, stops avoided, added or moved. A model of the chassis then answers what the "
    "recorded one was not asked; what people would have done otherwise nobody knows."
)

TOLD: Final = 20
"""Differences that are listed one by one, without --json."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags."""
    add_logs(parser, json_help="print a JSON object a line, one for each run of a gateway")
    add_tried_settings(parser)
    add_jobs(parser, "without --set and --with: run in N processes at once")
    add_ray(parser)


def add_tried_settings(parser: argparse.ArgumentParser) -> None:
    """--set and --with."""
    parser.add_argument(
        "--set", action="append", default=[], dest="changes", metavar="SETTING=VALUE", help="try another value"
    )
    parser.add_argument(
        "--with", type=Path, dest="file", metavar="FILE", help="try this whole configuration, a TOML file"
    )


def add_jobs(parser: argparse.ArgumentParser, words: str) -> None:
    """--jobs."""
    processors = len(os.sched_getaffinity(0))
    help_text = f"{words} (default: {processors}, the processors)"
    parser.add_argument("--jobs", type=whole_number, default=processors, metavar="N", help=help_text)


def tried_settings(arguments: argparse.Namespace) -> TriedSettings:
    """Return the settings that --set and --with ask for.

    Raises:
        CommandError: a file cannot be read, or a value is wrong.
    """
    changes = dict(map(_change, arguments.changes))
    text = None if arguments.file is None else _read(arguments.file)
    tried = TriedSettings(text, str(arguments.file), changes)
    if text is not None:
        # A wrong file or a wrong value is told before a long log is read.
        tried("")
    return tried


def run(arguments: argparse.Namespace, _settings: Settings, stopped: Callable[[], bool]) -> int:
    """Run again."""
    tried = tried_settings(arguments)
    if arguments.ray and not tried.is_own:
        raise CommandError("--ray is without --set and --with; regress has all of them", ExitCode.USAGE)
    asked = find(arguments)
    with progress_bar("running again", asked.bytes, stopped, prints=True, is_bounded=False) as progress:
        worst = ExitCode.OK
        runs = 0
        for result in _results(arguments, tried, asked, progress):
            runs += 1
            worst = max(worst, _outcome(result), key=_GRAVITY.index)
            show(result, describe(result), as_json=arguments.json)
            if stopped():
                break
    ending = ExitCode(end_with(asked.faults))
    if not runs:
        raise CommandError("there is no journal in it, so nothing can be run again", ExitCode.PARTIAL)
    return int(max(worst, ending, key=_GRAVITY.index))


def _results(
    arguments: argparse.Namespace, tried: TriedSettings, asked: Asked, progress: Progress
) -> Iterator[RerunResult | WhatIfResult]:
    if not tried.is_own:
        yield from what_if_logs(asked.logs, tried, asked.faults, progress=progress)
    elif arguments.ray:
        with ray_cluster(arguments.ray) as cluster:
            yield from rerun_in(cluster, asked.logs, asked.faults, SEGMENT_NS, progress)
    else:
        yield from rerun_in_parallel(asked.logs, asked.faults, arguments.jobs, progress=progress)


_GRAVITY: Final = (ExitCode.OK, ExitCode.PARTIAL, ExitCode.FAILURE)


def _outcome(result: RerunResult | WhatIfResult) -> ExitCode:
    if result.rules != COMMAND_RULES or (isinstance(result, RerunResult) and result.difference_count):
        return ExitCode.FAILURE
    return ExitCode.PARTIAL if result.detail else ExitCode.OK


def whole_number(text: str) -> int:
    """A number of at least 1, for argparse."""
    with suppress(ValueError):
        if (number := int(text)) > 0:
            return number
    raise argparse.ArgumentTypeError(f"{text!r} is no number of at least 1")


def _change(text: str) -> tuple[str, object]:
    key, equals, value = text.partition("=")
    if not equals:
        raise CommandError(f"--set {text!r}: give SETTING=VALUE, as command.speed_limit_mps=1.2", ExitCode.USAGE)
    return key.strip(), value.strip()


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        why = error.strerror or error
    except UnicodeDecodeError:
        why = "it is no UTF-8 text"
    raise CommandError(f"cannot read {plain(str(path))}: {why}", ExitCode.USAGE)


def describe(result: RerunResult | WhatIfResult) -> Iterator[str]:
    """Yield lines for people about a run; above them what to expect, if it was made under other rules."""
    if notice := rules_notice(result.rules):
        yield f"{result.robot}, run {result.run}: {notice}"
    yield _head(result)
    yield from _of_rerun(result) if isinstance(result, RerunResult) else _of_what_if(result)


def _of_rerun(result: RerunResult) -> Iterator[str]:
    if result.start_ns:
        same = ", ".join(f"{count} {subject}" for subject, count in result.same.items())
        yield f"  the same, byte for byte: {same or 'nothing'}"
        if result.unrecorded:
            lost = ", ".join(f"{count} {subject}" for subject, count in result.unrecorded.items())
            yield f"  not in the log, so not compared: {lost}"
        if result.given_up:
            yield f"  {result.given_up} messages found no counterpart in time, and were not compared"
        yield f"  different: {result.difference_count}"
    for difference in result.differences[:TOLD]:
        yield f"    {in_words(difference.time_ns)} {difference.subject}: {difference.what}"
        yield from (f"      {name}: {was!r}, now {now!r}" for name, (was, now) in difference.fields.items())
        if difference.message is not None:
            yield f"      {difference.message!r}"
    if result.difference_count > TOLD:
        yield f"    and {result.difference_count - TOLD} more"


def _of_what_if(result: WhatIfResult) -> Iterator[str]:
    yield from (f"  {name}: {was}, tried {tried}" for name, (was, tried) in result.settings.items())
    if not result.settings:
        yield "  the settings tried are those of the run"
    yield from table(
        ("", "distance/m", "moving/s", "top speed/mps", "stops"),
        [_journey("as recorded", result.recorded), _journey("as it would have been", result.other)],
        words=1,
    )
    yield from (f"  stop avoided: {_stop(stop)}" for stop in result.stops_avoided)
    yield from (f"  stop added: {_stop(stop)}" for stop in result.stops_added)
    yield from (f"  stop {_moved(one)}: {_stop(one.stop)}" for one in result.stops_moved)
    changed = sum(change.count for change in result.changes)
    yield f"  {changed} of {result.decisions} decisions would have been others"
    yield from (
        f"    {change.count} x {change.request} of {change.operator}: {verdict_in_words(change.recorded)}, then "
        f"{verdict_in_words(change.other)}, from {in_words(change.first_ns)} to {in_words(change.last_ns)}"
        for change in sorted(result.changes, key=lambda one: one.first_ns)
    )


def _head(result: RerunResult | WhatIfResult) -> str:
    head = f"{result.robot}, run {result.run}: {result.inputs} inputs"
    if result.first:
        head += f" from {result.first} on"
    if result.start_ns:
        seconds = (result.end_ns - result.start_ns) / 1e9
        head += f", {in_words(result.start_ns)} and {seconds:.1f} s on"
    return f"{head}; {result.detail}" if result.detail else head


def _journey(name: str, journey: Journey) -> tuple[str, ...]:
    numbers = (journey.distance_m, journey.moving_s, journey.top_speed_mps)
    return name, *(f"{number:.2f}" for number in numbers), str(len(journey.stops))


def _stop(stop: StopMade) -> str:
    operator = f", {stop.operator}" if stop.operator else ""
    return f"{in_words(stop.time_ns)} {stop.reason}{operator}: {stop.text}"


def _moved(moved: StopMoved) -> str:
    seconds = (moved.other_ns - moved.stop.time_ns) / 1e9
    return f"{abs(seconds):.2f} s {'later' if seconds > 0 else 'sooner'}"
