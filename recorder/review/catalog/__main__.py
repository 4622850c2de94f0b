"""The row of a log on the standard output, for who makes it in a process of its own.

Usage: python -m recorder.review.catalog LOG

Its place and name are Python's rule.
"""

from __future__ import annotations

import sys
from pathlib import Path

from recorder.review.catalog.log_row import write_row
from schemas.command_line import CommandError


def main() -> int:
    """Write the row; an exit code that is not 0 says on the standard error why there is none."""
    path = Path(sys.argv[1])
    try:
        row = write_row(path, path.name, path.stat().st_mtime_ns)
    except (CommandError, OSError) as error:
        sys.stderr.write(f"{error}\n")
        return 1
    sys.stdout.buffer.write(row)
    return 0


if __name__ == "__main__":
    sys.exit(main())
