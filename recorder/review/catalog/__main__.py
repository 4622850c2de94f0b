"""Write the row of a log to the standard output. A process of its own keeps the uploader small.

Usage: python -m recorder.review.catalog LOG
"""

from __future__ import annotations

import sys
from pathlib import Path

from recorder.review.catalog.log_row import write_row
from schemas.command_line import CommandError


def main() -> int:
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
