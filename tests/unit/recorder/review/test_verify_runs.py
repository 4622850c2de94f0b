"""The proof that no whole run of a gateway is missing between others, and that none was put in."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from itertools import pairwise, permutations
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from recorder.reading.faults import Faults
from recorder.reading.logs import find_logs
from recorder.review.verify import RobotProofReport, verify_logs
from recorder.review.verifying.findings import ProofFault
from schemas.authority.chain import FORMER_BYTES, FormerHeads, heads_text
from schemas.authority.trust import fits
from schemas.decisions import ChainHeads, Decision, Journal, SafetyEvent, SignedStatement
from schemas.messages import Message
from tests.support.authority import NOW_S, Fleet, Party, S
from tests.support.logs import saved
from tests.support.messages import ROBOT
from tests.support.signed_run import CHAINED_KINDS, SignedRun, driven, log_of, of, replaced, without

FLEET = Fleet()
ROBOT_PARTY = Party(ROBOT)
RUN_S = 4


def runs_of(
    count: int, robot: Party = ROBOT_PARTY, *, pause_s: int = 60, is_linked: bool = True
) -> list[SignedRun]:
    """Runs one after the other, each of which names the one before; nobody drives."""
    runs: list[SignedRun] = []
    for number in range(count):
        former = runs[-1].signer.last_heads if runs and is_linked else b""
        at_s = NOW_S + number * (RUN_S + pause_s)
        run = SignedRun(FLEET, robot, boot=f"boot no{number}".encode(), at_s=at_s, former=former)
        run.seconds(RUN_S)
        runs.append(run)
    return runs


RUNS = runs_of(4)


def verified(*logs: Sequence[Message]) -> RobotProofReport:
    """The result for logs of these samples, in files of their own."""
    with TemporaryDirectory() as name:
        paths = [saved(Path(name) / f"log-{number}.mcap", log_of(one)) for number, one in enumerate(logs)]
        faults = Faults()
        (report,) = verify_logs(find_logs(paths, faults), faults, [FLEET.trust])
        assert not faults, faults.told
        return report


def found(report: RobotProofReport) -> list[tuple[ProofFault, str]]:
    """The faults with their words."""
    return [(one.fault, one.what) for one in report.findings]


@pytest.mark.parametrize("is_one_log", [True, False])
def test_runs_that_name_each_other_hold(is_one_log: bool) -> None:  # noqa: FBT001 - a parameter
    """In one log, or in one each."""
    logs = [[one for run in RUNS for one in run.samples]] if is_one_log else [run.samples for run in RUNS]
    report = verified(*logs)
    assert report.is_proven, report.findings
    assert [run.former for run in report.runs] == ["", *(run.boot for run in report.runs[:-1])]


@pytest.mark.parametrize("dropped", [(1,), (2,), (1, 2)])
def test_a_run_that_is_missing_between_others_is_found(dropped: tuple[int, ...]) -> None:
    """However many: the next one names its predecessor."""
    kept = [run for number, run in enumerate(RUNS) if number not in dropped]
    (finding,) = found(verified(*(run.samples for run in kept)))
    before, after = RUNS[dropped[0] - 1], RUNS[dropped[-1] + 1]
    named = RUNS[dropped[-1]].signer.boot.hex()
    expected = f"between {before.signer.boot.hex()} and {after.signer.boot.hex()}: {named}"
    assert finding[0] is ProofFault.MISSING
    assert expected in finding[1]


def test_logs_may_begin_and_end_with_any_run() -> None:
    """Nothing says how far back they have to go, nor whether there was one more."""
    for first in range(len(RUNS)):
        for last in range(first + 1, len(RUNS) + 1):
            assert verified(*(run.samples for run in RUNS[first:last])).is_proven


@pytest.mark.parametrize("head", [0, 1, RUN_S // 2, RUN_S])
def test_the_first_run_alone_may_begin_in_its_middle(head: int) -> None:
    """Where a run before it is in the logs, all of it was to be there."""
    part = _from_head(RUNS[1], head)
    assert verified(part, RUNS[2].samples).is_proven
    for others in ([], [RUNS[2].samples]):
        report = verified(RUNS[0].samples, part, *others)
        assert report.is_proven == (head == 0)
        assert {fault for fault, _ in found(report)} == (set() if head == 0 else {ProofFault.MISSING})


@pytest.mark.parametrize("kind", CHAINED_KINDS)
def test_a_later_run_lacks_no_first_sample(kind: type[Message]) -> None:
    """Although all its heads are there."""
    first = of(RUNS[1].samples, kind)[0]
    report = verified(RUNS[0].samples, without(RUNS[1].samples, first))
    assert {fault for fault, _ in found(report)} == {ProofFault.MISSING}


def _from_head(run: SignedRun, number: int) -> list[Message]:
    """The statements of a run, and the rest of it from one of its heads on."""
    begin = of(run.samples, ChainHeads)[number]
    return [one for place, one in enumerate(run.samples) if place >= begin or isinstance(one, SignedStatement)]


@given(
    begin=st.integers(0, 40),
    end=st.integers(0, 40),
    cuts=st.lists(st.integers(1, 400), max_size=4).map(sorted),
    copied=st.tuples(st.integers(0, 400), st.integers(0, 60)),
)
def test_honest_logs_of_several_runs_hold_however_they_are_cut(
    begin: int, end: int, cuts: list[int], copied: tuple[int, int]
) -> None:
    """From anywhere in the first run to anywhere in the last, in several files, an incident beside them."""
    samples = [one for run in RUNS for one in run.samples]
    statements = [one for one in samples[:begin] if isinstance(one, SignedStatement)]
    kept = [*statements, *samples[begin : len(samples) - end]]
    places = [0, *(cut for cut in cuts if cut < len(kept)), len(kept)]
    files = [kept[first:last] for first, last in pairwise(places) if first < last]
    incident = kept[copied[0] : sum(copied)]
    report = verified(*files, *([incident] if incident else []))
    assert report.is_proven, report.findings


@given(since=st.integers(0, 200), count=st.integers(1, 200), gone=st.integers(0, 200), heads=st.integers(0, 12))
@settings(max_examples=2 * settings().max_examples)
def test_no_decision_that_was_made_up_makes_a_proven_holder(since: int, count: int, gone: int, heads: int) -> None:
    """Whatever is left out of the logs before it, and however many heads."""
    samples = [one for run in RUNS[:2] for one in run.samples]
    first_head = [one for one in samples if isinstance(one, ChainHeads)][heads - 2 :][:1] if heads > 1 else []
    begin_ns = first_head[0].time_ns if first_head else 0
    forged: list[Message] = []
    for place, one in enumerate(samples):
        if place < gone and not isinstance(one, SignedStatement):
            continue
        if isinstance(one, ChainHeads | Journal | SafetyEvent) and one.time_ns < begin_ns:
            continue
        is_his = isinstance(one, Decision) and since <= place < since + count
        forged.append(msgspec.structs.replace(one, operator="bob") if is_his else one)
    report = verified(forged)
    his = [one for one in report.holders if one.operator == "bob"]
    assert not any(one.is_proven for one in his)
    if report.is_proven:
        assert all(one.to_ns - one.from_ns <= 2 * S for one in his)


DRIVEN, _ = driven(FLEET, 8)
CHANGES: dict[type[Message], dict[str, Any]] = {
    Journal: {"inputs": b"\x90"},
    Decision: {"operator": "bob"},
    SafetyEvent: {"text": "otherwise"},
}


@given(begin=st.integers(0, 100), place=st.integers(0, 400), is_left_out=st.booleans(), more=st.integers(0, 3))
@settings(max_examples=3 * settings().max_examples)
def test_between_two_heads_of_a_log_nothing_is_left_out_or_changed(
    begin: int,
    place: int,
    is_left_out: bool,  # noqa: FBT001 - a parameter
    more: int,
) -> None:
    """Wherever the log begins, whichever sample it is, and if more of them before or behind it are missing."""
    statements = [one for one in DRIVEN.samples[:begin] if isinstance(one, SignedStatement)]
    samples = [*statements, *DRIVEN.samples[begin:]]
    heads = of(samples, ChainHeads)
    between = [at for at in range(heads[0], heads[-1]) if type(samples[at]) in CHAINED_KINDS]
    first = place % len(between)
    if is_left_out:
        changed = without(samples, *between[first : first + 1 + more])
    else:
        at = between[first]
        changed = replaced(samples, at, **CHANGES[type(samples[at])])
    assert verified(samples).is_proven
    report = verified(changed)
    assert not report.is_proven
    assert report.findings


@pytest.mark.parametrize("order", list(permutations(range(3))))
def test_a_clock_that_was_set_does_not_make_runs_missing(order: tuple[int, ...]) -> None:
    """They are linked by what they name, and not by their times."""
    former, runs = b"", []
    for number, place in enumerate(order):
        run = SignedRun(
            FLEET, ROBOT_PARTY, boot=f"boot no{number}".encode(), at_s=NOW_S + 100 * place, former=former
        )
        run.seconds(2)
        former = run.signer.last_heads
        runs.append(run)
    assert verified(*(run.samples for run in runs)).is_proven


def test_runs_of_before_they_were_linked_cannot_be_told_to_be_all() -> None:
    """They are read as they were, and nothing is said to be wrong with them."""
    report = verified(*(run.samples for run in runs_of(2, is_linked=False)))
    (finding,) = found(report)
    assert finding[0] is ProofFault.UNPROVEN
    assert "not linked" in finding[1]
    assert not report.is_broken
    assert all(count.broken == count.missing == 0 for run in report.runs for count in run.subjects.values())


def test_the_end_of_a_run_that_was_cut_off_is_found() -> None:
    """The next one names its last heads."""
    heads = of(RUNS[0].samples, ChainHeads)
    (finding,) = found(verified(RUNS[0].samples[: heads[-2]], RUNS[1].samples))
    assert finding == (ProofFault.MISSING, f"chain heads at the end of run {RUNS[0].signer.boot.hex()}")


def test_a_note_of_before_the_last_heads_is_none_to_complain_of() -> None:
    """A gateway that was killed has saved its heads up to a minute before."""
    first = SignedRun(FLEET, ROBOT_PARTY, boot=b"boot no1")
    first.seconds(2)
    kept = first.signer.last_heads
    first.seconds(3)
    second = SignedRun(FLEET, ROBOT_PARTY, boot=b"boot no2", at_s=NOW_S + 100, former=kept)
    second.seconds(2)
    assert verified(first.samples, second.samples).is_proven


def test_a_run_of_the_same_number_in_the_place_of_another_is_found() -> None:
    """The digest is of what the robot signed."""
    other = SignedRun(FLEET, ROBOT_PARTY, boot=RUNS[0].signer.boot, at_s=NOW_S - 1)
    other.seconds(RUN_S)
    assert ProofFault.CHANGED in {fault for fault, _ in found(verified(other.samples, RUNS[1].samples))}


@pytest.mark.parametrize("kept", [1, 2, RUN_S])
def test_heads_are_not_numbered_anew(kept: int) -> None:
    """The number of each is under its signature: an end that was cut off is not hidden by it."""
    heads = of(RUNS[0].samples, ChainHeads)
    samples: Sequence[Message] = RUNS[0].samples[: heads[kept - 1] + 1]
    last = len(heads) - 1
    for number in range(kept):
        samples = replaced(samples, heads[number], sequence=last - kept + 1 + number)
    report = verified(samples, RUNS[1].samples)
    assert ProofFault.WRONGLY_SIGNED in {one.fault for one in report.findings}


@pytest.mark.parametrize("former", [b"", bytes(FORMER_BYTES), RUNS[2].signer.last_heads])
def test_a_link_is_signed(former: bytes) -> None:
    """Nobody takes it away or puts another in its place."""
    samples: Sequence[Message] = RUNS[1].samples
    for place in of(samples, ChainHeads):
        samples = replaced(samples, place, former=former)
    report = verified(RUNS[0].samples, samples)
    assert ProofFault.WRONGLY_SIGNED in {one.fault for one in report.findings}


def test_what_names_a_run_is_no_subject() -> None:
    """The text of linked heads is never that of heads of one more subject, nor the other way."""
    head = RUNS[1].samples[of(RUNS[1].samples, ChainHeads)[-1]]
    assert isinstance(head, ChainHeads)
    said = {one.subject: (one.count, one.head) for one in head.heads}
    text = partial(heads_text, head.boot, head.time_ns, head.sequence)
    assert fits(ROBOT_PARTY.key, head.signature, text(said, head.former))
    named = FormerHeads.read(head.former)
    assert named is not None
    assert named.text() == head.former
    for subject in ("", "former", named.boot.decode("latin-1")):
        forged = {subject: (named.sequence, named.digest)} | said
        assert not fits(ROBOT_PARTY.key, head.signature, text(forged))


# Samples of a run without heads, beside one that has them.


def _unsigned(at_s: int, boot: bytes = b"no heads") -> list[Message]:
    """The samples of a gateway in open mode."""
    run = SignedRun(FLEET, ROBOT_PARTY, boot=boot, at_s=at_s)
    run.seconds(2)
    return [one for one in run.samples if type(one) in CHAINED_KINDS]


@pytest.mark.parametrize("after_s", [-5, 0, 1, RUN_S + 1])
def test_a_run_without_heads_is_not_counted_as_part_of_one_beside_it(after_s: int) -> None:
    """Before it, among its samples or behind it, and whether it comes first or last in the log."""
    unsigned = _unsigned(NOW_S + after_s)
    for samples in ([*unsigned, *RUNS[0].samples], [*RUNS[0].samples, *unsigned]):
        report = verified(samples)
        assert not report.is_proven
        assert report.unsigned_runs == 1
        assert any("a run without chain heads" in words for _, words in found(report))
        proven = sum(count.proven for count in report.runs[0].subjects.values())
        assert proven == sum(type(one) in CHAINED_KINDS for one in RUNS[0].samples)
        assert sum(count.after + count.broken for count in report.runs[0].subjects.values()) == 0


def test_a_decision_of_nobodys_run_is_not_one_of_the_run_beside_it() -> None:
    """Put in before the true ones, in their places: it proves no driver."""
    true = RUNS[0].samples
    forged = [one for one in _unsigned(NOW_S) if isinstance(one, Decision)]
    report = verified([*true[:1], *forged, *true[1:]])
    assert not report.is_proven
    assert ProofFault.UNPROVEN in {one.fault for one in report.findings}
    assert sorted((one.drives, one.is_proven) for one in report.holders) == [(2, False), (RUN_S, True)]
