"""Where figures come from: command, commit and machine."""

from __future__ import annotations

import os
import platform
import subprocess
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).parents[2]


def heading(words: list[str], seconds: float) -> str:
    """Where the figures come from: command, commit and machine."""
    machine = f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    return f"{' '.join(['python -m tests.bench', *words])} at {commit()}; {machine}; each load {seconds:g} s"


def commit(root: Path = ROOT) -> str:
    """The commit of the checkout, "-dirty" where files differ from it; words where there is no checkout."""
    command = ["git", "-C", str(root), "describe", "--always", "--dirty"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return "no commit"
