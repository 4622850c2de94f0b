"""Certificates of the network: its authority (CA), requests, and certificates of nodes. X.509 on P-256.

The common name (CN) is the node's role, by which access is ruled; its names, of hosts or nodes, are the subject's
alternative names (SAN). A role that only dials out gets a certificate that no client accepts from a server.
"""

from __future__ import annotations

import ipaddress
import re
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from typing import Final

import msgspec
from cryptography import x509
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from gateway.authority.transport import LISTENING, TransportRole
from schemas.authority.trust import fingerprint
from schemas.command_line import CommandError, ExitCode

LEAF_DAYS: Final = 30
"""Life of a node's certificate."""

RENEW_S: Final = LEAF_DAYS * 86_400 / 3
"""It is time to renew when no more than this is left."""

CA_DAYS: Final = 3653

BACKDATED: Final = timedelta(minutes=5)
"""A certificate is valid from a little earlier: no two clocks agree."""

NAME_PATTERN: Final = r"[A-Za-z0-9_.:-]{1,64}"

_CLIENT, _SERVER = ExtendedKeyUsageOID.CLIENT_AUTH, ExtendedKeyUsageOID.SERVER_AUTH


class CertificateError(CommandError):
    """A request, certificate or key that cannot be used: one line, to which who read the file adds its name."""

    def __init__(self, message: str) -> None:
        super().__init__(message, ExitCode.USAGE)


class Applicant(msgspec.Struct, frozen=True):
    """The applicant in a certificate request whose signature was verified.

    Attributes:
        role: the common name.
        names: of hosts or of the node.
        key: fingerprint of the key.
    """

    role: str
    names: list[str]
    key: str


def new_key() -> ec.EllipticCurvePrivateKey:
    """A key on P-256, the curve that every TLS library has."""
    return ec.generate_private_key(ec.SECP256R1())


def new_authority(key: ec.EllipticCurvePrivateKey, now_s: int) -> str:
    """The certificate of a new authority, self-signed, PEM."""
    name = _name("cruiser transport authority")
    builder = _builder(name, name, key.public_key(), now_s, now_s + CA_DAYS * 86_400)
    return _pem(_as_authority(builder).sign(key, SHA256()))


def new_request(key: ec.EllipticCurvePrivateKey, role: str, names: Sequence[str]) -> str:
    """A request (CSR, PKCS #10) for a certificate, PEM: signed by the key that it is for."""
    builder = x509.CertificateSigningRequestBuilder().subject_name(_name(role))
    return _pem(builder.add_extension(_alternatives(names), critical=False).sign(key, SHA256()))


def read_request(text: str) -> Applicant:
    """Return the applicant of a certificate request.

    Raises:
        CertificateError: it is no request, or not signed by its own key.
    """
    return _applicant(_request(text))


def issue(text: str, role: TransportRole, certificates: str, key: ec.EllipticCurvePrivateKey, now_s: int) -> str:
    """The certificate that is asked for, PEM.

    Args:
        text: the request. Its names and its key are taken over; what else it wants is not.
        role: that of the node.
        certificates: of the authority that signs first; while two count, that of the former one too.
        key: of the authority that signs.
        now_s: seconds since 1970.

    Raises:
        CertificateError: the request, or the authority's certificate, cannot be used.
    """
    request, authority = _request(text), read_certificates(certificates)[0]
    usage = [_SERVER, _CLIENT] if role in LISTENING else [_CLIENT]
    builder = (
        _below(authority, key, request, role.value, now_s)
        .add_extension(_alternatives(_applicant(request).names), critical=False)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(x509.ExtendedKeyUsage(usage), critical=False)
    )
    return _pem(builder.sign(key, SHA256()))


def read_certificates(text: str) -> list[x509.Certificate]:
    """The certificates of a PEM file, at least one.

    Raises:
        CertificateError: there is none, or one is damaged.
    """
    try:
        return x509.load_pem_x509_certificates(text.encode())
    except (ValueError, UnsupportedAlgorithm) as error:
        raise CertificateError("it is no certificate") from error


def fits(certificate: x509.Certificate, key: ec.EllipticCurvePrivateKey) -> bool:
    """Return True if it is the certificate of this key."""
    return _raw(certificate.public_key()) == _raw(key.public_key())


def is_issued(chain: Sequence[x509.Certificate], roots: Sequence[x509.Certificate]) -> bool:
    """Return True if each certificate is signed by the next one, and the last by a root (RFC 5280, 6.1).

    Args:
        chain: of a node, its own first.
        roots: of the network's authorities.
    """
    above = [one for one in chain[1:] if one not in roots]
    return all(
        any(_is_signer(signer, one) for signer in signers)
        for one, signers in zip((chain[0], *above), (*([one] for one in above), roots), strict=True)
    )


def _is_signer(above: x509.Certificate, below: x509.Certificate) -> bool:
    try:
        below.verify_directly_issued_by(above)
    except (ValueError, TypeError, InvalidSignature):
        return False
    return True


def begins_s(certificate: x509.Certificate) -> int:
    """The beginning of a certificate, seconds since 1970."""
    return int(certificate.not_valid_before_utc.timestamp())


def expires_s(certificate: x509.Certificate) -> int:
    """The end of a certificate, seconds since 1970."""
    return int(certificate.not_valid_after_utc.timestamp())


def names_of(certificate: x509.Certificate) -> list[str]:
    """The alternative names of a certificate: host names and addresses."""
    try:
        found = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        return []
    return _names(found)


def common_name_of(certificate: x509.Certificate) -> str:
    """The common name of a certificate: the role of its holder. Empty if it has none."""
    commons = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    return str(commons[0].value) if commons else ""


def _request(text: str) -> x509.CertificateSigningRequest:
    try:
        request = x509.load_pem_x509_csr(text.encode())
        is_signed = request.is_signature_valid
    except (ValueError, UnsupportedAlgorithm, InvalidSignature) as error:
        raise CertificateError("it holds no request for a certificate") from error
    if not is_signed:
        raise CertificateError("the request for a certificate is not signed by its own key")
    _public_key(request)
    return request


def _applicant(request: x509.CertificateSigningRequest) -> Applicant:
    commons = request.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    try:
        names = _names(request.extensions.get_extension_for_class(x509.SubjectAlternativeName).value)
    except (x509.ExtensionNotFound, ValueError) as error:
        raise CertificateError("the request for a certificate has no name") from error
    if len(commons) != 1 or not names or not all(re.fullmatch(NAME_PATTERN, name) for name in names):
        raise CertificateError("the request for a certificate has no role or no name")
    return Applicant(str(commons[0].value), names, fingerprint(_raw(request.public_key())))


def _public_key(request: x509.CertificateSigningRequest) -> ec.EllipticCurvePublicKey:
    key = request.public_key()
    if not isinstance(key, ec.EllipticCurvePublicKey) or not isinstance(key.curve, ec.SECP256R1):
        raise CertificateError("the request for a certificate is not of a key on P-256")
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
        raise CertificateError("the certificate of the authority is over")
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(datetime.fromtimestamp(now_s, UTC) - BACKDATED)
        .not_valid_after(datetime.fromtimestamp(until_s, UTC))
    )


def _as_authority(builder: x509.CertificateBuilder) -> x509.CertificateBuilder:
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
    constraints = x509.BasicConstraints(ca=True, path_length=0)
    return builder.add_extension(constraints, critical=True).add_extension(usage, critical=True)


def _below(
    above: x509.Certificate,
    signer: ec.EllipticCurvePrivateKey,
    request: x509.CertificateSigningRequest,
    common: str,
    now_s: int,
) -> x509.CertificateBuilder:
    """A certificate that the authority signs, and that lasts no longer than its own."""
    if not fits(above, signer):
        raise CertificateError("the authority's key is not that of its certificate")
    key = _public_key(request)
    until_s = min(now_s + LEAF_DAYS * 86_400, expires_s(above))
    builder = _builder(_name(common), above.subject, key, now_s, until_s)
    own = x509.SubjectKeyIdentifier.from_public_key(key)
    authority = x509.AuthorityKeyIdentifier.from_issuer_public_key(signer.public_key())
    return builder.add_extension(own, critical=False).add_extension(authority, critical=False)


def _raw(key: object) -> bytes:
    if not isinstance(key, ec.EllipticCurvePublicKey):
        return b""
    return key.public_bytes(Encoding.X962, PublicFormat.UncompressedPoint)


def _pem(made: x509.Certificate | x509.CertificateSigningRequest) -> str:
    return made.public_bytes(Encoding.PEM).decode()
