"""Whom a log's grants, revocations and robot keys go back to, and whether they hold at a time."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from typing import Final

import msgspec

from recorder.review.verifying.findings import ProofFault, ProofFinding
from schemas.authority.statement import (
    Grant,
    GrantRole,
    Revocations,
    Rotation,
    Signed,
    StatementFault,
    read_chain,
)
from schemas.authority.trust import HeldGrant, Objection, Trust
from schemas.reasons import Reason

_NOBODY: Final = bytes(32)
"""The standby key of an authority that is not known: nobody has it."""

_S: Final = 1_000_000_000


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


class LogAuthority:
    """The authority, the grants and the keys of a robot, as its log shows them.

    Attributes:
        is_vouched: the authority's keys were given from outside; else the log is all there is to believe.
        root: the authority's active key; empty if the log does not even name one.
        robot_keys: keys that the log says are this robot's, each with the chain of its grant.
        findings: statements that do not hold.
    """

    def __init__(self, robot: str, given: Trust | None, statements: Sequence[ShownStatement]) -> None:
        """Read statements.

        Args:
            robot: the robot's name, without its root.
            given: the fleet's authority; None believes the one that the log names.
            statements: in any order.
        """
        self.is_vouched = given is not None
        self.findings: list[ProofFinding] = []
        self.robot_keys: dict[bytes, list[Signed]] = {}
        self._grants: dict[bytes, list[Signed]] = {}
        self._judged: dict[bytes, GrantInfo] = {}
        changes: list[tuple[int, Signed]] = []
        for one in sorted(statements, key=lambda shown: shown.time_ns):
            chain = read_chain(one.text.encode())
            if isinstance(chain, StatementFault):
                self._find(ProofFault.CHANGED, f"a statement cannot be read: {chain.detail}", one.time_ns)
            elif isinstance(chain[0].statement, Grant):
                self._take_grant(chain, chain[0].statement, robot)
            else:
                changes.append((one.time_ns, chain[0]))
        trust = given or self._named()
        self.root = b"" if trust is None else trust.active
        self._times: list[int] = []
        self._trusts = [trust]
        for time_ns, signed in changes:
            self._change(time_ns, signed)

    def grant(self, identifier: bytes) -> list[Signed] | None:
        """The chain of a grant; None if the log does not hold it."""
        return self._grants.get(identifier)

    def judge(self, chain: Sequence[Signed], at_ns: int) -> HeldGrant | Objection:
        """Judge a grant as the robot had to at a time, nanoseconds since 1970."""
        trust = self._trusts[bisect_right(self._times, at_ns)]
        held = Objection(Reason.GRANT_UNKNOWN) if trust is None else trust.judge(list(chain), at_ns // _S)
        statement = chain[0].statement
        if chain[0].id not in self._judged and isinstance(statement, Grant):
            self._judged[chain[0].id] = _info(chain, statement, held)
        return held

    @property
    def grants(self) -> list[GrantInfo]:
        """The grants that were judged."""
        return list(self._judged.values())

    def _take_grant(self, chain: list[Signed], grant: Grant, robot: str) -> None:
        if chain[0].id in self._grants:
            return
        self._grants[chain[0].id] = chain
        if grant.role is GrantRole.ROBOT and grant.name == robot:
            self.robot_keys[bytes.fromhex(grant.key)] = chain

    def _named(self) -> Trust | None:
        """The authority that the robot's own grant names; no one vouches for it."""
        chains = list(self.robot_keys.values()) or list(self._grants.values())
        return Trust(chains[0][-1].signer, _NOBODY) if chains else None

    def _change(self, time_ns: int, signed: Signed) -> None:
        trust = self._trusts[-1]
        if trust is None:
            return
        if isinstance(signed.statement, Rotation) and not self.is_vouched:
            what = "a rotation cannot be checked: who the standby is, the log does not say (--authority)"
            self._find(ProofFault.UNPROVEN, what, time_ns)
            return
        is_list = isinstance(signed.statement, Revocations)
        newer = trust.revoke(signed) if is_list else trust.rotate(signed)
        if isinstance(newer, Trust):
            self._times.append(max([time_ns, *self._times[-1:]]))
            self._trusts.append(newer)
        elif newer.reason is not Reason.REPLAYED:  # A robot repeats the list in force.
            name = "a list of revocations" if is_list else "a rotation"
            self._find(ProofFault.WRONGLY_SIGNED, f"{name} is not the authority's: {newer.detail}", time_ns)

    def _find(self, fault: ProofFault, what: str, time_ns: int) -> None:
        self.findings.append(ProofFinding(fault, what, time_ns))


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
