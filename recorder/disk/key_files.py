"""The keys and grants of this machine, read and checked: see ``schemas.authority.identity``."""

from __future__ import annotations

import os
from pathlib import Path

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from schemas.authority import identity
from schemas.authority.identity import AUTHORITY_FILE, GRANT_FILE, KEY_FILE, FoundFile, Identity
from schemas.authority.trust import Trust
from schemas.settings import AuthoritySettings

KEY_CURE = "'openssl genpkey -algorithm ed25519' makes one"


def read_identity(settings: AuthoritySettings, who: str) -> Identity:
    """Read the key and the grant of somebody out of the directory that the settings name.

    Raises:
        CommandError: a file is missing, unreadable, readable for others, or not what it should be.
    """
    directory = Path(identity.directory_of(settings, os.environ, Path.home()))
    key, grant, authority = (
        _found(directory / name.format(who=who), identity.again(who))
        for name in (KEY_FILE, GRANT_FILE, AUTHORITY_FILE)
    )
    return identity.identity_of(key, grant, authority, who)


def read_trust(settings: AuthoritySettings, who: str) -> Trust:
    """Read the fleet's authority out of the directory that the settings name.

    Raises:
        CommandError: the file is missing, unreadable, or no authority's.
    """
    path = Path(identity.directory_of(settings, os.environ, Path.home())) / AUTHORITY_FILE
    return identity.trust_of(_found(path, identity.again(who)), who)


def read_private_key(path: Path) -> Ed25519PrivateKey:
    """Read a private key from a file of its own.

    Raises:
        CommandError: it is missing, unreadable, readable for others, or no Ed25519 key.
    """
    return identity.private_key(_found(path, KEY_CURE), KEY_CURE)


def _found(path: Path, cure: str) -> FoundFile:
    try:
        with path.open("rb") as file:
            status = os.fstat(file.fileno())
            return FoundFile(path, file.read(), status.st_mode, status.st_uid in {0, os.geteuid()})
    except OSError as error:
        raise identity.not_found(path, error, cure) from error
