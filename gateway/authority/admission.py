"""Signed mode on the robot: check who sent a request, and choose which statements to verify. Pure.

``admit`` runs before the arbiter and adds a verdict; ``reply`` runs after it and signs. Arbiter and journal see
verdicts and public keys only. A remote stop needs no proof; a proof only records who sent it.

The sieve chooses the statements that a robot verifies in a tick, so that no flood delays a revocation. Checking a
signature costs a hundred times as much as reading the text, so statements are sorted by the kind that their text
claims, and each kind has its own queue. Within a kind the choice is random: a sender could exploit any other
order.
"""

from __future__ import annotations

import re
from collections import OrderedDict
from collections.abc import Callable, Iterable
from enum import Enum
from random import SystemRandom
from typing import Any, Final, Generic, TypeVar

import msgspec
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey

from gateway.authority.session import DriveTags, RobotSigner, lease_key, public_bytes
from gateway.command.flow import PendingReply
from gateway.command.rulings import Credentials, RawRequest
from schemas import codec, keys
from schemas.authority.proof import ALGORITHM, DriveProof, GrantRole, RequestProof, Signed, statement_id
from schemas.authority.trust import HeldGrant, Objection, Trust, fits
from schemas.decisions import LeaseReply
from schemas.reasons import Reason
from schemas.requests import Acquire, Leased, Role, Take
from schemas.settings import Settings
from schemas.subjects import BY_VERB, DRIVE_VERB, STOP_VERB

CHALLENGE_MAX_NS: Final = 2_000_000_000  # a verb that echoes an older challenge is refused as too old
NONCE_KEPT_NS: Final = 4_000_000_000  # longer than CHALLENGE_MAX_NS: by then a repeated request is too old
GRANTS_KEPT: Final = 256  # known grants; beyond it the least recently used one is dropped
TAGS_PER_TICK: Final = 256  # most tags checked in a tick (1 ms), to handle the holder's drive commands first
SIGNATURES_PER_TICK: Final = 4  # most signatures of verbs checked in a tick (0.5 ms); the rest is refused as busy
HOLDERS_PER_TICK: Final = 4  # further signatures, of verbs with the lease's tag, which only its holder can make

ROLES: Final = {
    GrantRole.PROGRAM: Role.PROGRAM,
    GrantRole.OPERATOR: Role.OPERATOR,
    GrantRole.SUPERVISOR: Role.SUPERVISOR,
}
"""Roles of grants whose holders may hold a lease, and their role as its holder."""


class _Asked(msgspec.Struct, frozen=True):
    """A query that waits for its reply, with the sender's grant if the sender was proven."""

    raw: RawRequest
    sender: HeldGrant | None


class GivenLease(msgspec.Struct, frozen=True):
    """The lease that was given last.

    Attributes:
        holder: the grant under which it was requested.
        tags: those of its drive commands; None if the holder sent no usable public key, and so cannot drive.
    """

    id: int
    holder: HeldGrant
    tags: DriveTags | None


class SignedAdmission:
    """Judges the proofs of requests.

    Attributes:
        lease: the last one that was given; None before the first.
        now_s: the time by which grants are judged, seconds since 1970; the owner updates it.
        challenge_age_ns: returns the age of a challenge, or the reason why it is unknown.
    """

    def __init__(
        self,
        settings: Settings,
        trust: Trust,
        signer: RobotSigner,
        challenge_age_ns: Callable[[bytes, int], int | Reason],
        new_private_key: Callable[[], X25519PrivateKey] = X25519PrivateKey.generate,
    ) -> None:
        self.trust = trust
        self.lease: GivenLease | None = None
        self.now_s = 0
        self._root, self._robot = settings.robot.root, settings.robot.name
        self._signer = signer
        self.challenge_age_ns = challenge_age_ns
        self._new_private_key = new_private_key
        self._grants: OrderedDict[bytes, HeldGrant] = OrderedDict()
        self._nonces: OrderedDict[tuple[bytes, bytes], int] = OrderedDict()
        self._asking: dict[int, _Asked] = {}
        self._left = SIGNATURES_PER_TICK
        self._holders_left = HOLDERS_PER_TICK
        self._tags_left = TAGS_PER_TICK

    # Grants.

    def introduce(self, chain: list[Signed]) -> HeldGrant | Objection:
        """Accept a grant, from any sender: only its signature counts.

        Returns:
            The known grant: the same object as before if it was known already.
        """
        known = self._grants.get(chain[0].id)
        if known is not None and self.trust.objection(known, self.now_s) is not None:
            known = None
        if known is not None and [known.signed] == chain:
            return known
        held = self.trust.judge(chain, self.now_s)
        if isinstance(held, Objection):
            return held
        if not held.grant.covers(self._robot):
            return Objection(Reason.NOT_GRANTED, f"it does not cover {self._robot}")
        self._grants[held.id] = held
        if len(self._grants) > GRANTS_KEPT:
            self._grants.popitem(last=False)
        return held

    def known(self, grant_id: bytes) -> HeldGrant | None:
        return self._grants.get(grant_id)

    def objection_to_holder(self) -> Objection | None:
        """Return why the grant of the last lease is no longer valid; None if it is valid."""
        return None if self.lease is None else self.trust.objection(self.lease.holder, self.now_s)

    # Requests.

    def begin_tick(self, now_ns: int) -> None:
        """Allow the next bounded number of checks, and forget old nonces."""
        self._left, self._tags_left = SIGNATURES_PER_TICK, TAGS_PER_TICK
        self._holders_left = HOLDERS_PER_TICK
        while self._nonces and now_ns - next(iter(self._nonces.values())) > NONCE_KEPT_NS:
            self._nonces.popitem(last=False)

    def number_of(self, lease_id: int) -> int:
        """The lease's number in its holder's requests: the identifier itself, since the key is the secret."""
        return lease_id

    def may_be_holders(self, verb: str, payload: bytes, attachment: bytes) -> bool:
        """Return True if its tag is that of the lease's holder. A verb's signature is not checked here."""
        if self.lease is None or self.lease.tags is None:
            return False
        self._tags_left -= 1
        if self._tags_left < 0:
            return False
        if verb == DRIVE_VERB:
            return self.lease.tags.fits(attachment, payload)
        proof, command = RequestProof.read(attachment), BY_VERB.get(verb)
        if proof is None or command is None:
            return False
        key = keys.command(self._root, self._robot, self.lease.holder.grant.name, verb)
        return self._is_tagged(proof, proof.signed(key, command.encoding, payload))

    def _is_tagged(self, proof: RequestProof, text: bytes) -> bool:
        """Return True if a verb's tag was made with the lease's key."""
        lease = self.lease
        return (
            lease is not None
            and lease.tags is not None
            and lease.holder.id == proof.grant
            and lease.tags.fits_verb(proof.tag, text)
        )

    def admit(self, raw: RawRequest, now_ns: int) -> RawRequest:
        """Add to a request what is proven about its sender. A stop is served without proof too."""
        held: HeldGrant | Objection
        if raw.fault:
            # It was signed under another version's encoding, so its proof cannot be checked.
            held = Objection(Reason.MALFORMED)
        else:
            held = self._judge_drive(raw) if raw.verb == DRIVE_VERB else self._judge_verb(raw, now_ns)
        if raw.is_query:
            self._asking[raw.handle] = _Asked(raw, None if isinstance(held, Objection) else held)
        return msgspec.structs.replace(raw, credentials=_credentials(held))

    def _judge_drive(self, raw: RawRequest) -> HeldGrant | Objection:
        proof, lease = DriveProof.read(raw.attachment), self.lease
        if proof is None:
            return Objection(Reason.PROOF_MISSING)
        if lease is None or lease.tags is None or proof.lease != lease.id:
            return Objection(Reason.NO_LEASE)
        if DRIVE_VERB not in lease.holder.grant.verbs:
            return Objection(Reason.NOT_GRANTED, f"{DRIVE_VERB} is not among its verbs")
        return lease.holder if lease.tags.fits(raw.attachment, raw.payload) else Objection(Reason.PROOF_WRONG)

    def _judge_verb(self, raw: RawRequest, now_ns: int) -> HeldGrant | Objection:
        """Judge a signed verb, the cheapest check first: the signature takes a hundred times as long."""
        command, proof = BY_VERB.get(raw.verb), RequestProof.read(raw.attachment)
        if proof is None or command is None:
            return Objection(Reason.PROOF_MISSING)
        held = self._freshness(proof, now_ns) or self._granted(raw, proof)
        if isinstance(held, Objection):
            return held
        key = keys.command(self._root, self._robot, raw.operator, raw.verb)
        text = proof.signed(key, command.encoding, raw.payload)
        if not self._may_check(proof, text):
            return Objection(Reason.BUSY)
        if not fits(held.key, proof.signature, text):
            return Objection(Reason.PROOF_WRONG)
        self._nonces[proof.grant, proof.nonce] = now_ns
        self._grants.move_to_end(proof.grant)
        return self._objection_to_lease(raw, held) or held

    def _may_check(self, proof: RequestProof, text: bytes) -> bool:
        """Return True if this tick allows another signature check: of the holder, or of any sender."""
        if self._holders_left > 0 and self._is_tagged(proof, text):
            self._holders_left -= 1
            return True
        self._left -= 1
        return self._left >= 0

    def _objection_to_lease(self, raw: RawRequest, held: HeldGrant) -> Objection | None:
        """Return an objection if the request names a lease that was given to another grant.

        The arbiter knows holders by name only, and two grants may have the same name.
        """
        lease = self.lease
        if lease is None or lease.holder.id == held.id:
            return None
        request = codec.decode_request(BY_VERB[raw.verb], raw.payload)
        if isinstance(request, Leased) and request.lease == lease.id:
            return Objection(Reason.NO_LEASE, "the lease belongs to another grant")
        return None

    def _freshness(self, proof: RequestProof, now_ns: int) -> Objection | None:
        age_ns = self.challenge_age_ns(proof.challenge, now_ns)
        if isinstance(age_ns, Reason):
            return Objection(age_ns)
        if age_ns > CHALLENGE_MAX_NS:
            return Objection(Reason.TOO_OLD, f"{age_ns / 1e6:.0f} ms, at most {CHALLENGE_MAX_NS / 1e6:.0f} ms")
        return Objection(Reason.REPLAYED) if (proof.grant, proof.nonce) in self._nonces else None

    def _granted(self, raw: RawRequest, proof: RequestProof) -> HeldGrant | Objection:
        held = self._grants.get(proof.grant)
        if held is None:
            return Objection(Reason.GRANT_UNKNOWN)
        objection = self.trust.objection(held, self.now_s)
        if objection is not None:
            return objection
        if held.grant.name != raw.operator or held.grant.role not in ROLES:
            return Objection(Reason.NOT_GRANTED, f"it is for {held.grant.name}, {held.grant.role.value}")
        if raw.verb != STOP_VERB and raw.verb not in held.grant.verbs:
            return Objection(Reason.NOT_GRANTED, f"{raw.verb} is not among its verbs")
        return held

    # Replies.

    def reply(self, pending: PendingReply) -> PendingReply:
        """Sign a reply, and add the robot's public key if it gives a lease."""
        asked = self._asking.pop(pending.handle, None)
        if asked is None:
            return pending
        raw = asked.raw
        command = BY_VERB.get(raw.verb)
        if command is None or not raw.operator:
            # The query's key names no command, so there is no key expression to sign the reply for.
            return pending
        payload = pending.payload
        if asked.sender is not None:
            payload = self._give_lease(raw, asked.sender, payload)
        key = keys.command(self._root, self._robot, raw.operator, raw.verb)
        attachment = self._signer.reply(key, command.reply_encoding, payload, raw.attachment)
        return msgspec.structs.replace(pending, payload=payload, attachment=attachment)

    def _give_lease(self, raw: RawRequest, sender: HeldGrant, payload: bytes) -> bytes:
        """Note the holder of the lease that the reply gives, and agree on the lease's key."""
        request = codec.decode_request(BY_VERB[raw.verb], raw.payload)
        if not isinstance(request, Acquire | Take):
            return payload
        said = _LEASE_REPLY.decode(payload)
        if not said.ok:
            return payload
        private = self._new_private_key()
        drive = keys.command(self._root, self._robot, raw.operator, DRIVE_VERB)
        key = lease_key(private, request.public_key or b"", self._signer.boot, said.lease, drive)
        tags = None if key is None else DriveTags(key, said.lease, drive, BY_VERB[DRIVE_VERB].encoding)
        self.lease = GivenLease(said.lease, sender, tags)
        if tags is None:
            return payload
        return _ENCODER.encode(msgspec.structs.replace(said, public_key=public_bytes(private)))


def _credentials(held: HeldGrant | Objection) -> Credentials:
    if isinstance(held, Objection):
        return Credentials(held.reason, held.detail)
    return Credentials(
        Reason.NONE,
        serial=held.grant.serial,
        role=ROLES[held.grant.role],
        override=held.grant.override,
        speed_limit_mps=held.grant.speed_limit_mps,
    )


_ENCODER: Final = msgspec.msgpack.Encoder()
_LEASE_REPLY: Final = msgspec.msgpack.Decoder(LeaseReply)


WORDS_PER_TICK: Final = 4  # new lists of revocations, and rotations, verified in a tick (0.5 ms)
KEPT_WAITING: Final = 16  # statements of a kind that wait for the next tick; the excess is dropped at random


class StatementKind(Enum):
    """The kind of a statement by its text, which may be forged."""

    WORD = "a newer list of revocations, or rotation, in the name of the authority or the standby"
    KNOWN = "a grant that was verified"
    NEW = "a grant in the name of the authority"
    QUESTION = "empty: a client asks the robot for its identity"
    REST = "anything else"


_Item = TypeVar("_Item")
_CHANCE: Final = SystemRandom()


class StatementSieve(Generic[_Item]):
    """Queues of statements to verify, by kind."""

    def __init__(
        self,
        admission: SignedAdmission,
        sample: Callable[[list[Any], int], list[Any]] = _CHANCE.sample,
    ) -> None:
        self._admission = admission
        self._sample = sample
        self._waiting: dict[StatementKind, list[_Item]] = {kind: [] for kind in StatementKind}
        # The kinds in turn, the one chosen last at the end.
        self._turns: list[StatementKind] = [kind for kind in StatementKind if kind is not StatementKind.WORD]

    def choose(self, arrived: Iterable[tuple[bytes, _Item]]) -> list[_Item]:
        """Choose the statements to verify in this tick, from the new and the waiting ones.

        Args:
            arrived: text and item of each new statement.
        """
        for text, item in arrived:
            self._waiting[self.kind_of(text)].append(item)
        chosen = self._draw(StatementKind.WORD, WORDS_PER_TICK)
        kind = next((one for one in self._turns if self._waiting[one]), None)
        if kind is not None:
            self._turns.remove(kind)
            self._turns.append(kind)
            chosen += self._draw(kind, 1)
        for kind, items in self._waiting.items():
            if len(items) > KEPT_WAITING:
                self._waiting[kind] = self._sample(items, KEPT_WAITING)
        return chosen

    def kind_of(self, text: bytes) -> StatementKind:
        if not text:
            return StatementKind.QUESTION
        body, _, proofs = text.partition(b"\n")
        if (word := _WORD.match(body)) is not None:
            return StatementKind.WORD if self._is_news(word, proofs) else StatementKind.REST
        if body.startswith(_GRANT):
            if self._admission.known(statement_id(body)) is not None:
                return StatementKind.KNOWN
            if text.rstrip().rpartition(b"\n")[2].startswith(_by(self._admission.trust.active)):
                return StatementKind.NEW
        return StatementKind.REST

    def _draw(self, kind: StatementKind, most: int) -> list[_Item]:
        waiting = self._waiting[kind]
        places = self._sample(list(range(len(waiting))), min(most, len(waiting)))
        chosen = [waiting[place] for place in places]
        self._waiting[kind] = [item for place, item in enumerate(waiting) if place not in places]
        return chosen

    def _is_news(self, word: re.Match[bytes], proofs: bytes) -> bool:
        trust = self._admission.trust
        is_rotation, serial = word[1] == b"rotation", int(word[2])
        if serial <= (trust.rotation if is_rotation else trust.list_serial):
            return False
        signers = (trust.standby,) if is_rotation else (trust.active, trust.standby)
        return proofs.startswith(tuple(map(_by, signers)))


def _by(key: bytes) -> bytes:
    return f"{ALGORITHM} {key.hex()} ".encode()


_WORD: Final = re.compile(rb'\{"kind":"(revocations|rotation)","serial":(\d{1,16}),')
_GRANT: Final = b'{"kind":"grant",'
