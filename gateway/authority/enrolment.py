"""Access to Zenoh by role, as a Zenoh configuration, and the enrolment of robots and people. Pure.

The role of a node is the common name (CN) of its certificate. One table lists what each role may send to the
router and receive from it: the router's file has the whole table, any other node's file its own rows. Everything
else is denied, and Zenoh drops it silently. This limits what a stranger or a compromised node can reach.
Commanding a robot takes a signed request as well.

An enrolment is a request and the bundle that answers it; the private keys stay on the machine that made the
request. A request is JSON, signed as a whole by each key in it: the Ed25519 key for the grant, and the TLS key. A
bundle is two lines, like a statement: JSON, and the authority's signature over it. The fingerprints that people
compare cover everything that request and bundle decide.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from enum import Enum
from pathlib import PurePath
from string import ascii_lowercase, digits
from typing import Annotated, Any, Final, Literal, TypeVar

import msgspec
from cryptography import x509
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.hashes import SHA256
from msgspec import Meta

from schemas import keys
from schemas.authority.proof import (
    ALGORITHM,
    SIGNATURE_LINE,
    GrantRole,
    KeyHex,
    ProofKind,
    Signed,
    StatementFault,
    read_chain,
    signed_bytes,
)
from schemas.authority.trust import AuthorityKeys, Objection, fingerprint, fits
from schemas.command_line import UsageError
from schemas.keys import OPERATOR_PATTERN, ROBOT_PATTERN, ROOT_PATTERN
from schemas.settings import REQUEST_MAX_BYTES, ZenohSettings
from schemas.subjects import (
    AUTHORITY_CHUNK,
    COMMAND_CHUNK,
    COMMANDS,
    RECORDER_CHUNK,
    RECORDER_SUBJECTS,
    STOP_VERB,
    SUBJECTS,
    TEXT_MAX_BYTES,
    Asking,
)
from schemas.zenoh_session import WITH_NAMES, Json, session_settings


class TransportRole(Enum):
    """The role of a node or person in the network: the common name of its certificate.

    ``nothing`` has no row in the table: a robot uses it to test that the router enforces the rules.
    """

    ROBOT = "robot"
    OPERATOR = "operator"
    VIEWER = "viewer"
    RECORDER = "recorder"
    DESK = "desk"
    ROUTER = "router"
    NOTHING = "nothing"

    @property
    def is_granted(self) -> bool:
        """True if the role signs, and so needs a key and a grant as well as a certificate."""
        return self in _GRANTED


_R = TransportRole

LISTENING: Final = frozenset({_R.ROUTER, _R.DESK})  # roles whose certificates may be used by a server
MESSAGE_MAX_BYTES: Final = 1 << 20  # Zenoh drops a larger message while it arrives
COMMAND_MAX_BYTES: Final = 2 * REQUEST_MAX_BYTES  # of a request with its proof; a stop is never filtered
STATEMENT_MAX_BYTES: Final = TEXT_MAX_BYTES + REQUEST_MAX_BYTES
HISTORY: Final = "@adv/**"  # the key suffix where advanced publishers answer queries for earlier samples

Flow = Literal["ingress", "egress"]
_TURNED: Final[dict[str, Flow]] = {"ingress": "egress", "egress": "ingress"}


class AccessRow(msgspec.Struct, frozen=True):
    """A row of the table: messages that nodes of these roles may send to the router, or receive from it.

    Attributes:
        flow: ingress is what the router receives from them, egress what they receive from it.
        keys: key expressions; a message passes if one of them includes its key expression.
    """

    id: str
    roles: tuple[TransportRole, ...]
    flow: Flow
    messages: tuple[str, ...]
    keys: tuple[str, ...]


def access_table(root: str, robot: str = keys.ALL) -> list[AccessRow]:
    """Every message that is allowed between the router and a node.

    Args:
        robot: in a robot's own file its name: apart from stops and statements for all robots it uses this name
            only. In the router's file ``*``: the router does not know the robots' names.
    """
    one, every = f"{root}/{robot}", f"{root}/{keys.ALL}"
    everything = f"{root}/**"
    own, seen = _published(one), _published(every)
    token, tokens = (keys.liveliness(root, robot), *_histories(one)), (keys.liveliness(root), *_histories(every))
    commands, all_commands = f"{one}/{COMMAND_CHUNK}/*/*", f"{every}/{COMMAND_CHUNK}/*/*"
    all_stops = f"{every}/{COMMAND_CHUNK}/*/{STOP_VERB}"
    statement, all_statements = f"{one}/{AUTHORITY_CHUNK}", f"{every}/{AUTHORITY_CHUNK}"
    recorders = f"{root}/{RECORDER_CHUNK}/*"
    says = tuple(f"{recorders}/{subject.name}" for subject in RECORDER_SUBJECTS)
    orders = (f"{recorders}/{COMMAND_CHUNK}/*/*",)
    put, all_puts = (_verbs(robots, Asking.QUERY) for robots in (one, every))
    asked, all_asked = (_verbs(robots, Asking.PUT) for robots in (one, every))

    robots, viewers, recording = (_R.ROBOT,), (_R.VIEWER,), (_R.RECORDER,)
    commanding, people = (_R.OPERATOR, _R.DESK), (_R.OPERATOR, _R.DESK, _R.VIEWER)
    subscribe, queryable = "declare_subscriber", "declare_queryable"
    told = (subscribe, queryable)
    return [
        # A robot publishes, answers queries for its history, and checks whether its name is free.
        AccessRow("robot-publishes", robots, "ingress", ("put", "reply", queryable), own),
        AccessRow("robot-is-there", robots, "ingress", ("liveliness_token",), token),
        AccessRow("robot-looks", robots, "ingress", ("liveliness_query", "query"), (token[0], f"{one}/gateway/*")),
        AccessRow("robot-finds", robots, "egress", ("liveliness_token", "reply"), (token[0], f"{one}/gateway/*")),
        AccessRow("robot-is-subscribed", robots, "egress", (subscribe,), (*seen, everything)),
        AccessRow("robot-is-queried", robots, "egress", ("query",), seen),
        # A robot receives commands. Of those for all robots it receives stops and statements of the authority.
        AccessRow("robot-listens", robots, "ingress", told, (commands,)),
        AccessRow("robot-listens-to-the-authority", robots, "ingress", (queryable,), (statement,)),
        AccessRow("robot-is-commanded", robots, "egress", ("put",), put),
        AccessRow("robot-is-asked", robots, "egress", ("query",), asked),
        AccessRow("robot-is-stopped", robots, "egress", ("put", "query"), (all_stops,)),
        AccessRow("robot-is-shown", robots, "egress", ("query",), (statement, all_statements)),
        AccessRow("robot-replies", robots, "ingress", ("reply",), (commands, statement)),
        # People see all robots, one subject at a time: '**' would let them fill memory with subscriptions.
        AccessRow("people-subscribe", people, "ingress", (subscribe, "query"), (*seen, *says)),
        AccessRow("people-see", people, "egress", ("put", "reply"), (*seen, *says)),
        AccessRow("people-are-answered", people, "egress", (queryable,), seen),
        AccessRow(
            "people-look",
            people,
            "ingress",
            ("liveliness_query", "declare_liveliness_subscriber"),
            (*tokens, recorders),
        ),
        AccessRow("people-find", people, "egress", ("liveliness_token",), (*tokens, recorders)),
        # People query a robot's identity, with a statement or with an empty payload.
        AccessRow("people-show", people, "ingress", ("query",), (all_statements,)),
        AccessRow("people-are-told", people, "egress", ("reply", queryable), (all_statements,)),
        # Every person may stop one robot; operators and desks may stop all at once.
        AccessRow("viewer-stops-one", viewers, "ingress", ("put", "query"), tuple(_single(root, STOP_VERB))),
        AccessRow("people-reach", people, "egress", told, (all_commands,)),
        AccessRow("viewer-is-answered", viewers, "egress", ("reply",), (all_stops,)),
        AccessRow("operator-sends", commanding, "ingress", ("put",), all_puts),
        AccessRow("operator-asks", commanding, "ingress", ("query",), all_asked),
        AccessRow("operator-is-answered", commanding, "egress", ("reply",), (all_commands,)),
        AccessRow("operator-orders", commanding, "ingress", ("query",), orders),
        AccessRow("operator-is-obeyed", commanding, "egress", ("reply", queryable), orders),
        # A recorder receives everything except commands, and fetches missing samples from robots.
        AccessRow("recorder-subscribes", recording, "ingress", (subscribe,), (everything, *says)),
        AccessRow("recorder-receives", recording, "egress", ("put",), (everything, *says)),
        AccessRow("recorder-fetches", recording, "ingress", ("query",), seen),
        AccessRow("recorder-gets", recording, "egress", ("reply", queryable), seen),
        AccessRow(
            "recorder-looks",
            recording,
            "ingress",
            ("liveliness_query", "declare_liveliness_subscriber"),
            (keys.ANY_TOKEN, *tokens, recorders),
        ),
        AccessRow("recorder-finds", recording, "egress", ("liveliness_token",), (*tokens, recorders)),
        AccessRow("recorder-says", recording, "ingress", ("put",), says),
        AccessRow("recorder-is-subscribed", recording, "egress", (subscribe,), (everything, *says)),
        AccessRow("recorder-is-there", recording, "ingress", ("liveliness_token",), (recorders,)),
        AccessRow("recorder-listens", recording, "ingress", (queryable, "reply"), orders),
        AccessRow("recorder-is-ordered", recording, "egress", ("query", queryable), orders),
    ]


def zenoh_configuration(
    role: TransportRole, root: str, directory: PurePath, endpoints: Sequence[str], robot: str = ""
) -> dict[str, Json]:
    """The Zenoh configuration of a node, to be written as JSON.

    Args:
        endpoints: those a router listens on; for any other node, those of the routers.
    """
    protocols = sorted({_protocol(endpoint) for endpoint in endpoints})
    if not protocols:
        raise ValueError("there is no endpoint of a router")
    is_router = role is _R.ROUTER
    rows = [row for row in access_table(root, robot or keys.ALL) if is_router or role in row.roles]
    entries = session_settings(ZenohSettings(), *(((), endpoints) if is_router else (endpoints, ())))
    return _nested(
        entries
        | {
            "mode": "router" if is_router else "client",
            # zenohd always enables its admin space; the file decides only about reading and writing there.
            "adminspace": {"enabled": False, "permissions": {"read": False, "write": False}},
            "transport/link/protocols": list[Json](protocols),
            "transport/link/rx": {"max_message_size": MESSAGE_MAX_BYTES},
            "transport/link/tls": tls_configuration(role, directory),
            "access_control": _access_control(rows, is_router=is_router),
            "low_pass_filter": _size_limits(root),
        }
    )


def tls_configuration(role: TransportRole, directory: PurePath) -> dict[str, Json]:
    """The TLS part of a node's configuration; only roles that listen get a certificate to listen with."""
    certificate, key = (str(directory / name.format(who=role.value)) for name in (CERTIFICATE_FILE, TLS_KEY_FILE))
    ends = ("connect", "listen") if role in LISTENING else ("connect",)
    files = {f"{end}_certificate": certificate for end in ends} | {f"{end}_private_key": key for end in ends}
    return {
        "enable_mtls": True,
        "verify_name_on_connect": True,
        "close_link_on_expiration": True,
        "root_ca_certificate": str(directory / CA_FILE),
        **files,
    }


TLS_KEY_FILE, CERTIFICATE_FILE, CA_FILE = "{who}-tls.key", "{who}-tls.pem", "ca.pem"
SHUT_OUT_FILE: Final = CERTIFICATE_FILE.format(who=_R.NOTHING.value)  # of the role that may do nothing


def _published(robot: str) -> tuple[str, ...]:
    """Return the key expressions under which a robot publishes, and those of its histories."""
    names = dict.fromkeys(re.sub(r"/[^/]+", "/*", subject.name) for subject in SUBJECTS)
    return (*(f"{robot}/{name}" for name in names), *_histories(robot))


def _verbs(robot: str, other: Asking) -> tuple[str, ...]:
    """The keys of all verbs but those that are sent in this way only."""
    names = (command.verb for command in COMMANDS if command.asking is not other)
    return tuple(f"{robot}/{COMMAND_CHUNK}/*/{verb}" for verb in names)


def _histories(robot: str) -> tuple[str, ...]:
    places = {subject.name.partition("/")[0] for subject in SUBJECTS if subject.qos.history}
    return tuple(f"{robot}/{place}/*/{HISTORY}" for place in sorted(places))


def _single(root: str, verb: str) -> Iterator[str]:
    """Key expressions of a verb that include each robot's key, but not the key for all robots at once."""
    for letter in (*ascii_lowercase, *digits, "-"):
        yield f"{root}/{letter}$*/{COMMAND_CHUNK}/*/{verb}"


def _access_control(rows: list[AccessRow], *, is_router: bool) -> dict[str, Json]:
    """Zenoh's form of the rows. The roles are those at the other ends of the links: of the rows, or the router's.

    Every subject names a role: one without names would match every node.
    """
    rules: list[Json] = [
        {
            "id": row.id,
            "permission": "allow",
            "flows": [row.flow if is_router else _TURNED[row.flow]],
            "messages": list(row.messages),
            "key_exprs": list(dict.fromkeys(row.keys)),
        }
        for row in rows
    ]
    roles = list(dict.fromkeys(role for row in rows for role in row.roles)) if is_router else [_R.ROUTER]
    policies: list[Json] = [
        {
            "rules": [row.id for row in rows if not is_router or role in row.roles],
            "subjects": [role.value],
        }
        for role in roles
    ]
    subjects: list[Json] = [{"id": role.value, "cert_common_names": [role.value]} for role in roles]
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def _size_limits(root: str) -> list[Json]:
    """Limits on the size of requests and statements. A stop has none: it is never filtered."""
    every, recorders = f"{root}/{keys.ALL}", f"{root}/{RECORDER_CHUNK}/*"
    verbs = [f"{every}/{COMMAND_CHUNK}/*/{command.verb}" for command in COMMANDS if command.verb != STOP_VERB]
    limits = (
        ("requests", COMMAND_MAX_BYTES, [*verbs, f"{recorders}/{COMMAND_CHUNK}/*/*"]),
        ("statements", STATEMENT_MAX_BYTES, [f"{every}/{AUTHORITY_CHUNK}"]),
    )
    return [
        {
            "id": name,
            "flows": ["ingress"],
            "messages": ["put", "query"],
            "key_exprs": list[Json](expressions),
            "size_limit": size,
        }
        for name, size, expressions in limits
    ]


def _protocol(endpoint: str) -> str:
    protocol = endpoint.partition("/")[0]
    if protocol not in WITH_NAMES:
        raise ValueError(f"{endpoint} uses no certificates: give a {' or '.join(WITH_NAMES)} endpoint")
    return protocol


def _nested(entries: dict[str, Json]) -> dict[str, Json]:
    """Values by path as nested tables, as in Zenoh's file."""
    whole: dict[str, Any] = {}
    for path, value in entries.items():
        *parents, last = path.split("/")
        place = whole
        for parent in parents:
            place = place.setdefault(parent, {})
        place[last] = value
    return whole


_T = TypeVar("_T")

ENROLMENT_MAX_BYTES: Final = 65_536  # of a request or a bundle


ENROLLED: Final = tuple(role for role in TransportRole if role is not _R.NOTHING)  # roles to apply for
_NAMED_AS_ROBOTS: Final = {TransportRole.ROBOT, TransportRole.RECORDER}
_GRANTED: Final = {
    TransportRole.ROBOT: {GrantRole.ROBOT},
    TransportRole.OPERATOR: {GrantRole.OPERATOR, GrantRole.PROGRAM, GrantRole.SUPERVISOR},
    TransportRole.RECORDER: {GrantRole.RECORDER},
}
"""The roles of grants that an applicant's role allows; any other role gets no grant."""

REQUEST_VERSION: Final = 2  # version 1 names none; its signature and fingerprint did not cover the grant's key

Endpoint = Annotated[str, Meta(pattern=r"^(tls|quic)/[^\s]+:[0-9]+\Z", max_length=256)]
Name = Annotated[str, Meta(pattern=r"^[A-Za-z0-9_.:-]{1,64}\Z")]


class EnrolmentError(UsageError):
    """A request, bundle or certificate that cannot be used: one line; the caller adds the file's name."""


class EnrolmentRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A request for enrolment.

    Attributes:
        names: of the robot, the person, or the hosts; the first one is the name in a grant.
        csr: certificate request, PEM; empty in a browser's request: a browser uses its desk's certificate.
        key: for the grant, Ed25519; absent if the role gets no grant.
        proof: signature by ``key``, hexadecimal; absent without it.
        csr_proof: signature by the key in ``csr`` (ECDSA, SHA-256, DER), hexadecimal; absent without ``csr``.
    """

    version: int = 1
    role: TransportRole
    names: Annotated[list[Name], Meta(min_length=1, max_length=16)]
    csr: str
    key: KeyHex | None = None
    proof: Annotated[str, Meta(pattern=r"^[0-9a-f]{128}\Z")] | None = None
    csr_proof: Annotated[str, Meta(pattern=r"^([0-9a-f]{2}){8,72}\Z")] | None = None

    def signed(self) -> bytes:
        key = bytes.fromhex(self.key or "")
        texts = (part.encode() for part in (self.csr, *self.names))
        return signed_bytes(ProofKind.STATEMENT, b"request-2", self.role.value.encode(), key, *texts)


class FleetPlace(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The place of a fleet on Zenoh: the content of ``fleet.json``."""

    root: Annotated[str, Meta(pattern=rf"^{ROOT_PATTERN}\Z")]
    routers: Annotated[list[Endpoint], Meta(min_length=1, max_length=16)]


class Bundle(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The answer to an enrolment: certificates, keys of the authority and a grant.

    Attributes:
        certificate: for the TLS key, PEM; empty if none was requested.
        shut_out: the same with the role ``nothing``, for a robot's test of its network; empty for any other role.
        ca: the certificate of the network's authority, PEM.
        chain: the grant; empty if the role gets none.
        signer: always empty.
    """

    role: TransportRole
    name: str
    authority: AuthorityKeys
    fleet: FleetPlace
    certificate: str
    shut_out: str = ""
    ca: str
    chain: str = ""
    signer: Literal[""] = ""

    @property
    def fingerprint(self) -> str:
        return authority_fingerprint(self.authority, self.fleet, self.ca)


def new_request(
    role: TransportRole,
    names: list[str],
    csr: str,
    private: Ed25519PrivateKey | None,
    tls: ec.EllipticCurvePrivateKey | None,
) -> EnrolmentRequest:
    """A request, signed by each of its keys."""
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
    """A request whose proofs were checked."""
    request = _decoded(text, EnrolmentRequest, "request")
    if request.version != REQUEST_VERSION:
        raise EnrolmentError(
            f"it is a request of version {request.version}, not {REQUEST_VERSION}: upgrade Cruiser Gateway "
            f"there, and make a new request: 'cruiser provision renew {request.role.value}', or reload the page"
        )
    if request.role not in ENROLLED:
        raise EnrolmentError(f"not a request: role {request.role.value}")
    if request.role.is_granted != (request.key is not None):
        why = "gets no grant, but the request has a key" if request.key else "needs a grant, and has no key"
        raise EnrolmentError(f"a {request.role.value} {why}")
    if not request.csr and request.role is not TransportRole.OPERATOR:
        raise EnrolmentError(f"a {request.role.value} needs a certificate, and requests none")
    pattern = ROBOT_PATTERN if request.role in _NAMED_AS_ROBOTS else OPERATOR_PATTERN
    if request.role.is_granted and (len(request.names) > 1 or re.fullmatch(pattern, request.names[0]) is None):
        raise EnrolmentError(f"a {request.role.value} has one name, of the form {pattern}")
    _check_proofs(request)
    return request


def _check_proofs(request: EnrolmentRequest) -> None:
    """Check that each key in a request signed all of it, and that there are no further proofs."""
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
    """Return True if the key of the certificate request made this signature over this text."""
    try:
        key = x509.load_pem_x509_csr(csr.encode()).public_key()
        if isinstance(key, ec.EllipticCurvePublicKey):
            key.verify(signature, text, ec.ECDSA(SHA256()))
            return True
    except (InvalidSignature, UnsupportedAlgorithm, ValueError):
        return False
    return False


def bundle_text(bundle: Bundle, private: Ed25519PrivateKey) -> bytes:
    body = msgspec.json.encode(bundle)
    signature = private.sign(_signed(body)).hex()
    return body + f"\n{ALGORITHM} {private.public_key().public_bytes_raw().hex()} {signature}\n".encode()


def read_bundle(text: bytes, now_s: int) -> Bundle:
    """A bundle whose signature and grant were checked against the authority that the bundle names."""
    body, _, proof = text.rstrip(b"\n").partition(b"\n")
    match = SIGNATURE_LINE.fullmatch(proof)
    bundle = _decoded(body, Bundle, "bundle")
    if match is None:
        raise EnrolmentError("it is not signed")
    signer, signature = (bytes.fromhex(part.decode()) for part in match.groups())
    if not fits(signer, signature, _signed(body)):
        raise EnrolmentError("it was changed after it was signed")
    trust = bundle.authority.trust
    if signer != trust.active:
        raise EnrolmentError("it is not signed by the authority that it names")
    if bundle.role.is_granted:
        chain = read_chain(bundle.chain.encode())
        if isinstance(chain, StatementFault):
            raise EnrolmentError(f"its grant cannot be read: {chain.detail}")
        held = trust.judge(chain, now_s)
        if isinstance(held, Objection):
            raise EnrolmentError(f"its grant is not valid: {held.text}")
        if held.grant.name != bundle.name or held.grant.role not in _GRANTED[bundle.role]:
            raise EnrolmentError(f"its grant is for {held.grant.name}, {held.grant.role.value}")
    return bundle


def chain_of(text: bytes) -> list[Signed]:
    """The statements in a file of statements, or the grant in a bundle."""
    chain = read_chain(text)
    if not isinstance(chain, StatementFault):
        return chain
    try:
        inner = read_chain(_decoded(text.partition(b"\n")[0], Bundle, "bundle").chain.encode())
    except EnrolmentError as error:
        raise EnrolmentError(f"it contains no statement of an authority: {chain.detail}") from error
    if isinstance(inner, StatementFault):
        raise EnrolmentError("the bundle contains no grant")
    return inner


def request_fingerprint(request: EnrolmentRequest) -> str:
    """The fingerprint of the whole request, independent of its file's layout."""
    return fingerprint(request.signed())


def authority_fingerprint(authority: AuthorityKeys, fleet: FleetPlace, ca: str) -> str:
    """The fingerprint of everything that a machine installs from an authority."""
    keys = (bytes.fromhex(authority.active), bytes.fromhex(authority.standby))
    texts = (part.encode() for part in (ca, fleet.root, *fleet.routers))
    return fingerprint(signed_bytes(ProofKind.STATEMENT, b"authority", *keys, *texts))


def _decoded(text: bytes, kind: type[_T], what: str) -> _T:
    if len(text) > ENROLMENT_MAX_BYTES:
        raise EnrolmentError(f"not a {what}: longer than {ENROLMENT_MAX_BYTES} bytes")
    try:
        return msgspec.json.decode(text, type=kind)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise EnrolmentError(f"not a {what}: {str(error)[:200]}") from error


def _signed(body: bytes) -> bytes:
    return signed_bytes(ProofKind.STATEMENT, b"bundle", body)
