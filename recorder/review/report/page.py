"""The report as one HTML file, which needs no network and runs only its own scripts.

``page.js`` draws lines with uPlot, and path, bands and marks as SVG. Everything from a log is escaped; if that
fails, the policy still allows only the scripts whose hashes it names, and no network access.
"""

from __future__ import annotations

import hashlib
import re
import shlex
from base64 import b64encode
from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from html import escape
from importlib.resources import files
from importlib.resources.abc import Traversable
from itertools import pairwise
from string import Template
from types import MappingProxyType
from typing import Any, Final
from urllib.parse import quote

import msgspec

import schemas
from recorder.reading.times import in_words
from recorder.review.drives import MARGIN_NS, RecordedDrive
from recorder.review.entries import Entry
from recorder.review.report.findings import (
    ABSENT,
    BANDS,
    LINES,
    Drawn,
    Place,
    Point,
    Report,
    RobotReport,
    RobotSummary,
    Why,
    drive_distance,
    duration,
    is_lossy,
    iso,
    moment_words,
    reason_words,
    size,
    summary_lines,
    verdict,
    who,
)
from recorder.review.window import counted
from schemas.command_line import plain
from schemas.decisions import Severity
from schemas.reasons import Reason


def figures(robot: RobotSummary, drawn: Drawn) -> dict[str, Any]:
    stops = [moment.time_ns for moment in drawn.moments if moment.is_stop]
    return {
        "robot": robot.name,
        "from_ms": _ms(drawn.start_ns),
        "to_ms": -(-drawn.end_ns // 1_000_000),
        "lines": [_line(drawn.lines.get(name, [])) for name in LINES],
        "bands": [
            [(_ms(span.start_ns), _ms(span.end_ns), plain(span.value)) for span in drawn.bands.get(row, [])]
            for row in BANDS
        ],
        "outages": [(_ms(begin), _ms(end)) for begin, end in drawn.outages],
        "stops": [_ms(time_ns) for time_ns in stops],
        "moments": [_moment(one, drawn.places) for one in drawn.moments],
        "path": _path(drawn.places),
    }


def clock(time_ns: int) -> str:
    try:
        return f"{datetime.fromtimestamp(time_ns // 10**9, UTC):%H:%M:%S}.{time_ns % 10**9 // 10**6:03d}"
    except (ValueError, OverflowError, OSError):
        return f"{time_ns} ns"


def hover_text(moment: Entry) -> str:
    parts = [f"{moment.kind.value} {clock(moment.time_ns)}", plain(moment_words(moment))]
    if moment.reason is not Reason.NONE:
        parts.append(f"reason: {reason_words(moment.reason.value)}")
    if moment.operator:
        parts.append(f"operator: {plain(moment.operator)}")
    elif moment.holder:
        parts.append(f"holder of the lease: {plain(moment.holder)}")
    return "\n".join(parts)


def _ms(time_ns: int) -> int:
    return time_ns // 1_000_000


def _steps(times_ms: Sequence[int]) -> list[int]:
    """The first time, then the difference to each next one."""
    return [*times_ms[:1], *(after - before for before, after in pairwise(times_ms))]


def _line(points: Sequence[Point | None]) -> tuple[list[int], list[float | None]]:
    """Times and values; a break is a missing value right after the last one."""
    times_ms: list[int] = []
    values: list[float | None] = []
    for point in points:
        times_ms.append(times_ms[-1] + 1 if point is None else _ms(point[0]))
        values.append(None if point is None else round(point[1], 3))
    return _steps(times_ms), values


def _moment(moment: Entry, places: Sequence[Place]) -> dict[str, Any]:
    at = bisect_right(places, moment.time_ns, key=lambda place: place.time_ns)
    place = places[max(0, at - 1)] if places else None
    return {
        "ms": _ms(moment.time_ns),
        "kind": moment.kind.value,
        "text": hover_text(moment),
        "at": None if place is None else (round(place.x_m, 3), round(place.y_m, 3)),
    }


def _path(places: Sequence[Place]) -> dict[str, Sequence[float]]:
    """The places in order; ``begins`` are the numbers of those after a break."""
    return {
        "time_ms": _steps([_ms(place.time_ns) for place in places]),
        "x_m": [round(place.x_m, 3) for place in places],
        "y_m": [round(place.y_m, 3) for place in places],
        "heading_deg": [round(place.heading_deg, 1) for place in places],
        "begins": [number for number, place in enumerate(places) if place.begins],
    }


MOMENTS_SHOWN: Final = 300  # limit of rows in the table of events; the chart has all

DRIVES_SHOWN: Final = 1000
_OPENED: Final = 15  # a longer table is folded

_ZOOM: Final = "Drag to zoom, with shift to pan; click twice to go back."
_RANKS: Final = {Severity.ERROR: -2, Severity.WARNING: -1}
_LOSS_HEADS: Final = ("sent", "received", "written", "bus", "source", "link", "queue", "size", "full", "disk")
_MS: Final = 1_000_000

Whys = Mapping[tuple[str, int], Why]
"""The reasons of stops, by the robot's key and the time of the stop."""


class Html(msgspec.Struct, frozen=True):
    """Markup of this module, with everything from a log escaped."""

    markup: str


Row = tuple[str | int | Html | None, ...]
"""The cells of a row: texts, numbers, and None for an unknown number."""


def page(report: Report, whys: Whys = MappingProxyType({}), logs: str = "LOG") -> str:
    """Fill in ``page.html``; ``logs`` are the shell words for the commands on the page."""
    here, vendor = files(__package__), files(schemas) / "page" / "vendor"
    library, script = _text(vendor / "uPlot.iife.min.js"), _text(here / "page.js")
    _, name, licence = _text(vendor / "LICENSES.txt").partition("uPlot")
    hashes = (b64encode(hashlib.sha256(one.encode()).digest()).decode() for one in (library, script))
    allowed = " ".join(f"'sha256-{one}'" for one in hashes)
    charts = {"drives": [figures(*one) for one in report.drawn]}
    return Template(_text(here / "page.html")).substitute(
        policy=f"default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'; script-src {allowed}",
        names=text(", ".join(robot.summary.name for robot in report.robots)),
        style=_text(vendor / "uPlot.min.css") + _text(here / "page.css"),
        head="\n".join(_head(report)),
        robots="\n".join(_Page(report, whys, logs).robots()),
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
        yield f'<p class="note">Some data is unreadable: {counted(report.fault_count, "fault")}, see below.</p>'
    if report.more_robots:
        yield f'<p class="note">{counted(report.more_robots, "more robot")} in these logs are not shown.</p>'


class _Page:
    """Writes the robots of a report."""

    def __init__(self, report: Report, whys: Whys, logs: str) -> None:
        self._report = report
        self._whys = whys
        self._logs = logs
        self._is_alone = len(report.robots) == 1
        self._numbers = {id(one): number for number, (_, one) in enumerate(report.drawn)}

    def robots(self) -> Iterator[str]:
        """Yield all robots, with a table of drives if there are several robots."""
        robots = self._report.robots
        if not self._is_alone:
            for number, robot in enumerate(robots):
                name = f'<a href="#robot-{number}">{text(robot.summary.name)}</a>'
                yield f'<p class="verdict">{name}: {text(verdict(robot))}</p>'
            yield from self._overview()
        for number, robot in enumerate(robots):
            yield f'<section id="robot-{number}" aria-labelledby="head-{number}">'
            yield f'<h2 id="head-{number}">{text(robot.summary.name)}</h2>'
            yield from self._robot(robot)
            yield "</section>"

    def _robot(self, robot: RobotReport) -> Iterator[str]:
        summary = robot.summary
        yield f'<p class="verdict">{text(verdict(robot))}</p>'
        if summary.worst is not None:
            at = self._at(summary, summary.worst.time_ns, clock(summary.worst.time_ns))
            yield f'<p class="note">Worst moment, {at}: {text(moment_words(summary.worst))}</p>'
        if self._is_alone and len(robot.drives) > 1:
            yield from self._overview()
        for one in robot.drawn:
            yield from self._drawn(robot, one)
        others = [one for one in robot.moments if not self._is_drawn(summary, one.time_ns)]
        if others:
            yield from card("Events outside the drawn drives", self._events(robot, others))
        lines = (
            f"<dt>{text(name)}</dt><dd>{text(said)}</dd>" for name, said in summary_lines(robot, self._report)
        )
        yield from card("Details", ("<dl>", *lines, "</dl>"))
        if summary.refusals:
            more = f", and {summary.other_refusals} of other kinds" if summary.other_refusals else ""
            yield from card(
                "Refusals", records(f"Refused requests by verb, operator and reason{more}", summary.refusals)
            )
        yield from card("Completeness", _completeness(summary))
        more = f", and {summary.more_in_force} more" if summary.more_in_force else ""
        caption = f"Gateways, each in force until the next{more}"
        yield from card("Versions and configurations", records(caption, summary.in_force))

    def _overview(self) -> Iterator[str]:
        """Yield a table of drives, with a command for each one that is not drawn."""
        drawn = {id(one.drive): self._numbers[id(one)] for _, one in self._report.drawn}
        found = [(number, robot, one) for number, robot in enumerate(self._report.robots) for one in robot.drives]
        found.sort(key=lambda line: line[2].start_ns)
        rows: list[Row] = []
        for number, robot, drive in found[:DRIVES_SHOWN]:
            when = text(in_words(drive.start_ns).removesuffix(" UTC").partition(".")[0])
            worst = "-"
            if drive.worst:
                worst = f"<b>{self._at(robot.summary, drive.worst_ns, drive.worst)}</b>"
            if id(drive) in drawn:
                when = f'<a href="#drive-{drawn[id(drive)]}">{when}</a>'
            else:
                command = text(self._command(robot.summary.name, drive))
                worst += f"<details><summary>separate report</summary><code>{command}</code></details>"
            way = drive_distance(robot.summary, drive)
            lasted = duration((drive.end_ns - drive.start_ns) / 1e9)
            name = Html(f'<a href="#robot-{number}">{text(robot.summary.name)}</a>')
            rows.append((name, Html(when), lasted, way, drive.stops, Html(worst)))
        if not rows:
            return
        more = len(found) - len(rows) + sum(robot.more_drives for robot in self._report.robots)
        caption = counted(len(found), "drive")
        if len(drawn) < len(found):
            caption += "; the newest are drawn here, the others have a command for a separate report"
        yield '<section aria-labelledby="overview"><h2 id="overview">Drives</h2><div class="card overview">'
        yield from table_of(caption, ("robot", "when, UTC", "duration", "distance", "stops", "worst moment"), rows)
        if more:
            yield f"<p>{counted(more, 'more drive')}, not listed.</p>"
        yield "</div></section>"

    def _drawn(self, robot: RobotReport, one: Drawn) -> Iterator[str]:
        summary, number = robot.summary, self._numbers[id(one)]
        yield f'<section class="drive" id="drive-{number}" data-number="{number}" aria-labelledby="of-{number}">'
        title = f"{in_words(one.start_ns)}: {duration((one.end_ns - one.start_ns) / 1e9)}"
        if one.drive is not None:
            title += f", {drive_distance(summary, one.drive)}, {counted(one.drive.stops, 'stop')}"
        yield f'<h3 id="of-{number}">{text(title)}</h3>'
        yield (
            f'<div class="player" id="player-{number}" role="group" hidden '
            f'aria-label="{text(f"Play the drive of {summary.name}")}">'
            '<button type="button">Play</button>'
            '<select aria-label="Speed"><option value="1">1x</option><option value="4">4x</option>'
            '<option value="16">16x</option></select>'
            '<input type="range" min="0" max="1" step="1" value="0" aria-label="Time">'
            '<span><a href="#" title="Link to this moment"></a> <span class="said"></span></span></div>'
        )
        about = f"Map of the path of {summary.name}"
        marks = '<path class="robot"/><path class="ghost"/>'
        caption = f"Odometry from speed and steering angle. Click to go to a place. {_ZOOM}"
        yield from card("Path", _chart(f"map-{number}", "map", about, caption, marks), 4)
        about = f"Speed, steering angle, mode, arbiter state, lease and events of {summary.name} over time"
        caption = f"Point at a time to see the place on the map, click to go there. {_ZOOM}"
        marks = '<path class="outage"/><path class="stop"/><path class="now"/>'
        yield from card("Over time", _chart(f"time-{number}", "time", about, caption, marks), 4)
        stops = [moment for moment in one.moments if moment.is_stop]
        if stops:
            yield from card("Stops", self._stops(summary, stops), 4)
        if one.moments:
            yield from card("Events", self._events(robot, one.moments), 4)
        yield "</section>"

    def _stops(self, robot: RobotSummary, stops: Sequence[Entry]) -> Iterator[str]:
        """Yield each stop with its reason, folded; for the others the command that shows it."""
        others = []
        for stop in stops:
            why = self._whys.get((robot.key, stop.time_ns))
            if why is None:
                others.append(iso(stop.time_ns))
                continue
            reason = "" if stop.reason is Reason.NONE else reason_words(stop.reason.value)
            said = stop.text if reason in stop.text else f"{stop.text}: {reason}"
            yield f'<details class="why"><summary>{text(clock(stop.time_ns))} {text(said)}</summary>'
            yield f"<p>{text(why.headline)} {self._at(robot, stop.time_ns, 'Show it on path and charts.')}</p><ol>"
            for link in why.links:
                when, at, step, said = map(text, link)
                yield f"<li><span>{when}</span> <span>{at}</span> <b>{step}</b> <span>{said}</span></li>"
            yield "</ol></details>"
        if others:
            command = f"cruiser review why {self._logs} --robot {shlex.quote(robot.name)} --at {others[0]}"
            yield f"<p>{counted(len(others), 'more stop')}; <code>{text(command)}</code> shows the reason.</p>"

    def _events(self, robot: RobotReport, all_moments: Sequence[Entry]) -> Iterator[str]:
        """Yield a table of events, limited to the most severe."""
        moments = all_moments
        if len(moments) > MOMENTS_SHOWN:
            worst = sorted(range(len(moments)), key=lambda number: _RANKS.get(moments[number].severity, 0))
            moments = [moments[number] for number in sorted(worst[:MOMENTS_SHOWN])]
        rows: list[Row] = [
            (
                Html(self._at(robot.summary, one.time_ns, clock(one.time_ns))),
                one.kind.value,
                "" if one.reason is Reason.NONE else one.reason.value,
                who(one),
                moment_words(one),
            )
            for one in moments
        ]
        left_out = len(all_moments) - len(rows) + robot.more_moments
        caption = "The holder of the lease is in parentheses"
        if left_out:
            caption += f"; {left_out} less severe or later ones are left out"
        head = ("time, UTC", "what", "reason", "operator", "text")
        looks = [(one.severity.value, f' data-ms="{one.time_ns // _MS}"') for one in moments]
        yield from folded(caption, table_of(caption, head, rows, looks), rows)

    def _at(self, robot: RobotSummary, time_ns: int, words: str) -> str:
        """A link to a moment, or the words alone if it is not drawn."""
        if not self._is_drawn(robot, time_ns):
            return text(words)
        named = "" if self._is_alone else f"&robot={quote(robot.name, safe='')}"
        return f'<a href="{text(f"#t={iso(time_ns)}{named}")}">{text(words)}</a>'

    def _is_drawn(self, robot: RobotSummary, time_ns: int) -> bool:
        """True if a moment is on a time axis, in whole milliseconds."""
        return any(
            one.start_ns // _MS * _MS <= time_ns <= -(-one.end_ns // _MS) * _MS
            for summary, one in self._report.drawn
            if summary is robot
        )

    def _command(self, robot: str, drive: RecordedDrive) -> str:
        from_ns, to_ns = max(0, drive.log_start_ns - MARGIN_NS), drive.log_end_ns + MARGIN_NS
        file = shlex.quote(f"{robot}-{re.sub('[-:]', '', iso(drive.start_ns)[:19])}Z.html".replace("/", "-"))
        period = f"--from {iso(from_ns)} --to {iso(to_ns)}"
        return f"cruiser review report {self._logs} --robot {shlex.quote(robot)} {period} -o {file}"


def _chart(name: str, kind: str, about: str, caption: str, marks: str) -> Iterator[str]:
    yield '<figure><div class="stage">'
    yield f'<div class="chart {kind}" id="{name}" role="group" aria-label="{text(about)}"></div>'
    yield f'<svg aria-hidden="true">{marks}</svg></div>'
    yield f"<figcaption>{text(caption)}</figcaption></figure>"


def _completeness(summary: RobotSummary) -> Iterator[str]:
    lossy = {topic: one for topic, one in summary.completeness.items() if is_lossy(one)}
    if not summary.completeness:
        yield f"<p>The recorder's account is {ABSENT}.</p>"
    elif not lossy:
        yield f"<p>{counted(len(summary.completeness), 'topic')}, nothing lost.</p>"
    if summary.completeness:
        rows: list[Row] = [
            (topic.removeprefix(f"{summary.key}/"), *msgspec.structs.astuple(one))
            for topic, one in (lossy or summary.completeness).items()
        ]
        caption = "Samples by topic, from the source into the log, and where they were lost"
        table = table_of(caption, ("topic", *_LOSS_HEADS), rows)
        yield from table if lossy else folded("All topics", table)


def _files(report: Report) -> Iterator[str]:
    yield '<section aria-labelledby="files"><h2 id="files">Files</h2><div class="card">'
    yield from records("Sources of this report", report.files)
    if report.faults:
        yield "<h3>Unreadable data</h3><ul>"
        yield from (f"<li>{text(fault)}</li>" for fault in report.faults)
        if report.fault_count > len(report.faults):
            yield f"<li>and {report.fault_count - len(report.faults)} more</li>"
        yield "</ul>"
    yield "</div></section>"


# Pieces of the page.


def text(value: object) -> str:
    """Escape anything for the page: no tags, no attributes, no control characters."""
    return escape(plain(str(value)))


def safe_json(value: Any) -> str:  # noqa: ANN401 - whatever JSON can hold
    """JSON for a script element: it cannot end the element or begin a comment."""
    encoded = msgspec.json.encode(value).decode()
    for character in "<>&\u2028\u2029":
        encoded = encoded.replace(character, f"\\u{ord(character):04x}")
    return encoded


def card(title: str, inner: Iterable[str], level: int = 3) -> Iterator[str]:
    yield f'<div class="card"><h{level}>{text(title)}</h{level}>'
    yield from inner
    yield "</div>"


def folded(title: str, table: Iterable[str], rows: Sequence[Row] | None = None) -> Iterator[str]:
    """The table, folded below a title if it has many rows; without ``rows`` always."""
    if rows is not None and len(rows) <= _OPENED:
        yield from table
        return
    yield f"<details><summary>{text(title)}</summary>"
    yield from table
    yield "</details>"


def records(caption: str, found: Sequence[msgspec.Struct]) -> Iterator[str]:
    if not found:
        yield f"<p>{ABSENT.capitalize()}.</p>"
        return
    fields = found[0].__struct_fields__
    head = [field.removesuffix("_ns").removesuffix("_sha256").replace("_", " ") for field in fields]
    rows = [tuple(_cell(field, getattr(one, field)) for field in fields) for one in found]
    yield from folded(caption, table_of(caption, head, rows), rows)


def _cell(field: str, value: Any) -> str | int:  # noqa: ANN401 - any field of a record
    match value:
        case bool():
            return "yes" if value else "no"
        case int():
            return in_words(value) if field.endswith("_ns") else value
        case dict():
            return ", ".join(f"{name} {one}" for name, one in sorted(value.items())) or ABSENT
        case list():
            return "; ".join(value)
        case _:
            return reason_words(value) if field == "reason" else value[:12] if field.endswith("_sha256") else value


def table_of(
    caption: str, head: Sequence[str], rows: Sequence[Row], looks: Sequence[tuple[str, str]] | None = None
) -> Iterator[str]:
    """A table; a column holds numbers if the first row does. ``looks``: class and attributes of each row."""
    heads = "".join(
        f'<th scope="col"{_look(one)}>{text(name)}</th>' for name, one in zip(head, rows[0], strict=True)
    )
    yield f'<div class="scroll"><table><caption>{text(caption)}</caption><thead><tr>{heads}</tr></thead><tbody>'
    for (kind, more), cells in zip(looks or [("", "")] * len(rows), rows, strict=True):
        written = "".join(f"<td{_look(one)}>{_written(one)}</td>" for one in cells)
        yield f'<tr class="{text(kind)}"{more}>{written}</tr>'
    yield "</tbody></table></div>"


def _written(cell: str | int | Html | None) -> str:
    if isinstance(cell, Html):
        return cell.markup
    return "-" if cell is None else text(cell)


def _look(cell: str | int | Html | None) -> str:
    return "" if isinstance(cell, str | Html) else " class=number"
