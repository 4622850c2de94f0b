"""``cruiser review find``: moments, drives and logs by words, from the catalogs of directories."""

from __future__ import annotations

import argparse
import shlex
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote

import msgspec

from recorder.cli.review.asking import (
    JSON_HELP,
    end_with,
    log_place,
    needing_extra,
    needing_store,
    progress_bar,
    table,
)
from recorder.disk.log_directory import PART_SUFFIX, SUFFIX
from recorder.objects.address import StoreAddress, is_address, shown_url
from recorder.reading.faults import Faults
from recorder.reading.times import in_words
from recorder.review.report.links import iso
from schemas.exit_codes import CommandError, ExitCode
from schemas.printable import plain
from schemas.reasons import Reason
from schemas.settings import Settings

_missing: CommandError | None = None
try:
    with needing_extra():
        import pyarrow as pa

        from recorder.review.catalog.directory import Catalog
        from recorder.review.catalog.place import PlaceCatalog
        from recorder.review.catalog.rows import CatalogRow, LoggedMoment
        from recorder.review.find import FindAnswer, FoundDrive, FoundMoment, columns_of, find, read_words
except CommandError as error:
    # The help is for everybody.
    _missing = error

EXAMPLE: Final = """\
  cruiser review find 'stop reason=front_bumper robot=cruiser-* last 30d' logs
  cruiser review find 'drive distance_m>100 from 2026-01-02' logs
  cruiser review find 'log operator=alice lost>0' robot-logs depot-logs --json"""
DESCRIPTION: Final = (
    "What the logs of directories hold, by words: a subject (log, drive, event, stop, incident, fault, ...), "
    "conditions (FIELD=PATTERN, FIELD!=PATTERN, FIELD<NUMBER, FIELD>NUMBER), and a time (last 30d, from DATE, to "
    "DATE). It is answered from a catalog, catalog.parquet in each directory, which is brought up to date first: "
    "only logs that are new or have changed are opened. Exit code 3 if a log could not be read as a whole."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags."""
    parser.add_argument("words", metavar="WORDS", help="what to look for, as one argument")
    parser.add_argument(
        "logs",
        nargs="+",
        type=log_place,
        metavar="DIRECTORY",
        help="a directory of logs, here or in an object store (s3://BUCKET/PLACE, ...)",
    )
    parser.add_argument("--json", action="store_true", help=f"{JSON_HELP}, an object a line")
    parser.add_argument(
        "--catalog",
        type=Path,
        metavar="FILE",
        help="keep the catalog there, not beside the logs; of one directory",
    )
    parser.add_argument("--rebuild", action="store_true", help="make the catalog anew from the logs")


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    """Bring the catalogs up to date, and answer from them."""
    if _missing is not None:
        raise _missing
    query = read_words(arguments.words, time.time_ns())
    columns = columns_of(query)
    faults = Faults()
    directories = list(dict.fromkeys(arguments.logs))
    if arguments.catalog is not None and len(directories) > 1:
        raise CommandError("--catalog keeps the logs of one directory", ExitCode.USAGE)
    catalogs = [
        (place, _catalog(place, columns, settings, arguments.catalog, is_anew=arguments.rebuild))
        for place in directories
    ]
    total = sum(catalog.stale_bytes for _, catalog in catalogs)
    with progress_bar("cataloguing", total, stopped) as progress:
        for _, catalog in catalogs:
            catalog.refresh(faults, progress)
    rows = pa.concat_tables([_with_paths(path, catalog.table) for path, catalog in catalogs])
    if not rows.num_rows and not faults:
        _tell(catalogs)
        raise CommandError(f"there is no log in {', '.join(_shown(place) for place, _ in catalogs)}")
    found = find(rows, query)
    for line in _as_json(found) if arguments.json else _as_table(found):
        sys.stdout.write(f"{line}\n")
    _tell(catalogs)
    damaged = sum(count > 0 for count in rows.column("faults").to_pylist())
    if damaged:
        faults.add(f"{damaged} of {rows.num_rows} logs are damaged, or not whole: 'log faults>0' lists them")
    return end_with(faults)


def _catalog(
    place: Path | StoreAddress, columns: Sequence[str], settings: Settings, kept: Path | None, *, is_anew: bool
) -> Catalog | PlaceCatalog:
    if isinstance(place, Path):
        return Catalog(place, columns, kept, is_anew=is_anew)
    if kept is not None:
        raise CommandError("--catalog keeps the logs of a directory here", ExitCode.USAGE)
    with needing_store():
        from recorder.cli.review.stored import open_objects  # noqa: PLC0415 - it needs an extra
    return PlaceCatalog(open_objects(place, settings.upload), place, columns, is_anew=is_anew)


def _shown(place: Path | StoreAddress) -> str:
    return plain(str(place)) if isinstance(place, Path) else shown_url(place.url)


def _with_paths(place: Path | StoreAddress, rows: pa.Table) -> pa.Table:
    """The same, with each file as a path or an address."""
    names = rows.column("file").to_pylist()
    if isinstance(place, Path):
        paths = [str(place / name) for name in names]
    else:
        paths = [place.join(name).url for name in names]
    return rows.set_column(rows.schema.get_field_index("file"), "file", pa.array(paths, pa.string()))


def _tell(catalogs: Sequence[tuple[Path | StoreAddress, Catalog | PlaceCatalog]]) -> None:
    """Print on stderr what is no fault of a log, and yet ought to be known."""
    for _, catalog in catalogs:
        for note in catalog.notes:
            sys.stderr.write(f"cruiser review: {note}\n")
        for path in catalog.being_written:
            sys.stderr.write(f"cruiser review: {plain(str(path))} is being written, and not in the answer yet\n")


def link(file: str, robot: str, time_ns: int) -> str:
    """Return the address of a moment in the report of a log, which ``report_command`` writes.

    A report lies beside its log, so of a log in a store it is the log itself.
    """
    if is_address(file):
        return file
    named = f"&robot={quote(robot, safe='')}" if robot else ""
    return f"{page_of(file)}#t={iso(time_ns)}{named}"


def page_of(file: str) -> str:
    """Return the path of a log's report, beside the log."""
    return f"{file.removesuffix(PART_SUFFIX).removesuffix(SUFFIX)}.html"


def report_command(file: str) -> str:
    """Return the command that writes the report of a log beside it; empty for a log in a store."""
    if is_address(file):
        return ""
    return shlex.join(["cruiser", "review", "report", file, "-o", page_of(file)])


def why_command(file: str, moment: LoggedMoment) -> str:
    """Return the command that tells why the robot stopped, or did not move, at a moment."""
    named = ["--robot", moment.robot] if moment.robot else []
    return shlex.join(["cruiser", "review", "why", file, *named, "--at", iso(moment.time_ns)])


def record_of(one: FindAnswer) -> dict[str, Any]:
    """Return an answer as a JSON object: its own fields, its time as a text, and where to go on."""
    match one:
        case FoundMoment(file, moment):
            return {
                "time": in_words(moment.time_ns),
                "file": file,
                **msgspec.structs.asdict(moment),
                "link": link(file, moment.robot, moment.time_ns),
                "report": report_command(file),
                "why": why_command(file, moment),
            }
        case FoundDrive(file, drive):
            return {
                "time": in_words(drive.start_ns),
                "file": file,
                **msgspec.structs.asdict(drive),
                "link": link(file, drive.robot, drive.start_ns),
                "report": report_command(file),
            }
        case CatalogRow():
            fields = {"time": in_words(one.start_ns), **msgspec.structs.asdict(one)}
            # There may be thousands, and they have a subject of their own.
            del fields["moments"]
            return {**fields, "report": report_command(one.file)}


def _as_json(found: Sequence[FindAnswer]) -> Iterator[str]:
    for one in found:
        yield msgspec.json.encode(record_of(one)).decode()


def _as_table(found: Sequence[FindAnswer]) -> Iterator[str]:
    rows = []
    for one in found:
        head, row = _row(one)
        rows.append([plain(cell) for cell in row])
    if not rows:
        yield "nothing of that is in the logs"
        return
    yield from table(head, rows, words=len(head))
    if not isinstance(one, CatalogRow) and report_command(one.file):
        yield f"The page of a link is written by: {plain(report_command(one.file))}"


def _row(one: FindAnswer) -> tuple[Sequence[str], Sequence[str]]:
    """The heads of the columns, and the cells."""
    match one:
        case FoundMoment(file, moment):
            where = link(file, moment.robot, moment.time_ns)
            reason = "" if moment.reason == Reason.NONE.value else moment.reason
            cells = [in_words(moment.time_ns), moment.robot, moment.kind, reason, moment.operator]
            return ("time", "robot", "kind", "reason", "operator", "what", "link"), [*cells, moment.text, where]
        case FoundDrive(file, drive):
            where = link(file, drive.robot, drive.start_ns)
            lasted_s = (drive.end_ns - drive.start_ns) / 1e9
            cells = [in_words(drive.start_ns), drive.robot, f"{lasted_s:.0f} s", f"{drive.distance_m:.1f} m"]
            return (
                ("begin", "robot", "lasted", "distance", "stops", "worst", "link"),
                [*cells, str(drive.stops), drive.text or "-", where],
            )
        case CatalogRow():
            lasted_s = (one.end_ns - one.start_ns) / 1e9
            begin = in_words(one.start_ns) if one.messages else "no time"
            cells = [begin, ", ".join(one.names), f"{lasted_s:.0f} s", f"{one.distance_m:.1f} m"]
            lost = "not told" if one.lost is None else str(one.lost)
            return (
                ("begin", "robots", "lasted", "distance", "stops", "lost", "log"),
                [*cells, str(sum(one.stops.values())), lost, one.file],
            )
