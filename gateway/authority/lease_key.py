"""The key of a lease, known only to its holder and the robot: X25519 (RFC 7748) and HKDF-SHA256 (RFC 5869).

The request for the lease carries the holder's public key, the signed reply the robot's. Both are drawn for this
one lease, so a key that is learnt later opens nothing of before.
"""

from __future__ import annotations

import hmac
from typing import Final

from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey, X25519PublicKey
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.kdf.hkdf import HKDF

from schemas.authority.proof import TAG_BYTES, DriveProof, ProofKind, signed_bytes

LEASE_KEY_BYTES: Final = 32

_LENGTH_BYTES: Final = 4


def public_bytes(private: X25519PrivateKey) -> bytes:
    """The public key that goes to the other side, 32 bytes."""
    return private.public_key().public_bytes_raw()


def lease_key(private: X25519PrivateKey, other: bytes, boot: bytes, lease: int, expression: str) -> bytes | None:
    """The key of a lease, 32 bytes, the same on both sides; None if the other side's public key is none.

    Args:
        private: of this side.
        other: the public key of the other side, 32 bytes.
        boot: of the gateway's run, 8 bytes.
        lease: the lease's number.
        expression: the key expression of its drive commands.
    """
    try:
        shared = private.exchange(X25519PublicKey.from_public_bytes(other))
    except ValueError:  # of the wrong length, or of small order
        return None
    salt = signed_bytes(ProofKind.LEASE, boot, lease.to_bytes(8, "big"), expression.encode())
    info = signed_bytes(ProofKind.LEASE, *sorted((public_bytes(private), other)))
    return HKDF(SHA256(), LEASE_KEY_BYTES, salt=salt, info=info).derive(shared)


class DriveTags:
    """Makes and checks the tags of one lease: of its drive commands, and of its holder's verbs."""

    def __init__(self, key: bytes, lease: int, expression: str, encoding: str) -> None:
        """For the commands of one lease.

        Args:
            key: of the lease.
            lease: its number.
            expression: the key expression of its drive commands.
            encoding: theirs.
        """
        # All before the payload is the same in each command, so the state of the hash after it is kept.
        before = DriveProof(lease).signed(expression, encoding, b"")[:-_LENGTH_BYTES]
        self.lease = lease
        self._state = hmac.new(key, before, "sha256")
        self._empty = hmac.new(key, digestmod="sha256")

    def tag(self, payload: bytes) -> bytes:
        """The tag of a command, 16 bytes."""
        state = self._state.copy()
        state.update(len(payload).to_bytes(_LENGTH_BYTES, "big") + payload)
        return state.digest()[:TAG_BYTES]

    def verb_tag(self, text: bytes) -> bytes:
        """The tag of a verb, 16 bytes, over the text that its holder signs."""
        state = self._empty.copy()
        state.update(text)
        return state.digest()[:TAG_BYTES]

    def fits_verb(self, tag: bytes, text: bytes) -> bool:
        """Return True if the tag was made for a verb with this signed text, under this lease's key."""
        return hmac.compare_digest(tag, self.verb_tag(text))

    def attachment(self, payload: bytes) -> bytes:
        """The attachment that goes with a command."""
        return DriveProof(self.lease, self.tag(payload)).attachment()

    def fits(self, attachment: bytes, payload: bytes) -> bool:
        """Return True if the attachment was made for this command, under this lease's key."""
        proof = DriveProof.read(attachment)
        return (
            proof is not None and proof.lease == self.lease and hmac.compare_digest(proof.tag, self.tag(payload))
        )
