"""The identity of a machine, or of the person at it: private key, grant and authority, out of their files. Pure.

Each error is one line that names the file and the cure. The caller reads the files.
"""

from __future__ import annotations

import stat
from pathlib import PurePath
from typing import Final

import msgspec
from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import load_pem_private_key

from schemas.authority.proof import RequestProof, Signed, StatementFault, read_chain
from schemas.authority.trust import AuthorityKeys, Trust
from schemas.command_line import CommandError, ExitCode, plain

KEY_FILE, GRANT_FILE, AUTHORITY_FILE = "{who}.key", "{who}.grant", "authority.json"

OTHERS: Final = stat.S_IRWXG | stat.S_IRWXO
"""Permissions that nobody but the owner may have on a private key."""


class FoundFile(msgspec.Struct, frozen=True):
    """A file as it was found.

    Attributes:
        mode: type and permissions, as of ``stat``.
        is_own: it belongs to who reads it, or to root.
    """

    path: PurePath
    content: bytes
    mode: int
    is_own: bool


class Identity(msgspec.Struct, frozen=True):
    """The private key, grant and authority of this machine, or of the person at it."""

    private: Ed25519PrivateKey
    chain: list[Signed]
    trust: Trust


def identity_of(key: FoundFile, grant: FoundFile, authority: FoundFile, who: str) -> Identity:
    """Read the key and the grant of somebody, and check that they belong together."""
    private, shown = private_key(key, remade(who)), plain(str(grant.path))
    chain = read_chain(grant.content)
    if isinstance(chain, StatementFault):
        raise CommandError(f"{shown} is no grant: {chain.detail}; {renewed(who)}", ExitCode.USAGE)
    public = private.public_key().public_bytes_raw().hex()
    if getattr(chain[0].statement, "key", "") != public:
        raise CommandError(
            f"{shown} is not the grant of {plain(str(key.path))}: one of them is somebody else's; {renewed(who)}",
            ExitCode.USAGE,
        )
    trust = trust_of(authority, who)
    if chain[-1].signer != trust.active:
        raise CommandError(
            f"{plain(str(authority.path))} is not of the authority that signed {shown}: one of them is of another "
            f"fleet, or of before a rotation; {renewed(who)}",
            ExitCode.USAGE,
        )
    return Identity(private, chain, trust)


def trust_of(authority: FoundFile, who: str) -> Trust:
    """The trust that begins with the fleet's authority, as a file has it."""
    try:
        return msgspec.json.decode(authority.content, type=AuthorityKeys).trust
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        shown = plain(str(authority.path))
        raise CommandError(f"{shown} is damaged: {error}; {renewed(who)}", ExitCode.USAGE) from error


def private_key(file: FoundFile, cure: str) -> Ed25519PrivateKey:
    """The private key that a file holds."""
    check_owner(file)
    try:
        key = load_pem_private_key(file.content, None)
    except (ValueError, TypeError, UnsupportedAlgorithm) as error:
        # OpenSSL's own words are about its decoders, and end with a link to its questions and answers.
        raise CommandError(
            f"{plain(str(file.path))} is no private key, or damaged; {cure}", ExitCode.USAGE
        ) from error
    if not isinstance(key, Ed25519PrivateKey):
        raise CommandError(f"{plain(str(file.path))} is no Ed25519 key; {cure}", ExitCode.USAGE)
    return key


def check_owner(file: FoundFile) -> None:
    """Check that a private key is its owner's alone."""
    shown = plain(str(file.path))
    if file.mode & OTHERS:
        raise CommandError(f"{shown} can be read by others; chmod 600 {shown}", ExitCode.USAGE)
    if not file.is_own:
        raise CommandError(f"{shown} belongs to another user; chown it to yours", ExitCode.USAGE)


def not_found(path: PurePath, error: OSError, cure: str = "") -> CommandError:
    """The line for a file that cannot be read."""
    shown = plain(str(path))
    if isinstance(error, FileNotFoundError):
        return CommandError(f"{shown} is not there{cure and f'; {cure}'}", ExitCode.USAGE)
    return CommandError(f"{shown} cannot be read: {error.strerror}", ExitCode.USAGE)


INSTALLED: Final = "'cruiser provision install' writes it, out of the bundle with which the authority answers"


def made(who: str) -> str:
    """The cure for a key that is missing."""
    return f"'cruiser provision {who} NAME' makes it, and a request to the authority"


def remade(who: str) -> str:
    """The cure for a key that is damaged."""
    return f"'cruiser provision {who} NAME --replace' makes another, and a request to the authority"


def renewed(who: str) -> str:
    """The cure for a certificate, a grant or an authority that is damaged, over, or somebody else's."""
    return f"'cruiser provision renew {who}' asks for another"


def installed(who: str) -> str:
    """The cure for what is missing of what the authority answers."""
    return f"{INSTALLED} ({who}-NAME.bundle; --replace writes over what is left); {renewed(who)}"


def prove_request(
    private: Ed25519PrivateKey, proof: RequestProof, key: str, encoding: str, payload: bytes
) -> bytes:
    """The attachment of a request, signed."""
    signature = private.sign(proof.signed(key, encoding, payload))
    return msgspec.structs.replace(proof, signature=signature).attachment()
