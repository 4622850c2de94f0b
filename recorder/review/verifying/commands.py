"""Commanders by the requests in the journal: each signed verb's signature and grant, checked once more.

The robot judged each request when it came, and the journal has its verdict beside the request. A drive command is
proven by a key that only the robot and the holder of the lease have: it is attributed to the lease's holder.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Any, Final

import msgspec

from recorder.reading.topics import UNREADABLE
from recorder.review.verifying.authority import LogAuthority
from recorder.review.verifying.findings import ProofFault, ProofFinding
from schemas import keys
from schemas.authority.proof import GrantRole, RequestProof
from schemas.authority.trust import HeldGrant, Objection, fits
from schemas.decisions import Decision, Journal, Verdict
from schemas.journal import Kind
from schemas.reasons import Reason
from schemas.subjects import BY_VERB, DRIVE_VERB, STOP_VERB

SIGNED_INPUT: Final = bytes([0x9A, Kind.REQUEST])
"""A request of signed mode begins so in MessagePack: an array of ten, and the kind."""

OPEN_INPUT: Final = bytes([0x98, Kind.REQUEST])
"""One of open mode: an array of eight."""


LEASING: Final = frozenset({"acquire", "take"})

COMMANDING_ROLES: Final = frozenset({GrantRole.PROGRAM, GrantRole.OPERATOR, GrantRole.SUPERVISOR})

SAME_NS: Final = 50_000_000
"""A request and its decision are of one tick, or of two that follow each other."""

PROOF_OF_STOP_NS: Final = 5_000_000_000
"""The proof of a stop follows within this time: whoever stops waits no longer."""

STOPS_WAITING: Final = 256
"""Unsigned stops of an operator that wait for their proof; of a flood the oldest are nobody's."""

VERBS_MAX: Final = 20_000
"""Signed verbs that are kept one by one; a flood is counted."""

_DECODER: Final = msgspec.msgpack.Decoder(list[tuple[Any, ...]])


class SignedVerb(msgspec.Struct, frozen=True):
    """A verb whose proof the robot accepted.

    Attributes:
        time_ns: by the robot's clock, nanoseconds since 1970.
        operator: by the key expression.
        grant: the identifier of the grant; empty if there was no proof.
        holds: signature and grant hold.
        detail: why not.
        unsigned_before: stops of the same operator that came without a proof, and for which this one is it: a stop
            waits for no proof, which follows as soon as the robot has said what to sign.
        unsigned_after: stops in the same name that came without a proof right after this one: who stops says it
            again until the robot is seen to stand, and anybody may say it in that name. They stop what is stopped.
    """

    time_ns: int
    operator: str
    verb: str
    grant: str
    holds: bool
    detail: str = ""
    unsigned_before: int = 0
    unsigned_after: int = 0


class RefusedProof(msgspec.Struct):
    """Requests of one kind whose proof the robot refused, or stops that had none.

    Attributes:
        operator: by the key expression, so as they said themselves.
        reason: the robot's.
        first_ns, last_ns: by the robot's clock, nanoseconds since 1970.
    """

    operator: str
    verb: str
    reason: str
    count: int
    first_ns: int
    last_ns: int


class Holder(msgspec.Struct):
    """Somebody held the lease.

    Attributes:
        lease: its public identifier.
        grant: identifier of the grant under which it was given; empty if the log does not show it.
        from_ns, to_ns: the first and the last request under it that was accepted, by the robot's clock.
        drives: drive commands that were accepted.
    """

    lease: int
    operator: str
    grant: str
    from_ns: int
    to_ns: int
    drives: int


class CommandRecord:
    """Gathers what was commanded.

    Attributes:
        root: first chunks of the robot's keys, which are under its requests' signatures.
        verbs: those whose proof was accepted, by their time; ``verbs_untold`` more.
        refused: those whose proof was refused.
        unproven_stops: remote stops without a proof that holds. They are served all the same.
        findings: the faults.
    """

    def __init__(self, robot: str, authority: LogAuthority) -> None:
        """Nothing was commanded yet.

        Args:
            robot: its name.
            authority: judges the grants.
        """
        self.root = ""
        self._robot, self._authority = robot, authority
        self.verbs: list[SignedVerb] = []
        self.verbs_untold = 0
        self.findings: list[ProofFinding] = []
        self._refused: dict[tuple[str, str, str], RefusedProof] = {}
        self._stops: dict[str, deque[int]] = {}
        self._signed_stops: dict[str, int] = {}
        """The place of the last one of each operator among the verbs."""
        self._holders: dict[tuple[str, int], Holder] = {}

    @property
    def refused(self) -> list[RefusedProof]:
        """Requests that the robot refused for their proof."""
        return [one for one in self._refused.values() if one.verb != STOP_VERB]

    @property
    def unproven_stops(self) -> list[RefusedProof]:
        """Stops that nobody signed, neither right before nor right after."""
        for operator, stops in self._stops.items():
            while stops:
                at_ns = stops.popleft()
                self._refuse(operator, STOP_VERB, Reason.PROOF_MISSING.value, at_ns)
        return [one for one in self._refused.values() if one.verb == STOP_VERB]

    def holders(self) -> list[Holder]:
        """Return the holders of the lease, in order of time."""
        for holder in self._holders.values():
            asked = [
                verb
                for verb in self.verbs
                if verb.verb in LEASING
                and verb.operator == holder.operator
                and abs(verb.time_ns - holder.from_ns) <= SAME_NS
            ]
            holder.grant = asked[-1].grant if asked else ""
        return sorted(self._holders.values(), key=lambda one: one.from_ns)

    def take_decision(self, decision: Decision) -> None:
        """A decision says who had what accepted."""
        if decision.verdict is not Verdict.ACCEPTED or not decision.lease:
            return
        holder = self._holders.get((decision.operator, decision.lease))
        if holder is None:
            if decision.request not in LEASING | {DRIVE_VERB, "renew", "engage"}:
                return
            at_ns = decision.time_ns
            holder = Holder(decision.lease, decision.operator, "", at_ns, at_ns, 0)
            self._holders[decision.operator, decision.lease] = holder
        holder.from_ns = min(holder.from_ns, decision.time_ns)
        holder.to_ns = max(holder.to_ns, decision.time_ns)
        holder.drives += decision.request == DRIVE_VERB

    def take_journal(self, journal: Journal) -> None:
        """Take the requests of a message of the journal."""
        if SIGNED_INPUT not in journal.inputs and OPEN_INPUT not in journal.inputs:
            return
        try:
            inputs = _DECODER.decode(journal.inputs)
        except UNREADABLE:
            what = "a message of the journal whose inputs cannot be read"
            self.findings.append(ProofFinding(ProofFault.CHANGED, what, journal.time_ns))
            return
        waiting: list[tuple[Any, ...]] = []
        for one in inputs:
            if one[:1] == (Kind.REQUEST,) and len(one) == _SIGNED_LENGTH:
                waiting.append(one)
            elif one[:1] == (Kind.REQUEST,):
                what = "requests of open mode: nothing proves who sent them"
                self.findings.append(ProofFinding(ProofFault.UNPROVEN, what, journal.time_ns))
            elif one[:1] == (Kind.TICK,) and len(one) > _WALL:
                self._take_requests(waiting, one[_WALL])
                waiting = []
        # Their tick is in the next message.
        self._take_requests(waiting, journal.time_ns)

    def _take_requests(self, requests: Sequence[tuple[Any, ...]], at_ns: int) -> None:
        for one in requests:
            try:
                self._take_request(one, at_ns)
            except (TypeError, ValueError, IndexError, AttributeError):
                what = "a request in the journal is of no form that a gateway writes"
                self.findings.append(ProofFinding(ProofFault.CHANGED, what, at_ns))

    def _take_request(self, one: tuple[Any, ...], at_ns: int) -> None:
        _, _, _, verb, operator, payload, _, _, attachment, credentials = one
        reason = Reason(credentials[0])
        if verb == STOP_VERB and reason is Reason.PROOF_MISSING:
            if self._repeats(operator, at_ns):
                return
            stops = self._stops.setdefault(operator, deque())
            stops.append(at_ns)
            if len(stops) > STOPS_WAITING:
                self._refuse(operator, verb, reason.value, stops.popleft())
        elif reason is not Reason.NONE:
            self._refuse(operator, verb, reason.value, at_ns)
        elif verb != DRIVE_VERB:
            proof = RequestProof.read(attachment)
            found = self._judge(verb, operator, payload, proof, credentials, at_ns)
            if isinstance(found, ProofFinding):
                self.findings.append(found)
            if len(self.verbs) >= VERBS_MAX:
                self.verbs_untold += 1
                return
            grant = "" if proof is None else proof.grant.hex()
            detail = found.what if isinstance(found, ProofFinding) else ""
            before = 0
            if verb == STOP_VERB and not detail:
                before = self._proven_by_it(operator, at_ns)
                self._signed_stops[operator] = len(self.verbs)
            self.verbs.append(SignedVerb(at_ns, operator, verb, grant, not detail, detail, before))

    def _refuse(self, operator: str, verb: str, reason: str, at_ns: int) -> None:
        new = RefusedProof(operator, verb, reason, 0, at_ns, at_ns)
        refused = self._refused.setdefault((operator, verb, reason), new)
        refused.count += 1
        refused.first_ns, refused.last_ns = min(refused.first_ns, at_ns), max(refused.last_ns, at_ns)

    def _proven_by_it(self, place: str, at_ns: int) -> int:
        """Return the number of unsigned stops right before a signed one of the same operator, and forget them."""
        stops = self._stops.pop(place, ())
        proven = [one for one in stops if at_ns - PROOF_OF_STOP_NS <= one <= at_ns]
        self._stops[place] = deque(one for one in stops if one not in proven)
        return len(proven)

    def _repeats(self, place: str, at_ns: int) -> bool:
        """Return True if an unsigned stop came right after a signed one in the same name, and count it there."""
        number = self._signed_stops.get(place)
        if number is None or not 0 <= at_ns - self.verbs[number].time_ns <= PROOF_OF_STOP_NS:
            return False
        signed = self.verbs[number]
        self.verbs[number] = msgspec.structs.replace(signed, unsigned_after=signed.unsigned_after + 1)
        return True

    def _judge(
        self,
        verb: str,
        operator: str,
        payload: bytes,
        proof: RequestProof | None,
        credentials: Sequence[Any],
        at_ns: int,
    ) -> ProofFinding | None:
        """Return the finding against a verb that should not have been accepted; None if it should."""
        command, what = BY_VERB.get(verb), f"{verb} of {operator}"
        if proof is None or command is None:
            return ProofFinding(ProofFault.WRONGLY_SIGNED, f"{what} was accepted without a signature", at_ns)
        held = self._authority.judge(proof.grant, at_ns)
        if held is None:
            return ProofFinding(ProofFault.UNPROVEN, f"{what}: its grant is not in the log", at_ns)
        if isinstance(held, Objection):
            return self._authority.finding(f"{what} was accepted", held, at_ns)
        text = proof.signed(keys.command(self.root, self._robot, operator, verb), command.encoding, payload)
        if not fits(held.key, proof.signature, text):
            return ProofFinding(ProofFault.WRONGLY_SIGNED, f"{what}: its signature does not fit", at_ns)
        detail = self._excess(held, verb, operator, credentials)
        return ProofFinding(ProofFault.NOT_GRANTED, f"{what} was accepted: {detail}", at_ns) if detail else None

    def _excess(self, held: HeldGrant, verb: str, operator: str, credentials: Sequence[Any]) -> str:
        """Return what the robot allowed beyond the grant; empty if nothing."""
        grant = held.grant
        if grant.name != operator or grant.role not in COMMANDING_ROLES:
            return f"the grant is of {grant.name}, {grant.role.value}"
        if not grant.covers(self._robot):
            return f"the grant is not for {self._robot}"
        if verb != STOP_VERB and verb not in grant.verbs:
            return f"{verb} is not among the verbs of the grant"
        allowed = [grant.serial, grant.role.value, grant.override, grant.speed_limit_mps]
        return "" if list(credentials[2:6]) == allowed else "the robot took the grant for another one"


_SIGNED_LENGTH: Final = 10
_WALL: Final = 2
