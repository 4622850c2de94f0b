"""The directory of keys, certificates and grants. Pure, and without what it takes to read them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import PurePath
from typing import Final

from schemas.settings import AuthoritySettings

AUTO: Final = "auto"


def directory_of(settings: AuthoritySettings, environment: Mapping[str, str], home: PurePath) -> PurePath:
    """The directory that the settings name; auto is ``$XDG_CONFIG_HOME/cruiser``, or ``~/.config/cruiser``."""
    if settings.directory != AUTO:
        return PurePath(settings.directory)
    configured = environment.get("XDG_CONFIG_HOME", "")
    return (PurePath(configured) if configured else home / ".config") / "cruiser"
