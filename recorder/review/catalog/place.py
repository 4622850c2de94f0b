"""The catalog of a place in an object store: the rows that lie beside its logs; gathered in one object if many.

No log is read but one whose row is missing, damaged or of another log: then a copy of it, from beginning to end.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import msgspec
import pyarrow as pa
import pyarrow.compute as pc

from recorder.disk.log_directory import SUFFIX
from recorder.objects.address import StoreAddress, shown_url
from recorder.objects.interface import Objects, StoreError
from recorder.reading.faults import Faults
from recorder.reading.rows import Progress
from recorder.review.catalog.known import CATALOG_NAME
from recorder.review.catalog.rows import CatalogRow, CatalogUnreadableError
from recorder.review.catalog.single import read_row, row_of
from recorder.review.catalog.table import SCHEMA, read_former_row, read_stream, to_table, write_stream
from recorder.upload.manifest import FORMER_ROW_SUFFIX, ROW_SUFFIX
from schemas.exit_codes import CommandError, ExitCode
from schemas.printable import plain

AT_ONCE: Final = 16
"""Rows that are asked for at the same time."""

GATHERED_FROM: Final = 50
"""As many rows that were read one by one are gathered into one object, for the next time."""

CATALOG_MAX: Final = 512 * 1024 * 1024
ROW_MAX: Final = 16 * 1024 * 1024
"""Longer objects are no catalog, and no row."""

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
        is_anew: believe no row that is there.

    Attributes:
        stale: the logs that have to be read, and ``stale_bytes`` their length.
        being_written: always empty: a store shows a log when it is whole.
        notes: lines for people.

    Raises:
        CommandError: the store does not answer, or lists nothing.
    """

    def __init__(
        self, objects: Objects, place: StoreAddress, columns: Sequence[str], *, is_anew: bool = False
    ) -> None:
        self.notes: list[str] = []
        self.being_written: list[Path] = []
        self._objects = objects
        self._place = place
        self._columns = list(columns)
        with self._reachable(place.url):
            if not place.has_list:
                text = f"find cannot ask {shown_url(place.url)}: such a server does not list what it holds"
                raise CommandError(text, ExitCode.USAGE)
            listed = {one.name: one.bytes for one in objects.names()}
        self._logs = {name: size for name, size in listed.items() if name.endswith(SUFFIX)}
        self._tables = [] if is_anew else self._gathered(listed)
        known = {name for table in self._tables for name in table.column("file").to_pylist()}
        single: dict[str, str] = {}
        for name in sorted(self._logs.keys() - known) if not is_anew else ():
            rows = [name + suffix for suffix in (ROW_SUFFIX, FORMER_ROW_SUFFIX) if name + suffix in listed]
            if rows:
                single[name] = rows[0]
        with self._reachable(place.url):
            found = self._singles([(name, row, listed[row]) for name, row in single.items()])
        self._tables += [table for table in found if table is not None]
        known |= {name for name, table in zip(single, found, strict=True) if table is not None}
        self._read_singly = len(single)
        self.stale = [name for name in sorted(self._logs) if name not in known]

    @property
    def stale_bytes(self) -> int:
        """The length of all logs that have to be read."""
        return sum(self._logs[name] for name in self.stale)

    @property
    def table(self) -> pa.Table:
        """The wanted columns of the rows, by the logs' beginning. After ``refresh``."""
        return self._whole().select(self._columns)

    def refresh(self, faults: Faults, progress: Progress = lambda _: None) -> None:
        """Read the logs that have no row, and gather the rows if that is worth it.

        What was found is gathered also where the reading is interrupted.

        Args:
            faults: takes the logs that cannot be read.
            progress: receives the number of bytes that were read.
        """
        made: list[CatalogRow] = []
        if self.stale:
            url = shown_url(self._place.url)
            self.notes.append(f"{len(self.stale)} logs of {url} had no row that holds: they were read")
        try:
            while self.stale:
                try:
                    made.append(self._made(self.stale[0], progress))
                except CommandError as error:
                    if error.code in {ExitCode.PARTIAL, ExitCode.UNREACHABLE}:
                        raise
                    faults.add(str(error))
                self.stale.pop(0)
        finally:
            if made:
                self._tables.append(to_table(made))
            if made or self._read_singly >= GATHERED_FROM:
                self._gather()

    def _whole(self) -> pa.Table:
        table = pa.concat_tables([SCHEMA.empty_table(), *self._tables])
        return table.sort_by([("start_ns", "ascending"), ("file", "ascending")]).combine_chunks()

    def _gathered(self, listed: dict[str, int]) -> list[pa.Table]:
        """The rows of the gathered catalog that hold."""
        if not 0 < listed.get(CATALOG_NAME, 0) <= CATALOG_MAX:
            return []
        url = self._place.join(CATALOG_NAME).url
        try:
            table = read_stream(BytesIO(self._bytes(CATALOG_NAME)))
        except (StoreError, CatalogUnreadableError) as error:
            self.notes.append(f"{shown_url(url)}: {error}: the rows beside the logs are read instead")
            return []
        sizes = [self._logs.get(name) for name in table.column("file").to_pylist()]
        return [table.filter(pc.equal(table.column("bytes"), pa.array(sizes, pa.int64())))]

    def _singles(self, rows: Sequence[tuple[str, str, int]]) -> list[pa.Table | None]:
        """The rows of logs, by object and its length; some at a time, for each is a request or two."""
        pool = ThreadPoolExecutor(AT_ONCE)
        try:
            fetched = pool.map(lambda one: self._fetched(*one[1:]), rows)
            # Read one after the other: the bound on what one unpacks to is the process's.
            return [self._single(name, row, data) for (name, row, _), data in zip(rows, fetched, strict=True)]
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

    def _single(self, name: str, row: str, data: bytes | None) -> pa.Table | None:
        """The row beside a log, under the log's name; None if it does not hold."""
        if data is None:
            return None
        try:
            if row.endswith(ROW_SUFFIX):
                return to_table([msgspec.structs.replace(read_row(data, self._logs[name]), file=name)])
            table = read_former_row(data, self._logs[name])
        except CatalogUnreadableError:
            return None
        return table.set_column(table.schema.get_field_index("file"), SCHEMA.field("file"), pa.array([name]))

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
        url = self._place.join(name).url
        with TemporaryDirectory() as directory, self._reachable(url):
            path = Path(directory) / "log.mcap"
            if name.endswith(f".incident{SUFFIX}"):
                path = path.with_name("log.incident.mcap")
            found = self._objects.look(name)
            if found is None:
                raise CommandError(f"cannot read {shown_url(url)}: there is no such object")
            with path.open("wb") as copy:
                for start in range(0, found.bytes, PIECE_BYTES):
                    end = min(start + PIECE_BYTES, found.bytes)
                    copy.write(self._objects.read(name, start, end, found.e_tag))
                    progress(end - start)
            try:
                return row_of(path, name, 0)
            except CommandError as error:
                raise CommandError(str(error).replace(plain(str(path)), shown_url(url))) from error

    def _gather(self) -> None:
        stream = BytesIO()
        write_stream(stream, self._whole())
        try:
            self._objects.write(CATALOG_NAME, stream.getvalue())
        except StoreError as error:
            url = shown_url(self._place.join(CATALOG_NAME).url)
            self.notes.append(f"cannot write {url}: {error}; what was read is read again next time")

    @contextmanager
    def _reachable(self, url: str) -> Iterator[None]:
        try:
            yield
        except StoreError as error:
            raise CommandError(f"cannot read {shown_url(url)}: {error}", ExitCode.UNREACHABLE) from error
        except OSError as error:
            raise CommandError(f"cannot copy {shown_url(url)}: {error.strerror or error}") from error
