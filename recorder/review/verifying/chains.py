"""The hash chains of a robot's runs, held against the samples of its logs.

Two heads that follow each other say between them how many samples there are, and which. Samples are held until all
between two heads have come, whatever their order, and are then forgotten but for a digest of each, 8 bytes: so
memory grows by some 2 MB for each hour of a robot.
"""

from __future__ import annotations

import hashlib
from bisect import bisect_right
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from typing import Final

import msgspec

from recorder.review.verifying.findings import ProofFault, ProofFinding
from schemas.authority.chain import CHAINED, HEAD_PERIOD_NS, FormerHeads, first_link, heads_text, next_link
from schemas.decisions import ChainHeads
from schemas.messages import Message

TAIL_NS: Final = 5_000_000_000
"""Samples so long after the last head have lost theirs: a head comes each second."""

LINKING_NS: Final = 3_000_000_000
"""The longest time from the first head of a log to its first samples: one subject may be linked after another."""

BARE_NS: Final = 1_500_000_000
"""Honest logs have no more before their first head and after the last one: a head comes each second."""

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
        message: the sample itself.
    """

    sequence: int
    time_ns: int
    run: Hashable
    payload: bytes
    message: Message


Take = Callable[[ChainLink, bool], None]
"""Receives each sample once, and whether two heads prove it."""


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

    __slots__ = ("_take", "digests", "end", "first", "from_ns", "head", "held", "others", "start", "to_ns")

    def __init__(
        self, first: int, end: int, start: bytes, head: bytes, from_ns: int, to_ns: int, take: Take
    ) -> None:
        self._take = take
        self.first, self.end = first, end
        self.start, self.head = start, head
        self.from_ns, self.to_ns = min(from_ns, to_ns), max(from_ns, to_ns)
        self.held: dict[Hashable, dict[int, ChainLink]] = {}
        self.others: dict[tuple[Hashable, int], list[ChainLink]] = {}
        self.digests = b""

    def distance_ns(self, time_ns: int) -> int:
        return max(0, self.from_ns - time_ns, time_ns - self.to_ns)

    def add(self, link: ChainLink) -> bool | None:
        """True if the sample is new, False if it is there already; None if it contradicts one that is."""
        if self.digests:
            at = (link.sequence - self.first) * DIGEST_BYTES
            return False if self.digests[at : at + DIGEST_BYTES] == _digest(link.payload) else None
        held = self.held.setdefault(link.run, {})
        before = held.setdefault(link.sequence, link)
        if before is not link:
            if before.payload == link.payload:
                return False
            others = self.others.setdefault((link.run, link.sequence), [])
            if len(others) < ALTERNATIVES_MAX:
                others.append(link)
            return None
        if len(held) == self.end - self.first:
            self._prove(link.run)
        return True

    def _prove(self, run: Hashable) -> None:
        held = self.held[run]
        links = [held[place] for place in range(self.first, self.end)]
        for tried in self._readings(run, links):
            head = self.start
            for link in tried:
                head = next_link(head, link.payload)
            if head == self.head:
                self.digests = b"".join(_digest(link.payload) for link in tried)
                for link in tried:
                    self._take(link, True)  # noqa: FBT003 - see Take
                self.keep(run)
                self.held, self.others = {}, {}
                return

    def _readings(self, run: Hashable, links: list[ChainLink]) -> Iterator[list[ChainLink]]:
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

    def keep(self, run: Hashable) -> None:
        """Give the samples of other runs away, as unproven."""
        self._give(other for of, other in self.held.items() if of != run)
        self.held = {run: self.held[run]} if run in self.held else {}

    def end_unproven(self) -> None:
        """Give away all that is held: no head proves it."""
        self._give(self.held.values())

    def _give(self, held: Iterable[dict[int, ChainLink]]) -> None:
        for links in held:
            for link in links.values():
                self._take(link, False)  # noqa: FBT003 - see Take

    def best(self) -> dict[int, ChainLink]:
        """The samples of the run of which most are there."""
        return max(self.held.values(), key=len, default={})


def _times(held: dict[int, ChainLink]) -> Iterator[int]:
    return (link.time_ns for link in held.values())


def _digest(payload: bytes) -> bytes:
    return hashlib.sha256(payload).digest()[:DIGEST_BYTES]


class SubjectChain:
    """The chain of one subject in one run.

    Attributes:
        counts: the results of its samples; whole after ``close``.
        findings: the faults, likewise.
        proven_run: the run of those samples that were proven first; None before.
        strangers: the first and the last time of samples that are of no run with heads, though they were given the
            place of this one's; whole after ``close``.
    """

    def __init__(self, boot: bytes, subject: str, heads: Sequence[ChainHeads], take: Take) -> None:
        """With all heads of the run, by their sequence."""
        self.subject = subject
        self._take = take
        self._begins_empty = False
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
                segment = _Segment(count, said.count, head, said.head, begins_ns, one.time_ns, take)
                self.segments.append(segment)
            self._begins_empty |= said.count == 0
            count, head, begins_ns = said.count, said.head, one.time_ns
        self.end = count
        self._first_ns, self.last_ns = heads[0].time_ns, heads[-1].time_ns
        self._firsts = [segment.first for segment in self.segments]
        self._tails: dict[Hashable, dict[int, int]] = {}
        self._times: dict[Hashable, tuple[int, int]] = {}
        self.proven_run: Hashable = None
        self.strangers: dict[Hashable, tuple[int, int]] = {}

    def distance_ns(self, link: ChainLink) -> int:
        """The time between a sample and the heads that should have it between them; 0 if it fits."""
        if link.sequence >= self.end:
            return max(0, self.last_ns - link.time_ns, link.time_ns - self.last_ns - TAIL_NS)
        return self._segment(link.sequence).distance_ns(link.time_ns)

    def add(self, link: ChainLink) -> None:
        """Put a sample into its place."""
        first_ns, last_ns = self._times.get(link.run, (link.time_ns, link.time_ns))
        self._times[link.run] = min(first_ns, link.time_ns), max(last_ns, link.time_ns)
        if link.sequence >= self.end:
            tail = self._tails.setdefault(link.run, {})
            if link.sequence in tail:
                self.counts.repeated += 1
                return
            tail[link.sequence] = link.time_ns
            self._take(link, False)  # noqa: FBT003 - see Take
            return
        segment = self._segment(link.sequence)
        is_new = segment.add(link)
        if segment.digests and self.proven_run is None:
            self.proven_run = link.run
        if is_new is None:
            self.contradictions.setdefault(link.sequence, link.time_ns)
        elif not is_new:
            self.counts.repeated += 1

    def close(self, run: Hashable, *, may_begin_later: bool) -> None:
        """Nothing more comes: judge.

        Args:
            run: the run whose samples were proven, in this subject or in another; None if none was.
            may_begin_later: the logs may begin in the middle of this run; else it is whole from its first sample.
        """
        run = self.proven_run if run is None else run
        if run is not None:
            self.strangers = {other: times for other, times in self._times.items() if other != run}
            for segment in self.segments:
                segment.keep(run)
        tails = [tail for of, tail in self._tails.items() if run in (None, of)]
        self.counts.after = sum(map(len, tails))
        before, hanging, has_begun = 0, [], False
        for number, segment in enumerate(self.segments):
            segment.judge_again()
            if segment.digests:
                self.counts.proven += segment.end - segment.first
                if self.counts.from_ns is None:
                    self.counts.from_ns = segment.from_ns if segment.first else 0
            elif may_begin_later and number == before and not has_begun and self._is_before(segment):
                # The log begins in mid-run: what is there hangs on nothing. Two heads that follow each other later
                # say what lies between them, whatever the log holds of it.
                held = segment.best()
                absent = segment.end - segment.first - len(held)
                has_begun = bool(self._near(segment))
                self.counts.before += len(held)
                self.counts.absent += absent
                if segment.first:
                    self._judge_late(segment, absent)
                since_ns, until_ns = self._first_ns - BARE_NS, segment.to_ns + BARE_NS
                hanging += [at for at in _times(held) if not since_ns <= at <= until_ns]
                before = number + 1
        self._judge_broken(self.segments[before:])
        self._judge_bare("before the heads that would prove them", hanging)
        if self.contradictions:
            what = f"{self.subject}: samples of one sequence that contradict each other"
            first_ns = min(self.contradictions.values())
            self.findings.append(ProofFinding(ProofFault.CHANGED, what, first_ns, len(self.contradictions)))
        self._judge_tail([time_ns for tail in tails for time_ns in tail.values()])
        for segment in self.segments:
            segment.end_unproven()

    def _judge_tail(self, times_ns: Sequence[int]) -> None:
        tail_ns = max(times_ns, default=0)
        if tail_ns > self.last_ns + TAIL_NS:
            seconds = (tail_ns - self.last_ns) / 1e9
            what = f"heads of {self.subject}: samples go on for {seconds:.0f} s after the last one"
            self.findings.append(ProofFinding(ProofFault.MISSING, what, self.last_ns, self.counts.after))
        else:
            far = [at for at in times_ns if abs(at - self.last_ns) > BARE_NS]
            self._judge_bare("after the last head, which proves none of them", far)

    def _judge_late(self, segment: _Segment, absent: int) -> None:
        """Find samples that are absent between the first heads: nothing tells why the logs begin behind them."""
        what = f"{self.subject}: samples behind the first head, before those with which the logs begin"
        found = ProofFinding(ProofFault.UNPROVEN, what, segment.from_ns, absent, segment.to_ns)
        self.findings.append(found)

    def _judge_bare(self, where: str, times_ns: Sequence[int]) -> None:
        """Find what nothing proves, and what is not of the moment before the first head or after the last."""
        if times_ns:
            what = f"{self.subject}: samples {where}"
            found = ProofFinding(ProofFault.UNPROVEN, what, min(times_ns), len(times_ns), max(times_ns))
            self.findings.append(found)

    def _is_before(self, segment: _Segment) -> bool:
        """Return True if the log may begin in a segment: with a sample within it, and without a gap from there."""
        if self._begins_empty:
            # The logs hold a head of before the first sample.
            return False
        if segment.first and segment.from_ns >= self._first_ns + LINKING_NS:
            return False
        near = self._near(segment)
        return segment.first not in segment.best() and len(near) == segment.end - min(near, default=segment.end)

    def _near(self, segment: _Segment) -> list[int]:
        """Return the places held of a segment from right before the first head on: there may be no gap in them.

        What came late, from a robot's memory, may lie in a cut without its neighbours: it hangs on nothing, and is
        told as such.
        """
        since_ns = self._first_ns - BARE_NS
        return [place for place, link in segment.best().items() if segment.first or link.time_ns >= since_ns]

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
        heads: their number.
        first_ns, last_ns: times of the first and the last, by the robot's clock, nanoseconds since 1970.
        series: distinguishes the samples of this run from others', as far as something of it is proven.
        former: the last heads of the run before that the robot knew; None if it knew of none.
    """

    def __init__(self, boot: bytes, heads: Sequence[ChainHeads], take: Take) -> None:
        """With the heads of the run, by their sequence; none twice."""
        self.boot = boot
        self.heads = len(heads)
        self._first, self._last = heads[0].sequence, heads[-1].sequence
        self.first_ns, self.last_ns = heads[0].time_ns, heads[-1].time_ns
        self.series: dict[str, Hashable] = {}
        self.digests = {one.sequence: _heads_digest(one) for one in heads}
        formers = {one.former for one in heads}
        self.contradicts_itself = len(formers) > 1
        self.former = FormerHeads.read(heads[0].former)
        self.subjects = {subject: SubjectChain(boot, subject, heads, take) for subject in CHAINED}

    def close(self, *, may_begin_later: bool) -> list[ProofFinding]:
        """Nothing more comes. Returns what is wrong.

        Args:
            may_begin_later: the logs may begin in the middle of this run.
        """
        found = []
        missing = self._last + 1 - (self._first if may_begin_later else 0) - self.heads
        if missing:
            found.append(ProofFinding(ProofFault.MISSING, "chain heads", self.first_ns, missing))
        if self.contradicts_itself:
            what = "the chain heads of a run name more than one run before it"
            found.append(ProofFinding(ProofFault.CHANGED, what, self.first_ns))
        for subject, chain in self.subjects.items():
            chain.close(self.series.get(_SERIES[subject]), may_begin_later=may_begin_later)
            found += chain.findings
        return found


class RobotChains:
    """The chains of all runs of a robot.

    Attributes:
        runs: by the time of their first heads.
    """

    def __init__(self, heads: Iterable[ChainHeads], take: Take) -> None:
        """With all heads whose signature holds, none twice."""
        self._take = take
        by_boot: dict[bytes, list[ChainHeads]] = {}
        for one in heads:
            by_boot.setdefault(one.boot, []).append(one)
        runs = (
            RunChains(boot, sorted(of_boot, key=lambda one: one.sequence), take)
            for boot, of_boot in by_boot.items()
        )
        self.runs = sorted(runs, key=lambda run: run.first_ns)

    def close(self) -> list[ProofFinding]:
        """Nothing more comes. Returns what is wrong."""
        first = _first_of(self.runs)
        found = [one for run in self.runs for one in run.close(may_begin_later=run is first)]
        return [*found, *_missing_runs(self.runs)]

    def add(self, subject: str, link: ChainLink) -> bool:
        """Put a sample into the chain of its run. False if there is none."""
        series = _SERIES[subject]
        its = [run for run in self.runs if run.series.get(series) == link.run]
        open_ones = its or [run for run in self.runs if series not in run.series]
        if not open_ones:
            self._take(link, False)  # noqa: FBT003 - see Take
            return False
        run = min(open_ones, key=lambda one: one.subjects[subject].distance_ns(link))
        chain = run.subjects[subject]
        if not its and chain.distance_ns(link) > FAR_NS:
            self._take(link, False)  # noqa: FBT003 - see Take
            return False
        chain.add(link)
        if chain.proven_run is not None:
            run.series.setdefault(series, chain.proven_run)
        return True


def _first_of(runs: Sequence[RunChains]) -> RunChains | None:
    """The run with which the logs begin: the first one whose predecessor is not in them."""
    known = {run.boot for run in runs}
    return next((run for run in runs if run.former is None or run.former.boot not in known), None)


def _missing_runs(runs: Sequence[RunChains]) -> Iterator[ProofFinding]:
    """Find the runs that others name, or that nobody could name.

    The logs begin with one run, whatever was before it. Each other run has to name one that is there.

    Args:
        runs: by the time of their first heads.
    """
    known = {run.boot: run for run in runs}
    first = _first_of(runs)
    for number, run in enumerate(runs):
        before = runs[number - 1].boot.hex() if number else ""
        named = None if run.former is None else known.get(run.former.boot)
        if run.former is not None and named is not None:
            yield from _cut_off(named, run.former)
        elif run is first:
            continue
        elif run.former is None:
            what = "a run is not linked to the one before it: whether one is missing between them, nothing tells"
            yield ProofFinding(ProofFault.UNPROVEN, what, run.first_ns)
        else:
            between = f"between {before} and {run.boot.hex()}" if before else f"before {run.boot.hex()}"
            what = f"a run is missing {between}: {run.former.boot.hex()}, or more"
            yield ProofFinding(ProofFault.MISSING, what, run.first_ns)


def _cut_off(run: RunChains, kept: FormerHeads) -> Iterator[ProofFinding]:
    """Compare the last heads of a run with those that the next run knew; a note may be a minute old."""
    last = max(run.digests)
    if kept.sequence > last:
        what = f"chain heads at the end of run {run.boot.hex()}"
        yield ProofFinding(ProofFault.MISSING, what, run.last_ns, kept.sequence - last)
    elif run.digests.get(kept.sequence, kept.digest) != kept.digest:
        what = f"the chain heads of run {run.boot.hex()} are not those that the next run names"
        yield ProofFinding(ProofFault.CHANGED, what, run.last_ns)


def signed_text(one: ChainHeads) -> bytes | None:
    """The text under the signature of heads; None if they name a subject twice: one of the two is not in it."""
    said = {entry.subject: (entry.count, entry.head) for entry in one.heads}
    if len(said) < len(one.heads):
        return None
    return heads_text(one.boot, one.time_ns, one.sequence, said, one.former)


def _heads_digest(one: ChainHeads) -> bytes:
    return FormerHeads.of(one.boot, one.sequence, signed_text(one) or b"").digest


FAR_NS: Final = 60_000_000_000
"""A sample so far from all heads is of a run that has none in the logs."""

_SERIES: Final = {subject: "run" if subject == "journal" else "tick" for subject in CHAINED}
"""The number by which a subject's samples show their run: see ``ChainLink.run``."""
