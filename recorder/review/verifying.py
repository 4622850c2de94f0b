"""The parts of ``verify``: authority, commands, files and their signatures.

``LogAuthority`` finds the authority of a log's grants, revocations and robot keys, and whether they held at a
time. The authority changes within a log: revocations arrive, a rotation replaces the keys, grants are renewed.
Each sample is judged by the statements in force at its time. A statement was in force at the latest when the robot
first showed it, and not before it was signed; in between the robot may or may not have known it, because a log may
begin later, and the robot repeats its statements.

``CommandRecord`` verifies each signed verb in the journal again; the journal has the robot's own verdict beside
it. A drive command is proven by a key that only the robot and the lease's holder have: it is attributed to the
holder.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Sequence
from enum import Enum
from pathlib import Path
from typing import Any, Final

import msgspec
from mcap import records

from recorder.disk.log_names import SIGNATURE_SUFFIX
from recorder.mcap.reader import read_pieces
from recorder.mcap.writer import unnumbered
from recorder.reading.logs import Faults, LogFile
from recorder.reading.rows import Progress
from recorder.reading.topics import UNREADABLE
from recorder.record.robots import STATEMENTS_NAME
from recorder.record.signed_mode import SIGNATURE_MAX_BYTES, LogSignature
from schemas import keys
from schemas.authority.proof import (
    Grant,
    GrantRole,
    RequestProof,
    Revocations,
    Rotation,
    Signed,
    StatementFault,
    chain_text,
    read_chain,
)
from schemas.authority.trust import BY_SITE, HeldGrant, Objection, Trust, fingerprint, fits, is_signed
from schemas.command_line import other_kind
from schemas.decisions import Decision, Journal, Verdict
from schemas.journal import Kind
from schemas.reasons import TEXTS, Reason
from schemas.subjects import BY_VERB, DRIVE_VERB, STOP_VERB


class ProofFault(Enum):
    """The kind of a fault. All but ``unproven`` and ``other_authority`` are tampering."""

    MISSING = "missing"
    CHANGED = "changed"
    WRONGLY_SIGNED = "wrongly_signed"
    NOT_GRANTED = "not_granted"
    UNPROVEN = "unproven"  # the log lacks the evidence
    OTHER_AUTHORITY = "other_authority"  # all signatures are of an authority that was not given

    @property
    def is_tampering(self) -> bool:
        """True if the log was certainly changed, or a command not granted."""
        return self not in {ProofFault.UNPROVEN, ProofFault.OTHER_AUTHORITY}


class ProofFinding(msgspec.Struct, frozen=True):
    """A finding, with the robot's first and last time, since 1970; None if there is none, or only one."""

    fault: ProofFault
    what: str
    time_ns: int | None = None
    count: int = 1
    until_ns: int | None = None


_NOBODY: Final = bytes(32)  # in place of an unknown standby key
_S: Final = 1_000_000_000
_ALWAYS_NS: Final = -(2**63)


class ShownStatement(msgspec.Struct, frozen=True):
    """A statement that a robot accepted or repeated, at ``time_ns`` by its clock."""

    robot: str
    time_ns: int
    text: str


class GrantInfo(msgspec.Struct, frozen=True):
    """A grant of a log, for people.

    Attributes:
        id: the identifier, hexadecimal.
        not_before, not_after: validity of the whole chain, seconds since 1970.
        signers: names in the chain above it, the nearest first.
        root: the authority's key at the end of the chain, hexadecimal.
        objection: why it did not hold at its first use; empty if it did.
    """

    id: str
    name: str
    role: str
    serial: int
    key: str
    not_before: int
    not_after: int
    signers: list[str]
    root: str
    objection: str


class _InForce(msgspec.Struct, frozen=True):
    """The authorities in force from a time on: several while it is open which of the given ones.

    Attributes:
        earliest_ns: the time of signing of the statement that introduced them.
        shown_ns: the time when the robot first showed that statement.
    """

    earliest_ns: int
    shown_ns: int
    trusts: tuple[Trust, ...]


class LogAuthority:
    """The authority, the grants and the keys of a robot in its log.

    Attributes:
        is_vouched: the log is under a given authority; else only the log itself names it.
        roots: the authority's active keys, in the order in which they were in force.
    """

    def __init__(self, robot: str, given: Sequence[Trust], statements: Iterable[ShownStatement]) -> None:
        self.is_vouched = bool(given)
        self.findings: list[ProofFinding] = []
        self._given = tuple(given)
        self._own: dict[bytes, list[list[Signed]]] = {}
        self._grants: dict[bytes, list[list[Signed]]] = {}
        self._verified: dict[tuple[bytes, bytes], HeldGrant | Objection] = {}
        self._judged: dict[bytes, GrantInfo] = {}
        self._unknown_until_ns = _ALWAYS_NS
        self._foreign: list[tuple[int, Signed, str]] = []
        changes: list[tuple[int, Signed]] = []
        statements = list(statements)
        self._shown = [(one.time_ns, one.text) for one in statements]
        for time_ns, text in _first_shown(statements):
            chain = read_chain(text.encode())
            if isinstance(chain, StatementFault):
                self._find(ProofFault.CHANGED, f"a statement cannot be read: {chain.detail}", time_ns)
            elif isinstance(grant := chain[0].statement, Grant):
                self._grants.setdefault(chain[0].id, []).append(chain)
                if grant.role is GrantRole.ROBOT and grant.name == robot:
                    self._own.setdefault(bytes.fromhex(grant.key), []).append(chain)
            else:
                changes.append((time_ns, chain[0]))
        self.robot_keys = list(self._own)
        self._in_force: list[_InForce] = []
        changes.sort(key=_order)
        unread = list(self.findings)
        self._follow(tuple(given) or tuple(self._named()), changes)
        if other := self._other_authority():
            # Also check whether the log is consistent under its own authority.
            self.is_vouched = False
            self.findings = [ProofFinding(ProofFault.OTHER_AUTHORITY, other), *unread]
            self._follow(tuple(self._named()), changes)
        roots = (trust.active for state in self._in_force for trust in state.trusts)
        self.roots = list(dict.fromkeys(roots))

    def _follow(self, first: tuple[Trust, ...], changes: Sequence[tuple[int, Signed]]) -> None:
        """Follow the authority through the revocations and rotations of the log, in order."""
        self._in_force = [_InForce(_ALWAYS_NS, _ALWAYS_NS, first)]
        self._foreign.clear()
        for time_ns, signed in changes:
            self._change(time_ns, signed)
        self._judge_foreign()

    @property
    def grants(self) -> list[GrantInfo]:
        return list(self._judged.values())

    def judge(self, identifier: bytes, at_ns: int) -> HeldGrant | Objection | None:
        """Judge a grant at a time; None if it is not in the log."""
        return self._judge(self._grants.get(identifier, ()), at_ns)

    def judge_own(self) -> Iterator[ProofFinding]:
        """Judge the robot's own grants at the times when it showed them.

        A rotation ends a grant; until the next one, the key is that of the grants on both sides. An expired grant
        leaves the key unproven, but is no sign of tampering.
        """
        for key, chains in self._own.items():
            texts = {chain_text(chain) for chain in chains}
            yield from self._judge_own(key, [time_ns for time_ns, text in self._shown if text in texts])

    def _judge_own(self, key: bytes, times_ns: Iterable[int]) -> Iterator[ProofFinding]:
        times = sorted(times_ns)
        objections = [(at_ns, self._judge(self._own[key], at_ns)) for at_ns in times]
        held_ns = [at_ns for at_ns, held in objections if isinstance(held, HeldGrant)]
        for at_ns, held in objections:
            if not isinstance(held, Objection):
                continue
            found = self.finding("the robot's own grant does not hold", held, at_ns)
            if held.reason is Reason.GRANT_EXPIRED:
                found = ProofFinding(ProofFault.UNPROVEN, found.what, at_ns)
            elif (
                held.reason is Reason.GRANT_UNKNOWN
                and at_ns >= self._unknown_until_ns
                and self._is_of_former(self._own[key])
            ):
                if held_ns and held_ns[0] < at_ns < held_ns[-1]:
                    continue
                what = "a rotation ended the robot's own grant, and the logs hold no other for that time"
                found = ProofFinding(ProofFault.UNPROVEN, what, at_ns)
            yield found

    def finding(self, what: str, objection: Objection, at_ns: int) -> ProofFinding:
        """The finding about an action with a grant that did not hold at that time."""
        if objection.reason is Reason.GRANT_UNKNOWN and self._unknown_until_ns != _ALWAYS_NS:
            why = (
                f"it is under authority {_fingerprints(self._unknown_roots()) or 'unknown'}, which was not given; "
                f"the log shows the rotation from it to {_fingerprints(self._given_keys())}: also give the "
                "earlier authority.json (--authority FILE for each)"
            )
            return ProofFinding(ProofFault.UNPROVEN, f"{what}: {why}", at_ns)
        is_by_site = objection.detail == BY_SITE
        fault = ProofFault.UNPROVEN if is_by_site else ProofFault.NOT_GRANTED
        return ProofFinding(fault, f"{what}: {_cause(objection)}", at_ns)

    def _other_authority(self) -> str:
        """The text of a finding that the whole log is under an authority that was not given; empty if it is not.

        It is if none of the robot's own grants is under a given authority, and no rotation leads to one. If only
        some are, the others were inserted.
        """
        chains = [chain for chains in self._own.values() for chain in chains]
        is_whole = all(isinstance(self._verify(one, Trust(one[-1].signer, _NOBODY)), HeldGrant) for one in chains)
        if not self._given or not chains or not is_whole or self._unknown_until_ns != _ALWAYS_NS:
            return ""
        if self._is_of_former(chains):
            return ""
        are = "none of those" if len(self._given) > 1 else "not the one"
        return (
            f"signed under authority {_fingerprints(self._unknown_roots())}, which is {are} that you gave "
            f"({_fingerprints(self._given_keys())}); the log shows no rotation between them: give the earlier "
            "authority.json (--authority FILE). If that authority was never yours, the log is not either"
        )

    def _unknown_roots(self) -> list[bytes]:
        """The keys of unknown authorities of the robot's own grants."""
        known = {trust.active for state in self._in_force for trust in state.trusts}
        roots = (chain[-1].signer for chains in self._own.values() for chain in chains)
        return [root for root in dict.fromkeys(roots) if root not in known]

    def _given_keys(self) -> list[bytes]:
        return [trust.active for trust in self._given]

    def _is_of_former(self, chains: Sequence[list[Signed]]) -> bool:
        """True if an authority in force at any time signed one of these chains."""
        trusts = [trust for state in self._in_force for trust in state.trusts]
        return any(isinstance(self._verify(chain, trust), HeldGrant) for chain in chains for trust in trusts)

    def _judge(self, chains: Sequence[list[Signed]], at_ns: int) -> HeldGrant | Objection | None:
        """The first chain that held; else the first objection, of the authority certainly in force."""
        found: HeldGrant | Objection | None = None
        states = list(self._states(at_ns))
        for chain in chains:
            for state in states:
                for trust in state.trusts:
                    held = self._held(chain, trust, at_ns // _S)
                    if isinstance(held, HeldGrant):
                        self._note(chain, held)
                        return held
                    found = found or held
            found = found or Objection(Reason.GRANT_UNKNOWN)
        if found is not None:
            self._note(chains[0], found)
        return found

    def _states(self, at_ns: int) -> Iterator[_InForce]:
        """The state certainly in force at a time, then those that may have been in force already."""
        certain = max(number for number, state in enumerate(self._in_force) if state.shown_ns < at_ns)
        yield self._in_force[certain]
        yield from (state for state in self._in_force[certain + 1 :] if state.earliest_ns <= at_ns)

    def _held(self, chain: list[Signed], trust: Trust, now_s: int) -> HeldGrant | Objection:
        held = self._verify(chain, trust)
        return held if isinstance(held, Objection) else trust.objection(held, now_s) or held

    def _verify(self, chain: list[Signed], trust: Trust) -> HeldGrant | Objection:
        """Verify the signatures of a chain, once for each authority, independent of time."""
        place = b"".join(one.id + one.signature for one in chain), trust.active
        held = self._verified.get(place)
        if held is None:
            begins = max(
                (one.statement.not_before for one in chain if isinstance(one.statement, Grant)), default=0
            )
            held = self._verified[place] = Trust(trust.active, trust.standby).judge(chain, begins)
        return held

    def _note(self, chain: Sequence[Signed], held: HeldGrant | Objection) -> None:
        statement = chain[0].statement
        if chain[0].id not in self._judged and isinstance(statement, Grant):
            self._judged[chain[0].id] = _info(chain, statement, held)

    def _named(self) -> Iterator[Trust]:
        """The unverified authority of the robot's first grant."""
        of_robot = [chain for chains in self._own.values() for chain in chains]
        for chain in of_robot[:1] or [chains[0] for chains in self._grants.values()][:1]:
            yield Trust(chain[-1].signer, _NOBODY)

    def _change(self, time_ns: int, signed: Signed) -> None:
        if isinstance(signed.statement, Rotation):
            self._rotate(time_ns, signed, signed.statement)
        elif isinstance(signed.statement, Revocations):
            self._revoke(time_ns, signed, signed.statement)

    def _rotate(self, time_ns: int, signed: Signed, rotation: Rotation) -> None:
        trusts = self._in_force[-1].trusts
        newer = [trust.rotate(signed) for trust in trusts]
        accepted = [one for one in newer if isinstance(one, Trust)]
        if accepted:
            self._begin(time_ns, rotation.at, tuple(accepted[:1]))
            return
        # The predecessor of a given authority is unknown.
        led_to = [
            trust
            for trust in trusts
            if _keys(trust) == (rotation.active, rotation.standby) and trust.rotation < rotation.serial
        ]
        if not led_to and any(isinstance(one, Objection) and one.reason is Reason.REPLAYED for one in newer):
            return
        if not is_signed(signed) or (self.is_vouched and not led_to):
            detail = "it is not signed by the standby key"
            self._foreign.append((time_ns, signed, f"a rotation is not the authority's: {detail}"))
        elif led_to:
            self._unknown_until_ns = time_ns
        else:
            what = "a rotation cannot be verified: the log does not name the standby (--authority)"
            self._find(ProofFault.UNPROVEN, what, time_ns)
            self._unknown_until_ns = time_ns
            new = Trust(bytes.fromhex(rotation.active), bytes.fromhex(rotation.standby), rotation.serial)
            self._begin(time_ns, rotation.at, (new,))

    def _revoke(self, time_ns: int, signed: Signed, revocations: Revocations) -> None:
        trusts = self._in_force[-1].trusts
        newer = [trust.revoke(signed) for trust in trusts]
        if any(isinstance(one, Trust) for one in newer):
            changed = tuple(
                one if isinstance(one, Trust) else trust for one, trust in zip(newer, trusts, strict=True)
            )
            self._begin(time_ns, revocations.at, changed)
            return
        if newer and not any(one.reason is Reason.REPLAYED for one in newer if isinstance(one, Objection)):
            self._foreign.append((time_ns, signed, "a list of revocations is not the authority's"))

    def _judge_foreign(self) -> None:
        """Judge the statements that no authority in force signed, when all rotations are known.

        A robot may repeat the revocations of a replaced authority, which are not in force any more.
        """
        trusts = [trust for state in self._in_force for trust in state.trusts]
        known = {key for trust in trusts for key in (trust.active, trust.standby)}
        for time_ns, signed, what in self._foreign:
            is_whole = is_signed(signed)
            if is_whole and signed.signer in known and isinstance(signed.statement, Revocations):
                continue
            is_unknown = is_whole and (not self.is_vouched or self._unknown_until_ns != _ALWAYS_NS)
            self._find(ProofFault.UNPROVEN if is_unknown else ProofFault.WRONGLY_SIGNED, what, time_ns)

    def _begin(self, time_ns: int, signed_s: int, trusts: tuple[Trust, ...]) -> None:
        """Add the authorities in force from now on. The robot's clock may be behind the signer's."""
        shown_ns = max(time_ns, self._in_force[-1].shown_ns)
        self._in_force.append(_InForce(min(signed_s * _S, shown_ns), shown_ns, trusts))

    def _find(self, fault: ProofFault, what: str, time_ns: int) -> None:
        self.findings.append(ProofFinding(fault, what, time_ns))


def _cause(objection: Objection) -> str:
    """The text of an objection, without the time since a grant's end, so that equal ones can be merged."""
    if objection.reason is not Reason.GRANT_EXPIRED:
        return objection.text
    has_begun = "begins" not in objection.detail
    return TEXTS[objection.reason].means if has_begun else "it had not begun"


def _fingerprints(keys: Iterable[bytes]) -> str:
    return ", ".join(fingerprint(key) for key in keys)


def _first_shown(statements: Iterable[ShownStatement]) -> list[tuple[int, str]]:
    """Each text once, with the time of its first appearance, in order of time."""
    first: dict[str, int] = {}
    for one in statements:
        first[one.text] = min(first.get(one.text, one.time_ns), one.time_ns)
    return sorted((time_ns, text) for text, time_ns in first.items())


def _order(change: tuple[int, Signed]) -> tuple[int, int, int]:
    """The order of statements: at equal times rotations before revocations, each by serial."""
    time_ns, signed = change
    serial = signed.statement.serial if isinstance(signed.statement, Rotation | Revocations) else 0
    return time_ns, not isinstance(signed.statement, Rotation), serial


def _keys(trust: Trust) -> tuple[str, str]:
    return trust.active.hex(), trust.standby.hex()


def _info(chain: Sequence[Signed], grant: Grant, held: HeldGrant | Objection) -> GrantInfo:
    above = [one.statement for one in chain if isinstance(one.statement, Grant)]
    return GrantInfo(
        id=chain[0].id.hex(),
        name=grant.name,
        role=grant.role.value,
        serial=grant.serial,
        key=grant.key,
        not_before=max(one.not_before for one in above),
        not_after=min(one.not_after for one in above),
        signers=[one.name for one in above[1:]],
        root=chain[-1].signer.hex(),
        objection=held.text if isinstance(held, Objection) else "",
    )


def file_statements(logs: Sequence[LogFile], faults: Faults) -> Iterator[ShownStatement]:
    """The statements in the metadata of logs; entries of another form are skipped."""
    for log in logs:
        try:
            with log.open() as stream:
                pieces = read_pieces(stream, log.bytes, is_verifying=False)
                found = [
                    one.metadata
                    for one in pieces
                    if isinstance(one, records.Metadata) and unnumbered(one.name) == STATEMENTS_NAME
                ]
        except OSError as error:
            faults.add(f"{log.path}: {error.strerror or error}")
            continue
        for entries in found:
            for name, text in entries.items():
                yield from _shown(name, text, log)


def _shown(name: str, text: str, log: LogFile) -> Iterator[ShownStatement]:
    robot, _, place = name.partition(" ")
    time_ns = place.partition(" ")[0]
    short = robot.rpartition("/")[2]
    if time_ns.isascii() and time_ns.isdecimal() and len(time_ns) < _DIGITS:
        yield ShownStatement(robot if short in log.namesakes else short, int(time_ns), text)


_DIGITS = 20


SIGNED_INPUT: Final = bytes([0x9A, Kind.REQUEST])  # MessagePack of a request in signed mode: an array of ten
OPEN_INPUT: Final = bytes([0x98, Kind.REQUEST])  # in open mode: an array of eight
LEASING: Final = frozenset({"acquire", "take"})
COMMANDING_ROLES: Final = frozenset({GrantRole.PROGRAM, GrantRole.OPERATOR, GrantRole.SUPERVISOR})
SAME_NS: Final = 50_000_000  # a request and its decision are of one tick, or of two successive ones
VERBS_MAX: Final = 20_000  # signed verbs that are listed; a flood is counted

_DECODER: Final = msgspec.msgpack.Decoder(list[tuple[Any, ...]])


class SignedVerb(msgspec.Struct, frozen=True):
    """A verb whose proof the robot accepted.

    Attributes:
        time_ns: by the robot's clock, nanoseconds since 1970.
        operator: by the key expression.
        grant: the identifier of the grant; empty without a proof.
    """

    time_ns: int
    operator: str
    verb: str
    grant: str
    holds: bool
    detail: str = ""


class RefusedProof(msgspec.Struct):
    """Requests of one kind whose proof the robot refused, or stops without one.

    Attributes:
        operator: by the key expression, unverified.
        first_ns, last_ns: by the robot's clock, nanoseconds since 1970.
    """

    operator: str
    verb: str
    reason: str
    count: int
    first_ns: int
    last_ns: int


class Holder(msgspec.Struct):
    """A holder of a lease.

    Attributes:
        grant: identifier of the holder's grant; empty if the log does not show it.
        from_ns, to_ns: the first and the last accepted request of the lease, by the robot's clock.
    """

    lease: int
    operator: str
    grant: str
    from_ns: int
    to_ns: int
    drives: int


class CommandRecord:
    """Collects the commands of a robot.

    Attributes:
        root: first chunks of the robot's keys, which the requests' signatures cover.
        verbs: those with an accepted proof, by time; ``verbs_untold`` more.
    """

    def __init__(self, robot: str, authority: LogAuthority) -> None:
        self.root = ""
        self._robot, self._authority = robot, authority
        self.verbs: list[SignedVerb] = []
        self.verbs_untold = 0
        self.findings: list[ProofFinding] = []
        self._refused: dict[tuple[str, str, str], RefusedProof] = {}
        self._holders: dict[tuple[str, int], Holder] = {}

    @property
    def refused(self) -> list[RefusedProof]:
        return [one for one in self._refused.values() if one.verb != STOP_VERB]

    @property
    def unproven_stops(self) -> list[RefusedProof]:
        """Stops without a signature: stops are sent before their proof."""
        return [one for one in self._refused.values() if one.verb == STOP_VERB]

    def holders(self) -> list[Holder]:
        """The holders of the lease, in order of time."""
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
        if SIGNED_INPUT not in journal.inputs and OPEN_INPUT not in journal.inputs:
            return
        try:
            inputs = _DECODER.decode(journal.inputs)
        except UNREADABLE:
            what = "a journal message with unreadable inputs"
            self.findings.append(ProofFinding(ProofFault.CHANGED, what, journal.time_ns))
            return
        waiting: list[tuple[Any, ...]] = []
        for one in inputs:
            if one[:1] == (Kind.REQUEST,) and len(one) == _SIGNED_LENGTH:
                waiting.append(one)
            elif one[:1] == (Kind.REQUEST,):
                what = "requests of open mode: their senders are unproven"
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
                what = "a malformed request in the journal"
                self.findings.append(ProofFinding(ProofFault.CHANGED, what, at_ns))

    def _take_request(self, one: tuple[Any, ...], at_ns: int) -> None:
        _, _, _, verb, operator, payload, _, _, attachment, credentials = one
        reason = Reason(credentials[0])
        if reason is not Reason.NONE:
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
            self.verbs.append(SignedVerb(at_ns, operator, verb, grant, not detail, detail))

    def _refuse(self, operator: str, verb: str, reason: str, at_ns: int) -> None:
        new = RefusedProof(operator, verb, reason, 0, at_ns, at_ns)
        refused = self._refused.setdefault((operator, verb, reason), new)
        refused.count += 1
        refused.first_ns, refused.last_ns = min(refused.first_ns, at_ns), max(refused.last_ns, at_ns)

    def _judge(
        self,
        verb: str,
        operator: str,
        payload: bytes,
        proof: RequestProof | None,
        credentials: Sequence[Any],
        at_ns: int,
    ) -> ProofFinding | None:
        """The finding against a verb that should not have been accepted; None if it should."""
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
        """The robot's excess over the grant; empty if there is none."""
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


UNSIGNED: Final = "the log has no recorder's signature, as in open mode"
OPEN: Final = "a log is signed when it is finished; this one is still being written"

_BLOCK: Final = 1 << 20


class SignedFile(msgspec.Struct, frozen=True):
    """A log file and its signature.

    Attributes:
        sha256: of the whole file, hexadecimal; empty if it was not read.
        key: the signature's key, hexadecimal; empty if there is none.
        grant: identifier of that key's grant, hexadecimal; ``statement`` is the text of its chain.
        fits: the key signed this file; else a finding gives the reason.
    """

    file: str
    sha256: str = ""
    key: str = ""
    grant: str = ""
    statement: str = ""
    fits: bool = False


def prove_file(log: LogFile, faults: Faults, progress: Progress) -> tuple[SignedFile, ProofFinding | None]:
    """Compare a file with the signature beside it, by any signer, and return the finding, if any."""
    name = log.path.name
    if log.is_being_written:
        return SignedFile(name), ProofFinding(ProofFault.UNPROVEN, OPEN)
    try:
        data = _beside(log.path)
        digest = hashlib.sha256()
        with log.open() as stream:
            while data and (block := stream.read(_BLOCK)):
                digest.update(block)
                progress(0)
    except OSError as error:
        faults.add(f"{log.name}: {error.strerror or error}")
        return SignedFile(name), ProofFinding(ProofFault.UNPROVEN, "a file cannot be read")
    if not data:
        return SignedFile(name), ProofFinding(ProofFault.UNPROVEN, UNSIGNED)
    sha256, found = digest.hexdigest(), LogSignature.read(data)
    if found is None:
        what = f"{name}: the signature beside it has an unknown form"
        return SignedFile(name, sha256), ProofFinding(ProofFault.CHANGED, what)
    finding = None
    if not found.fits:
        finding = ProofFinding(ProofFault.WRONGLY_SIGNED, f"{name}: its signature is not that of the key it names")
    elif found.sha256 != sha256:
        finding = ProofFinding(ProofFault.CHANGED, f"{name} is not the file that its recorder signed")
    chain = found.chain
    return SignedFile(name, sha256, found.key.hex(), chain[0].id.hex(), chain_text(chain), not finding), finding


def _beside(path: Path) -> bytes:
    """The signature beside a log; empty if there is none."""
    beside = path.with_name(path.name + SIGNATURE_SUFFIX)
    try:
        if other_kind(beside.stat().st_mode):
            return b"\n"
        with beside.open("rb") as stream:
            return stream.read(SIGNATURE_MAX_BYTES + 1) or b"\n"
    except FileNotFoundError:
        return b""
