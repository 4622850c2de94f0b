"""Certificates of the network, and the directory of keys, certificates and grants. X.509 on P-256.

A certificate's common name (CN) is the node's role, which decides its access; its subject alternative names (SAN)
are hosts or nodes. Roles that only dial out get a client certificate. Private files are readable by their owner
only and not overwritten. Zenoh's errors name no file and no expiry: here each fault is one line with the file and
the cure.
"""

from __future__ import annotations

import getpass
import ipaddress
import json
import os
import re
import stat
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path, PurePath
from typing import Final, NamedTuple, TypeVar

import msgspec
from cryptography import x509
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.serialization import (
    BestAvailableEncryption,
    Encoding,
    KeySerializationEncryption,
    NoEncryption,
    PrivateFormat,
    PublicFormat,
    load_pem_private_key,
)
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from gateway.authority.enrolment import (
    CA_FILE,
    LISTENING,
    SHUT_OUT_FILE,
    TLS_KEY_FILE,
    EnrolmentError,
    TransportRole,
)
from schemas.authority.key_files import (
    AUTHORITY_FILE,
    INSTALLED,
    certificate_role,
    check_owner,
    find,
    remade,
    renewed,
)
from schemas.authority.trust import fingerprint
from schemas.command_line import CommandError, UsageError, check_regular, plain
from schemas.settings import ZenohSettings

LEAF_DAYS: Final = 30  # life of a node's certificate
RENEW_S: Final = LEAF_DAYS * 86_400 / 3  # a certificate with less time left is due for renewal
CA_DAYS: Final = 3653
BACKDATED: Final = timedelta(minutes=5)  # a certificate begins so much earlier, since clocks differ

NAME_PATTERN: Final = r"[A-Za-z0-9_.:-]{1,64}"

_CLIENT, _SERVER = ExtendedKeyUsageOID.CLIENT_AUTH, ExtendedKeyUsageOID.SERVER_AUTH


class Applicant(msgspec.Struct, frozen=True):
    """The applicant in a certificate request whose signature was verified."""

    role: str
    names: list[str]
    key: str


def new_key() -> ec.EllipticCurvePrivateKey:
    """A key on P-256, the curve that every TLS library supports."""
    return ec.generate_private_key(ec.SECP256R1())


def new_authority(key: ec.EllipticCurvePrivateKey, now_s: int) -> str:
    name = _name("cruiser transport authority")
    usage = x509.KeyUsage(
        digital_signature=False,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=True,
        crl_sign=True,
        encipher_only=False,
        decipher_only=False,
    )
    builder = (
        _builder(name, name, key.public_key(), now_s, now_s + CA_DAYS * 86_400)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(usage, critical=True)
    )
    return _pem(builder.sign(key, SHA256()))


def new_request(key: ec.EllipticCurvePrivateKey, role: str, names: Sequence[str]) -> str:
    """A certificate request (CSR, PKCS #10), PEM, signed by its own key."""
    builder = x509.CertificateSigningRequestBuilder().subject_name(_name(role))
    return _pem(builder.add_extension(_alternatives(names), critical=False).sign(key, SHA256()))


def read_request(text: str) -> Applicant:
    return _applicant(_request(text))


def issue(text: str, role: TransportRole, certificates: str, key: ec.EllipticCurvePrivateKey, now_s: int) -> str:
    """Issue a node's certificate, PEM; it ends with the authority's at the latest.

    Args:
        text: the request; only its names and its key are used.
        certificates: first that of the signing authority; during a change of authorities also the former one's.
    """
    request, authority = _request(text), read_certificates(certificates)[0]
    if not fits(authority, key):
        raise EnrolmentError("the authority's key is not that of its certificate")
    own = _public_key(request)
    until_s = min(now_s + LEAF_DAYS * 86_400, expires_s(authority))
    usage = [_SERVER, _CLIENT] if role in LISTENING else [_CLIENT]
    builder = (
        _builder(_name(role.value), authority.subject, own, now_s, until_s)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(own), critical=False)
        .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(key.public_key()), critical=False)
        .add_extension(_alternatives(_applicant(request).names), critical=False)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(x509.ExtendedKeyUsage(usage), critical=False)
    )
    return _pem(builder.sign(key, SHA256()))


def read_certificates(text: str) -> list[x509.Certificate]:
    try:
        return x509.load_pem_x509_certificates(text.encode())
    except (ValueError, UnsupportedAlgorithm) as error:
        raise EnrolmentError("not a certificate") from error


def fits(certificate: x509.Certificate, key: ec.EllipticCurvePrivateKey) -> bool:
    return _raw(certificate.public_key()) == _raw(key.public_key())


def is_issued(certificate: x509.Certificate, roots: Sequence[x509.Certificate]) -> bool:
    """Return True if one of the roots signed this certificate (RFC 5280, 6.1)."""
    for root in roots:
        with suppress(ValueError, TypeError, InvalidSignature):
            certificate.verify_directly_issued_by(root)
            return True
    return False


def begins_s(certificate: x509.Certificate) -> int:
    return int(certificate.not_valid_before_utc.timestamp())


def expires_s(certificate: x509.Certificate) -> int:
    return int(certificate.not_valid_after_utc.timestamp())


def names_of(certificate: x509.Certificate) -> list[str]:
    try:
        found = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        return []
    return _names(found)


def _request(text: str) -> x509.CertificateSigningRequest:
    try:
        request = x509.load_pem_x509_csr(text.encode())
        is_signed = request.is_signature_valid
    except (ValueError, UnsupportedAlgorithm, InvalidSignature) as error:
        raise EnrolmentError("no certificate request in it") from error
    if not is_signed:
        raise EnrolmentError("the certificate request is not signed by its own key")
    _public_key(request)
    return request


def _applicant(request: x509.CertificateSigningRequest) -> Applicant:
    commons = request.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    try:
        names = _names(request.extensions.get_extension_for_class(x509.SubjectAlternativeName).value)
    except (x509.ExtensionNotFound, ValueError) as error:
        raise EnrolmentError("the certificate request has no name") from error
    if len(commons) != 1 or not names or not all(re.fullmatch(NAME_PATTERN, name) for name in names):
        raise EnrolmentError("the certificate request has no role or no name")
    return Applicant(str(commons[0].value), names, fingerprint(_raw(request.public_key())))


def _public_key(request: x509.CertificateSigningRequest) -> ec.EllipticCurvePublicKey:
    key = request.public_key()
    if not isinstance(key, ec.EllipticCurvePublicKey) or not isinstance(key.curve, ec.SECP256R1):
        raise EnrolmentError("the certificate request's key is not on P-256")
    return key


def _names(found: x509.SubjectAlternativeName) -> list[str]:
    hosts = found.get_values_for_type(x509.DNSName)
    return [*hosts, *map(str, found.get_values_for_type(x509.IPAddress))]


def _alternatives(names: Sequence[str]) -> x509.SubjectAlternativeName:
    return x509.SubjectAlternativeName([_general_name(name) for name in names])


def _general_name(name: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(name))
    except ValueError:
        return x509.DNSName(name)


def _name(common: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common)])


def _builder(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePublicKey, now_s: int, until_s: int
) -> x509.CertificateBuilder:
    if until_s <= now_s:
        raise EnrolmentError("the authority's certificate has expired")
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(datetime.fromtimestamp(now_s, UTC) - BACKDATED)
        .not_valid_after(datetime.fromtimestamp(until_s, UTC))
    )


def _raw(key: object) -> bytes:
    if not isinstance(key, ec.EllipticCurvePublicKey):
        return b""
    return key.public_bytes(Encoding.X962, PublicFormat.UncompressedPoint)


def _pem(made: x509.Certificate | x509.CertificateSigningRequest) -> str:
    return made.public_bytes(Encoding.PEM).decode()


PrivateKey = Ed25519PrivateKey | ec.EllipticCurvePrivateKey
_T = TypeVar("_T")

STANDBY_FILE: Final = "standby.pub"

OWNERS, FOR_ALL = 0o600, 0o644  # modes of files

PUBLIC: Final = frozenset({STANDBY_FILE, AUTHORITY_FILE, CA_FILE})  # public keys, to be copied by other users


class Passphrase:
    """The passphrase of the keys, from a file, or asked once at the terminal."""

    def __init__(self, file: str | None = None, *, is_wanted: bool = True) -> None:
        self._file = file
        self._is_wanted = is_wanted
        self._known: bytes | None = None

    def new(self) -> KeySerializationEncryption:
        if not self._is_wanted:
            return NoEncryption()
        if self._known is None:
            text = self._read() if self._file else self._ask("passphrase for the new keys: ")
            if not self._file and self._ask("once more: ") != text:
                raise UsageError("the two passphrases differ")
            self._known = text
        if not self._known:
            raise UsageError("an empty passphrase protects nothing; use --no-passphrase for none")
        return BestAvailableEncryption(self._known)

    def of(self, path: Path) -> bytes:
        if self._known is None:
            self._known = self._read() if self._file else self._ask(f"passphrase of {path.name}: ")
        return self._known

    def _read(self) -> bytes:
        try:
            return Path(self._file or "").read_bytes().partition(b"\n")[0].rstrip(b"\r")
        except OSError as error:
            raise UsageError(f"{self._file} cannot be read: {error.strerror}") from error

    def _ask(self, prompt: str) -> bytes:
        if not sys.stdin.isatty():
            raise UsageError("no terminal to ask for a passphrase: give --passphrase-file or --no-passphrase")
        try:
            return getpass.getpass(prompt).encode()
        except EOFError as error:
            raise UsageError("no passphrase given") from error


class KeyStore:
    """A directory that only its owner may write."""

    def __init__(self, directory: Path, passphrase: Passphrase | None = None) -> None:
        self.directory = directory
        self._passphrase = passphrase or Passphrase()

    def path(self, name: str) -> Path:
        return self.directory / name

    def shown(self, name: str) -> str:
        return plain(str(self.path(name)))

    def has(self, name: str) -> bool:
        return os.path.lexists(self.path(name))

    def write(
        self, files: Mapping[str, str], *, replace: bool = False, cure: str = "--replace overwrites it"
    ) -> None:
        """Write files, or none of them if one exists and ``replace`` is not set."""
        present = [name for name in files if self.has(name)]
        if present and not replace:
            raise UsageError(f"{self.shown(present[0])} is there already; {cure}")
        try:
            self.directory.mkdir(mode=0o700, parents=True, exist_ok=True)
        except OSError as error:
            raise CommandError(f"{plain(str(self.directory))} cannot be made: {error.strerror}") from error
        self._check_directory()
        for name, text in files.items():
            write_file(self.path(name), text, FOR_ALL if name in PUBLIC else OWNERS, replace=replace)

    def append(self, name: str, line: str) -> None:
        flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_NOFOLLOW
        try:
            with os.fdopen(os.open(self.path(name), flags, 0o600), "w", encoding="utf-8") as file:
                file.write(f"{line}\n")
        except OSError as error:
            raise CommandError(f"{self.shown(name)} cannot be written: {error.strerror}") from error

    def read(self, name: str, cure: str) -> bytes:
        return read_input(self.path(name), cure)

    def read_as(self, name: str, kind: type[_T], cure: str) -> _T:
        try:
            return msgspec.json.decode(self.read(name, cure), type=kind)
        except (msgspec.MsgspecError, UnicodeDecodeError) as error:
            raise UsageError(f"{self.shown(name)} is damaged: {error}; {cure}") from error

    def pem(self, private: PrivateKey, *, is_protected: bool) -> str:
        """A private key in PEM, encrypted with the passphrase if it is to be protected."""
        encryption = self._passphrase.new() if is_protected else NoEncryption()
        return private.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, encryption).decode()

    def ed25519(self, name: str, cure: str) -> Ed25519PrivateKey:
        key = self._key(name, cure)
        if not isinstance(key, Ed25519PrivateKey):
            raise self._other_kind(name, cure)
        return key

    def p256(self, name: str, cure: str) -> ec.EllipticCurvePrivateKey:
        key = self._key(name, cure)
        if not isinstance(key, ec.EllipticCurvePrivateKey):
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
            why = "the passphrase is wrong, or the file damaged" if is_protected else f"not a private key; {cure}"
            raise UsageError(f"{plain(str(file.path))}: {why}") from error

    def _other_kind(self, name: str, cure: str) -> CommandError:
        return UsageError(f"{self.shown(name)} is another kind of key; {cure}")

    def _check_directory(self) -> None:
        found, shown = self.directory.stat(), plain(str(self.directory))
        if found.st_uid not in {0, os.geteuid()}:
            raise UsageError(f"{shown} belongs to another user; chown it to yours")
        if found.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
            raise UsageError(f"{shown} can be written by others; chmod 700 {shown}")


def read_input(path: Path, cure: str = "") -> bytes:
    return find(path, cure).content


@contextmanager
def naming(path: str | PurePath, cure: str = "") -> Iterator[None]:
    """Add a file's name and the cure to a ``CommandError`` about its content."""
    try:
        yield
    except CommandError as error:
        raise CommandError(f"{plain(str(path))}: {error}{cure and f'; {cure}'}", error.code) from error


def replace_whole(path: Path, text: str, mode: int) -> None:
    """Write a file atomically, with this mode, following no link."""
    unfinished = path.with_name(f".{path.name}.unfinished")
    # A leftover of an interrupted write, or a file that somebody placed there to read along.
    unfinished.unlink(missing_ok=True)
    descriptor = os.open(unfinished, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, mode)
    with os.fdopen(descriptor, "w", encoding="utf-8") as file:
        os.fchmod(file.fileno(), mode)
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    unfinished.replace(path)


def write_file(path: Path, text: str, mode: int, *, replace: bool) -> None:
    """Write a file atomically; an existing one only with ``replace``."""
    shown = plain(str(path))
    try:
        if not replace and os.path.lexists(path):
            raise UsageError(f"{shown} is there already; --replace overwrites it")
        replace_whole(path, text, mode)
    except OSError as error:
        raise CommandError(f"{shown} cannot be written: {error.strerror}") from error


_DAY_S: Final = 86_400


class TlsFiles(NamedTuple):
    """The files with which a session connects."""

    ca: Path
    certificate: Path
    key: Path


def tls_files(file: Path) -> TlsFiles | None:
    """Return the files that a provisioned Zenoh file names; None for a file that was written by hand."""
    try:
        tls = json.loads(read_input(file))["transport"]["link"]["tls"]
        names = (tls[name] for name in ("root_ca_certificate", "connect_certificate", "connect_private_key"))
        return TlsFiles(*map(Path, names))
    except (ValueError, LookupError, TypeError):
        return None


def check_tls_files(file: Path, who: str, now_s: float) -> str:
    """Check certificate and key of a Zenoh file against each other, the network's authority and the time.

    Returns:
        A warning if the certificate ends soon; else empty.
    """
    files, cure = tls_files(file), renewed(who)
    if files is None:
        return ""
    roots, certificate = _read(files.ca, INSTALLED), _read(files.certificate, cure)[0]
    shown = plain(str(files.certificate))
    _check_end(files.ca, max(map(expires_s, roots)) - now_s, "the fleet needs a new authority")
    if not fits(certificate, KeyStore(files.key.parent).p256(files.key.name, remade(who))):
        raise UsageError(f"{shown} is not the certificate of {plain(str(files.key))}; {cure}")
    if not is_issued(certificate, roots):
        raise UsageError(
            f"{shown} is of another network than {plain(str(files.ca))}: no authority there signed it; {cure}"
        )
    left_s = expires_s(certificate) - now_s
    _check_end(files.certificate, left_s, cure)
    return f"{shown} ends in {left_s / _DAY_S:.1f} days; {cure}" if left_s < RENEW_S else ""


def check_kinds(file: Path) -> None:
    """Check that a Zenoh file and the files that it names are regular: Zenoh would wait for ever for a FIFO."""
    named: Sequence[Path] = ()
    with suppress(CommandError):
        named = tls_files(file) or ()
    for path in (file, *named):
        with suppress(OSError, ValueError):
            check_regular(path, path.stat().st_mode)


def why_shut_out(file: Path, now_s: float) -> str:
    """Return the fault in the files of a session that did not open; empty if none is found."""
    try:
        check_tls_files(file, file.stem, now_s)
        for path in (tls_files(file) or ())[:2]:
            begins_in_s = begins_s(_read(path, "")[0]) - now_s
            if begins_in_s > 0:
                begins = f"{plain(str(path))} begins in {begins_in_s / _DAY_S:.1f} days"
                return f"{begins} by this computer's clock: the clock is behind, set it"
    except CommandError as error:
        return str(error)
    return ""


def certificate_ends_s(settings: ZenohSettings) -> int | None:
    """Return the end of the session's certificate, seconds since 1970; None if none is found."""
    try:
        files = tls_files(Path(settings.config)) if settings.config else None
        return expires_s(_read(files.certificate, "")[0]) if files else None
    except CommandError:
        return None


def role_of(file: Path) -> str:
    """Return the role in the certificate that a Zenoh file names; empty if it cannot be read."""
    try:
        files = tls_files(file)
    except CommandError:
        return ""
    return certificate_role(files.certificate) if files else ""


def _read(path: Path, cure: str) -> list[x509.Certificate]:
    try:
        return read_certificates(read_input(path, cure).decode(errors="replace"))
    except EnrolmentError as error:
        raise UsageError(f"{plain(str(path))}: {error}{cure and f'; {cure}'}") from error


def _check_end(path: Path, left_s: float, cure: str) -> None:
    if left_s <= 0:
        ended = f"{plain(str(path))} ended {-left_s / _DAY_S:.1f} days ago"
        raise UsageError(f"{ended}; {cure}")


def check_shut_out(directory: Path, now_s: float) -> None:
    """Check the certificate with which a robot tests its network against its key and the time."""
    cure = "'cruiser provision renew robot' asks for it"
    path = directory / SHUT_OUT_FILE
    certificate = _read(path, cure)[0]
    _check_end(path, expires_s(certificate) - now_s, cure)
    key = KeyStore(directory).p256(TLS_KEY_FILE.format(who="robot"), remade("robot"))
    if not fits(certificate, key):
        raise UsageError(f"{plain(str(path))} does not match the key beside it; {cure}")
