"""The identity of this machine or its user, read from files: private key, grant and authority.

Each fault is one line that names the file and the cure.
"""

from __future__ import annotations

import os
import re
import stat
from pathlib import Path
from typing import Final

import msgspec
from cryptography import x509
from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import load_pem_private_key
from cryptography.x509.oid import NameOID

from schemas import configuration
from schemas.authority.proof import Grant, Signed, StatementFault, read_chain
from schemas.authority.trust import AuthorityKeys, Trust
from schemas.command_line import CommandError, UsageError, check_regular, plain
from schemas.keys import ROBOT_PATTERN
from schemas.settings import AuthoritySettings

KEY_FILE, GRANT_FILE, AUTHORITY_FILE = "{who}.key", "{who}.grant", "authority.json"

FILE_MAX_BYTES: Final = 4_000_000

OTHERS: Final = stat.S_IRWXG | stat.S_IRWXO  # permissions that only the owner may have on a private key


class FoundFile(msgspec.Struct, frozen=True):
    """A file as it was found.

    Attributes:
        mode: type and permissions, as in ``stat``.
        is_own: it belongs to this user or to root.
    """

    path: Path
    content: bytes
    mode: int
    is_own: bool


class Identity(msgspec.Struct, frozen=True):
    """The private key, grant and authority of this machine or its user."""

    private: Ed25519PrivateKey
    chain: list[Signed]
    trust: Trust


def directory_of(settings: AuthoritySettings) -> Path:
    """The directory that the settings name; auto is ``$XDG_CONFIG_HOME/cruiser``, or ``~/.config/cruiser``."""
    return Path(configuration.directory_of(settings, os.environ, Path.home()))


def find(path: Path, cure: str = "") -> FoundFile:
    """Read a small file, with its permissions and owner."""
    shown = plain(str(path))
    try:
        check_regular(path, path.stat().st_mode)
        with path.open("rb") as file:
            status = os.fstat(file.fileno())
            content = file.read(FILE_MAX_BYTES + 1)
    except FileNotFoundError as error:
        raise UsageError(f"{shown} is not there{cure and f'; {cure}'}") from error
    except OSError as error:
        raise UsageError(f"{shown} cannot be read: {error.strerror}") from error
    if len(content) > FILE_MAX_BYTES:
        raise UsageError(f"{shown} is larger than {FILE_MAX_BYTES} bytes")
    return FoundFile(path, content, status.st_mode, status.st_uid in {0, os.geteuid()})


def check_owner(file: FoundFile) -> None:
    shown = plain(str(file.path))
    if file.mode & OTHERS:
        raise UsageError(f"{shown} can be read by others; chmod 600 {shown}")
    if not file.is_own:
        raise UsageError(f"{shown} belongs to another user; chown it to yours")


def read_identity(directory: Path, who: str) -> Identity:
    """Read key, grant and authority, and check that they belong together.

    Args:
        who: ``robot``, ``operator`` or ``recorder``: the files' name.
    """
    key = find(directory / KEY_FILE.format(who=who), made(who))
    grant = find(directory / GRANT_FILE.format(who=who), installed(who))
    private, shown = _private_key(key, remade(who)), plain(str(grant.path))
    chain = read_chain(grant.content)
    if isinstance(chain, StatementFault):
        raise UsageError(f"{shown} is not a grant: {chain.detail}; {renewed(who)}")
    if getattr(chain[0].statement, "key", "") != private.public_key().public_bytes_raw().hex():
        raise UsageError(
            f"{shown} is not the grant of {plain(str(key.path))}: one of them belongs to another; {renewed(who)}"
        )
    trust = read_trust(directory, who)
    if chain[-1].signer != trust.active:
        authority = plain(str(directory / AUTHORITY_FILE))
        raise UsageError(
            f"{authority} is not of the authority that signed {shown}: one of them is of another fleet, or from "
            f"before a rotation; {renewed(who)}"
        )
    return Identity(private, chain, trust)


def read_trust(directory: Path, who: str = "viewer") -> Trust:
    """Read the keys of the fleet's authority, as this role has them."""
    file = find(directory / AUTHORITY_FILE, installed(who))
    try:
        return msgspec.json.decode(file.content, type=AuthorityKeys).trust
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        raise UsageError(f"{plain(str(file.path))} is damaged: {error}; {renewed(who)}") from error


def _private_key(file: FoundFile, cure: str) -> Ed25519PrivateKey:
    check_owner(file)
    shown = plain(str(file.path))
    try:
        key = load_pem_private_key(file.content, None)
    except (ValueError, TypeError, UnsupportedAlgorithm) as error:
        # OpenSSL's own message is about its decoders.
        raise UsageError(f"{shown} is not a private key, or damaged; {cure}") from error
    if not isinstance(key, Ed25519PrivateKey):
        raise UsageError(f"{shown} is not an Ed25519 key; {cure}")
    return key


def granted_name(directory: Path, who: str) -> str:
    """Return the name in a grant, whose signature is not checked; empty if it is no valid chunk of a key."""
    try:
        chain = read_chain(find(directory / GRANT_FILE.format(who=who)).content)
    except CommandError:
        return ""
    grant = None if isinstance(chain, StatementFault) else chain[0].statement
    name = grant.name if isinstance(grant, Grant) else ""
    return name if re.fullmatch(ROBOT_PATTERN, name) else ""


def certificate_role(path: Path) -> str:
    """The role in a certificate, its common name; empty if it cannot be read."""
    try:
        subject = x509.load_pem_x509_certificates(find(path).content)[0].subject
    except (CommandError, ValueError, UnsupportedAlgorithm):
        return ""
    return str(next((name.value for name in subject.get_attributes_for_oid(NameOID.COMMON_NAME)), ""))


INSTALLED: Final = "'cruiser provision install' writes it from the authority's bundle"


def made(who: str) -> str:
    return f"'cruiser provision {who} NAME' makes it and a request to the authority"


def remade(who: str) -> str:
    return f"'cruiser provision {who} NAME --replace' makes another and a request to the authority"


def renewed(who: str) -> str:
    """The cure for a damaged, expired or foreign certificate, grant or authority."""
    return f"'cruiser provision renew {who}' asks for another"


def installed(who: str) -> str:
    """The cure for a missing file of a bundle."""
    return f"{INSTALLED} ({who}-NAME.bundle; --replace overwrites what is there); {renewed(who)}"
