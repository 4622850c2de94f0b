"""What a log lacks, made again out of the journal that it holds."""

import re
from collections.abc import Callable, Collection, Iterable, Iterator
from functools import cache
from operator import itemgetter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO

import msgspec
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from gateway import core
from gateway.journal import inputs_of
from gateway.rerun.rerun import rerun
from gateway.telemetry.sample import Sample
from recorder.cli.review.why import chain_in_words
from recorder.reading.faults import Faults
from recorder.reading.log_file import LogFile
from recorder.reading.logs import find_logs
from recorder.reading.rows import Selection, read_rows
from recorder.reading.survey import survey
from recorder.reading.topics import RECONSTRUCTED_CHUNK
from recorder.review.catalog.rows import summarize
from recorder.review.check import check_log
from recorder.review.merge import merge
from recorder.review.report.findings import Why
from recorder.review.report.page import page
from recorder.review.report.survey import read_report
from recorder.review.report.words import moment_words
from recorder.review.rerun import holes as module_holes
from recorder.review.rerun import reconstruction
from recorder.review.rerun.player import rerun_logs
from recorder.review.rerun.reconstruction import FROM_JOURNAL, MADE_AGAIN, OTHERWISE, HoleFilling, filled
from recorder.review.timeline.entries import EntryKind
from recorder.review.timeline.timeline import read_events
from recorder.review.verify import verify_logs
from recorder.review.verifying.findings import ProofFault
from recorder.review.why import explain
from schemas import codec
from schemas.decisions import Decision, Journal, SafetyState
from schemas.exit_codes import CommandError, ExitCode
from schemas.journal import Kind
from schemas.settings import Settings
from schemas.subjects import BY_NAME
from tests.support.authority import Fleet
from tests.support.commands import review
from tests.support.logs import channel_of, encoded, mcap_log, saved
from tests.support.messages import MS, SECOND, key_of
from tests.support.rigs.recorded import RecordedRig
from tests.support.signed_run import driven, of, without
from tests.support.signed_run import log_of as log_of_samples

Messages = set[tuple[str, int, bytes]]
"""Topic, publish time and data."""


BACK_NS = (4 * SECOND, 75 * SECOND, 600 * SECOND)
"""So far before a hole a checkpoint is looked for: first in less than in the product, for a short drive."""

QUIET_S = 5.0
"""So long a checkpoint has been there that the journal need not be read from the run's beginning."""


@pytest.fixture(autouse=True)
def _not_far_back(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reconstruction, "BACK_NS", BACK_NS)


@cache
def drive() -> RecordedRig:
    """A robot that is driven, stopped by the deadman, and driven once more; a checkpoint is taken each second."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(core, "CHECKPOINT_PERIOD_NS", SECOND)
        rig, operator = RecordedRig.ready()
        rig.run(QUIET_S)
        for speed_mps in (0.6, -0.4):
            operator.take_lease()
            operator.engage()
            operator.drive(speed_mps, 5.0, 1.5)
            rig.rest_after(0.5)
        rig.run(1)
        return rig


def log_of(
    path: Path, lost: tuple[float, float] = (0, 0), subjects: Collection[str] = MADE_AGAIN
) -> list[LogFile]:
    """The drive's log, without what was said of these subjects from one second of it to another."""
    rig = RecordedRig()
    first_ns = drive().recorded[0][0]
    from_ns, to_ns = (first_ns + round(one * SECOND) for one in lost)
    rig.settings = drive().settings
    rig.recorded = [
        (at_ns, one)
        for at_ns, one in drive().recorded
        if one.subject not in subjects or not from_ns <= at_ns < to_ns
    ]
    path.write_bytes(rig.log())
    return find_logs([path], Faults())


@cache
def whole_log() -> bytes:
    """The drive's log."""
    return drive().log()


def messages(logs: Iterable[LogFile], *, is_made: bool = False) -> Messages:
    """What the logs hold of a gateway; what was made again alone, if so wanted."""
    faults = Faults()
    selection = Selection(lambda topic: topic.subject in MADE_AGAIN, is_filled=is_made)
    rows = list(read_rows(list(logs), selection, faults))
    assert not faults, faults.told
    return {(row.topic.name, row.publish_ns, row.data) for row in rows if bool(row.topic.reconstructed) == is_made}


class Holed:
    """The drive's log, whole, and without some of a time."""

    def __init__(self, directory: str, lost: tuple[float, float], subjects: Collection[str] = MADE_AGAIN) -> None:
        self.faults = Faults()
        self.whole = find_logs([saved(Path(directory) / "whole.mcap", whole_log())], Faults())
        self.logs = log_of(Path(directory) / "holed.mcap", lost, subjects)
        self.filled = filled(self.logs, self.faults)


times = st.tuples(st.floats(QUIET_S, QUIET_S + 4), st.floats(0.7, 3)).map(lambda one: (one[0], one[0] + one[1]))
lost_subjects = st.sets(st.sampled_from(sorted(MADE_AGAIN))).map(lambda some: {*some, "safety/state"})
bounded = settings(max_examples=settings().max_examples // 5, phases=(Phase.explicit, Phase.reuse, Phase.generate))


@bounded
@given(lost=times, subjects=lost_subjects)
def test_what_a_log_lacks_comes_out_of_its_journal_byte_for_byte(
    lost: tuple[float, float], subjects: set[str]
) -> None:
    """States, feedback, raw frames, decisions and events of any time: all that was lost, and nothing else."""
    with TemporaryDirectory() as directory:
        log = Holed(directory, lost, subjects)
        whole, held = messages(log.whole), messages(log.logs)
        assert whole > held
        assert messages(log.filled, is_made=True) == whole - held
        assert not log.faults


@bounded
@given(lost=times)
def test_the_events_of_a_log_with_a_hole_are_those_of_the_whole_log(lost: tuple[float, float]) -> None:
    """But for the mark of those that nobody recorded, and an entry that says so."""
    with TemporaryDirectory() as directory:
        log = Holed(directory, lost)
        told = list(read_events(log.filled, Selection(), log.faults))
        expected = list(read_events(log.whole, Selection(), log.faults))
        holes = [one for one in told if one.kind is EntryKind.GAP]
        assert [plain(one) for one in told if one.kind is not EntryKind.GAP] == expected
        assert len(holes) == 1
        assert "no state of the arbiter was recorded for" in holes[0].text
        for one in told:
            assert bool(one.reconstructed) == (holes[0].time_ns < one.time_ns < holes[0].last_ns or one in holes)


@bounded
@given(lost=times, at=st.floats(QUIET_S, QUIET_S + 8))
def test_a_log_with_a_hole_tells_why_as_the_whole_one_does(lost: tuple[float, float], at: float) -> None:
    """But for the marks: what nobody recorded is said, and each link that rests on it is marked."""
    with TemporaryDirectory() as directory:
        log = Holed(directory, lost)
        at_ns = drive().recorded[0][0] + round(at * SECOND)
        [told, expected] = [
            explain("cruiser-1", logs, survey(of, log.faults), at_ns, log.faults)
            for logs, of in ((log.filled, log.logs), (log.whole, log.whole))
        ]
        assert not log.faults
        chain = [plain(link) for link in told.chain if "not all was recorded" not in link.text]
        assert msgspec.structs.replace(plain(told), chain=chain) == expected


def plain(one: Any) -> Any:  # noqa: ANN401 - any structure with a mark
    """The same without the mark."""
    return msgspec.structs.replace(one, reconstructed="")


def test_what_rests_on_a_hole_is_marked(tmp_path: Path) -> None:
    """A stop of which nothing was recorded but the journal: the answer, its links and the report say so."""
    lost = (QUIET_S + 1, QUIET_S + 4)
    log = Holed(str(tmp_path), lost)
    told = explain("cruiser-1", log.filled, survey(log.logs, log.faults), None, log.faults)
    stop = next(one for one in read_events(log.filled, Selection(), log.faults, kinds=[EntryKind.STOP]))
    assert stop.reconstructed == FROM_JOURNAL
    assert not told.reconstructed, "the last stop was recorded"
    told = explain("cruiser-1", log.filled, survey(log.logs, log.faults), stop.time_ns, log.faults)
    assert told.reconstructed == FROM_JOURNAL
    assert {one.reconstructed for one in told.chain if one.time_ns == stop.time_ns} == {FROM_JOURNAL}
    report = read_report(log.filled, Selection(), log.faults)
    [robot] = report.robots
    [moment] = [one for one in robot.charts.moments if one.is_stop and one.time_ns == stop.time_ns]
    mark = "[reconstructed from the journal]"
    assert mark in moment_words(moment)
    assert len(robot.summary.silences) == 1
    whys = {(robot.summary.key, stop.time_ns): Why(told.headline, list(chain_in_words(told)))}
    [summary] = re.findall(r"<summary>([^<]*no acceptable drive command[^<]*)</summary>", page(report, "", whys))
    assert summary.endswith(mark)


def test_a_log_without_a_hole_is_read_as_it_is(tmp_path: Path) -> None:
    """Nothing is looked for in it, nor is anything run again."""
    logs = log_of(tmp_path / "whole.mcap")
    seen: list[int] = []
    assert filled(logs, Faults(), seen.append) == logs
    assert not seen


def test_a_hole_is_filled_when_somebody_looks_there(tmp_path: Path) -> None:
    """What is asked of another time does not run a journal again."""
    log = Holed(str(tmp_path), (QUIET_S + 1, QUIET_S + 3))
    [hole] = [one for one in log.filled if one.is_reconstructed]
    before = Selection(to_ns=hole.start_ns - SECOND, is_filled=True)
    assert len(list(read_rows(log.filled, before, log.faults))) > 100
    assert isinstance(hole.stored, HoleFilling)
    assert not hole.stored.is_made
    assert messages(log.filled, is_made=True)
    assert hole.stored.is_made


def test_where_the_journal_has_a_hole_too_the_log_does_not_tell(tmp_path: Path) -> None:
    """Nothing is made up: what could not be made again is missing as before."""
    log = Holed(str(tmp_path), (QUIET_S + 1, QUIET_S + 3), {*MADE_AGAIN, "journal"})
    assert not messages(log.filled, is_made=True)
    expected = list(read_events(log.logs, Selection(), log.faults))
    assert list(read_events(log.filled, Selection(), log.faults)) == expected
    assert any("nothing of the arbiter for" in one.text for one in expected)


def test_an_arbiter_that_decides_otherwise_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What it says beside the hole is not what was recorded there."""

    def other(configuration: Settings, journals: Iterable[Journal]) -> Iterator[Sample]:
        for sample in rerun(configuration, journals):
            if sample.subject == "safety/state":
                state = codec.decode(BY_NAME[sample.subject], sample.payload)
                assert isinstance(state, SafetyState)
                yield Sample(sample.subject, codec.encode(msgspec.structs.replace(state, guarded=False)))
            else:
                yield sample

    monkeypatch.setattr(reconstruction, "installed", lambda _: other)
    log = Holed(str(tmp_path), (QUIET_S + 1, QUIET_S + 3))
    told = list(read_events(log.filled, Selection(), log.faults))
    assert {one.reconstructed for one in told} == {"", OTHERWISE}


def test_a_run_without_its_settings_is_not_made_again(tmp_path: Path) -> None:
    """With others it would be another run."""
    rig = RecordedRig()
    rig.settings = drive().settings
    first_ns = drive().recorded[0][0] + round(QUIET_S * SECOND)
    rig.recorded = [
        (at_ns, one)
        for at_ns, one in drive().recorded
        if one.subject == "journal" or not first_ns < at_ns < first_ns + 2 * SECOND
    ]
    path = tmp_path / "log.mcap"
    path.write_bytes(rig.log(with_info=False))
    assert not messages(filled(find_logs([path], Faults()), Faults()), is_made=True)


def test_a_merged_log_holds_what_was_made_again_apart_from_what_was_recorded(tmp_path: Path) -> None:
    """It answers as the log of which it was made; whoever does not ask for more reads what was recorded."""
    log = Holed(str(tmp_path), (QUIET_S + 1, QUIET_S + 3))
    path = tmp_path / "filled.mcap"
    joined = merge(log.filled, path, log.faults)
    assert joined.sources == [str(tmp_path / "holed.mcap")]
    assert joined.reconstructed == len(messages(log.filled, is_made=True)) > 1000
    again = find_logs([path], log.faults)
    assert messages(again) == messages(log.logs)
    assert messages(again, is_made=True) == messages(log.filled, is_made=True)
    assert filled(again, log.faults) == again, "nothing is missing any more"
    told, expected = (list(read_events(logs, Selection(), log.faults)) for logs in (again, log.filled))
    assert told == expected
    found, expected_of_file = (check_log(one).findings for one in (path, tmp_path / "holed.mcap"))
    assert [(one.what, one.count) for one in found] == [(one.what, one.count) for one in expected_of_file]
    [run], [expected_run] = (list(rerun_logs(logs, log.faults)) for logs in (again, log.logs))
    assert run == expected_run
    assert not log.faults


def test_what_was_made_again_proves_nothing(tmp_path: Path) -> None:
    """A decision that is missing in a signed log stays missing, though a channel beside it has its very bytes."""
    fleet = Fleet()
    run, _ = driven(fleet)
    place = of(run.samples, Decision)[2]
    decision = run.samples[place]
    channel = channel_of(Decision, topic=f"{key_of(Decision)}/{RECONSTRUCTED_CHUNK}")
    made = (1, decision.sequence, decision.time_ns, decision.time_ns, encoded(decision))
    paths = [tmp_path / "log.mcap", tmp_path / "made.mcap"]
    paths[0].write_bytes(log_of_samples(without(run.samples, place)))
    paths[1].write_bytes(mcap_log([channel], [[made]]))
    faults = Faults()
    merge(find_logs(paths, faults), tmp_path / "both.mcap", faults)
    [report] = verify_logs(find_logs([tmp_path / "both.mcap"], faults), faults, [fleet.trust])
    assert {one.fault for one in report.findings} == {ProofFault.MISSING}


def test_a_hole_between_two_logs_is_filled(tmp_path: Path) -> None:
    """A recorder was away for two seconds, and the next one asked for the journal: a second after it came."""
    away_ns, back_ns = (drive().recorded[0][0] + round((QUIET_S + one) * SECOND) for one in (1, 3))
    late = [
        (back_ns + SECOND, one)
        for at_ns, one in drive().recorded
        if away_ns <= at_ns < back_ns and one.subject == "journal"
    ]
    parts = [
        [one for one in drive().recorded if one[0] < away_ns],
        sorted([one for one in drive().recorded if one[0] >= back_ns] + late, key=itemgetter(0)),
    ]
    for number, part in enumerate(parts):
        rig = RecordedRig()
        rig.settings, rig.recorded = drive().settings, part
        (tmp_path / f"{number}.mcap").write_bytes(rig.log())
    faults = Faults()
    logs = find_logs([tmp_path], faults)
    whole = messages(log_of(tmp_path / "whole.mcap"))
    assert messages(filled(logs, faults), is_made=True) == whole - messages(logs)
    assert not faults


def test_the_catalog_has_what_was_made_again(tmp_path: Path) -> None:
    """Moments that nobody recorded are found by their words, which say so."""
    log = Holed(str(tmp_path), (QUIET_S + 1, QUIET_S + 4))
    row = summarize(log.logs[0], "holed.mcap", 0, None)
    expected = summarize(log.whole[0], "whole.mcap", 0, None)
    mark = " [reconstructed from the journal]"
    assert sum(one.text.endswith(mark) for one in row.moments) == 1
    told = {one.text.removesuffix(mark) for one in row.moments if one.kind != EntryKind.GAP.value}
    assert told == {one.text for one in expected.moments}
    assert row.stops == expected.stops
    assert row.distance_m == pytest.approx(expected.distance_m)


@pytest.mark.parametrize("question", ["events", "why"])
def test_a_log_in_a_store_is_filled_as_a_file_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], question: str
) -> None:
    """Its digest leaves out states, which are not taken for missing."""
    Holed(str(tmp_path), (QUIET_S + 1, QUIET_S + 8))
    said = []
    for place in (tmp_path / "holed.mcap", f"file://{tmp_path}/holed.mcap"):
        assert review(question, place, "--json") == ExitCode.OK
        said.append(capsys.readouterr().out)
    assert said[0] == said[1]
    assert '"reconstructed":"from the journal"' in said[0].replace(": ", ":")


def test_a_long_hole_is_filled_part_by_part(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Memory does not grow with it; each part is held against the one before, and none is made twice."""
    for length in ("STRETCH_NS", "BESIDE_NS"):
        monkeypatch.setattr(reconstruction, length, 2 * SECOND)
    log = Holed(str(tmp_path), (QUIET_S + 1, QUIET_S + 6))
    parts = [one for one in log.filled if one.is_reconstructed]
    assert len(parts) == 3
    faults = Faults()
    selection = Selection(lambda topic: topic.subject in MADE_AGAIN, is_filled=True)
    rows = [row for row in read_rows(log.filled, selection, faults) if row.topic.reconstructed]
    made = {(row.topic.name, row.publish_ns, row.data) for row in rows}
    assert len(rows) == len(made)
    assert made == messages(log.whole) - messages(log.logs)


def test_settings_that_cannot_be_read_are_a_fault_and_end_no_answer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A newer gateway may have written them: the hole stays one, and all else is told."""

    def refuse(_text: str) -> Settings:
        raise CommandError("unknown setting")

    log = Holed(str(tmp_path), (QUIET_S + 1, QUIET_S + 3))
    expected = list(read_events(log.logs, Selection(), log.faults))
    assert not log.faults
    monkeypatch.setattr(reconstruction, "settings_from", refuse)
    assert list(read_events(log.filled, Selection(), log.faults)) == expected
    assert log.faults.told == ["cruiser-1: its configuration cannot be read: unknown setting"]


Recorded = list[tuple[int, Sample]]
"""What was said, and when it was received."""


def log_of_recorded(path: Path, recorded: Recorded) -> list[LogFile]:
    """The log of what was received so."""
    rig = RecordedRig()
    rig.settings, rig.recorded = drive().settings, sorted(recorded, key=itemgetter(0))
    path.write_bytes(rig.log())
    return find_logs([path], Faults())


def at(second: float) -> int:
    """A time of the drive."""
    return drive().recorded[0][0] + round(second * SECOND)


def without_states(from_s: float, to_s: float) -> Recorded:
    """The drive, of which a part was not recorded; but the journal is there."""
    return [
        (at_ns, one)
        for at_ns, one in drive().recorded
        if one.subject not in MADE_AGAIN or not at(from_s) <= at_ns < at(to_s)
    ]


def with_journals(recorded: Recorded, change: Callable[[Journal], Journal]) -> Recorded:
    """The same with other journals from the hole's second on."""

    def changed(one: Sample) -> Sample:
        journal = codec.decode(BY_NAME["journal"], one.payload)
        assert isinstance(journal, Journal)
        return Sample("journal", codec.encode(change(journal)))

    return [
        (at_ns, changed(one) if one.subject == "journal" and at_ns >= at(QUIET_S + 1) else one)
        for at_ns, one in recorded
    ]


def with_inputs(*more: tuple[Any, ...]) -> Recorded:
    """A drive with a hole, in whose journals these inputs stand besides."""
    made = [msgspec.msgpack.encode(one) for one in more]

    def change(journal: Journal) -> Journal:
        inputs = [*inputs_of(journal), *map(msgspec.msgpack.decode, made)]
        return msgspec.structs.replace(journal, inputs=msgspec.msgpack.encode(inputs))

    return with_journals(without_states(QUIET_S + 1, QUIET_S + 3), change)


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ((Kind.TICK, -5, 5, 0, b""), "can't convert negative int"),
        ((Kind.TICK, 2**62, 2**62, 0, b"x"), "is no message"),
        ((Kind.FRAME, 5, [2**63, b"12345678", 2**63]), "is no message"),
        ((Kind.LINKS, 5, *["x"] * 8), ""),
    ],
)
def test_whatever_a_journal_holds_the_log_is_answered(tmp_path: Path, more: tuple[Any, ...], said: str) -> None:
    """Inputs that no gateway was given are a line, and what was recorded is told as ever."""
    logs = log_of_recorded(tmp_path / "log.mcap", with_inputs(more))
    faults = Faults()
    told = list(read_events(filled(logs, faults), Selection(), faults))
    assert [one for one in told if not one.reconstructed]
    assert any("cannot be run again from there on" in one and said in one for one in faults.told)


def test_a_run_that_takes_long_is_looked_at_from_journal_to_journal(tmp_path: Path) -> None:
    """So whoever waits for the answer can end it, though nothing comes out of the run and one chunk holds all."""
    logs = log_of_recorded(tmp_path / "log.mcap", without_states(QUIET_S + 1, QUIET_S + 3))
    looks: list[int] = []
    made = filled(logs, Faults(), looks.append)
    before = len(looks)
    assert messages(made, is_made=True)
    assert len(looks) - before > 20 * BACK_NS[0] // SECOND, "of the seconds before the hole alone"


@pytest.mark.parametrize("bound", ["RECORDS_MAX", "SAID_MAX"])
def test_what_is_held_while_a_hole_is_filled_is_bounded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, bound: str
) -> None:
    """Where more comes out of a journal than a gateway says, nothing of it is shown, and that is told."""
    monkeypatch.setattr(reconstruction, bound, 100)
    log = Holed(str(tmp_path), (QUIET_S + 1, QUIET_S + 3))
    assert not [
        one for one in read_rows(log.filled, Selection(is_filled=True), log.faults) if one.topic.reconstructed
    ]
    assert log.faults.told == ["cruiser-1: what is missing is not reconstructed: " + reconstruction.TOO_MUCH]


def test_what_fills_all_holes_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is in memory until the question is answered."""
    monkeypatch.setattr(reconstruction, "CONTENT_MAX", 1000)
    log = Holed(str(tmp_path), (QUIET_S + 1, QUIET_S + 3))
    assert not [
        one for one in read_rows(log.filled, Selection(is_filled=True), log.faults) if one.topic.reconstructed
    ]
    assert "ask for one robot, or with --from and --to" in log.faults.told[0]


def test_no_log_has_endless_holes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A state here and there, with hours between them, is a hole each time: of these so many are kept."""
    monkeypatch.setattr(module_holes, "FOUND_MAX", 5)
    states = [one for one in without_states(0, 0) if one[1].subject == "safety/state"][::20]
    assert len(states) > 10
    logs = log_of_recorded(tmp_path / "log.mcap", states)
    assert len(module_holes.holes(logs, Faults())) == 5


def test_a_hole_is_looked_for_in_the_logs_of_its_robot_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of hundreds of robots that a recorder lost at once the logs are opened once, and not each for all others."""
    states = [one for one in without_states(0, 0) if one[1].subject == "safety/state"][::20]
    rig = RecordedRig()
    rig.settings, rig.recorded = drive().settings, states
    for number in range(8):
        (tmp_path / f"{number}.mcap").write_bytes(rig.log(robot=f"cruiser-{number}"))
    logs = find_logs([tmp_path], Faults())
    opened: list[str] = []

    def open_log(log: LogFile) -> BinaryIO:
        opened.append(log.name)
        return log.path.open("rb")

    monkeypatch.setattr(LogFile, "open", open_log)
    assert len(module_holes.holes(logs, Faults())) > 8
    assert len(opened) <= 2 * len(logs), "once for the account, and once for the states"


def test_a_journal_of_another_robot_is_never_as_the_recorded_one(tmp_path: Path) -> None:
    """It may be put under any key: none of the states beside the hole comes out of it, and the mark says so."""
    other = RecordedRig.beginning(at(QUIET_S - 4) + 3 * MS, 99)
    other.run(12)
    recorded = [one for one in without_states(QUIET_S + 1, QUIET_S + 3) if one[1].subject != "journal"]
    journals = [one for one in other.recorded if one[1].subject == "journal"]
    logs = log_of_recorded(tmp_path / "log.mcap", recorded + journals)
    faults = Faults()
    rows = read_rows(filled(logs, faults), Selection(is_filled=True), faults)
    assert {one.topic.reconstructed for one in rows} == {"", OTHERWISE}


def test_why_sees_what_a_recorder_missed_that_hung(tmp_path: Path) -> None:
    """What waited for it was received at once, long after it was said; what is missing was between that."""
    hung_s, late_s, on_s = 3.0, 4.0, QUIET_S + 4
    recorded = [
        (at(on_s) if at(hung_s) <= at_ns < at(late_s) else at_ns, one)
        for at_ns, one in without_states(late_s, on_s)
        if one.subject != "journal"
    ]
    recorded += [
        (max(at_ns, at(on_s) + SECOND) if at_ns >= at(late_s) else at_ns, one)
        for at_ns, one in drive().recorded
        if one.subject == "journal"
    ]
    logs = log_of_recorded(tmp_path / "log.mcap", recorded)
    whole = log_of(tmp_path / "whole.mcap")
    faults = Faults()
    for second in (late_s + 1, QUIET_S + 1.5, QUIET_S + 3):
        told, expected = (
            explain("cruiser-1", one, survey(of, faults), at(second), faults)
            for one, of in ((filled(logs, faults), logs), (whole, whole))
        )
        assert told.reconstructed == FROM_JOURNAL
        assert (told.state, told.reason, told.stop_ns) == (expected.state, expected.reason, expected.stop_ns)
    assert not faults
