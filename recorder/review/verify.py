"""The verification of a robot's logs: who commanded when, with which grant, and each file's signature.

The operator's signature in the journal proves a verb, the recorder's signature a file since its data was received.
Nothing proves that no data was lost in between.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

import msgspec

from recorder.encoding.samples import SEQUENCE_SPAN
from recorder.reading.logs import Faults, LogFile, logs_of
from recorder.reading.rows import Progress, Row, Selection, decoded_rows
from recorder.reading.survey import survey
from recorder.reading.topics import Topic
from recorder.review.verifying import (
    CommandRecord,
    GrantInfo,
    Holder,
    LogAuthority,
    ProofFault,
    ProofFinding,
    RefusedProof,
    ShownStatement,
    SignedFile,
    SignedVerb,
    file_statements,
    prove_file,
)
from schemas import keys
from schemas.authority.proof import GrantRole
from schemas.authority.trust import HeldGrant, Objection, Trust
from schemas.decisions import Decision, Journal, SignedStatement
from schemas.messages import Message
from schemas.reasons import Reason

JOURNAL: Final = "journal"
DECISION: Final = "safety/decision"
STATEMENT: Final = "authority/statement"

FINDINGS_MAX: Final = 1000  # findings beyond which equal ones are merged


class RobotProofReport(msgspec.Struct, frozen=True):
    """The result of the verification of a robot's logs.

    Attributes:
        authorities: the active keys of the fleet's authority, hexadecimal: several across a rotation.
        is_vouched: the logs are under a given authority.
        robot_key: the robot's, hexadecimal; empty if the logs do not hold its grant.
        verbs: signed verbs that the robot accepted; ``verbs_untold`` more.
        refused: requests that it refused for their proof.
        unproven_stops: stops without a signature; stops are always executed.
        unread: unreadable parts of the logs, of any robot.
    """

    robot: str
    authorities: list[str]
    is_vouched: bool
    robot_key: str
    files: list[SignedFile]
    grants: list[GrantInfo]
    holders: list[Holder]
    verbs: list[SignedVerb]
    verbs_untold: int
    refused: list[RefusedProof]
    unproven_stops: list[RefusedProof]
    findings: list[ProofFinding]
    unread: int = 0

    @property
    def is_broken(self) -> bool:
        """True if something was changed, wrongly signed, or not granted."""
        return any(one.fault.is_tampering for one in self.findings)

    @property
    def is_of_other_authority(self) -> bool:
        """True if the logs are under an authority that was not given."""
        return any(one.fault is ProofFault.OTHER_AUTHORITY for one in self.findings)

    @property
    def holds(self) -> bool:
        """True if the readable part holds."""
        return not self.findings

    @property
    def is_proven(self) -> bool:
        """True if all could be read, and holds."""
        return self.holds and not self.unread


def verify_logs(
    logs: Sequence[LogFile],
    faults: Faults,
    trusts: Sequence[Trust] = (),
    progress: Progress = lambda _: None,
) -> Iterator[RobotProofReport]:
    """Verify the logs of each robot; without an authority, by the one named in the logs."""
    robots, verified = set(survey(logs, faults).robots), set[str]()
    # A verification also finds robots that the summaries omit.
    files = [prove_file(log, faults, progress) for log in logs]
    while left := robots - verified:
        robot = min(left)
        yield _Verification(robot, logs, files, faults, trusts, robots).run(progress)
        verified.add(robot)


class _Verification:
    def __init__(
        self,
        robot: str,
        logs: Sequence[LogFile],
        files: Sequence[tuple[SignedFile, ProofFinding | None]],
        faults: Faults,
        trusts: Sequence[Trust],
        robots: set[str],
    ) -> None:
        """Verify this robot; others are added to ``robots`` when found."""
        self._robot, self._logs, self._faults, self._robots = robot, logs, faults, robots
        self._trusts = trusts
        self._statements = [one for one in file_statements(logs, faults) if one.robot == robot]
        own = {log.path for log in logs_of(robot, logs)}
        self._files = [(log, *file) for log, file in zip(logs, files, strict=True) if log.path in own]
        self._findings: list[ProofFinding] = []

    def run(self, progress: Progress) -> RobotProofReport:
        """Read the logs twice: statements, then commands."""
        for _, message in self._rows((STATEMENT,), lambda _: None):
            if isinstance(message, SignedStatement):
                self._statements.append(ShownStatement(self._robot, message.time_ns, message.text))
        self._statements += [
            ShownStatement(self._robot, log.start_ns, file.statement) for log, file, _ in self._files if file.key
        ]
        name = self._robot.rpartition("/")[2]
        authority = LogAuthority(name, self._trusts, self._statements)
        self._findings += authority.judge_own()
        for log, file, finding in self._files:
            self._findings += filter(None, [finding or _judge_recorder(authority, log, file)])
        if not authority.robot_keys:
            what = "the logs do not hold the robot's grant, as in open mode: the operators are unproven"
            self._find(ProofFault.UNPROVEN, what, min((log.start_ns for log, _, _ in self._files), default=None))
        record = self._read_commands(name, authority, progress)
        return RobotProofReport(
            robot=self._robot,
            authorities=[key.hex() for key in authority.roots],
            is_vouched=authority.is_vouched,
            robot_key=authority.robot_keys[-1].hex() if authority.robot_keys else "",
            files=[file for _, file, _ in self._files],
            grants=authority.grants,
            holders=record.holders(),
            verbs=sorted(record.verbs, key=lambda one: one.time_ns),
            verbs_untold=record.verbs_untold,
            refused=record.refused,
            unproven_stops=record.unproven_stops,
            findings=_merged([*authority.findings, *self._findings, *record.findings]),
            unread=self._faults.count,
        )

    def _read_commands(self, name: str, authority: LogAuthority, progress: Progress) -> CommandRecord:
        record = CommandRecord(name, authority)
        taken: set[int] = set()
        for row, message in self._rows((JOURNAL, DECISION), progress):
            parts = keys.parse(row.topic.name)
            record.root = record.root or ("" if parts is None else parts.root)
            # A log and its incident hold the same samples: recognise them by a hash.
            place = hash((row.topic.subject, row.publish_ns, row.sequence, row.data))
            if place in taken:
                continue
            taken.add(place)
            if isinstance(message, Decision):
                record.take_decision(message)
            elif isinstance(message, Journal):
                record.take_journal(message)
        return record

    def _rows(self, subjects: Sequence[str], progress: Progress) -> Iterator[tuple[Row, Message]]:
        def wants(topic: Topic) -> bool:
            self._robots.update(filter(None, [topic.robot]))
            return topic.robot == self._robot and topic.subject in subjects

        for row, message in decoded_rows(self._logs, Selection(wants), self._faults, progress):
            if not isinstance(message, Message):
                continue
            if row.publish_ns != message.time_ns or row.sequence != message.sequence % SEQUENCE_SPAN:
                what = f"{row.topic.subject}: samples whose record has another time or sequence"
                self._find(ProofFault.CHANGED, what, message.time_ns)
            yield row, message

    def _find(self, fault: ProofFault, what: str, time_ns: int | None) -> None:
        self._findings.append(ProofFinding(fault, what, time_ns))
        if len(self._findings) > FINDINGS_MAX:
            self._findings = _merged(self._findings)


def _judge_recorder(authority: LogAuthority, log: LogFile, file: SignedFile) -> ProofFinding | None:
    """Return the finding against the signer of a file, by the grants in force at its end; None if there is none.

    An expired grant, or one of an unknown authority, proves nothing, but is no sign of tampering.
    """
    held = authority.judge(bytes.fromhex(file.grant), log.end_ns)
    if isinstance(held, Objection) and held.reason is not Reason.GRANT_REVOKED:
        what = f"{file.file} is signed by an unverified recorder: {held.text}"
        return ProofFinding(ProofFault.UNPROVEN, what, log.end_ns)
    if isinstance(held, Objection):
        return authority.finding(f"{file.file} is signed by a recorder that was revoked", held, log.end_ns)
    if isinstance(held, HeldGrant) and held.grant.role is GrantRole.RECORDER:
        return None
    what = f"{file.file} is signed by a key without a recorder's grant"
    return ProofFinding(ProofFault.WRONGLY_SIGNED, what, log.end_ns)


def _merged(findings: Sequence[ProofFinding]) -> list[ProofFinding]:
    """Merge equal findings, the earliest first."""
    merged: dict[tuple[ProofFault, str], ProofFinding] = {}
    for one in findings:
        known = merged.get((one.fault, one.what))
        count = one.count + (0 if known is None else known.count)
        both = [other for other in (known, one) if other is not None]
        times = [at for other in both for at in (other.time_ns, other.until_ns) if at is not None]
        first, last = min(times, default=None), max(times, default=None)
        until = None if first == last else last
        merged[one.fault, one.what] = ProofFinding(one.fault, one.what, first, count, until)
    return sorted(merged.values(), key=lambda one: one.time_ns or 0)
