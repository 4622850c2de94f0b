"""A drive on the page: what plays it, its path, its charts, its stops with their reasons, its events."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

from recorder.review.report.figures import clock
from recorder.review.report.findings import Moment, RobotReport, RobotSummary, Why
from recorder.review.report.links import PageLinks
from recorder.review.report.markup import Html, card, counted, folded, table_of, text
from recorder.review.report.words import headline, moment_words, reason_words, who

MOMENTS_SHOWN: Final = 300
"""Rows of the table of events; the chart has all."""

_ZOOM: Final = "Drag to zoom, with shift to pan; click twice to go back."
_RANKS: Final = {"error": -2, "warning": -1}


def drawn(number: int, robot: RobotReport, links: PageLinks, level: int = 3) -> Iterator[str]:
    """Path, charts, stops and events, and what plays them."""
    summary, charts = robot.summary, robot.charts
    yield f'<div id="drive-{number}" data-number="{number}">'
    yield (
        f'<div class="player" id="player-{number}" role="group" hidden '
        f'aria-label="{text(f"Play the drive of {summary.name}")}">'
        '<button type="button">Play</button>'
        '<select aria-label="How fast"><option value="1">1x</option><option value="4">4x</option>'
        '<option value="16">16x</option></select>'
        '<input type="range" min="0" max="1" step="1" value="0" aria-label="Time">'
        '<span><a href="#" title="This moment: a link to share"></a> <span class="said"></span></span></div>'
    )
    about = f"Map of the path of {summary.name}: {headline(summary)}"
    marks = '<path class="robot"/><path class="ghost"/>'
    caption = (
        "By odometry: speed and steering angle. Left is up. The robot has its own size, unless that is too small. "
        f"Click to go to a place. {_ZOOM}"
    )
    yield from card("Path", _chart(f"map-{number}", "map", about, caption, marks), level)
    about = f"Speed, steering angle, mode, arbiter state, lease and events of {summary.name} over time"
    caption = f"Point at a time to see the place on the map, click to go there. {_ZOOM}"
    marks = '<path class="outage"/><path class="stop"/><path class="now"/>'
    yield from card("Over time", _chart(f"time-{number}", "time", about, caption, marks), level)
    stops = [moment for moment in charts.moments if moment.is_stop]
    if stops:
        yield from card("Stops", _stops(summary, stops, links), level)
    if charts.moments:
        yield from card("Events", events(robot, charts.moments, links), level)
    yield "</div>"


def _stops(robot: RobotSummary, stops: Sequence[Moment], links: PageLinks) -> Iterator[str]:
    """Each stop, below which its reason can be opened. Those without one stand behind the others, as commands."""
    answers = [(stop, links.why(robot, stop)) for stop in stops]
    known = [(stop, answer) for stop, answer in answers if isinstance(answer, Why)]
    for stop, answer in known:
        reason = "" if stop.reason == "none" else reason_words(stop.reason)
        said = stop.text if reason in stop.text else f"{stop.text}: {reason}"
        yield f'<details class="why"><summary>{text(clock(stop.time_ns))} {text(said)}</summary>'
        yield f"<p>{text(answer.headline)} {links.at(robot, stop.time_ns, 'Show it on path and charts.')}</p>"
        yield "<ol>"
        for link in answer.links:
            when, at, step, said = map(text, link)
            yield f"<li><span>{when}</span> <span>{at}</span> <b>{step}</b> <span>{said}</span></li>"
        yield "</ol></details>"
    others = [(stop, answer) for stop, answer in answers if isinstance(answer, str)]
    if others:
        rows = [(clock(stop.time_ns), moment_words(stop), answer) for stop, answer in others[:MOMENTS_SHOWN]]
        caption = f"{counted(len(others), 'stop')} whose reason was not looked for, and the command that does"
        yield from folded(caption, table_of(caption, ("time, UTC", "what", "command"), rows), rows)


def _chart(name: str, kind: str, about: str, caption: str, marks: str) -> Iterator[str]:
    """A chart, with the marks that move over it."""
    yield '<figure><div class="stage">'
    yield f'<div class="chart {kind}" id="{name}" role="group" aria-label="{text(about)}"></div>'
    yield f'<svg aria-hidden="true">{marks}</svg></div>'
    yield f"<figcaption>{text(caption)}</figcaption></figure>"


def events(robot: RobotReport, all_moments: Sequence[Moment], links: PageLinks) -> Iterator[str]:
    """Yield a table of events; of too many, those that matter most."""
    summary, moments = robot.summary, all_moments
    if len(moments) > MOMENTS_SHOWN:
        # Those that matter most, in the order of their times.
        worst = sorted(range(len(moments)), key=lambda number: _RANKS.get(moments[number].severity, 0))
        moments = [moments[number] for number in sorted(worst[:MOMENTS_SHOWN])]
    rows = [
        (
            Html(links.at(summary, one.time_ns, clock(one.time_ns))),
            one.kind,
            "" if one.reason == "none" else one.reason,
            who(one),
            moment_words(one),
        )
        for one in moments
    ]
    left_out = len(all_moments) - len(rows) + robot.charts.more_moments
    caption = "What a person should know; in parentheses, who held the lease" + (
        f"; {left_out} of less weight, or later, are left out" if left_out else ""
    )
    head = ("time, UTC", "what", "reason", "operator", "text")
    looks = [(one.severity, f' data-ms="{one.time_ns // 1_000_000}"') for one in moments]
    yield from folded(caption, table_of(caption, head, rows, looks), rows)


def refusals(summary: RobotSummary, links: PageLinks) -> Iterator[str]:
    """Yield a table of refused requests."""
    rows = [
        (
            one.count,
            one.request,
            one.operator,
            one.reason,
            reason_words(one.reason),
            Html(links.at(summary, one.first_ns, clock(one.first_ns))),
        )
        for one in summary.refusals
    ]
    caption = "Refused requests by verb, operator and reason" + (
        f"; {summary.other_refusals} of further kinds" if summary.other_refusals else ""
    )
    head = ("count", "request", "operator", "reason", "in words", "first")
    yield from folded(caption, table_of(caption, head, rows), rows)
