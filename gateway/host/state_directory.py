"""The directory of what outlives a restart of the gateway."""

from __future__ import annotations

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
