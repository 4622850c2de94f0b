"""Several logs in one, in the order of log times."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from recorder.reading.faults import Faults
from recorder.reading.log_file import LogFile
from recorder.reading.rows import Progress
from recorder.review.joining.joining import Joined, JoinRange, join

MERGED_NAME: Final = "cruiser.merged"
"""The metadata record with the names of the files that a merged one is made of."""


def merge(logs: Sequence[LogFile], path: Path, faults: Faults, progress: Progress = lambda _: None) -> Joined:
    """Write all messages of logs into a new file, each once, with all of their metadata and attachments.

    Args:
        logs: in the order of their beginnings, as ``find_logs`` gives them.
        path: the new file.
        faults: takes what cannot be read; all the rest is in the file.
        progress: receives the number of bytes that were read.

    Raises:
        CommandError: the file is there already, or cannot be written.
    """
    about = {"files": ",".join(log.path.name for log in logs)}
    return join(logs, path, JoinRange(), (MERGED_NAME, about), faults, progress)
