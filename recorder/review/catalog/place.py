"""The catalog of a place in an object store: the rows that lie beside its logs.

No log is read but one whose row is missing, damaged or of another log: then a copy of it, from beginning to end.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import msgspec
import pyarrow as pa

from recorder.disk.log_names import SUFFIX
from recorder.objects.address import StoreAddress, shown_url
from recorder.objects.cache import LogCache
from recorder.objects.interface import Objects, StoreError
from recorder.reading.faults import Faults
from recorder.reading.rows import Progress
from recorder.review.catalog.rows import CatalogRow, CatalogUnreadableError
from recorder.review.catalog.single import read_row, row_of
from recorder.review.catalog.table import to_table
from recorder.upload.manifest import ROW_SUFFIX
from schemas.command_line import CommandError, ExitCode, plain

AT_ONCE: Final = 16
"""Rows that are asked for at the same time."""

ROW_MAX: Final = 16 * 1024 * 1024
"""A longer object is no row."""

PIECE_BYTES: Final = 4 * 1024 * 1024


class _GoneError(StoreError):
    """An object of a list is not there."""


class PlaceCatalog:
    """The catalog of a place, as far as its rows hold; ``refresh`` adds the rest.

    A row holds for a log of the same name and length: nobody overwrites a log of an upload.

    Args:
        objects: of the place.
        place: its address.
        columns: those of ``CatalogRow`` that are wanted.
        cache: fetches the logs that have no row.
        is_anew: believe no row that is there.

    Attributes:
        stale: the logs that have to be read, and ``stale_bytes`` their length.
        being_written: always empty: a store shows a log when it is whole.
        notes: lines for people.

    Raises:
        CommandError: the store does not answer, or lists nothing.
    """

    def __init__(
        self,
        objects: Objects,
        place: StoreAddress,
        columns: Sequence[str],
        cache: LogCache,
        *,
        is_anew: bool = False,
    ) -> None:
        self.notes: list[str] = []
        self.being_written: list[Path] = []
        self._objects = objects
        self._place = place
        self._cache = cache
        self._columns = list(columns)
        with self._reachable(place.url):
            if not place.has_list:
                text = f"find cannot ask {shown_url(place.url)}: such a server does not list what it holds"
                raise CommandError(text, ExitCode.USAGE)
            listed = {one.name: one.bytes for one in objects.names()}
        self._logs = {name: size for name, size in listed.items() if name.endswith(SUFFIX)}
        single = [] if is_anew else [name for name in sorted(self._logs) if name + ROW_SUFFIX in listed]
        with self._reachable(place.url):
            found = self._singles([(name, listed[name + ROW_SUFFIX]) for name in single])
        self._rows = [row for row in found if row is not None]
        known = {row.file for row in self._rows}
        self.stale = [name for name in sorted(self._logs) if name not in known]

    @property
    def stale_bytes(self) -> int:
        """The length of all logs that have to be read."""
        return sum(self._logs[name] for name in self.stale)

    @property
    def table(self) -> pa.Table:
        """The wanted columns of the rows, by the logs' beginning. After ``refresh``."""
        table = to_table(self._rows).sort_by([("start_ns", "ascending"), ("file", "ascending")])
        return table.select(self._columns).combine_chunks()

    def refresh(
        self,
        faults: Faults,
        progress: Progress = lambda _: None,
        in_time: Callable[[int, Progress], Progress] = lambda _, progress: progress,
    ) -> None:
        """Read copies of the logs that have no row.

        Args:
            faults: takes the logs that cannot be read, or not in time.
            progress: receives the number of bytes that were fetched.
            in_time: makes the progress of one log of so many bytes, which may give it up.
        """
        if self.stale:
            url = shown_url(self._place.url)
            self.notes.append(f"{len(self.stale)} logs of {url} had no row that holds: they were read")
        while self.stale:
            name = self.stale[0]
            try:
                self._rows.append(self._made(name, in_time(self._logs[name], progress)))
            except CommandError as error:
                if error.code is ExitCode.UNREACHABLE:
                    raise
                faults.add(f"{name}: {error}" if error.code is ExitCode.PARTIAL else str(error))
            self.stale.pop(0)

    def _singles(self, logs: Sequence[tuple[str, int]]) -> list[CatalogRow | None]:
        """The rows of logs, by name and the row's length; some at a time, for each is a request or two."""
        pool = ThreadPoolExecutor(AT_ONCE)
        try:
            fetched = pool.map(lambda one: self._fetched(one[0] + ROW_SUFFIX, one[1]), logs)
            # Read one after the other: the bound on what one unpacks to is the process's.
            return [self._single(name, data) for (name, _), data in zip(logs, fetched, strict=True)]
        finally:
            # A store that is gone is not asked for each.
            pool.shutdown(cancel_futures=True)

    def _fetched(self, row: str, size: int) -> bytes | None:
        """The object of a row; None if it is gone, or longer than any row."""
        if size > ROW_MAX:
            return None
        try:
            return self._bytes(row)
        except _GoneError:
            return None

    def _single(self, name: str, data: bytes | None) -> CatalogRow | None:
        """The row beside a log, under the log's name; None if it does not hold."""
        if data is None:
            return None
        try:
            return msgspec.structs.replace(read_row(data, self._logs[name]), file=name)
        except CatalogUnreadableError:
            return None

    def _bytes(self, name: str) -> bytes:
        """All of a small object. A list may tell its length as it was."""
        found = self._objects.look(name)
        if found is None:
            raise _GoneError("it is gone")
        pieces = [
            self._objects.read(name, start, min(start + PIECE_BYTES, found.bytes), found.e_tag)
            for start in range(0, found.bytes, PIECE_BYTES)
        ]
        return b"".join(pieces)

    def _made(self, name: str, progress: Progress) -> CatalogRow:
        """Make the row of a log, of which a copy is read."""
        path = self._cache.fetch(self._objects, self._place, name, progress)
        try:
            return row_of(path, name, 0)
        except CommandError as error:
            url = shown_url(self._place.join(name).url)
            raise CommandError(str(error).replace(plain(str(path)), url)) from error

    @contextmanager
    def _reachable(self, url: str) -> Iterator[None]:
        try:
            yield
        except StoreError as error:
            raise CommandError(f"cannot read {shown_url(url)}: {error}", ExitCode.UNREACHABLE) from error
        except OSError as error:
            raise CommandError(f"cannot copy {shown_url(url)}: {error.strerror or error}") from error
