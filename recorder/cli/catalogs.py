"""The catalogs of directories, brought up to date before they are read."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import pyarrow as pa

from recorder.cli.asking import in_time, progress_bar
from recorder.objects.address import StoreAddress, shown_url
from recorder.reading.logs import Faults
from recorder.review.catalog.directory import Catalog, PlaceCatalog
from schemas.command_line import CommandError, ExitCode, needing_extra, plain
from schemas.settings import Settings

Place = Path | StoreAddress


def catalog_rows(
    places: Sequence[Place],
    columns: Sequence[str],
    settings: Settings,
    faults: Faults,
    stopped: Callable[[], bool],
    kept: Path | None = None,
) -> pa.Table:
    """The rows of all logs of these places, with path or address as their file; CommandError without any log."""
    places = list(dict.fromkeys(places))
    if kept is not None and (len(places) > 1 or not isinstance(places[0], Path)):
        raise CommandError("--catalog needs exactly one local directory", ExitCode.USAGE)
    catalogs = [_opened(place, columns, settings, kept) for place in places]
    total = sum(one.stale_bytes for one in catalogs)
    # Each log has its own time limit: a malicious one must not delay the others.
    with progress_bar("cataloguing", total, stopped, is_bounded=False) as progress:
        for one in catalogs:
            one.refresh(faults, progress, in_time)
    for one in catalogs:
        for note in one.notes:
            sys.stderr.write(f"cruiser review: {note}\n")
        for path in one.being_written:
            sys.stderr.write(f"cruiser review: {plain(str(path))} is being written, and not included yet\n")
    rows = pa.concat_tables([_with_paths(place, one.table) for place, one in zip(places, catalogs, strict=True)])
    if not rows.num_rows and not faults:
        raise CommandError(f"there is no log in {', '.join(map(_shown, places))}")
    damaged = sum(count > 0 for count in rows.column("faults").to_pylist())
    if damaged:
        faults.add(f"{damaged} of {rows.num_rows} logs are damaged or unfinished: 'find logs' marks them")
    return rows


def _opened(place: Place, columns: Sequence[str], settings: Settings, kept: Path | None) -> Catalog | PlaceCatalog:
    if isinstance(place, Path):
        return Catalog(place, columns, kept)
    with needing_extra():
        from recorder.cli.stored import open_cache, open_objects  # noqa: PLC0415 - it needs an extra
    return PlaceCatalog(open_objects(place, settings.upload), place, columns, open_cache(settings.upload))


def _shown(place: Place) -> str:
    return plain(str(place)) if isinstance(place, Path) else shown_url(place.url)


def _with_paths(place: Place, rows: pa.Table) -> pa.Table:
    """The rows with each file as a path or an address."""
    names = rows.column("file").to_pylist()
    paths = [str(place / name) if isinstance(place, Path) else place.join(name).url for name in names]
    return rows.set_column(rows.schema.get_field_index("file"), "file", pa.array(paths, pa.string()))
