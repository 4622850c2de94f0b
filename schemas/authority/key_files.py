"""Read the keys, certificates and grants of this machine. What they must hold: ``schemas.authority.identity``."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Final

from cryptography import x509
from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.x509.oid import NameOID

from schemas import configuration
from schemas.authority import identity
from schemas.authority.identity import AUTHORITY_FILE, GRANT_FILE, KEY_FILE, FoundFile, Identity
from schemas.authority.proof import Grant, StatementFault, read_chain
from schemas.authority.trust import Trust
from schemas.command_line import CommandError, ExitCode, check_regular, plain
from schemas.keys import ROBOT_PATTERN
from schemas.settings import AuthoritySettings

FILE_MAX_BYTES: Final = 4_000_000


def directory_of(settings: AuthoritySettings) -> Path:
    """The directory that the settings name; auto is ``$XDG_CONFIG_HOME/cruiser``, or ``~/.config/cruiser``."""
    return Path(configuration.directory_of(settings, os.environ, Path.home()))


def find(path: Path, cure: str = "") -> FoundFile:
    """A file, which is not large, with what it takes to judge whose it is."""
    try:
        check_regular(path, path.stat().st_mode)
        with path.open("rb") as file:
            status = os.fstat(file.fileno())
            content = file.read(FILE_MAX_BYTES + 1)
    except OSError as error:
        raise identity.not_found(path, error, cure) from error
    if len(content) > FILE_MAX_BYTES:
        raise CommandError(f"{plain(str(path))} is too large to be what it should be", ExitCode.USAGE)
    return FoundFile(path, content, status.st_mode, status.st_uid in {0, os.geteuid()})


def read_identity(directory: Path, who: str) -> Identity:
    """Read a key and its grant, and check that they belong together."""
    key = find(directory / KEY_FILE.format(who=who), identity.made(who))
    grant, authority = (
        find(directory / name.format(who=who), identity.installed(who)) for name in (GRANT_FILE, AUTHORITY_FILE)
    )
    return identity.identity_of(key, grant, authority, who)


def read_trust(directory: Path, who: str = "viewer") -> Trust:
    """Read the keys of the fleet's authority, as this role has them."""
    return identity.trust_of(find(directory / AUTHORITY_FILE, identity.installed(who)), who)


def granted_name(directory: Path, who: str) -> str:
    """Return the name in a grant, whose signature is not checked; empty if there is none in the form of a key."""
    try:
        chain = read_chain(find(directory / GRANT_FILE.format(who=who)).content)
    except CommandError:
        return ""
    grant = None if isinstance(chain, StatementFault) else chain[0].statement
    name = grant.name if isinstance(grant, Grant) else ""
    return name if re.fullmatch(ROBOT_PATTERN, name) else ""


def certificate_role(path: Path) -> str:
    """The role that a certificate names, its common name; empty where none can be read."""
    try:
        subject = x509.load_pem_x509_certificates(find(path).content)[0].subject
    except (CommandError, ValueError, UnsupportedAlgorithm):
        return ""
    return str(next((name.value for name in subject.get_attributes_for_oid(NameOID.COMMON_NAME)), ""))
