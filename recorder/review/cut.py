"""A part of a log, as a log."""

from __future__ import annotations

from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import Path

from recorder.reading.faults import Faults
from recorder.reading.log_file import LogFile
from recorder.reading.rows import Progress, Selection
from recorder.review.info import CUT_NAME
from recorder.review.joining.joining import Joined, JoinRange, join


def cut(
    logs: Sequence[LogFile],
    path: Path,
    selection: Selection,
    topics: Sequence[str],
    faults: Faults,
    progress: Progress = lambda _: None,
) -> Joined:
    """Write the messages of a time and of some topics into a new file, with all metadata and attachments.

    Args:
        logs: in the order of their beginnings, as ``find_logs`` gives them.
        path: the new file.
        selection: its log times are wanted; what topics are, the patterns say.
        topics: patterns, as a shell has them; ``*`` matches any part of a topic. None for all topics.
        faults: takes what cannot be read; all the rest is in the file.
        progress: receives the number of bytes that were read.

    Raises:
        CommandError: the file is there already, or cannot be written, or no topic is of the patterns.
    """
    about = {
        "files": ",".join(log.path.name for log in logs),
        "from_ns": str(selection.from_ns),
        "to_ns": str(selection.to_ns),
        "topics": " ".join(topics),
    }

    def is_wanted(topic: str) -> bool:
        return any(fnmatchcase(topic, pattern) for pattern in topics)

    wanted = JoinRange(is_wanted if topics else None, selection.from_ns, selection.to_ns)
    return join(logs, path, wanted, (CUT_NAME, about), faults, progress)
