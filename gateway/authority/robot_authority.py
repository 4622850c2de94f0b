"""The authority over this robot: statements, the floor of time, the proof of the robot's name. Pure.

Statements come from any client, by the query ``@auth``: only their signatures count. Grants are held in memory;
revocations, rotations and the floor of time survive a restart.

The floor is the newest time in a verified statement, plus the time that has passed since. Setting the wall clock
back revives no expired grant; setting it forward only ends grants sooner. Only a rotation to a new authority
lowers it.

A robot's certificate says only that it is a robot, so any gateway could answer on ``gateway/info`` under any name.
The answer is therefore signed over random bytes of the query, and contains the robot's grant.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import msgspec

from gateway.authority.admission import SignedAdmission
from gateway.authority.session import RobotSigner
from gateway.command.flow import PendingReply
from gateway.command.rulings import RawRequest, Ruling
from schemas import codec, keys
from schemas.authority.proof import (
    ROBOT_PROOF_BYTES,
    Grant,
    GrantRole,
    Revocations,
    RobotProof,
    Rotation,
    Signed,
    StatementFault,
    chain_text,
    read_chain,
)
from schemas.authority.trust import AuthorityKeys, HeldGrant, Objection, Trust, fits
from schemas.codec import Sample
from schemas.decisions import SignedStatement, StatementReply
from schemas.messages import SEQUENCE_MAX
from schemas.reasons import TEXTS, Reason
from schemas.settings import Settings
from schemas.subjects import BY_NAME, STATEMENT_REPLY_ENCODING, TEXT_MAX_BYTES

_S: Final = 1_000_000_000


class TimeFloor:
    """A lower bound of the time."""

    def __init__(self, floor_s: int, boot_ns: int) -> None:
        """Begin with a stored floor; ``boot_ns`` is the time since the machine's start (CLOCK_BOOTTIME)."""
        self.restart(floor_s, boot_ns)

    def least_s(self, boot_ns: int) -> int:
        return self._floor_s + max(0, boot_ns - self._since_ns) // _S

    def now_s(self, boot_ns: int, wall_s: int) -> int:
        """The time by which grants are judged: the later one of floor and wall clock."""
        return max(self.least_s(boot_ns), wall_s)

    def restart(self, at_s: int, boot_ns: int) -> None:
        """Take the time from a new authority: a thief of the former one's key may have signed any time."""
        self._floor_s, self._since_ns = at_s, boot_ns

    def lift(self, at_s: int, boot_ns: int) -> None:
        """Raise the floor to the time in a verified statement, seconds since 1970."""
        if at_s > self.least_s(boot_ns):
            self.restart(at_s, boot_ns)


_INFO: Final = BY_NAME["gateway/info"]


class NameProof:
    """Proves the robot's name, and checks other gateways' claims to it."""

    def __init__(
        self,
        settings: Settings,
        signer: RobotSigner,
        admission: SignedAdmission,
        own: Callable[[], list[Signed]],
    ) -> None:
        self._robot = settings.robot.name
        self._key = keys.build(settings.robot.root, settings.robot.name, _INFO)
        self._signer = signer
        self._admission = admission
        self._own = own

    def attachment(self, payload: bytes, question: bytes) -> bytes:
        """The attachment of an answer: the robot's proof, then its grant as text."""
        return self._signer.reply(self._key, _INFO.encoding, payload, question) + chain_text(self._own()).encode()

    def is_namesake(self, payload: bytes, attachment: bytes, question: bytes, now_s: int) -> bool:
        """Return True if an answer comes from a gateway with this robot's key, or with a grant for its name."""
        proof = RobotProof.read(attachment[:ROBOT_PROOF_BYTES])
        if proof is None or len(attachment) > ROBOT_PROOF_BYTES + TEXT_MAX_BYTES:
            return False
        text = proof.signed_reply(self._key, _INFO.encoding, payload, question)
        if fits(self._signer.public_key, proof.signature, text):
            return True
        chain = read_chain(attachment[ROBOT_PROOF_BYTES:])
        if isinstance(chain, StatementFault):
            return False
        # Judged at the grant's beginning if this computer's clock is behind.
        starts = [one.statement.not_before for one in chain if isinstance(one.statement, Grant)]
        held = self._admission.trust.judge(chain, max([now_s, *starts]))
        return (
            isinstance(held, HeldGrant)
            and (held.grant.role, held.grant.name) == (GrantRole.ROBOT, self._robot)
            and fits(held.key, proof.signature, text)
        )


REPEAT_NS: Final = 60_000_000_000  # period of publishing the grants in use, for logs that begin later
BARS_NS: Final = 1_000_000_000  # period of judging whether the robot may be engaged
SAVE_NS: Final = 60_000_000_000  # period of saving the floor of time


class Kept(msgspec.Struct, frozen=True):
    """The state of the authority that survives a restart.

    Attributes:
        own: the robot's own grant, if it was renewed since it was provisioned.
        revocations: the newest list, signed; empty if the active authority has sent none.
        rotations: all that were accepted, signed, in their order.
        epoch: grants of a lower one are not valid.
        floor_s: the floor of time, seconds since 1970.
        since: the authority that was provisioned when the first statement was accepted.
    """

    own: str = ""
    revocations: str = ""
    rotations: list[str] = []
    epoch: int = 0
    floor_s: int = 0
    since: AuthorityKeys | None = None


def resume(provisioned: Trust, kept: Kept) -> tuple[Trust, Kept] | Objection:
    """The trust at a start, and the stored state as far as it belongs to the installed authority.

    After a rotation the next bundle installs the new authority's keys: the stored state remains valid. Keys of an
    unrelated authority discard it.

    Args:
        provisioned: the trust in the installed keys.
    """
    since = provisioned if kept.since is None else kept.since.trust
    trust = trust_of(since, kept)
    here = (provisioned.active, provisioned.standby)
    begins = AuthorityKeys(provisioned.active.hex(), provisioned.standby.hex())
    if here == (since.active, since.standby):
        return trust if isinstance(trust, Objection) else (trust, msgspec.structs.replace(kept, since=begins))
    if not isinstance(trust, Objection) and here in _led_to(kept.rotations):
        return trust, kept
    return provisioned, Kept(since=begins)


def _led_to(rotations: list[str]) -> set[tuple[bytes, bytes]]:
    """The keys of each authority that these verified rotations led to."""
    chains = (read_chain(text.encode()) for text in rotations)
    found = (chain[0].statement for chain in chains if not isinstance(chain, StatementFault))
    return {(bytes.fromhex(one.active), bytes.fromhex(one.standby)) for one in found if isinstance(one, Rotation)}


def trust_of(trust: Trust, kept: Kept) -> Trust | Objection:
    """The trust after all rotations and revocations that were accepted since provisioning."""
    for text in filter(None, (*kept.rotations, kept.revocations)):
        chain = read_chain(text.encode())
        if isinstance(chain, StatementFault):
            return Objection(Reason.MALFORMED, chain.detail)
        newer = trust.revoke(chain[0]) if text == kept.revocations else trust.rotate(chain[0])
        if isinstance(newer, Objection):
            return newer
        trust = newer
    return msgspec.structs.replace(trust, epoch=max(trust.epoch, kept.epoch))


class AuthorityEffects(msgspec.Struct):
    """Actions of one tick."""

    samples: list[Sample]
    bars: dict[Reason, str] | None = None
    ended: Objection | None = None
    kept: Kept | None = None


class RobotAuthority:
    """The authority, as a robot knows it.

    Attributes:
        self_test: the fault of the gateway's own files or endpoints; empty if there is none.
        unsaved: why the state could not be saved; empty if it was.
    """

    def __init__(
        self,
        settings: Settings,
        admission: SignedAdmission,
        signer: RobotSigner,
        floor: TimeFloor,
        own: list[Signed],
        kept: Kept,
    ) -> None:
        self.admission = admission
        self.signer = signer
        self.self_test = self.unsaved = ""
        self.name_proof = NameProof(settings, signer, admission, lambda: self._own)
        self._key = keys.authority(settings.robot.root, settings.robot.name)
        self._floor = floor
        self._own = own
        self._own_held: HeldGrant | None = None
        self._kept = kept
        self._is_changed = False
        self._bars: dict[Reason, str] = {}
        self._new: list[str] = []
        self._sequence = 0
        self._bars_due_ns = self._repeat_due_ns = self._save_due_ns = 0

    def receive(self, raw: RawRequest, boot_ns: int) -> PendingReply:
        """Handle a client's statement. Returns the reply: accepted, or why not."""
        refusal = self._take_over(raw.payload, boot_ns)
        ruling = Ruling() if refusal is None else Ruling(refusal.reason, refusal.detail)
        accepted, cure = ruling.reason is Reason.NONE, TEXTS[ruling.reason].cure
        said = StatementReply(accepted, ruling.reason, ruling.text, cure, own=chain_text(self._own))
        payload = _ENCODER.encode(said)
        attachment = self.signer.reply(self._key, STATEMENT_REPLY_ENCODING, payload, raw.attachment)
        return PendingReply(raw.handle, raw.verb, payload, attachment)

    def _take_over(self, text: bytes, boot_ns: int) -> Objection | None:
        chain = read_chain(text)
        if isinstance(chain, StatementFault):
            return Objection(Reason.MALFORMED, chain.detail)
        match chain[0].statement:
            case Grant():
                return self._introduce(chain, boot_ns)
            case Revocations() | Rotation() as statement:
                return self._replace_trust(chain[0], statement, boot_ns)

    @property
    def grant_ends_s(self) -> int | None:
        """The end of the robot's own grant, seconds since 1970; None if it has none."""
        return min(
            (one.statement.not_after for one in self._own if isinstance(one.statement, Grant)), default=None
        )

    def know_time(self, boot_ns: int, wall_ns: int) -> None:
        self.admission.now_s = self._floor.now_s(boot_ns, wall_ns // 1_000_000_000)

    def tick(self, now_ns: int, boot_ns: int, wall_ns: int) -> AuthorityEffects:
        """Compute the effects of the authority, every 10 ms."""
        admission = self.admission
        self.know_time(boot_ns, wall_ns)
        admission.begin_tick(now_ns)
        effects = AuthorityEffects(self._statements(now_ns, wall_ns), ended=admission.objection_to_holder())
        if now_ns >= self._bars_due_ns or self._faults() != self._bars.get(Reason.SELF_TEST, ""):
            # Once a second is enough: ``ended`` ends a drive at once.
            self._bars_due_ns = now_ns + BARS_NS
            bars = self._bars_now(boot_ns)
            if bars != self._bars:
                self._bars = effects.bars = bars
        if self._is_changed or now_ns >= self._save_due_ns:
            self._is_changed, self._save_due_ns = False, now_ns + SAVE_NS
            effects.kept = self.to_keep(boot_ns)
        return effects

    def to_keep(self, boot_ns: int) -> Kept:
        self._kept = msgspec.structs.replace(self._kept, floor_s=self._floor.least_s(boot_ns))
        return self._kept

    def _introduce(self, chain: list[Signed], boot_ns: int) -> Objection | None:
        known = self.admission.known(chain[0].id)
        held = self.admission.introduce(chain)
        if isinstance(held, Objection):
            return held
        if held is not known:
            self._floor.lift(held.grant.not_before, boot_ns)
            self._new.append(held.signed.text())
        if held.key == self.signer.public_key and held.grant.role is GrantRole.ROBOT:
            own = self._own_grant()
            if isinstance(own, Objection) or held.grant.not_after > own.grant.not_after:
                self._own, self._own_held, self._is_changed = [held.signed], held, True
                self._kept = msgspec.structs.replace(self._kept, own=held.signed.text())
        return None

    def _own_grant(self) -> HeldGrant | Objection:
        """The robot's own grant, or why it is not valid. Its signature is verified until it fits once."""
        trust, now_s = self.admission.trust, self.admission.now_s
        if self._own_held is None:
            judged = trust.judge(self._own, now_s)
            if isinstance(judged, Objection):
                return judged
            self._own_held = judged
        return trust.objection(self._own_held, now_s) or self._own_held

    def _replace_trust(self, signed: Signed, statement: Revocations | Rotation, boot_ns: int) -> Objection | None:
        trust = self.admission.trust
        is_rotation, text = isinstance(statement, Rotation), signed.text()
        if text in self._kept.rotations:
            return Objection(Reason.REPLAYED, f"rotation {statement.serial} was accepted before")
        newer = trust.rotate(signed) if is_rotation else trust.revoke(signed)
        if isinstance(newer, Objection):
            return newer
        self.admission.trust = newer
        if is_rotation:
            self._floor.restart(statement.at, boot_ns)
            # The former authority's list ends with it: after another rotation its key may be active again.
            rotations = [*self._kept.rotations, text]
            self._kept = msgspec.structs.replace(
                self._kept, epoch=newer.epoch, rotations=rotations, revocations=""
            )
        else:
            self._floor.lift(statement.at, boot_ns)
            self._kept = msgspec.structs.replace(self._kept, epoch=newer.epoch, revocations=text)
        self._new.append(text)
        self._is_changed = True
        return None

    def _faults(self) -> str:
        """Return the faults of the gateway's own files and endpoints, and of saving; empty if there are none."""
        forgets = f"{self.unsaved}: a restart would lose revocations" if self.unsaved else ""
        return "; ".join(filter(None, (self.self_test, forgets)))

    def _bars_now(self, boot_ns: int) -> dict[Reason, str]:
        bars = {Reason.SELF_TEST: faults} if (faults := self._faults()) else {}
        own = self._own_grant()
        if isinstance(own, Objection):
            # Without the current time: a text that changes each minute would be an event each minute.
            bars[own.reason] = f"the robot's own grant: {own.text.partition(', and here')[0]}"
        else:
            self._floor.lift(own.grant.not_before, boot_ns)
        return bars

    def _statements(self, now_ns: int, wall_ns: int) -> list[Sample]:
        """The new statements; once a minute also those in use, for logs that began later."""
        texts, self._new = self._new, []
        if now_ns >= self._repeat_due_ns:
            self._repeat_due_ns = now_ns + REPEAT_NS
            lease = self.admission.lease
            in_use = "" if lease is None else lease.holder.signed.text()
            repeated = (*self._kept.rotations, chain_text(self._own), in_use, self._kept.revocations)
            texts += [text for text in repeated if text]
        return [self._sample(text, wall_ns) for text in texts]

    def _sample(self, text: str, wall_ns: int) -> Sample:
        sequence, self._sequence = self._sequence, (self._sequence + 1) & SEQUENCE_MAX
        message = SignedStatement(time_ns=wall_ns, sequence=sequence, text=text)
        return Sample("authority/statement", codec.encode(message))


_ENCODER: Final = msgspec.msgpack.Encoder()
