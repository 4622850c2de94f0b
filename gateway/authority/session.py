"""Shared by robot and operator: the key of a lease, tags and signatures, and why a robot is not trusted. Pure.

Only the holder and the robot know the key of a lease: X25519 (RFC 7748) and HKDF-SHA256 (RFC 5869). The request
for the lease carries the holder's public key, the signed reply the robot's. Both are drawn for this lease, so a
key that leaks later reveals nothing earlier.
"""

from __future__ import annotations

import hmac
from collections.abc import Sequence
from typing import Final

import msgspec
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey, X25519PublicKey
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.kdf.hkdf import HKDF

from schemas.authority.proof import TAG_BYTES, DriveProof, ProofKind, RobotProof, Signed, signed_bytes
from schemas.authority.trust import Objection, Trust, fingerprint
from schemas.reasons import TEXTS, Reason

LEASE_KEY_BYTES: Final = 32

_LENGTH_BYTES: Final = 4


def public_bytes(private: X25519PrivateKey) -> bytes:
    return private.public_key().public_bytes_raw()


def lease_key(private: X25519PrivateKey, other: bytes, boot: bytes, lease: int, expression: str) -> bytes | None:
    """The key of a lease, 32 bytes, the same on both sides; None if the other side's public key is invalid."""
    try:
        shared = private.exchange(X25519PublicKey.from_public_bytes(other))
    except ValueError:  # of the wrong length, or of small order
        return None
    salt = signed_bytes(ProofKind.LEASE, boot, lease.to_bytes(8, "big"), expression.encode())
    info = signed_bytes(ProofKind.LEASE, *sorted((public_bytes(private), other)))
    return HKDF(SHA256(), LEASE_KEY_BYTES, salt=salt, info=info).derive(shared)


class DriveTags:
    """Makes and checks the tags of one lease, for drive commands and for its holder's verbs."""

    def __init__(self, key: bytes, lease: int, expression: str, encoding: str) -> None:
        # Everything before the payload is the same in each command, so its hash state is computed once.
        before = DriveProof(lease).signed(expression, encoding, b"")[:-_LENGTH_BYTES]
        self.lease = lease
        self._state = hmac.new(key, before, "sha256")
        self._empty = hmac.new(key, digestmod="sha256")

    def tag(self, payload: bytes) -> bytes:
        state = self._state.copy()
        state.update(len(payload).to_bytes(_LENGTH_BYTES, "big") + payload)
        return state.digest()[:TAG_BYTES]

    def verb_tag(self, text: bytes) -> bytes:
        """The tag of a verb, 16 bytes, over the text that the holder signs."""
        state = self._empty.copy()
        state.update(text)
        return state.digest()[:TAG_BYTES]

    def fits_verb(self, tag: bytes, text: bytes) -> bool:
        """Return True if the tag was made over this text with this lease's key."""
        return hmac.compare_digest(tag, self.verb_tag(text))

    def attachment(self, payload: bytes) -> bytes:
        return DriveProof(self.lease, self.tag(payload)).attachment()

    def fits(self, attachment: bytes, payload: bytes) -> bool:
        proof = DriveProof.read(attachment)
        return (
            proof is not None and proof.lease == self.lease and hmac.compare_digest(proof.tag, self.tag(payload))
        )


class RobotSigner:
    """Signs replies and publications with the robot's key."""

    def __init__(self, private: Ed25519PrivateKey, boot: bytes) -> None:
        self.boot = boot
        self.public_key = private.public_key().public_bytes_raw()
        self._private = private
        self._unsigned = RobotProof(boot)

    def reply(self, key: str, encoding: str, payload: bytes, request: bytes) -> bytes:
        return self._proof(self._unsigned.signed_reply(key, encoding, payload, request))

    def publication(self, key: str, encoding: str, payload: bytes) -> bytes:
        return self._proof(self._unsigned.signed_publication(key, encoding, payload))

    def _proof(self, text: bytes) -> bytes:
        return msgspec.structs.replace(self._unsigned, signature=self._private.sign(text)).attachment()


SOMEBODY_ELSE: Final = "check the robot: another machine may be answering in its place"


class Unmet(msgspec.Struct, frozen=True):
    """The reason why a robot's identity is not verified.

    Attributes:
        is_refusal: the identity is verified, but the robot refuses the grant that it was shown.
    """

    reason: Reason
    text: str
    cure: str
    is_refusal: bool = False


SILENT: Final = Unmet(
    Reason.PROOF_MISSING,
    "it does not prove its identity: its keys may be missing or damaged, or it is not in signed mode",
    "'cruiser why ROBOT' shows what it reports, unverified",
)
"""For a robot that does not reply on ``@auth``."""

UNSIGNED: Final = Unmet(
    Reason.PROOF_WRONG,
    "its reply is not signed with the key that it proved",
    "it may have restarted: try again; 'cruiser why ROBOT' shows what it reports",
)
"""For a robot whose identity was verified, and whose reply does not fit its key."""

NEW_GRANT: Final = "'cruiser provision renew operator', 'sign' at the authority, 'install --replace'"

_CURES: Final = {
    Reason.GRANT_EXPIRED: f"set the clock that is wrong; if none is, get a new grant: {NEW_GRANT}",
    Reason.GRANT_UNKNOWN: f"get a grant from this robot's authority: {NEW_GRANT}, with --fingerprint F",
}
"""Cures for a refused grant that are more specific than the robot's own."""


def not_believed(objection: Objection, chain: Sequence[Signed], trust: Trust) -> Unmet:
    """Return why a robot's reply with this chain is not trusted; the chain is empty if it cannot be read."""
    if objection.reason is Reason.GRANT_EXPIRED:
        return Unmet(
            objection.reason,
            f"the robot's own grant: {objection.detail}",
            "set this computer's clock if it is wrong; if not, the robot needs a new grant: "
            "'cruiser provision renew robot' on the robot, 'sign' at the authority, 'install --replace'",
        )
    if objection.reason is Reason.GRANT_UNKNOWN and chain:
        return Unmet(
            objection.reason,
            f"the robot's own grant is signed by the authority's key {fingerprint(chain[-1].signer)}, and "
            f"authority.json here names the key {fingerprint(trust.active)}",
            "if it is a robot of yours, one of the two has files of a former authority: 'cruiser provision renew' "
            "there, 'sign' at the current authority, 'install --replace --fingerprint F'",
        )
    return Unmet(objection.reason, objection.detail or objection.text, SOMEBODY_ELSE)


def not_taken(objection: Objection, cure: str) -> Unmet:
    return Unmet(
        objection.reason,
        f"it refuses the grant: {objection.text}",
        _CURES.get(objection.reason) or cure or TEXTS[objection.reason].cure,
        is_refusal=True,
    )
