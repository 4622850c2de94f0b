"""The operator's half of signed mode: sign requests, and verify what robots sign. Pure.

First the operator meets a robot: it sends its grant, and the robot's reply contains the robot's own grant by the
same authority. From then on the robot's replies and states are checked with its key.

Signed samples can be recorded and replayed by a third party. The robot's reply therefore covers random bytes of
the question and names the robot's current run. States of another run are rejected, and within a run those that are
not newer than the last one.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable
from typing import Final

import msgspec
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey

from gateway.authority.session import (
    SILENT,
    UNSIGNED,
    DriveTags,
    Unmet,
    lease_key,
    not_believed,
    not_taken,
    public_bytes,
)
from gateway.telemetry.samples import Received
from schemas import keys
from schemas.authority.proof import (
    Grant,
    GrantRole,
    RequestProof,
    RobotProof,
    Signed,
    StatementFault,
    chain_text,
    prove_request,
    read_chain,
)
from schemas.authority.trust import Objection, Trust, fits
from schemas.codec import PAYLOAD_ERRORS
from schemas.command_line import UsageError
from schemas.decisions import LeaseReply, StatementReply
from schemas.messages import SEQUENCE_MAX, Sequence
from schemas.reasons import Reason
from schemas.subjects import BY_VERB, DRIVE_VERB, SIGNED, STATEMENT_REPLY_ENCODING, STOP_VERB

NONCE_BYTES: Final = 8
QUESTION_BYTES: Final = 16  # random, for each query of a robot's identity, against replayed replies
DRIVE: Final = BY_VERB[DRIVE_VERB]


class _Known(msgspec.Struct):
    """A robot that was met.

    Attributes:
        boot: its run, by its newest reply to one of our questions.
        newest: the sequence of the newest sample that was accepted, by subject.
        is_other_run_seen: a sample of another run with its signature came: it restarted, or the sample is a
            replay.
    """

    key: bytes
    boot: bytes
    newest: dict[str, int]
    is_other_run_seen: bool = False


class KnownRobots:
    """The robots that were met, and the checks of what they sign.

    Attributes:
        statement: the grant that is sent to robots; empty without one.
    """

    statement = b""

    def __init__(self, trust: Trust, root: str, now_s: Callable[[], int]) -> None:
        self._trust = trust
        self._root = root
        self._now_s = now_s
        self._robots: dict[str, _Known] = {}
        self._unmet: dict[str, Unmet] = {}

    def unmet(self, robot: str) -> Unmet | None:
        """Return why the robot's newest reply was not accepted; None if it was, or if there is none."""
        return self._unmet.get(robot)

    def doubt(self, robot: str) -> Unmet:
        """Return why a reply of this robot cannot be verified."""
        unmet = self._unmet.get(robot)
        if unmet is not None and not unmet.is_refusal:
            return unmet
        return UNSIGNED if self.has_met(robot) else SILENT

    def meet(self, robot: str, received: Received, question: bytes) -> Objection | None:
        """Check a robot's reply to the statement. Returns why it is not of this fleet, or refuses the grant.

        Args:
            question: the attachment of the query (``new_question``).
        """
        try:
            said = _STATEMENT_REPLY.decode(received.payload)
        except PAYLOAD_ERRORS as error:
            objection = Objection(Reason.MALFORMED, str(error)[:200])
            self._unmet[robot] = not_believed(objection, [], self._trust)
            return objection
        chain = read_chain(said.own.encode())
        doubt = self._doubt(robot, received, question, chain)
        if doubt is not None:
            own = [] if isinstance(chain, StatementFault) else chain
            self._unmet[robot] = not_believed(doubt, own, self._trust)
            return doubt
        if said.ok:
            self._unmet.pop(robot, None)
            return None
        refusal = Objection(said.reason, said.detail)
        self._unmet[robot] = not_taken(refusal, said.cure)
        return refusal

    def _doubt(
        self, robot: str, received: Received, question: bytes, chain: list[Signed] | StatementFault
    ) -> Objection | None:
        """Return why a reply is not this robot's; None if it is, and the robot is known from then on."""
        proof = RobotProof.read(received.attachment)
        if isinstance(chain, StatementFault) or proof is None:
            return Objection(Reason.PROOF_MISSING, "the reply is not signed")
        held = self._trust.judge(chain, self._now_s())
        if isinstance(held, Objection):
            return held
        if held.grant.role is not GrantRole.ROBOT or held.grant.name != robot:
            return Objection(Reason.NOT_GRANTED, f"the reply is from {held.grant.name}, not from {robot}")
        key = keys.authority(self._root, robot)
        if not fits(
            held.key,
            proof.signature,
            proof.signed_reply(key, STATEMENT_REPLY_ENCODING, received.payload, question),
        ):
            return Objection(Reason.PROOF_WRONG, "the reply is not the robot's")
        known = self._robots.get(robot)
        newest = known.newest if known is not None and known.boot == proof.boot else {}
        self._robots[robot] = _Known(held.key, proof.boot, newest)
        return None

    def has_met(self, robot: str) -> bool:
        return robot in self._robots

    def is_to_meet_again(self, robot: str) -> bool:
        """Return True if a state of another run came. The robot's reply shows whether it restarted."""
        known = self._robots.get(robot)
        return known is not None and known.is_other_run_seen

    def is_reply(self, robot: str, received: Received, request: bytes) -> bool:
        proof, known = RobotProof.read(received.attachment), self._robots.get(robot)
        if proof is None or known is None:
            return False
        text = proof.signed_reply(received.key, received.encoding, received.payload, request)
        return received.key.startswith(f"{self._root}/{robot}/") and fits(known.key, proof.signature, text)

    def believes(self, robot: str, received: Received) -> bool:
        """Return True if a sample of this robot can be trusted.

        Safety state and robot state must be signed, of the robot's current run, and newer than the last one.
        """
        subject = received.key.removeprefix(f"{self._root}/{robot}/")
        if subject not in SIGNED:
            return True
        proof, known, sequence = (
            RobotProof.read(received.attachment),
            self._robots.get(robot),
            _sequence_of(received),
        )
        if proof is None or known is None or sequence is None:
            return False
        is_of_run = proof.boot == known.boot
        # The cheap checks first: a flood of replayed samples costs no signature checks.
        if is_of_run and not _is_newer(sequence, known.newest.get(subject)):
            return False
        if not is_of_run and known.is_other_run_seen:
            return False
        if not self.is_state(robot, received):
            return False
        if is_of_run:
            known.newest[subject] = sequence
        else:
            known.is_other_run_seen = True
        return is_of_run

    def is_state(self, robot: str, received: Received) -> bool:
        proof, known = RobotProof.read(received.attachment), self._robots.get(robot)
        if proof is None or known is None:
            return False
        text = proof.signed_publication(received.key, received.encoding, received.payload)
        return received.key.startswith(f"{self._root}/{robot}/") and fits(known.key, proof.signature, text)


class OperatorProof(KnownRobots):
    """An operator's key and grant, and the robots that were met."""

    def __init__(
        self,
        private: Ed25519PrivateKey,
        chain: list[Signed],
        trust: Trust,
        root: str,
        now_s: Callable[[], int],
        nonce: Callable[[int], bytes] = secrets.token_bytes,
    ) -> None:
        super().__init__(trust, root, now_s)
        grant = chain[0].statement
        self.name = grant.name if isinstance(grant, Grant) else ""
        self.statement = chain_text(chain).encode()
        self._private = private
        self._grant = chain[0].id
        self._nonce = nonce
        self._tags: DriveTags | None = None
        self._leased = ""

    def request(self, robot: str, verb: str, payload: bytes, challenge: bytes) -> bytes:
        proof = RequestProof(self._grant, challenge, self._nonce(NONCE_BYTES))
        key = keys.command(self._root, robot, self.name, verb)
        encoding = BY_VERB[verb].encoding
        attachment = prove_request(self._private, proof, key, encoding, payload)
        if self._tags is None or robot != self._leased:
            return attachment
        return attachment + self._tags.verb_tag(proof.signed(key, encoding, payload))

    def begin_lease(self, robot: str, private: X25519PrivateKey, reply: LeaseReply, attachment: bytes) -> bool:
        proof = RobotProof.read(attachment)
        if proof is None or reply.public_key is None:
            return False
        expression = keys.command(self._root, robot, self.name, DRIVE.verb)
        key = lease_key(private, reply.public_key, proof.boot, reply.lease, expression)
        self._tags = None if key is None else DriveTags(key, reply.lease, expression, DRIVE.encoding)
        self._leased = robot
        return self._tags is not None

    def drive(self, payload: bytes) -> bytes:
        return b"" if self._tags is None else self._tags.attachment(payload)


class ViewerProof(KnownRobots):
    """Verifies what robots sign, for a client without a grant, which may only stop robots.

    Attributes:
        name: empty, for lack of a grant. Robots prove their identity in reply to an empty statement too.
    """

    name = ""

    def meet(self, robot: str, received: Received, question: bytes) -> Objection | None:
        """Check a robot's reply to the empty statement. Returns why it is not of this fleet."""
        refusal = super().meet(robot, received, question)
        return None if self.has_met(robot) else refusal

    def request(self, robot: str, verb: str, _payload: bytes, _challenge: bytes) -> bytes:
        if verb != STOP_VERB:
            raise UsageError(
                f"{verb} of {robot} needs an operator's key and grant; there is none here: see docs/authority.md"
            )
        return new_question()

    def begin_lease(self, *_: object) -> bool:
        return False

    def drive(self, _payload: bytes) -> bytes:
        return b""


def new_lease_key() -> tuple[X25519PrivateKey, bytes]:
    """Draw a key for one lease. Returns the private half, and the public one for the request."""
    private = X25519PrivateKey.generate()
    return private, public_bytes(private)


def new_question() -> bytes:
    """The attachment of a query of a robot's identity: random bytes."""
    return secrets.token_bytes(QUESTION_BYTES)


class _Numbered(msgspec.Struct, frozen=True):
    """The sequence number of any sample."""

    sequence: Sequence


_NUMBERED: Final = msgspec.msgpack.Decoder(_Numbered)


def _sequence_of(received: Received) -> int | None:
    try:
        return _NUMBERED.decode(received.payload).sequence
    except PAYLOAD_ERRORS:
        return None


def _is_newer(sequence: int, newest: int | None) -> bool:
    """Return True if it is ahead of the newest by less than half of the number space (RFC 1982)."""
    return newest is None or 0 < (sequence - newest) & SEQUENCE_MAX <= SEQUENCE_MAX // 2


_STATEMENT_REPLY: Final = msgspec.msgpack.Decoder(StatementReply)
