"""The beginning of a report of several robots or drives: each drive in a row."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import msgspec

from recorder.reading.times import in_words
from recorder.review.report.findings import Moment, Report, ReportedDrive, RobotReport
from recorder.review.report.links import PageLinks
from recorder.review.report.markup import Html, Row, counted, table_of, text
from recorder.review.report.words import duration, metres

ROWS_MAX: Final = 1000

_HEAD: Final = ("robot", "when, UTC", "how long", "distance", "stops", "worst finding")
_RANKS: Final = {"warning": 1, "error": 2}


class _Line(msgspec.Struct, frozen=True):
    """A row to be."""

    robot: int
    drive: ReportedDrive
    drawn: int | None


def is_needed(report: Report) -> bool:
    """Report whether there is more than one drive to choose from."""
    return len(report.robots) > 1 or any(robot.is_apart for robot in report.robots)


def overview(report: Report, links: PageLinks) -> Iterator[str]:
    """Yield the table; a drive that is not drawn has the command that draws it."""
    numbers = {id(one): number for number, one in enumerate(report.drawn)}
    found = [line for number, robot in enumerate(report.robots) for line in _lines(number, robot, numbers)]
    found.sort(key=lambda line: line.drive.start_ns)
    rows: list[Row] = []
    for line in found[:ROWS_MAX]:
        name, drive = report.robots[line.robot].summary.name, line.drive
        when = text(in_words(drive.start_ns).removesuffix(" UTC").partition(".")[0])
        worst = f"<b>{text(drive.worst)}</b>" if drive.worst else "-"
        if line.drawn is None:
            command = text(links.command(name, drive))
            worst += f"<details><summary>a report of its own</summary><code>{command}</code></details>"
        else:
            when = f'<a href="#drive-{line.drawn}">{when}</a>'
        rows.append(
            (
                Html(f'<a href="#robot-{line.robot}">{text(name)}</a>'),
                Html(when),
                duration((drive.end_ns - drive.start_ns) / 1e9),
                metres(drive.distance_m),
                drive.stops,
                Html(worst),
            )
        )
    if not rows:
        return
    more = len(found) - len(rows) + sum(robot.more_drives for robot in report.robots)
    undrawn = sum(line.drawn is None for line in found)
    caption = counted(len(found), "drive") + (
        f", {len(found) - undrawn} of which are drawn here: the worst, and of these the last; "
        "the others have the command for a report of their own"
        if undrawn
        else ""
    )
    yield '<section aria-labelledby="overview"><h2 id="overview">Drives</h2><div class="card overview">'
    yield from table_of(caption, _HEAD, rows)
    if more:
        yield f"<p>{counted(more, 'more drive')} for which there was no room.</p>"
    yield "</div></section>"


def _lines(number: int, robot: RobotReport, numbers: dict[int, int]) -> Iterator[_Line]:
    if robot.is_apart:
        for drive in robot.drives:
            yield _Line(number, drive, None if drive.report is None else numbers[id(drive.report)])
        return
    summary = robot.summary
    worst = max(robot.charts.moments, key=_rank, default=None)
    is_told = worst is not None and _rank(worst) > 0
    whole = ReportedDrive(
        start_ns=summary.start_ns,
        end_ns=summary.end_ns,
        log_start_ns=summary.start_ns,
        log_end_ns=summary.end_ns,
        distance_m=summary.distance_m,
        stops=sum(summary.stops.values()),
        severity=worst.severity if worst is not None and is_told else "info",
        worst=worst.text if worst is not None and is_told else "",
    )
    yield _Line(number, whole, numbers[id(robot)])


def _rank(moment: Moment) -> int:
    return _RANKS.get(moment.severity, 0)
