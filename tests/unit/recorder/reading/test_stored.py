"""Logs in object stores are asked without being read: by the digest at their end, and the index of chunks."""

from collections.abc import Callable
from pathlib import Path
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap import records

from recorder.encoding.event_digest import DIGEST_NAME, Digest, DigestUnreadableError
from recorder.mcap.reader import record_at
from recorder.mcap.summary_reader import read_summary
from recorder.objects.ranged import BLOCK_BYTES
from recorder.reading.faults import Faults
from recorder.reading.log_file import LogFile
from recorder.reading.logs import look_at, look_at_stored
from recorder.reading.rows import END_OF_TIME_NS, LogReader, Selection, read_rows
from recorder.reading.survey import survey
from recorder.review.timeline.entries import Entry, EntryKind
from recorder.review.timeline.timeline import read_events
from recorder.review.why import Explainer
from schemas.messages import Variant
from schemas.reasons import Reason
from tests.support.fakes.objects import FakeStoredLog
from tests.support.logs import saved
from tests.support.messages import MS, SECOND
from tests.support.nights import by_night
from tests.support.rigs.day import Day
from tests.support.rigs.recorded import RecordedRig


@pytest.fixture(scope="module")
def day(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The log of a day in which everything happens."""
    lived = Day(3, Variant.COARSE)
    lived.live()
    path = tmp_path_factory.mktemp("logs") / "a.mcap"
    path.write_bytes(lived.rig.log())
    return path


def events(log: LogFile, from_ns: int = 0, to_ns: int = END_OF_TIME_NS) -> list[Entry]:
    """What happened, without faults."""
    faults = Faults()
    found = list(read_events([log], Selection(from_ns=from_ns, to_ns=to_ns), faults))
    assert faults.told == []
    return found


def test_the_events_of_a_stored_log_are_those_of_the_file(day: Path) -> None:
    """Though only its end is read."""
    stored = FakeStoredLog(day)
    here, there = look_at(day), look_at_stored(stored)
    assert events(there) == events(here)
    assert len(events(here)) > 50
    assert stored.objects.fetched < day.stat().st_size / 3


def test_the_events_of_a_part_of_a_stored_log_are_those_of_the_file(day: Path) -> None:
    """But for the words on the state at its end, which is that of half a second before at most."""
    here, there = look_at(day), look_at_stored(FakeStoredLog(day))
    for from_ns in range(here.start_ns, here.end_ns, 7 * SECOND):
        found = [
            [one for one in events(log, from_ns, from_ns + 10 * SECOND) if one.kind is not EntryKind.GAP]
            for log in (here, there)
        ]
        assert found[0] == found[1]


@pytest.mark.parametrize("seed", [1, by_night(2)])
def test_what_a_recorder_lost_is_told_of_a_stored_log_as_of_the_file(tmp_path: Path, seed: int) -> None:
    """The digest leaves out what was there, and shows what was not: states, decisions and late receipts."""
    day = Day(seed, Variant.FINE, ticks=3000)
    day.live()
    chance = Random(seed)  # noqa: S311 - the same each time
    rig = day.rig
    rig.recorded = [one for one in rig.recorded if chance.random() > 0.02]
    path = saved(tmp_path / "a.mcap", rig.log(lag_ns=chance.choice([0, 400, 700, 5000]) * MS))
    here, there = look_at(path), look_at_stored(FakeStoredLog(path))
    assert events(there) == events(here)
    assert any(one.text.endswith("are not in the log") for one in events(here))


@pytest.mark.parametrize("period_s", [17, by_night(5)])
def test_why_a_stored_log_stopped_is_why_the_file_did(day: Path, period_s: int) -> None:
    """In the end, and every few seconds."""
    here, there = look_at(day), look_at_stored(FakeStoredLog(day))
    explained = [explainer(one) for one in (here, there)]
    answers = [
        [one.last(), *(one.at(at_ns) for at_ns in range(here.start_ns, here.end_ns, period_s * SECOND))]
        for one in explained
    ]
    assert answers[0] == answers[1]


def explainer(log: LogFile) -> Explainer:
    """The one of the robot's log."""
    return Explainer("cruiser-1", [log], survey([log], Faults()), Faults())


@given(data=st.data())
def test_any_time_and_topics_of_a_stored_log_are_those_of_the_file(drive: Path, data: st.DataObject) -> None:
    """The same messages in the same order, whichever chunks hold them."""
    here, there = look_at(drive), look_at_stored(FakeStoredLog(drive))
    from_ns, to_ns = sorted(
        data.draw(st.lists(st.integers(here.start_ns, here.end_ns + 1), min_size=2, max_size=2))
    )
    subjects = data.draw(st.sets(st.sampled_from(["state", "safety/event", "can/{bus}/rx", "none"])))
    found = []
    for log in (here, there):
        faults = Faults()
        selection = Selection(lambda topic: topic.subject in subjects, from_ns, to_ns)
        found.append(
            [(row.topic.name, row.sequence, row.log_ns, row.data) for row in read_rows([log], selection, faults)]
        )
        assert not faults
    assert found[0] == found[1]


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The log of a minute of driving, as a recorder writes it: four chunks a second. It ends with a stop."""
    rig, operator = RecordedRig.driving(0.5)
    for turn in range(12):
        operator.drive(0.5, 10.0 - turn, 5.0)
    rig.put("passer-by", "stop", b"")
    rig.rest_after(1)
    path = tmp_path_factory.mktemp("logs") / "a.mcap"
    path.write_bytes(rig.log(tick_ns=10 * MS))
    return path


def test_the_stop_of_a_drive_is_explained_with_few_requests_and_bytes(drive: Path) -> None:
    """Its end, its digest, its configuration, and the seconds around the stop. Events take less."""
    stored = FakeStoredLog(drive)
    log = look_at_stored(stored)
    assert explainer(log).last().reason is Reason.REMOTE_STOP
    assert stored.objects.requests <= 8
    size = drive.stat().st_size
    seconds = (log.end_ns - log.start_ns) / SECOND
    window = size * 24 / seconds
    assert stored.objects.fetched < window + 6 * BLOCK_BYTES
    again = FakeStoredLog(drive)
    assert events(look_at_stored(again))
    assert again.objects.requests <= 5
    assert again.objects.fetched < size / 10 + 4 * BLOCK_BYTES


def test_a_log_without_a_digest_is_read_by_the_index_of_its_chunks(drive: Path, tmp_path: Path) -> None:
    """One of an older version: ten seconds of it take about ten seconds of bytes."""
    log = look_at(drive)
    old = tmp_path / "old.mcap"
    old.write_bytes(without_digest(drive.read_bytes()))
    stored = FakeStoredLog(old)
    there = look_at_stored(stored)
    assert events(there) == events(log)
    again = FakeStoredLog(old)
    there = look_at_stored(again)
    middle_ns = (log.start_ns + log.end_ns) // 2
    selection = Selection(from_ns=middle_ns, to_ns=middle_ns + 10 * SECOND)
    assert len(list(read_rows([there], selection, Faults()))) == len(list(read_rows([log], selection, Faults())))
    assert again.objects.fetched < there.bytes / 4


def without_digest(data: bytes) -> bytes:
    """The log as a recorder without digests writes it."""
    return data.replace(DIGEST_NAME.encode(), b"cruiser.nothin")


@pytest.mark.parametrize(
    "spoil", [lambda data: data[:-1], lambda data: data[:50] + b"\0" + data[51:], lambda _: b""]
)
def test_a_damaged_digest_is_not_believed(drive: Path, spoil: Callable[[bytes], bytes]) -> None:
    """Its log is read instead."""
    stored = FakeStoredLog(drive)
    log = look_at_stored(stored)
    with log.open() as stream:
        reader = LogReader(stream, log, Selection(is_digested=True), Faults())
        assert reader.digest is not None
        summary = read_summary(stream)
        assert summary is not None
        [place] = [one for one in summary.attachments if one.name == DIGEST_NAME]
        attachment = record_at(stream, place.offset, records.Attachment)
        assert attachment is not None
        with pytest.raises(DigestUnreadableError):
            Digest([spoil(attachment.data)], summary.statistics.message_count if summary.statistics else 0)
        with pytest.raises(DigestUnreadableError, match="another log"):
            Digest([attachment.data], 5)
