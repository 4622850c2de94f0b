"""``cruiser upload``: finished logs and incidents to an object store."""

from __future__ import annotations

import argparse
import asyncio
import logging
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Final

from recorder.cli.show import show
from recorder.disk.files import UploadNote
from recorder.objects.address import shown_url
from recorder.upload.finished import row_maker
from schemas.command_line import CommandError, ExitCode, needing_extra, plain
from schemas.peers import RateLimit
from schemas.settings import Settings, UploadSettings

if TYPE_CHECKING:
    from recorder.upload.uploader import Uploader, UploadTotals

log = logging.getLogger(__name__)

EXAMPLE: Final = """\
  cruiser upload --logs logs --store file:///media/disk/logs --once
  AWS_ACCESS_KEY_ID=... AWS_SECRET_ACCESS_KEY=... cruiser upload --logs logs --store s3://fleet-logs/plant-1"""

KINDS: Final = ("s3://", "gs://", "az://", "file:///")
LOOK_S: Final = 10.0  # pause between two looks at the directory
AWAY_MAX_S: Final = 600.0  # longest pause, while the store does not respond
POLL_S: Final = 0.1  # period of checks for a stop


def add_arguments(parser: argparse.ArgumentParser) -> None:
    # It runs as long as its machine, and logs the uploaded files.
    parser.set_defaults(log_level="info")
    parser.add_argument(
        "--logs", dest="recorder.directory", metavar="DIR", help="directory of the logs (default .)"
    )
    parser.add_argument(
        "--store", dest="upload.store", metavar="URL", help="s3://BUCKET/PLACE, gs://, az:// or file:///DIRECTORY"
    )
    parser.add_argument(
        "--rate",
        dest="upload.rate_bytes_s",
        metavar="N",
        help="mean rate on the link in bytes/s, in parts of 5 MiB (default 250000); 0: no limit",
    )
    parser.add_argument("--once", action="store_true", help="try each finished log once, then end")
    parser.add_argument("--json", action="store_true", help="print the result as JSON")


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    upload, directory = settings.upload, Path(settings.recorder.directory)
    if not upload.store:
        raise CommandError("no store given: use --store URL, or upload.store in the settings", ExitCode.USAGE)
    if not upload.store.startswith(KINDS):
        # The library has others, one of them in memory.
        raise CommandError(
            f"unknown kind of store: {shown_url(upload.store)}; use one of {', '.join(KINDS)}", ExitCode.USAGE
        )
    if not directory.is_dir():
        raise CommandError(f"{plain(str(directory))} is no directory", ExitCode.USAGE)
    with needing_extra():
        import recorder.upload.uploader  # noqa: F401, PLC0415 - needs the extra 'upload'
    with UploadNote(directory) as note:
        totals, is_there = asyncio.run(_upload(upload, directory, note, stopped, is_once=arguments.once))
    show(totals, _lines(totals), as_json=arguments.json)
    if totals.uploaded or not totals.faults:
        return int(ExitCode.PARTIAL if totals.faults else ExitCode.OK)
    return int(ExitCode.FAILURE if is_there else ExitCode.UNREACHABLE)


async def _upload(
    upload: UploadSettings, directory: Path, note: UploadNote, stopped: Callable[[], bool], *, is_once: bool
) -> tuple[UploadTotals, bool]:
    """Return the result, and whether the store is reachable."""
    from recorder.upload.uploader import LogStore, Uploader, UploadPlan  # noqa: PLC0415 - not before the package is known

    store = LogStore(upload.store, upload.options)
    url, release = shown_url(upload.store), version("cruiser-gateway")
    plan = UploadPlan(directory, url, upload.logs == "incidents", upload.read_back, release)
    rows = row_maker("recorder.review.catalog") if upload.catalog else None
    uploader = Uploader(plan, store, note, RateLimit(upload.rate_bytes_s), rows)
    log.info("uploading finished logs of %s to %s", plain(str(directory)), url)
    work = asyncio.create_task(_work(uploader, stopped, is_once=is_once))
    while not work.done():
        await asyncio.wait([work], timeout=POLL_S)
        if stopped():
            # An interrupted upload does not appear in the store.
            work.cancel()
            await asyncio.wait([work])
    return uploader.totals, work.cancelled() or work.result()


async def _work(uploader: Uploader, stopped: Callable[[], bool], *, is_once: bool) -> bool:
    pause_s = LOOK_S
    while True:
        is_there = True
        try:
            is_there = await uploader.upload_all(lambda: not stopped())
        except OSError as error:
            if is_once:
                raise CommandError(f"cannot read the logs: {error.strerror or error}") from error
            log.debug("cannot read the logs: %s", error)
        if is_once:
            return is_there
        pause_s = LOOK_S if is_there else min(2 * pause_s, AWAY_MAX_S)
        await asyncio.sleep(pause_s)


def _lines(totals: UploadTotals) -> list[str]:
    logs = f"{totals.uploaded} logs uploaded, {totals.bytes} bytes, {totals.rows} with a row in the catalog"
    faults = [f"{name}: {fault}" for name, fault in totals.faults.items()]
    return [f"{logs}; {len(totals.waiting)} waiting", *faults]
