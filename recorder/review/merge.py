"""Several logs in one, in the order of log times."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from recorder.reading.faults import Faults
from recorder.reading.log_file import LogFile
from recorder.reading.rows import Progress
from recorder.reading.times import in_words
from recorder.review.joining.joining import Joined, JoinRange, join

MERGED_NAME: Final = "cruiser.merged"
"""The metadata record with the names of the files that a merged one is made of, and what of it nobody recorded."""


def merge(logs: Sequence[LogFile], path: Path, faults: Faults, progress: Progress = lambda _: None) -> Joined:
    """Write all messages of logs into a new file, each once, with all of their metadata and attachments.

    Args:
        logs: in the order of their beginnings, as ``find_logs`` gives them; with what fills their holes, as
            ``filled`` gives them, that goes into the file too, on topics of its own.
        path: the new file.
        faults: takes what cannot be read; all the rest is in the file.
        progress: receives the number of bytes that were read.

    Raises:
        CommandError: the file is there already, or cannot be written.
    """
    about = {"files": ",".join(log.path.name for log in logs if not log.is_reconstructed)}
    made = [f"{in_words(log.start_ns)} to {in_words(log.end_ns)}" for log in logs if log.is_reconstructed]
    if made:
        about["reconstructed"] = ", ".join(made)
    return join(logs, path, JoinRange(), (MERGED_NAME, about), faults, progress)
