"""Replay of a log: rows, samples, due times, and playing, with a fake clock."""

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from recorder import replay
from recorder.encoding.protobuf import LOGGED, compile_encoder
from recorder.reading.logs import Faults
from recorder.reading.rows import Row
from recorder.reading.survey import survey
from recorder.reading.topics import Topic
from recorder.replay import (
    AS_FAST_AS_POSSIBLE,
    ATTEND_NS,
    ENCODING_BYTES_MAX,
    FOR_EVER,
    LONGEST_PAUSE_NS,
    SLIP_NS,
    KeyMap,
    Pace,
    Played,
    ReplaySample,
    Samples,
    batch,
    may_hold,
    once,
    overlap,
    play,
    roots_of,
    runs,
    shifted,
    wants_of,
)
from schemas import codec, keys
from schemas.can_word import ERROR, EXTENDED, REMOTE
from schemas.command_line import CommandError, ExitCode
from schemas.messages import CanFrames, Gear, RawSample
from schemas.settings import BATCH_MAX_FRAMES
from schemas.subjects import ALL_SUBJECTS, BY_TYPE, RECORDER_SUBJECTS, Subject
from tests.support.drives import drive_samples, write_samples
from tests.support.messages import MS, ROBOT, SECOND, WALL_NS, FakeSample, can_frame, gear, key_of, sample_of
from tests.support.reading import logs_of, raw_row, row_of, rows_of, topic
from tests.support.strategies import message_of

RX = topic("fleet/cruiser-1/can/can0/rx")
TX = topic("fleet/cruiser-1/can/can0/tx")
RAW = topic("fleet/elsewhere", RawSample)


def frame_row(number: int, sequence: int, log_ms: int, of: Topic = RX) -> Row:
    return row_of(of, can_frame(time_ns=WALL_NS + number * MS), sequence, WALL_NS + log_ms * MS)


def test_an_incident_and_another_recorders_log_repeat_nothing(tmp_path: Path) -> None:
    samples = drive_samples(10)
    one = write_samples(tmp_path / "one.mcap", samples)
    two = write_samples(tmp_path / "two.mcap", samples[5:], offset_ns=53 * MS)
    alone = [(row.topic.name, row.sequence, row.data) for row in rows_of(one)]
    both = [(row.topic.name, row.sequence, row.data) for row in once(rows_of(one, two))]
    # What has no time of its own is not known again.
    assert sorted(row for row in both if row[0] != "fleet/elsewhere") == sorted(
        row for row in alone if row[0] != "fleet/elsewhere"
    )


def test_what_one_file_has_twice_was_twice() -> None:
    rows = [frame_row(1, 1, 5), frame_row(1, 1, 5)]
    assert list(once(rows)) == rows


def test_what_is_remembered_is_bounded() -> None:
    other = topic(RX.name)
    rows = [frame_row(number, number, number) for number in range(100)]
    again = [row_of(other, can_frame(time_ns=row.publish_ns), row.sequence) for row in rows]
    assert len(list(once([*rows, *again[-10:]], remembered=10))) == 100
    assert len(list(once([*rows, *again[:10]], remembered=10))) == 110


OTHER_ROW = Row(RAW, 0, WALL_NS + 50 * MS, WALL_NS, b"")


@pytest.mark.parametrize(
    ("rows", "found"),
    [
        # By their sequence and receipt, at the place of the first, each topic for itself.
        (
            [
                *(frame_row(number, 7, 50, of) for number, of in ((1, RX), (2, TX), (3, RX))),
                *(frame_row(4, 8, 50), frame_row(5, 9, 99)),
            ],
            [(RX, [1, 3]), (RX, [4]), (TX, [2]), (RX, [5])],
        ),
        # Other messages are runs of their own, at their place among the batches.
        (
            [frame_row(1, 1, 40), OTHER_ROW, OTHER_ROW, frame_row(2, 2, 60)],
            [(RX, [1]), (RAW, [0]), (RAW, [0]), (RX, [2])],
        ),
        # A log that puts all its frames into one batch is cut up.
        (
            [frame_row(number, 0, 0) for number in range(BATCH_MAX_FRAMES + 1)],
            [(RX, list(range(BATCH_MAX_FRAMES))), (RX, [BATCH_MAX_FRAMES])],
        ),
    ],
    ids=["batches", "others", "endless"],
)  # fmt: skip
def test_frames_of_one_batch_are_one_run(rows: list[Row], found: list[tuple[Topic, list[int]]]) -> None:
    assert [(run[0].topic, [(row.publish_ns - WALL_NS) // MS for row in run]) for run in runs(rows)] == found


def every_key(_key: str) -> bool:
    return True


def replayed(path: Path, root: str = "replay") -> tuple[list[ReplaySample], Samples]:
    found = Samples(KeyMap(root, roots_of(survey(logs_of(path), Faults()).topics.values())), every_key, Faults())
    return list(found.of(runs(rows_of(path)))), found


def test_the_payloads_are_those_that_were_recorded(tmp_path: Path) -> None:
    samples = drive_samples()
    found, _ = replayed(write_samples(tmp_path / "log.mcap", samples))
    assert [one.key for one in found] == ["replay" + one.key.removeprefix("fleet") for one in samples]
    assert [one.encoding for one in found] == [one.encoding for one in samples]
    assert [one.attachment for one in found] == [one.attachment for one in samples]
    batches = BY_TYPE[CanFrames].encoding
    for one, sample in zip(found, samples, strict=True):
        if sample.encoding != batches:
            assert one.payload() == sample.payload
            continue
        # Of a batch the log does not keep its own time, which is that of its last frame at the earliest.
        was, now = codec.decode(BY_TYPE[CanFrames], sample.payload), one.message
        assert isinstance(was, CanFrames)
        assert isinstance(now, CanFrames)
        assert now == shifted_to(was, max(was.frame_time_ns))


def shifted_to(one: CanFrames, time_ns: int) -> CanFrames:
    return CanFrames(
        time_ns, one.sequence, one.bus, 0, one.frame_time_ns, one.can_id, one.fd_flags, one.length, one.data
    )


PLAIN_SUBJECTS = [subject for subject in ALL_SUBJECTS if subject.type is not CanFrames]


@pytest.mark.parametrize("subject", PLAIN_SUBJECTS, ids=lambda subject: subject.schema_name)
@given(data=st.data())
def test_every_message_comes_back_as_it_was(subject: Subject, data: st.DataObject) -> None:
    message = data.draw(message_of(subject.type))
    is_own = subject in RECORDER_SUBJECTS
    key = keys.of_recorder("fleet", "bench", subject.name) if is_own else keys.build("fleet", ROBOT, subject)
    of = topic(key, subject.type)
    row = Row(of, message.sequence, WALL_NS, WALL_NS, compile_encoder(subject.type)(message))
    faults = Faults()
    (found,) = Samples(KeyMap("replay", ["fleet"]), every_key, faults).of([[row]])
    assert found.encoding == subject.encoding
    assert codec.decode(subject, found.payload()) == message
    assert not faults


def test_frames_become_the_words_that_they_were() -> None:
    found = batch(
        [
            can_frame(0x123, WALL_NS + 5, b"", is_extended=False, is_remote=True),
            can_frame(0x18C4D1EF, WALL_NS),
            can_frame(4, WALL_NS + 2, is_extended=False, is_error=True),
        ],
        9,
    )
    assert found.can_id == [0x123 | REMOTE, 0x18C4D1EF | EXTENDED, 4 | ERROR]
    assert (found.sequence, found.time_ns, found.dropped) == (9, WALL_NS + 5, 0)


def test_a_command_is_never_published() -> None:
    new_key = KeyMap("replay", ["fleet"])
    of = topic("fleet/cruiser-1/@cmd/operator-1/stop", RawSample)
    samples = Samples(new_key, every_key, Faults())
    commands = [
        "fleet/cruiser-1/@cmd/operator-1/stop",
        "@cmd",
        "@cmd/x",
        "a/@cmd",
        "fleet/@recorder/bench/@cmd/operator-1/stop",
    ]
    rows = [raw_row(of, RawSample(0, key, "", b"", b"", "")) for key in commands]
    assert list(samples.of([row] for row in rows)) == []
    assert samples.withheld == len(commands)


def test_an_encoding_that_is_too_long_for_zenoh_is_withheld() -> None:
    of = topic("fleet/thing/@raw", RawSample)
    samples = Samples(KeyMap("replay", ["fleet"]), every_key, Faults())
    longest = "x" * ENCODING_BYTES_MAX
    said = [RawSample(0, "fleet/thing", one, b"", b"", "") for one in (longest, f"{longest}x", f"{longest[1:]}é")]
    assert [one.encoding for one in samples.of([raw_row(of, raw)] for raw in said)] == [longest]
    assert samples.withheld == 2


@pytest.mark.parametrize(
    ("roots", "key", "new_key"),
    [
        # A key that names several things, or none, is never published.
        *(
            ("fleet", key, None)
            for key in ("**", "fleet/*/state", "fleet/$*/x", "", "/x", "x/", "x//y", "x?y", "x#y")
        ),
        # A root of several chunks is one root; others, and what only begins like it, are put behind the new one.
        ("site/fleet", "site/fleet/cruiser-1/state", "replay/cruiser-1/state"),
        ("site/fleet", "site/fleets/x", "replay/site/fleets/x"),
        ("site/fleet", "x/y", "replay/x/y"),
        # Where a log has several roots, each is kept: two robots of one name stay two.
        ("fleet other", "fleet/cruiser-1/state", "replay/fleet/cruiser-1/state"),
        ("fleet other", "other/cruiser-1/state", "replay/other/cruiser-1/state"),
    ],
)
def test_a_key_is_put_under_the_new_root(roots: str, key: str, new_key: str | None) -> None:
    assert KeyMap("replay", roots.split())(key) == new_key


@given(st.text(max_size=40))
def test_whatever_a_log_says_stays_under_the_root(key: str) -> None:
    found = KeyMap("replay", ["fleet"])(key)
    if found is not None:
        assert found.startswith("replay/")
        assert "@cmd" not in found.split("/")
        assert not set("*$?#") & set(found)


@pytest.mark.parametrize(
    ("one", "other", "is_one"),
    [
        ("fleet", "fleet", True),
        ("fleet", "fleet/old", True),
        ("a/b", "a", True),
        ("fleet", "fleets", False),
        ("replay", "fleet", False),
    ],
)
def test_roots_overlap_by_chunks(one: str, other: str, is_one: bool) -> None:  # noqa: FBT001 - a column of the table
    """A recorder of fleet also records fleet/old."""
    assert overlap(one, other) is is_one
    assert overlap(other, one) is is_one


def test_what_never_was_a_sample_is_passed_over() -> None:
    assert not may_hold(topic("fleet/cruiser-1/safety/event/log", Gear), every_key)
    assert not may_hold(topic("fleet/cruiser-1/state", Gear), every_key)
    assert may_hold(topic(key_of(Gear), Gear), every_key)
    samples = Samples(KeyMap("replay", []), every_key, Faults())
    wrong = topic("fleet/cruiser-1/state", Gear)
    assert list(samples.of([[Row(wrong, 0, WALL_NS, WALL_NS, b"")]])) == []


def test_broken_samples_are_published_as_they_were(tmp_path: Path) -> None:
    broken = FakeSample(key_of(Gear), BY_TYPE[Gear].encoding, b"\xc1broken")
    gone = FakeSample("fleet/elsewhere", "zenoh/bytes", b"", deleted=True)
    found, _ = replayed(write_samples(tmp_path / "log.mcap", [sample_of(gear(0)), broken, gone]))
    assert [(one.key, one.payload(), one.is_delete) for one in found[1:]] == [
        ("replay/cruiser-1/chassis/gear", broken.payload, False),
        ("replay/elsewhere", b"", True),
    ]


def test_only_wanted_keys_are_published() -> None:
    def wants(key: str) -> bool:
        return key == "wanted/x"

    shared = topic("@more", RawSample)
    assert may_hold(shared, wants)
    assert not may_hold(topic("other/@raw", RawSample), wants)
    assert may_hold(topic("wanted/x/@raw", RawSample), wants)
    samples = Samples(KeyMap("replay", []), wants, Faults())
    rows = [raw_row(shared, RawSample(0, key, "", b"", b"", "")) for key in ("wanted/x", "other")]
    assert [one.key for one in samples.of([row] for row in rows)] == ["replay/wanted/x"]
    assert samples.withheld == 0


def test_all_receive_times_move_together() -> None:
    one = batch([can_frame(time_ns=WALL_NS), can_frame(time_ns=WALL_NS + MS)], 3)
    later = shifted(one, 5 * MS)
    assert isinstance(later, CanFrames)
    assert later.frame_time_ns == [WALL_NS + 5 * MS, WALL_NS + 6 * MS]
    assert (later.time_ns, later.sequence, later.data) == (WALL_NS + 6 * MS, 3, one.data)
    assert shifted(gear(1), -(2**63)).time_ns == 0
    assert shifted(gear(1), 2**63).time_ns == 2**63 - 1
    sample = ReplaySample(WALL_NS, "replay/x", "", raw=b"as it was")
    assert sample.payload(MS) == b"as it was"


@given(st.sampled_from(LOGGED), st.binary(max_size=60))
def test_bytes_that_are_no_message_are_a_fault(kind: type[msgspec.Struct], data: bytes) -> None:
    name = "fleet/elsewhere" if kind is RawSample else "fleet/cruiser-1/can/can0/rx"
    subject = next((one for one in ALL_SUBJECTS if one.type is kind), None)
    if subject is not None and subject.type is not CanFrames:
        name = f"fleet/cruiser-1/{subject.name}"
    of = topic(name, kind)
    faults = Faults()
    row = Row(of, 0, WALL_NS, WALL_NS, data)
    found = list(Samples(KeyMap("replay", ["fleet"]), every_key, faults).of([[row]]))
    assert len(found) + faults.count <= 1
    for one in found:
        one.payload()


HOUR = 3600 * SECOND


@pytest.mark.parametrize(
    ("speed", "offsets_ns", "due_ns", "cut"),
    [
        # What is 600 ns behind the first one is due after that time, divided by the speed.
        *(
            (speed, [0, 600], [0, wanted], 0)
            for speed, wanted in {1: 600, 2: 300, 0.5: 1200, 10: 60, AS_FAST_AS_POSSIBLE: 0}.items()
        ),
        # What is a little out of order is late, and holds nothing up.
        (1, [0, 900 * MS, 200 * MS, SECOND], [0, 900 * MS, 900 * MS, SECOND], 0),
        # Where it is far behind, the clock was set back: the replay goes on from there at its pace.
        (1, [HOUR, 0, 5, 10], [0, 0, 5, 10], 0),
        # A log of two days is not watched overnight; the pauses are counted, and divided by the speed too.
        (
            1,
            [0, LONGEST_PAUSE_NS, HOUR, HOUR + 5],
            [0, *(n * LONGEST_PAUSE_NS for n in (1, 2)), 120 * SECOND + 5],
            1,
        ),
        (2, [0, HOUR], [0, LONGEST_PAUSE_NS // 2], 1),
    ],
)
def test_when_what_is_so_far_into_a_log_is_due(
    speed: float, offsets_ns: list[int], due_ns: list[int], cut: int
) -> None:
    pace = Pace(speed)
    pace.start(5000)
    assert [pace.due_ns(WALL_NS + offset_ns) - 5000 for offset_ns in offsets_ns] == due_ns
    assert pace.cut == cut


@given(st.lists(st.integers(0, 20_000_000), min_size=1, max_size=300), st.sampled_from([1.0, 3.0, 0.7, 10.0]))
def test_nothing_adds_up(steps_ns: list[int], speed: float) -> None:
    pace = Pace(speed)
    times = [sum(steps_ns[:number]) for number in range(len(steps_ns) + 1)]
    found = [pace.due_ns(WALL_NS + time) for time in times]
    assert found == [round(time / speed) for time in times]
    assert found == sorted(found)


OVER = CommandError("it is over", ExitCode.UNREACHABLE)


class Rig:
    """A log with a sample each 0.1 s, a slow outlet, and a clock; ``sent`` has time, sample and shift in ms."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, length: int = 10) -> None:
        self.begun_ns = self.now_ns = 77 * SECOND
        self.length = length
        self.sent: list[tuple[int, int, int]] = []
        self.attended: list[int] = []
        self.takes_ns = self.reading_ns = 0
        self.halts_at_ns = self.stops_at_ns = 10**18
        clock = SimpleNamespace(
            monotonic_ns=lambda: self.now_ns, time_ns=lambda: self.now_ns + 2 * WALL_NS, sleep=self.sleep
        )
        monkeypatch.setattr(replay, "time", clock)

    def sleep(self, wait_s: float) -> None:
        assert wait_s > 0, "waits for nothing"
        self.now_ns += round(wait_s * 1e9)

    def read(self) -> Iterator[ReplaySample]:
        self.now_ns += self.reading_ns
        return (ReplaySample(WALL_NS + number * 100 * MS, "", "") for number in range(self.length))

    def send(self, item: ReplaySample, shift_ns: int) -> None:
        self.sent.append(((self.now_ns - self.begun_ns) // MS, (item.time_ns - WALL_NS) // MS, shift_ns))
        self.now_ns += self.takes_ns

    def attend(self) -> CommandError | None:
        self.attended.append(self.now_ns)
        return OVER if self.now_ns - self.begun_ns >= self.halts_at_ns else None

    def play(self, speed: float = 1, loops: int = 1, *, is_now: bool = False) -> Played:
        def stopped() -> bool:
            return self.now_ns - self.begun_ns >= self.stops_at_ns

        return play(self.read, Pace(speed), self, stopped, loops=loops, is_now=is_now)


def every_100_ms(number: int, begin_ms: int = 0, step_ms: int = 100) -> list[tuple[int, int, int]]:
    return [(begin_ms + step_ms * one, 100 * one, 0) for one in range(number)]


@pytest.mark.parametrize(
    ("given_", "speed", "loops", "sent", "played"),
    [
        # To the moment, at any speed.
        ({}, 2, 1, every_100_ms(10, step_ms=50), Played(1, has_ended=True)),
        # What a slow outlet takes is made up for in the waiting: it adds no drift.
        ({"length": 60, "takes_ns": 30 * MS}, 1, 1, every_100_ms(60), Played(1, has_ended=True)),
        # Finding the beginning makes nothing late, however long it takes.
        ({"reading_ns": 500 * MS}, 1, 1, every_100_ms(10, 500), Played(1, has_ended=True)),
        # An empty log ends at once, even one that is to be played for ever.
        ({"length": 0}, 1, FOR_EVER, [], Played(0, has_ended=True)),
        # A loop goes on where the last round was due.
        ({"length": 2}, 1, 2, [*every_100_ms(2), *every_100_ms(2, 100)], Played(2, has_ended=True)),
        # It can be stopped, also one that would go on for ever.
        ({"length": 2, "stops_at_ns": 150 * MS}, 1, FOR_EVER, [*every_100_ms(2), (100, 0, 0)], Played(2)),
        # What ends it is told from the first look on, and between the last look and the end.
        ({"halts_at_ns": 0}, 1, 1, [], Played(1, halt=OVER)),
        (
            {"length": 1, "takes_ns": 1, "halts_at_ns": 1},
            1,
            1,
            every_100_ms(1),
            Played(1, has_ended=True, halt=OVER),
        ),
        # After a stop of the process nothing comes in a burst; how far it fell behind is told.
        (
            {"length": 3, "takes_ns": SLIP_NS + 101 * MS},
            1,
            1,
            [(0, 0, 0), (1101, 100, 0), (2202, 200, 0)],
            Played(1, SLIP_NS + MS, 2 * (SLIP_NS + MS), has_ended=True),
        ),
    ],
    ids=["fast", "a slow outlet", "a late beginning", "empty", "loops", "stopped", "halted", "late halt", "slips"],
)
def test_each_is_sent_when_it_is_due(
    monkeypatch: pytest.MonkeyPatch,
    given_: dict[str, int],
    speed: float,
    loops: int,
    sent: list[tuple[int, int, int]],
    played: Played,
) -> None:
    rig = Rig(monkeypatch)
    for knob, value in given_.items():
        setattr(rig, knob, value)
    assert rig.play(speed, loops) == played
    assert rig.sent == sent
    pauses = [later - earlier for earlier, later in zip(rig.attended, rig.attended[1:], strict=False)]
    assert max(pauses, default=0) <= ATTEND_NS + rig.takes_ns


def test_the_outlet_is_looked_after_when_there_is_no_time_to_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = Rig(monkeypatch, 10_000)
    rig.takes_ns, rig.halts_at_ns = MS, SECOND
    assert rig.play(AS_FAST_AS_POSSIBLE) == Played(1, halt=OVER)
    assert 1000 <= len(rig.sent) <= 1000 + ATTEND_NS // MS


@pytest.mark.parametrize("speed", [1.0, 4.0, AS_FAST_AS_POSSIBLE])
def test_the_present_is_that_of_sending(monkeypatch: pytest.MonkeyPatch, speed: float) -> None:
    rig = Rig(monkeypatch)
    rig.takes_ns = MS
    rig.play(speed, is_now=True)
    assert len(rig.sent) == 10
    for at_ms, offset_ms, shift_ns in rig.sent:
        assert WALL_NS + offset_ms * MS + shift_ns == rig.begun_ns + at_ms * MS + 2 * WALL_NS


def test_a_key_expression_is_checked_before_anything_is_sent() -> None:
    with pytest.raises(CommandError, match="no key expression") as caught:
        wants_of(["fleet//x"])
    assert caught.value.code is ExitCode.USAGE


@pytest.mark.parametrize(
    ("expression", "key", "is_wanted"),
    [
        ("fleet/**/**", "fleet/cruiser-1/chassis/gear", True),
        ("fleet/*/chassis/*", "fleet/cruiser-1/chassis/gear", True),
        ("fleet/cruiser-2/**", "fleet/cruiser-1/chassis/gear", False),
        ("fleet/**", "fleet/@recorder/depot/health", False),
        ("@more", "@more", True),
        ("**", "no//key", False),
    ],
)
def test_keys_match_as_they_do_in_zenoh(expression: str, key: str, is_wanted: bool) -> None:  # noqa: FBT001 - pytest gives it
    assert wants_of(["elsewhere", expression])(key) is is_wanted
