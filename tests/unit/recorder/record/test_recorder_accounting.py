"""A recorder without I/O: each message is accounted for, whatever comes."""

from collections import Counter
from io import BytesIO
from typing import Final

import msgspec
import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, rule
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from recorder.encoding.samples import ReceivedSample
from recorder.record import robot_log
from recorder.record.accounting import COMPLETENESS_NAME, OTHER_KEYS, KeyReport
from recorder.record.actions import INCIDENT_MARK, Lost
from recorder.record.incidents import INCIDENT_NAME
from recorder.record.recorder import REPORT_LOSSES_NS, HealthReport, Vitals
from schemas import keys
from schemas.decisions import EventKind, SafetyEvent, Severity
from schemas.messages import CanFrames, Gear
from schemas.recording import LOG_CHUNK, GapReason
from tests.support.fakes.recording import MemoryFile
from tests.support.messages import (
    MS,
    SECOND,
    WALL_NS,
    FakeSample,
    batch,
    feedback,
    gear,
    key_of,
    safety_event,
    sample_of,
)
from tests.support.rigs.recorder import GEAR_KEY, OTHERS, OWN, PLAN, RecorderRig, messages, metadata


class _Key:
    """The fate of the samples of one key, in order."""

    def __init__(self) -> None:
        self.sequence = 7
        self.fates: list[str] = []
        self.fate_of: dict[int, tuple[str, int]] = {}
        """By log time: whether its messages are to be written, and how many there are."""


class _Window(msgspec.Struct):
    """An incident: the times between which it must hold all received samples."""

    file: MemoryFile
    first_ns: int
    last_ns: int


def _is_ours(topic: str) -> bool:
    """True of the recorder's own messages and of event lines."""
    return topic.startswith(OWN) or topic.endswith(f"/{LOG_CHUNK}")


class Machine(RuleBasedStateMachine):
    """Three robots and a stranger, operators, and a disk that is full or loses chunks.

    Each sample has its own time of receipt.
    """

    def __init__(self) -> None:
        super().__init__()
        self.bench = RecorderRig()
        self.keys: dict[tuple[str, str], _Key] = {}
        self.windows: dict[str, list[_Window]] = {}

    @rule(
        robot=st.sampled_from(["a", "b", OTHERS]),
        frames=st.sampled_from([0, 0, 0, 1, 5]),
        wait_ms=st.sampled_from([0, 0, 1, 30, 90]),
        fate=st.sampled_from(["come", "come", "come", "come", "link", "queue", "size"]),
    )
    def send(self, robot: str, frames: int, wait_ms: int, fate: str) -> None:
        self.bench.run(wait_ms * MS)
        self.bench.now_ns += 1000
        key, sample, count = self._sample(robot, frames)
        known = self.keys.setdefault((robot, key), _Key())
        known.fates.append(fate)
        if fate == "queue":
            self.bench.recorder.drop(key, GapReason.QUEUE, self.bench.now_ns, self.bench.wall_ns)
        elif fate == "size":
            self.bench.receive(FakeSample(key, "", bytes(1001)))
        elif fate == "come":
            known.fate_of[self.bench.wall_ns] = (self.bench.recorder.state.value, count)
            self.bench.receive(sample)
        self.bench.notice()

    def _sample(self, robot: str, frames: int) -> tuple[str, ReceivedSample, int]:
        if robot == OTHERS:
            return "fleet/elsewhere", FakeSample("fleet/elsewhere", "text/plain", b"hello"), 1
        key = key_of(CanFrames if frames else Gear, robot)
        known = self.keys.setdefault((robot, key), _Key())
        known.sequence += 1
        if frames:
            rows = [(WALL_NS, feedback(number)) for number in range(frames)]
            return key, sample_of(batch(known.sequence, rows), robot), frames
        return key, sample_of(gear(known.sequence), robot), 1

    @rule(robot=st.sampled_from(["a", "b"]), severity=st.sampled_from([Severity.INFO, Severity.ERROR]))
    def raise_an_alarm(self, robot: str, severity: Severity) -> None:
        self.bench.now_ns += 1000
        key = key_of(SafetyEvent, robot)
        known = self.keys.setdefault((robot, key), _Key())
        known.sequence += 1
        known.fates.append("come")
        known.fate_of[self.bench.wall_ns] = (self.bench.recorder.state.value, 1)
        self.bench.receive(sample_of(safety_event(EventKind.STOP, severity, known.sequence), robot))
        if severity is not Severity.INFO and self.bench.recorder.has_incident_room:
            self._begun(robot)
        self.bench.notice()

    @rule(robot=st.sampled_from(["", "a", "b"]))
    def mark(self, robot: str) -> None:
        for name in self.bench.mark(robot):
            self._begun(name.removesuffix(INCIDENT_MARK))
        self.bench.notice()

    def _begun(self, log: str) -> None:
        file = self.bench.writer.open_file(log + INCIDENT_MARK)
        assert file is not None
        windows = self.windows.setdefault(log, [])
        now_ns, plan = self.bench.now_ns, PLAN.log
        if windows and windows[-1].file is file:
            windows[-1].last_ns = now_ns + plan.after_ns
        else:
            windows.append(_Window(file, now_ns - plan.before_ns, now_ns + plan.after_ns))

    @rule(span_ms=st.sampled_from([10, 300, 1000, 2500]))
    def wait(self, span_ms: int) -> None:
        self.bench.run(span_ms * MS)

    @rule()
    def split(self) -> None:
        self.bench.writer.apply(self.bench.recorder.roll("split", self.bench.now_ns))
        self.bench.notice()

    @rule(has_room=st.booleans(), has_incident_room=st.sampled_from([True, True, False]), roll=st.booleans())
    def fill_the_disk(self, has_room: bool, has_incident_room: bool, roll: bool) -> None:  # noqa: FBT001 - drawn
        self.bench.room(has_room=has_room, has_incident_room=has_incident_room, roll=roll)
        if not has_incident_room:
            for window in (one for windows in self.windows.values() for one in windows):
                window.last_ns = min(window.last_ns, self.bench.now_ns)
        self.bench.notice()

    @rule(loses=st.booleans())
    def lose_chunks(self, loses: bool) -> None:  # noqa: FBT001 - drawn
        self.bench.writer.loses = loses

    def teardown(self) -> None:
        self.bench.close()
        for file in (file for files in self.bench.writer.files.values() for file in files):
            assert file.is_ended
            assert len(metadata(file, "cruiser")) >= 1
        self._each_message_is_in_one_file_of_its_log_or_accounted_for()
        for (_, key), known in self.keys.items():
            self._the_account_of_a_key_adds_up(key, known)
        self._each_incident_holds_what_came_before_and_after()
        self._log_and_incident_name_each_other()
        self._the_health_says_the_same()

    def _each_message_is_in_one_file_of_its_log_or_accounted_for(self) -> None:
        found: dict[tuple[str, str], Counter[int]] = {}
        for log, files in self.bench.logs().items():
            for topic, time_ns in (one for file in files for one in messages(file)):
                found.setdefault((log, topic), Counter())[time_ns] += 1
        for place, known in self.keys.items():
            wanted = Counter[int]()
            for time_ns, (state, count) in known.fate_of.items():
                if state == "recording":
                    wanted[time_ns] = count - self.bench.writer.lost[place[1], time_ns]
            assert found.pop(place, Counter()) == wanted
        assert all(_is_ours(topic) for _, topic in found)

    def _the_account_of_a_key_adds_up(self, key: str, known: _Key) -> None:
        report = self.bench.recorder.counts.get(key, KeyReport())
        fates = Counter(known.fates)
        came = [index for index, fate in enumerate(known.fates) if fate == "come"]
        seen = known.fates[came[0] : came[-1]] if came else []
        assert report.received == fates["come"] + fates["queue"] + fates["size"]
        assert (report.lost_queue, report.lost_size) == (fates["queue"], fates["size"])
        if report.sent is None:
            assert "elsewhere" in key or not known.fates.count("come")
        else:
            assert report.lost_link == seen.count("link")
            assert report.sent == report.received + report.lost_link
        states = Counter[str]()
        for time_ns, (state, count) in known.fate_of.items():
            lost = self.bench.writer.lost[key, time_ns] if state == "recording" else 0
            states["lost"] += lost
            states[state] += count - lost
        assert report.written == states["recording"]
        assert (report.lost_full, report.lost_disk) == (states["full"], states["lost"])

    def _each_incident_holds_what_came_before_and_after(self) -> None:
        for log, windows in self.windows.items():
            of_log = {key: known for (robot, key), known in self.keys.items() if robot == log}
            assert [one.file for one in windows] == self.bench.writer.files[log + INCIDENT_MARK]
            for window in windows:
                assert window.file.opened.is_incident
                found = Counter(messages(window.file))
                for key, known in of_log.items():
                    for time_ns, (_, count) in known.fate_of.items():
                        is_due = window.first_ns <= time_ns - WALL_NS <= window.last_ns
                        assert found.pop((key, time_ns), 0) in ({count} if is_due else {0, count})
                assert all(_is_ours(topic) for topic, _ in found)
        assert self.bench.recorder.incidents == sum(map(len, self.windows.values()))

    def _log_and_incident_name_each_other(self) -> None:
        for log, windows in self.windows.items():
            files = {file.name: file for file in self.bench.logs().get(log, [])}
            for window in windows:
                named = metadata(window.file, INCIDENT_NAME)
                assert len({one["because"] for one in named}) == 1
                for one in named:
                    if one["file"]:
                        back = metadata(files[one["file"]], INCIDENT_NAME)
                        assert {**one, "file": window.file.name} in back

    def _the_health_says_the_same(self) -> None:
        counts = self.bench.recorder.counts.values()
        health = HealthReport("bench", "1", 0).now(self.bench.recorder, Vitals(), self.bench.now_ns, WALL_NS)
        assert health.received == sum(one.received for one in counts)
        assert health.written == sum(one.written for one in counts)
        assert health.missed == sum(one.lost_link for one in counts)
        dropped = sum(one.lost_queue + one.lost_size + one.lost_full + one.lost_disk for one in counts)
        assert sum(health.dropped.values()) == dropped


Machine.TestCase.settings = settings(stateful_step_count=30, suppress_health_check=list(HealthCheck))


TestRecording = Machine.TestCase


def test_a_loss_is_told_in_the_log_that_it_is_about(bench: RecorderRig) -> None:
    for robot in ("a", "b"):
        bench.receive(sample_of(gear(0), robot), FakeSample(key_of(Gear, robot), "text/plain", b""))
    bench.writer.apply(bench.recorder.receive_notice(Lost("a", {1: 3, 2: 2}, WALL_NS, WALL_NS + 5), 0, WALL_NS))
    bench.writer.apply(bench.recorder.receive_notice(Lost("a", {1: 1}, WALL_NS + 7, WALL_NS + 9), 0, WALL_NS))
    bench.run(REPORT_LOSSES_NS)
    key = key_of(Gear, "a")
    assert [(gap.key, gap.count, gap.first_ns, gap.last_ns) for gap in bench.gaps()] == [
        (key, 4, WALL_NS, WALL_NS + 9),
        (f"{key}/@raw", 2, WALL_NS, WALL_NS + 5),
    ]
    bench.close()
    topics = {log: [topic for file in files for topic, _ in messages(file)] for log, files in bench.logs().items()}
    assert topics["a"].count(f"{OWN}/gap") == 2
    assert f"{OWN}/gap" not in topics["b"]


def test_what_the_disk_lost_of_an_incident_is_no_loss_of_the_log(bench: RecorderRig) -> None:
    bench.receive(sample_of(gear(0)))
    for log in ("cruiser-1!", "nobody"):
        assert not bench.recorder.receive_notice(Lost(log, {1: 1}, 0, 0), 0, WALL_NS)
    bench.run(REPORT_LOSSES_NS)
    assert bench.recorder.counts[GEAR_KEY].lost_disk == 0


Step = str | int


@pytest.mark.parametrize(
    ("steps", "first", "second"),
    [
        # received, written, lost_full of each file
        ([100, "full", 100, "room", 100], (100, 100, 0), (200, 100, 100)),
        (["full", 5, "room", 100, "full", "room", 100], (105, 100, 5), (100, 100, 0)),
    ],
)
def test_a_file_counts_what_came_since_the_one_before_it(
    bench: RecorderRig, steps: list[Step], first: tuple[int, ...], second: tuple[int, ...]
) -> None:
    sequence = 0
    do = {"full": lambda: bench.room(has_room=False), "room": bench.room}
    for step in steps:
        if isinstance(step, str):
            do[step]()
            continue
        for _ in range(step):
            sequence += 1
            bench.receive(sample_of(gear(sequence)))
            bench.run(10 * MS)
    bench.close()
    told = [
        msgspec.json.decode(one[GEAR_KEY], type=KeyReport)
        for file in bench.logs()["cruiser-1"]
        for one in metadata(file, COMPLETENESS_NAME)
    ]
    assert [(one.received, one.written, one.lost_full) for one in told] == [first, second]
    assert not any(one.lost_link for one in told)


def test_the_gaps_of_a_long_full_disk_are_in_the_next_file(
    bench: RecorderRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(robot_log, "PENDING_EVENTS_MAX", 10)
    monkeypatch.setattr(robot_log, "PENDING_GAPS_MAX", 3)
    bench.receive(sample_of(gear(0)))
    bench.room(has_room=False)
    for _ in range(60):
        bench.receive(*(FakeSample(f"fleet/cruiser-1/k/{number}", "x", b"") for number in range(5)))
        bench.run(SECOND)
    bench.room()
    bench.receive(sample_of(gear(1)))
    bench.close()
    published = Counter[str]()
    for gap in bench.gaps():
        published[gap.key] += gap.count
    file = bench.logs()["cruiser-1"][1]
    reader = make_reader(BytesIO(file.disk.getvalue()), decoder_factories=[DecoderFactory()])
    found = [content for _, _, _, content in reader.iter_decoded_messages(topics=[f"{OWN}/gap"])]
    assert published == {f"fleet/cruiser-1/k/{number}": 60 for number in range(5)}
    assert {gap.key: gap.count for gap in found} == {
        **{f"fleet/cruiser-1/k/{number}": 60 for number in range(3)},
        OTHER_KEYS: 120,
    }
    assert all(gap.last_ns - gap.first_ns >= 58 * SECOND for gap in found)


LONG_KEY: Final = f"fleet/cruiser-1/{'y' * keys.KEY_MAX_LENGTH}"


def test_very_long_keys_are_kept_and_not_remembered(bench: RecorderRig) -> None:
    monster = [FakeSample(f"{LONG_KEY}{number}", "x", b"") for number in range(20)]
    bench.receive(*monster)
    bench.receive(FakeSample(LONG_KEY, "x", bytes(2000)))
    bench.run(REPORT_LOSSES_NS)
    assert set(bench.recorder.counts) == {"@more", f"{OWN}/gap"}
    assert bench.recorder.counts["@more"] == KeyReport(received=21, written=20, lost_size=1)
    assert not bench.recorder._by_key
    assert [gap.key for gap in bench.gaps()] == [OTHER_KEYS]
