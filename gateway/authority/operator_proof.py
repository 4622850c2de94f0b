"""The operator's half: sign requests, and believe of a robot only what that robot signed. Pure.

Before anything else a robot is met: it is shown the operator's grant, and its reply has the chain of its own
grant, which ends at the same authority. From then on its replies and states are held against its key.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable
from typing import Final

import msgspec
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey

from gateway.authority.lease_key import DriveTags, lease_key, public_bytes
from gateway.telemetry.received import Received
from schemas import keys
from schemas.authority.identity import prove_request
from schemas.authority.proof import SIGNED, RequestProof, RobotProof
from schemas.authority.statement import Grant, GrantRole, Signed, StatementFault, chain_text, read_chain
from schemas.authority.trust import Objection, Trust, fits
from schemas.codec import PAYLOAD_ERRORS
from schemas.decisions import LeaseReply, StatementReply
from schemas.reasons import Reason
from schemas.subjects import BY_VERB, DRIVE_VERB, STATEMENT_REPLY_ENCODING

NONCE_BYTES: Final = 8

DRIVE: Final = BY_VERB[DRIVE_VERB]


class KnownRobots:
    """The keys of the robots that were met: what a viewer needs to believe a robot."""

    def __init__(self, trust: Trust, root: str, now_s: Callable[[], int]) -> None:
        """No robot is met yet.

        Args:
            trust: the fleet's authority.
            root: first chunks of every key expression.
            now_s: the time, seconds since 1970.
        """
        self._trust = trust
        self._root = root
        self._now_s = now_s
        self._robots: dict[str, bytes] = {}

    def meet(self, robot: str, received: Received) -> Objection | None:
        """A robot's reply to the statement. Returns why it is no robot of this fleet, or refuses the grant."""
        try:
            said = _STATEMENT_REPLY.decode(received.payload)
        except PAYLOAD_ERRORS as error:
            return Objection(Reason.MALFORMED, str(error)[:200])
        chain, proof = read_chain(said.own.encode()), RobotProof.read(received.attachment)
        if isinstance(chain, StatementFault) or proof is None:
            return Objection(Reason.PROOF_MISSING, "the reply is not signed")
        held = self._trust.judge(chain, self._now_s())
        if isinstance(held, Objection):
            return held
        if held.grant.role is not GrantRole.ROBOT or held.grant.name != robot:
            return Objection(Reason.NOT_GRANTED, f"the reply is of {held.grant.name}, not of {robot}")
        key = keys.authority(self._root, robot)
        if not fits(
            held.key, proof.signature, proof.signed_reply(key, STATEMENT_REPLY_ENCODING, received.payload, b"")
        ):
            return Objection(Reason.PROOF_WRONG, "the reply is not the robot's")
        self._robots[robot] = held.key
        return None if said.ok else Objection(said.reason, said.detail)

    def has_met(self, robot: str) -> bool:
        """The key of this robot is known."""
        return robot in self._robots

    def is_reply(self, robot: str, received: Received, request: bytes) -> bool:
        """Is it this robot's reply to the request that had this attachment?"""
        proof, known = RobotProof.read(received.attachment), self._robots.get(robot)
        if proof is None or known is None:
            return False
        text = proof.signed_reply(received.key, received.encoding, received.payload, request)
        return received.key.startswith(f"{self._root}/{robot}/") and fits(known, proof.signature, text)

    def believes(self, robot: str, received: Received) -> bool:
        """May a sample of this robot be believed? What people decide by it has to have signed."""
        subject = received.key.removeprefix(f"{self._root}/{robot}/")
        return subject not in SIGNED or self.is_state(robot, received)

    def is_state(self, robot: str, received: Received) -> bool:
        """Did this robot sign what it is said to have published?"""
        proof, known = RobotProof.read(received.attachment), self._robots.get(robot)
        if proof is None or known is None:
            return False
        text = proof.signed_publication(received.key, received.encoding, received.payload)
        return received.key.startswith(f"{self._root}/{robot}/") and fits(known, proof.signature, text)


class OperatorProof(KnownRobots):
    """An operator's key and grant, and the robots that were met.

    Attributes:
        name: under which the grant lets its holder command.
        statement: the grant with its chain, to be shown to robots.
    """

    def __init__(
        self,
        private: Ed25519PrivateKey,
        chain: list[Signed],
        trust: Trust,
        root: str,
        now_s: Callable[[], int],
        nonce: Callable[[int], bytes] = secrets.token_bytes,
    ) -> None:
        """No robot is met yet.

        Args:
            private: the operator's key.
            chain: its grant, and those of its signers.
            trust: the fleet's authority.
            root: first chunks of every key expression.
            now_s: the time, seconds since 1970.
            nonce: random bytes, so many.
        """
        super().__init__(trust, root, now_s)
        grant = chain[0].statement
        self.name = grant.name if isinstance(grant, Grant) else ""
        self.statement = chain_text(chain).encode()
        self._private = private
        self._grant = chain[0].id
        self._nonce = nonce
        self._tags: DriveTags | None = None

    def request(self, robot: str, verb: str, payload: bytes, challenge: bytes) -> bytes:
        """The attachment of a verb.

        Args:
            robot: its name.
            verb: what is asked.
            payload: the bytes that are sent.
            challenge: the newest one that the robot published.
        """
        proof = RequestProof(self._grant, challenge, self._nonce(NONCE_BYTES))
        key = keys.command(self._root, robot, self.name, verb)
        return prove_request(self._private, proof, key, BY_VERB[verb].encoding, payload)

    def begin_lease(self, robot: str, private: X25519PrivateKey, reply: LeaseReply, attachment: bytes) -> bool:
        """Agree with the robot on the key of a lease; False if its reply has no key.

        Args:
            robot: its name.
            private: the key whose public half was in the request.
            reply: the robot's, which was verified.
            attachment: the reply's.
        """
        proof = RobotProof.read(attachment)
        if proof is None or reply.public_key is None:
            return False
        expression = keys.command(self._root, robot, self.name, DRIVE.verb)
        key = lease_key(private, reply.public_key, proof.boot, reply.lease, expression)
        self._tags = None if key is None else DriveTags(key, reply.lease, expression, DRIVE.encoding)
        return self._tags is not None

    def drive(self, payload: bytes) -> bytes:
        """The attachment of a drive command under the lease; empty without one."""
        return b"" if self._tags is None else self._tags.attachment(payload)


def new_lease_key() -> tuple[X25519PrivateKey, bytes]:
    """A key for one lease: the private half, and the public one for the request."""
    private = X25519PrivateKey.generate()
    return private, public_bytes(private)


_STATEMENT_REPLY: Final = msgspec.msgpack.Decoder(StatementReply)
