"""The tables of a dataset's Parquet files."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

import duckdb
import pyarrow as pa

from recorder.review.columns.tables import HEAD, ROBOT, TOPIC
from recorder.review.export.manifest import Manifest, Part, described
from recorder.review.querying.tables import WHOSE, TableInfo, free_name, own_columns, shown


class DatasetSource:
    """Tables of a dataset's Parquet files.

    Args:
        directory: of the dataset.
        manifest: its own.
    """

    def __init__(self, directory: Path, manifest: Manifest) -> None:
        self._directory = directory.absolute()
        self._manifest = manifest
        self._parts: dict[str, list[Part]] = {}
        own = {(name, described(columns.schema)[0]) for name, columns in own_columns().items()}
        names: dict[tuple[str, str], str] = {}
        # Our own subjects have their names before others.
        for part in sorted(manifest.files, key=lambda part: (part.table, part.columns) not in own):
            key = part.table, part.columns
            if key not in names:
                is_own = key in own or self._is_like(part)
                taken = self._parts if is_own else {*self._parts, *own_columns()}
                names[key] = free_name(part.table, taken)
            self._parts.setdefault(names[key], []).append(part)

    def _is_like(self, part: Part) -> bool:
        """Report whether a table is of a subject of ours, as another version had it: it has fields in common."""
        own = own_columns().get(part.table)
        names = {column.name for column in self._manifest.schemas.get(part.columns, [])}
        return own is not None and bool(names & set(own.schema.names[len(HEAD) :]))

    @property
    def directories(self) -> list[str]:
        """Return the directory of its files, as DuckDB sees it before and after it looks for patterns."""
        return [str(self._directory), _unglobbed(str(self._directory))]

    @property
    def tables(self) -> list[TableInfo]:
        """Return the tables of the dataset."""
        return [
            TableInfo(
                name,
                sorted({part.topic for part in parts}),
                shown([*described(pa.schema(WHOSE))[1], *self._manifest.schemas.get(parts[0].columns, [])]),
            )
            for name, parts in sorted(self._parts.items())
        ]

    def declare(self, connection: duckdb.DuckDBPyConnection, names: Collection[str]) -> None:
        """Make the named tables known, or all if none is named; and those of our own subjects that are empty."""
        for name, columns in own_columns().items():
            if name not in self._parts:
                connection.register(name, pa.schema([*WHOSE, *columns.schema]).empty_table())
        for name, parts in self._parts.items():
            # Looking into files costs time; but where a name is unknown, DuckDB knows one that is like it.
            if names and name not in names and all(one in self._parts or one in own_columns() for one in names):
                continue
            files = ", ".join(_quoted(_unglobbed(str(self._directory / part.path))) for part in parts)
            # The names are made of letters, digits and lines; the files are quoted.
            connection.execute(
                f'CREATE VIEW "{name}" AS SELECT {ROBOT}, {TOPIC}, * EXCLUDE ({TOPIC}, {ROBOT}, date) '  # noqa: S608
                f"FROM read_parquet([{files}], hive_partitioning = true, hive_types_autocast = false)"
            )


def _quoted(text: str) -> str:
    return "'" + text.replace("'", "''") + "'"


def _unglobbed(path: str) -> str:
    """A path in which DuckDB sees no pattern."""
    return "".join(f"[{letter}]" if letter in "*?[" else letter for letter in path)
