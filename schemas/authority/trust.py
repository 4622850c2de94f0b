"""The fleet's authority: which grants are valid, revocations and rotations, and fingerprints of keys. Pure.

A grant is valid if the authority's active key signed it, and it is not expired, revoked or of an old epoch.
"""

from __future__ import annotations

import hashlib
from datetime import UTC, datetime
from functools import lru_cache
from typing import Final

import msgspec
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

from schemas.authority.proof import Grant, KeyHex, ProofKind, Revocations, Rotation, Signed, signed_bytes
from schemas.reasons import TEXTS, Reason


def fingerprint(data: bytes) -> str:
    """Return a text that people can compare by phone: the first half of a SHA-256, in groups."""
    digest = hashlib.sha256(data).hexdigest()[:32]
    return "-".join(digest[start : start + 4] for start in range(0, len(digest), 4))


def key_fingerprint(key: str) -> str:
    return fingerprint(bytes.fromhex(key))


KEYS_KEPT: Final = 512  # cached key objects; making one takes 20 us
SAME_AUTHORITY: Final = (
    "it keeps the authority's key: make a new authority along with the new standby, and rotate to that"
)
BY_SITE: Final = "a site granted it, and only the authority may: sign the request there ('cruiser provision sign')"
_LAST_S: Final = 253_402_300_799  # end of the year 9999, seconds since 1970: a statement may contain any number


class Objection(msgspec.Struct, frozen=True):
    """The reason why a proof is rejected, with details."""

    reason: Reason
    detail: str = ""

    @property
    def text(self) -> str:
        """The reason's meaning, with the detail. A robot's reply has the meaning in its detail already."""
        means = TEXTS[self.reason].means
        return self.detail if self.detail.startswith(means) else "; ".join(filter(None, (means, self.detail)))


class HeldGrant(msgspec.Struct, frozen=True):
    """A grant whose signature was verified."""

    id: bytes
    grant: Grant
    key: bytes
    signed: Signed


class Trust(msgspec.Struct, frozen=True):
    """The authority as it is known here; immutable.

    Attributes:
        standby: the key that signs only revocations and rotations.
        rotation: the serial of the last rotation; 0 before the first.
        list_serial: that of the newest list of revocations; 0 before the first.
        epoch: grants of a lower one are not valid. It never falls under one authority.
    """

    active: bytes
    standby: bytes
    rotation: int = 0
    list_serial: int = 0
    revoked: frozenset[bytes] = frozenset()
    epoch: int = 0

    def judge(self, chain: list[Signed], now_s: int) -> HeldGrant | Objection:
        if not chain:
            return Objection(Reason.GRANT_UNKNOWN)
        signed, grant = chain[0], chain[0].statement
        if not isinstance(grant, Grant):
            return Objection(Reason.MALFORMED, "it is not a grant")
        if len(chain) > 1:
            return Objection(Reason.NOT_GRANTED, BY_SITE)
        if signed.signer != self.active:
            return Objection(Reason.GRANT_UNKNOWN, "it is not signed by the authority that is known here")
        if not is_signed(signed):
            return Objection(Reason.PROOF_WRONG, "the signature of the grant does not fit")
        held = HeldGrant(signed.id, grant, bytes.fromhex(grant.key), signed)
        return self.objection(held, now_s) or held

    def has_signed(self, chain: list[Signed]) -> bool:
        """Return True if this authority signed the statement, expired or not."""
        first = chain[0]
        signers = {self.active} if isinstance(first.statement, Grant) else {self.active, self.standby}
        return len(chain) == 1 and first.signer in signers and is_signed(first)

    def objection(self, held: HeldGrant, now_s: int) -> Objection | None:
        """Return why a verified grant is not valid now; None if it is."""
        grant = held.grant
        if held.signed.signer != self.active:
            return Objection(Reason.GRANT_REVOKED, "its authority was replaced")
        if grant.epoch < self.epoch:
            return Objection(Reason.GRANT_REVOKED, f"epoch {grant.epoch} is over")
        if not self.revoked.isdisjoint({held.id, held.key}):
            return Objection(Reason.GRANT_REVOKED, f"by list {self.list_serial}")
        if now_s > grant.not_after:
            return Objection(
                Reason.GRANT_EXPIRED, f"it ended {in_utc(grant.not_after)}, and here it is {in_utc(now_s)}"
            )
        if now_s < grant.not_before:
            return Objection(
                Reason.GRANT_EXPIRED, f"it begins {in_utc(grant.not_before)}, and here it is {in_utc(now_s)}"
            )
        return None

    def revoke(self, signed: Signed) -> Trust | Objection:
        """The trust after a list of revocations; an objection if it is not a newer list of this authority."""
        new = signed.statement
        if not isinstance(new, Revocations):
            return Objection(Reason.MALFORMED, "it is not a list of revocations")
        if signed.signer not in {self.active, self.standby} or not is_signed(signed):
            return Objection(Reason.PROOF_WRONG, "the list is not the authority's")
        if new.serial <= self.list_serial:
            return Objection(Reason.REPLAYED, f"list {new.serial} after {self.list_serial}")
        revoked = frozenset(map(bytes.fromhex, (*new.grants, *new.keys)))
        return msgspec.structs.replace(
            self, list_serial=new.serial, revoked=revoked, epoch=max(self.epoch, new.epoch)
        )

    def rotate(self, signed: Signed) -> Trust | Objection:
        """The trust after a rotation; an objection if it is not a newer one by the standby key.

        The former authority's revocations end with its grants: a thief of its key may have signed a list that
        revokes all robots, with the highest possible serial and epoch.
        """
        new = signed.statement
        if not isinstance(new, Rotation):
            return Objection(Reason.MALFORMED, "it is not a rotation")
        keys = bytes.fromhex(new.active), bytes.fromhex(new.standby)
        if signed.signer != self.standby and keys == (self.active, self.standby):
            # Whoever signed it, it changes nothing.
            return Objection(Reason.REPLAYED, "the authority that it leads to is in force")
        if signed.signer != self.standby or not is_signed(signed):
            return Objection(Reason.PROOF_WRONG, "it is not signed by the standby key")
        if new.serial <= self.rotation:
            return Objection(Reason.REPLAYED, f"rotation {new.serial} after {self.rotation}")
        if keys[0] == self.active:
            return Objection(Reason.MALFORMED, SAME_AUTHORITY)
        return Trust(*keys, rotation=new.serial, epoch=new.epoch)


class AuthorityKeys(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The fleet's authority, as installed on a machine: ``authority.json``."""

    active: KeyHex
    standby: KeyHex

    @property
    def trust(self) -> Trust:
        return Trust(bytes.fromhex(self.active), bytes.fromhex(self.standby))


def keys_fingerprint(authority: AuthorityKeys) -> str:
    """The fingerprint of both keys of an authority, the content of ``authority.json``."""
    keys = (bytes.fromhex(authority.active), bytes.fromhex(authority.standby))
    return fingerprint(signed_bytes(ProofKind.STATEMENT, b"keys", *keys))


def is_signed(signed: Signed) -> bool:
    """Return True if the signature of a statement fits its body and the key that it names."""
    return fits(signed.signer, signed.signature, signed.signed)


def fits(key: bytes, signature: bytes, text: bytes) -> bool:
    """Return True if this key made this Ed25519 signature over this text. Never raises.

    Keys of small order are refused: signatures that fit them can be made without a private key, so the holder of a
    grant for one could deny every request.
    """
    if key[:31] + bytes(byte & 0x7F for byte in key[31:]) in SMALL_ORDER:
        return False
    try:
        _public_key(key).verify(signature, text)
    except (InvalidSignature, ValueError):
        return False
    return True


SMALL_ORDER: Final = frozenset(
    map(
        bytes.fromhex,
        (
            f"{0:064x}",
            f"01{0:062x}",
            "26e8958fc2b227b045c3f489f2ef98f0d5dfac05d3c63339b13802886d53fc05",
            "c7176a703d4dd84fba3c0b760d10670f2a2053fa2c39ccc64ec7fd7792ac037a",
            f"ec{'f' * 60}7f",
            f"ed{'f' * 60}7f",
            f"ee{'f' * 60}7f",
        ),
    )
)
"""Public keys of small order, without the sign bit, in all their encodings, as in libsodium."""


@lru_cache(KEYS_KEPT)
def _public_key(key: bytes) -> Ed25519PublicKey:
    return Ed25519PublicKey.from_public_bytes(key)


def in_utc(time_s: int) -> str:
    """Seconds since 1970 as text, to the minute: with seconds, or as an age, it would be logged every second."""
    return datetime.fromtimestamp(min(max(time_s, 0), _LAST_S), UTC).strftime("%Y-%m-%d %H:%M UTC")
