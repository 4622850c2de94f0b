"""Logs on this machine, read message by message; unreadable parts are left out, and reported."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path

from recorder.disk.log_directory import PART_SUFFIX, SUFFIX
from recorder.mcap.channel import LogChannel
from recorder.mcap.log_map import LogMap
from recorder.mcap.reader import LoggedMessage

Take = Callable[[dict[int, LogChannel], Iterable[LoggedMessage]], None]
"""Takes the channels and the messages of one log."""


class OwnLogs:
    """Logs, and those that are in directories, whole or not.

    Attributes:
        paths: those that can be read.
        unread: the others, and why.
    """

    def __init__(self, paths: Sequence[Path]) -> None:
        self.paths: list[Path] = []
        self.unread: list[str] = []
        self._charts: dict[Path, LogMap] = {}
        for path in dict.fromkeys(_spread(paths)):
            chart = LogMap()
            try:
                with path.open("rb") as stream:
                    chart.read_on(stream, os.fstat(stream.fileno()).st_size)
            except OSError as error:
                self._leave_out(path, error)
                continue
            self.paths.append(path)
            self._charts[path] = chart

    def each(self, take: Take) -> None:
        """Hand over every log."""
        for path in list(self.paths):
            chart = self._charts[path]
            try:
                with path.open("rb") as stream:
                    take(chart.channels, chart.messages(stream))
            except OSError as error:
                self._leave_out(path, error)
                self.paths.remove(path)

    def directory(self, prefix: str) -> Path:
        """The directory of a log with topics that begin so; else that of the first log."""
        fitting = (
            path
            for path in self.paths
            if any(channel.topic.startswith(prefix) for channel in self._charts[path].channels.values())
        )
        return next(fitting, self.paths[0]).parent

    @property
    def faults(self) -> list[str]:
        """Return a line for people for each log, or part of one, that could not be read."""
        damaged = [(path, self._charts[path].damaged) for path in self.paths]
        return self.unread + [f"{path}: {count} damaged places were skipped" for path, count in damaged if count]

    def _leave_out(self, path: Path, error: OSError) -> None:
        self.unread.append(f"{path}: {error.strerror or error}")


def _spread(paths: Sequence[Path]) -> Iterator[Path]:
    for path in paths:
        if path.is_dir():
            yield from sorted([*path.glob(f"*{SUFFIX}"), *path.glob(f"*{PART_SUFFIX}")])
        else:
            yield path
