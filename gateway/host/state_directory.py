"""The directory of what outlives a restart of the gateway, and the way in which its files are written."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Final

AUTO: Final = "auto"


def state_directory(setting: str, environment: Mapping[str, str]) -> Path | None:
    """The directory that ``gateway.state_dir`` names; None if there is none.

    Auto is ``$STATE_DIRECTORY``, which systemd sets, else ``$XDG_STATE_HOME/cruiser``, else
    ``~/.local/state/cruiser``.
    """
    if setting != AUTO:
        return Path(setting) if setting else None
    given = environment.get("STATE_DIRECTORY", "").partition(":")[0]
    if given:
        return Path(given)
    state = environment.get("XDG_STATE_HOME", "")
    home = environment.get("HOME", "")
    if state.startswith("/"):
        return Path(state) / "cruiser"
    return Path(home) / ".local" / "state" / "cruiser" if home else None


def write_whole(path: Path, content: bytes) -> None:
    """Write a file that is there as it was or as it is now, whatever happens meanwhile. Makes its directory.

    Raises:
        OSError: it cannot be written; it is as it was.
    """
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    unfinished = path.with_suffix(".unfinished")
    descriptor = os.open(unfinished, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW, 0o600)
    with os.fdopen(descriptor, "wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    unfinished.replace(path)
    sync_directory(path.parent)


def sync_directory(directory: Path) -> None:
    """Have the disk hold which files a directory has: a power cut undoes no change of before."""
    descriptor = os.open(directory, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
