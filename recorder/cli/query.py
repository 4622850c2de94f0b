"""``cruiser review query``: SQL over logs, or over a dataset."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable, Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import Any, Final

import msgspec

from recorder.cli.asking import JSON_HELP, add_period, end_with, find, progress_bar, table
from recorder.cli.show import show
from recorder.reading.logs import Faults
from schemas.command_line import CommandError, ExitCode, needing_extra, plain
from schemas.settings import Settings

EXAMPLE: Final = """  cruiser review query 'SELECT log_time, kind, text FROM safety_event' logs
  cruiser review query 'SELECT robot, max(speed_mps) FROM chassis_drive GROUP BY robot' dataset
  cruiser review query 'SELECT file FROM catalog WHERE distance_m > 100' logs
  cruiser review query --tables logs"""
DESCRIPTION: Final = (
    "Answers SQL (DuckDB's dialect) from logs, or from a dataset of 'cruiser review export'. Each subject is a "
    "table: state, chassis_drive, safety_decision, can_rx, journal, ...; its columns are robot, log_time, "
    "publish_time, sequence, and the fields of the message. The table catalog has a row for each log of "
    "directories, from the catalog of 'cruiser review find'. The statement can access only these tables. Exit "
    "code 2 if it is wrong, 3 if not all of a log could be read."
)

SHOWN_MAX: Final = 1000  # rows of a table for people
CELL_MAX: Final = 60

_CONTROLS: Final = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069]")
"""Characters that control a terminal, or the direction of its text."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.usage = f"{parser.prog} [options] SQL LOG...\n       {parser.prog} --tables [options] LOG..."
    parser.add_argument("words", nargs="+", metavar="SQL LOG", help="a statement, then logs or one dataset")
    parser.add_argument("--tables", action="store_true", help="list the tables and their columns instead")
    parser.add_argument("--json", action="store_true", help=f"{JSON_HELP}, an object a line")
    parser.add_argument("--csv", action="store_true", help="print CSV")
    add_period(parser)


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    sql, *logs = ["", *arguments.words] if arguments.tables else arguments.words
    if not logs:
        raise CommandError("give a statement, and then a log or a dataset", ExitCode.USAGE)
    arguments.logs = [Path(log) for log in logs]
    with needing_extra():
        from recorder.review import query  # noqa: PLC0415 - its libraries are an extra
        from recorder.review.export import read_manifest  # noqa: PLC0415
    if sql and query.asks_catalog(sql):
        return _ask_catalog(query, sql, arguments, settings, stopped)
    manifests = list(map(read_manifest, arguments.logs))
    if len(logs) > 1 and any(manifests):
        raise CommandError("give one dataset alone, without logs or other datasets", ExitCode.USAGE)
    manifest = manifests[0]
    if manifest is not None:
        if arguments.from_time or arguments.to_time:
            raise CommandError(
                "for a dataset, give the time in the statement: WHERE log_time > ...", ExitCode.USAGE
            )
        _ask(query, query.DatasetSource(arguments.logs[0], manifest), sql, arguments, stopped)
        return int(ExitCode.OK)
    asked = find(arguments, settings, stopped)
    selection = asked.selection
    with progress_bar("reading", asked.bytes, stopped, prints=True, is_bounded=False) as progress:
        source = query.LogSource(asked.logs, selection, asked.faults, progress)
        try:
            _ask(query, source, sql, arguments, stopped)
        except CommandError:
            # DuckDB turns an interrupt into its own error.
            if stopped():
                raise KeyboardInterrupt from None
            # A read fault may be the cause.
            end_with(asked.faults)
            raise
    return end_with(asked.faults)


def _ask_catalog(
    query: Any,  # noqa: ANN401 - a module that is imported late
    sql: str,
    arguments: argparse.Namespace,
    settings: Settings,
    stopped: Callable[[], bool],
) -> int:
    from recorder.cli.catalogs import catalog_rows  # noqa: PLC0415 - as above
    from recorder.review.catalog.directory import SCHEMA  # noqa: PLC0415
    from recorder.review.query import CatalogSource  # noqa: PLC0415

    if arguments.from_time or arguments.to_time:
        raise CommandError("for a catalog, give the time in the statement: WHERE start_ns > ...", ExitCode.USAGE)
    faults = Faults()
    rows = catalog_rows(arguments.logs, SCHEMA.names, settings, faults, stopped)
    _ask(query, CatalogSource(rows), sql, arguments, stopped)
    return end_with(faults)


def _ask(query: Any, source: Any, sql: str, arguments: argparse.Namespace, stopped: Callable[[], bool]) -> None:  # noqa: ANN401 - a module that is imported late
    if arguments.tables:
        for one in source.tables:
            show(one, _columns(one), as_json=arguments.json)
        return
    with query.answer(source, sql, stopped) as rows, query.one_line_errors():
        if rows is None:
            return
        if arguments.csv:
            _print_csv(rows, stopped)
        elif arguments.json:
            for one in _objects(rows, stopped):
                sys.stdout.write(msgspec.json.encode(one).decode() + "\n")
        else:
            _print_table(rows.schema.names, _objects(rows, stopped))


def _objects(rows: Iterable[Any], stopped: Callable[[], bool]) -> Iterator[dict[str, Any]]:
    from recorder.review.export import objects  # noqa: PLC0415 - as above

    for batch in rows:
        if stopped():
            return
        yield from objects(batch)


def _print_csv(rows: Any, stopped: Callable[[], bool]) -> None:  # noqa: ANN401 - Arrow has no annotations
    from pyarrow import RecordBatch  # noqa: PLC0415 - as above

    from recorder.review.export import csv_text  # noqa: PLC0415

    is_first = True
    for batch in rows:
        if stopped():
            return
        _write_csv(csv_text(batch, with_header=is_first))
        is_first = False
    if is_first:
        _write_csv(csv_text(RecordBatch.from_pylist([], schema=rows.schema), with_header=True))


def _write_csv(text: str) -> None:
    """Print CSV with a terminal's control characters escaped, except tabs and line ends."""
    sys.stdout.write(_CONTROLS.sub(lambda found: ascii(found[0])[1:-1], text))


def _print_table(names: list[str], found: Iterator[dict[str, Any]]) -> None:
    shown = list(islice(found, SHOWN_MAX))
    lines = table(names, [[_cell(row[name]) for name in names] for row in shown], words=len(names))
    sys.stdout.write("\n".join(lines) + "\n" if lines else "  no rows\n")
    if next(found, None) is not None:
        sys.stderr.write(f"cruiser review: only the first {SHOWN_MAX} rows are shown; --csv and --json give all\n")


def _cell(value: Any) -> str:  # noqa: ANN401 - any value of SQL
    if value is None:
        return "-"
    if isinstance(value, str):
        text = value
    elif isinstance(value, float):
        text = f"{value:.10g}"
    else:
        text = msgspec.json.encode(value).decode()
    text = plain(text)
    return text if len(text) <= CELL_MAX else f"{text[: CELL_MAX - 3]}..."


def _columns(one: Any) -> Iterator[str]:  # noqa: ANN401 - a class of a module that is imported late
    yield f"{one.name}: {', '.join(one.topics)}"
    rows = [[plain(column.name), plain(column.type), plain(column.unit)] for column in one.columns]
    yield from table(("column", "type", "unit"), rows, words=3)
