"""A recorder without I/O: whatever comes and whatever is asked, each message is accounted for."""

from collections import Counter
from collections.abc import Callable, Iterator
from io import BytesIO
from typing import Any, Final

import msgspec
import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, rule
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from recorder.encoding.foxglove_log import LOG_CHUNK
from recorder.encoding.received_sample import ReceivedSample
from recorder.record import channels, robot_log
from recorder.record.accounting import COMPLETENESS_NAME, OTHER_KEYS, KeyReport
from recorder.record.actions import INCIDENT_MARK, LogAction, Publish, Query
from recorder.record.health import HealthReport, Vitals
from recorder.record.incidents import INCIDENT_NAME
from recorder.record.notices import Deleted, DiskRoom, Lost
from recorder.record.recorder import QUICK_BYTES, REPORT_LOSSES_NS, Recorder, RecorderPlan
from recorder.record.robot_log import CONTINUED_NAME, LogPlan
from schemas import codec, keys
from schemas.decisions import ArbiterState, EventKind, SafetyEvent, SafetyState, Severity
from schemas.messages import CanFrames, GatewayInfo, Gear
from schemas.recording import GapReason, RecorderEvent, RecorderEventKind, RecorderState, RecordGap
from schemas.subjects import BY_TYPE
from tests.support.recorder_fakes import (
    MS,
    RECORDER_PLAN,
    ROOT,
    SAFETY_STATE,
    SECOND,
    WALL_NS,
    FakeSample,
    MemoryFile,
    MemoryWriter,
    batch,
    feedback,
    gear,
    info,
    key_of,
    safety_event,
    sample_of,
)

OTHERS: Final = "others"
"""The name of the log for what is no robot's."""

PLAN: Final = msgspec.structs.replace(
    RECORDER_PLAN,
    log=LogPlan(
        OTHERS,
        300,
        SECOND // 2,
        "0.1.0",
        alarms=frozenset({EventKind.STOP}),
        before_ns=2 * SECOND,
        after_ns=2 * SECOND,
    ),
    sample_max_bytes=1000,
)
GEAR_KEY = key_of(Gear)
EVENT_KEY = key_of(SafetyEvent)
OWN = keys.of_recorder(ROOT, "bench")


class Bench:
    """A recording, the writer that carries it out, and a clock."""

    def __init__(self, plan: RecorderPlan = PLAN) -> None:
        self.recorder = Recorder(plan)
        self.writer = MemoryWriter()
        self.now_ns = 0

    @property
    def wall_ns(self) -> int:
        return WALL_NS + self.now_ns

    def receive(self, *samples: ReceivedSample) -> None:
        """They come now."""
        self.writer.apply(self.recorder.receive(map(self._now, samples), self.now_ns))

    def _now(self, sample: ReceivedSample) -> ReceivedSample:
        assert isinstance(sample, FakeSample)
        return msgspec.structs.replace(sample, received_ns=self.wall_ns)

    def tick(self) -> None:
        self.writer.apply(self.recorder.tick(self.now_ns, self.wall_ns, {}))

    def run(self, span_ns: int) -> None:
        """Let time go by."""
        end_ns = self.now_ns + span_ns
        while self.now_ns < end_ns:
            self.now_ns = min(end_ns, self.now_ns + 10 * MS)
            self.tick()
            self.notice()

    def notice(self) -> None:
        """What became of the files."""
        while self.writer.notices:
            notice = self.writer.notices.pop(0)
            self.writer.apply(self.recorder.receive_notice(notice, self.now_ns, self.wall_ns))

    def stop(self) -> None:
        self.writer.apply(self.recorder.stop("operator-1", self.now_ns, self.wall_ns))

    def start(self) -> None:
        self.writer.apply(self.recorder.start("operator-1", self.now_ns, self.wall_ns))

    def mark(self, robot: str = "", because: str = "it shook") -> dict[str, str]:
        marked, actions = self.recorder.mark(robot, because, self.now_ns, self.wall_ns)
        self.writer.apply(actions)
        return marked

    def room(self, *, has_room: bool = True, has_incident_room: bool = True, roll: bool = False) -> None:
        room = DiskRoom(has_room, has_incident_room, roll)
        self.writer.apply(self.recorder.receive_notice(room, self.now_ns, self.wall_ns))

    def close(self) -> None:
        self.writer.apply(self.recorder.close(self.now_ns, self.wall_ns))
        self.notice()

    def events(self) -> list[RecorderEvent]:
        return [one for one in self.writer.said if isinstance(one, RecorderEvent)]

    def gaps(self) -> list[RecordGap]:
        return [one for one in self.writer.said if isinstance(one, RecordGap)]

    def logs(self) -> dict[str, list[MemoryFile]]:
        """The files of each log, without the incidents."""
        return {log: files for log, files in self.writer.files.items() if not log.endswith(INCIDENT_MARK)}


def messages(file: MemoryFile) -> list[tuple[str, int]]:
    """Topic and log time of each message of a file, as a public reader finds them."""
    reader = make_reader(BytesIO(file.disk.getvalue()), validate_crcs=True)
    return [(channel.topic, one.log_time) for _, channel, one in reader.iter_messages(log_time_order=False)]


def times(file: MemoryFile, topic: str = GEAR_KEY) -> list[int]:
    """When a file's messages of a topic were received, since the beginning."""
    return [time_ns - WALL_NS for found, time_ns in messages(file) if found == topic]


def metadata(file: MemoryFile, name: str) -> list[dict[str, str]]:
    """The metadata records of a name, in their order."""
    reader = make_reader(BytesIO(file.disk.getvalue()), validate_crcs=True)
    return [one.metadata for one in reader.iter_metadata() if one.name == name]


class _Key:
    """What became of the samples of one key, in their order."""

    def __init__(self) -> None:
        self.sequence = 7
        self.fates: list[str] = []
        self.fate_of: dict[int, tuple[str, int]] = {}
        """By log time: whether its messages are to be written, and how many there are."""


class _Window(msgspec.Struct):
    """An incident: from when to when it has to hold what was received."""

    file: MemoryFile
    first_ns: int
    last_ns: int


def _is_ours(topic: str) -> bool:
    """What the recorder says of itself, and the second form of events, are no samples."""
    return topic.startswith(OWN) or topic.endswith(f"/{LOG_CHUNK}")


class Machine(RuleBasedStateMachine):
    """Three robots and somebody else, operators, and a disk that is full or loses chunks.

    Each sample has a receipt of its own, by which it is found again in the files.
    """

    def __init__(self) -> None:
        super().__init__()
        self.bench = Bench()
        self.keys: dict[tuple[str, str], _Key] = {}
        self.windows: dict[str, list[_Window]] = {}
        self.was_stopped: Counter[str] = Counter()

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
    def stop(self) -> None:
        self.bench.stop()
        self.bench.notice()

    @rule()
    def start(self) -> None:
        self.bench.start()
        self.bench.notice()

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


Machine.TestCase.settings = settings(
    max_examples=100, stateful_step_count=30, suppress_health_check=list(HealthCheck)
)


TestRecording = Machine.TestCase


@pytest.fixture
def bench() -> Iterator[Bench]:
    """A bench, of which every file is whole and readable in the end."""
    one = Bench()
    yield one
    one.close()
    assert all(messages(file) is not None for files in one.writer.files.values() for file in files)


def test_each_robot_has_a_log_and_what_is_no_robots_another(bench: Bench) -> None:
    """Robots of another root are no mere namesakes: their logs are their own."""
    bench.receive(sample_of(gear(0), "a"), sample_of(gear(0), "b"), sample_of(gear(0), "a", "site/hall"))
    bench.receive(FakeSample("anything", "x", b""), FakeSample("fleet/a/of/their/own", "x", b""))
    bench.close()
    found = {log: [topic for file in files for topic, _ in messages(file)] for log, files in bench.logs().items()}
    assert found == {
        "a": [key_of(Gear, "a"), "fleet/a/of/their/own"],
        "b": [key_of(Gear, "b")],
        "site/hall/a": [key_of(Gear, "a", "site/hall")],
        OTHERS: ["anything"],
    }


def test_robots_beyond_the_limit_share_a_log(monkeypatch: pytest.MonkeyPatch, bench: Bench) -> None:
    """Anybody on the network can make up names."""
    bench.recorder = Recorder(msgspec.structs.replace(PLAN, log_limit=2))
    monkeypatch.setattr("recorder.record.recorder.OWNED_KEY_LIMIT", 4)
    for number in range(10):
        bench.receive(sample_of(gear(0), f"r-{number}"))
        assert len(bench.recorder._by_key) <= 4
    assert set(bench.logs()) == {"r-0", "r-1", "r-2", OTHERS}


def test_a_known_robot_has_its_own_log_however_many_others_came_first(bench: Bench) -> None:
    """Made-up names must not push it into the log that strangers share."""
    plan = msgspec.structs.replace(PLAN, log_limit=2, known=frozenset({"cruiser-1"}))
    bench.recorder = Recorder(plan)
    for number in range(10):
        bench.receive(sample_of(gear(0), f"r-{number}"))
    bench.receive(sample_of(gear(0)))
    assert set(bench.logs()) == {"r-0", "r-1", "r-2", "cruiser-1", OTHERS}


def test_one_log_for_all_if_that_is_wanted() -> None:
    """Whose ever the samples are; and a robot of it can be marked."""
    bench = Bench(msgspec.structs.replace(PLAN, per_robot=False))
    bench.receive(sample_of(gear(0), "a"), sample_of(gear(0), "b"), FakeSample("x", "x", b""))
    assert set(bench.logs()) == {OTHERS}
    assert bench.mark("c") == {}
    assert set(bench.mark("b")) == {OTHERS + INCIDENT_MARK}


def test_in_standby_nothing_is_written_but_incidents() -> None:
    """Until somebody starts it: then the next sample begins a file. What was before is in none, and no loss."""
    bench = Bench(msgspec.structs.replace(PLAN, standby=True))
    assert bench.recorder.state is RecorderState.STOPPED
    bench.receive(sample_of(gear(0)))
    bench.run(SECOND)
    assert bench.writer.files == {}
    bench.mark("cruiser-1")
    bench.run(SECOND)
    bench.start()
    bench.receive(sample_of(gear(1)))
    bench.close()
    assert (times(bench.logs()["cruiser-1"][0]), times(bench.writer.files["cruiser-1!"][0])) == (
        [2 * SECOND],
        [0, 2 * SECOND],
    )
    assert bench.recorder.counts[GEAR_KEY] == KeyReport(sent=2, received=2, written=1)
    assert bench.gaps() == []


def test_what_is_in_hand_when_the_reason_changes_keeps_its_own(bench: Bench) -> None:
    """A message that came while the disk was full is lost to that, and not to the stop that followed."""
    bench.receive(sample_of(gear(0)))
    bench.room(has_room=False)
    bench.receive(sample_of(gear(1)))
    bench.stop()
    bench.receive(sample_of(gear(2)))
    bench.start()
    bench.receive(sample_of(gear(3)))
    bench.room()
    bench.receive(sample_of(gear(4)))
    bench.run(SECOND)
    report = bench.recorder.counts[GEAR_KEY]
    assert (report.received, report.written, report.lost_full) == (5, 2, 2)
    assert sum(gap.count for gap in bench.gaps()) == 2


def test_what_is_in_hand_at_the_end_is_accounted_for_too() -> None:
    """A recorder that ends while the disk is full has lost the last messages as well, and says so."""
    bench = Bench()
    bench.receive(sample_of(gear(0)))
    bench.room(has_room=False)
    bench.run(REPORT_LOSSES_NS)
    bench.receive(sample_of(gear(1)))
    bench.mark()
    bench.close()
    report = bench.recorder.counts[GEAR_KEY]
    assert (report.written, report.lost_full) == (1, 1)
    assert [(gap.key, gap.reason, gap.count) for gap in bench.gaps()] == [(GEAR_KEY, GapReason.FULL, 1)]
    assert times(bench.writer.files["cruiser-1!"][0]) == [0, SECOND]


def test_an_incident_ends_with_what_was_in_hand(bench: Bench) -> None:
    """The last quarter of a second waits in memory when its time is up: it belongs into it."""
    bench.receive(sample_of(gear(0)))
    bench.mark()
    bench.run(2 * SECOND - 50 * MS)
    bench.receive(sample_of(gear(1)))
    bench.run(SECOND)
    assert bench.writer.open_file("cruiser-1!") is None
    assert times(bench.writer.files["cruiser-1!"][0]) == [0, 2 * SECOND - 50 * MS]


def test_an_incident_of_no_time_holds_its_cause(bench: Bench) -> None:
    """Nothing before and nothing after, but the event."""
    plan = msgspec.structs.replace(PLAN, log=msgspec.structs.replace(PLAN.log, before_ns=0, after_ns=0))
    bench.recorder = Recorder(plan)
    bench.receive(sample_of(safety_event(EventKind.STOP)))
    bench.run(10 * MS)
    assert times(bench.writer.files["cruiser-1!"][0], EVENT_KEY) == [0]


def test_the_next_incident_is_of_its_own(bench: Bench) -> None:
    """It says when and why it was, and nothing of the one before; each channel is declared once."""
    bench.receive(sample_of(gear(0)))
    bench.notice()
    bench.mark(because="first")
    bench.notice()
    bench.run(3 * SECOND)
    marked = bench.mark(because="second")
    assert marked == {"cruiser-1!": ""}
    bench.notice()
    assert bench.mark() == {"cruiser-1!": "cruiser-1-1.incident.mcap"}
    bench.close()
    first, second = bench.writer.files["cruiser-1!"]
    assert [one["because"] for one in metadata(first, INCIDENT_NAME)] == ["first"]
    assert [one["because"] for one in metadata(second, INCIDENT_NAME)] == ["second"]
    (log,) = bench.logs()["cruiser-1"]
    named = metadata(log, INCIDENT_NAME)
    assert [(one["because"], one["file"], one["at_ns"]) for one in named] == [
        ("first", first.name, str(WALL_NS)),
        ("second", second.name, str(WALL_NS + 3 * SECOND)),
    ]
    words = [event for event in bench.events() if event.kind is RecorderEventKind.INCIDENT]
    assert [(event.robot, event.file) for event in words] == [
        ("cruiser-1", first.name),
        ("cruiser-1", second.name),
    ]


def test_a_new_incident_has_no_file_while_the_one_before_is_being_ended(bench: Bench) -> None:
    """However late the disk is: nobody is told the name of the wrong file."""
    bench.receive(sample_of(gear(0)))
    bench.mark()
    bench.notice()
    bench.now_ns += 3 * SECOND
    bench.tick()
    assert bench.mark() == {"cruiser-1!": ""}


def test_an_incident_does_not_name_a_log_that_was_ended(bench: Bench) -> None:
    """Even if the disk has not done it yet."""
    bench.receive(sample_of(gear(0)))
    bench.notice()
    bench.stop()
    bench.mark()
    bench.close()
    (incident,) = bench.writer.files["cruiser-1!"]
    assert [one["file"] for one in metadata(incident, INCIDENT_NAME)] == [""]


def test_incident_and_log_find_each_other_however_late_the_disk_is(bench: Bench) -> None:
    """A log that had not been opened, or that goes on in another file, is named as soon as it has a name."""
    bench.receive(sample_of(safety_event(EventKind.STOP)))
    bench.now_ns += SECOND
    bench.notice()
    bench.writer.apply(bench.recorder.roll("split", bench.now_ns))
    bench.receive(sample_of(gear(1)))
    bench.notice()
    bench.close()
    (incident,) = bench.writer.files["cruiser-1!"]
    logs = bench.logs()["cruiser-1"]
    assert [one["file"] for one in metadata(incident, INCIDENT_NAME)] == ["", *(log.name for log in logs)]
    about = {"at_ns": str(WALL_NS), "because": "stop: as it were", "file": incident.name}
    assert [metadata(log, INCIDENT_NAME) for log in logs] == [[about], [about]]


def test_an_alarm_is_of_its_kind_and_of_now(bench: Bench) -> None:
    """What is merely said, what is not asked for, and what a gateway kept of long ago make no incident."""
    event = sample_of(safety_event(EventKind.STOP))
    bench.receive(sample_of(gear(0)), FakeSample(event.key, event.encoding, event.payload, is_reply=True))
    assert bench.recorder.counts[EVENT_KEY].received == 1
    bench.receive(sample_of(safety_event(EventKind.LEASE)), sample_of(safety_event(EventKind.STOP, Severity.INFO)))
    assert bench.recorder.incidents == 0
    bench.receive(event)
    assert bench.recorder.incidents == 1


TOKEN = keys.liveliness(ROOT, "cruiser-1")


def arbiter(bench: Bench, sequence: int, engaged: ArbiterState, *, run: int = 1) -> ReceivedSample:
    """A state that is published now, of one of several runs of the gateway."""
    tick = run * 10**10 + sequence
    said = msgspec.structs.replace(SAFETY_STATE, sequence=sequence, tick=tick, state=engaged, output_speed_mps=0.6)
    return sample_of(msgspec.structs.replace(said, time_ns=bench.wall_ns))


def drive(bench: Bench, engaged: ArbiterState = ArbiterState.ENGAGED, *, first: int = 0, run: int = 1) -> None:
    """Half a second of states."""
    for sequence in range(first, first + 10):
        bench.receive(arbiter(bench, sequence, engaged, run=run))
        bench.run(50 * MS)


@pytest.mark.parametrize("restart_ns", [None, 100 * MS, 2 * SECOND])
def test_a_gateway_that_dies_at_work_is_an_incident(bench: Bench, restart_ns: int | None) -> None:
    """Whether another one begins soon, late, or never; it is said, with what the dead one told the chassis."""
    drive(bench)
    dead_ns = bench.wall_ns
    bench.recorder.lose_token(TOKEN, bench.now_ns)
    if restart_ns is not None:
        bench.run(restart_ns)
        drive(bench, ArbiterState.STANDBY, run=2)
    bench.run(SECOND)
    assert bench.recorder.incidents == 1
    (gone,) = [one for one in bench.events() if one.kind is RecorderEventKind.GATEWAY]
    assert (gone.robot, gone.severity, gone.time_ns) == ("cruiser-1", Severity.ERROR, dead_ns)
    assert "its token is gone, and it was engaged, and told 0.60 m/s" in gone.text
    bench.close()
    (incident,) = bench.writer.files["cruiser-1!"]
    held = [log_ns for topic, log_ns in messages(incident) if topic == key_of(SafetyState)]
    assert min(held) < dead_ns, "what came before is kept"


def test_a_gateway_that_stands_by_is_told_and_makes_no_incident(bench: Bench) -> None:
    """Nothing was told the chassis; links of robots that stand come and go all day."""
    drive(bench, ArbiterState.STANDBY)
    bench.recorder.lose_token(TOKEN, bench.now_ns)
    bench.run(SECOND)
    assert bench.recorder.incidents == 0
    (gone,) = [one for one in bench.events() if one.kind is RecorderEventKind.GATEWAY]
    assert gone.severity is Severity.WARNING


def test_a_gateway_that_was_told_to_end_has_not_died(bench: Bench) -> None:
    """It says so, and is at rest; one that says so and goes silent in the midst of its stop has died."""
    for sequence, (engaged, incidents) in enumerate([(ArbiterState.STANDBY, 0), (ArbiterState.STOPPING, 1)]):
        drive(bench, engaged, first=10 * sequence)
        ends = msgspec.structs.replace(safety_event(EventKind.GATEWAY, Severity.INFO, sequence), tick=10**10)
        bench.receive(sample_of(ends))
        bench.recorder.lose_token(TOKEN, bench.now_ns)
        bench.run(SECOND)
        assert bench.recorder.incidents == incidents


def test_a_token_that_goes_while_the_states_go_on_tells_nothing(bench: Bench) -> None:
    """Anybody may declare it and take it back. Nor does one of a robot that is not recorded."""
    drive(bench)
    bench.recorder.lose_token(TOKEN, bench.now_ns)
    bench.recorder.lose_token(keys.liveliness(ROOT, "stranger"), bench.now_ns)
    bench.recorder.lose_token("odd", bench.now_ns)
    for first in range(10, 310, 10):
        drive(bench, first=first)
    bench.run(SECOND)
    assert bench.recorder.incidents == 0
    assert bench.events() == []


def test_states_that_wait_for_a_busy_recorder_hide_no_death(bench: Bench) -> None:
    """They come in after the token is gone, and then no more."""
    drive(bench)
    bench.recorder.lose_token(TOKEN, bench.now_ns)
    drive(bench, first=10)
    drive(bench, first=20)
    bench.run(SECOND)
    assert bench.recorder.incidents == 1


def test_without_room_for_incidents_there_are_none(bench: Bench) -> None:
    """Neither by an alarm nor by a mark; one that is being written ends with what was in hand, and it is told."""
    bench.receive(sample_of(gear(0)))
    bench.mark()
    bench.notice()
    bench.receive(sample_of(gear(1)))
    bench.room(has_incident_room=False)
    (incident,) = bench.writer.files["cruiser-1!"]
    assert incident.is_ended
    bench.receive(sample_of(gear(2)), sample_of(safety_event(EventKind.STOP)))
    assert bench.mark() == {}
    bench.run(3 * SECOND)
    bench.receive(sample_of(safety_event(EventKind.STOP, sequence=1)))
    assert bench.recorder.incidents == 1
    assert len(times(incident)) == 2
    (cut,) = [one for one in bench.events() if "ended early" in one.text]
    assert (cut.kind, cut.severity, cut.file) == (RecorderEventKind.INCIDENT, Severity.ERROR, incident.name)


def test_the_rings_share_their_memory(bench: Bench) -> None:
    """However much comes, from however many robots."""
    bench.recorder = Recorder(msgspec.structs.replace(PLAN, ring_bytes=10_000))
    for number in range(300):
        bench.receive(sample_of(gear(number), f"r-{number % 3}"))
        bench.run(10 * MS)
        assert bench.recorder.ring_bytes <= 10_000
    assert bench.recorder.ring_bytes > 5000


def test_a_loss_is_told_in_the_log_that_it_is_about(bench: Bench) -> None:
    """Also of a broken sample's topic, which is no key; once a second, all of a key together."""
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


def test_what_the_disk_lost_of_an_incident_is_no_loss_of_the_log(bench: Bench) -> None:
    """Nor is anything told of a log that nobody knows."""
    bench.receive(sample_of(gear(0)))
    for log in ("cruiser-1!", "nobody"):
        assert bench.recorder.receive_notice(Lost(log, {1: 1}, 0, 0), 0, WALL_NS) == []
    bench.run(REPORT_LOSSES_NS)
    assert bench.recorder.counts[GEAR_KEY].lost_disk == 0


def test_a_robot_whose_first_sample_is_dropped_is_asked_all_the_same(bench: Bench) -> None:
    """And its answer describes the log."""
    bench.recorder.drop(key_of(GatewayInfo), GapReason.QUEUE, 0, WALL_NS)
    assert list(bench.recorder._logs) == ["cruiser-1"]
    actions = bench.recorder.tick(0, WALL_NS, {})
    assert Query(key_of(GatewayInfo)) in actions
    bench.writer.apply(actions)
    bench.receive(sample_of(info()))
    bench.close()
    described = metadata(bench.logs()["cruiser-1"][0], "cruiser")
    assert described[-1]["cruiser-1.variant"] == "coarse"


def test_a_sample_that_is_too_large_is_counted_and_no_more(bench: Bench) -> None:
    """One byte less is recorded."""
    bench.receive(FakeSample("x", "x", bytes(1000)), FakeSample("x", "x", bytes(1001)))
    bench.run(REPORT_LOSSES_NS)
    assert bench.recorder.counts["x"] == KeyReport(received=2, written=1, lost_size=1)
    assert [(gap.key, gap.reason, gap.count) for gap in bench.gaps()] == [("x", GapReason.SIZE, 1)]


def test_what_is_said_is_numbered_and_said_in_every_log_that_is_written(bench: Bench) -> None:
    """A stop by the one who asked for it, what was deleted, and a disk that is full and is not any more."""
    bench.receive(sample_of(gear(0), "a"), sample_of(gear(0), "b"))
    bench.writer.apply(bench.recorder.receive_notice(Deleted("old.mcap", 5), 0, WALL_NS))
    bench.room(has_room=False)
    bench.room(has_room=False)
    bench.room()
    bench.stop()
    bench.stop()
    bench.room(has_room=False)
    bench.room()
    bench.start()
    bench.start()
    events = bench.events()
    assert [event.kind.value for event in events] == [
        *("deleted", "full", "full", "stopped", "full", "full", "started")
    ]
    assert [event.sequence for event in events] == list(range(7))
    assert [event.operator for event in events if event.operator] == ["operator-1", "operator-1"]
    bench.close()
    for files in bench.logs().values():
        # No file is being written when there is room again, nor at the start: nothing has come since.
        assert [len([1 for topic, _ in messages(file) if topic == f"{OWN}/event"]) for file in files] == [2]
    # What several logs hold is counted together.
    assert bench.recorder.counts[f"{OWN}/event"].written == 4


def test_a_file_says_why_the_one_before_it_ended(bench: Bench) -> None:
    """Whatever was asked for when none was being written."""
    bench.receive(sample_of(gear(0)))
    bench.notice()
    bench.room(roll=True)
    bench.writer.apply(bench.recorder.roll("signal", 0))
    bench.receive(sample_of(gear(1)))
    bench.stop()
    bench.start()
    bench.receive(sample_of(gear(2)))
    bench.close()
    _, second, third = bench.logs()["cruiser-1"]
    assert metadata(second, CONTINUED_NAME) == [{"file": "2", "because": "room"}]
    assert metadata(third, CONTINUED_NAME) == [{"file": "3", "because": "stopped"}]


@pytest.mark.parametrize(
    ("bring_about", "state"),
    [
        (lambda bench: bench.stop(), RecorderState.STOPPED),
        (lambda bench: bench.room(has_room=False), RecorderState.FULL),
    ],
)
def test_a_robot_that_turns_up_meanwhile_has_no_file(
    bench: Bench, bring_about: Callable[[Bench], None], state: RecorderState
) -> None:
    """Neither while it was stopped nor while the disk is full; what it declares is in the file that follows."""
    bring_about(bench)
    assert bench.recorder.state is state
    bench.receive(sample_of(gear(0)))
    assert (bench.writer.files, bench.recorder.writing, bench.recorder.files) == ({}, set(), {})
    bench.room()
    bench.start()
    bench.receive(sample_of(gear(1)))
    assert bench.recorder.writing == {"cruiser-1"}
    assert bench.recorder.files == {}
    bench.notice()
    assert bench.recorder.files == {"cruiser-1": "cruiser-1-0.mcap"}


def test_after_the_end_nothing_is_asked_for(bench: Bench) -> None:
    """Notices come after it, too; nobody would carry out what they cause."""
    bench.receive(sample_of(gear(0)))
    bench.mark()
    bench.writer.apply(bench.recorder.close(0, WALL_NS))
    for notice in [*bench.writer.notices, DiskRoom(has_room=False, has_incident_room=True), Deleted("x", 1)]:
        actions = bench.recorder.receive_notice(notice, 0, WALL_NS)
        assert not [one for one in actions if isinstance(one, LogAction)]
    bench.writer.notices.clear()


def test_an_incident_declares_what_its_log_did(bench: Bench) -> None:
    """With its attachments, and what is known of the robot; also what is declared while it lasts."""
    bench.receive(sample_of(gear(0)), sample_of(info()))
    assert set(bench.mark("cruiser-1")) == {"cruiser-1!"}
    bench.receive(sample_of(batch(0, [(WALL_NS, feedback(0))])))
    bench.close()
    (incident,) = bench.writer.files["cruiser-1!"]
    reader = make_reader(BytesIO(incident.disk.getvalue()))
    summary = reader.get_summary()
    assert summary is not None
    topics = [channel.topic for channel in summary.channels.values()]
    assert topics[:3] == [GEAR_KEY, key_of(GatewayInfo), key_of(CanFrames)]
    assert [one.name for one in reader.iter_metadata()] == ["cruiser", INCIDENT_NAME]
    attached = {one.name for one in reader.iter_attachments()}
    assert {"cruiser-1/configuration.toml", "cruiser-1/cruiser-coarse.dbc"} < attached


@pytest.mark.parametrize(
    "payload",
    [
        codec.encode(gear(3)).replace(b"drive", b"\xff\xfe\xff\xfe\xff"),
        b"\x81\xa1x" + b"\x91" * 100_000 + b"\xc0",
        b"",
    ],
)
def test_a_broken_payload_on_the_fast_path_is_kept_as_it_is(payload: bytes) -> None:
    """Text that is none, nesting without end: whatever decoding raises is no reason to stop."""
    bench = Bench(msgspec.structs.replace(PLAN, sample_max_bytes=1_000_000))
    good = sample_of(gear(0))
    broken = FakeSample(good.key, good.encoding, payload)
    bench.receive(*(sample_of(gear(number)) for number in range(3)), broken, sample_of(gear(3)))
    counts = bench.recorder.counts
    assert (counts[GEAR_KEY].written, counts[f"{GEAR_KEY}/@raw"].written) == (4, 1)


def test_an_incident_without_room_is_told(bench: Bench) -> None:
    """Nobody would look for what is not there."""
    bench.receive(sample_of(gear(0)))
    bench.room(has_incident_room=False)
    bench.receive(sample_of(safety_event(EventKind.STOP)))
    actions = bench.recorder.tick(SECOND, WALL_NS, {})
    bench.writer.apply(actions)
    (said,) = [one.message for one in actions if isinstance(one, Publish)]
    assert isinstance(said, RecorderEvent)
    assert (said.kind, said.severity) == (RecorderEventKind.INCIDENT, Severity.ERROR)
    assert "stop: as it were" in said.text
    assert bench.recorder.incidents == 0


def test_files_do_not_become_many_however_often_it_is_asked_for(bench: Bench) -> None:
    """One a second of each log; what comes too soon is one later, and nothing waits for a file that is ended."""
    for number in range(300):
        bench.receive(sample_of(gear(number)))
        bench.writer.apply(bench.recorder.roll("signal", bench.now_ns))
        bench.run(10 * MS)
    assert len(bench.logs()["cruiser-1"]) in {3, 4}
    bench.run(2 * SECOND)
    bench.receive(sample_of(gear(300)))
    files = len(bench.logs()["cruiser-1"])
    bench.run(5 * SECOND)
    assert len(bench.logs()["cruiser-1"]) == files
    assert bench.writer.open_file("cruiser-1") is not None


def test_a_file_that_the_disk_has_not_begun_is_not_ended_for_another() -> None:
    """While a disk hangs, what is to be begun does not pile up; when it goes on, the file is ended once."""
    plan = msgspec.structs.replace(PLAN, log=msgspec.structs.replace(PLAN.log, rotate_ns=2 * SECOND))
    bench = Bench(plan)
    for number in range(200):
        bench.receive(sample_of(gear(number)))
        bench.writer.apply(bench.recorder.roll("signal", bench.now_ns))
        bench.now_ns += 100 * MS
        bench.tick()
    assert len(bench.logs()["cruiser-1"]) == 1
    bench.notice()
    bench.tick()
    assert [file.is_ended for file in bench.logs()["cruiser-1"]] == [True]
    bench.close()


def test_a_key_that_is_a_lines_topic_is_another(bench: Bench) -> None:
    """Whichever comes first: what anybody publishes there is decoded as what it is, and so are the events."""
    intruder = FakeSample(f"{EVENT_KEY}/{LOG_CHUNK}", "zenoh/bytes", b"\xff\xfe")
    reserved = FakeSample(f"{EVENT_KEY}/@log", "zenoh/bytes", b"\xff\xfe")
    event = sample_of(safety_event(EventKind.LEASE))
    for robot, samples in (("a", [event, intruder, reserved]), ("b", [intruder, reserved, event])):
        moved = [FakeSample(one.key.replace("cruiser-1", robot), one.encoding, one.payload) for one in samples]
        bench.receive(*moved, *moved)
    bench.close()
    for robot, line in (("a", LOG_CHUNK), ("b", "@log")):
        (file,) = bench.logs()[robot]
        reader = make_reader(BytesIO(file.disk.getvalue()), decoder_factories=[DecoderFactory()])
        found: dict[str, list[tuple[str, Any]]] = {}
        for schema, channel, _, content in reader.iter_decoded_messages():
            assert schema is not None
            found.setdefault(channel.topic.removeprefix(f"fleet/{robot}/"), []).append((schema.name, content))
        names = {topic: {name for name, _ in pairs} for topic, pairs in found.items()}
        somebodys = f"safety/event/{LOG_CHUNK}" + ("/@raw" if line == LOG_CHUNK else "")
        assert names == {
            "safety/event": {"cruiser.SafetyEvent"},
            f"safety/event/{line}": {"foxglove.Log"},
            somebodys: {"cruiser.RawSample"},
            "safety/event/@log/@raw": {"cruiser.RawSample"},
        }
        assert all(content.payload == b"\xff\xfe" for _, content in found[somebodys])
        assert len(found[somebodys]) == 2


Step = str | int


@pytest.mark.parametrize(
    ("steps", "first", "second"),
    [
        # received, written, lost_full of each file
        ([100, "full", 100, "room", 100], (100, 100, 0), (200, 100, 100)),
        ([100, "stop", 100, "start", 100], (100, 100, 0), (100, 100, 0)),
        ([100, "full", 100, "stop", "room", "start", 100], (100, 100, 0), (200, 100, 100)),
        ([100, "full", 100, "stop", 50, "room", "start", 100], (100, 100, 0), (200, 100, 100)),
        ([100, "stop", 100, "full", "start", 50, "room", 100], (100, 100, 0), (150, 100, 50)),
        ([100, "full", 50, "stop", 50, "start", 50, "room", 100], (100, 100, 0), (200, 100, 100)),
        (["stop", 50, "start", 10, "stop", 20, "full", "start", 5, "room", 7], (10, 10, 0), (12, 7, 5)),
    ],
)
def test_a_file_counts_what_was_wanted_since_the_one_before_it(
    bench: Bench, steps: list[Step], first: tuple[int, ...], second: tuple[int, ...]
) -> None:
    """In whatever order a disk was full and somebody stopped it; what came while it was stopped is no loss."""
    sequence = 0
    do = {"full": lambda: bench.room(has_room=False), "room": bench.room, "stop": bench.stop, "start": bench.start}
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


def test_the_gaps_of_a_long_full_disk_are_in_the_next_file(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each is published in its second; in the file those of a key are one, so that it may last."""
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


def test_what_the_recorder_says_comes_back_and_is_recorded_once(bench: Bench) -> None:
    """Whoever records the recorders' keys gets its own, too; another recorder's are samples like any other."""
    bench.receive(sample_of(gear(0)))
    bench.mark()
    bench.notice()
    (said,) = bench.events()
    encoding, payload = BY_TYPE[RecorderEvent].encoding, codec.encode(said)
    bench.receive(*(FakeSample(f"fleet/@recorder/{name}/event", encoding, payload) for name in ("bench", "depot")))
    bench.recorder.drop(f"{OWN}/event", GapReason.QUEUE, 0, WALL_NS)
    bench.close()
    files = [file for files in bench.logs().values() for file in files]
    found = Counter(topic for file in files for topic, _ in messages(file))
    assert found[f"{OWN}/event"] == found["fleet/@recorder/depot/event"] == 1
    assert bench.recorder.counts[f"{OWN}/event"].lost_queue == 0


def test_keys_that_anybody_makes_up_take_nothing_from_the_tables(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However many came before it, a safety event makes its incident."""
    monkeypatch.setitem(channels.LIMITS, channels.ChannelQuota.OTHER, 10)
    bench.receive(*(FakeSample(f"fleet/cruiser-1/k/{number}", "x", b"") for number in range(60)))
    bench.receive(sample_of(safety_event(EventKind.STOP)))
    assert bench.recorder.incidents == 1
    assert bench.recorder.counts["@more"].written == 50
    assert bench.recorder.counts[f"{EVENT_KEY}/{LOG_CHUNK}"].written == 1


LONG_KEY: Final = f"fleet/cruiser-1/{'y' * keys.KEY_MAX_LENGTH}"


def test_very_long_keys_are_kept_and_not_remembered(bench: Bench) -> None:
    """Each with its sample, which is all; what is lost of them is counted without them."""
    monster = [FakeSample(f"{LONG_KEY}{number}", "x", b"") for number in range(20)]
    bench.receive(*monster)
    bench.receive(FakeSample(LONG_KEY, "x", bytes(2000)))
    bench.run(REPORT_LOSSES_NS)
    assert set(bench.recorder.counts) == {"@more", f"{OWN}/gap"}
    assert bench.recorder.counts["@more"] == KeyReport(received=21, written=20, lost_size=1)
    assert not bench.recorder._by_key
    assert [gap.key for gap in bench.gaps()] == [OTHER_KEYS]


def test_a_pass_ends_when_its_time_is_over(bench: Bench) -> None:
    """What there was no time for is still there; at least one is recorded."""
    for is_late, taken in ((lambda: False, 7), (lambda: True, 1)):
        waiting = iter([FakeSample("fleet/cruiser-1/k", "x", b"")] * 7)
        before = sum(count.received for count in bench.recorder.counts.values())
        bench.writer.apply(bench.recorder.receive(waiting, 0, is_late))
        assert sum(count.received for count in bench.recorder.counts.values()) - before == taken
        assert len(list(waiting)) == 7 - taken


def test_large_payloads_do_not_take_the_quick_way() -> None:
    """What they hold besides the fields may take long to go through: the time is looked at after each."""
    bench = Bench(msgspec.structs.replace(PLAN, sample_max_bytes=1_000_000))
    bench.receive(*(sample_of(gear(number)) for number in range(3)))
    large = msgspec.msgpack.encode({**msgspec.to_builtins(gear(3)), "more": bytes(QUICK_BYTES)})
    good = sample_of(gear(3))
    waiting = iter([FakeSample(good.key, good.encoding, large), sample_of(gear(4))])
    bench.writer.apply(bench.recorder.receive(waiting, 0, lambda: True))
    assert len(list(waiting)) == 1
    assert bench.recorder.counts[GEAR_KEY].written == 4
