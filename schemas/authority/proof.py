"""Layouts of signed bytes and attachments, and the signed statements of an authority.

A proof is the Zenoh attachment of a sample, a query or a reply; payloads do not change. It signs the exact bytes
of the payload, with their key expression and encoding:

    "cruiser-auth-1" 0x00 | kind | length part | length part | ...

A length is four bytes. The functions below list the parts of each kind. Numbers are big-endian; every attachment
begins with the version of its layout.

A statement of an authority is a grant, a list of revocations or a rotation to new keys: two lines of text, JSON
and the signature over exactly these bytes. A chain of several statements, a grant by a site, is read and refused.

    {"kind":"grant","serial":17,"operator":"desk-1",...}
    ed25519 KEY_OF_THE_SIGNER SIGNATURE
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable
from enum import Enum
from fnmatch import fnmatchcase
from struct import Struct
from typing import TYPE_CHECKING, Annotated, Final, Self

import msgspec
from msgspec import Meta

from schemas import keys
from schemas.subjects import TEXT_MAX_BYTES

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

VERSION: Final = 1

DOMAIN: Final = b"cruiser-auth-1\0"  # begins every signed text: signatures made for other purposes do not fit
SIGNATURE_BYTES: Final = 64  # of Ed25519 (RFC 8032)
TAG_BYTES: Final = 16  # of HMAC-SHA256 (RFC 2104), truncated to its first half
KEY_BYTES: Final = 32  # of a public key, Ed25519 or X25519
ID_BYTES: Final = 8


class ProofKind(Enum):
    """The kind of a signed text. The values are the byte after the domain."""

    STATEMENT = b"A"
    REQUEST = b"S"
    DRIVE = b"M"
    REPLY = b"R"
    PUBLICATION = b"P"
    LEASE = b"L"


def signed_bytes(kind: ProofKind, *parts: bytes) -> bytes:
    """The text to sign; different parts never give the same text."""
    return b"".join((DOMAIN, kind.value, *(piece for part in parts for piece in (_LENGTH.pack(len(part)), part))))


_LENGTH: Final = Struct(">I")


class RequestProof(msgspec.Struct, frozen=True):
    """The attachment of a verb: 89 bytes, or 105 with a tag.

    Attributes:
        grant: identifier of the signer's grant, see ``statement_id``.
        challenge: the newest one of ``safety/state`` that the signer received.
        nonce: random, never used before.
        signature: the operator's, Ed25519.
        tag: truncated HMAC-SHA256 of the same text with the key of the sender's lease; empty without a lease. It
            proves nothing more, but takes a thirtieth of the time to check.
    """

    grant: bytes
    challenge: bytes
    nonce: bytes
    signature: bytes = bytes(SIGNATURE_BYTES)
    tag: bytes = b""

    @classmethod
    def read(cls, attachment: bytes) -> Self | None:
        tag = attachment[_REQUEST.size :]
        if len(attachment) < _REQUEST.size or len(tag) not in {0, TAG_BYTES} or attachment[0] != VERSION:
            return None
        _, grant, challenge, nonce, signature = _REQUEST.unpack(attachment[: _REQUEST.size])
        return cls(grant, challenge, nonce, signature, tag)

    def attachment(self) -> bytes:
        return _REQUEST.pack(VERSION, self.grant, self.challenge, self.nonce, self.signature) + self.tag

    def signed(self, key: str, encoding: str, payload: bytes) -> bytes:
        """The text to sign: key expression, encoding, attachment up to the signature, payload."""
        fields = self.attachment()[: _REQUEST.size - SIGNATURE_BYTES]
        return signed_bytes(ProofKind.REQUEST, key.encode(), encoding.encode(), fields, payload)


def prove_request(
    private: Ed25519PrivateKey, proof: RequestProof, key: str, encoding: str, payload: bytes
) -> bytes:
    signature = private.sign(proof.signed(key, encoding, payload))
    return msgspec.structs.replace(proof, signature=signature).attachment()


_REQUEST: Final = Struct(f">B{ID_BYTES}s{ID_BYTES}s{ID_BYTES}s{SIGNATURE_BYTES}s")


class DriveProof(msgspec.Struct, frozen=True):
    """The attachment of a drive command: 25 bytes. Sequence and challenge are in the payload."""

    lease: int
    tag: bytes = bytes(TAG_BYTES)

    @classmethod
    def read(cls, attachment: bytes) -> Self | None:
        if len(attachment) != _DRIVE.size or attachment[0] != VERSION:
            return None
        return cls(*_DRIVE.unpack(attachment)[1:])

    def attachment(self) -> bytes:
        return _DRIVE.pack(VERSION, self.lease, self.tag)

    def signed(self, key: str, encoding: str, payload: bytes) -> bytes:
        """The text of the tag: key expression, encoding, attachment without its tag, payload."""
        fields = self.attachment()[:-TAG_BYTES]
        return signed_bytes(ProofKind.DRIVE, key.encode(), encoding.encode(), fields, payload)


_DRIVE: Final = Struct(f">BQ{TAG_BYTES}s")


class RobotProof(msgspec.Struct, frozen=True):
    """The attachment of a reply, or of a published state: 73 bytes."""

    boot: bytes
    signature: bytes = bytes(SIGNATURE_BYTES)

    @classmethod
    def read(cls, attachment: bytes) -> Self | None:
        if len(attachment) != _ROBOT.size or attachment[0] != VERSION:
            return None
        return cls(*_ROBOT.unpack(attachment)[1:])

    def attachment(self) -> bytes:
        return _ROBOT.pack(VERSION, self.boot, self.signature)

    def signed_reply(self, key: str, encoding: str, payload: bytes, request: bytes) -> bytes:
        """The text that a reply signs. ``request`` is the attachment of the request, empty if it had none."""
        fields = self.attachment()[:-SIGNATURE_BYTES]
        return signed_bytes(ProofKind.REPLY, key.encode(), encoding.encode(), fields, payload, request)

    def signed_publication(self, key: str, encoding: str, payload: bytes) -> bytes:
        fields = self.attachment()[:-SIGNATURE_BYTES]
        return signed_bytes(ProofKind.PUBLICATION, key.encode(), encoding.encode(), fields, payload)


_ROBOT: Final = Struct(f">B{ID_BYTES}s{SIGNATURE_BYTES}s")
ROBOT_PROOF_BYTES: Final = _ROBOT.size


def statement_id(body: bytes) -> bytes:
    """The identifier of a signed statement: the first eight bytes of the SHA-256 of its body."""
    return hashlib.sha256(body).digest()[:ID_BYTES]


STATEMENTS_MAX: Final = 3  # of the longest chain that is read; only a single statement is accepted
ALGORITHM: Final = "ed25519"

KeyHex = Annotated[str, Meta(pattern=r"^[0-9a-f]{64}\Z", description="public key, Ed25519, hexadecimal")]
IdHex = Annotated[str, Meta(pattern=r"^[0-9a-f]{16}\Z", description="identifier of a grant, hexadecimal")]
Time = Annotated[int, Meta(ge=0, le=2**53 - 1, description="seconds since 1970, UTC")]
Serial = Annotated[int, Meta(ge=0, le=2**53 - 1)]
Delegations = Annotated[int, Meta(ge=0, le=STATEMENTS_MAX - 1)]
RobotPattern = Annotated[str, Meta(pattern=r"^[a-z0-9*-]+\Z", max_length=64)]
NameOfHolder = Annotated[str, Meta(pattern=rf"^{keys.OPERATOR_PATTERN}\Z")]
Verb = Annotated[str, Meta(pattern=r"^[a-z_]+\Z", max_length=32)]


class GrantRole(Enum):
    """The role of a grant's holder. The first three may hold a lease; ``site`` is refused."""

    PROGRAM = "program"
    OPERATOR = "operator"
    SUPERVISOR = "supervisor"
    SITE = "site"
    ROBOT = "robot"
    RECORDER = "recorder"


class _Statement(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="kind", kw_only=True):
    """Unknown fields are an error: a restriction must not be ignored."""


class Grant(_Statement, frozen=True, forbid_unknown_fields=True, tag="grant", kw_only=True):
    """Permission for one holder to use verbs, on some robots, for a limited time.

    Attributes:
        serial: rises with each grant of its signer, for people.
        name: the holder's: an operator's chunk of the command keys, or a robot's.
        key: the holder's.
        robots: patterns of robots' names, ``*`` for any letters.
        verbs: those that the holder may use.
        override: the holder may take the lease of a moving robot.
        speed_limit_mps: the holder's speed limit; none if absent.
        not_before, not_after: the first and the last second in which it is valid.
        epoch: raised by the authority to end all earlier grants at once.
        may_delegate: has no effect.
    """

    serial: Serial
    name: NameOfHolder
    key: KeyHex
    role: GrantRole
    robots: Annotated[list[RobotPattern], Meta(max_length=64)]
    verbs: Annotated[list[Verb], Meta(max_length=64)] = []
    override: bool = False
    speed_limit_mps: Annotated[float, Meta(gt=0, le=100)] | None = None
    not_before: Time
    not_after: Time
    epoch: Serial = 0
    may_delegate: Delegations = 0

    def covers(self, robot: str) -> bool:
        # ``*`` is the only special character in a pattern. Unlike a regular expression's, fnmatch's time does not
        # grow with a power of the number of stars.
        return any(fnmatchcase(robot, pattern) for pattern in self.robots)


class Revocations(_Statement, frozen=True, forbid_unknown_fields=True, tag="revocations", kw_only=True):
    """Everything that is revoked. A list with a higher serial replaces one with a lower.

    Attributes:
        at: time of signing.
        grants: identifiers of revoked grants.
        keys: holders whose grants are all revoked.
        epoch: grants of a lower epoch are revoked.
    """

    serial: Serial
    at: Time
    grants: Annotated[list[IdHex], Meta(max_length=4096)] = []
    keys: Annotated[list[KeyHex], Meta(max_length=4096)] = []
    epoch: Serial = 0


class Rotation(_Statement, frozen=True, forbid_unknown_fields=True, tag="rotation", kw_only=True):
    """New keys of the authority, signed by the standby key, which the robots know."""

    serial: Serial
    at: Time
    active: KeyHex
    standby: KeyHex
    epoch: Serial = 0


Statement = Grant | Revocations | Rotation


class Signed(msgspec.Struct, frozen=True):
    """A statement with its signature, as it was received."""

    body: bytes
    signer: bytes
    signature: bytes
    statement: Statement

    @property
    def id(self) -> bytes:
        return statement_id(self.body)

    @property
    def signed(self) -> bytes:
        return signed_bytes(ProofKind.STATEMENT, self.body)

    def text(self) -> str:
        return f"{self.body.decode()}\n{ALGORITHM} {self.signer.hex()} {self.signature.hex()}\n"


class StatementFault(msgspec.Struct, frozen=True):
    """The fault in a text that is not a chain of signed statements. A value: wire input never raises."""

    detail: str


def body_of(statement: Statement) -> bytes:
    return _ENCODER.encode(statement)


def read_chain(text: bytes) -> list[Signed] | StatementFault:
    """The statements of a chain, whose signatures are not checked here.

    Args:
        text: pairs of lines; blank lines and lines that begin with ``#`` are ignored.
    """
    if len(text) > TEXT_MAX_BYTES:
        return StatementFault(f"it is longer than {TEXT_MAX_BYTES} bytes")
    lines = [line for line in text.split(b"\n") if line.strip() and not line.startswith(b"#")]
    if not lines or len(lines) % 2:
        return StatementFault("it is not pairs of lines, a statement and its signature")
    if len(lines) > 2 * STATEMENTS_MAX:
        return StatementFault(f"it has more than {STATEMENTS_MAX} statements")
    chain: list[Signed] = []
    for body, proof in zip(lines[::2], lines[1::2], strict=True):
        match = SIGNATURE_LINE.fullmatch(proof)
        if match is None:
            return StatementFault("a statement is not followed by its signature")
        try:
            statement = _DECODER.decode(body)
        except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
            return StatementFault(str(error)[:200])
        chain.append(Signed(body, bytes.fromhex(match[1].decode()), bytes.fromhex(match[2].decode()), statement))
    return chain


def chain_text(chain: Iterable[Signed]) -> str:
    return "".join(signed.text() for signed in chain)


SIGNATURE_LINE: Final = re.compile(rb"ed25519 ([0-9a-f]{64}) ([0-9a-f]{128})")
_ENCODER: Final = msgspec.json.Encoder()
_DECODER: Final = msgspec.json.Decoder(Statement)
