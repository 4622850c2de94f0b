"""Many logs into one dataset: Parquet files by topic, robot and date, and a manifest.

What is there is never overwritten. Files are written in a hidden directory beside, moved to their places when all
are whole, and named by the manifest last: an export that is interrupted leaves no directory that counts as one.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Final

import msgspec

from recorder.disk.log_directory import lock_own
from recorder.reading.faults import Faults
from recorder.reading.log_file import LogFile
from recorder.reading.rows import Progress
from recorder.review.export.manifest import (
    FORMAT,
    MANIFEST_NAME,
    VERSION,
    Input,
    Manifest,
    Part,
    sha256_of,
    write_manifest,
)
from recorder.review.export.one_log import ExportOutcome, ExportRange, ExportTask, export_log
from recorder.review.tasks import HERE, Act
from schemas.command_line import CommandError, plain

_STAGING_PREFIX: Final = ".export-"

Runner = Callable[[Act[ExportTask, ExportOutcome], Sequence[ExportTask], Progress], Iterable[ExportOutcome]]
"""As ``tasks.TaskRunner``."""


class Exported(msgspec.Struct, frozen=True):
    """The result of an export.

    Attributes:
        inputs: the logs that were read.
        files: that were written.
    """

    directory: str
    inputs: list[Input]
    files: list[Part]

    @property
    def rows(self) -> int:
        """Rows that were written."""
        return sum(part.rows for part in self.files)


def export_dataset(
    logs: Sequence[LogFile],
    directory: Path,
    wanted: ExportRange,
    faults: Faults,
    *,
    run: Runner = HERE,
    progress: Progress = lambda _: None,
) -> Exported:
    """Write logs into a dataset.

    Args:
        logs: in the order of their beginnings.
        directory: of the dataset; it is made if it is not there.
        wanted: topics and time.
        faults: takes what cannot be read of the logs; the rest is exported all the same.
        run: does the work.
        progress: receives the number of bytes that were read.

    Raises:
        CommandError: the directory holds something already, or cannot be written.
    """
    shown = plain(str(directory))
    try:
        directory.mkdir(parents=True, exist_ok=True)
        with _locked(directory):
            if (directory / MANIFEST_NAME).exists():
                raise CommandError(f"{shown} is a dataset already: nothing is overwritten, so export to another")
            if any(not path.name.startswith(".") for path in directory.iterdir()):
                raise CommandError(f"{shown} is not empty, and no dataset: it has no {MANIFEST_NAME}")
            inputs, files = _export(logs, directory, wanted, run, progress)
    except OSError as error:
        raise CommandError(f"cannot write {shown}: {error.strerror or error}") from error
    for one in inputs:
        for fault in one.faults:
            faults.add(fault)
        faults.count += one.fault_count - len(one.faults)
    return Exported(shown, inputs, files)


def _export(
    logs: Sequence[LogFile], directory: Path, wanted: ExportRange, run: Runner, progress: Progress
) -> tuple[list[Input], list[Part]]:
    staging = Path(tempfile.mkdtemp(prefix=_STAGING_PREFIX, dir=directory)).absolute()
    try:
        # A log that is named twice is one.
        by_hash = {sha256_of(log.path, log.bytes): log for log in reversed(logs)}
        tasks = [ExportTask(log, sha256, staging, wanted) for sha256, log in reversed(by_hash.items())]
        outcomes = list(run(export_log, tasks, progress))
        inputs = [outcome.input for outcome in outcomes]
        files = [part for outcome in outcomes for part in outcome.parts]
        schemas = {key: columns for outcome in outcomes for key, columns in outcome.schemas.items()}
        for path in staging.iterdir():
            path.rename(directory / path.name)
        product = f"cruiser-gateway {version('cruiser-gateway')}"
        write_manifest(directory, Manifest(FORMAT, VERSION, product, inputs, files, schemas))
    finally:
        shutil.rmtree(staging, ignore_errors=True)
    return inputs, files


@contextmanager
def _locked(directory: Path) -> Generator[None, None, None]:
    """One export at a time, where the file system locks directories; NFS does not."""
    place = os.open(directory, os.O_RDONLY)
    try:
        if not lock_own(place):
            raise CommandError(f"another export writes into {plain(str(directory))}")
        yield
    finally:
        os.close(place)
