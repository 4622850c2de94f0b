"""The proof that rides in the Zenoh attachment of a sample, a query or a reply. Payloads stay as they are.

Signed are the exact bytes of the payload, with the key expression and the encoding under which they are sent:

    "cruiser-auth-1" 0x00 | kind | length part | length part | ...

A length is four bytes, the highest first. The parts of each kind stand in the functions below. Every number in an
attachment has its highest byte first; every attachment begins with the version of its layout.
"""

from __future__ import annotations

import hashlib
from enum import Enum
from struct import Struct
from typing import Final, Self

import msgspec

VERSION: Final = 1

DOMAIN: Final = b"cruiser-auth-1\0"
"""Every signed text begins so: a signature given elsewhere says nothing here."""

SIGNATURE_BYTES: Final = 64
"""Of Ed25519 (RFC 8032)."""

TAG_BYTES: Final = 16
"""Of HMAC-SHA256 (RFC 2104), cut to its first half."""

KEY_BYTES: Final = 32
"""Of a public key, Ed25519 or X25519."""

ID_BYTES: Final = 8


SIGNED: Final = ("safety/state", "state")
"""Subjects that people decide by: each sample is signed."""


class ProofKind(Enum):
    """The kind of a signed text. The values are the byte after the domain."""

    STATEMENT = b"A"
    REQUEST = b"S"
    DRIVE = b"M"
    REPLY = b"R"
    PUBLICATION = b"P"
    LEASE = b"L"


def signed_bytes(kind: ProofKind, *parts: bytes) -> bytes:
    """The text that is signed: no two lists of parts give the same."""
    return b"".join((DOMAIN, kind.value, *(piece for part in parts for piece in (_LENGTH.pack(len(part)), part))))


_LENGTH: Final = Struct(">I")


class RequestProof(msgspec.Struct, frozen=True):
    """The attachment of a verb: 89 bytes, or 105 with a tag.

    Attributes:
        grant: identifier of the signer's grant, see ``statement_id``.
        challenge: the newest one of ``safety/state`` that the signer saw.
        nonce: random, never used before.
        signature: the operator's, Ed25519.
        tag: HMAC-SHA256 of the same text under the key of the lease that its sender holds, cut; empty without one.
            It proves nothing more, but to check it takes a thirtieth of the time.
    """

    grant: bytes
    challenge: bytes
    nonce: bytes
    signature: bytes = bytes(SIGNATURE_BYTES)
    tag: bytes = b""

    @classmethod
    def read(cls, attachment: bytes) -> Self | None:
        """The proof that an attachment holds, or None if it holds none."""
        tag = attachment[_REQUEST.size :]
        if len(attachment) < _REQUEST.size or len(tag) not in {0, TAG_BYTES} or attachment[0] != VERSION:
            return None
        _, grant, challenge, nonce, signature = _REQUEST.unpack(attachment[: _REQUEST.size])
        return cls(grant, challenge, nonce, signature, tag)

    def attachment(self) -> bytes:
        """The bytes that go with the request."""
        return _REQUEST.pack(VERSION, self.grant, self.challenge, self.nonce, self.signature) + self.tag

    def signed(self, key: str, encoding: str, payload: bytes) -> bytes:
        """The text under signature and tag: key expression, encoding, attachment up to the signature, payload."""
        fields = self.attachment()[: _REQUEST.size - SIGNATURE_BYTES]
        return signed_bytes(ProofKind.REQUEST, key.encode(), encoding.encode(), fields, payload)


_REQUEST: Final = Struct(f">B{ID_BYTES}s{ID_BYTES}s{ID_BYTES}s{SIGNATURE_BYTES}s")


class DriveProof(msgspec.Struct, frozen=True):
    """The attachment of a drive command: 25 bytes. Sequence and challenge stand in the payload.

    Attributes:
        lease: number of the lease, as in the payload.
        tag: HMAC-SHA256 under the key of the lease, cut.
    """

    lease: int
    tag: bytes = bytes(TAG_BYTES)

    @classmethod
    def read(cls, attachment: bytes) -> Self | None:
        """The proof that an attachment holds, or None if it holds none."""
        if len(attachment) != _DRIVE.size or attachment[0] != VERSION:
            return None
        return cls(*_DRIVE.unpack(attachment)[1:])

    def attachment(self) -> bytes:
        """The bytes that go with the command."""
        return _DRIVE.pack(VERSION, self.lease, self.tag)

    def signed(self, key: str, encoding: str, payload: bytes) -> bytes:
        """The text under the tag: key expression, encoding, attachment without its tag, payload."""
        fields = self.attachment()[:-TAG_BYTES]
        return signed_bytes(ProofKind.DRIVE, key.encode(), encoding.encode(), fields, payload)


_DRIVE: Final = Struct(f">BQ{TAG_BYTES}s")


class RobotProof(msgspec.Struct, frozen=True):
    """The attachment of a reply, or of a published state: 73 bytes.

    Attributes:
        boot: random, drawn at the start of the gateway.
        signature: the robot's, Ed25519.
    """

    boot: bytes
    signature: bytes = bytes(SIGNATURE_BYTES)

    @classmethod
    def read(cls, attachment: bytes) -> Self | None:
        """The proof that an attachment holds, or None if it holds none."""
        if len(attachment) != _ROBOT.size or attachment[0] != VERSION:
            return None
        return cls(*_ROBOT.unpack(attachment)[1:])

    def attachment(self) -> bytes:
        """The bytes that go with the reply or the sample."""
        return _ROBOT.pack(VERSION, self.boot, self.signature)

    def signed_reply(self, key: str, encoding: str, payload: bytes, request: bytes) -> bytes:
        """The text under a reply's signature.

        Args:
            key: the reply's own key expression.
            encoding: the reply's.
            payload: the reply's.
            request: the attachment of the request that is answered; empty if it had none. So a reply answers one
                request and no other.
        """
        fields = self.attachment()[:-SIGNATURE_BYTES]
        return signed_bytes(ProofKind.REPLY, key.encode(), encoding.encode(), fields, payload, request)

    def signed_publication(self, key: str, encoding: str, payload: bytes) -> bytes:
        """The text under the signature of a published sample."""
        fields = self.attachment()[:-SIGNATURE_BYTES]
        return signed_bytes(ProofKind.PUBLICATION, key.encode(), encoding.encode(), fields, payload)


_ROBOT: Final = Struct(f">B{ID_BYTES}s{SIGNATURE_BYTES}s")
ROBOT_PROOF_BYTES: Final = _ROBOT.size


def statement_id(body: bytes) -> bytes:
    """The identifier of a signed statement: the first eight bytes of the SHA-256 of its body."""
    return hashlib.sha256(body).digest()[:ID_BYTES]
