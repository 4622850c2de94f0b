"""The row of a log for the catalog, made by a process of its own that can be ended at any time."""

from __future__ import annotations

import asyncio
from asyncio.subprocess import PIPE
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Final

from schemas.command_line import module_command, plain

ROW_S: Final = 600.0
"""Making a row is given up after this time..."""

ROW_S_PER_BYTE: Final = 20e-6
"""...and this much for each byte of the log: 20 s a megabyte, on a robot that has other things to do."""

Summarize = Callable[[Path], Awaitable[bytes]]
"""Makes the row of a log; raises RowError, or OSError where the log is gone."""


class RowError(Exception):
    """The row of a log could not be made: in a line."""


def row_maker(module: str) -> Summarize:
    """Return what runs a module of this Python with a log's path, and takes the row from its standard output."""

    async def summarize(path: Path) -> bytes:
        size = path.stat().st_size  # noqa: ASYNC240 - nothing else runs here, and a log was just read there
        budget_s = ROW_S + ROW_S_PER_BYTE * size
        process = await asyncio.create_subprocess_exec(
            *module_command(module, str(path)), stdout=PIPE, stderr=PIPE
        )
        try:
            row, said = await asyncio.wait_for(process.communicate(), budget_s)
        except TimeoutError:
            raise RowError(f"given up after {budget_s:.0f} s") from None
        finally:
            if process.returncode is None:
                process.kill()
                await process.wait()
        if process.returncode or not row:
            last = plain(said.decode(errors="replace").strip().rpartition("\n")[2])
            raise RowError(last or f"its process ended with {process.returncode}")
        return row

    return summarize
