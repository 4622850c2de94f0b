"""``cruiser`` on a path, as after an installation: other tests run the commands of pages and scripts with it."""

import shlex
import sys
from pathlib import Path


def install(directory: Path) -> Path:
    """Put a program ``cruiser`` there. Returns the directory."""
    directory.mkdir(exist_ok=True)
    cruiser = directory / "cruiser"
    cruiser.write_text(f'#!/bin/sh\nexec {shlex.quote(sys.executable)} -m gateway "$@"\n', encoding="utf-8")
    cruiser.chmod(0o755)
    return directory
