"""Whom a log's grants, revocations and robot keys go back to, and whether they held at a time.

The authority changes in mid-log: lists of revocations come, a rotation replaces the keys, grants are renewed. Each
sample is judged by what was in force at its time. A statement was in force from the moment when the robot showed
it first at the latest, and not before it was signed; in between the robot may or may not have known it, for a log
may begin long after, and the robot repeats what is in force.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Final

import msgspec

from recorder.review.verifying.findings import ProofFault, ProofFinding
from schemas.authority.proof import (
    Grant,
    GrantRole,
    Revocations,
    Rotation,
    Signed,
    StatementFault,
    chain_text,
    read_chain,
)
from schemas.authority.trust import BY_SITE, HeldGrant, Objection, Trust, fingerprint, is_signed
from schemas.reasons import TEXTS, Reason

_NOBODY: Final = bytes(32)
"""The standby key of an authority that is not known: nobody has it."""

_S: Final = 1_000_000_000

_ALWAYS_NS: Final = -(2**63)


class ShownStatement(msgspec.Struct, frozen=True):
    """A statement that a robot took over, or repeated.

    Attributes:
        time_ns: when it said so, by its clock, nanoseconds since 1970.
        text: the statement with its chain and signatures.
    """

    robot: str
    time_ns: int
    text: str


class GrantInfo(msgspec.Struct, frozen=True):
    """A grant of a log, for people.

    Attributes:
        id: the identifier, hexadecimal.
        name, role, serial, key: of the holder.
        not_before, not_after: the time in which all of its chain holds, seconds since 1970.
        signers: names of those above it in the chain, the nearest first.
        root: the key of the authority at which the chain ends, hexadecimal.
        objection: why it did not hold when it was first used; empty if it did.
        revoked_later: the reason for which it was revoked, or its authority replaced, by the end of the logs;
            empty if it was not, or did not hold from the first.
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
    revoked_later: str = ""


class _InForce(msgspec.Struct, frozen=True):
    """The authorities that counted from a time on: more than one as long as nothing says which of the given.

    Attributes:
        earliest_ns: the time of the signature of the statement that brought them.
        shown_ns: the time when the robot showed that statement first.
    """

    earliest_ns: int
    shown_ns: int
    trusts: tuple[Trust, ...]


class LogAuthority:
    """The authority, the grants and the keys of a robot, as its log shows them.

    Attributes:
        is_vouched: the authority's keys were given from outside; else the log is all there is to believe.
        roots: the authority's active keys, in the order in which they were in force; none if the log names none.
        robot_keys: keys that the log says are this robot's.
        findings: statements that do not hold.
    """

    def __init__(self, robot: str, given: Sequence[Trust], statements: Iterable[ShownStatement]) -> None:
        """Read statements.

        Args:
            robot: the robot's name, without its root.
            given: the fleet's authority, and those before it; without any the log is believed.
            statements: in any order, repeated ones too.
        """
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
            # Whoever made this log, it can hold in itself, or not: by its own authority that is told all the same.
            self.is_vouched = False
            self.findings = [ProofFinding(ProofFault.OTHER_AUTHORITY, other), *unread]
            self._follow(tuple(self._named()), changes)
        roots = (trust.active for state in self._in_force for trust in state.trusts)
        self.roots = list(dict.fromkeys(roots))

    def _follow(self, first: tuple[Trust, ...], changes: Sequence[tuple[int, Signed]]) -> None:
        """Follow the authority from its beginning through the lists and rotations of the log, in order."""
        self._in_force = [_InForce(_ALWAYS_NS, _ALWAYS_NS, first)]
        self._foreign.clear()
        for time_ns, signed in changes:
            self._change(time_ns, signed)
        self._judge_foreign()

    @property
    def grants(self) -> list[GrantInfo]:
        """The grants that were judged."""
        judged = self._judged.values()
        return [msgspec.structs.replace(one, revoked_later=self._revoked_later(one)) for one in judged]

    def _revoked_later(self, info: GrantInfo) -> str:
        """Return why no authority of the end of the logs counts a grant that held once; empty if one does."""
        if info.objection:
            return ""
        objection: Objection | None = None
        for chain in self._grants[bytes.fromhex(info.id)]:
            for trust in self._in_force[-1].trusts:
                held = self._held(chain, trust, info.not_before)
                if isinstance(held, HeldGrant):
                    return ""
                objection = objection or held
        return "" if objection is None else objection.text

    def judge(self, identifier: bytes, at_ns: int) -> HeldGrant | Objection | None:
        """Judge a grant as the robot had to at a time, nanoseconds since 1970; None if it is not in the log."""
        return self._judge(self._grants.get(identifier, ()), at_ns)

    def judge_own(self) -> Iterator[ProofFinding]:
        """Judge the robot's own grants at the times when it showed them.

        A rotation ends one; until the next one comes, the key is that of the grants on both sides. That a grant is
        over means that nobody vouches for the key, and not that somebody else has it.
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
        """Return the finding that somebody did something at a time with a grant that did not hold."""
        if objection.reason is Reason.GRANT_UNKNOWN and self._unknown_until_ns != _ALWAYS_NS:
            why = (
                f"that is under authority {_fingerprints(self._unknown_roots()) or 'of before'}, which was not "
                f"given; the log shows the rotation from it to {_fingerprints(self._given_keys())}: give the "
                "authority.json of before it too (--authority FILE for each)"
            )
            return ProofFinding(ProofFault.UNPROVEN, f"{what}: {why}", at_ns)
        is_by_site = objection.detail == BY_SITE
        fault = ProofFault.UNPROVEN if is_by_site else ProofFault.NOT_GRANTED
        return ProofFinding(fault, f"{what}: {_cause(objection)}", at_ns)

    def _other_authority(self) -> str:
        """Return that the whole log is under an authority that was not given, in words; empty if it is not.

        So it is if no grant of the robot's own goes back to one that was given, and the log leads to none of them.
        Where some do, or where an own grant holds under nobody, the others are somebody's who was put in.
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
            f"({_fingerprints(self._given_keys())}); the log shows no rotation from it to that: give the "
            "authority.json of then (--authority FILE). If that authority was never yours, somebody else made this"
        )

    def _unknown_roots(self) -> list[bytes]:
        """Return the keys of authorities of the robot's own grants that are not known."""
        known = {trust.active for state in self._in_force for trust in state.trusts}
        roots = (chain[-1].signer for chains in self._own.values() for chain in chains)
        return [root for root in dict.fromkeys(roots) if root not in known]

    def _given_keys(self) -> list[bytes]:
        return [trust.active for trust in self._given]

    def _is_of_former(self, chains: Sequence[list[Signed]]) -> bool:
        """Report whether an authority that counted before or after signed any of these chains."""
        trusts = [trust for state in self._in_force for trust in state.trusts]
        return any(isinstance(self._verify(chain, trust), HeldGrant) for chain in chains for trust in trusts)

    def _judge(self, chains: Sequence[list[Signed]], at_ns: int) -> HeldGrant | Objection | None:
        """The first chain that held; else the first objection, by the authority that certainly counted."""
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
        """The state that counted at a time for certain, and then those that may have counted already."""
        certain = max(number for number, state in enumerate(self._in_force) if state.shown_ns < at_ns)
        yield self._in_force[certain]
        yield from (state for state in self._in_force[certain + 1 :] if state.earliest_ns <= at_ns)

    def _held(self, chain: list[Signed], trust: Trust, now_s: int) -> HeldGrant | Objection:
        held = self._verify(chain, trust)
        return held if isinstance(held, Objection) else trust.objection(held, now_s) or held

    def _verify(self, chain: list[Signed], trust: Trust) -> HeldGrant | Objection:
        """Verify the signatures of a chain, once for each authority, and nothing that depends on the time."""
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
        """The authority that the robot's first grant names; no one vouches for it."""
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
        # Of an authority that was given, and not come to by a rotation, it is not known who was there before.
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
            what = "a rotation cannot be checked: who the standby is, the log does not say (--authority)"
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
        """Judge the statements that no authority in force signed, now that all rotations are known.

        A robot may repeat the list of an authority that was replaced: that list is in force no more.
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
        """The authorities that count from now on. A robot's clock may be behind that of who signed."""
        shown_ns = max(time_ns, self._in_force[-1].shown_ns)
        self._in_force.append(_InForce(min(signed_s * _S, shown_ns), shown_ns, trusts))

    def _find(self, fault: ProofFault, what: str, time_ns: int) -> None:
        self.findings.append(ProofFinding(fault, what, time_ns))


def _cause(objection: Objection) -> str:
    """Return an objection in words that are the same each second: without how long ago a grant ended."""
    if objection.reason is not Reason.GRANT_EXPIRED:
        return objection.text
    has_begun = "begins" not in objection.detail
    return TEXTS[objection.reason].means if has_begun else "it had not begun"


def _fingerprints(keys: Iterable[bytes]) -> str:
    return ", ".join(fingerprint(key) for key in keys)


def _first_shown(statements: Iterable[ShownStatement]) -> list[tuple[int, str]]:
    """Each text once, with the time when it was shown first, in order of time."""
    first: dict[str, int] = {}
    for one in statements:
        first[one.text] = min(first.get(one.text, one.time_ns), one.time_ns)
    return sorted((time_ns, text) for text, time_ns in first.items())


def _order(change: tuple[int, Signed]) -> tuple[int, int, int]:
    """Those that a robot repeats at one time: rotations before lists, each by its serial."""
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
