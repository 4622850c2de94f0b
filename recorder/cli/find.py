"""``cruiser review find``: stops, incidents, events, drives and logs, from the catalogs of directories."""

from __future__ import annotations

import argparse
import re
import shlex
import sys
import time
from collections.abc import Callable, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote

import msgspec

from recorder.cli.asking import JSON_HELP, add_robots, chosen_robots, end_with, log_place, table
from recorder.disk.log_names import PART_SUFFIX, SUFFIX
from recorder.objects.address import is_address
from recorder.reading.logs import Faults
from recorder.reading.times import date_of, in_words
from recorder.review.report.findings import iso
from schemas.arguments import whole_number
from schemas.command_line import CommandError, ExitCode, needing_extra, plain
from schemas.reasons import Reason
from schemas.settings import Settings

SEARCHES: Final = ("stops", "incidents", "events", "drives", "logs")

EXAMPLE: Final = """\
  cruiser review find stops logs --reason front_bumper --robot 'cruiser-*' --since 30d
  cruiser review find drives logs --operator alice --since 2026-01-02
  cruiser review find logs robot-logs depot-logs --json
  cruiser review query 'SELECT file FROM catalog WHERE distance_m > 100' logs"""
DESCRIPTION: Final = (
    "Finds stops, incidents, events, drives or logs in directories of logs. It reads a catalog, catalog.parquet "
    "in each directory, which is brought up to date first: only new or changed logs are opened. For any other "
    "question, 'cruiser review query' has the catalog as a table. Exit code 3 if not all of a log could be "
    "read."
)

_UNITS_S: Final = {"s": 1, "min": 60, "h": 3600, "d": 86400, "w": 7 * 86400}
_SPAN: Final = re.compile(rf"(\d{{1,9}})({'|'.join(_UNITS_S)})")
_REASONS: Final = tuple(reason.value for reason in Reason)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("search", choices=SEARCHES, metavar="SEARCH", help=f"one of {', '.join(SEARCHES)}")
    parser.add_argument(
        "logs",
        nargs="+",
        type=log_place,
        metavar="DIRECTORY",
        help="a directory of logs, here or in an object store (s3://BUCKET/PLACE, ...)",
    )
    add_robots(parser)
    parser.add_argument("--reason", type=_reason, metavar="WORD", help="with a stop or refusal for this reason")
    parser.add_argument("--operator", metavar="NAME", help="of this operator")
    moment = "a time before now (90min, 12h, 30d, 2w), or a date in UTC (2026-01-02, 2026-01-02T03:04:05Z)"
    parser.add_argument(
        "--since", type=_moment, default=0, metavar="TIME", help=f"ended after this time: {moment}"
    )
    parser.add_argument("--until", type=_moment, metavar="TIME", help="begun before this time, likewise")
    parser.add_argument("--newest", type=whole_number(1, 2**31 - 1), metavar="N", help="only the last N answers")
    parser.add_argument("--json", action="store_true", help=f"{JSON_HELP}, an object a line")
    parser.add_argument(
        "--catalog",
        type=Path,
        metavar="FILE",
        help="store the catalog there, not beside the logs; for one directory",
    )


def _reason(text: str) -> str:
    if text in _REASONS:
        return text
    near = get_close_matches(text, _REASONS, 1)
    hint = f"did you mean {near[0]}?" if near else f"it is one of {', '.join(_REASONS)}"
    raise argparse.ArgumentTypeError(f"there is no reason {text!a}: {hint}")


def _moment(text: str) -> int:
    if match := _SPAN.fullmatch(text):
        return max(0, time.time_ns() - int(match[1]) * _UNITS_S[match[2]] * 1_000_000_000)
    time_ns = date_of(text)
    if time_ns is None or not 0 <= time_ns < 2**63:
        raise argparse.ArgumentTypeError(
            f"{text!a} is no time: give one as 30d, 2026-01-02 or 2026-01-02T03:04:05Z"
        )
    return time_ns


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    with needing_extra():
        from recorder.cli.catalogs import catalog_rows  # noqa: PLC0415 - its libraries are an extra
        from recorder.review.catalog import find  # noqa: PLC0415
    bounds = {} if arguments.until is None else {"until_ns": arguments.until}
    if arguments.until is not None and arguments.since >= arguments.until:
        raise CommandError("--since must be before --until", ExitCode.USAGE)
    faults = Faults()
    columns = find.SEARCHES[arguments.search].columns
    rows = catalog_rows(arguments.logs, columns, settings, faults, stopped, arguments.catalog)
    named = {name for names in rows.column("names").to_pylist() for name in names}
    robots = chosen_robots(arguments.robot, named) if arguments.robot else None
    conditions = find.FindConditions(robots, arguments.reason, arguments.operator, arguments.since, **bounds)
    found = find.find(rows, arguments.search, conditions, arguments.newest, stopped)
    for line in _as_json(arguments.search, found) if arguments.json else _as_table(arguments.search, found):
        sys.stdout.write(f"{line}\n")
    return end_with(faults)


def link(file: str, robot: str, time_ns: int) -> str:
    """The address of a moment in the report of a log, which ``report_command`` writes; in a store, the log's."""
    if is_address(file):
        return file
    named = f"&robot={quote(robot, safe='')}" if robot else ""
    return f"{page_of(file)}#t={iso(time_ns)}{named}"


def page_of(file: str) -> str:
    """The path of a log's report, beside the log."""
    return f"{file.removesuffix(PART_SUFFIX).removesuffix(SUFFIX)}.html"


def report_command(file: str) -> str:
    """The command that writes the report of a log beside it; empty for a log in a store."""
    return "" if is_address(file) else shlex.join(["cruiser", "review", "report", file, "-o", page_of(file)])


def _as_json(search: str, found: Sequence[dict[str, Any]]) -> list[str]:
    """An answer as a line of JSON: its fields, its time as a text, and further commands."""
    return [msgspec.json.encode({**one, **_more(search, one)}).decode() for one in found]


def _more(search: str, one: dict[str, Any]) -> dict[str, Any]:
    file = one["file"]
    time_ns = one["start_ns" if search in {"drives", "logs"} else "time_ns"]
    more = {"time": in_words(time_ns), "report": report_command(file)}
    if search == "logs":
        return more
    more["link"] = link(file, one["robot"], time_ns)
    if search != "drives":
        named = ["--robot", one["robot"]] if one["robot"] else []
        more["why"] = shlex.join(["cruiser", "review", "why", file, *named, "--at", iso(time_ns)])
    return more


def _as_table(search: str, found: Sequence[dict[str, Any]]) -> list[str]:
    if not found:
        return ["nothing found"]
    head, cells = {"logs": (_LOG, _log_cells), "drives": (_DRIVE, _drive_cells)}.get(
        search, (_EVENT, _event_cells)
    )
    lines = table(head, [[plain(cell) for cell in cells(one)] for one in found], words=len(head))
    command = report_command(found[-1]["file"]) if search != "logs" else ""
    return [*lines, *([f"To write the page of a link: {plain(command)}"] if command else [])]


_EVENT: Final = ("time", "robot", "kind", "reason", "operator", "what", "link")
_DRIVE: Final = ("begin", "robot", "lasted", "distance", "stops", "worst", "link")
_LOG: Final = ("begin", "robots", "lasted", "distance", "stops", "lost", "faults", "log")


def _event_cells(one: dict[str, Any]) -> list[str]:
    reason = "" if one["reason"] == Reason.NONE.value else one["reason"]
    where = link(one["file"], one["robot"], one["time_ns"])
    operator = one["operator"] or (f"({one['holder']})" if one["holder"] else "")
    return [in_words(one["time_ns"]), one["robot"], one["kind"], reason, operator, one["text"], where]


def _drive_cells(one: dict[str, Any]) -> list[str]:
    where = link(one["file"], one["robot"], one["start_ns"])
    times = [in_words(one["start_ns"]), one["robot"], *_extent(one, "missing_s")]
    return [*times, str(one["stops"]), one["text"] or "-", where]


def _log_cells(one: dict[str, Any]) -> list[str]:
    begin = in_words(one["start_ns"]) if one["messages"] else "no time"
    lost = "unknown" if one["lost"] is None else str(one["lost"])
    counts = [str(sum(one["stops"].values())), lost, str(one["faults"])]
    return [begin, ", ".join(one["names"]), *_extent(one, "gap_s"), *counts, one["file"]]


def _extent(one: dict[str, Any], missing: str) -> tuple[str, str]:
    """Its time and distance."""
    at_least = "at least " if one[missing] else ""
    return f"{(one['end_ns'] - one['start_ns']) / 1e9:.0f} s", f"{at_least}{one['distance_m']:.1f} m"
