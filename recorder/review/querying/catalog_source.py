"""The rows of catalogs as one table, a row a log."""

from __future__ import annotations

from collections.abc import Collection
from typing import Final

import duckdb
import pyarrow as pa

from recorder.review.querying.tables import TableInfo

CATALOG: Final = "catalog"
"""The table's name."""


class CatalogSource:
    """A table of catalogs' rows."""

    directories: Final[list[str]] = []
    tables: Final[list[TableInfo]] = []

    def __init__(self, rows: pa.Table) -> None:
        self._rows = rows

    def declare(self, connection: duckdb.DuckDBPyConnection, _names: Collection[str]) -> None:
        """Make the table known."""
        connection.register(CATALOG, self._rows)
