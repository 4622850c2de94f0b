"""One robot's log, without I/O."""

import json
import tracemalloc
from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from recorder.encoding.routes import FRAMES_MAX, FRAMES_MAX_BYTES
from recorder.encoding.samples import ReceivedSample
from recorder.record import accounting
from recorder.record import robots as backlog_module
from recorder.record import robots as robots_module
from recorder.record.accounting import ChannelQuota, KeyReport
from recorder.record.actions import (
    Action,
    CloseLog,
    Opened,
    OpenLog,
    SyncLog,
    WriteChunk,
    WriteMetadata,
)
from recorder.record.robot_log import LogContext, LogPlan, RobotLog
from schemas import keys
from schemas.decisions import ArbiterState, EventKind, Journal, Severity
from schemas.messages import CanFrames, FrameHealth, GatewayHealth, GatewayInfo, Gear, Message
from schemas.recording import GapReason, RecordGap
from schemas.subjects import SUBJECTS, Subject
from tests.support.logs import PLAN, Log
from tests.support.logs import read_records as read
from tests.support.messages import (
    GEAR_FEEDBACK,
    MS,
    SECOND,
    WALL_NS,
    FakeSample,
    arbiter,
    batch,
    feedback,
    gear,
    key_of,
    safety_event,
    sample_of,
    state,
)
from tests.support.strategies import TEXTS, message_of, subjects_and_messages

ENCODINGS = st.one_of(st.sampled_from([subject.encoding for subject in SUBJECTS]), TEXTS)
KEYS = st.one_of(st.sampled_from([key_of(subject.type) for subject in SUBJECTS]), TEXTS)
TIMES = st.one_of(st.integers(-(2**70), 2**70), st.just(WALL_NS))
GEAR_KEY = key_of(Gear)
FRAMES_KEY = key_of(CanFrames)
INFO_KEY = key_of(GatewayInfo)


def in_short(report: KeyReport) -> tuple[int, int, int]:
    """Messages written, samples missed, frames dropped by the source."""
    return report.written, report.lost_link, report.lost_source


def kinds(actions: Sequence[Action]) -> list[type[Action]]:
    return [type(action) for action in actions]


@given(subjects_and_messages())
def test_a_sample_of_any_subject_becomes_its_message(pair: tuple[Subject, Message]) -> None:
    subject, message = pair
    log = Log()
    log.receive(sample_of(message))
    records = read(log.close())
    if isinstance(message, CanFrames):
        return  # has tests of its own
    topic, schema, record, content = records[0]
    assert len(records) == 1
    assert (topic, schema) == (key_of(subject.type), subject.schema_name)
    assert (record.log_time, record.publish_time, record.sequence) == (WALL_NS, message.time_ns, message.sequence)
    assert content.time_ns == message.time_ns


@given(
    st.lists(
        st.builds(FakeSample, KEYS, ENCODINGS, st.binary(max_size=60), st.binary(max_size=9), TIMES), max_size=9
    ),
    TIMES,
)
def test_whatever_comes_is_kept_in_a_file_that_others_read(samples: list[ReceivedSample], wall_ns: int) -> None:
    """Any key, encoding, payload, attachment and time."""
    log = Log()
    log.receive(*samples, wall_ns=wall_ns)
    if not samples:
        assert log.close() == b""
        return
    records = read(log.close())
    assert len(records) == len(samples)
    for sample, (topic, schema, record, content) in zip(samples, records, strict=True):
        assert schema == "cruiser.RawSample"
        assert (content.key, content.encoding) == (sample.key, sample.encoding)
        assert (content.payload, content.attachment) == (sample.payload, sample.attachment)
        assert content.reason
        assert topic in {sample.key, f"{sample.key}/@raw"}
        assert 0 <= record.publish_time <= 2**63 - 1
        assert 0 <= record.log_time <= 2**63 - 1


def with_time(time: object, sample: ReceivedSample) -> ReceivedSample:
    payload = msgspec.msgpack.encode({**msgspec.msgpack.decode(sample.payload), "time_ns": time})
    return FakeSample(sample.key, sample.encoding, payload)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda sample: FakeSample(sample.key, sample.encoding, b"\xc1"), ""),
        (lambda sample: FakeSample(sample.key, "text/plain", sample.payload), "text/plain"),
        (lambda sample: FakeSample(sample.key, sample.encoding.replace("/1", "/2"), sample.payload), "version 2"),
        (lambda sample: FakeSample(sample.key, "zenoh/bytes", b"", deleted=True), "deleted"),
        (lambda sample: FakeSample(sample.key, sample.encoding, b""), ""),
        # A time that no log can hold never becomes a publish time.
        *((partial(with_time, time), "") for time in (-1, 2**63, 2**64 - 1, None, 1.5, "now")),
    ],
)
def test_a_broken_sample_of_a_known_key_is_kept_beside_the_good_ones(
    change: Callable[[ReceivedSample], ReceivedSample], reason: str
) -> None:
    log = Log()
    good = sample_of(gear(0))
    log.receive(good, change(good), sample_of(gear(1)))
    records = [(topic, schema) for topic, schema, _, _ in read(log.close())]
    assert records == [
        (GEAR_KEY, "cruiser.Gear"),
        (f"{GEAR_KEY}/@raw", "cruiser.RawSample"),
        (GEAR_KEY, "cruiser.Gear"),
    ]
    assert reason in read(log.disk.getvalue())[1][3].reason


def test_a_batch_is_unfolded_into_its_frames() -> None:
    log = Log()
    frames = [(WALL_NS - number * MS, feedback(number)) for number in range(3)]
    log.receive(sample_of(batch(7, frames, dropped=2)))
    records = read(log.close())
    assert {(topic, schema) for topic, schema, _, _ in records} == {(FRAMES_KEY, "cruiser.CanFrame")}
    assert [(record.publish_time, content.data) for _, _, record, content in records] == frames
    assert {(record.sequence, record.log_time) for _, _, record, _ in records} == {(7, WALL_NS)}
    content = records[0][3]
    assert (content.identifier, content.is_extended, content.dlc, content.bus) == (GEAR_FEEDBACK, True, 8, "can0")
    assert in_short(log.log.channels.counts[FRAMES_KEY]) == (3, 0, 2)


@pytest.mark.parametrize(
    ("word", "fd", "expected"),
    [
        (0x7FF, 0, (0x7FF, False, False, False, False, False, False)),
        (0x9FFFFFFF, 0, (0x1FFFFFFF, True, False, False, False, False, False)),
        (0x40000001, 0, (1, False, True, False, False, False, False)),
        (0x20000004, 0, (4, False, False, True, False, False, False)),
        (1, 0b111, (1, False, False, False, True, True, True)),
        (1, 0b100, (1, False, False, False, True, False, False)),
    ],
)
def test_the_flags_of_a_frame_are_told_apart(word: int, fd: int, expected: tuple[object, ...]) -> None:
    """Extended, remote and error as in linux/can.h; FD with bit rate switch and error state."""
    log = Log()
    message = CanFrames(WALL_NS, 0, "can0", 0, [1], [word], [fd], [0], [b""])
    log.receive(sample_of(message))
    content = read(log.close())[0][3]
    flags = (content.is_extended, content.is_remote, content.is_error)
    fd_flags = (content.is_fd, content.bitrate_switch, content.error_state_indicator)
    assert (content.identifier, *flags, *fd_flags) == expected


@given(st.lists(st.tuples(st.integers(1, 300), st.booleans()), max_size=60))
def test_no_message_waits_longer_than_the_setting(steps: list[tuple[int, bool]]) -> None:
    log = Log()
    now, oldest = 0, None
    for wait_ms, comes in steps:
        for _ in range(-(-wait_ms // 10)):
            now += 10 * MS
            if SyncLog in kinds(log.tick(now)):
                oldest = None
            assert oldest is None or now - oldest < PLAN.flush_ns // 2
        if comes:
            log.receive(sample_of(gear(0)), now_ns=now)
            oldest = now if oldest is None else oldest


def test_what_a_gateway_still_keeps_fills_the_gap() -> None:
    message = Journal(time_ns=WALL_NS, sequence=0, run=7, first=0, count=0, inputs=b"\x90")
    lived = [sample_of(msgspec.structs.replace(message, sequence=number)) for number in range(6)]
    replies = [FakeSample(one.key, one.encoding, one.payload, is_reply=True) for one in lived]
    log = Log()
    log.receive(lived[0])
    log.ask(0)
    log.receive(lived[4], now_ns=1)
    assert in_short(log.log.channels.counts[key_of(Journal)]) == (2, 3, 0)
    log.ask(2)
    log.receive(*replies[1:5], now_ns=3)
    log.receive(*replies, lived[5], now_ns=4)
    assert in_short(log.log.channels.counts[key_of(Journal)]) == (6, 0, 0)
    sequences = [content.sequence for topic, _, _, content in read(log.close()) if topic == key_of(Journal)]
    assert sequences == [0, 4, 1, 2, 3, 5]


def test_more_keys_than_channels_share_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(accounting.LIMITS, ChannelQuota.OTHER, 2)
    monkeypatch.setitem(accounting.LIMITS, ChannelQuota.TABLE, 1)
    log = Log()
    log.receive(*(FakeSample(f"k/{number}", "x", b"") for number in range(4)))
    log.receive(sample_of(gear(0)), sample_of(gear(0), "b"))
    records = read(log.close())
    assert [topic for topic, _, _, _ in records] == ["k/0", "k/1", "@more", "@more", GEAR_KEY, "@more"]
    keys_kept = [content.key for topic, _, _, content in records if topic == "@more"]
    assert keys_kept == ["k/2", "k/3", key_of(Gear, "b")]


def test_a_robot_has_room_for_a_few_buses(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(robots_module, "BUS_LIMIT", 2)
    monkeypatch.setitem(accounting.LIMITS, ChannelQuota.OTHER, 1)
    log = Log()
    sample = sample_of(batch(0, [(WALL_NS, feedback(0))]))
    for bus in ("can0", "can1", "can2", "can3", "can0"):
        log.receive(FakeSample(sample.key.replace("can0", bus), sample.encoding, sample.payload))
    topics = [topic for topic, _, _, _ in read(log.close())]
    assert topics == [*(FRAMES_KEY.replace("can0", bus) for bus in ("can0", "can1", "can2")), "@more", FRAMES_KEY]


GAP = RecordGap(WALL_NS, 3, GEAR_KEY, GapReason.QUEUE, WALL_NS - 5, WALL_NS - 1, 7)


def test_there_is_always_room_for_what_the_recorder_says(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(accounting.LIMITS, ChannelQuota.OTHER, 3)
    log = Log()
    log.receive(*(FakeSample(f"x/{number}", "", b"") for number in range(9)))
    log.add_own("own", GAP, SECOND)
    assert [one[1] for one in read(log.close()) if one[0] == "own"] == ["cruiser.RecordGap"]


@given(message_of(GatewayHealth), st.lists(st.integers(0, 100), min_size=1, max_size=5))
def test_what_the_gateway_never_got_from_the_bus_is_counted_at_its_key(
    health: GatewayHealth, counts: list[int]
) -> None:
    log = Log()
    log.receive(sample_of(gear(0)))
    assert log.log.channels.counts[GEAR_KEY].lost_bus is None
    for sequence, count in enumerate(counts):
        frames = [
            FrameHealth(name, 100.0, 0, count, 0, 0, 0, silent=False, alive_faults=0, failures=[])
            for name in ("Auto_GearFeedBack", "Auto_DriveFeedBack", "what is that")
        ]
        log.receive(sample_of(msgspec.structs.replace(health, sequence=sequence, feedback=frames)))
    lost = sum(later - earlier if later >= earlier else later for earlier, later in pairwise(counts))
    assert log.log.channels.counts[GEAR_KEY].lost_bus == lost
    assert set(log.log.channels.counts) == {GEAR_KEY, key_of(GatewayHealth)}


FRAMES = batch(0, [(0, bytes(8))] * FRAMES_MAX)


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        (FRAMES, ""),
        (batch(0, [(0, bytes(8))] * (FRAMES_MAX + 1)), f"more than {FRAMES_MAX} frames in a batch"),
        (
            batch(0, [(0, bytes(8))] * 10 * FRAMES_MAX),
            f"a batch of frames is larger than {FRAMES_MAX_BYTES} bytes",
        ),
        (msgspec.structs.replace(FRAMES, can_id=[1]), "the columns differ in length"),
    ],
    ids=["as many as may be", "one more", "very many", "uneven"],
)
def test_a_batch_that_makes_no_sense_is_kept_as_it_is(message: CanFrames, reason: str) -> None:
    log = Log(LogPlan("x", 1 << 30, SECOND, "1"))
    log.receive(sample_of(message))
    assert log.log.channels.counts[FRAMES_KEY].written == (0 if reason else FRAMES_MAX)
    if reason:
        ((topic, _, _, content),) = read(log.close())
        assert (topic, content.reason) == (f"{FRAMES_KEY}/@raw", reason)


def test_ever_new_keys_and_robots_cost_no_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(accounting.LIMITS, ChannelQuota.OTHER, 20)
    monkeypatch.setitem(accounting.LIMITS, ChannelQuota.TABLE, 10)
    for module in (robots_module, backlog_module):
        monkeypatch.setattr(module, "ROBOT_LIMIT", 10)
    # That cache has a bound of its own.
    monkeypatch.setattr(keys, "_parse", keys._parse.__wrapped__)
    log = Log(LogPlan("x", 1, SECOND, "1"))  # Every sample is a chunk of its own, and goes.

    def receive(first: int, last: int) -> None:
        for number in range(first, last):
            log.log.receive_sample(sample_of(gear(number), f"robot-{number}"), 0, WALL_NS)
            log.log.receive_sample(FakeSample(f"any/{number}", "x", b""), 0, WALL_NS)
            log.log.receive_sample(FakeSample(key_of(Gear, f"broken-{number}"), "x", b""), 0, WALL_NS)
            log.log.incidents.trim(SECOND)
            log.context.actions.clear()

    receive(0, 500)
    tracemalloc.start()
    try:
        before, _ = tracemalloc.get_traced_memory()
        receive(500, 3000)
        after, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert after - before < 50_000  # 7,500 keys would be a million and more.
    assert len(log.log.channels.counts) == 31
    assert sum(count.written for count in log.log.channels.counts.values()) == 3 * 3000


ROLLING = LogPlan("x", 1 << 20, SECOND // 2, "1", rotate_bytes=1000, rotate_ns=60 * SECOND)


@pytest.mark.parametrize(
    ("plan", "now_ns", "file_bytes", "is_ended"),
    [
        (ROLLING, 2 * SECOND, 999, False),
        (ROLLING, 2 * SECOND, 1000, True),
        (ROLLING, SECOND - 1, 1000, False),
        (ROLLING, 60 * SECOND - 1, 0, False),
        (ROLLING, 60 * SECOND, 0, True),
        (PLAN, 10**18, 10**18, False),
    ],
)
def test_a_file_that_is_large_or_old_enough_is_ended(
    plan: LogPlan,
    now_ns: int,
    file_bytes: int,
    is_ended: bool,  # noqa: FBT001 - pytest gives it
) -> None:
    log = Log(plan)
    log.receive(sample_of(gear(0)))
    actions = kinds(log.tick(now_ns, file_bytes))
    assert (CloseLog in actions) == is_ended
    if is_ended:
        assert actions[-1] == CloseLog
        assert actions.index(WriteChunk) < actions.index(WriteMetadata)


def test_a_file_in_which_nothing_is_received_is_ended() -> None:
    log = Log(LogPlan("x", 1 << 20, SECOND, "1", idle_ns=10 * SECOND))
    log.receive(sample_of(gear(0)))
    log.tick(5 * SECOND)
    log.receive(sample_of(gear(1)), now_ns=6 * SECOND)
    log.tick(7 * SECOND)
    log.add_own("own", GAP, 8 * SECOND)
    assert CloseLog not in kinds(log.tick(16 * SECOND - 1))
    assert kinds(log.tick(16 * SECOND))[-1] == CloseLog


def test_the_next_file_begins_with_the_next_sample() -> None:
    context = LogContext()
    log = RobotLog(ROLLING, context)
    log.receive_sample(sample_of(gear(4)), 0, WALL_NS)
    log.receive_sample(sample_of(batch(0, [(WALL_NS, feedback(0))])), 0, WALL_NS)
    log.receive_opened(Opened("x", "x.mcap"))
    log.roll("signal", 0)
    assert context.actions[-1] == CloseLog("x")
    context.actions.clear()
    log.roll("signal", 0)
    log.close(0)
    assert context.actions == []
    log.receive_sample(sample_of(gear(5)), SECOND, WALL_NS + SECOND)
    assert context.actions[0] == OpenLog("x", "x", WALL_NS + SECOND)
    records = {one.name: one.entries for one in context.actions if isinstance(one, WriteMetadata)}
    assert records["cruiser.continued"] == {"file": "2", "because": "signal"}
    assert list(records["cruiser.latest"]) == [GEAR_KEY]
    latest = json.loads(records["cruiser.latest"][GEAR_KEY])
    assert (latest["log_time_ns"], latest["message"]["sequence"]) == (WALL_NS, 4)
    log.close(SECOND)
    (chunk,) = [one.chunk for one in context.actions if isinstance(one, WriteChunk)]
    assert chunk.counts == {1: 1}


@pytest.mark.parametrize("kind", EventKind)
@pytest.mark.parametrize("severity", Severity)
@pytest.mark.parametrize("is_reply", [False, True])
def test_an_event_of_the_kinds_that_were_asked_for_is_an_alarm(
    kind: EventKind,
    severity: Severity,
    is_reply: bool,  # noqa: FBT001 - pytest gives it
) -> None:
    log = Log(LogPlan("x", 1, SECOND, "1", alarms=frozenset({EventKind.STOP, EventKind.FAULT})))
    # Something of before, so that what a reply holds is missing.
    log.receive(sample_of(gear(0)))
    event = sample_of(safety_event(kind, severity))
    actions = log.receive(FakeSample(event.key, event.encoding, event.payload, is_reply=is_reply))
    is_alarm = kind in {EventKind.STOP, EventKind.FAULT} and severity is not Severity.INFO and not is_reply
    begun = [one for one in actions if isinstance(one, OpenLog)]
    assert begun == [OpenLog("x!", "x", WALL_NS, is_incident=True)] * is_alarm
    last = actions[-1]
    assert isinstance(last, WriteChunk)
    assert last.log == ("x!" if is_alarm else "x")
    if is_alarm:
        assert log.log.incidents.about["because"] == f"{kind.value}: as it were"


@pytest.mark.parametrize(
    ("severity", "arbiter_says", "speed_mps", "incidents"),
    [
        (Severity.WARNING, {"lease_holder": "operator-1"}, 0.0, 1),
        (Severity.WARNING, {"state": ArbiterState.STOPPING}, 0.0, 1),
        (Severity.WARNING, {}, 0.3, 1),
        (Severity.WARNING, {}, -0.3, 1),
        (Severity.WARNING, {}, None, 1),
        (Severity.WARNING, None, 0.0, 1),
        (Severity.WARNING, {}, 0.0, 0),
        (Severity.ERROR, {}, 0.0, 1),
    ],
)
def test_a_warning_of_an_idle_robot_is_no_incident(
    severity: Severity, arbiter_says: dict[str, object] | None, speed_mps: float | None, incidents: int
) -> None:
    log = Log(msgspec.structs.replace(PLAN, alarms=frozenset({EventKind.FAULT})))
    log.receive(sample_of(state(0, speed_mps=speed_mps)))
    if arbiter_says is not None:
        idle: dict[str, object] = {"state": ArbiterState.STANDBY, "engaged": False, "lease_holder": ""}
        log.receive(sample_of(arbiter(0, **idle | arbiter_says)))
    log.receive(sample_of(safety_event(EventKind.FAULT, severity)))
    assert log.context.incidents == incidents


def test_a_batch_becomes_as_many_chunks_as_it_needs() -> None:
    limit_bytes = 2000
    log = Log(LogPlan("x", limit_bytes, SECOND, "1"))
    log.receive(sample_of(batch(0, [(WALL_NS + number, feedback(number)) for number in range(1000)])))
    log.close()
    sizes = [len(one.chunk.records) for one in log.done if isinstance(one, WriteChunk)]
    assert len(sizes) > 20
    assert max(sizes) < limit_bytes + 200
    assert log.log.channels.counts[FRAMES_KEY].written == 1000


def test_a_text_without_end_is_cut_where_it_becomes_a_line() -> None:
    event = msgspec.structs.replace(
        safety_event(EventKind.STOP), text="x" * 1_000_000, operator="y" * 1_000_000, sequence=0
    )
    log = Log(LogPlan("x", 1 << 30, SECOND, "1", alarms=frozenset({EventKind.STOP})))
    log.receive(sample_of(event))
    log.close()
    because = log.log.incidents.about["because"]
    assert (len(because), because[:9]) == (300, "stop: xxx")
    chunk = next(one.chunk for one in log.done if isinstance(one, WriteChunk))
    assert 2_000_000 < len(chunk.records) < 2_002_000
