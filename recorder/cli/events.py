"""``cruiser review events``: list what happened, in order."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterable, Iterator
from itertools import chain, islice
from typing import Any, Final

import msgspec

from recorder.cli.asking import (
    Asked,
    add_logs,
    add_period,
    add_robots,
    chosen_robots,
    end_with,
    find,
    no_robot,
    progress_bar,
)
from recorder.cli.show import json_line
from recorder.reading.logs import Faults
from recorder.reading.survey import survey
from recorder.reading.times import in_words
from recorder.review.entries import Entry, EntryKind
from recorder.review.events import read_events
from schemas.command_line import plain
from schemas.reasons import TEXTS, Reason
from schemas.settings import Settings

EXAMPLE: Final = """\
  cruiser review events logs
  cruiser review events logs --from 20 --to 40 --kind stop --kind refusal --robot 'depot-*'
  cruiser review events logs --json | jq -r 'select(.severity == "error").text'"""
DESCRIPTION: Final = (
    "List what happened, in order: leases, engagements, stops, latches, faults, takeovers, refusals, and gaps in "
    "the log, each with time, cause and operator. Similar refusals and faults in a row are one line with a count. "
    "Exit code 1 if the logs hold nothing of a robot, 3 if a file is not whole."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_logs(parser, json_help="print a JSON object a line")
    add_period(parser)
    add_robots(parser)
    parser.add_argument(
        "--kind",
        action="append",
        default=[],
        choices=[kind.value for kind in EntryKind],
        metavar="KIND",
        help=f"only this kind; may be repeated. One of {', '.join(kind.value for kind in EntryKind)}",
    )


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    asked = find(arguments, settings, stopped)
    robots = survey(asked.logs, Faults()).robots if arguments.robot else []
    wanted, kinds = chosen_robots(arguments.robot, robots), frozenset(map(EntryKind, arguments.kind))
    show = _as_json if arguments.json else _as_table
    with progress_bar("events", asked.bytes, stopped, prints=True) as progress:
        entries = read_events(asked.logs, asked.selection, asked.faults, progress, robots=wanted, kinds=kinds)
        first = list(islice(entries, 1))
        if not first and not survey(asked.logs, Faults()).robots:
            raise no_robot(asked.faults)
        for line in show(chain(first, entries), asked):
            sys.stdout.write(f"{line}\n")
    return end_with(asked.faults)


def record_of(entry: Entry, start_ns: int) -> dict[str, Any]:
    """An entry as a JSON object, with its time in words and since the start of the logs."""
    return {
        "time": in_words(entry.time_ns),
        "since_s": round((entry.time_ns - start_ns) / 1e9, 6),
        **msgspec.structs.asdict(entry),
        "cause": "" if entry.reason is Reason.NONE else TEXTS[entry.reason].means,
    }


def _as_json(entries: Iterable[Entry], asked: Asked) -> Iterator[str]:
    for entry in entries:
        yield json_line(record_of(entry, asked.start_ns))


_HEAD: Final = ("since/s", "time (UTC)", "robot", "severity", "kind", "cause", "operator", "what")
_ROW: Final = "{:>10}  {:12}  {:10}  {:8}  {:8}  {:16}  {:16}  {}"
"""Columns of fixed width: entries are printed as they are read."""


def _as_table(entries: Iterable[Entry], asked: Asked) -> Iterator[str]:
    yield _ROW.format(*_HEAD)
    day = ""
    for entry in entries:
        date, _, time = in_words(entry.time_ns).removesuffix(" UTC").partition(" ")
        if date != day:
            yield f"{'':10}  {date}"
            day = date
        row = _ROW.format(
            f"{(entry.time_ns - asked.start_ns) / 1e9:.3f}",
            time,
            entry.robot or "-",
            entry.severity.value,
            entry.kind.value,
            "-" if entry.reason is Reason.NONE else entry.reason.value,
            entry.operator or (f"({entry.holder})" if entry.holder and not entry.request else "-"),
            _what(entry),
        )
        # Names in a log may hold terminal commands.
        yield plain(row)


def _what(entry: Entry) -> str:
    lasted_s = (entry.last_ns - entry.time_ns) / 1e9
    notes = []
    if entry.count > 1:
        notes.append(f"{entry.count} times" + (f" within {lasted_s:.1f} s" if lasted_s >= 0.05 else ""))
    if entry.is_late:
        notes.append("out of order")
    return entry.text + (f" [{', '.join(notes)}]" if notes else "")
