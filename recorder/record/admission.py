"""The door of a recorder in signed mode: who sent an order, and may that person give it? Pure.

As with robots, anyone shows grants and revocations, by the query ``@auth``: what counts are their signatures. An
order echoes a challenge of the recorder's own, which its health and each reply to ``status`` hold, so that nobody
can keep one for later. ``status`` needs no proof.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Collection
from typing import Final

import msgspec

from schemas import keys
from schemas.authority.identity import Identity, prove_request
from schemas.authority.proof import ID_BYTES, RequestProof
from schemas.authority.statement import (
    Grant,
    GrantRole,
    Revocations,
    Rotation,
    StatementFault,
    chain_text,
    read_chain,
)
from schemas.authority.trust import HeldGrant, Objection, Trust, fits
from schemas.reasons import TEXTS, Reason, Text
from schemas.recording import Mark
from schemas.requests import Request
from schemas.subjects import RECORDER_BY_VERB

CHALLENGE_NS: Final = 1_000_000_000
"""A new challenge is drawn so often."""

CHALLENGE_MAX_NS: Final = 5_000_000_000
"""An order that echoes a challenge drawn before that is too old."""

GRANTS_KEPT: Final = 256
"""Grants that are known at a time; beyond it the one that was not used for longest goes."""

ALL_ROBOTS: Final = "*"
"""The pattern of whoever may be there: only a grant for all covers it."""

OPEN_TO_ALL: Final = frozenset({"status"})
"""Verbs that need no proof."""

ROLES: Final = frozenset({GrantRole.PROGRAM, GrantRole.OPERATOR, GrantRole.SUPERVISOR, GrantRole.RECORDER})
"""Roles that may give a recorder orders."""


class OrderNote(msgspec.Struct, frozen=True):
    """The authority's statements that a recorder keeps across a restart.

    Attributes:
        statements: accepted rotations and lists of revocations, signed, in order; of successive lists the newest,
            and those of a higher epoch, which never falls.
        floor_s: the newest time in anything that was verified, seconds since 1970.
    """

    statements: list[str] = []
    floor_s: int = 0


class SignedOrder(msgspec.Struct, frozen=True):
    """A request to a recorder as it came.

    Attributes:
        operator: by the key expression.
        payload, attachment: the bytes.
        request: the decoded payload.
    """

    verb: str
    operator: str
    payload: bytes
    attachment: bytes
    request: Request


class OrderAdmission:
    """Judges orders to one recorder.

    Attributes:
        note: the state to keep across a restart.
    """

    def __init__(
        self,
        trust: Trust,
        root: str,
        recorder: str,
        note: OrderNote,
        draw: Callable[[int], bytes],
        robots: Collection[str] = (ALL_ROBOTS,),
    ) -> None:
        """No grant is known yet.

        Args:
            trust: the fleet's authority, as the recorder was provisioned with it.
            root: first chunks of the recorder's keys.
            recorder: its name.
            note: the one that was kept last.
            draw: random bytes, so many.
            robots: the robots that it records, by name or ``*`` for all that there are. An order about the whole
                recorder is one about each of them.
        """
        self.note = OrderNote()
        self._trust = trust
        self._robots = robots
        for text in note.statements:
            self.show(text.encode(), 0)
        self._lift(note.floor_s)
        self._root, self._recorder, self._draw = root, recorder, draw
        self._challenges: OrderedDict[bytes, int] = OrderedDict()
        self._grants: OrderedDict[bytes, HeldGrant] = OrderedDict()
        self._nonces: OrderedDict[tuple[bytes, bytes], int] = OrderedDict()

    def challenge(self, now_ns: int) -> bytes:
        """The challenge to echo now."""
        while self._challenges and now_ns - next(iter(self._challenges.values())) > CHALLENGE_MAX_NS:
            self._challenges.popitem(last=False)
        newest = next(reversed(self._challenges), None)
        if newest is None or now_ns - self._challenges[newest] >= CHALLENGE_NS:
            newest = self._draw(ID_BYTES)
            self._challenges[newest] = now_ns
        return newest

    def show(self, text: bytes, now_s: int) -> Objection | None:
        """Somebody shows a statement. Returns why it is not taken over; None if it is.

        Args:
            text: the statement, signed, with its chain.
            now_s: the time, seconds since 1970.
        """
        chain = read_chain(text)
        if isinstance(chain, StatementFault):
            return Objection(Reason.MALFORMED, chain.detail)
        statement = chain[0].statement
        if isinstance(statement, Grant):
            held = self._trust.judge(chain, max(now_s, self.note.floor_s))
            if isinstance(held, Objection):
                return held
            # It has begun, so it is later than that: a clock that is set back revives nothing.
            self._lift(held.not_before)
            self._grants[held.id] = held
            if len(self._grants) > GRANTS_KEPT:
                self._grants.popitem(last=False)
            return None
        if not isinstance(statement, Revocations | Rotation):
            return Objection(Reason.NOT_GRANTED, "a recorder takes no time from anybody")
        is_rotation = isinstance(statement, Rotation)
        newer = self._trust.rotate(chain[0]) if is_rotation else self._trust.revoke(chain[0])
        if isinstance(newer, Objection):
            return newer
        # A thief of the former authority's key may have signed any time.
        is_other = newer.active != self._trust.active
        floor_s = statement.at if is_other else max(self.note.floor_s, statement.at)
        self._trust = newer
        kept = [text for text in self.note.statements if is_rotation or not _is_superseded(text, statement)]
        self.note = OrderNote([*kept, chain[0].text()], floor_s)
        return None

    def _lift(self, at_s: int) -> None:
        """Note that it is so late at least: something that was verified says so."""
        if at_s > self.note.floor_s:
            self.note = msgspec.structs.replace(self.note, floor_s=at_s)

    def judge(self, order: SignedOrder, now_ns: int, now_s: int) -> Objection | None:
        """Judge an order. Returns why it is rejected; None if it is accepted.

        Args:
            order: as it came.
            now_ns: monotonic.
            now_s: the time, seconds since 1970.
        """
        if order.verb in OPEN_TO_ALL:
            return None
        proof = RequestProof.read(order.attachment)
        if proof is None:
            return Objection(Reason.PROOF_MISSING)
        refusal = self._freshness(proof, now_ns)
        if refusal is not None:
            return refusal
        held = self._grants.get(proof.grant)
        refusal = Objection(Reason.GRANT_UNKNOWN) if held is None else self._not_granted(held, order, now_s)
        if held is None or refusal is not None:
            return refusal
        key = keys.recorder_command(self._root, self._recorder, order.operator, order.verb)
        encoding = RECORDER_BY_VERB[order.verb].encoding
        if not fits(held.key, proof.signature, proof.signed(key, encoding, order.payload)):
            return Objection(Reason.PROOF_WRONG)
        self._nonces[proof.grant, proof.nonce] = now_ns
        self._grants.move_to_end(proof.grant)
        return None

    def _freshness(self, proof: RequestProof, now_ns: int) -> Objection | None:
        while self._nonces and now_ns - next(iter(self._nonces.values())) > CHALLENGE_MAX_NS:
            self._nonces.popitem(last=False)
        drawn_ns = self._challenges.get(proof.challenge)
        if drawn_ns is None:
            return Objection(Reason.CHALLENGE_UNKNOWN)
        if now_ns - drawn_ns > CHALLENGE_MAX_NS:
            return Objection(Reason.TOO_OLD)
        return Objection(Reason.REPLAYED) if (proof.grant, proof.nonce) in self._nonces else None

    def _not_granted(self, held: HeldGrant, order: SignedOrder, now_s: int) -> Objection | None:
        objection = self._trust.objection(held, max(now_s, self.note.floor_s))
        if objection is not None:
            return objection
        grant = held.grant
        if grant.name != order.operator or grant.role not in ROLES:
            return Objection(Reason.NOT_GRANTED, f"it is of {grant.name}, {grant.role.value}")
        if order.verb not in grant.verbs:
            return Objection(Reason.NOT_GRANTED, f"{order.verb} is not among its verbs")
        robot = _robot_of(order.request)
        if robot and not grant.covers(robot):
            return Objection(Reason.NOT_GRANTED, f"it is not for {robot}")
        others = [] if robot else [one for one in sorted(self._robots) if not grant.covers(one)]
        if others:
            named = "all robots" if ALL_ROBOTS in others else ", ".join(others)
            what = f"{order.verb} is for all that this recorder records, and the grant is not for {named}"
            advice = "; name a robot that it is for" if order.verb == "mark" else ""
            return Objection(Reason.NOT_GRANTED, f"{what}{advice}")
        return None


def _is_superseded(text: str, newer: Revocations | Rotation) -> bool:
    """Return True if it is a list of revocations of which nothing remains in force after a newer one."""
    chain = read_chain(text.encode())
    older = None if isinstance(chain, StatementFault) else chain[0].statement
    return isinstance(older, Revocations) and older.epoch <= newer.epoch


def _robot_of(request: Request) -> str:
    """The robot, or the pattern of robots, that an order names; empty if it names none."""
    return request.robot if isinstance(request, Mark) else ""


def text_of(reason: Reason) -> Text:
    """A reason in words, as a recorder says it."""
    return _OF_A_RECORDER.get(reason, TEXTS[reason])


_OF_A_RECORDER: Final = {
    Reason.PROOF_MISSING: Text("the order is not signed", "send it with an operator's key: see docs/authority.md"),
    Reason.PROOF_WRONG: Text(
        "the signature does not fit the order",
        "send it with the key of the grant, to this recorder, as it was signed: see docs/authority.md",
    ),
    Reason.GRANT_UNKNOWN: Text(
        "the recorder does not know the grant, or its authority",
        "show it the grant with its chain (query @auth)",
    ),
}


def refusal_text(refusal: Objection) -> str:
    """A refusal in words, with the reason's name and the cure."""
    text = text_of(refusal.reason)
    said = "; ".join(filter(None, (text.means, refusal.detail)))
    return f"{said} ({refusal.reason.value}). Cure: {text.cure}"


class OrderProof:
    """The operator's side: signs orders.

    Attributes:
        name: under which the grant lets its holder give orders.
        statement: the grant with its chain, to be shown to recorders.
    """

    def __init__(self, identity: Identity, root: str, nonce: Callable[[int], bytes]) -> None:
        """With an operator's key and grant.

        Args:
            identity: the sender of these orders.
            root: first chunks of the recorders' keys.
            nonce: random bytes, so many.
        """
        grant = identity.chain[0].statement
        self.name = grant.name if isinstance(grant, Grant) else ""
        self.statement = chain_text(identity.chain).encode()
        self._identity, self._root, self._nonce = identity, root, nonce

    def attachment(self, recorder: str, verb: str, payload: bytes, challenge: bytes) -> bytes:
        """The attachment of an order.

        Args:
            recorder: its name.
            verb: the requested one.
            payload: the bytes that are sent.
            challenge: the newest one that the recorder gave.
        """
        proof = RequestProof(self._identity.chain[0].id, challenge, self._nonce(ID_BYTES))
        key = keys.recorder_command(self._root, recorder, self.name, verb)
        return prove_request(self._identity.private, proof, key, RECORDER_BY_VERB[verb].encoding, payload)
