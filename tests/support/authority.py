"""Authorities and people of a test, with keys that are drawn for it."""

from __future__ import annotations

import os
from typing import Any

import msgspec
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey

from gateway.authority.admission import SignedAdmission
from gateway.authority.operator_proof import OperatorProof, new_lease_key
from gateway.authority.robot_authority import AuthorityEffects, Kept, RobotAuthority, TimeFloor
from gateway.authority.session import RobotSigner
from gateway.command.flow import PendingReply
from gateway.command.rulings import Credentials, RawRequest
from gateway.telemetry.samples import Received
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
from schemas.decisions import LeaseReply, StatementReply
from schemas.reasons import Reason
from schemas.requests import Acquire, Drive
from schemas.settings import AuthoritySettings, Settings
from schemas.subjects import BY_NAME, BY_VERB, STATEMENT_REPLY_ENCODING

NOW_S = 1_795_000_000
DAY_S = 86_400
S = 1_000_000_000
CHALLENGE = b"newest.."
AUTH = "fleet/cruiser-1/@auth"
QUESTION = b"who are you now?"
VERBS = [verb for verb in BY_VERB if verb != "stop"]


class Party:
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
        """Grant a party everything but for ``changes``; the grant is that party's chain from then on."""
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
        proof = RequestProof(self.chain[0].id, challenge, nonce or os.urandom(8))
        signature = self.private.sign(proof.signed(key, encoding, payload))
        return msgspec.structs.replace(proof, signature=signature).attachment()


class Fleet:
    def __init__(self) -> None:
        self.authority = Party("authority")
        self.standby = Party("standby")
        self.trust = Trust(self.authority.key, self.standby.key)

    def site(self, **changes: Any) -> Party:  # noqa: ANN401 - fields of a grant
        """A party that grants, as earlier versions let sites do."""
        site = Party("depot")
        self.authority.grant(site, **({"role": GrantRole.SITE, "may_delegate": 1, "override": True} | changes))
        return site

    def operator(self, name: str = "ann", **changes: Any) -> Party:  # noqa: ANN401 - fields of a grant
        operator = Party(name)
        self.authority.grant(operator, **changes)
        return operator


class AuthorityBench:
    def __init__(self, fleet: Fleet | None = None, kept: Kept | None = None) -> None:
        self.fleet = fleet or Fleet()
        self.robot = Party("cruiser-1")
        self.fleet.authority.grant(self.robot, role=GrantRole.ROBOT, robots=["cruiser-1"])
        self.signer = RobotSigner(self.robot.private, b"boot no1")
        given = Settings(authority=AuthoritySettings(mode="signed"))
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
        """Send a statement, and check that the reply is the robot's."""
        raw = RawRequest(1, "", "", text.encode(), len(text))
        pending = self.authority.receive(raw, self.now_ns)
        proof = RobotProof.read(pending.attachment)
        assert proof is not None
        signed = proof.signed_reply("fleet/cruiser-1/@auth", STATEMENT_REPLY_ENCODING, pending.payload, b"")
        assert fits(self.robot.key, proof.signature, signed)
        return msgspec.msgpack.decode(pending.payload, type=StatementReply)

    def bars(self) -> dict[Reason, str]:
        """Reasons why the robot cannot be engaged, a second later."""
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


class Pair:
    """An operator and a robot of one fleet, connected by bytes only."""

    def __init__(self, *, met: bool = True, **granted: Any) -> None:  # noqa: ANN401 - fields of a grant
        self.bench = AuthorityBench()
        self.ann = self.bench.fleet.operator(**granted)
        self.proof = self.new_proof()
        self.refusal = self.meet() if met else None

    def new_proof(self) -> OperatorProof:
        return OperatorProof(self.ann.private, self.ann.chain, self.bench.fleet.trust, "fleet", lambda: NOW_S)

    def meet(self, question: bytes = QUESTION) -> Objection | None:
        return self.proof.meet("cruiser-1", self.shown(question), question)

    def believes(self, received: Received, **changes: Any) -> bool:  # noqa: ANN401 - what arrives
        return self.proof.believes("cruiser-1", msgspec.structs.replace(received, **changes))

    def leased(self, lease: int) -> tuple[Credentials, X25519PrivateKey, bytes, Received]:
        private, public = new_lease_key()
        credentials, reply, request = self.ask(
            "acquire", msgspec.msgpack.encode(Acquire(public_key=public)), given(lease)
        )
        return credentials, private, request, reply

    @property
    def robot(self) -> RobotAuthority:
        return self.bench.authority

    def shown(self, question: bytes = QUESTION) -> Received:
        raw = RawRequest(1, "", "", self.proof.statement, len(self.proof.statement), attachment=question)
        reply = self.robot.receive(raw, self.bench.now_ns)
        return Received(AUTH, STATEMENT_REPLY_ENCODING, reply.payload, reply.attachment)

    def state(self, sequence: int, subject: str = "safety/state", boot: bytes = b"boot no1") -> Received:
        known, key = BY_NAME[subject], f"fleet/cruiser-1/{subject}"
        payload = msgspec.msgpack.encode({"time_ns": 1, "sequence": sequence})
        signer = RobotSigner(self.bench.robot.private, boot)
        return Received(key, known.encoding, payload, signer.publication(key, known.encoding, payload))

    def restart(self, boot: bytes) -> None:
        self.robot.signer = RobotSigner(self.bench.robot.private, boot)

    def ask(self, verb: str, payload: bytes, said: bytes = b"") -> tuple[Credentials, Received, bytes]:
        self.bench.tick()
        attachment = self.proof.request("cruiser-1", verb, payload, CHALLENGE)
        admission = self.robot.admission
        raw = admission.admit(RawRequest(7, verb, "ann", payload, len(payload), attachment=attachment), 0)
        assert raw.credentials is not None
        reply = admission.reply(PendingReply(7, verb, said))
        key = f"fleet/cruiser-1/@cmd/ann/{verb}"
        received = Received(key, BY_VERB[verb].reply_encoding, reply.payload, reply.attachment)
        return raw.credentials, received, attachment

    def drives(self, lease: int) -> Credentials:
        payload = msgspec.msgpack.encode(
            Drive(lease=lease, seq=1, challenge=CHALLENGE, speed_mps=0.1, angle_deg=0)
        )
        raw = RawRequest(0, "drive", "ann", payload, len(payload), attachment=self.proof.drive(payload))
        credentials = self.robot.admission.admit(raw, 0).credentials
        assert credentials is not None
        return credentials


def given(lease: int) -> bytes:
    return msgspec.msgpack.encode(
        LeaseReply(ok=True, reason=Reason.NONE, detail="", cure="", lease=lease, expires_s=2.0)
    )
