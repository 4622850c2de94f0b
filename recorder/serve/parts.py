"""A part of a log as a file to take away: a log itself, or what ``cruiser review export`` makes of it, packed."""

from __future__ import annotations

import shutil
import zipfile
from pathlib import Path
from typing import Final

from starlette.concurrency import run_in_threadpool

from recorder.disk.log_directory import PART_SUFFIX, SUFFIX
from recorder.review.report.links import iso
from schemas.web.jobs import ask_review

PART_S: Final = 600.0
"""The longest part of a log; ``cruiser review cut`` and ``export`` make any."""

PART_BYTES: Final = 1 << 30
"""The largest one, before it is packed."""

LOG: Final = "mcap"

FORMS: Final = (LOG, "csv", "parquet", "candump", "asc", "blf")
"""A log, or the formats of ``export``."""

_FAST: Final = 1


async def make_part(log: Path, from_ns: int, to_ns: int, form: str, place: Path) -> str:
    """Make a part of a log.

    Args:
        log: the log.
        from_ns: the first log time, since 1970...
        to_ns: ...and the first one that is not wanted any more.
        form: one of FORMS.
        place: where the file goes.

    Returns:
        The reason that there is no such file; empty if there is one.
    """
    period = [f"--from={iso(from_ns)}", f"--to={iso(to_ns)}"]
    if form == LOG:
        done = await ask_review(["cut", str(log), *period, "-o", str(place)], file_bytes=PART_BYTES)
        return "" if _is_there(place) else done.fault or "nothing was cut"
    files = place.with_suffix(".files")
    try:
        words = ["export", str(log), *period, f"--format={form}", "-o", str(files)]
        done = await ask_review(words, file_bytes=PART_BYTES)
        return done.fault if done.code is None else await run_in_threadpool(_pack, files, place, done.fault)
    finally:
        await run_in_threadpool(shutil.rmtree, files, ignore_errors=True)


def _is_there(path: Path) -> bool:
    return path.is_file()


def _pack(files: Path, place: Path, fault: str) -> str:
    """Put the files of a directory into one. Returns the reason that it was not done."""
    found = sorted(path for path in files.rglob("*") if path.is_file())
    if not found:
        return fault or "the log holds nothing of that time"
    if sum(path.stat().st_size for path in found) > PART_BYTES:
        return f"that is more than {PART_BYTES >> 20} MiB: give a shorter time"
    with zipfile.ZipFile(place, "w", zipfile.ZIP_DEFLATED, compresslevel=_FAST) as packed:
        for path in found:
            packed.write(path, path.relative_to(files))
    return ""


def name_of_part(log: Path, from_ns: int, form: str) -> str:
    """Return the name of such a file for whoever takes it away."""
    stem = log.name.removesuffix(PART_SUFFIX).removesuffix(SUFFIX)
    return f"{stem}-{iso(from_ns)[11:19].replace(':', '')}{SUFFIX if form == LOG else f'.{form}.zip'}"
