"""Enrolment: a request, which leaves the machine where the keys stay, and a bundle in answer. Pure.

A request is JSON, and all of it is signed by each key in it: the Ed25519 key that the grant is to be for, and the
TLS key of the request for a certificate. A bundle is two lines, like a statement: JSON, and the authority's
signature over it. Their fingerprints, which people compare, cover all that is decided by them.
"""

from __future__ import annotations

import re
from enum import Enum
from typing import Annotated, Final, TypeVar

import msgspec
from cryptography import x509
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.hashes import SHA256
from msgspec import Meta

from gateway.authority.transport import TransportRole
from schemas.authority.proof import (
    ALGORITHM,
    GrantRole,
    KeyHex,
    ProofKind,
    Signed,
    StatementFault,
    read_chain,
    signed_bytes,
)
from schemas.authority.trust import AuthorityKeys, HeldGrant, Objection, Trust, fingerprint, fits
from schemas.command_line import CommandError, ExitCode
from schemas.keys import OPERATOR_PATTERN, ROBOT_PATTERN, ROOT_PATTERN

_T = TypeVar("_T")

TEXT_MAX_BYTES: Final = 65_536
"""No request and no bundle is longer."""


class EnrolmentRole(Enum):
    """The role that an applicant asks for."""

    ROBOT = "robot"
    OPERATOR = "operator"
    VIEWER = "viewer"
    RECORDER = "recorder"
    ROUTER = "router"
    DESK = "desk"

    @property
    def transport(self) -> TransportRole:
        """The role on the network."""
        return TransportRole(self.value)

    @property
    def is_granted(self) -> bool:
        """True if the role signs, and so needs a key and a grant besides its certificate."""
        return self in _GRANTED


_NAMED_AS_ROBOTS: Final = {EnrolmentRole.ROBOT, EnrolmentRole.RECORDER}
_GRANTED: Final = {
    EnrolmentRole.ROBOT: {GrantRole.ROBOT},
    EnrolmentRole.OPERATOR: {GrantRole.OPERATOR, GrantRole.PROGRAM, GrantRole.SUPERVISOR},
    EnrolmentRole.RECORDER: {GrantRole.RECORDER},
}
"""The roles of a grant that each role of an applicant may get; all other roles get none."""

SITES_ARE_GONE: Final = (
    "sites are gone: the authority signs each person's request itself ('cruiser provision sign')"
)

REQUEST_VERSION: Final = 2
"""Requests of before name none: neither their signature nor their fingerprint covers the key for the grant."""

Endpoint = Annotated[str, Meta(pattern=r"^(tls|quic)/[^\s]+:[0-9]+\Z", max_length=256)]
Name = Annotated[str, Meta(pattern=r"^[A-Za-z0-9_.:-]{1,64}\Z")]


class EnrolmentError(CommandError):
    """A request or a bundle that cannot be used: one line, to which who read the file adds its name."""

    def __init__(self, message: str) -> None:
        super().__init__(message, ExitCode.USAGE)


class EnrolmentRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A request to be let in.

    Attributes:
        version: of this form.
        role: as what.
        names: of the robot, the person, or the hosts; the first one is the name in a grant.
        csr: request for a certificate, PEM; empty in a browser's, which connects with its desk's.
        key: for the grant, Ed25519; none where none is wanted.
        proof: signature of that key, hexadecimal; none where there is no key.
        csr_proof: signature of the key in ``csr`` (ECDSA, SHA-256, DER), hexadecimal; none without ``csr``.
    """

    version: int = 1
    role: EnrolmentRole
    names: Annotated[list[Name], Meta(min_length=1, max_length=16)]
    csr: str
    key: KeyHex | None = None
    proof: Annotated[str, Meta(pattern=r"^[0-9a-f]{128}\Z")] | None = None
    csr_proof: Annotated[str, Meta(pattern=r"^([0-9a-f]{2}){8,72}\Z")] | None = None

    def signed(self) -> bytes:
        """The text under both proofs, of which the fingerprint is."""
        key = bytes.fromhex(self.key or "")
        texts = (part.encode() for part in (self.csr, *self.names))
        return signed_bytes(ProofKind.STATEMENT, b"request-2", self.role.value.encode(), key, *texts)


class FleetPlace(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The place of a fleet on Zenoh: the content of ``fleet.json``.

    Attributes:
        root: first chunks of every key.
        routers: endpoints of its routers.
    """

    root: Annotated[str, Meta(pattern=rf"^{ROOT_PATTERN}\Z")]
    routers: Annotated[list[Endpoint], Meta(min_length=1, max_length=16)]


class Bundle(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The answer to an enrolment: certificates, keys of the authority and a grant.

    Attributes:
        role, name: of the request.
        authority: the fleet's.
        fleet: its place on Zenoh.
        certificate: for the TLS key, and of who signed it, PEM; empty where none was asked for.
        shut_out: the same of the role ``nothing``, by which a robot tests its network; empty for all others.
        ca: the network's authority, PEM.
        chain: the grant; empty where none is wanted.
        signer: of earlier versions: the site that made the bundle. It is refused.
    """

    role: EnrolmentRole
    name: str
    authority: AuthorityKeys
    fleet: FleetPlace
    certificate: str
    shut_out: str = ""
    ca: str
    chain: str = ""
    signer: str = ""

    @property
    def fingerprint(self) -> str:
        """The fingerprint of the authority that the bundle brings."""
        return authority_fingerprint(self.authority, self.fleet, self.ca)


def new_request(
    role: EnrolmentRole,
    names: list[str],
    csr: str,
    private: Ed25519PrivateKey | None,
    tls: ec.EllipticCurvePrivateKey | None,
) -> EnrolmentRequest:
    """A request, proven by each of its keys.

    Args:
        role: as what.
        names: see ``EnrolmentRequest``.
        csr: the request for a certificate.
        private: the key that the grant is to be for.
        tls: the key of ``csr``.

    Raises:
        EnrolmentError: a name is not of its form.
    """
    key = None if private is None else private.public_key().public_bytes_raw().hex()
    request = EnrolmentRequest(version=REQUEST_VERSION, role=role, names=names, csr=csr, key=key)
    text = request.signed()
    request = msgspec.structs.replace(
        request,
        proof=None if private is None else private.sign(text).hex(),
        csr_proof=None if tls is None else tls.sign(text, ec.ECDSA(SHA256())).hex(),
    )
    return read_request(msgspec.json.encode(request))


def read_request(text: bytes) -> EnrolmentRequest:
    """A request, both of its proofs checked.

    Raises:
        EnrolmentError: it is none, or a proof is wrong.
    """
    request = _decoded(text, EnrolmentRequest, "request")
    if request.version != REQUEST_VERSION:
        raise EnrolmentError(
            f"it is a request of version {request.version}, whose fingerprint does not cover its key. Bring "
            "Cruiser Gateway there to this version, and ask again: "
            f"'cruiser provision renew {request.role.value}'; in a browser, load the page again and save another"
        )
    if request.role.is_granted != (request.key is not None):
        why = "is granted nothing, and has a key" if request.key else "has no key for its grant"
        raise EnrolmentError(f"{request.role.value} {why}")
    if not request.csr and request.role is not EnrolmentRole.OPERATOR:
        raise EnrolmentError(f"a {request.role.value} needs a certificate, and asks for none")
    pattern = ROBOT_PATTERN if request.role in _NAMED_AS_ROBOTS else OPERATOR_PATTERN
    if request.role.is_granted and (len(request.names) > 1 or re.fullmatch(pattern, request.names[0]) is None):
        raise EnrolmentError(f"a {request.role.value} has one name, of the form {pattern}")
    _check_proofs(request)
    return request


def _check_proofs(request: EnrolmentRequest) -> None:
    """Check that each key in a request has signed all of it, and that there is no proof of another."""
    text, proof, csr_proof = (
        request.signed(),
        bytes.fromhex(request.proof or ""),
        bytes.fromhex(request.csr_proof or ""),
    )
    is_proven = not proof if request.key is None else fits(bytes.fromhex(request.key), proof, text)
    if not is_proven:
        raise EnrolmentError("the request is not signed by its own key")
    is_proven = _has_signed(request.csr, csr_proof, text) if request.csr else not csr_proof
    if not is_proven:
        raise EnrolmentError("the request is not signed by the key of its certificate")


def _has_signed(csr: str, signature: bytes, text: bytes) -> bool:
    """Return True if it is the signature of the key of a request for a certificate over this text."""
    try:
        key = x509.load_pem_x509_csr(csr.encode()).public_key()
        if isinstance(key, ec.EllipticCurvePublicKey):
            key.verify(signature, text, ec.ECDSA(SHA256()))
            return True
    except (InvalidSignature, UnsupportedAlgorithm, ValueError):
        return False
    return False


def bundle_text(bundle: Bundle, private: Ed25519PrivateKey) -> bytes:
    """The two lines of a bundle."""
    body = msgspec.json.encode(bundle)
    signature = private.sign(_signed(body)).hex()
    return body + f"\n{ALGORITHM} {private.public_key().public_bytes_raw().hex()} {signature}\n".encode()


def read_bundle(text: bytes, now_s: int) -> Bundle:
    """A bundle whose maker, and whose grant, were held against the authority that it names itself.

    Args:
        text: the two lines.
        now_s: seconds since 1970.

    Raises:
        EnrolmentError: it is none, was changed, or is nobody's who may make one.
    """
    body, _, proof = text.rstrip(b"\n").partition(b"\n")
    match = _PROOF.fullmatch(proof)
    bundle = _decoded(body, Bundle, "bundle")
    if match is None:
        raise EnrolmentError("it is not signed")
    signer, signature = (bytes.fromhex(part.decode()) for part in match.groups())
    if not fits(signer, signature, _signed(body)):
        raise EnrolmentError("it was changed after it was signed")
    trust = bundle.authority.trust
    if bundle.signer:
        raise EnrolmentError(f"a site made it, and {SITES_ARE_GONE}")
    if signer != trust.active:
        raise EnrolmentError("it is not signed by the authority that it names")
    if bundle.role.is_granted:
        held = _judged(trust, bundle.chain, now_s, "its grant")
        if held.grant.name != bundle.name or held.grant.role not in _GRANTED[bundle.role]:
            raise EnrolmentError(f"its grant is of {held.grant.name}, {held.grant.role.value}")
    return bundle


def chain_of(text: bytes) -> list[Signed]:
    """The statements of a file: of a statement's own, or the grant in a bundle.

    Raises:
        EnrolmentError: it holds none.
    """
    chain = read_chain(text)
    if not isinstance(chain, StatementFault):
        return chain
    try:
        inner = read_chain(_decoded(text.partition(b"\n")[0], Bundle, "bundle").chain.encode())
    except EnrolmentError as error:
        raise EnrolmentError(f"it holds no statement of an authority: {chain.detail}") from error
    if isinstance(inner, StatementFault):
        raise EnrolmentError("the bundle holds no grant")
    return inner


def request_fingerprint(request: EnrolmentRequest) -> str:
    """The fingerprint of a request, which covers all of it: the same however its file is laid out."""
    return fingerprint(request.signed())


def authority_fingerprint(authority: AuthorityKeys, fleet: FleetPlace, ca: str) -> str:
    """The fingerprint of an authority, which covers all that a machine takes over of it.

    Args:
        authority: its keys.
        fleet: the fleet's place on Zenoh.
        ca: the network's authority, PEM, as it stands in the file.
    """
    keys = (bytes.fromhex(authority.active), bytes.fromhex(authority.standby))
    texts = (part.encode() for part in (ca, fleet.root, *fleet.routers))
    return fingerprint(signed_bytes(ProofKind.STATEMENT, b"authority", *keys, *texts))


def _judged(trust: Trust, chain_text: str, now_s: int, what: str) -> HeldGrant:
    chain = read_chain(chain_text.encode())
    if isinstance(chain, StatementFault):
        raise EnrolmentError(f"{what} cannot be read: {chain.detail}")
    held = trust.judge(chain, now_s)
    if isinstance(held, Objection):
        raise EnrolmentError(f"{what} does not hold: {held.text}")
    return held


def _decoded(text: bytes, kind: type[_T], what: str) -> _T:
    if len(text) > TEXT_MAX_BYTES:
        raise EnrolmentError(f"it is no {what}: longer than {TEXT_MAX_BYTES} bytes")
    try:
        return msgspec.json.decode(text, type=kind)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        why = SITES_ARE_GONE if _OF_SITE.search(text) else str(error)[:200]
        raise EnrolmentError(f"it is no {what}: {why}") from error


def _signed(body: bytes) -> bytes:
    return signed_bytes(ProofKind.STATEMENT, b"bundle", body)


_OF_SITE: Final = re.compile(rb'"role": *"site"')
_PROOF: Final = re.compile(rb"ed25519 ([0-9a-f]{64}) ([0-9a-f]{128})")
