"""A part of a log, as a log."""

from __future__ import annotations

from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import Path

from recorder.reading.faults import Faults
from recorder.reading.log_file import LogFile
from recorder.reading.rows import Progress
from recorder.review.info import CUT_NAME
from recorder.review.joining.joining import Joined, JoinRange, join


def cut(
    logs: Sequence[LogFile],
    path: Path,
    period: tuple[int, int],
    topics: Sequence[str],
    faults: Faults,
    progress: Progress = lambda _: None,
) -> Joined:
    """Write the messages of a time and of some topics into a new file, with all metadata and attachments.

    Args:
        logs: in the order of their beginnings, as ``find_logs`` gives them.
        path: the new file.
        period: the first log time, in nanoseconds since 1970, and the first one that is too late.
        topics: patterns, as a shell has them; ``*`` matches any part of a topic. None for all topics.
        faults: takes what cannot be read; all the rest is in the file.
        progress: is told of bytes that were read.

    Raises:
        CommandError: the file is there already, or cannot be written.
    """
    from_ns, to_ns = period
    about = {
        "files": ",".join(log.path.name for log in logs),
        "from_ns": str(from_ns),
        "to_ns": str(to_ns),
        "topics": " ".join(topics),
    }

    def is_wanted(topic: str) -> bool:
        return not topics or any(fnmatchcase(topic, pattern) for pattern in topics)

    return join(logs, path, JoinRange(is_wanted, from_ns, to_ns), (CUT_NAME, about), faults, progress)
