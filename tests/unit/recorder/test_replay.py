"""A log published again: its rows, the samples that they were, when each is due, and playing. No real clock."""

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

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
    SET_BACK_AFTER,
    SLIP_NS,
    By,
    Due,
    Halt,
    KeyMap,
    Lateness,
    Pace,
    ReplayRun,
    ReplaySample,
    ReplayScheduler,
    Samples,
    batch,
    in_order,
    key_checked,
    key_matches,
    may_hold,
    once,
    overlap,
    play,
    root_of_token,
    roots_of,
    runs,
    shifted,
)
from schemas import codec, keys
from schemas.can_word import ERROR, EXTENDED, REMOTE
from schemas.command_line import CommandError, ExitCode
from schemas.messages import CanFrames, Gear, RawSample
from schemas.settings import BATCH_MAX_FRAMES
from schemas.subjects import ALL_SUBJECTS, BY_TYPE, RECORDER_SUBJECTS, Subject
from tests.support.drives import drive_samples, write_samples
from tests.support.fakes.replay import HALT, FakeClock, FakeOutlet
from tests.support.messages import MS, ROBOT, SECOND, WALL_NS, FakeSample, can_frame, gear, key_of, sample_of
from tests.support.reading import logs_of, raw_row, row_of, rows_of, topic
from tests.support.strategies import message_of

RX = topic("fleet/cruiser-1/can/can0/rx")
TX = topic("fleet/cruiser-1/can/can0/tx")
RAW = topic("fleet/elsewhere", RawSample)


def frame_row(number: int, sequence: int, log_ms: int, of: Topic = RX) -> Row:
    """A frame of 1 ms times its number."""
    return row_of(of, can_frame(time_ns=WALL_NS + number * MS), sequence, WALL_NS + log_ms * MS)


def test_an_incident_and_another_recorders_log_repeat_nothing(tmp_path: Path) -> None:
    """What two files hold comes once, whenever each recorder received it."""
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
    """Two frames of one moment are two frames."""
    rows = [frame_row(1, 1, 5), frame_row(1, 1, 5)]
    assert list(once(rows)) == rows


def test_what_is_remembered_is_bounded() -> None:
    """Files that repeat each other do so at about the same time; what is long past is forgotten."""
    other = topic(RX.name)
    rows = [frame_row(number, number, number) for number in range(100)]
    again = [row_of(other, can_frame(time_ns=row.publish_ns), row.sequence) for row in rows]
    assert len(list(once([*rows, *again[-10:]], remembered=10))) == 100
    assert len(list(once([*rows, *again[:10]], remembered=10))) == 110


OTHER_ROW = Row(RAW, 0, WALL_NS + 50 * MS, WALL_NS, b"")


@pytest.mark.parametrize(
    ("rows", "by", "found"),
    [
        # By their sequence and receipt, at the place of the first, each topic for itself.
        (
            [
                *(frame_row(number, 7, 50, of) for number, of in ((1, RX), (2, TX), (3, RX))),
                *(frame_row(4, 8, 50), frame_row(5, 9, 99)),
            ],
            By.LOG,
            [(RX, [1, 3], 50), (RX, [4], 50), (TX, [2], 50), (RX, [5], 99)],
        ),
        # A batch was published when its last frame had come.
        ([frame_row(1, 7, 50), frame_row(3, 7, 50)], By.PUBLISH, [(RX, [1, 3], 3)]),
        # Other messages are runs of their own, at their place among the batches.
        (
            [frame_row(1, 1, 40), OTHER_ROW, OTHER_ROW, frame_row(2, 2, 60)],
            By.LOG,
            [(RX, [1], 40), (RAW, [0], 50), (RAW, [0], 50), (RX, [2], 60)],
        ),
        # A log that puts all its frames into one batch is cut up.
        (
            [frame_row(number, 0, 0) for number in range(BATCH_MAX_FRAMES + 1)],
            By.LOG,
            [(RX, list(range(BATCH_MAX_FRAMES)), 0), (RX, [BATCH_MAX_FRAMES], 0)],
        ),
    ],
    ids=["batches", "published", "others", "endless"],
)  # fmt: skip
def test_frames_of_one_batch_are_one_run(
    rows: list[Row], by: By, found: list[tuple[Topic, list[int], int]]
) -> None:
    """Each with its topic, the numbers of its rows and its time."""
    assert [
        (run.topic, [(row.publish_ns - WALL_NS) // MS for row in run.rows], (run.time_ns - WALL_NS) // MS)
        for run in runs(rows, by)
    ] == found


@given(st.lists(st.integers(0, 50), min_size=1, max_size=200), st.integers(1, 20))
def test_what_is_a_little_out_of_order_is_sorted(late_ms: list[int], every_ms: int) -> None:
    """Frames that reached the recorder up to the horizon late come in their order; nothing is lost."""
    rows = [
        row_of(
            RX,
            can_frame(time_ns=WALL_NS + number * every_ms * MS),
            number,
            WALL_NS + (number * every_ms + late) * MS,
        )
        for number, late in enumerate(late_ms)
    ]
    rows.sort(key=lambda row: row.log_ns)
    found = list(in_order(runs(rows, By.PUBLISH), horizon_ns=60 * MS))
    assert len(found) == len(rows)
    assert all(one.time_ns <= other.time_ns for one, other in pairwise(found))


def test_what_is_very_late_comes_late() -> None:
    """And holds nothing up: what is sorted is bounded in time and in number."""
    rows = [frame_row(number, number, number) for number in range(0, 10_000, 10)]
    late = frame_row(5, 1, 5_000)
    rows.insert(501, late)
    found = [run.rows[0] for run in in_order(runs(rows, By.PUBLISH), horizon_ns=SECOND)]
    assert len(found) == len(rows)
    assert 300 < found.index(late) <= 501
    held: list[int] = []

    def counted() -> Iterator[ReplayRun]:
        for number, run in enumerate(runs(rows, By.PUBLISH)):
            held.append(number)
            yield run

    for given_out, _ in enumerate(in_order(counted(), horizon_ns=10**18, limit=50)):
        assert held[-1] - given_out <= 51


def every_key(_key: str) -> bool:
    """Wants all."""
    return True


def replayed(path: Path, root: str = "replay") -> tuple[list[ReplaySample], Samples]:
    """All samples of a log."""
    found = Samples(KeyMap(root, roots_of(survey(logs_of(path), Faults()).topics.values())), every_key, Faults())
    return list(found.of(runs(rows_of(path), By.LOG))), found


def test_the_payloads_are_those_that_were_recorded(tmp_path: Path) -> None:
    """Byte by byte, in their order, with their encoding and attachment, under the other root."""
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
    """With another time of its own, and the frames' as they were."""
    return CanFrames(
        time_ns, one.sequence, one.bus, 0, one.frame_time_ns, one.can_id, one.fd_flags, one.length, one.data
    )


PLAIN_SUBJECTS = [subject for subject in ALL_SUBJECTS if subject.type is not CanFrames]


@pytest.mark.parametrize("subject", PLAIN_SUBJECTS, ids=lambda subject: subject.schema_name)
@given(data=st.data())
def test_every_message_comes_back_as_it_was(subject: Subject, data: st.DataObject) -> None:
    """Of every subject, whatever its fields hold: record, typed message, payload."""
    message = data.draw(message_of(subject.type))
    is_own = subject in RECORDER_SUBJECTS
    key = keys.of_recorder("fleet", "bench", subject.name) if is_own else keys.build("fleet", ROBOT, subject)
    of = topic(key, subject.type)
    row = Row(of, message.sequence, WALL_NS, WALL_NS, compile_encoder(subject.type)(message))
    faults = Faults()
    (found,) = Samples(KeyMap("replay", ["fleet"]), every_key, faults).of([ReplayRun(WALL_NS, of, [row])])
    assert found.encoding == subject.encoding
    assert codec.decode(subject, found.payload()) == message
    assert not faults


def test_frames_become_the_words_that_they_were() -> None:
    """Identifier and kind in one."""
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
    """Whatever the log holds, and whoever asks for it."""
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
    assert list(samples.of(ReplayRun(WALL_NS, of, [row]) for row in rows)) == []
    assert samples.withheld == len(commands)


def test_an_encoding_that_is_too_long_for_zenoh_is_withheld() -> None:
    """In bytes, not in characters."""
    of = topic("fleet/thing/@raw", RawSample)
    samples = Samples(KeyMap("replay", ["fleet"]), every_key, Faults())
    longest = "x" * ENCODING_BYTES_MAX
    said = [RawSample(0, "fleet/thing", one, b"", b"", "") for one in (longest, f"{longest}x", f"{longest[1:]}é")]
    assert [one.encoding for one in samples.of(ReplayRun(WALL_NS, of, [raw_row(of, raw)]) for raw in said)] == [
        longest
    ]
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
    """A log may hold anything."""
    assert KeyMap("replay", roots.split())(key) == new_key


@given(st.text(max_size=40))
def test_whatever_a_log_says_stays_under_the_root(key: str) -> None:
    """And is no command, and reaches one key alone."""
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
    """What is under fleet/old is recorded by whoever records fleet."""
    assert overlap(one, other) is is_one
    assert overlap(other, one) is is_one


def test_the_root_of_a_gateway_is_all_before_its_robot() -> None:
    """As its token has it."""
    assert root_of_token(keys.liveliness("site/fleet", "cruiser-1")) == "site/fleet"


def test_what_never_was_a_sample_is_passed_over() -> None:
    """Lines for viewers, other makers' messages, and a schema of ours under a key of another."""
    assert not may_hold(topic("fleet/cruiser-1/safety/event/log", Gear), every_key)
    assert not may_hold(topic("fleet/cruiser-1/state", Gear), every_key)
    assert may_hold(topic(key_of(Gear), Gear), every_key)
    samples = Samples(KeyMap("replay", []), every_key, Faults())
    wrong = topic("fleet/cruiser-1/state", Gear)
    assert list(samples.of([ReplayRun(WALL_NS, wrong, [Row(wrong, 0, WALL_NS, WALL_NS, b"")])])) == []


def test_broken_samples_are_published_as_they_were(tmp_path: Path) -> None:
    """Under the key that they had, and those that say that a key is gone say so again."""
    broken = FakeSample(key_of(Gear), BY_TYPE[Gear].encoding, b"\xc1broken")
    gone = FakeSample("fleet/elsewhere", "zenoh/bytes", b"", deleted=True)
    found, _ = replayed(write_samples(tmp_path / "log.mcap", [sample_of(gear(0)), broken, gone]))
    assert [(one.key, one.payload(), one.is_delete) for one in found[1:]] == [
        ("replay/cruiser-1/chassis/gear", broken.payload, False),
        ("replay/elsewhere", b"", True),
    ]


def test_only_wanted_keys_are_published() -> None:
    """Of a channel that samples of several keys share, too: each tells its own."""

    def wants(key: str) -> bool:
        return key == "wanted/x"

    shared = topic("@more", RawSample)
    assert may_hold(shared, wants)
    assert not may_hold(topic("other/@raw", RawSample), wants)
    assert may_hold(topic("wanted/x/@raw", RawSample), wants)
    samples = Samples(KeyMap("replay", []), wants, Faults())
    rows = [raw_row(shared, RawSample(0, key, "", b"", b"", "")) for key in ("wanted/x", "other")]
    assert [one.key for one in samples.of(ReplayRun(WALL_NS, shared, [row]) for row in rows)] == [
        "replay/wanted/x"
    ]
    assert samples.withheld == 0


def test_all_receive_times_move_together() -> None:
    """Of the message and of the frames in it; nothing else moves, and no time leaves its bounds."""
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
    """Told and passed over; what can be read all the same is a sample."""
    name = "fleet/elsewhere" if kind is RawSample else "fleet/cruiser-1/can/can0/rx"
    subject = next((one for one in ALL_SUBJECTS if one.type is kind), None)
    if subject is not None and subject.type is not CanFrames:
        name = f"fleet/cruiser-1/{subject.name}"
    of = topic(name, kind)
    faults = Faults()
    row = Row(of, 0, WALL_NS, WALL_NS, data)
    found = list(Samples(KeyMap("replay", ["fleet"]), every_key, faults).of([ReplayRun(WALL_NS, of, [row])]))
    assert len(found) + faults.count <= 1
    for one in found:
        one.payload()


FOR_NO_PAUSE = 10**18
BEGUN_NS = 5_000


def pace(speed: float = 1, longest_pause_ns: int = FOR_NO_PAUSE) -> Pace:
    """A pace that was started."""
    one = Pace(speed, longest_pause_ns)
    one.start(BEGUN_NS)
    return one


def dues(one: Pace, *offsets_ns: int) -> list[int]:
    """The due times, from the start on, of what is so far into the log."""
    return [one.due_ns(WALL_NS + offset_ns) - BEGUN_NS for offset_ns in offsets_ns]


HOUR = 3600 * SECOND


@pytest.mark.parametrize(
    ("one", "offsets_ns", "due_ns", "cut"),
    [
        # What is 600 ns behind the first one is due after that time, divided by the speed.
        *(
            (pace(speed), [0, 600], [0, wanted], 0)
            for speed, wanted in {1: 600, 2: 300, 0.5: 1200, 10: 60, AS_FAST_AS_POSSIBLE: 0}.items()
        ),
        # A message that was asked for later stands late in the log, and holds nothing up.
        (pace(), [0, 9 * SECOND, 2 * SECOND, 9 * SECOND + 1], [0, 9 * SECOND, 9 * SECOND, 9 * SECOND + 1], 0),
        # A log of two days is not watched overnight; the pauses are counted.
        (
            pace(1, 10 * SECOND),
            [0, 10 * SECOND, HOUR, HOUR + SECOND],
            [0, 10 * SECOND, 20 * SECOND, 21 * SECOND],
            1,
        ),
        # At twice the speed a cut pause takes half as long.
        (pace(2, 10 * SECOND), [0, HOUR], [0, 5 * SECOND], 1),
    ],
)
def test_when_what_is_so_far_into_a_log_is_due(
    one: Pace, offsets_ns: list[int], due_ns: list[int], cut: int
) -> None:
    """By its time in the log, the speed, and how long a pause may be."""
    assert dues(one, *offsets_ns) == due_ns
    assert one.cut == cut


@given(st.lists(st.integers(0, 20_000_000), min_size=1, max_size=300), st.sampled_from([1.0, 3.0, 0.7, 10.0]))
def test_nothing_adds_up(steps_ns: list[int], speed: float) -> None:
    """After any number of steps the due time is that of the whole way, to the nanosecond, and none steps back."""
    one = pace(speed)
    times = [sum(steps_ns[:number]) for number in range(len(steps_ns) + 1)]
    found = dues(one, *times)
    assert found == [round(time / speed) for time in times]
    assert found == sorted(found)


def test_a_clock_that_was_set_back_is_followed() -> None:
    """Where all that follows is earlier the clock was set back, and the replay goes on from there at its pace."""
    one = pace()
    one.due_ns(WALL_NS + 3600 * SECOND)
    found = [one.due_ns(WALL_NS + number * MS) - BEGUN_NS for number in range(2 * SET_BACK_AFTER)]
    assert found[: SET_BACK_AFTER + 1] == [0] * (SET_BACK_AFTER + 1)
    assert found[-1] == (2 * SET_BACK_AFTER - 1 - SET_BACK_AFTER) * MS


@given(st.lists(st.integers(0, 3_000_000_000), min_size=1, max_size=200), st.floats(0.01, 1))
def test_lateness_is_told_to_a_bucket(late_ns: list[int], part: float) -> None:
    """At least this part was no later than what is told, and what is told is not 0.1 ms too much, up to 2 s."""
    lateness = Lateness()
    for one in late_ns:
        lateness.add(one)
    told = lateness.quantile_ns(part)
    exact = sorted(late_ns)[max(0, -int(-part * len(late_ns) // 1) - 1)]
    assert exact <= told <= max(late_ns)
    assert told - exact <= 100_000 or told > 2 * SECOND
    assert lateness.max_ns == max(late_ns)


def test_no_lateness_is_none() -> None:
    """Of nothing, and of what came early."""
    lateness = Lateness()
    assert lateness.quantile_ns(0.99) == 0
    lateness.add(-5)
    assert lateness.quantile_ns(0.99) == lateness.max_ns == 0


def mark(time_ns: int) -> ReplaySample:
    """Something with a time."""
    return ReplaySample(time_ns, "", "")


class Tape:
    """A log of so many samples, 100 ns apart; counts how often it was read."""

    def __init__(self, count: int) -> None:
        self.times = [WALL_NS + number * 100 for number in range(count)]
        self.reads = 0

    def read(self) -> Iterator[ReplaySample]:
        self.reads += 1
        return map(mark, self.times)


def taken(player: ReplayScheduler, now_ns: int) -> list[int]:
    """All that is due, as offsets into the log."""
    found = []
    while (due := player.take(now_ns)) is not None:
        found.append(due.item.time_ns - WALL_NS)
    return found


def started(tape: Tape, speed: float = 1, loops: int = 1) -> ReplayScheduler:
    """A player that plays since the time 0."""
    player = ReplayScheduler(tape.read, Pace(speed, FOR_NO_PAUSE), loops)
    player.start(0)
    return player


@pytest.mark.parametrize(
    ("count", "speed", "loops", "steps", "ends", "late_ns"),
    [
        # What is due comes out in its order when its time has come, and nothing else.
        (4, 1, 1, [(0, [0], 100), (99, [], 100), (250, [100, 200], 300), (300, [300], None)], (True, 1, 1), 150),
        # An empty log ends at once, even one that is to be played for ever.
        (0, 1, FOR_EVER, [], (True, 1, 1), 0),
        # A loop goes on where the last round was due: what was late in one makes the next one no later.
        (3, 1, 2, [(230, [0, 100, 200, 0], 300), (1000, [100, 200], None)], (True, 2, 2), 700),
        (2, 1, FOR_EVER, [(1000, [0, 100] * 10 + [0], 1100)], (False, 11, 11), 1000),
        # As fast as possible nothing has a due time that it could miss.
        (5, AS_FAST_AS_POSSIBLE, 1, [(10 * SECOND, [0, 100, 200, 300, 400], None)], (True, 1, 1), 0),
    ],
)
def test_a_log_is_played_as_often_as_was_asked_for(
    count: int,
    speed: float,
    loops: int,
    steps: list[tuple[int, list[int], int | None]],
    ends: tuple[bool, int, int],
    late_ns: int,
) -> None:
    """At each time what is due, and when the next one is; then whether it has ended, and in which loop."""
    tape = Tape(count)
    player = started(tape, speed, loops)
    assert [(now_ns, taken(player, now_ns), player.next_ns) for now_ns, _, _ in steps] == steps
    assert (player.is_ended, player.loop, tape.reads) == ends
    assert (player.lateness.max_ns, player.slipped_ns) == (late_ns, 0)


def test_who_stood_still_goes_on_from_there() -> None:
    """After a stop of the process nothing comes in a burst; how far it fell behind is told."""
    player = started(Tape(3))
    taken(player, 0)
    now_ns = 100 + SLIP_NS + 1
    assert player.take(now_ns) == Due(mark(WALL_NS + 100), now_ns)
    assert (player.next_ns, player.slipped_ns) == (now_ns + 100, SLIP_NS + 1)


class Rig:
    """A log of so many seconds with a mark every 0.1 s, a clock and an outlet."""

    def __init__(self, length_s: float = 1, speed: float = 1, loops: int = 1) -> None:
        self.clock = FakeClock()
        self.begun_ns = self.clock.now_ns
        self.outlet = FakeOutlet(self.clock)
        self.count = round(length_s * 10)
        self.reading_ns = 0
        """How long it takes to find the beginning."""
        self.player = ReplayScheduler(self._read, Pace(speed, 10**18), loops)
        self.stops_at_ns = 10**18

    def _read(self) -> Iterator[ReplaySample]:
        self.clock.now_ns += self.reading_ns
        return (ReplaySample(WALL_NS + number * 100 * MS, "", "") for number in range(self.count))

    def play(self, *, is_now: bool = False) -> Halt | None:
        def stopped() -> bool:
            return self.clock.now_ns >= self.stops_at_ns

        return play(self.player, self.outlet, self.clock, stopped, is_now=is_now)

    @property
    def sent(self) -> list[tuple[int, int]]:
        """When, and what, in ms since the beginning."""
        return [
            ((at_ns - self.begun_ns) // MS, (item.time_ns - WALL_NS) // MS) for at_ns, item, _ in self.outlet.got
        ]


@pytest.mark.parametrize(
    ("length_s", "speed", "takes_ns", "reading_ns", "halts_at_ns", "sent"),
    [
        # To the moment, at any speed.
        (1, 2, 0, 0, None, [(50 * number, 100 * number) for number in range(10)]),
        # What a slow outlet takes is made up for in the waiting: it adds no drift.
        (60, 1, 30 * MS, 0, None, [(100 * number, 100 * number) for number in range(600)]),
        # Finding the beginning makes nothing late, however long it takes.
        (30, 1, 0, 500 * MS, None, [(500 + 100 * number, 100 * number) for number in range(300)]),
        # What ends it is told from the first look on, and between the last look and the end.
        (1, 1, 0, 0, 0, []),
        (0.1, 1, 1, 0, 1, [(0, 0)]),
    ],
    ids=["twice as fast", "a slow outlet", "a late beginning", "halted", "halted at the end"],
)
def test_each_is_sent_when_it_is_due(
    length_s: float,
    speed: float,
    takes_ns: int,
    reading_ns: int,
    halts_at_ns: int | None,
    sent: list[tuple[int, int]],
) -> None:
    """In between the outlet is looked after."""
    rig = Rig(length_s, speed)
    rig.outlet.takes_ns, rig.reading_ns = takes_ns, reading_ns
    rig.outlet.halts_at_ns = None if halts_at_ns is None else rig.begun_ns + halts_at_ns
    assert rig.play() == (None if halts_at_ns is None else HALT)
    assert rig.sent == sent
    assert rig.player.lateness.max_ns == 0
    looks = [rig.begun_ns + reading_ns, *rig.outlet.attended[1:]]
    assert all(later - earlier <= ATTEND_NS + takes_ns for earlier, later in pairwise(looks))


def test_the_outlet_is_looked_after_when_there_is_no_time_to_wait() -> None:
    """As fast as possible, and slower than that: a gateway that turns up is seen all the same."""
    rig = Rig(length_s=1000, speed=0)
    rig.outlet.takes_ns = MS
    rig.outlet.halts_at_ns = rig.begun_ns + SECOND
    assert rig.play() == HALT
    assert len(rig.outlet.got) <= 1000 + ATTEND_NS // MS
    assert rig.clock.slept == []


def test_it_can_be_stopped() -> None:
    """Also one that would go on for ever."""
    rig = Rig(loops=FOR_EVER)
    rig.stops_at_ns = rig.begun_ns + 5 * SECOND + 1
    assert rig.play() is None
    assert not rig.player.is_ended
    assert len(rig.sent) > 50


def test_the_present_is_that_of_sending() -> None:
    """Whatever the speed: what is due now gets the time of now, and nothing else is moved."""
    for speed in (1.0, 4.0, 0.0):
        rig = Rig(speed=speed)
        rig.outlet.takes_ns = MS
        rig.play(is_now=True)
        for at_ns, item, shift_ns in rig.outlet.got:
            assert item.time_ns + shift_ns == at_ns + 2 * WALL_NS
    rig = Rig()
    rig.play()
    assert {shift_ns for _, _, shift_ns in rig.outlet.got} == {0}


def test_a_key_expression_is_checked_before_anything_is_sent() -> None:
    """And brought into Zenoh's form."""
    assert key_checked("fleet/**/**") == "fleet/**"
    with pytest.raises(CommandError, match="no key expression") as caught:
        key_checked("fleet//x")
    assert caught.value.code is ExitCode.USAGE


@pytest.mark.parametrize(
    ("expression", "topic", "expected"),
    [
        ("fleet/**", "fleet/cruiser-1/chassis/gear", True),
        ("fleet/*/chassis/*", "fleet/cruiser-1/chassis/gear", True),
        ("fleet/cruiser-1/chassis/gear", "fleet/cruiser-1/chassis/gear", True),
        ("fleet/cruiser-2/**", "fleet/cruiser-1/chassis/gear", False),
        ("fleet/**", "fleet/@recorder/depot/health", False),
        ("no//key", "fleet/cruiser-1/chassis/gear", False),
        ("@more", "@more", True),
        ("", "fleet/cruiser-1/chassis/gear", False),
        ("fleet/**", "no//key", False),
    ],
)
def test_keys_match_as_they_do_in_zenoh(expression: str, topic: str, expected: bool) -> None:  # noqa: FBT001 - pytest gives it
    """What is no key expression matches nothing but itself."""
    assert key_matches(expression, topic) == expected
