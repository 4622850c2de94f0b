"""The keys and grants of this machine: the files that ``cruiser provision`` made, read and checked.

A private key is its owner's alone: a file that others may read is refused. Everything that is wrong is one line
that names the file and the cure.
"""

from __future__ import annotations

import os
import stat
from pathlib import Path
from typing import Final

import msgspec
from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import load_pem_private_key

from gateway.authority.enrolment import AuthorityKeys
from schemas.authority.statement import Signed, StatementFault, read_chain
from schemas.authority.trust import Trust
from schemas.exit_codes import CommandError, ExitCode
from schemas.settings import AuthoritySettings

AUTO: Final = "auto"

KEY_FILE, GRANT_FILE, AUTHORITY_FILE = "{who}.key", "{who}.grant", "authority.json"

OTHERS: Final = stat.S_IRWXG | stat.S_IRWXO
"""Permissions that nobody but the owner may have on a private key."""


class Identity(msgspec.Struct, frozen=True):
    """Who this machine, or the person at it, is.

    Attributes:
        private: the private key.
        chain: the grant, and those of its signers.
        trust: the fleet's authority.
    """

    private: Ed25519PrivateKey
    chain: list[Signed]
    trust: Trust


def directory_of(settings: AuthoritySettings) -> Path:
    """The directory that the settings name; auto is ``$XDG_CONFIG_HOME/cruiser``, or ``~/.config/cruiser``."""
    if settings.directory != AUTO:
        return Path(settings.directory)
    home = os.environ.get("XDG_CONFIG_HOME", "")
    return (Path(home) if home else Path.home() / ".config") / "cruiser"


def read_identity(directory: Path, who: str) -> Identity:
    """Read the key and the grant of somebody, and check that they belong together.

    Args:
        directory: where they are.
        who: ``robot``, ``operator``, ``recorder``: the files' name.

    Raises:
        CommandError: a file is missing, unreadable, readable for others, or not what it should be.
    """
    key_file = directory / KEY_FILE.format(who=who)
    private = _private_key(key_file, who)
    grant_file = directory / GRANT_FILE.format(who=who)
    chain = read_chain(_content(grant_file, who))
    if isinstance(chain, StatementFault):
        raise CommandError(f"{grant_file} is no grant: {chain.detail}; {_again(who)}", ExitCode.USAGE)
    public = private.public_key().public_bytes_raw().hex()
    if getattr(chain[0].statement, "key", "") != public:
        raise CommandError(
            f"{grant_file} is not the grant of {key_file}: one of them is somebody else's; {_again(who)}",
            ExitCode.USAGE,
        )
    return Identity(private, chain, read_trust(directory, who))


def read_trust(directory: Path, who: str = "viewer") -> Trust:
    """Read the keys of the fleet's authority.

    Raises:
        CommandError: the file is missing, unreadable or damaged.
    """
    path = directory / AUTHORITY_FILE
    try:
        authority = msgspec.json.decode(_content(path, who), type=AuthorityKeys)
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        raise CommandError(f"{path} is damaged: {error}; {_again(who)}", ExitCode.USAGE) from error
    return Trust(bytes.fromhex(authority.active), bytes.fromhex(authority.standby))


def _private_key(path: Path, who: str) -> Ed25519PrivateKey:
    content = _content(path, who)
    try:
        found = path.stat()
        key = load_pem_private_key(content, None)
    except (OSError, ValueError, TypeError, UnsupportedAlgorithm) as error:
        raise CommandError(f"{path} is no private key: {error}; {_again(who)}", ExitCode.USAGE) from error
    if found.st_mode & OTHERS:
        raise CommandError(f"{path} can be read by others: chmod 600 {path}", ExitCode.USAGE)
    if found.st_uid not in {0, os.geteuid()}:
        raise CommandError(f"{path} belongs to another user: chown it to yours", ExitCode.USAGE)
    if not isinstance(key, Ed25519PrivateKey):
        raise CommandError(f"{path} is no Ed25519 key; {_again(who)}", ExitCode.USAGE)
    return key


def _content(path: Path, who: str) -> bytes:
    try:
        return path.read_bytes()
    except FileNotFoundError as error:
        raise CommandError(f"{path} is not there; {_again(who)}", ExitCode.USAGE) from error
    except OSError as error:
        raise CommandError(f"{path} cannot be read: {error.strerror}", ExitCode.USAGE) from error


def _again(who: str) -> str:
    return f"'cruiser provision {who}' makes it"
