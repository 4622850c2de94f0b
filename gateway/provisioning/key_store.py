"""The directory of keys, certificates and grants: what is secret is its owner's alone, and nothing is overwritten.

Everything that is wrong is one line that names the file and the cure.
"""

from __future__ import annotations

import getpass
import os
import stat
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path, PurePath
from typing import Final, TypeVar

import msgspec
from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import (
    BestAvailableEncryption,
    Encoding,
    KeySerializationEncryption,
    NoEncryption,
    PrivateFormat,
    load_pem_private_key,
)

from gateway.authority.transport import CA_FILE
from schemas.authority.identity import AUTHORITY_FILE, FoundFile, check_owner, not_found
from schemas.authority.proof import Signed, StatementFault, read_chain
from schemas.command_line import CommandError, ExitCode, check_regular, plain

PrivateKey = Ed25519PrivateKey | EllipticCurvePrivateKey
_T = TypeVar("_T")

FILE_MAX_BYTES: Final = 4_000_000

STANDBY_FILE: Final = "standby.pub"

PUBLIC: Final = frozenset({STANDBY_FILE, AUTHORITY_FILE, CA_FILE})
"""Files that are copied to others, who have to read them: public keys of standby, authority and network."""


class Passphrase:
    """The source of the keys' passphrase: a file, or the terminal, asked once.

    Args:
        file: its first line is the passphrase.
        is_wanted: new keys are to have one.
    """

    def __init__(self, file: str | None = None, *, is_wanted: bool = True) -> None:
        self._file = file
        self._is_wanted = is_wanted
        self._known: bytes | None = None

    def new(self) -> KeySerializationEncryption:
        """Return the encryption for new keys.

        Raises:
            CommandError: there is nobody to ask, or two answers differ.
        """
        if not self._is_wanted:
            return NoEncryption()
        if self._known is None:
            text = self._read() if self._file else self._ask("passphrase for the new keys: ")
            if not self._file and self._ask("once more: ") != text:
                raise CommandError("the two passphrases differ", ExitCode.USAGE)
            self._known = text
        if not self._known:
            raise CommandError("an empty passphrase protects nothing; --no-passphrase says so", ExitCode.USAGE)
        return BestAvailableEncryption(self._known)

    def of(self, path: Path) -> bytes:
        """That of a key that has one.

        Raises:
            CommandError: there is nobody to ask.
        """
        if self._known is None:
            self._known = self._read() if self._file else self._ask(f"passphrase of {path.name}: ")
        return self._known

    def _read(self) -> bytes:
        try:
            return Path(self._file or "").read_bytes().partition(b"\n")[0].rstrip(b"\r")
        except OSError as error:
            raise CommandError(f"{self._file} cannot be read: {error.strerror}", ExitCode.USAGE) from error

    def _ask(self, prompt: str) -> bytes:
        if not sys.stdin.isatty():
            raise CommandError(
                "there is no terminal to ask for a passphrase: say --passphrase-file, or --no-passphrase",
                ExitCode.USAGE,
            )
        try:
            return getpass.getpass(prompt).encode()
        except EOFError as error:
            raise CommandError("no passphrase was given", ExitCode.USAGE) from error


class KeyStore:
    """A directory that is its owner's alone.

    Attributes:
        directory: its place.
    """

    def __init__(self, directory: Path, passphrase: Passphrase | None = None) -> None:
        self.directory = directory
        self._passphrase = passphrase or Passphrase()

    def path(self, name: str) -> Path:
        """Return the path of a file."""
        return self.directory / name

    def has(self, name: str) -> bool:
        """Return True if the file is there."""
        return os.path.lexists(self.path(name))

    def write(
        self, files: Mapping[str, str], *, replace: bool = False, cure: str = "--replace writes over"
    ) -> None:
        """Write files, all of them or none that is there already.

        Args:
            files: texts by name.
            replace: over what is there.
            cure: the advice if a file is there already.

        Raises:
            CommandError: a file is there already, or cannot be written.
        """
        present = [name for name in files if self.has(name)]
        if present and not replace:
            raise CommandError(f"{plain(str(self.path(present[0])))} is there already; {cure}", ExitCode.USAGE)
        try:
            self.directory.mkdir(mode=0o700, parents=True, exist_ok=True)
        except OSError as error:
            raise CommandError(f"{plain(str(self.directory))} cannot be made: {error.strerror}") from error
        self._check_directory()
        for name, text in files.items():
            write = write_public if name in PUBLIC else write_private
            write(self.path(name), text, replace=replace)

    def append(self, name: str, line: str) -> None:
        """Add a line to a file.

        Raises:
            CommandError: it cannot be written.
        """
        flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_NOFOLLOW
        try:
            with os.fdopen(os.open(self.path(name), flags, 0o600), "w", encoding="utf-8") as file:
                file.write(f"{line}\n")
        except OSError as error:
            raise CommandError(f"{plain(str(self.path(name)))} cannot be written: {error.strerror}") from error

    def read(self, name: str, cure: str) -> bytes:
        """The content of a file.

        Args:
            name: of the file.
            cure: the command that makes it, if it is missing.

        Raises:
            CommandError: it is missing or cannot be read.
        """
        return read_input(self.path(name), cure)

    def read_as(self, name: str, kind: type[_T], cure: str) -> _T:
        """A JSON file.

        Raises:
            CommandError: it is missing, cannot be read, or is not what it should be.
        """
        try:
            return msgspec.json.decode(self.read(name, cure), type=kind)
        except (msgspec.MsgspecError, UnicodeDecodeError) as error:
            raise CommandError(
                f"{plain(str(self.path(name)))} is damaged: {error}; {cure}", ExitCode.USAGE
            ) from error

    def chain(self, name: str, cure: str) -> list[Signed]:
        """A file of statements.

        Raises:
            CommandError: it is missing, or holds none.
        """
        chain = read_chain(self.read(name, cure))
        if isinstance(chain, StatementFault):
            raise CommandError(
                f"{plain(str(self.path(name)))} is no grant: {chain.detail}; {cure}", ExitCode.USAGE
            )
        return chain

    def pem(self, private: PrivateKey, *, is_protected: bool) -> str:
        """A private key as a file holds it, under the passphrase if it is to be protected.

        Raises:
            CommandError: there is no passphrase.
        """
        encryption = self._passphrase.new() if is_protected else NoEncryption()
        return private.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, encryption).decode()

    def ed25519(self, name: str, cure: str) -> Ed25519PrivateKey:
        """A key that signs statements and requests.

        Raises:
            CommandError: it is missing, others may read it, or it is another kind of key.
        """
        key = self._key(name, cure)
        if not isinstance(key, Ed25519PrivateKey):
            raise self._other_kind(name, cure)
        return key

    def p256(self, name: str, cure: str) -> EllipticCurvePrivateKey:
        """A key of a certificate.

        Raises:
            CommandError: see ``ed25519``.
        """
        key = self._key(name, cure)
        if not isinstance(key, EllipticCurvePrivateKey):
            raise self._other_kind(name, cure)
        return key

    def _key(self, name: str, cure: str) -> object:
        file = find(self.path(name), cure)
        check_owner(file)
        is_protected = b"BEGIN ENCRYPTED PRIVATE KEY" in file.content
        password = self._passphrase.of(self.path(name)) if is_protected else None
        try:
            return load_pem_private_key(file.content, password)
        except (ValueError, TypeError, UnsupportedAlgorithm) as error:
            why = "the passphrase is wrong, or the file damaged" if is_protected else f"no private key; {cure}"
            raise CommandError(f"{plain(str(file.path))}: {why}", ExitCode.USAGE) from error

    def _other_kind(self, name: str, cure: str) -> CommandError:
        return CommandError(f"{plain(str(self.path(name)))} is another kind of key; {cure}", ExitCode.USAGE)

    def _check_directory(self) -> None:
        found, shown = self.directory.stat(), plain(str(self.directory))
        if found.st_uid not in {0, os.geteuid()}:
            raise CommandError(f"{shown} belongs to another user; chown it to yours", ExitCode.USAGE)
        if found.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
            raise CommandError(f"{shown} can be written by others; chmod 700 {shown}", ExitCode.USAGE)


def find(path: Path, cure: str = "") -> FoundFile:
    """A file, which is not large, with what it takes to judge whose it is.

    Raises:
        CommandError: it is missing, too large, no regular file, or cannot be read.
    """
    try:
        check_regular(path, path.stat().st_mode)
        with path.open("rb") as file:
            status = os.fstat(file.fileno())
            content = file.read(FILE_MAX_BYTES + 1)
    except OSError as error:
        raise not_found(path, error, cure) from error
    if len(content) > FILE_MAX_BYTES:
        raise CommandError(f"{plain(str(path))} is too large to be what it should be", ExitCode.USAGE)
    return FoundFile(path, content, status.st_mode, status.st_uid in {0, os.geteuid()})


def read_input(path: Path, cure: str = "") -> bytes:
    """The content of a file.

    Raises:
        CommandError: see ``find``.
    """
    return find(path, cure).content


@contextmanager
def naming(path: str | PurePath, cure: str = "") -> Iterator[None]:
    """Begin what is said to be wrong with a file's content with its name, and end it with the cure."""
    try:
        yield
    except CommandError as error:
        raise CommandError(f"{plain(str(path))}: {error}{cure and f'; {cure}'}", error.code) from error


def replace_whole(path: Path, text: str, mode: int) -> None:
    """Write a file of this mode: whole, or not at all; through no link.

    Raises:
        OSError: it cannot be written.
    """
    unfinished = path.with_name(f".{path.name}.unfinished")
    # What is left of a writing that was cut off, or what somebody else has put there to read along.
    unfinished.unlink(missing_ok=True)
    descriptor = os.open(unfinished, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, mode)
    with os.fdopen(descriptor, "w", encoding="utf-8") as file:
        os.fchmod(file.fileno(), mode)
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    unfinished.replace(path)


def write_private(path: Path, text: str, *, replace: bool) -> None:
    """Write a file that is its owner's alone: whole, or not at all; through no link.

    Raises:
        CommandError: see ``write_public``.
    """
    _write(path, text, 0o600, replace=replace)


def write_public(path: Path, text: str, *, replace: bool) -> None:
    """Write a file that is given to others, for everybody to read: whole, or not at all; through no link.

    Raises:
        CommandError: it is there already and not to be replaced, or cannot be written.
    """
    _write(path, text, 0o644, replace=replace)


def _write(path: Path, text: str, mode: int, *, replace: bool) -> None:
    shown = plain(str(path))
    try:
        if not replace and os.path.lexists(path):
            raise CommandError(f"{shown} is there already; --replace writes over", ExitCode.USAGE)
        replace_whole(path, text, mode)
    except OSError as error:
        raise CommandError(f"{shown} cannot be written: {error.strerror}") from error
