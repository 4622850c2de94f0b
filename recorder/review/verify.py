"""The proof of a robot's logs: who commanded when, with which grant, and whether anything is missing or changed.

Proven are the journal, the decisions and the events of a gateway in signed mode: by hash chains whose heads the
robot signs each second, and each verb by the signature of who asked. All else follows from the journal, which has
each frame and each request: see ``rerun``.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Sequence
from typing import Final

import msgspec

from recorder.encoding.key_counters import SEQUENCE_SPAN
from recorder.reading.faults import Faults
from recorder.reading.log_file import LogFile
from recorder.reading.rows import Progress, Row, Selection, read_rows
from recorder.reading.survey import survey
from recorder.reading.topics import UNREADABLE, Topic
from recorder.review.verifying.authority import GrantInfo, LogAuthority, ShownStatement
from recorder.review.verifying.chains import (
    TAIL_NS,
    ChainLink,
    ProvenCount,
    RobotChains,
    RunChains,
    SubjectChain,
    signed_text,
)
from recorder.review.verifying.commands import CommandRecord, Holder, RefusedProof, SignedVerb
from recorder.review.verifying.file_statements import file_statements
from recorder.review.verifying.findings import ProofFault, ProofFinding
from recorder.review.verifying.links import LinkReader, link_reader
from schemas import codec, keys
from schemas.authority.chain import CHAINED
from schemas.authority.trust import Trust, fits
from schemas.decisions import ChainHeads, Decision, Journal, SafetyEvent, SignedStatement, is_same_run
from schemas.messages import Message

HEADS: Final = "authority/heads"
STATEMENT: Final = "authority/statement"

FINDINGS_MAX: Final = 1000
"""Findings that wait to be put together; those that are alike are one."""


class RunProof(msgspec.Struct, frozen=True):
    """A run of a gateway in signed mode.

    Attributes:
        boot: the run's random number, hexadecimal.
        former: that of the run before, as the robot kept it, hexadecimal; empty if it knew of none.
        first_ns, last_ns: the times of the first and the last chain head, by the robot's clock.
        heads: chain heads in the logs.
        subjects: the samples of each chained subject.
    """

    boot: str
    former: str
    first_ns: int
    last_ns: int
    heads: int
    subjects: dict[str, ProvenCount]


class RobotProofReport(msgspec.Struct, frozen=True):
    """The result of the verification of a robot's logs.

    Attributes:
        authorities: the active keys of the fleet's authority, hexadecimal: more than one across a rotation;
            none if the logs name none.
        is_vouched: the authority was given by who asks; else nobody vouches for it, as where the logs are under
            another one than was given.
        robot_key: the robot's, hexadecimal; empty if the logs do not hold its grant.
        runs: those of which chain heads are there.
        unsigned_runs: runs without any, in open mode: nothing proves them.
        grants: those that were used.
        holders: the lease's holders.
        verbs: signed verbs that the robot accepted the proof of; ``verbs_untold`` more.
        refused: requests that it refused for their proof.
        unproven_stops: stops that nobody signed right before or after. A stop is served in any case.
        findings: faults, and facts that cannot be decided.
        unread: parts of the logs that cannot be read. Whose they are is not known.
    """

    robot: str
    authorities: list[str]
    is_vouched: bool
    robot_key: str
    runs: list[RunProof]
    unsigned_runs: int
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
        """Something is missing, changed, wrongly signed, or was not granted."""
        return any(one.fault.is_tampering for one in self.findings)

    @property
    def is_of_other_authority(self) -> bool:
        """All of it goes back to an authority that was not given."""
        return any(one.fault is ProofFault.OTHER_AUTHORITY for one in self.findings)

    @property
    def holds(self) -> bool:
        """All that could be read holds."""
        return bool(self.runs) and not self.unsigned_runs and not self.findings

    @property
    def is_proven(self) -> bool:
        """All that is there could be read, and holds."""
        return self.holds and not self.unread


def verify_logs(
    logs: Sequence[LogFile],
    faults: Faults,
    trusts: Sequence[Trust] = (),
    statements: Sequence[ShownStatement] = (),
    progress: Progress = lambda _: None,
) -> Iterator[RobotProofReport]:
    """Verify the logs of each robot.

    Args:
        logs: in the order of their beginnings.
        faults: collects what cannot be read.
        trusts: the fleet's authority, and those before it; without any the one that the logs name is believed.
        statements: grants and revocations that are not in the logs.
        progress: receives the count of bytes that were read, for each robot anew.
    """
    robots, verified = set(survey(logs, faults).robots), set[str]()
    # What the summaries leave out, a verification comes upon.
    while left := robots - verified:
        robot = min(left)
        own = [one for one in statements if one.robot == robot]
        yield _Verification(robot, logs, faults, trusts, own, robots).run(progress)
        verified.add(robot)


def shown_statements(
    logs: Sequence[LogFile], faults: Faults, progress: Progress = lambda _: None
) -> list[ShownStatement]:
    """All grants and revocations that logs hold, by their log time; each text once for each robot."""
    found: dict[tuple[str, str], ShownStatement] = {}
    wanted = Selection(lambda topic: topic.subject == STATEMENT)
    for row, message in _messages(read_rows(logs, wanted, faults, progress), faults):
        if isinstance(message, SignedStatement):
            robot = row.topic.robot
            found.setdefault((robot, message.text), ShownStatement(robot, message.time_ns, message.text))
    for one in file_statements(logs, faults):
        found.setdefault((one.robot, one.text), one)
    return list(found.values())


class _Verification:
    def __init__(
        self,
        robot: str,
        logs: Sequence[LogFile],
        faults: Faults,
        trusts: Sequence[Trust],
        statements: Sequence[ShownStatement],
        robots: set[str],
    ) -> None:
        """Of this robot; others are added to ``robots`` as they are met."""
        self._robot, self._logs, self._faults, self._robots = robot, logs, faults, robots
        self._trusts, self._statements = trusts, list(statements)
        self._statements += [one for one in file_statements(logs, faults) if one.robot == robot]
        self._findings: list[ProofFinding] = []
        self._readers: dict[Topic, LinkReader | None] = {}
        self._ticks: list[int] = []
        self._unsigned: dict[tuple[str, Hashable], tuple[int, int]] = {}
        self._signed_runs: set[Hashable] = set()
        self._root = ""
        self._robot_key = b""

    def run(self, progress: Progress) -> RobotProofReport:
        """Read the logs twice: statements and heads, and then what they prove."""
        heads = self._read_proofs()
        name = self._robot.rpartition("/")[2]
        authority = LogAuthority(name, self._trusts, self._statements)
        record = CommandRecord(self._root, name, authority)

        is_signed = bool(authority.robot_keys)

        def take(link: ChainLink, is_proven: bool) -> None:  # noqa: FBT001 - see Take
            message = link.message
            if isinstance(message, Decision):
                record.take_decision(message, link.run, is_proven=is_proven and is_signed)
            elif isinstance(message, Journal) and record.take_journal(message, is_proven=is_proven and is_signed):
                self._signed_runs.add(link.run)

        chains = RobotChains(self._distinct(self._signed(heads, authority)), take)
        self._read_links(chains, progress)
        self._findings += chains.close()
        for run in chains.runs:
            for subject, chain in run.subjects.items():
                self._take_strangers(subject, chain)
        self._judge_unsigned()
        self._judge_bare(chains.runs)
        return RobotProofReport(
            robot=self._robot,
            authorities=[key.hex() for key in authority.roots],
            is_vouched=authority.is_vouched,
            robot_key=self._robot_key.hex(),
            runs=list(map(_as_proof, chains.runs)),
            unsigned_runs=sum(subject == "journal" for subject, _ in self._unsigned),
            grants=authority.grants,
            holders=record.holders(),
            verbs=sorted(record.verbs, key=lambda one: one.time_ns),
            verbs_untold=record.verbs_untold,
            refused=record.refused,
            unproven_stops=record.unproven_stops,
            findings=_merged([*authority.findings, *self._findings, *record.findings]),
            unread=self._faults.count,
        )

    def _rows(self, subjects: Sequence[str], progress: Progress) -> Iterator[tuple[Row, Message]]:
        def wants(topic: Topic) -> bool:
            self._robots.update(filter(None, [topic.robot]))
            return topic.robot == self._robot and topic.subject in subjects

        # Others may read what a wrong index hides.
        wanted = Selection(wants, checks_indexes=subjects is CHAINED)
        for row, message in _messages(read_rows(self._logs, wanted, self._faults, progress), self._faults):
            parts = keys.parse(row.topic.name)
            self._root = self._root or ("" if parts is None else parts.root)
            if row.publish_ns != message.time_ns or row.sequence != message.sequence % SEQUENCE_SPAN:
                what = f"{row.topic.subject}: samples that the log gives another time, or another place"
                self._find(ProofFault.CHANGED, what, message.time_ns)
            yield row, message

    def _read_proofs(self) -> list[ChainHeads]:
        heads: dict[bytes, ChainHeads] = {}
        for _, message in self._rows((HEADS, STATEMENT), lambda _: None):
            if isinstance(message, SignedStatement):
                self._statements.append(ShownStatement(self._robot, message.time_ns, message.text))
            elif isinstance(message, ChainHeads):
                heads.setdefault(codec.encode(message), message)
        return list(heads.values())

    def _distinct(self, heads: Sequence[ChainHeads]) -> list[ChainHeads]:
        """Return one of each number of a run. Those that the robot did not sign are in nobody's way any more."""
        distinct: dict[tuple[bytes, int], ChainHeads] = {}
        for one in heads:
            if distinct.setdefault((one.boot, one.sequence), one) != one:
                self._find(ProofFault.CHANGED, "chain heads that contradict each other", one.time_ns)
        return list(distinct.values())

    def _signed(self, heads: Sequence[ChainHeads], authority: LogAuthority) -> list[ChainHeads]:
        """The heads whose signature is the robot's."""
        robot_keys = authority.robot_keys
        if heads and not robot_keys:
            what = "the logs do not hold the robot's grant: whose chain heads these are cannot be told"
            self._find(ProofFault.UNPROVEN, what, min(one.time_ns for one in heads))
            return list(heads)
        signed = []
        times: dict[bytes, list[int]] = {}
        for one in heads:
            text = signed_text(one)
            signer = next((key for key in robot_keys if text and fits(key, one.signature, text)), None)
            if signer is None:
                self._find(ProofFault.WRONGLY_SIGNED, "chain heads that the robot did not sign", one.time_ns)
                continue
            times.setdefault(signer, []).append(one.time_ns)
            self._robot_key = signer
            signed.append(one)
        for key, at in times.items():
            self._findings += authority.judge_robot(key, at)
        return signed

    def _read_links(self, chains: RobotChains, progress: Progress) -> None:
        for row, message in self._rows(CHAINED, progress):
            if row.topic not in self._readers:
                self._readers[row.topic] = link_reader(row.topic)
            reader = self._readers[row.topic]
            if reader is None:
                what = f"{row.topic.subject} has fields of a newer version: verify it with that one"
                self._find(ProofFault.UNPROVEN, what, message.time_ns)
                continue
            if reader.hides(row.data):
                what = f"{row.topic.subject}: samples with fields that only some readers see"
                self._find(ProofFault.CHANGED, what, message.time_ns)
            run_id = self._run_of(message)
            link = ChainLink(message.sequence, message.time_ns, run_id, reader.encode(message), message)
            if not chains.add(row.topic.subject, link):
                self._take_unsigned(row.topic.subject, run_id, message.time_ns, message.time_ns)

    def _take_strangers(self, subject: str, chain: SubjectChain) -> None:
        """Count the samples that stood among those of a run, and are of another that has no heads."""
        for run_id, (first_ns, last_ns) in chain.strangers.items():
            self._take_unsigned(subject, run_id, first_ns, last_ns)

    def _take_unsigned(self, subject: str, run_id: Hashable, first_ns: int, last_ns: int) -> None:
        known = self._unsigned.get((subject, run_id), (first_ns, last_ns))
        self._unsigned[subject, run_id] = min(known[0], first_ns), max(known[1], last_ns)

    def _run_of(self, message: Message) -> Hashable:
        """Return an identifier of a message's run: the journal's number, or one tick for all ticks of a run."""
        if isinstance(message, Journal):
            return message.run
        tick = message.tick if isinstance(message, Decision | SafetyEvent) else 0
        for one in self._ticks:
            if is_same_run(one, tick):
                return one
        self._ticks.append(tick)
        return tick

    def _judge_unsigned(self) -> None:
        for (subject, run_id), (time_ns, until_ns) in self._unsigned.items():
            if subject != "journal":
                continue
            if run_id not in self._signed_runs:
                what = "a run without chain heads, as in open mode: nothing proves it"
                self._find(ProofFault.UNPROVEN, what, time_ns)
            elif until_ns - time_ns > TAIL_NS:
                what = "chain heads of a whole run, whose requests are those of signed mode"
                self._find(ProofFault.MISSING, what, time_ns)
            else:
                what = "a run, or a part of one, that is too short to hold a chain head"
                self._find(ProofFault.UNPROVEN, what, time_ns)
        if not any(subject == "journal" for subject, _ in self._unsigned):
            for (subject, _), (time_ns, _) in self._unsigned.items():
                what = f"{subject}: samples of a run that has no chain heads and no journal"
                self._find(ProofFault.UNPROVEN, what, time_ns)

    def _judge_bare(self, runs: Sequence[RunChains]) -> None:
        """Find logs with heads of which nothing stands between two: a single one proves no sample beside it."""
        if runs and not any(chain.counts.proven for run in runs for chain in run.subjects.values()):
            self._find(ProofFault.UNPROVEN, "no sample stands between two chain heads", runs[0].first_ns)

    def _find(self, fault: ProofFault, what: str, time_ns: int) -> None:
        self._findings.append(ProofFinding(fault, what, time_ns))
        if len(self._findings) > FINDINGS_MAX:
            self._findings = _merged(self._findings)


def _messages(rows: Iterator[Row], faults: Faults) -> Iterator[tuple[Row, Message]]:
    for row in rows:
        try:
            message = None if row.topic.decode is None else row.topic.decode(row.data)
        except UNREADABLE as error:
            faults.add(f"{row.topic.name}: a message that cannot be read: {error}")
            continue
        if isinstance(message, Message):
            yield row, message


def _as_proof(run: RunChains) -> RunProof:
    return RunProof(
        boot=run.boot.hex(),
        former="" if run.former is None else run.former.boot.hex(),
        first_ns=run.first_ns,
        last_ns=run.last_ns,
        heads=run.heads,
        subjects={subject: chain.counts for subject, chain in run.subjects.items()},
    )


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
