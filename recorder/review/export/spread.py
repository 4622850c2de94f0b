"""The export over the cores of this machine, by Daft, or over a cluster: the same function, mapped over logs."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any, Final

import msgspec

from recorder.reading.rows import Progress
from recorder.review.export.dataset import Runner
from recorder.review.export.one_log import ExportOutcome, ExportTask, export_log
from recorder.review.tasks import outcome_of
from schemas.missing_extra import missing_extra

QUIET: Final = {
    "DAFT_ANALYTICS_ENABLED": "0",
    "DAFT_PROGRESS_BAR": "0",
    "DO_NOT_TRACK": "1",
    "SCARF_NO_ANALYTICS": "1",
}
"""Daft reports every import to its makers, unless these are set before."""


def pool_runner(pool: Executor) -> Runner:
    """A runner that has the tasks done by whoever is in a pool, as ``recorder.review.tasks.ray_cluster``."""

    def run(tasks: Sequence[ExportTask], progress: Progress) -> Iterator[ExportOutcome]:
        for future in [pool.submit(export_log, task) for task in tasks]:
            outcome = outcome_of(future, progress)
            progress(outcome.input.bytes)
            yield outcome

    return run


def daft_runner() -> Runner:
    """A runner on Daft.

    Raises:
        CommandError: Daft is not installed.
    """
    os.environ.update(QUIET)
    try:
        import daft  # noqa: PLC0415 - only behind the settings above
    except ImportError:
        raise missing_extra("Daft", "daft") from None
    daft.set_runner_native()
    do_task = daft.func(task_to_outcome, return_dtype=daft.DataType.string(), use_process=True)

    def run(tasks: Sequence[ExportTask], progress: Progress) -> Iterator[ExportOutcome]:
        if not tasks:
            return
        names = ["number", "task"]
        columns = {names[0]: list(range(len(tasks))), names[1]: [encode_task(task) for task in tasks]}
        # One task a partition, or all of them would go to one worker.
        frame = daft.from_pydict(columns).into_batches(1)
        frame = frame.select(daft.col("number"), do_task(daft.col("task")).alias("outcome"))
        outcomes: dict[int, ExportOutcome] = {}
        for row in frame.iter_rows():
            outcome = decode_outcome(row["outcome"])
            outcomes[row["number"]] = outcome
            progress(outcome.input.bytes)
        yield from (outcomes[number] for number in range(len(tasks)))

    return run


def task_to_outcome(task: str) -> str:
    """Do a task: both are JSON."""
    return msgspec.json.encode(export_log(decode_task(task)), enc_hook=str).decode()


def encode_task(task: ExportTask) -> str:
    """A task as JSON."""
    return msgspec.json.encode(task, enc_hook=str).decode()


def decode_task(text: str) -> ExportTask:
    """The task that a JSON text is."""
    return msgspec.json.decode(text, type=ExportTask, dec_hook=_path)


def decode_outcome(text: str) -> ExportOutcome:
    """The outcome that a JSON text is."""
    return msgspec.json.decode(text, type=ExportOutcome)


def _path(_kind: type, text: Any) -> Path:  # noqa: ANN401 - whatever stands in the JSON
    return Path(text)
