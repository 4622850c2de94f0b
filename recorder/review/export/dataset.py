"""Many logs into one dataset: Parquet files by topic, robot and date, and a manifest.

What is there is never overwritten. New files are written in a hidden directory beside, moved to their places when
all are whole, and named by the manifest last: an export that is interrupted leaves the dataset as it was.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import tempfile
from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Final

import msgspec

from recorder.reading.faults import Faults
from recorder.reading.log_file import LogFile
from recorder.reading.rows import Progress
from recorder.reading.topics import key_of
from recorder.review.export.known_rows import TopicNames, overlapping
from recorder.review.export.manifest import (
    FORMAT,
    MANIFEST_NAME,
    VERSION,
    Input,
    Manifest,
    Part,
    read_manifest,
    sha256_of,
    write_manifest,
)
from recorder.review.export.one_log import ExportOutcome, ExportRange, ExportTask, export_log
from recorder.review.tasks import HERE, Act
from schemas import keys
from schemas.exit_codes import CommandError
from schemas.printable import plain

_STAGING_PREFIX: Final = ".export-"

Runner = Callable[[Act[ExportTask, ExportOutcome], Sequence[ExportTask], Progress], Iterable[ExportOutcome]]
"""As ``tasks.TaskRunner``."""


class Exported(msgspec.Struct, frozen=True):
    """The result of an export.

    Attributes:
        inputs: the logs that were read.
        files: that were written.
        known: logs that were in the dataset already.
    """

    directory: str
    inputs: list[Input]
    files: list[Part]
    known: list[str]

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
    is_adding: bool = False,
    run: Runner = HERE,
    progress: Progress = lambda _: None,
) -> Exported:
    """Write logs into a dataset.

    Args:
        logs: in the order of their beginnings.
        directory: of the dataset; it is made if it is not there.
        wanted: topics and time.
        faults: takes what cannot be read of the logs; the rest is exported all the same.
        is_adding: a dataset is there already, and gets what it has not.
        run: does the work.
        progress: receives the number of bytes that were read.

    Raises:
        CommandError: the directory holds something already, or no dataset to add to; or it cannot be written.
    """
    shown = plain(str(directory))
    try:
        directory.mkdir(parents=True, exist_ok=True)
        with _locked(directory):
            before = _manifest_before(directory, is_adding=is_adding)
            return _export(
                _as_called_before(before, logs, shown), directory, wanted, faults, before, run, progress
            )
    except OSError as error:
        raise CommandError(f"cannot write {shown}: {error.strerror or error}") from error


def _export(
    logs: Sequence[LogFile],
    directory: Path,
    wanted: ExportRange,
    faults: Faults,
    before: Manifest,
    run: Runner,
    progress: Progress,
) -> Exported:
    hashes = {log: sha256_of(log.path, log.bytes) for log in logs}
    known = {one.sha256 for one in before.inputs}
    new: dict[str, LogFile] = {}
    for log in logs:
        if hashes[log] not in known:
            new.setdefault(hashes[log], log)
    staging = Path(tempfile.mkdtemp(prefix=_STAGING_PREFIX, dir=directory)).absolute()
    try:
        new_logs, names = list(new.values()), TopicNames()
        tasks = [
            ExportTask(log, sha256, overlapping(log, new_logs[:place], names), staging, wanted)
            for place, (sha256, log) in enumerate(new.items())
        ]
        outcomes = list(run(export_log, tasks, progress))
        files = [_move(staging, directory, part) for outcome in outcomes for part in outcome.parts]
        schemas = dict(before.schemas)
        for outcome in outcomes:
            schemas |= outcome.schemas
        inputs = [outcome.input for outcome in outcomes]
        write_manifest(
            directory,
            msgspec.structs.replace(
                before,
                product=f"cruiser-gateway {version('cruiser-gateway')}",
                inputs=before.inputs + inputs,
                files=before.files + files,
                schemas=schemas,
            ),
        )
    finally:
        shutil.rmtree(staging, ignore_errors=True)
    for one in inputs:
        for fault in one.faults:
            faults.add(fault)
        faults.count += one.fault_count - len(one.faults)
    were_known = [plain(str(log.path)) for log in logs if hashes[log] in known]
    return Exported(plain(str(directory)), inputs, files, were_known)


@contextmanager
def _locked(directory: Path) -> Generator[None, None, None]:
    """One export at a time."""
    place = os.open(directory, os.O_RDONLY)
    try:
        fcntl.flock(place, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    except BlockingIOError:
        raise CommandError(f"another export writes into {plain(str(directory))}") from None
    finally:
        os.close(place)


def _manifest_before(directory: Path, *, is_adding: bool) -> Manifest:
    """Return the manifest of a dataset to add to, or an empty one. An unfinished export is not in it."""
    found = read_manifest(directory)
    shown = plain(str(directory))
    if found is not None:
        if not is_adding:
            raise CommandError(f"{shown} is a dataset already: --add adds to it, nothing is overwritten")
        return found
    if any(not path.name.startswith(".") for path in directory.iterdir()):
        raise CommandError(f"{shown} is not empty, and no dataset: it has no {MANIFEST_NAME}")
    return Manifest(FORMAT, VERSION, "", [], [], {})


def _as_called_before(before: Manifest, logs: Sequence[LogFile], shown: str) -> list[LogFile]:
    """The logs, whose robots are called as in the dataset: with their roots if they are so there.

    Raises:
        CommandError: one of them has the name of another root's that is there by its name alone.
    """
    of_parts = [(keys.parse(key_of(part.topic)[0]), part.robot) for part in before.files if part.robot]
    there = {(parts.root, parts.robot): called for parts, called in of_parts if parts is not None}
    with_root = frozenset(name for (_, name), called in there.items() if called != name)
    for root, name in sorted({robot for log in logs for robot in log.robots} - there.keys()):
        for (other_root, other), called in there.items():
            if other == name == called:
                raise CommandError(
                    f"{shown} holds {other_root}/{name} by its name alone, and these logs hold {root}/{name}: "
                    "export all of them together, or these into a dataset of their own"
                )
    return [msgspec.structs.replace(log, namesakes=log.namesakes | with_root) for log in logs]


def _move(staging: Path, directory: Path, part: Part) -> Part:
    """To its place in the dataset, under another number if an export that was killed left a file there."""
    path, number = part.path, 0
    (directory / path).parent.mkdir(parents=True, exist_ok=True)
    # Nobody else moves anything here: the directory is locked.
    while (directory / path).exists():
        number += 1
        path = f"{part.path.removesuffix('.parquet')}.{number}.parquet"
    (staging / part.path).rename(directory / path)
    return msgspec.structs.replace(part, path=path)
