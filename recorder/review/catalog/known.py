"""A log that need not be opened, as a catalog says; known without the libraries that read catalogs."""

from __future__ import annotations

from typing import Final

import msgspec

from recorder.reading.log_file import LogFile
from recorder.review.info import LogBrief

CATALOG_NAME: Final = "catalog.parquet"
"""The catalog in the directory of its logs."""


class CatalogedLog(msgspec.Struct, frozen=True):
    """A log that is as the catalog says.

    Attributes:
        is_covered: None where logs of the catalog have changed or gone since.
    """

    log: LogFile
    is_covered: bool | None
    brief: LogBrief
