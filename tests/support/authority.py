"""Authorities and people of a test, with keys that are drawn for it."""

from __future__ import annotations

import os
from typing import Any

import msgspec
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from gateway.authority.admission import SignedAdmission
from gateway.authority.robot_authority import AuthorityEffects, Kept, RobotAuthority, TimeFloor, trust_of
from gateway.authority.session import RobotSigner
from gateway.command.rulings import RawRequest
from schemas.authority.proof import (
    Grant,
    GrantRole,
    ProofKind,
    RequestProof,
    Revocations,
    RobotProof,
    Rotation,
    Signed,
    Statement,
    body_of,
    chain_text,
    signed_bytes,
)
from schemas.authority.trust import HeldGrant, Objection, Trust, fits
from schemas.decisions import StatementReply
from schemas.reasons import Reason
from schemas.settings import AuthoritySettings, Settings
from schemas.subjects import BY_VERB, STATEMENT_REPLY_ENCODING

NOW_S = 1_795_000_000
DAY_S = 86_400
S = 1_000_000_000
CHALLENGE = b"newest.."
VERBS = [verb for verb in BY_VERB if verb != "stop"]


class Party:
    """Somebody with a key: an authority, an operator, a robot."""

    def __init__(self, name: str = "somebody") -> None:
        self.name = name
        self.private = Ed25519PrivateKey.generate()
        self.chain: list[Signed] = []

    @property
    def key(self) -> bytes:
        return self.private.public_key().public_bytes_raw()

    def sign(self, statement: Statement) -> Signed:
        body = body_of(statement)
        return Signed(body, self.key, self.private.sign(signed_bytes(ProofKind.STATEMENT, body)), statement)

    def grant(self, to: Party, **changes: Any) -> list[Signed]:  # noqa: ANN401 - fields of a grant
        """Grant everything, but for the changes. Returns the party's chain from then on."""
        said: dict[str, Any] = {
            "serial": 1,
            "name": to.name,
            "key": to.key.hex(),
            "role": GrantRole.OPERATOR,
            "robots": ["*"],
            "verbs": VERBS,
            "not_before": NOW_S - DAY_S,
            "not_after": NOW_S + DAY_S,
        }
        to.chain = [self.sign(Grant(**(said | changes))), *self.chain]
        return to.chain

    def revoke(
        self, serial: int, *held: HeldGrant, keys: tuple[bytes, ...] = (), epoch: int = 0, at: int = NOW_S
    ) -> Signed:
        return self.sign(
            Revocations(
                serial=serial,
                at=at,
                grants=[one.id.hex() for one in held],
                keys=[key.hex() for key in keys],
                epoch=epoch,
            )
        )

    def rotate(self, serial: int, active: Party, standby: Party, epoch: int = 0) -> Signed:
        return self.sign(
            Rotation(serial=serial, at=NOW_S, active=active.key.hex(), standby=standby.key.hex(), epoch=epoch)
        )

    def prove(self, key: str, encoding: str, payload: bytes, challenge: bytes, nonce: bytes = b"") -> bytes:
        """The attachment of a request of this party."""
        proof = RequestProof(self.chain[0].id, challenge, nonce or os.urandom(8))
        signature = self.private.sign(proof.signed(key, encoding, payload))
        return msgspec.structs.replace(proof, signature=signature).attachment()


class Fleet:
    """A fleet's authority with its standby, and the trust that its robots begin with."""

    def __init__(self) -> None:
        self.authority = Party("authority")
        self.standby = Party("standby")
        self.trust = Trust(self.authority.key, self.standby.key)

    def site(self, **changes: Any) -> Party:  # noqa: ANN401 - fields of a grant
        """A party that grants, as an earlier version let sites do."""
        site = Party("depot")
        self.authority.grant(site, **({"role": GrantRole.SITE, "may_delegate": 1, "override": True} | changes))
        return site

    def operator(self, name: str = "ann", **changes: Any) -> Party:  # noqa: ANN401 - fields of a grant
        operator = Party(name)
        self.authority.grant(operator, **changes)
        return operator


class AuthorityBench:
    def __init__(
        self,
        fleet: Fleet | None = None,
        kept: Kept | None = None,
        **settings: Any,  # noqa: ANN401
    ) -> None:
        self.fleet = fleet or Fleet()
        self.robot = Party("cruiser-1")
        self.fleet.authority.grant(self.robot, role=GrantRole.ROBOT, robots=["cruiser-1"])
        self.signer = RobotSigner(self.robot.private, b"boot no1")
        given = Settings(authority=AuthoritySettings(mode="signed", **settings))
        admission = SignedAdmission(given, self.fleet.trust, self.signer, self._age)
        kept = kept or Kept()
        floor = TimeFloor(kept.floor_s, 0)
        own = self.robot.chain
        self.authority = RobotAuthority(given, admission, self.signer, floor, own, kept)
        self.now_ns = 0
        self.wall_s = NOW_S
        self._bars: dict[Reason, str] = {}
        self.begun = self.tick()

    @staticmethod
    def _age(challenge: bytes, _now_ns: int) -> int | Reason:
        return 20_000_000 if challenge == CHALLENGE else Reason.CHALLENGE_UNKNOWN

    def tick(self, after_ns: int = S) -> AuthorityEffects:
        self.now_ns += after_ns
        effects = self.authority.tick(self.now_ns, self.now_ns, self.wall_s * S)
        self._bars = effects.bars if effects.bars is not None else self._bars
        return effects

    def show(self, text: str) -> StatementReply:
        """Show a statement. The reply has to be the robot's."""
        raw = RawRequest(1, "", "", text.encode(), len(text))
        pending = self.authority.receive(raw, self.now_ns)
        proof = RobotProof.read(pending.attachment)
        assert proof is not None
        signed = proof.signed_reply("fleet/cruiser-1/@auth", STATEMENT_REPLY_ENCODING, pending.payload, b"")
        assert fits(self.robot.key, proof.signature, signed)
        return msgspec.msgpack.decode(pending.payload, type=StatementReply)

    def bars(self) -> dict[Reason, str]:
        """The reasons against engaging, a second later."""
        self.tick()
        return self._bars

    def takes(self, *signed: Signed | str) -> None:
        for one in signed:
            assert self.show(one if isinstance(one, str) else one.text()).ok

    def chain_of(self, name: str, **changes: Any) -> str:  # noqa: ANN401 - fields of a grant
        return chain_text(self.fleet.operator(name, **changes).chain)

    @property
    def own(self) -> str:
        return chain_text(self.robot.chain)

    def regrant(self, by: Party | None = None, **changes: Any) -> str:  # noqa: ANN401 - fields of a grant
        """Another grant for the robot's key."""
        self.robot.chain = []
        said: dict[str, Any] = {"role": GrantRole.ROBOT, "robots": ["cruiser-1"]}
        (by or self.fleet.authority).grant(self.robot, **(said | changes))
        return self.own

    def restarted(self) -> Trust:
        """The trust after a restart with the note of the next tick."""
        kept = self.tick().kept
        assert kept is not None
        trust = trust_of(self.fleet.trust, kept)
        assert not isinstance(trust, Objection)
        return trust
