"""The report as one HTML file, which needs no network and runs no script but its own.

All that comes from a log is escaped. Should that fail, the page's content security policy lets no other script run
than those whose hashes it names, and nothing be fetched.
"""

from __future__ import annotations

import hashlib
from base64 import b64encode
from collections.abc import Iterator, Mapping
from importlib.resources import files
from importlib.resources.abc import Traversable
from string import Template
from types import MappingProxyType
from typing import Final

import msgspec

import schemas
from recorder.reading.times import in_words
from recorder.review.report.drive_cards import drawn, events, refusals
from recorder.review.report.figures import figures, looks
from recorder.review.report.findings import Report, ReportedDrive, ReportedFile, RobotReport, RobotSummary
from recorder.review.report.links import PageLinks, Whys
from recorder.review.report.markup import card, counted, definitions, folded, safe_json, table_of, text
from recorder.review.report.overview import is_needed, overview
from recorder.review.report.words import (
    SHOWN,
    duration,
    gateway_lines,
    headline,
    is_lossy,
    size,
    summary_lines,
    times,
    way,
)

_LOSS_HEADS: Final = ("sent", "received", "written", "bus", "source", "link", "queue", "size", "full", "disk")
_GATEWAY: Final = "cruiser-gateway"
_OTHER_FACTS: Final = ("bus", "recorder_version")
"""Facts that a gateway does not report with its version."""


def page(report: Report, whys: Whys = MappingProxyType({}), logs: str = "LOG") -> str:
    """The page, which is ``page.html`` filled in.

    Args:
        report: its content.
        whys: the reasons of the stops, as far as they were looked for.
        logs: the logs, as a shell has them, for commands that the page names.
    """
    here, vendor = files(__package__), files(schemas) / "page" / "vendor"
    library, script = _text(vendor / "uPlot.iife.min.js"), _text(here / "page.js")
    _, name, licence = _text(vendor / "LICENSES.txt").partition("uPlot")
    charts = {"looks": looks(), "drives": [figures(robot) for robot in report.drawn]}
    links = PageLinks(report, whys, logs)
    numbers = {id(one): number for number, one in enumerate(report.drawn)}
    robots = [*overview(report, links)] if is_needed(report) else []
    for number, robot in enumerate(report.robots):
        robots += _robot(number, robot, report, links, numbers)
    hashes = (b64encode(hashlib.sha256(one.encode()).digest()).decode() for one in (library, script))
    allowed = " ".join(f"'sha256-{one}'" for one in hashes)
    return Template(_text(here / "page.html")).substitute(
        policy=f"default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'; script-src {allowed}",
        names=text(", ".join(robot.summary.name for robot in report.robots)),
        style=_text(vendor / "uPlot.min.css") + _text(here / "page.css"),
        head="\n".join(_head(report)),
        robots="\n".join(robots),
        files="\n".join(_files(report)),
        version=text(report.version),
        charts=safe_json(charts),
        library=library,
        licence=name + licence.partition("@msgpack")[0],
        script=script,
    )


def _text(place: Traversable) -> str:
    return place.read_text(encoding="utf-8")


def _head(report: Report) -> Iterator[str]:
    starts = [robot.summary.start_ns for robot in report.robots]
    ends = [robot.summary.end_ns for robot in report.robots]
    yield (
        f'<p class="lead">{text(in_words(min(starts)))} to {text(in_words(max(ends)))}, '
        f"{counted(len(report.files), 'file')}, {text(size(sum(file.bytes for file in report.files)))}</p>"
    )
    if report.fault_count:
        yield f'<p class="note">Not all could be read: {counted(report.fault_count, "fault")}, see below.</p>'
    if report.more_robots:
        yield f'<p class="note">{counted(report.more_robots, "more robot")} in these logs are not shown.</p>'


def _robot(
    number: int, robot: RobotReport, report: Report, links: PageLinks, numbers: Mapping[int, int]
) -> Iterator[str]:
    """Yield a robot, with a section for each drive if they are apart. ``numbers`` are of what is drawn, by id."""
    summary = robot.summary
    yield f'<section id="robot-{number}" aria-labelledby="head-{number}">'
    yield f'<h2 id="head-{number}">{text(summary.name)}</h2>'
    yield from _beginning(summary)
    yield from card("Summary", definitions(summary_lines(summary, report)))
    if robot.is_apart:
        for drive in robot.drives:
            if drive.report is not None:
                yield from _drive(numbers[id(drive.report)], drive, drive.report, links)
        others = [one for one in robot.charts.moments if not links.is_drawn(summary, one.time_ns)]
        if others:
            yield from card("Events outside of the drives that are drawn", events(robot, others, links))
    else:
        yield from drawn(numbers[id(robot)], robot, links)
    if summary.refusals:
        yield from card("Refusals", refusals(summary, links))
    yield from card("Completeness", _completeness(summary))
    yield from card("Versions and configurations", _in_force(summary))
    yield "</section>"


def _beginning(summary: RobotSummary, *, is_part: bool = False) -> Iterator[str]:
    yield f'<p class="lead">{text(headline(summary))}</p>'
    notes = gateway_lines(summary)
    for note in notes[:SHOWN]:
        yield f'<p class="note">Gateway: {text(note)}.</p>'
    if len(notes) > SHOWN:
        yield f'<p class="note">Gateway: {len(notes) - SHOWN} more such; see the events.</p>'
    yield from _figures(summary, is_part=is_part)


def _drive(number: int, drive: ReportedDrive, robot: RobotReport, links: PageLinks) -> Iterator[str]:
    lasted = duration((drive.end_ns - drive.start_ns) / 1e9)
    yield f'<section class="drive" aria-labelledby="of-{number}">'
    yield f'<h3 id="of-{number}">{text(robot.summary.name)}, {text(in_words(drive.start_ns))}: {text(lasted)}</h3>'
    yield from _beginning(robot.summary, is_part=True)
    yield from drawn(number, robot, links, level=4)
    yield "</section>"


def _figures(summary: RobotSummary, *, is_part: bool) -> Iterator[str]:
    stops = sum(summary.stops.values())
    outages = sum(not one.is_between_logs for one in summary.outages) + summary.more_outages
    lost = sum(one.lost + one.lost_source + (one.lost_bus or 0) for one in summary.completeness.values())
    tiles = [
        ("", way(summary), "path"),
        ("", duration(summary.moving_s), "moving"),
        ("", f"{abs(summary.top_mps):.2f} m/s", "highest speed"),
        ("", str(stops), "stop" if stops == 1 else "stops"),
        *([("bad", str(outages), "gateway outage" if outages == 1 else "gateway outages")] if outages else []),
        ("bad" if summary.refused else "", str(summary.refused), "refused requests"),
        *([] if is_part else [_lost_tile(lost, is_known=bool(summary.completeness))]),
    ]
    yield '<ul class="figures">'
    for kind, value, name in tiles:
        yield f'<li class="{kind}"><strong>{text(value)}</strong><span>{text(name)}</span></li>'
    yield "</ul>"


def _lost_tile(lost: int, *, is_known: bool) -> tuple[str, str, str]:
    if not is_known:
        return "bad", "?", "lost: not told"
    return ("bad" if lost else "good"), str(lost), "samples lost"


def _completeness(summary: RobotSummary) -> Iterator[str]:
    lossy = {topic: one for topic, one in summary.completeness.items() if is_lossy(one)}
    if not summary.completeness:
        yield "<p>The log holds no account of what its recorder received and lost: it was not finished.</p>"
    elif not lossy:
        yield f"<p>{counted(len(summary.completeness), 'topic')}, nothing lost.</p>"
    if summary.unwritten:
        unwritten = [(one.topic, one.reason, one.count) for one in summary.unwritten]
        yield from table_of("Reached the recorder, and is not in the log", ("topic", "why", "count"), unwritten)
    if summary.completeness:
        rows = [
            (topic.removeprefix(f"{summary.key}/"), *msgspec.structs.astuple(one))
            for topic, one in (lossy or summary.completeness).items()
        ]
        caption = "Samples of each topic on their way from the source into the log, and where they were lost"
        table = table_of(caption, ("topic", *_LOSS_HEADS), rows)
        yield from table if lossy else folded("All topics", table)


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
        kinds = [("changed" if one.changes else "", "") for one in summary.in_force]
        yield from folded(caption, table_of(caption, head, rows, kinds), rows)
    facts = {name: value for name, value in summary.facts.items() if name in _OTHER_FACTS}
    if summary.in_force:
        first = summary.in_force[0].versions
        facts["packages of the first"] = ", ".join(f"{name} {value}" for name, value in sorted(first.items()))
    if facts:
        yield from definitions([(name.replace("_", " "), value) for name, value in sorted(facts.items())])
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
    yield from table_of("What this report was made of", ("file", "size", "from", "to", "state"), rows)
    if report.faults:
        yield "<h3>What could not be read</h3><ul>"
        yield from (f"<li>{text(fault)}</li>" for fault in report.faults)
        if report.fault_count > len(report.faults):
            yield f"<li>and {report.fault_count - len(report.faults)} more</li>"
        yield "</ul>"
    yield "</div></section>"
