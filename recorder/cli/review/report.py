"""``cruiser review report``: a drive on one page, for people."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import msgspec

from recorder.cli.review.asking import add_logs, add_period, end_with, find, progress_bar
from recorder.cli.show import show
from recorder.review.report.findings import Report
from recorder.review.report.page import page
from recorder.review.report.survey import read_report
from recorder.review.report.words import headline, summary_lines
from schemas.exit_codes import CommandError, ExitCode
from schemas.printable import plain
from schemas.settings import Settings

EXAMPLE: Final = "  cruiser review report logs -o report.html"
DESCRIPTION: Final = (
    "A report of a drive: summary, map of the path, speed, angle, mode and states on one time axis, stops, "
    "refusals, whether the gateway died, what is missing, versions and configurations. As one HTML file that "
    "needs no network. With --json and without -o nothing is written but the "
    "summary. Exit code 3 if not all could be read."
)

DEFAULT_FILE: Final = "report.html"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags."""
    add_logs(parser, json_help="print the summary as JSON")
    add_period(parser)
    parser.add_argument(
        "-o",
        "--out",
        type=Path,
        metavar="FILE",
        help=f"write there, an HTML file; {DEFAULT_FILE} unless told otherwise",
    )


def run(arguments: argparse.Namespace, _settings: Settings, stopped: Callable[[], bool]) -> int:
    """Read, and write what is asked for."""
    out = arguments.out or (None if arguments.json else Path(DEFAULT_FILE))
    if out is not None and out.suffix != ".html":
        raise CommandError(f"{plain(str(out))} does not end with .html", ExitCode.USAGE)
    plotly = _plotly() if out is not None else ""
    asked = find(arguments)
    with progress_bar("report", asked.bytes, stopped) as progress:
        report = read_report(
            asked.logs, asked.selection, asked.faults, progress, version=version("cruiser-gateway")
        )
    if not report.robots:
        end_with(asked.faults)
        raise CommandError("there is no state, decision or event of a robot in these logs, so nothing to report")
    if out is not None:
        _write(out, page(report, plotly).encode())
    show(summary(report), describe(report, out), as_json=arguments.json)
    return end_with(asked.faults)


def summary(report: Report) -> dict[str, Any]:
    """Return all of a report but what is drawn."""
    fields: dict[str, Any] = msgspec.structs.asdict(report)
    fields["robots"] = [
        {**msgspec.structs.asdict(robot.summary), "moments": robot.charts.moments} for robot in report.robots
    ]
    return fields


def describe(report: Report, out: Path | None) -> Iterator[str]:
    """Yield the summaries as lines for people, and where the page was written."""
    for robot in report.robots:
        yield f"{robot.summary.name}: {headline(robot.summary)}"
        yield from (f"  {name.ljust(16)} {said}" for name, said in summary_lines(robot.summary, report))
    if out is not None:
        yield f"written: {out}"


def _plotly() -> str:
    """The script that draws the charts, loaded before the reading: it may be missing.

    Raises:
        CommandError: it is.
    """
    try:
        from plotly.offline import get_plotlyjs  # noqa: PLC0415 - an extra
    except ImportError as error:
        raise CommandError("a report needs plotly: pip install 'cruiser-gateway[review]'") from error
    return str(get_plotlyjs())


def _write(path: Path, content: bytes) -> None:
    """Whole or not at all.

    Raises:
        CommandError: it cannot be written.
    """
    beside = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        try:
            beside.write_bytes(content)
            beside.replace(path)
        finally:
            beside.unlink(missing_ok=True)
    except OSError as error:
        raise CommandError(f"cannot write {plain(str(path))}: {error.strerror or error}") from error
