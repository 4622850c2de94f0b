"""A recorder without I/O: the log of a sample, queues, and its own messages."""

import weakref
from collections import Counter
from io import BytesIO
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from recorder.encoding.samples import ReceivedSample
from recorder.record import accounting
from recorder.record.accounting import KeyReport
from recorder.record.actions import INCIDENT_MARK, Deleted, DiskRoom, LogAction, Query
from recorder.record.recorder import QUICK_BYTES, SAMPLE_BYTES, TICK_LOGS, Recorder, SampleInbox
from recorder.record.robot_log import CONTINUED_NAME
from recorder.record.robots import ANSWER_NS, KEPT_SUBJECTS
from schemas import codec
from schemas.decisions import EventKind
from schemas.messages import GatewayInfo, Gear
from schemas.recording import LOG_CHUNK, GapReason, RecorderEvent, RecorderState
from schemas.subjects import BY_TYPE
from tests.support.messages import MS, SECOND, WALL_NS, FakeSample, gear, info, key_of, safety_event, sample_of
from tests.support.rigs.recorder import (
    EVENT_KEY,
    GEAR_KEY,
    OTHERS,
    OWN,
    PLAN,
    RecorderRig,
    messages,
    metadata,
    times,
)


def test_each_robot_has_a_log_and_what_is_no_robots_another(bench: RecorderRig) -> None:
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


@pytest.mark.parametrize("known", [frozenset[str](), frozenset({"cruiser-1"})])
def test_robots_beyond_the_limit_share_a_log(
    monkeypatch: pytest.MonkeyPatch, bench: RecorderRig, known: frozenset[str]
) -> None:
    bench.recorder = Recorder(msgspec.structs.replace(PLAN, log_limit=2, known=known))
    monkeypatch.setattr("recorder.record.recorder.OWNED_KEY_LIMIT", 4)
    for robot in (*(f"r-{number}" for number in range(10)), "cruiser-1"):
        bench.receive(sample_of(gear(0), robot))
        assert len(bench.recorder._by_key) <= 4
    assert set(bench.logs()) == {"r-0", "r-1", "r-2", OTHERS} | known


def test_one_log_for_all_if_that_is_wanted() -> None:
    bench = RecorderRig(msgspec.structs.replace(PLAN, per_robot=False))
    bench.receive(sample_of(gear(0), "a"), sample_of(gear(0), "b"), FakeSample("x", "x", b""))
    assert set(bench.logs()) == {OTHERS}
    assert bench.mark("c") == {}
    assert set(bench.mark("b")) == {OTHERS + INCIDENT_MARK}


def test_in_standby_nothing_is_written_but_incidents() -> None:
    bench = RecorderRig(msgspec.structs.replace(PLAN, standby=True))
    assert bench.recorder.state is RecorderState.STOPPED
    bench.receive(sample_of(gear(0)))
    bench.run(SECOND)
    assert bench.writer.files == {}
    bench.mark("cruiser-1")
    bench.room(has_room=False)
    bench.room()
    bench.run(SECOND)
    bench.receive(sample_of(gear(1)))
    bench.close()
    assert list(bench.writer.files) == ["cruiser-1!"]
    assert times(bench.writer.files["cruiser-1!"][0]) == [0, 2 * SECOND]
    assert bench.recorder.counts[GEAR_KEY] == KeyReport(sent=2, received=2, written=0)
    assert bench.gaps() == []


def test_a_robot_whose_first_sample_is_dropped_is_asked_all_the_same(bench: RecorderRig) -> None:
    bench.recorder.drop(key_of(GatewayInfo), GapReason.QUEUE, 0, WALL_NS)
    assert list(bench.recorder._logs) == ["cruiser-1"]
    actions = bench.recorder.ask(0)
    assert Query(key_of(GatewayInfo)) in actions
    bench.writer.apply(actions)
    bench.receive(sample_of(info()))
    bench.close()
    described = metadata(bench.logs()["cruiser-1"][0], "cruiser")
    assert described[-1]["cruiser-1.variant"] == "coarse"


def test_what_is_said_is_numbered_and_said_in_every_log_that_is_written(bench: RecorderRig) -> None:
    bench.receive(sample_of(gear(0), "a"), sample_of(gear(0), "b"))
    bench.writer.apply(bench.recorder.receive_notice(Deleted("old.mcap", 5), 0, WALL_NS))
    bench.room(has_room=False)
    bench.room(has_room=False)
    bench.room()
    events = bench.events()
    assert [event.kind.value for event in events] == ["deleted", "full", "full"]
    assert [event.sequence for event in events] == list(range(3))
    bench.close()
    for files in bench.logs().values():
        # No file is being written when there is room again, nor at the start: nothing has come since.
        assert [len([1 for topic, _ in messages(file) if topic == f"{OWN}/event"]) for file in files] == [2]
    # What several logs hold is counted together.
    assert bench.recorder.counts[f"{OWN}/event"].written == 4


def test_a_file_says_why_the_one_before_it_ended(bench: RecorderRig) -> None:
    bench.receive(sample_of(gear(0)))
    bench.notice()
    bench.room(roll=True)
    bench.writer.apply(bench.recorder.roll("signal", 0))
    bench.receive(sample_of(gear(1)))
    bench.room(has_room=False)
    bench.room()
    bench.receive(sample_of(gear(2)))
    bench.close()
    _, second, third = bench.logs()["cruiser-1"]
    assert metadata(second, CONTINUED_NAME) == [{"file": "2", "because": "room"}]
    assert metadata(third, CONTINUED_NAME) == [{"file": "3", "because": "full"}]


def test_after_the_end_nothing_is_asked_for(bench: RecorderRig) -> None:
    bench.receive(sample_of(gear(0)))
    bench.mark()
    bench.writer.apply(bench.recorder.close(0, WALL_NS))
    for notice in [*bench.writer.notices, DiskRoom(has_room=False, has_incident_room=True), Deleted("x", 1)]:
        actions = bench.recorder.receive_notice(notice, 0, WALL_NS)
        assert not [one for one in actions if isinstance(one, LogAction)]
    bench.writer.notices.clear()


@pytest.mark.parametrize(
    "payload",
    [
        codec.encode(gear(3)).replace(b"drive", b"\xff\xfe\xff\xfe\xff"),
        b"\x81\xa1x" + b"\x91" * 100_000 + b"\xc0",
        b"",
    ],
)
def test_a_broken_payload_on_the_fast_path_is_kept_as_it_is(payload: bytes) -> None:
    bench = RecorderRig(msgspec.structs.replace(PLAN, sample_max_bytes=1_000_000))
    good = sample_of(gear(0))
    broken = FakeSample(good.key, good.encoding, payload)
    bench.receive(*(sample_of(gear(number)) for number in range(3)), broken, sample_of(gear(3)))
    counts = bench.recorder.counts
    assert (counts[GEAR_KEY].written, counts[f"{GEAR_KEY}/@raw"].written) == (4, 1)


def test_files_do_not_become_many_however_often_it_is_asked_for(bench: RecorderRig) -> None:
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
    plan = msgspec.structs.replace(PLAN, log=msgspec.structs.replace(PLAN.log, rotate_ns=2 * SECOND))
    bench = RecorderRig(plan)
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


def test_a_key_that_is_a_lines_topic_is_another(bench: RecorderRig) -> None:
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


def test_what_the_recorder_says_comes_back_and_is_recorded_once(bench: RecorderRig) -> None:
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
    bench: RecorderRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(accounting.LIMITS, accounting.ChannelQuota.OTHER, 10)
    bench.receive(*(FakeSample(f"fleet/cruiser-1/k/{number}", "x", b"") for number in range(60)))
    bench.receive(sample_of(safety_event(EventKind.STOP)))
    assert bench.recorder.incidents == 1
    assert bench.recorder.counts["@more"].written == 50
    assert bench.recorder.counts[f"{EVENT_KEY}/{LOG_CHUNK}"].written == 1


def test_large_payloads_do_not_take_the_quick_way() -> None:
    bench = RecorderRig(msgspec.structs.replace(PLAN, sample_max_bytes=1_000_000))
    bench.receive(*(sample_of(gear(number)) for number in range(3)))
    large = msgspec.msgpack.encode({**msgspec.to_builtins(gear(3)), "more": bytes(QUICK_BYTES)})
    good = sample_of(gear(3))
    waiting = iter([FakeSample(good.key, good.encoding, large), sample_of(gear(4))])
    bench.writer.apply(bench.recorder.receive(waiting, 0, lambda: True))
    assert len(list(waiting)) == 1
    assert bench.recorder.counts[GEAR_KEY].written == 4


def test_a_fleet_that_appears_at_once_is_asked_bit_by_bit(bench: RecorderRig) -> None:
    robots = [f"r-{number}" for number in range(3 * TICK_LOGS)]
    bench.receive(*(sample_of(gear(0), robot) for robot in robots))
    infos = {Query(key_of(GatewayInfo, robot)) for robot in robots}
    assert bench.recorder.ask(bench.now_ns, 0) == (), "where there is no room no turn is over"
    asked: list[Query] = []
    while not infos <= set(asked):
        queries = [one for one in bench.recorder.ask(bench.now_ns, 7) if isinstance(one, Query)]
        assert 0 < len(queries) <= 7
        asked += queries
        bench.now_ns += 50 * MS
    # The first have been silent for long, and nobody was asked anything twice before the last was asked at all.
    assert bench.now_ns > 2 * ANSWER_NS
    assert len(asked) == len(set(asked))


def test_at_the_end_every_log_is_asked_for_its_last_samples(bench: RecorderRig) -> None:
    robots = [f"r-{number}" for number in range(2 * TICK_LOGS)]
    bench.receive(*(sample_of(info(), robot) for robot in robots))
    for tick in range(600):
        bench.recorder.ask(tick * SECOND, 10**6)
    assert bench.recorder.ask(700 * SECOND, 10**6) == ()
    bench.recorder.ask_last(700 * SECOND)
    asked = [one.key for one in bench.recorder.ask(700 * SECOND, 10**6) if isinstance(one, Query)]
    assert sorted(asked) == sorted(key_of(one.type, robot) for robot in robots for one in KEPT_SUBJECTS)


LIMIT_BYTES = 5000


def sample(number: int, size: int) -> ReceivedSample:
    return FakeSample("k", "x", bytes(size), received_ns=number)


@given(st.lists(st.one_of(st.integers(0, 6000), st.tuples(st.integers(0, 5), st.integers(0, 3000))), max_size=60))
def test_the_oldest_go_first_and_each_is_taken_or_told(steps: list[int | tuple[int, int]]) -> None:
    inbox = SampleInbox(LIMIT_BYTES)
    waiting: list[tuple[int, int]] = []
    for number, step in enumerate(steps):
        if isinstance(step, int):
            waiting.append((number, step + 1 + SAMPLE_BYTES))
            dropped = inbox.put(sample(number, step))
            gone = []
            while sum(size for _, size in waiting) > LIMIT_BYTES:
                gone.append(("k", waiting.pop(0)[0]))
            assert dropped == gone
        else:
            taken = list(inbox.take(*step))
            assert [one.received_ns for one in taken] == [number for number, _ in waiting[: len(taken)]]
            sizes = [size for _, size in waiting[: len(taken)]]
            # The last one may go beyond.
            assert len(taken) <= step[0]
            assert sum(sizes[:-1]) <= step[1]
            assert len(taken) == min(step[0], len(waiting)) or sum(sizes) > step[1]
            del waiting[: len(taken)]
        assert (len(inbox), inbox.bytes) == (len(waiting), sum(size for _, size in waiting))
        assert inbox.bytes <= LIMIT_BYTES


class Received:
    key, encoding, payload, attachment = "k", "x", b"payload", b"attachment"
    zenoh_time_ns, received_ns, source, deleted, is_reply = 1, 2, ("source", 3), True, True


def test_what_waits_is_a_copy() -> None:
    inbox, received = SampleInbox(1000), Received()
    gone = weakref.ref(received)
    inbox.put(received)
    del received
    assert gone() is None
    (taken,) = inbox.take(1, 1000)
    for name in ("key", "encoding", "payload", "attachment", "zenoh_time_ns", "received_ns", "source"):
        assert getattr(taken, name) == getattr(Received, name)
    assert taken.deleted
    assert taken.is_reply
