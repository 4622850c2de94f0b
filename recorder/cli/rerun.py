"""``cruiser review rerun``: the recorded frames and requests through this version's arbiter."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Final

from recorder.cli.asking import add_logs, end_with, find, progress_bar, worst
from recorder.cli.show import show
from recorder.cli.spread import add_task_runner, task_runner
from recorder.reading.times import in_words
from recorder.review.rerun import RerunResult
from recorder.review.what_if import (
    Journey,
    RerunTask,
    StopMade,
    TriedSettings,
    WhatIfResult,
    rerun_tasks,
    run_task,
)
from schemas.command_line import CommandError, ExitCode, plain
from schemas.journal import COMMAND_RULES, rules_notice
from schemas.settings import Settings

EXAMPLE: Final = """\
  cruiser review rerun logs
  cruiser review rerun logs --set command.speed_limit_mps=1.2"""
DESCRIPTION: Final = (
    "Gives this version's arbiter the recorded frames and requests again, at the recorded times. Decisions, "
    "events, states and sent frames must be equal byte for byte; differences are listed, with exit code 1, "
    "which is also the code of a run made under other command rules. A run whose beginning is missing is rerun "
    "from a point where the gateway was at rest; exit code 3 if a run is incomplete. With --set or --with, "
    "three lines summarise the differences: decisions, distance and time, stops avoided, added or moved. A "
    "model of the chassis then answers commands that differ from the recorded ones; operators' requests stay as "
    "recorded. For several logs, the last line counts those that decide otherwise."
)

DIFFERENCES_SHOWN: Final = 20  # differences that are listed without --json


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_logs(parser, json_help="print a JSON object a line, one for each run of a gateway")
    parser.add_argument(
        "--set", action="append", default=[], dest="changes", metavar="SETTING=VALUE", help="try another value"
    )
    parser.add_argument(
        "--with", type=Path, dest="file", metavar="FILE", help="try this whole configuration, a TOML file"
    )
    add_task_runner(parser)


def _tried_settings(arguments: argparse.Namespace) -> TriedSettings:
    changes = dict(map(_change, arguments.changes))
    text = None if arguments.file is None else _read(arguments.file)
    tried = TriedSettings(text, str(arguments.file), changes)
    if text is not None:
        # Report a wrong file or value before a long log is read.
        tried("")
    return tried


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    tried = _tried_settings(arguments)
    asked = find(arguments, settings, stopped)
    logs, otherwise, codes = 0, list[str](), list[int]()
    with progress_bar("running again", asked.bytes, stopped, prints=True, is_bounded=False) as progress:
        tasks = rerun_tasks(asked.logs, tried, asked.faults)
        outcomes = task_runner(arguments, asked)(run_task, tasks, progress)
        for task, outcome in zip(tasks, outcomes, strict=True):
            asked.faults.add_all(outcome.faults)
            for result in outcome.results:
                codes.append(_outcome(result))
                show(result, _describe(result), as_json=arguments.json)
            logs += bool(outcome.results)
            found = [result.differs_ns for result in outcome.results if result.differs_ns is not None]
            otherwise += [_place(task, min(found))] if found else []
    if logs > 1 and not arguments.json:
        first = f", the first: {otherwise[0]}" if otherwise else ""
        sys.stdout.write(f"{len(otherwise)} of {logs} logs decide otherwise{first}\n")
    codes.append(end_with(asked.faults))
    if not logs:
        raise CommandError("the logs hold no journal, so nothing can be rerun", ExitCode.PARTIAL)
    return worst(codes)


def _place(task: RerunTask, time_ns: int) -> str:
    """The file of a log with a moment, and the moment."""
    files = [log for log in task.logs if log.start_ns <= time_ns <= log.end_ns]
    return f"{plain((files or task.logs)[0].name)}, {in_words(time_ns)}"


def _outcome(result: RerunResult | WhatIfResult) -> ExitCode:
    if result.rules != COMMAND_RULES or (isinstance(result, RerunResult) and result.difference_count):
        return ExitCode.FAILURE
    return ExitCode.PARTIAL if result.detail else ExitCode.OK


def _change(text: str) -> tuple[str, object]:
    key, equals, value = text.partition("=")
    if not equals:
        raise CommandError(f"--set {text!r}: use SETTING=VALUE, as command.speed_limit_mps=1.2", ExitCode.USAGE)
    return key.strip(), value.strip()


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        why = error.strerror or error
    except UnicodeDecodeError:
        why = "it is no UTF-8 text"
    raise CommandError(f"cannot read {plain(str(path))}: {why}", ExitCode.USAGE)


def _describe(result: RerunResult | WhatIfResult) -> Iterator[str]:
    if notice := rules_notice(result.rules):
        yield f"{result.robot}, run {result.run}: {notice}"
    yield _head(result)
    yield from _of_rerun(result) if isinstance(result, RerunResult) else _of_what_if(result)


def _of_rerun(result: RerunResult) -> Iterator[str]:
    if result.start_ns:
        same = ", ".join(f"{count} {subject}" for subject, count in result.same.items())
        yield f"  equal byte for byte: {same or 'nothing'}"
        if result.unrecorded:
            lost = ", ".join(f"{count} {subject}" for subject, count in result.unrecorded.items())
            yield f"  not in the log, so not compared: {lost}"
        if result.given_up:
            yield f"  {result.given_up} messages had no counterpart in time, and were not compared"
        if result.reworded:
            yield f"  {result.reworded} messages differ only in their wording"
        yield f"  different: {result.difference_count}"
    for difference in result.differences[:DIFFERENCES_SHOWN]:
        yield f"    {in_words(difference.time_ns)} {difference.subject}: {difference.what}"
        yield from (f"      {name}: {was!r}, now {now!r}" for name, (was, now) in difference.fields.items())
        if difference.message is not None:
            yield f"      {difference.message!r}"
    if result.difference_count > DIFFERENCES_SHOWN:
        yield f"    and {result.difference_count - DIFFERENCES_SHOWN} more"


def _of_what_if(result: WhatIfResult) -> Iterator[str]:
    """The differences in three lines; ``--json`` has all of them."""
    tried = ", ".join(f"{name} {tried} instead of {was}" for name, (was, tried) in result.settings.items())
    changes = sorted(result.changes, key=lambda one: one.first_ns)
    first = "".join(
        f", from {in_words(one.first_ns)} on: {one.request} of {one.operator} {one.other}"
        f"; recorded: {one.recorded}"
        for one in changes[:1]
    )
    count = sum(change.count for change in changes)
    yield f"  with {tried or 'the same settings'}: {count} of {result.decisions} decisions differ{first}"
    yield f"  {_way(result.other)}; recorded: {_way(result.recorded)}"
    moved = [one.stop for one in result.stops_moved]
    stops = {"avoided": result.stops_avoided, "added": result.stops_added, "moved": moved}
    yield f"  stops: {'; '.join(_stops(word, found) for word, found in stops.items() if found) or 'the same'}"


def _head(result: RerunResult | WhatIfResult) -> str:
    head = f"{result.robot}, run {result.run}: {result.inputs} inputs"
    if result.first:
        head += f" from {result.first} on"
    if result.start_ns:
        seconds = (result.end_ns - result.start_ns) / 1e9
        head += f", {in_words(result.start_ns)} and {seconds:.1f} s on"
    return f"{head}; {result.detail}" if result.detail else head


def _way(journey: Journey) -> str:
    return (
        f"{journey.distance_m:.2f} m in {journey.moving_s:.2f} s, at most {journey.top_speed_mps:.2f} m/s, "
        f"{len(journey.stops)} stops"
    )


def _stops(word: str, stops: Sequence[StopMade]) -> str:
    return f"{len(stops)} {word}, the first at {in_words(stops[0].time_ns)} ({stops[0].reason})"
