"""The report as one HTML file, which needs no network and runs no script but its own.

All that comes from a log is escaped. Should that fail, the page's content security policy lets no other script run
than those whose hashes it names, and nothing be fetched.
"""

from __future__ import annotations

import hashlib
from base64 import b64encode
from collections.abc import Iterable, Iterator, Sequence
from html import escape
from importlib.resources import files
from string import Template
from typing import Any, Final

import msgspec

from recorder.reading.times import in_words
from recorder.review.report.figures import clock, on_map, over_time, placed
from recorder.review.report.findings import Report, ReportedFile, RobotReport, RobotSummary
from recorder.review.report.words import (
    SHOWN,
    Line,
    duration,
    gateway_lines,
    headline,
    is_lossy,
    metres,
    moment_words,
    reason_words,
    size,
    summary_lines,
    times,
    who,
)
from schemas.printable import plain

MOMENTS_SHOWN: Final = 300
"""Rows of the table of events; the chart has all."""

_LOSS_HEADS: Final = ("sent", "received", "written", "bus", "source", "link", "queue", "size", "full", "disk")
_RANKS: Final = {"error": -2, "warning": -1}
_GATEWAY: Final = "cruiser-gateway"
_OTHER_FACTS: Final = ("bus", "recorder_version")
"""Facts that a gateway does not report with its version."""

_OPENED: Final = 15
"""A longer table is folded."""


_Row = tuple[str | int | None, ...]
"""The cells of a table's row: texts, numbers, and None for a number that is not known."""


def page(report: Report, plotly_js: str) -> str:
    """The page, which is ``page.html`` filled in.

    Args:
        report: its content.
        plotly_js: the library that draws; it is part of the page.
    """
    here = files(__package__)
    script = (here / "page.js").read_text()
    charts = [
        {"map": on_map(robot.charts), "time": over_time(robot.charts), "places": placed(robot.charts.places)}
        for robot in report.robots
    ]
    robots = (line for number, robot in enumerate(report.robots) for line in _robot(number, robot, report))
    hashes = (b64encode(hashlib.sha256(one.encode()).digest()).decode() for one in (plotly_js, script))
    allowed = " ".join(f"'sha256-{one}'" for one in hashes)
    return Template((here / "page.html").read_text()).substitute(
        policy=f"default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'; script-src {allowed}",
        names=text(", ".join(robot.summary.name for robot in report.robots)),
        style=(here / "page.css").read_text(),
        head="\n".join(_head(report)),
        robots="\n".join(robots),
        files="\n".join(_files(report)),
        version=text(report.version),
        charts=safe_json(charts),
        plotly=plotly_js,
        script=script,
    )


def text(value: object) -> str:
    """Anything as text of the page: no tag, no attribute, no character that rules the line."""
    return escape(plain(str(value)))


def safe_json(value: Any) -> str:  # noqa: ANN401 - whatever JSON can hold
    """JSON that can stand in a script element: nothing in it ends that, or begins a comment."""
    encoded = msgspec.json.encode(value).decode()
    for character in "<>&\u2028\u2029":
        encoded = encoded.replace(character, f"\\u{ord(character):04x}")
    return encoded


def _head(report: Report) -> Iterator[str]:
    starts = [robot.summary.start_ns for robot in report.robots]
    ends = [robot.summary.end_ns for robot in report.robots]
    yield (
        f'<p class="lead">{text(in_words(min(starts)))} to {text(in_words(max(ends)))}, '
        f"{_counted(len(report.files), 'file')}, {text(size(sum(file.bytes for file in report.files)))}</p>"
    )
    if report.fault_count:
        yield f'<p class="note">Not all could be read: {_counted(report.fault_count, "fault")}, see below.</p>'
    if report.more_robots:
        yield f'<p class="note">{_counted(report.more_robots, "more robot")} in these logs are not shown.</p>'
    if len(report.robots) > 1:
        links = ", ".join(
            f'<a href="#robot-{number}">{text(robot.summary.name)}</a>'
            for number, robot in enumerate(report.robots)
        )
        yield f"<nav aria-label='Robots'><p>{links}</p></nav>"


def _robot(number: int, robot: RobotReport, report: Report) -> Iterator[str]:
    summary, charts = robot.summary, robot.charts
    yield f'<section id="robot-{number}" aria-labelledby="head-{number}">'
    yield f'<h2 id="head-{number}">{text(summary.name)}</h2>'
    yield f'<p class="lead">{text(headline(summary))}</p>'
    notes = gateway_lines(summary)
    for note in notes[:SHOWN]:
        yield f'<p class="note">Gateway: {text(note)}.</p>'
    if len(notes) > SHOWN:
        yield f'<p class="note">Gateway: {len(notes) - SHOWN} more such; see the events.</p>'
    yield from _figures(summary)
    yield from _card("Summary", _definitions(summary_lines(summary, report)))
    about = f"Map of the path of {summary.name}: {headline(summary)}"
    yield from _card(
        "Path",
        _chart(f"map-{number}", "map", about, "By odometry: speed and steering angle. Left is up."),
    )
    about = f"Speed, steering angle, mode, arbiter state, lease and events of {summary.name} over time"
    caption = "Point at a time to see the place on the map; drag to zoom all charts, click twice to go back."
    yield from _card("Over time", _chart(f"time-{number}", "time", about, caption))
    if charts.moments:
        yield from _card("Events", _moments(robot))
    if summary.refusals:
        yield from _card("Refusals", _refusals(summary))
    yield from _card("Completeness", _completeness(summary))
    yield from _card("Versions and configurations", _in_force(summary))
    yield "</section>"


def _figures(summary: RobotSummary) -> Iterator[str]:
    stops = sum(summary.stops.values())
    outages = sum(not one.is_between_logs for one in summary.outages) + summary.more_outages
    lost = sum(one.lost + one.lost_source + (one.lost_bus or 0) for one in summary.completeness.values())
    tiles = [
        ("", metres(summary.distance_m), "path"),
        ("", duration(summary.moving_s), "moving"),
        ("", f"{abs(summary.top_mps):.2f} m/s", "highest speed"),
        ("", str(stops), "stop" if stops == 1 else "stops"),
        *([("bad", str(outages), "gateway outage" if outages == 1 else "gateway outages")] if outages else []),
        ("bad" if summary.refused else "", str(summary.refused), "refused requests"),
        _lost_tile(lost, is_known=bool(summary.completeness)),
    ]
    yield '<ul class="figures">'
    for kind, value, name in tiles:
        yield f'<li class="{kind}"><strong>{text(value)}</strong><span>{text(name)}</span></li>'
    yield "</ul>"


def _lost_tile(lost: int, *, is_known: bool) -> tuple[str, str, str]:
    if not is_known:
        return "bad", "?", "lost: not told"
    return ("bad" if lost else "good"), str(lost), "samples lost"


def _card(title: str, inner: Iterable[str]) -> Iterator[str]:
    yield f'<div class="card"><h3>{text(title)}</h3>'
    yield from inner
    yield "</div>"


def _definitions(lines: Sequence[Line]) -> Iterator[str]:
    yield "<dl>"
    for name, said in lines:
        yield f"<dt>{text(name)}</dt><dd>{text(said)}</dd>"
    yield "</dl>"


def _chart(name: str, kind: str, about: str, caption: str) -> Iterator[str]:
    yield "<figure>"
    yield f'<div class="chart {kind}" id="{name}" role="img" aria-label="{text(about)}"></div>'
    yield f"<figcaption>{text(caption)}</figcaption></figure>"


def _moments(robot: RobotReport) -> Iterator[str]:
    moments = robot.charts.moments
    if len(moments) > MOMENTS_SHOWN:
        # Those that matter most, in the order of their times.
        worst = sorted(range(len(moments)), key=lambda number: _RANKS.get(moments[number].severity, 0))
        moments = [moments[number] for number in sorted(worst[:MOMENTS_SHOWN])]
    rows = [
        (clock(one.time_ns), one.kind, "" if one.reason == "none" else one.reason, who(one), moment_words(one))
        for one in moments
    ]
    left_out = len(robot.charts.moments) - len(rows) + robot.charts.more_moments
    caption = "What a person should know; in parentheses, who held the lease" + (
        f"; {left_out} of less weight, or later, are left out" if left_out else ""
    )
    head = ("time, UTC", "what", "reason", "operator", "text")
    yield from _folded(caption, _table(caption, head, rows, [one.severity for one in moments]), rows)


def _refusals(summary: RobotSummary) -> Iterator[str]:
    rows = [
        (one.count, one.request, one.operator, one.reason, reason_words(one.reason), clock(one.first_ns))
        for one in summary.refusals
    ]
    caption = "Refused requests by verb, operator and reason" + (
        f"; {summary.other_refusals} of further kinds" if summary.other_refusals else ""
    )
    head = ("count", "request", "operator", "reason", "in words", "first")
    yield from _folded(caption, _table(caption, head, rows), rows)


def _completeness(summary: RobotSummary) -> Iterator[str]:
    lossy = {topic: one for topic, one in summary.completeness.items() if is_lossy(one)}
    if not summary.completeness:
        yield "<p>The log holds no account of what its recorder received and lost: it was not finished.</p>"
    elif not lossy:
        yield f"<p>{_counted(len(summary.completeness), 'topic')}, nothing lost.</p>"
    if summary.unwritten:
        unwritten = [(one.topic, one.reason, one.count) for one in summary.unwritten]
        yield from _table("Reached the recorder, and is not in the log", ("topic", "why", "count"), unwritten)
    if summary.completeness:
        rows = [
            (topic.removeprefix(f"{summary.key}/"), *msgspec.structs.astuple(one))
            for topic, one in (lossy or summary.completeness).items()
        ]
        caption = "Samples of each topic on their way from the source into the log, and where they were lost"
        table = _table(caption, ("topic", *_LOSS_HEADS), rows)
        yield from table if lossy else _folded("All topics", table)


def _in_force(summary: RobotSummary) -> Iterator[str]:
    if summary.in_force:
        rows = [
            (
                in_words(one.since_ns),
                one.variant,
                one.configuration_sha256[:12] or "not told",
                one.versions.get(_GATEWAY, "not told"),
                "; ".join([*one.changes, *one.settings]),
            )
            for one in summary.in_force
        ]
        caption = "Gateways that were in force, each until the next" + (
            f"; there was no room for what was told {times(summary.more_in_force)} more"
            if summary.more_in_force
            else ""
        )
        head = ("since", "variant", "configuration", "version", "what is otherwise")
        kinds = ["changed" if one.changes else "" for one in summary.in_force]
        yield from _folded(caption, _table(caption, head, rows, kinds), rows)
    facts = {name: value for name, value in summary.facts.items() if name in _OTHER_FACTS}
    if summary.in_force:
        first = summary.in_force[0].versions
        facts["packages of the first"] = ", ".join(f"{name} {value}" for name, value in sorted(first.items()))
    if facts:
        yield from _definitions([(name.replace("_", " "), value) for name, value in sorted(facts.items())])
    else:
        yield "<p>The log does not tell.</p>"


def _state(file: ReportedFile) -> str:
    if file.is_accounted:
        return "finished"
    return "being written" if file.is_being_written else "not finished by its recorder"


def _files(report: Report) -> Iterator[str]:
    rows = [
        (file.name, size(file.bytes), in_words(file.start_ns), in_words(file.end_ns), _state(file))
        for file in report.files
    ]
    yield '<section aria-labelledby="files"><h2 id="files">Files</h2><div class="card">'
    yield from _table("What this report was made of", ("file", "size", "from", "to", "state"), rows)
    if report.faults:
        yield "<h3>What could not be read</h3><ul>"
        yield from (f"<li>{text(fault)}</li>" for fault in report.faults)
        if report.fault_count > len(report.faults):
            yield f"<li>and {report.fault_count - len(report.faults)} more</li>"
        yield "</ul>"
    yield "</div></section>"


def _folded(title: str, table: Iterable[str], rows: Sequence[_Row] | None = None) -> Iterator[str]:
    """The table, below a title to be opened if these rows of it are many; without rows in any case."""
    if rows is not None and len(rows) <= _OPENED:
        yield from table
        return
    yield f"<details><summary>{text(title)}</summary>"
    yield from table
    yield "</details>"


def _table(
    caption: str, head: Sequence[str], rows: Sequence[_Row], kinds: Sequence[str] | None = None
) -> Iterator[str]:
    """A table; a column is of numbers if the first row has one there. Each row may have a class."""
    heads = "".join(
        f'<th scope="col"{_look(one)}>{text(name)}</th>' for name, one in zip(head, rows[0], strict=True)
    )
    yield f'<div class="scroll"><table><caption>{text(caption)}</caption><thead><tr>{heads}</tr></thead><tbody>'
    for kind, cells in zip(kinds or [""] * len(rows), rows, strict=True):
        written = "".join(f"<td{_look(one)}>{'-' if one is None else text(one)}</td>" for one in cells)
        yield f'<tr class="{text(kind)}">{written}</tr>'
    yield "</tbody></table></div>"


def _look(cell: str | int | None) -> str:
    return "" if isinstance(cell, str) else " class=number"


def _counted(count: int, noun: str) -> str:
    return f"{count} {noun}{'' if count == 1 else 's'}"
