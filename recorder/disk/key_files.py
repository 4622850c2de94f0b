"""The keys and grants of this machine, read and checked: see ``schemas.authority.identity``."""

from __future__ import annotations

import os
import re
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.x509.oid import NameOID

from schemas.authority import identity
from schemas.authority.identity import AUTHORITY_FILE, GRANT_FILE, KEY_FILE, FoundFile, Identity
from schemas.authority.proof import Grant, StatementFault, read_chain
from schemas.authority.trust import Trust
from schemas.command_line import CommandError, check_regular
from schemas.keys import ROBOT_PATTERN
from schemas.settings import AuthoritySettings

KEY_CURE = "'openssl genpkey -algorithm ed25519' makes one"


def read_identity(settings: AuthoritySettings, who: str) -> Identity:
    """Read the key and the grant of somebody out of the directory that the settings name.

    Raises:
        CommandError: a file is missing, unreadable, readable for others, or not what it should be.
    """
    directory = Path(identity.directory_of(settings, os.environ, Path.home()))
    key = _found(directory / KEY_FILE.format(who=who), identity.made(who))
    grant, authority = (
        _found(directory / name.format(who=who), identity.installed(who)) for name in (GRANT_FILE, AUTHORITY_FILE)
    )
    return identity.identity_of(key, grant, authority, who)


def has_key(settings: AuthoritySettings, who: str) -> bool:
    """Return True if the directory that the settings name holds a key of somebody."""
    directory = Path(identity.directory_of(settings, os.environ, Path.home()))
    return (directory / KEY_FILE.format(who=who)).exists()


def read_trust(settings: AuthoritySettings, who: str) -> Trust:
    """Read the fleet's authority out of the directory that the settings name.

    Raises:
        CommandError: the file is missing, unreadable, or no authority's.
    """
    path = Path(identity.directory_of(settings, os.environ, Path.home())) / AUTHORITY_FILE
    return identity.trust_of(_found(path, identity.installed(who)), who)


def granted_name(settings: AuthoritySettings, who: str) -> str:
    """Return the name under which somebody was provisioned; empty if no grant says so, or in no form of a key.

    It names, and proves nothing: its signature is not looked at.
    """
    path = Path(identity.directory_of(settings, os.environ, Path.home())) / GRANT_FILE.format(who=who)
    try:
        chain = read_chain(_found(path, identity.installed(who)).content)
    except CommandError:
        return ""
    grant = None if isinstance(chain, StatementFault) else chain[0].statement
    name = grant.name if isinstance(grant, Grant) else ""
    return name if re.fullmatch(ROBOT_PATTERN, name) else ""


def read_private_key(path: Path) -> Ed25519PrivateKey:
    """Read a private key from a file of its own.

    Raises:
        CommandError: it is missing, unreadable, readable for others, or no Ed25519 key.
    """
    return identity.private_key(_found(path, KEY_CURE), KEY_CURE)


def certificate_role(path: Path) -> str:
    """The role that the certificate of this machine names; empty where none can be read."""
    try:
        subject = x509.load_pem_x509_certificates(_found(path, "").content)[0].subject
    except (CommandError, ValueError):
        return ""
    return str(next((name.value for name in subject.get_attributes_for_oid(NameOID.COMMON_NAME)), ""))


def _found(path: Path, cure: str) -> FoundFile:
    try:
        check_regular(path, path.stat().st_mode)
        with path.open("rb") as file:
            status = os.fstat(file.fileno())
            return FoundFile(path, file.read(), status.st_mode, status.st_uid in {0, os.geteuid()})
    except OSError as error:
        raise identity.not_found(path, error, cure) from error
