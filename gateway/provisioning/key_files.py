"""The keys and grants of this machine: the files that ``cruiser provision`` made, read and checked.

A private key is its owner's alone: a file that others may read is refused. Everything that is wrong is one line
that names the file and the cure.
"""

from __future__ import annotations

import os
from pathlib import Path

from gateway.provisioning.key_store import find
from schemas.authority import identity
from schemas.authority.identity import AUTHORITY_FILE, GRANT_FILE, KEY_FILE, Identity
from schemas.authority.trust import Trust
from schemas.settings import AuthoritySettings


def directory_of(settings: AuthoritySettings) -> Path:
    """The directory that the settings name; auto is ``$XDG_CONFIG_HOME/cruiser``, or ``~/.config/cruiser``."""
    return Path(identity.directory_of(settings, os.environ, Path.home()))


def read_identity(directory: Path, who: str) -> Identity:
    """Read the key and the grant of somebody, and check that they belong together.

    Args:
        directory: their place.
        who: ``robot``, ``operator``, ``recorder``: the files' name.

    Raises:
        CommandError: a file is missing, unreadable, readable for others, or not what it should be.
    """
    key = find(directory / KEY_FILE.format(who=who), identity.made(who))
    grant, authority = (
        find(directory / name.format(who=who), identity.installed(who)) for name in (GRANT_FILE, AUTHORITY_FILE)
    )
    return identity.identity_of(key, grant, authority, who)


def read_trust(directory: Path, who: str = "viewer") -> Trust:
    """Read the keys of the fleet's authority, as somebody in this role has them.

    Raises:
        CommandError: the file is missing, unreadable or damaged.
    """
    return identity.trust_of(find(directory / AUTHORITY_FILE, identity.installed(who)), who)
