"""The hash chains of a robot's runs, held against the samples of its logs.

Two heads that follow each other say between them how many samples there are, and which. Samples are held until all
between two heads have come, whatever their order, and are then forgotten but for a digest of each, 8 bytes: so
memory grows by some 2 MB for each hour of a robot.
"""

from __future__ import annotations

import hashlib
from bisect import bisect_right
from collections.abc import Hashable, Iterable, Iterator, Sequence
from typing import Final

import msgspec

from recorder.review.verifying.findings import ProofFault, ProofFinding
from schemas.authority.chain import CHAINED, HEAD_PERIOD_NS, first_link, next_link
from schemas.decisions import ChainHeads

TAIL_NS: Final = 5_000_000_000
"""Samples so long after the last head have lost theirs: a head comes each second."""

LINKING_NS: Final = 3_000_000_000
"""The longest time from the first head of a log to its first samples: one subject may be linked after another."""

DIGEST_BYTES: Final = 8

ALTERNATIVES_MAX: Final = 8
"""Contradicting samples of one place that are tried, before a chain is said to be broken."""


class ChainLink(msgspec.Struct, frozen=True, gc=False):
    """A sample that belongs into a chain.

    Attributes:
        sequence: its place in the chain.
        time_ns: when it was published, by the robot's clock, nanoseconds since 1970.
        run: distinguishes the samples of one run of the gateway from those of others.
        payload: its MessagePack bytes.
    """

    sequence: int
    time_ns: int
    run: Hashable
    payload: bytes


class ProvenCount(msgspec.Struct):
    """The samples of a subject in one run of the gateway.

    Attributes:
        proven: samples that two heads prove.
        before: samples before the first head from which on the log is whole: nothing proves them.
        absent: samples of the run before these, which the log does not hold: it begins in mid-run.
        after: samples after the last head: nothing proves them yet.
        missing: samples that the heads count and the log lacks.
        broken: samples that stand between heads with something missing or changed.
        repeated: samples that are in the logs more than once, alike; each counts once.
        from_ns: time of the first head from which on samples are proven; 0 if they are from the run's first
            sample on, None if none is.
    """

    proven: int = 0
    before: int = 0
    absent: int = 0
    after: int = 0
    missing: int = 0
    broken: int = 0
    repeated: int = 0
    from_ns: int | None = None


class _Segment:
    """The samples between two heads of a subject: places ``first`` up to, but not including, ``end``."""

    __slots__ = ("digests", "end", "first", "from_ns", "head", "held", "others", "start", "to_ns")

    def __init__(self, first: int, end: int, start: bytes, head: bytes, from_ns: int, to_ns: int) -> None:
        self.first, self.end = first, end
        self.start, self.head = start, head
        self.from_ns, self.to_ns = min(from_ns, to_ns), max(from_ns, to_ns)
        self.held: dict[Hashable, dict[int, bytes]] = {}
        self.others: dict[tuple[Hashable, int], list[bytes]] = {}
        self.digests = b""

    def distance_ns(self, time_ns: int) -> int:
        return max(0, self.from_ns - time_ns, time_ns - self.to_ns)

    def add(self, link: ChainLink) -> bool | None:
        """True if the sample is new, False if it is there already; None if it contradicts one that is."""
        if self.digests:
            at = (link.sequence - self.first) * DIGEST_BYTES
            return False if self.digests[at : at + DIGEST_BYTES] == _digest(link.payload) else None
        held = self.held.setdefault(link.run, {})
        before = held.setdefault(link.sequence, link.payload)
        if before is not link.payload:
            if before == link.payload:
                return False
            others = self.others.setdefault((link.run, link.sequence), [])
            if len(others) < ALTERNATIVES_MAX:
                others.append(link.payload)
            return None
        if len(held) == self.end - self.first:
            self._prove(link.run)
        return True

    def _prove(self, run: Hashable) -> None:
        held = self.held[run]
        links = [held[place] for place in range(self.first, self.end)]
        for tried in self._readings(run, links):
            head = self.start
            for payload in tried:
                head = next_link(head, payload)
            if head == self.head:
                self.digests = b"".join(map(_digest, tried))
                self.held, self.others = {}, {}
                return

    def _readings(self, run: Hashable, links: list[bytes]) -> Iterator[list[bytes]]:
        """The samples, and those with one that contradicts another in its place."""
        yield links
        for (of, place), others in self.others.items():
            at = place - self.first
            for other in others if of == run else ():
                yield [*links[:at], other, *links[at + 1 :]]

    def judge_again(self) -> None:
        """Try once more, for what contradicts may have come last."""
        for run, held in list(self.held.items()):
            if self.others and not self.digests and len(held) == self.end - self.first:
                self._prove(run)

    def best(self) -> dict[int, bytes]:
        """The samples of the run of which most are there."""
        return max(self.held.values(), key=len, default={})


def _digest(payload: bytes) -> bytes:
    return hashlib.sha256(payload).digest()[:DIGEST_BYTES]


class SubjectChain:
    """The chain of one subject in one run.

    Attributes:
        counts: the results of its samples; whole after ``close``.
        findings: the faults, likewise.
        proven_run: the run of those samples that were proven first; None before.
    """

    def __init__(self, boot: bytes, subject: str, heads: Sequence[ChainHeads]) -> None:
        """With all heads of the run, by their sequence."""
        self.subject = subject
        self.counts = ProvenCount()
        self.segments: list[_Segment] = []
        self.findings: list[ProofFinding] = []
        self.contradictions: dict[int, int] = {}
        count, head = 0, first_link(boot, subject)
        begins_ns = heads[0].time_ns - heads[0].sequence * HEAD_PERIOD_NS - TAIL_NS
        for one in heads:
            said = next((entry for entry in one.heads if entry.subject == subject), None)
            if said is None or said.count < count or (said.count == count and said.head != head):
                what = f"the heads of {subject} contradict each other"
                self.findings.append(ProofFinding(ProofFault.CHANGED, what, one.time_ns))
                continue
            if said.count > count:
                segment = _Segment(count, said.count, head, said.head, begins_ns, one.time_ns)
                self.segments.append(segment)
            count, head, begins_ns = said.count, said.head, one.time_ns
        self.end = count
        self._first_ns, self.last_ns = heads[0].time_ns, heads[-1].time_ns
        self._firsts = [segment.first for segment in self.segments]
        self._tail: set[int] = set()
        self._tail_ns = 0
        self.proven_run: Hashable = None

    def distance_ns(self, link: ChainLink) -> int:
        """The time between a sample and the heads that should have it between them; 0 if it fits."""
        if link.sequence >= self.end:
            return max(0, self.last_ns - link.time_ns, link.time_ns - self.last_ns - TAIL_NS)
        return self._segment(link.sequence).distance_ns(link.time_ns)

    def add(self, link: ChainLink) -> bool:
        """True if the sample is new."""
        if link.sequence >= self.end:
            if link.sequence in self._tail:
                self.counts.repeated += 1
                return False
            self._tail.add(link.sequence)
            self.counts.after += 1
            self._tail_ns = max(self._tail_ns, link.time_ns)
            return True
        segment = self._segment(link.sequence)
        is_new = segment.add(link)
        if segment.digests and self.proven_run is None:
            self.proven_run = link.run
        if is_new is None:
            self.contradictions.setdefault(link.sequence, link.time_ns)
        elif not is_new:
            self.counts.repeated += 1
        return is_new is True

    def close(self) -> None:
        """Nothing more comes: judge."""
        before = 0
        for number, segment in enumerate(self.segments):
            segment.judge_again()
            if segment.digests:
                self.counts.proven += segment.end - segment.first
                if self.counts.from_ns is None:
                    self.counts.from_ns = segment.from_ns if segment.first else 0
            elif number == before and self._is_before(segment):
                # The log begins in mid-run: what is there hangs on nothing. Two heads that follow each other later
                # say what lies between them, whatever the log holds of it.
                self.counts.before += len(segment.best())
                self.counts.absent += segment.end - segment.first - len(segment.best())
                before = number + 1
        self._judge_broken(self.segments[before:])
        if self.contradictions:
            what = f"{self.subject}: samples of one sequence that contradict each other"
            first_ns = min(self.contradictions.values())
            self.findings.append(ProofFinding(ProofFault.CHANGED, what, first_ns, len(self.contradictions)))
        if self._tail_ns > self.last_ns + TAIL_NS:
            seconds = (self._tail_ns - self.last_ns) / 1e9
            what = f"heads of {self.subject}: samples go on for {seconds:.0f} s after the last one"
            self.findings.append(ProofFinding(ProofFault.MISSING, what, self.last_ns, self.counts.after))

    def _is_before(self, segment: _Segment) -> bool:
        """Return True if the log may begin in a segment: with a sample within it, and without a gap from there."""
        if segment.first and segment.from_ns >= self._first_ns + LINKING_NS:
            return False
        held = segment.best()
        return not held or (segment.first not in held and len(held) == segment.end - min(held))

    def _judge_broken(self, segments: Iterable[_Segment]) -> None:
        """Find what is missing or changed; what lies next to each other is one finding."""
        missing, since_ns, until_ns = 0, 0, 0

        def tell_missing() -> None:
            if missing:
                seconds = (until_ns - since_ns) / 1e9
                what = f"{self.subject}: samples between two heads, in {seconds:.0f} s"
                self.findings.append(ProofFinding(ProofFault.MISSING, what, since_ns, missing))

        for segment in segments:
            if segment.digests:
                continue
            held, size = segment.best(), segment.end - segment.first
            self.counts.broken += len(held)
            self.counts.missing += size - len(held)
            if len(held) == size:
                what = f"{self.subject}: samples between two heads are not those that the robot signed"
                self.findings.append(ProofFinding(ProofFault.CHANGED, what, segment.from_ns, size))
                continue
            if missing and segment.from_ns > until_ns:
                tell_missing()
                missing = 0
            since_ns = since_ns if missing else segment.from_ns
            missing, until_ns = missing + size - len(held), segment.to_ns
        tell_missing()

    def _segment(self, sequence: int) -> _Segment:
        return self.segments[bisect_right(self._firsts, sequence) - 1]


class RunChains:
    """The chains of one run of a gateway.

    Attributes:
        boot: the run's random number, in the heads.
        heads: their number; ``missing_heads`` more by their sequence.
        first_ns, last_ns: times of the first and the last, by the robot's clock, nanoseconds since 1970.
        series: distinguishes the samples of this run from others', as far as something of it is proven.
    """

    def __init__(self, boot: bytes, heads: Sequence[ChainHeads]) -> None:
        """With the heads of the run, by their sequence; none twice."""
        self.boot = boot
        self.heads = len(heads)
        self.missing_heads = heads[-1].sequence - heads[0].sequence + 1 - len(heads)
        self.first_ns, self.last_ns = heads[0].time_ns, heads[-1].time_ns
        self.series: dict[str, Hashable] = {}
        self.subjects = {subject: SubjectChain(boot, subject, heads) for subject in CHAINED}

    def close(self) -> list[ProofFinding]:
        """Nothing more comes. Returns what is wrong."""
        found = []
        if self.missing_heads:
            found.append(ProofFinding(ProofFault.MISSING, "chain heads", self.first_ns, self.missing_heads))
        for chain in self.subjects.values():
            chain.close()
            found += chain.findings
        return found


class RobotChains:
    """The chains of all runs of a robot.

    Attributes:
        runs: by the time of their first heads.
    """

    def __init__(self, heads: Iterable[ChainHeads]) -> None:
        """With all heads whose signature holds, none twice."""
        by_boot: dict[bytes, list[ChainHeads]] = {}
        for one in heads:
            by_boot.setdefault(one.boot, []).append(one)
        runs = (
            RunChains(boot, sorted(of_boot, key=lambda one: one.sequence)) for boot, of_boot in by_boot.items()
        )
        self.runs = sorted(runs, key=lambda run: run.first_ns)

    def add(self, subject: str, link: ChainLink) -> tuple[RunChains | None, bool]:
        """Put a sample into the chain of its run. Returns the run, if there is any, and whether it is new."""
        series = _SERIES[subject]
        its = [run for run in self.runs if run.series.get(series) == link.run]
        open_ones = its or [run for run in self.runs if series not in run.series]
        if not open_ones:
            return None, True
        run = min(open_ones, key=lambda one: one.subjects[subject].distance_ns(link))
        chain = run.subjects[subject]
        if not its and chain.distance_ns(link) > FAR_NS:
            return None, True
        is_new = chain.add(link)
        if chain.proven_run is not None:
            run.series.setdefault(series, chain.proven_run)
        return run, is_new


FAR_NS: Final = 60_000_000_000
"""A sample so far from all heads is of a run that has none in the logs."""

_SERIES: Final = {subject: "run" if subject == "journal" else "tick" for subject in CHAINED}
"""The number by which a subject's samples show their run: see ``ChainLink.run``."""
