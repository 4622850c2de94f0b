"""Enrolment: a request, which leaves the machine where the keys stay, and a bundle in answer. Pure.

A request is JSON, and is proven twice: the request for a certificate in it is signed by the TLS key, and the whole
by the Ed25519 key that the grant is to be for. A bundle is two lines, like a statement: JSON, and the authority's
signature over it.
"""

from __future__ import annotations

import re
from enum import Enum
from typing import Annotated, Final, TypeVar

import msgspec
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from msgspec import Meta

from gateway.authority.transport import TransportRole
from schemas.authority.fingerprint import fingerprint
from schemas.authority.proof import ProofKind, signed_bytes
from schemas.authority.statement import ALGORITHM, GrantRole, KeyHex, Signed, StatementFault, read_chain
from schemas.authority.trust import AuthorityKeys, HeldGrant, Objection, Trust, fits
from schemas.exit_codes import CommandError, ExitCode
from schemas.keys import OPERATOR_PATTERN, ROBOT_PATTERN, ROOT_PATTERN

_T = TypeVar("_T")

TEXT_MAX_BYTES: Final = 65_536
"""No request and no bundle is longer."""


class EnrolmentRole(Enum):
    """The role that an applicant asks for."""

    SITE = "site"
    ROBOT = "robot"
    OPERATOR = "operator"
    VIEWER = "viewer"
    RECORDER = "recorder"
    ROUTER = "router"
    DESK = "desk"

    @property
    def transport(self) -> TransportRole | None:
        """The role on the network; None for a site, which makes certificates and does not connect."""
        return None if self is EnrolmentRole.SITE else TransportRole(self.value)

    @property
    def is_granted(self) -> bool:
        """True if the role signs, and so needs a key and a grant besides its certificate."""
        return self in _GRANTED


_NAMED_AS_ROBOTS: Final = {EnrolmentRole.ROBOT, EnrolmentRole.RECORDER}
_GRANTED: Final = {
    EnrolmentRole.SITE: {GrantRole.SITE},
    EnrolmentRole.ROBOT: {GrantRole.ROBOT},
    EnrolmentRole.OPERATOR: {GrantRole.OPERATOR, GrantRole.PROGRAM, GrantRole.SUPERVISOR},
    EnrolmentRole.RECORDER: {GrantRole.RECORDER},
}
"""The roles of a grant that each role of an applicant may get; all other roles get none."""

BY_SITES: Final = frozenset({EnrolmentRole.OPERATOR, EnrolmentRole.VIEWER})
"""Whom a site lets in: people."""

Endpoint = Annotated[str, Meta(pattern=r"^(tls|quic)/[^\s]+:[0-9]+$", max_length=256)]
Name = Annotated[str, Meta(pattern=r"^[A-Za-z0-9_.:-]{1,64}$")]


class EnrolmentError(CommandError):
    """A request or a bundle that cannot be used: one line, to which who read the file adds its name."""

    def __init__(self, message: str) -> None:
        super().__init__(message, ExitCode.USAGE)


class EnrolmentRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A request to be let in.

    Attributes:
        role: as what.
        names: of the robot, the person, or the hosts; the first one is the name in a grant.
        csr: request for a certificate, PEM; empty in a browser's, which connects with its desk's.
        key: for the grant, Ed25519; empty where none is wanted.
        proof: signature of that key, hexadecimal.
    """

    role: EnrolmentRole
    names: Annotated[list[Name], Meta(min_length=1, max_length=16)]
    csr: str
    key: KeyHex | None = None
    proof: Annotated[str, Meta(pattern="^[0-9a-f]{128}$")] | None = None

    def signed(self) -> bytes:
        """The text under the proof."""
        parts = (self.role.value, *self.names, self.csr)
        return signed_bytes(ProofKind.STATEMENT, b"request", *(part.encode() for part in parts))


class FleetPlace(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The place of a fleet on Zenoh: the content of ``fleet.json``.

    Attributes:
        root: first chunks of every key.
        routers: endpoints of its routers.
    """

    root: Annotated[str, Meta(pattern=f"^{ROOT_PATTERN}$")]
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
        chain: the grant, and those of its signers; empty where none is wanted.
        signer: the chain of the site that made the bundle; empty if the authority did.
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


def new_request(
    role: EnrolmentRole, names: list[str], csr: str, private: Ed25519PrivateKey | None
) -> EnrolmentRequest:
    """A request, proven by the key that the grant is to be for.

    Raises:
        EnrolmentError: a name is not of its form.
    """
    key = None if private is None else private.public_key().public_bytes_raw().hex()
    request = EnrolmentRequest(role=role, names=names, csr=csr, key=key)
    if private is not None:
        request = msgspec.structs.replace(request, proof=private.sign(request.signed()).hex())
    return read_request(msgspec.json.encode(request))


def read_request(text: bytes) -> EnrolmentRequest:
    """A request, its own proof checked; that of the certificate's key is not checked here.

    Raises:
        EnrolmentError: it is none, or its proof is wrong.
    """
    request = _decoded(text, EnrolmentRequest, "request")
    if request.role.is_granted != (request.key is not None):
        why = "is granted nothing, and has a key" if request.key else "has no key for its grant"
        raise EnrolmentError(f"{request.role.value} {why}")
    if not request.csr and request.role is not EnrolmentRole.OPERATOR:
        raise EnrolmentError(f"a {request.role.value} needs a certificate, and asks for none")
    pattern = ROBOT_PATTERN if request.role in _NAMED_AS_ROBOTS else OPERATOR_PATTERN
    if request.role.is_granted and (len(request.names) > 1 or re.fullmatch(pattern, request.names[0]) is None):
        raise EnrolmentError(f"a {request.role.value} has one name, of the form {pattern}")
    if request.key is not None:
        proof = bytes.fromhex(request.proof or "")
        if not fits(bytes.fromhex(request.key), proof, request.signed()):
            raise EnrolmentError("the request is not signed by its own key")
    return request


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
    if not bundle.signer and signer != trust.active:
        raise EnrolmentError("it is not signed by the authority that it names")
    if bundle.signer:
        site = _judged(trust, bundle.signer, now_s, "the grant of the site that made it")
        if site.key != signer or site.grant.role is not GrantRole.SITE or bundle.role not in BY_SITES:
            raise EnrolmentError("it is signed by nobody who may make one")
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
    """The fingerprint of a request: the same however its file is laid out."""
    return fingerprint(request.signed())


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
        raise EnrolmentError(f"it is no {what}: {str(error)[:200]}") from error


def _signed(body: bytes) -> bytes:
    return signed_bytes(ProofKind.STATEMENT, b"bundle", body)


_PROOF: Final = re.compile(rb"ed25519 ([0-9a-f]{64}) ([0-9a-f]{128})")
