"""``cruiser review report``: make an HTML page of a drive."""

from __future__ import annotations

import argparse
import os
import shlex
from collections.abc import Callable, Iterator, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import msgspec

from recorder.cli.asking import add_logs, add_period, end_with, find, progress_bar
from recorder.cli.show import show
from recorder.cli.why import chain_in_words
from recorder.reading.logs import Faults, LogFile
from recorder.reading.rows import Progress
from recorder.reading.survey import survey
from recorder.review.report.findings import Report, Why, summary_lines, verdict
from recorder.review.report.gather import read_report
from recorder.review.report.page import page
from recorder.review.why import Explainer
from schemas.command_line import CommandError, ExitCode, plain
from schemas.settings import Settings

EXAMPLE: Final = "  cruiser review report logs -o report.html"
DESCRIPTION: Final = (
    "Make one HTML page of a drive, which needs no network: summary, map of the path, speed, angle, mode and "
    "states over time, stops with their reasons, refusals, outages of the gateway, losses, versions and "
    "configurations. With --json and without -o only the summary is printed. Exit code 3 if some data could not "
    "be read."
)

DEFAULT_FILE: Final = "report.html"

WHYS_MAX: Final = 100  # limit of stops that are explained; each takes a tenth of a second


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_logs(parser, json_help="print the summary as JSON")
    add_period(parser)
    parser.add_argument("--robot", metavar="NAME", help="only this robot")
    parser.add_argument(
        "-o",
        "--out",
        type=Path,
        metavar="FILE",
        help=f"the HTML file to write (default: {DEFAULT_FILE})",
    )


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    out = arguments.out or (None if arguments.json else Path(DEFAULT_FILE))
    if out is not None and out.suffix != ".html":
        raise CommandError(f"{plain(str(out))} does not end with .html", ExitCode.USAGE)
    asked = find(arguments, settings, stopped)
    selection = asked.selection
    if arguments.robot is not None:
        # Its own messages, and those of recorders, which name no robot.
        selection = msgspec.structs.replace(selection, wants=lambda topic: topic.robot in {arguments.robot, ""})
    with progress_bar("report", asked.bytes, stopped) as progress:
        report = read_report(
            asked.logs,
            selection,
            asked.faults,
            progress,
            version=version("cruiser-gateway"),
        )
    if not report.robots and arguments.robot is not None:
        end_with(asked.faults)
        raise CommandError(f"the logs hold nothing of {plain(arguments.robot)}", ExitCode.USAGE)
    if not report.robots:
        end_with(asked.faults)
        raise CommandError("nothing to report: the logs hold no state, decision or event of a robot for this time")
    if out is not None:
        with progress_bar("why", asked.bytes, stopped) as progress:
            whys = reasons(report, asked.logs, progress)
        _write(out, page(report, whys, shlex.join(map(str, arguments.logs))).encode())
    show(summary(report), describe(report, out), as_json=arguments.json)
    return end_with(asked.faults)


def summary(report: Report) -> dict[str, Any]:
    fields: dict[str, Any] = msgspec.structs.asdict(report)
    fields["robots"] = [
        {
            **msgspec.structs.asdict(robot.summary),
            "moments": robot.moments,
            "drives": robot.drives,
            "more_drives": robot.more_drives,
        }
        for robot in report.robots
    ]
    return fields


def reasons(report: Report, logs: Sequence[LogFile], progress: Progress) -> dict[tuple[str, int], Why]:
    """Explain the first WHYS_MAX stops of a report, by the robot's key and the time of the stop.

    Faults of the logs were reported when they were read before.
    """
    found: dict[tuple[str, int], Why] = {}
    contents = survey(logs, Faults())
    explainers: dict[str, Explainer] = {}
    for robot in report.robots:
        stops = dict.fromkeys(one.time_ns for drawn in robot.drawn for one in drawn.moments if one.is_stop)
        if not stops or len(found) >= WHYS_MAX:
            continue
        name = robot.summary.name
        if name not in explainers:
            explainers[name] = Explainer(name, logs, contents, Faults(), progress)
        for time_ns in list(stops)[: WHYS_MAX - len(found)]:
            progress(0)
            explanation = explainers[name].at(time_ns)
            found[robot.summary.key, time_ns] = Why(explanation.headline, list(chain_in_words(explanation)))
    return found


def describe(report: Report, out: Path | None) -> Iterator[str]:
    for robot in report.robots:
        yield f"{robot.summary.name}: {verdict(robot)}"
        yield from (f"  {name.ljust(16)} {said}" for name, said in summary_lines(robot, report))
    if out is not None:
        yield f"written: {out}"


def _write(path: Path, content: bytes) -> None:
    """Write the whole file or nothing."""
    beside = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        try:
            beside.write_bytes(content)
            beside.replace(path)
        finally:
            beside.unlink(missing_ok=True)
    except OSError as error:
        raise CommandError(f"cannot write {plain(str(path))}: {error.strerror or error}") from error
