"""The check of a log's file and of its data."""

import itertools
import re
import struct
import zlib
from collections.abc import Callable
from io import BytesIO
from random import Random

import msgspec
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.writer import CompressionType

from recorder.encoding.protobuf import compile_encoder, descriptor_set, schema_name
from recorder.encoding.samples import SEQUENCE_SPAN
from recorder.mcap.arrays import PADDING, Places
from recorder.mcap.framing import CHECK_OPCODE, MAGIC, MESSAGE_HEADER, RECORD_HEADER, encode
from recorder.mcap.writer import LogChannel
from recorder.review.check import LogCheck, check_stream
from recorder.review.checking import (
    AliveCount,
    ChannelEnds,
    FollowingCount,
    FrameCount,
    InTimeCount,
    between,
    feedback_frames,
)
from recorder.review.flaws import FINDINGS_MAX, About, Findings
from schemas.can_word import COUNTER_SPAN
from schemas.messages import CanFrame, Gear
from schemas.recording import GapReason, RecordGap
from tests.support.logs import (
    ENCODE_GEAR,
    GEAR_CHANNEL,
    GEAR_TOPIC,
    Log,
    channel_of,
    foreign_log,
    gear_message,
    gears,
    own_log,
)
from tests.support.messages import (
    GEAR_FEEDBACK,
    MS,
    SECOND,
    WALL_NS,
    FakeSample,
    batch,
    can_frame,
    feedback,
    gear,
    sample_of,
)
from tests.support.rigs import scenarios

LOG = own_log([gears(0, 5, 100), gears(5, 5, 200)], metadata=[("m", {"a": "b"})], attachments=[("n", b"abc")])


def check(data: bytes) -> LogCheck:
    stream = BytesIO(data)
    stream.seek(len(MAGIC))
    return check_stream(stream, len(data), "log.mcap")


def said(found: LogCheck, about: About | None = None) -> list[str]:
    return [one.what for one in found.findings if about in {None, one.about}]


def rebuilt(change: Callable[[records.McapRecord], records.McapRecord | None], data: bytes = LOG) -> bytes:
    """A log with records changed or left out, with correct checksums and its old summary."""
    out = bytearray(MAGIC)
    at, last, summary_start = len(MAGIC), b"", 0
    while at < len(data) - len(MAGIC):
        opcode, length = RECORD_HEADER.unpack_from(data, at)
        body = data[at + RECORD_HEADER.size : at + RECORD_HEADER.size + length]
        at += RECORD_HEADER.size + length
        if opcode == CHECK_OPCODE:
            if last:
                out += struct.pack("<BQII", CHECK_OPCODE, 8, len(last), zlib.crc32(last))
            continue
        if opcode == Opcode.FOOTER:
            _, offset_start, _ = struct.unpack("<QQI", body)
            footer = RECORD_HEADER.pack(opcode, length) + struct.pack(
                "<QQ", summary_start, offset_start + len(out) - (at - RECORD_HEADER.size - length)
            )
            out += footer + struct.pack("<I", zlib.crc32(footer, zlib.crc32(out[summary_start:])))
            continue
        if opcode == Opcode.DATA_END:
            out += RECORD_HEADER.pack(opcode, length) + struct.pack("<I", zlib.crc32(out))
            summary_start = len(out)
            continue
        record = change(PARSED[opcode](ReadDataStream(BytesIO(body))))
        last = b"" if record is None else encode(record)
        out += last
    return bytes(out) + MAGIC


KINDS = (
    *(records.Header, records.Schema, records.Channel, records.Chunk, records.MessageIndex, records.Attachment),
    *(records.Metadata, records.Statistics, records.ChunkIndex, records.AttachmentIndex, records.MetadataIndex),
    records.SummaryOffset,
)
PARSED = {Opcode[re.sub("(?<=[a-z])(?=[A-Z])", "_", kind.__name__).upper()]: kind.read for kind in KINDS}


def first_of(kind: type, edit: Callable[[records.McapRecord], None]) -> bytes:
    """The log with the first record of a kind edited."""
    done: list[bool] = []

    def change(record: records.McapRecord) -> records.McapRecord:
        if isinstance(record, kind) and not done:
            done.append(True)
            edit(record)
        return record

    data = rebuilt(change)
    assert done
    return data


def setting(**values: object) -> Callable[[records.McapRecord], None]:
    def edit(record: records.McapRecord) -> None:
        for name, value in values.items():
            assert getattr(record, name) != value
            setattr(record, name, value)

    return edit


def held(said: int, found: int, name: str) -> str:
    return f"the file states {said} {name}; {found} were found"


OF_CHUNK = "the summary's index of a chunk is wrong"
TIMES = "a chunk states wrong times"
BEHIND = "the message indexes behind a chunk are wrong"
PACKED = "a chunk cannot be read: its compression 'zstx' is not supported"
WHOLE = "the file states wrong first and last times"


@pytest.mark.parametrize(
    ("kind", "edit", "what"),
    [
        (records.Chunk, setting(message_start_time=99), TIMES),
        (records.Chunk, setting(message_end_time=141), TIMES),
        (records.Chunk, setting(uncompressed_size=1), "a chunk cannot be read: a chunk's sizes differ"),
        (records.Chunk, setting(uncompressed_crc=1), "a chunk cannot be read: its checksum is wrong"),
        (records.Chunk, setting(compression="zstx"), PACKED),
        (records.MessageIndex, setting(records=[(1, 0)]), BEHIND),
        (records.MessageIndex, setting(channel_id=2), BEHIND),
        (records.Statistics, setting(message_count=9), held(9, 10, "messages")),
        (records.Statistics, setting(schema_count=2), held(2, 1, "schemas")),
        (records.Statistics, setting(channel_count=2), held(2, 1, "channels")),
        (records.Statistics, setting(chunk_count=3), held(3, 2, "chunks")),
        (records.Statistics, setting(attachment_count=0), held(0, 1, "attachments")),
        (records.Statistics, setting(metadata_count=2), held(2, 1, "metadata records")),
        (records.Statistics, setting(channel_message_counts={1: 9, 2: 1}), held(9, 10, "messages")),
        (records.Statistics, setting(message_start_time=0), WHOLE),
        (records.ChunkIndex, setting(message_start_time=0), OF_CHUNK),
        (records.ChunkIndex, setting(uncompressed_size=0), OF_CHUNK),
        (records.ChunkIndex, setting(compression="zstx"), OF_CHUNK),
        (records.ChunkIndex, setting(message_index_offsets={1: 8}), OF_CHUNK),
        (records.ChunkIndex, setting(chunk_start_offset=8), "the summary's index has a chunk that does not exist"),
        (records.AttachmentIndex, setting(offset=8), "the summary's index of the attachment n is wrong"),
        (records.AttachmentIndex, setting(data_size=4), "the summary's index of the attachment n is wrong"),
        (records.MetadataIndex, setting(name="x"), "the summary's index of the metadata x is wrong"),
        (records.MetadataIndex, setting(length=1), "the summary's index of the metadata m is wrong"),
        (records.SummaryOffset, setting(group_opcode=8), "the summary's own offsets are wrong"),
        (records.SummaryOffset, setting(group_length=2**40), "the summary's own offsets are wrong"),
        (records.Schema, setting(name="cruiser.Geax"), "the schema cruiser.Geax cannot be read"),
        (records.Schema, setting(data=b"\xff"), "the schema cruiser.Gear cannot be read"),
        (records.Schema, setting(id=0), "the schema cruiser.Gear has the id 0, which means none"),
        (records.Channel, setting(schema_id=7), "its schema is missing"),
        (records.Channel, setting(topic="other"), "the summary's channel is not in the data"),
        (records.Channel, setting(id=7), "messages of channel 1, which the file does not hold"),
    ],
)
def test_a_false_record_is_found(kind: type, edit: Callable[[records.McapRecord], None], what: str) -> None:
    """All checksums are right."""
    found = check(first_of(kind, edit))
    assert what in said(found, About.FILE)
    assert not found.whole


@pytest.mark.parametrize(
    ("kind", "what"),
    [
        (records.Header, "the file has no header"),
        (records.Schema, "its schema is missing"),
        (records.Channel, "messages of channel 1, which the file does not hold"),
        (records.Chunk, held(2, 0, "chunks")),
        (records.Attachment, held(1, 0, "attachments")),
        (records.Metadata, held(1, 0, "metadata records")),
        (records.ChunkIndex, "the summary's own offsets are wrong"),
    ],
)
def test_what_is_left_out_is_noticed(kind: type, what: str) -> None:
    assert rebuilt(lambda record: record) == LOG
    found = check(rebuilt(lambda record: None if isinstance(record, kind) else record))
    assert what in said(found, About.FILE)


def test_a_log_time_that_goes_backwards_is_found_within_and_between_chunks() -> None:
    chunks = [
        [gear_message(number, time_ns) for number, time_ns in enumerate((5, 5, 3, 4, 2))],
        [gear_message(5, 1), gear_message(6, 9)],
        [gear_message(7, 9)],
    ]
    found = check(own_log(chunks))
    [finding] = found.findings
    assert (finding.about, finding.what, finding.count) == (About.ALLOWED, "the log time goes backwards", 3)
    assert found.is_sound


def test_what_a_recorder_says_itself_may_have_waited() -> None:
    own = channel_of(Gear, 2, "fleet/@recorder/bench/event/log")
    chunks = [
        [gear_message(0, 10), gear_message(0, 5, 2), gear_message(1, 20)],
        [gear_message(1, 6, 2), gear_message(2, 25), gear_message(3, 30)],
        [gear_message(2, 99, 2), gear_message(4, 40)],
    ]
    assert check(own_log(chunks, [GEAR_CHANNEL, own])).findings == []
    chunks[2].append(gear_message(5, 39))
    assert said(check(own_log(chunks, [GEAR_CHANNEL, own]))) == ["the log time goes backwards"]


def test_messages_that_are_not_what_their_schema_says_are_found() -> None:
    good = ENCODE_GEAR(gear(0))
    broken = [(1, 1, 20, good[:-1]), (1, 2, 30, b"\x0f" + good[1:]), (1, 3, 40, b""), (1, 4, 50, good + b"\x0a")]
    found = check(own_log([[gear_message(0, 10), *broken, gear_message(5, 60)]]))
    # No bytes at all are a message of defaults.
    assert (found.channels[0].unreadable, said(found)) == (3, ["messages do not match their schema"])
    assert found.findings[0].topic == GEAR_TOPIC
    for place in (0, 9, len(good) - 2, len(good) - 1):
        wrong = good[:place] + b"\xff" + good[place + 1 :]
        found = check(own_log([[gear_message(0, 10)], [(1, 1, 20, wrong)], [gear_message(2, 30)]]))
        assert (found.channels[0].unreadable, len(found.findings)) == (1, 1), place


def test_an_older_versions_schema_is_told_and_its_messages_are_read_by_it() -> None:
    other = LogChannel(1, GEAR_TOPIC, schema_name(Gear), descriptor_set(CanFrame).replace(b"CanFrame", b"Gear"))
    descriptors = descriptor_set(Gear).replace(b"alive_counter", b"alive_numberx")
    changed = LogChannel(1, GEAR_TOPIC, schema_name(Gear), descriptors)
    found = check(own_log([gears(0, 3, 10)], [changed]))
    assert said(found) == ["the schema cruiser.Gear differs from this version's"]
    assert found.channels[0].unreadable == 0
    assert "the schema cruiser.Gear cannot be read" in said(check(own_log([gears(0, 3, 10)], [other])))


@pytest.mark.parametrize("compression", CompressionType)
@pytest.mark.parametrize("use_chunking", [True, False])
def test_files_of_others_are_sound(compression: CompressionType, use_chunking: bool) -> None:  # noqa: FBT001 - a parameter
    found = check(foreign_log(compression=compression, use_chunking=use_chunking))
    assert found.findings == []
    assert (found.messages, found.channels[0].is_read) == (10, True)


OF_GEAR = ("cruiser.Gear", "protobuf", descriptor_set(Gear))


@pytest.mark.parametrize(
    ("given", "what"),
    [
        ({"data": b"{"}, ["messages do not match their schema"]),
        ({"schema": ("t", "jsonschema", b"{")}, ["the schema t is no JSON"]),
        ({"schema": None}, ["the channel has no schema"]),
        ({"encoding": "protobuf", "schema": ("a.B", "protobuf", b"\xff")}, ["the schema a.B cannot be read"]),
        (
            {
                "encoding": "protobuf",
                "schema": ("cruiser.Gear", "protobuf", descriptor_set(Gear)),
                "data": b"\xff",
            },
            ["messages do not match their schema"],
        ),
    ],
)
def test_files_of_others_may_be_wrong_too(given: dict[str, object], what: list[str]) -> None:
    assert said(check(foreign_log(**given))) == what  # type: ignore[arg-type]  # each is right for its name


def test_losses_are_about_the_data_and_the_file_is_whole() -> None:
    log = Log()
    log.receive(*(sample_of(gear(number)) for number in (0, 3, 4)))
    frames = [(WALL_NS + number * 10 * MS, feedback(number)) for number in range(40) if number not in {5, 20, 21}]
    batches = batch(0, frames[:10]), batch(1, frames[10:20]), batch(3, frames[20:])
    log.receive(*map(sample_of, batches))
    log.receive(FakeSample("k", "x", b""), FakeSample("k", "x", b""))
    found = check(log.close())
    assert {channel.topic: channel.missed for channel in found.channels} == {
        "fleet/cruiser-1/can/can0/rx": 1,
        "fleet/cruiser-1/chassis/gear": 2,
        "k": None,
    }
    assert (found.missed, found.frames_lost, found.whole, found.is_sound) == (3, 3, True, False)
    frame = found.frames[0]
    assert (frame.identifier, frame.name, frame.frames, frame.lost) == ("0x18C4D1EF", "Auto_GearFeedBack", 37, 3)
    assert [(one.about, one.what, one.count, one.topic.rpartition("/")[2]) for one in found.findings] == [
        (About.DATA, "samples missed, by the sequence", 1, "rx"),
        (About.DATA, "Auto_GearFeedBack: frames lost, by the alive counter", 3, "rx"),
        (About.DATA, "samples missed, by the sequence", 2, "gear"),
    ]
    assert found.findings[1].time_ns == WALL_NS + 60 * MS
    assert [one.time_ns for one in found.findings if "sequence" in one.what] == [WALL_NS, WALL_NS]


@pytest.mark.parametrize("away_ms", [40, 700, 20_000])
@pytest.mark.parametrize("is_one_chunk", [True, False])
def test_the_time_without_a_gateway_is_no_loss_on_the_way(away_ms: int, *, is_one_chunk: bool) -> None:
    log = Log()
    frames = [(WALL_NS + number * 10 * MS, feedback(number)) for number in range(60) if number not in {5, 45}]
    away = [(at_ns + away_ms * MS, data) for at_ns, data in frames[29:]]
    batches = [batch(0, frames[:10]), batch(1, frames[10:29]), batch(0, away[:10]), batch(1, away[10:])]
    for one in batches:
        log.receive(sample_of(one))
        if not is_one_chunk:
            log.receive(*(sample_of(gear(number)) for number in range(2000)))
    found = check(log.close())
    (frame,) = found.frames
    assert (frame.frames, frame.lost, frame.outages, frame.unseen) == (58, 2, 0, 0)
    about_frames = [(one.what, one.count) for one in found.findings if one.topic.endswith("rx")]
    assert about_frames == [
        ("restarts of the gateway: the frames between were not received", 1),
        ("Auto_GearFeedBack: frames lost, by the alive counter", 2),
    ]


def test_two_gateways_under_one_name_are_told_and_no_loss_is_made_up() -> None:
    log = Log()
    for number in range(30):
        for start, behind_ns in ((0, 0), (5000, 3 * MS)):
            frames = [(WALL_NS + number * 100 * MS + at * 10 * MS + behind_ns, feedback(at)) for at in range(10)]
            log.receive(sample_of(gear(start + number)), sample_of(batch(start + number, frames)))
    found = check(log.close())
    assert (found.missed, found.frames_lost) == (0, 0)
    assert {one.what for one in found.findings} == {
        "two gateways publish under one name: their losses are unknown"
    }
    assert not found.is_sound


def test_what_the_recorder_could_not_write_is_about_the_data() -> None:
    log = Log()
    log.receive(sample_of(gear(0)))
    for number, count in enumerate((3, 4)):
        gap = RecordGap(WALL_NS, number, "fleet/x", GapReason.QUEUE, WALL_NS + SECOND, WALL_NS + 2 * SECOND, count)
        log.add_own("fleet/@recorder/bench/gap", gap, 0)
    [found] = check(log.close()).findings
    assert (found.about, found.topic, found.count, found.time_ns) == (About.DATA, "fleet/x", 7, WALL_NS + SECOND)
    assert found.what == "lost by the recorder (queue)"


def test_every_flipped_byte_is_found() -> None:
    for place in range(len(MAGIC), len(LOG)):
        damaged = bytearray(LOG)
        damaged[place] ^= 1 << place % 8
        assert not check(bytes(damaged)).whole, place


@example(noise=b"\x05", place=0)
@given(st.binary(max_size=200), st.integers(0, 10_000))
def test_nothing_that_a_file_may_hold_raises(noise: bytes, place: int) -> None:
    place = len(MAGIC) + place % (len(LOG) - len(MAGIC))
    check(LOG[:place] + noise + LOG[place + len(noise) :])
    check(MAGIC + noise)


def test_many_findings_are_counted_and_the_first_are_told() -> None:
    findings = Findings("x")
    for number in range(FINDINGS_MAX + 7):
        findings.file(f"{number}")
    assert (len(findings.told), findings.untold) == (FINDINGS_MAX, 7)
    assert findings.has(About.FILE)
    assert not findings.has(About.DATA)


@pytest.mark.parametrize("without", [(), ("journal",)])
def test_a_step_of_the_robots_clock_is_no_loss(without: tuple[str, ...]) -> None:
    found = check(scenarios.stepped_clock(steps_recorder=True).log(without=without))
    assert (found.frames_lost, found.frames[0].outages) == (0, 1)


# Raw frames that never came, by their alive counters.

PERIOD_NS = 10 * MS


def gear_count() -> AliveCount:
    return AliveCount(feedback_frames()[GEAR_FEEDBACK])


def receive(count: AliveCount, *frames: tuple[float, int]) -> AliveCount:
    """Frames one by one: the periods since the first, and the counter."""
    for periods, counter in frames:
        data = np.frombuffer(feedback(counter), np.uint8).reshape(1, -1)
        count.receive(np.array([round(periods * PERIOD_NS)], np.int64), data)
    return count


@given(st.integers(0, 15), st.lists(st.booleans(), min_size=1, max_size=200))
def test_what_is_lost_is_counted_exactly_while_gaps_are_short(first: int, arrives: list[bool]) -> None:
    numbers = [0]
    for number, comes in enumerate(arrives, start=1):
        if comes or number - numbers[-1] == COUNTER_SPAN - 1:
            numbers.append(number)
    count = receive(gear_count(), *((number, first + number) for number in numbers))
    assert (count.frames, count.lost) == (len(numbers), numbers[-1] + 1 - len(numbers))
    assert (count.repeated, count.corrupt, count.outages) == (0, 0, 0)


@pytest.mark.parametrize("gap", [16, 17, 100, 999])
@pytest.mark.parametrize("counter", range(COUNTER_SPAN))
def test_across_a_long_gap_the_counter_decides_within_the_elapsed_periods(gap: int, counter: int) -> None:
    """Of all numbers that fit the counter, the one nearest to the elapsed periods."""
    count = receive(gear_count(), (0, 0), (gap, counter))
    fitting = range((counter - 1) % COUNTER_SPAN, gap + COUNTER_SPAN, COUNTER_SPAN)
    nearest = min(abs(lost - (gap - 1)) for lost in fitting)
    lost = count.lost + count.unseen
    assert count.outages == 1
    assert lost in fitting
    assert abs(lost - (gap - 1)) == nearest


@pytest.mark.parametrize(
    ("frames", "lost", "repeated", "outages", "unseen"),
    [
        # A step back of the clock tells nothing, and neither does the counter then.
        ([(0, 0), (-0.1, 5)], 0, 0, 1, 0),
        # A repeated counter is not fifteen lost frames.
        ([(0, 3), (1, 3)], 0, 1, 0, 0),
        # A long gap between regular frames, and one over which the clock may have been set.
        ([(0, 0), (1, 1), (2, 2), (35, 35), (36, 36)], 0, 0, 1, 32),
        ([(0, 0), (1, 1), (6100, 4), (6101, 5)], 2, 0, 1, 0),
        ([(0, 0), (35, 3), (360_000, 4), (360_001, 5)], 2, 0, 2, 32),
    ],
)
def test_what_the_counter_cannot_tell(
    frames: list[tuple[float, int]], lost: int, repeated: int, outages: int, unseen: int
) -> None:
    count = receive(gear_count(), *frames)
    assert (count.lost, count.repeated, count.outages, count.unseen) == (lost, repeated, outages, unseen)


STALLS = st.lists(st.tuples(st.integers(0, 400), st.integers(0, 120)), max_size=4)
"""When a machine stands still, and for how long, in periods."""


def arrivals(sent: list[int], stalls: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """The time of receipt of each frame, in order; frames of a stall arrive at its end."""
    received = []
    for number in sent:
        at = number
        for start, length in sorted(stalls):
            at = max(at, start + length) if start <= at else at
        received.append((at, number))
    return received


@given(st.integers(0, 15), STALLS)
def test_frames_that_come_late_and_all_at_once_are_not_lost(first: int, stalls: list[tuple[int, int]]) -> None:
    count = receive(gear_count(), *((at, first + number) for at, number in arrivals(list(range(600)), stalls)))
    assert (count.frames, count.lost, count.unseen, count.repeated) == (600, 0, 0, 0)


@given(STALLS, st.integers(20, 300), st.integers(0, 200))
def test_every_lost_frame_of_a_long_gap_counts(stalls: list[tuple[int, int]], start: int, length: int) -> None:
    sent = [number for number in range(1000) if not start <= number < start + length]
    apart = [(at, stall) for at, stall in stalls if at + stall < start or at >= start + length]
    count = receive(gear_count(), *arrivals(sent, apart))
    assert count.lost + count.unseen == length


ENCODE = compile_encoder(CanFrame)
DRIVE_FEEDBACK = 0x18C4D3EF


def frame(number: int, identifier: int = GEAR_FEEDBACK, data: bytes | None = None, bus: str = "can0") -> CanFrame:
    made = can_frame(identifier, 10 * MS * number, feedback(number) if data is None else data)
    return msgspec.structs.replace(made, bus=bus)


def take(count: FrameCount, records: list[bytes]) -> list[int]:
    lengths = np.array([len(one) for one in records], np.int64)
    head = bytes(MESSAGE_HEADER.size)
    content = np.frombuffer(b"".join(head + one for one in records) + bytes(PADDING), np.uint8)
    return count.take(content, Places(np.cumsum(lengths + len(head)) - lengths, lengths))


def counts(*batches: list[CanFrame]) -> list[tuple[object, ...]]:
    count = FrameCount()
    for frames in batches:
        assert take(count, [ENCODE(one) for one in frames]) == []
    return [msgspec.structs.astuple(one) for one in count.info("t")]


FRAMES = st.builds(
    frame,
    st.integers(0, 60),
    st.sampled_from([GEAR_FEEDBACK, DRIVE_FEEDBACK, 0x123]),
    st.sampled_from([None, None, None, None, bytes(8), b"\x01" + bytes(7), b"\x01", b""]),
    st.sampled_from(["can0", "can0", "can0", "b"]),
)


@given(st.lists(st.lists(FRAMES, min_size=1, max_size=20), max_size=5))
def test_many_at_once_count_as_each_by_itself(batches: list[list[CanFrame]]) -> None:
    assert counts(*batches) == counts(*([one] for batch in batches for one in batch))


def test_records_that_are_no_frames_are_told() -> None:
    count = FrameCount()
    good = ENCODE(frame(0))
    assert take(count, [good, b"\xff", ENCODE(frame(1)), b"\x0f" * len(good)]) == [1, 3]
    assert count.info("t")[0].frames == 2
    corrupt = bytearray(feedback(2))
    corrupt[6] ^= 0x70
    # The counter of a corrupt frame is not read: it counts as the one that was due.
    frames = [frame(0), frame(1), frame(2, data=bytes(corrupt)), frame(3)]
    assert counts(frames)[0][3:] == (4, 0, 0, 1, 0, 0)


# Samples that never came: by their sequences in one log, and between several.

STEERING = "fleet/cruiser-1/chassis/steering"
OTHER = "fleet/cruiser-2/chassis/gear"


def add(line: InTimeCount, messages: list[tuple[int, int]]) -> None:
    if messages:
        sequences, times_ns = zip(*messages, strict=True)
        line.take(np.array(sequences, np.int64), np.array(times_ns, np.uint64))


def gaps_of(messages: list[tuple[int, int]]) -> list[tuple[int, int, int | None]]:
    line = InTimeCount()
    add(line, messages[: len(messages) // 3])
    add(line, messages[len(messages) // 3 :])
    return [(before.last, after.first, missing) for before, after, missing in line.gaps()]


@given(st.sets(st.integers(0, 120), min_size=1), st.integers(0, SEQUENCE_SPAN - 1), st.randoms())
def test_what_is_missing_is_found_in_any_order(there: set[int], start: int, chooser: object) -> None:
    messages = [((start + number) % SEQUENCE_SPAN, number * SECOND) for number in sorted(there)]
    ordered = sorted(there)
    expected = [
        ((start + one) % SEQUENCE_SPAN, (start + other) % SEQUENCE_SPAN, other - one - 1)
        for one, other in itertools.pairwise(ordered)
        if other - one > 1
    ]
    assert gaps_of(messages) == expected
    chooser.shuffle(messages)  # type: ignore[attr-defined] # Hypothesis's Random
    assert gaps_of(messages) == expected
    # A second copy, as an incident's log is one, changes nothing.
    assert gaps_of(messages + messages[: len(messages) // 2]) == expected


FIRST = [(number, number * SECOND) for number in range(100)]
WOVEN = [(number, number * SECOND) for pair in zip(range(40), range(40, 80), strict=True) for number in pair]


@pytest.mark.parametrize(
    ("messages", "gaps"),
    [
        # The frames of a batch share its sequence.
        ([(number // 3, number) for number in range(30)], []),
        ([(number // 3, number) for number in range(30) if number // 3 != 4], [(3, 5, 1)]),
        # What was asked for later stands piece by piece between what comes by itself.
        (WOVEN, []),
        ([one for one in WOVEN if one[0] != 20], [(19, 21, 1)]),
        # The same number much later is another gateway's, and a step back is a gap of unknown size.
        ([*((number, number) for number in range(6)), (5, 200 * SECOND), (6, 201 * SECOND)], [(5, 5, None)]),
        ([*FIRST, *((number, (200 + number) * SECOND) for number in range(5, 50))], [(99, 5, None)]),
        ([*((number, (200 + number) * SECOND) for number in range(50)), *FIRST], [(99, 0, None)]),
        # A loss after a restart, although the sequence goes on where the old gateway's ended.
        ([*FIRST[:6], *((n, (100 + n) * SECOND) for n in (0, 1, 2, 3, 4, 6, 7))], [(5, 0, None), (4, 6, 1)]),
    ],
)
def test_gaps_of_a_log(messages: list[tuple[int, int]], gaps: list[tuple[int, int, int | None]]) -> None:
    assert gaps_of(messages) == gaps


def ends(first: int, last: int, start: int = 0) -> ChannelEnds:
    """Ends of a channel with a message each nanosecond; sequence 0 was at ``start``."""
    return ChannelEnds(first % 2**32, last % 2**32, start + first, start + last)


def test_the_samples_of_a_robot_are_one_answer() -> None:
    found = between(
        [
            ("b", {GEAR_TOPIC: ends(15, 20), STEERING: ends(13, 20)}),
            ("a", {GEAR_TOPIC: ends(0, 10), STEERING: ends(0, 11)}),
            ("c", {OTHER: ends(50, 60)}),
        ]
    )
    (one,) = found
    assert (one.robot, one.samples, one.topics) == ("fleet/cruiser-1", 5, 2)
    assert (one.from_ns, one.to_ns, one.before, one.after) == (10, 15, "a", "b")


@given(st.lists(st.tuples(st.integers(1, 50), st.integers(0, 5)), min_size=1, max_size=8), st.randoms())
def test_what_was_left_out_is_found(parts: list[tuple[int, int]], shuffle: Random) -> None:
    logs, at, left_out = [], 2**32 - 40, 0
    for number, (length, gap) in enumerate(parts):
        logs.append((str(number), {GEAR_TOPIC: ends(at, at + length)}))
        at += length + 1 + gap
        left_out += gap
    shuffle.shuffle(logs)
    assert sum(one.samples for one in between(logs)) == left_out - parts[-1][1]


@pytest.mark.parametrize(
    "logs",
    [
        # Two recorders have the same, and an incident lies within another log.
        [("a", {GEAR_TOPIC: ends(0, 100)}), ("b", {GEAR_TOPIC: ends(20, 40)}), ("c", {GEAR_TOPIC: ends(95, 200)})],
        # A gateway that began anew counts from 0.
        [("a", {GEAR_TOPIC: ends(0, 100)}), ("b", {GEAR_TOPIC: ends(0, 10, start=1000)})],
    ],
)
def test_overlapping_logs_lack_nothing(logs: list[tuple[str, dict[str, ChannelEnds]]]) -> None:
    assert between(logs) == []


@pytest.mark.parametrize("parts", [1, 2, 5, 100])
@pytest.mark.parametrize(
    ("sequences", "missed", "first"),
    [
        (range(20), 0, None),
        ((0, 1, 1, 1, 2), 0, None),  # the frames of a batch
        ((5, 8, 9, 12), 4, 1),
        ((SEQUENCE_SPAN - 2, SEQUENCE_SPAN - 1, 0, 2), 1, 3),
        ((7, 8, 0, 1, 4), 2, 4),  # a gateway that started again
        ((0, 2**24 + 1, 2**24 + 2), 0, None),  # as well
        ([one + place for one in range(20) for place in (0, 500)], None, None),  # two gateways by turns
        ((0, 1, 3, 2, 4), 2, 2),  # one that was overtaken
    ],
)
def test_missed_numbers(sequences: list[int], missed: int | None, first: int | None, parts: int) -> None:
    count = FollowingCount()
    for part in np.array_split(np.array(sequences), parts):
        if len(part):
            count.take(part, part)
    assert count.has_two_sources == (missed is None)
    if missed is not None:
        assert (count.missed, count.first_ns) == (missed, None if first is None else list(sequences)[first])
