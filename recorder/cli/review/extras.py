"""What an answer needs that is not installed with the product: one line says what to install."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from typing import Final

from schemas.exit_codes import CommandError

_LIBRARIES: Final = {"daft", "duckdb", "numpy", "ptars", "pyarrow", "ray"}


@contextmanager
def needing_extra(extra: str) -> Generator[None, None, None]:
    """Around an import of what an extra brings.

    Raises:
        CommandError: it is missing.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        name = (error.name or "").partition(".")[0]
        if name not in _LIBRARIES:
            raise
        raise CommandError(f"this needs {name}: pip install 'cruiser-gateway[{extra}]'") from None
