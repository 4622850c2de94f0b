"""Whether a log is what it says, and what it lacks."""

import random
import struct
import zlib
from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.writer import CompressionType

from recorder.encoding.protobuf import descriptor_set, schema_name
from recorder.mcap.framing import CHECK_OPCODE, MAGIC, RECORD_HEADER, encode
from recorder.mcap.writer import LogChannel
from recorder.review.check import LogCheck, check_log, check_stream
from recorder.review.flaws import FINDINGS_MAX, About, Findings
from schemas.decisions import Journal
from schemas.messages import CanFrame, Gear
from schemas.recording import GapReason, RecordGap
from tests.support.logs import (
    ENCODE_GEAR,
    GEAR_CHANNEL,
    GEAR_TOPIC,
    Log,
    foreign_log,
    gear_message,
    gears,
    own_log,
    saved,
    small_log,
)
from tests.support.messages import MS, SECOND, WALL_NS, FakeSample, batch, feedback, gear, sample_of
from tests.support.rigs import scenarios

LOG = own_log([gears(0, 5, 100), gears(5, 5, 200)], metadata=[("m", {"a": "b"})], attachments=[("n", b"abc")])


def check(data: bytes) -> LogCheck:
    """What is found in a file with this content."""
    stream = BytesIO(data)
    stream.seek(len(MAGIC))
    return check_stream(stream, len(data), "log.mcap")


def said(found: LogCheck, about: About | None = None) -> list[str]:
    """What the findings say."""
    return [one.what for one in found.findings if about in {None, one.about}]


def rebuilt(change: Callable[[records.McapRecord], records.McapRecord | None], data: bytes = LOG) -> bytes:
    """A log with records changed or left out, all checksums right again; what its end says stays as it was."""
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


PARSED = {
    Opcode.HEADER: records.Header.read,
    Opcode.SCHEMA: records.Schema.read,
    Opcode.CHANNEL: records.Channel.read,
    Opcode.CHUNK: records.Chunk.read,
    Opcode.MESSAGE_INDEX: records.MessageIndex.read,
    Opcode.ATTACHMENT: records.Attachment.read,
    Opcode.METADATA: records.Metadata.read,
    Opcode.STATISTICS: records.Statistics.read,
    Opcode.CHUNK_INDEX: records.ChunkIndex.read,
    Opcode.ATTACHMENT_INDEX: records.AttachmentIndex.read,
    Opcode.METADATA_INDEX: records.MetadataIndex.read,
    Opcode.SUMMARY_OFFSET: records.SummaryOffset.read,
}


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
    """Sets attributes of a record."""

    def edit(record: records.McapRecord) -> None:
        for name, value in values.items():
            assert getattr(record, name) != value
            setattr(record, name, value)

    return edit


def test_a_sound_log_has_no_findings() -> None:
    """All of it is read: messages, channels, raw frames."""
    found = check(small_log())
    assert found.findings == []
    assert (found.whole, found.is_sound, found.messages) == (True, True, 12)
    assert {channel.topic: channel.missed for channel in found.channels} == {
        "fleet/cruiser-1/can/can0/rx": 0,
        "fleet/cruiser-1/chassis/gear": 0,
        "fleet/cruiser-1/gateway/info": None,
        "fleet/elsewhere": None,
    }
    assert all(channel.is_read and not channel.unreadable for channel in found.channels)
    assert [(frame.name, frame.frames) for frame in found.frames] == [("Auto_GearFeedBack", 5)]


def test_what_was_put_together_anew_is_as_it_was() -> None:
    """The tests below change one thing and no other."""
    assert rebuilt(lambda record: record) == LOG
    assert check(LOG).findings == []


@pytest.mark.parametrize(
    ("kind", "edit", "what"),
    [
        (records.Chunk, setting(message_start_time=99), "a chunk's times are not those of its messages"),
        (records.Chunk, setting(message_end_time=141), "a chunk's times are not those of its messages"),
        (records.Chunk, setting(uncompressed_size=1), "a chunk cannot be read: a chunk's sizes differ"),
        (records.Chunk, setting(uncompressed_crc=1), "a chunk cannot be read: its checksum is wrong"),
        (
            records.Chunk,
            setting(compression="zstx"),
            "a chunk cannot be read: its compression 'zstx' is not known here",
        ),
        (records.MessageIndex, setting(records=[(1, 0)]), "the message indexes behind a chunk are wrong"),
        (records.MessageIndex, setting(channel_id=2), "the message indexes behind a chunk are wrong"),
        (records.Statistics, setting(message_count=9), "the file says that it holds 9 messages; 10 were found"),
        (records.Statistics, setting(schema_count=2), "the file says that it holds 2 schemas; 1 were found"),
        (records.Statistics, setting(channel_count=2), "the file says that it holds 2 channels; 1 were found"),
        (records.Statistics, setting(chunk_count=3), "the file says that it holds 3 chunks; 2 were found"),
        (
            records.Statistics,
            setting(attachment_count=0),
            "the file says that it holds 0 attachments; 1 were found",
        ),
        (
            records.Statistics,
            setting(metadata_count=2),
            "the file says that it holds 2 metadata records; 1 were found",
        ),
        (
            records.Statistics,
            setting(channel_message_counts={1: 9, 2: 1}),
            "the file says that it holds 9 messages; 10 were found",
        ),
        (
            records.Statistics,
            setting(message_start_time=0),
            "the file's first and last time are not those of its messages",
        ),
        (records.ChunkIndex, setting(message_start_time=0), "the summary's index of a chunk is wrong"),
        (records.ChunkIndex, setting(uncompressed_size=0), "the summary's index of a chunk is wrong"),
        (records.ChunkIndex, setting(compression="zstx"), "the summary's index of a chunk is wrong"),
        (records.ChunkIndex, setting(message_index_offsets={1: 8}), "the summary's index of a chunk is wrong"),
        (records.ChunkIndex, setting(chunk_start_offset=8), "the summary's index names a chunk that is not there"),
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
def test_a_file_that_says_what_is_not_so_is_found_out(
    kind: type, edit: Callable[[records.McapRecord], None], what: str
) -> None:
    """Each of these with all checksums right: none would be seen by them."""
    found = check(first_of(kind, edit))
    assert what in said(found, About.FILE)
    assert not found.whole


@pytest.mark.parametrize(
    ("kind", "what"),
    [
        (records.Header, "the file has no header"),
        (records.Schema, "its schema is missing"),
        (records.Channel, "messages of channel 1, which the file does not hold"),
        (records.Chunk, "the file says that it holds 2 chunks; 0 were found"),
        (records.Attachment, "the file says that it holds 1 attachments; 0 were found"),
        (records.Metadata, "the file says that it holds 1 metadata records; 0 were found"),
        (records.ChunkIndex, "the summary's own offsets are wrong"),
    ],
)
def test_what_is_left_out_is_noticed(kind: type, what: str) -> None:
    """Every record of a kind, and nothing else."""
    found = check(rebuilt(lambda record: None if isinstance(record, kind) else record))
    assert what in said(found, About.FILE)


def test_a_finding_tells_where_and_how_many() -> None:
    """The file, the place of the first, and all of them counted."""

    def change(record: records.McapRecord) -> records.McapRecord:
        if isinstance(record, records.Chunk):
            record.message_start_time -= 1
        return record

    [finding] = [one for one in check(rebuilt(change)).findings if "chunk's times" in one.what]
    assert (finding.path, finding.about, finding.count) == ("log.mcap", About.FILE, 2)
    assert finding.offset == LOG.index(b"\x04\x00\x00\x00zstd") - RECORD_HEADER.size - 28


def test_a_log_time_that_goes_backwards_is_found_within_and_between_chunks() -> None:
    """Counted each time; equal times are fine."""
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
    """For a file that it goes into; the others' times are judged without it."""
    own = LogChannel(2, "fleet/@recorder/bench/event/log", schema_name(Gear), descriptor_set(Gear))
    chunks = [
        [gear_message(0, 10), gear_message(0, 5, 2), gear_message(1, 20)],
        [gear_message(1, 6, 2), gear_message(2, 25), gear_message(3, 30)],
        [gear_message(2, 99, 2), gear_message(4, 40)],
    ]
    assert check(own_log(chunks, [GEAR_CHANNEL, own])).findings == []
    chunks[2].append(gear_message(5, 39))
    assert said(check(own_log(chunks, [GEAR_CHANNEL, own]))) == ["the log time goes backwards"]


def test_messages_that_are_not_what_their_schema_says_are_found() -> None:
    """Of ours by their layout, and each looked at where that is in doubt."""
    good = ENCODE_GEAR(gear(0))
    broken = [
        (1, 1, 20, good[:-1]),
        (1, 2, 30, b"\x0f" + good[1:]),
        (1, 3, 40, b""),
        (1, 4, 50, good + b"\x0a"),
    ]
    found = check(own_log([[gear_message(0, 10), *broken, gear_message(5, 60)]]))
    # No bytes at all are a message of defaults.
    assert (found.channels[0].unreadable, said(found)) == (3, ["messages are not what their schema says"])
    assert found.findings[0].topic == GEAR_TOPIC


def test_a_wrong_tag_among_messages_of_the_same_length_is_found() -> None:
    """Every place where a layout has a fixed byte counts, and every flag and enumeration."""
    good = ENCODE_GEAR(gear(1))
    for place in (0, 9, len(good) - 2, len(good) - 1):
        broken = good[:place] + b"\xff" + good[place + 1 :]
        found = check(own_log([[gear_message(0, 10), (1, 1, 20, broken), gear_message(2, 30)]]))
        assert found.channels[0].unreadable == 1, place


def test_a_broken_message_is_found_in_its_own_chunk() -> None:
    """Though many chunks are judged together."""
    chunks = [gears(number, 1, 100 + number) for number in range(10)]
    chunks[7][0] = (1, 7, 107, b"\xff")
    data = own_log(chunks)
    offsets = []
    at = -1
    while (at := data.find(b"\x04\x00\x00\x00zstd", at + 1)) >= 0:
        offsets.append(at - RECORD_HEADER.size - 28)
    assert check(data).findings[0].offset == offsets[7]


def test_an_older_versions_schema_is_told_and_its_messages_are_read_by_it() -> None:
    """The file's own schema is what its messages are held against."""
    other = LogChannel(1, GEAR_TOPIC, schema_name(Gear), descriptor_set(CanFrame).replace(b"CanFrame", b"Gear"))
    descriptors = descriptor_set(Gear).replace(b"alive_counter", b"alive_numberx")
    changed = LogChannel(1, GEAR_TOPIC, schema_name(Gear), descriptors)
    found = check(own_log([gears(0, 3, 10)], [changed]))
    assert said(found) == ["the schema cruiser.Gear is not the one that this version writes"]
    assert found.channels[0].unreadable == 0
    assert "the schema cruiser.Gear cannot be read" in said(check(own_log([gears(0, 3, 10)], [other])))


@pytest.mark.parametrize("compression", CompressionType)
@pytest.mark.parametrize("use_chunking", [True, False])
def test_files_of_others_are_sound(compression: CompressionType, use_chunking: bool) -> None:  # noqa: FBT001 - a parameter
    """In every compression, with schemas and channels in the chunks, and with nothing in chunks at all."""
    found = check(foreign_log(compression=compression, use_chunking=use_chunking))
    assert found.findings == []
    assert (found.messages, found.channels[0].is_read) == (10, True)


def test_what_nobody_here_can_read_is_not_judged() -> None:
    """As ROS 2's CDR; it is no finding, and it is told."""
    found = check(foreign_log(encoding="cdr", schema=("p/msg/T", "ros2msg", b"int8 x"), data=b"\x00\x01\x00\x00"))
    assert found.findings == []
    assert not found.channels[0].is_read


@pytest.mark.parametrize(
    ("given", "what"),
    [
        ({"data": b"{"}, ["messages are not what their schema says"]),
        ({"schema": ("t", "jsonschema", b"{")}, ["the schema t is no JSON"]),
        ({"schema": None}, ["the channel has no schema"]),
        (
            {"encoding": "protobuf", "schema": ("a.B", "protobuf", b"\xff")},
            ["the schema a.B cannot be read"],
        ),
        (
            {
                "encoding": "protobuf",
                "schema": ("cruiser.Gear", "protobuf", descriptor_set(Gear)),
                "data": b"\xff",
            },
            ["messages are not what their schema says"],
        ),
    ],
)
def test_files_of_others_may_be_wrong_too(given: dict[str, object], what: list[str]) -> None:
    """Schemas, messages, channels without a schema."""
    assert said(check(foreign_log(**given))) == what  # type: ignore[arg-type]  # each is right for its name


def test_losses_are_about_the_data_and_the_file_is_whole() -> None:
    """Samples by the gaps in sequence, raw frames by their alive counters; neither where it says nothing."""
    log = Log()
    log.receive(*(sample_of(gear(number)) for number in (0, 3, 4)))
    frames = [(WALL_NS + number * 10 * MS, feedback(number)) for number in range(40) if number not in {5, 20, 21}]
    log.receive(
        sample_of(batch(0, frames[:10])), sample_of(batch(1, frames[10:20])), sample_of(batch(3, frames[20:]))
    )
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
    """One that was killed, and another that counts its batches anew; what either lost is told all the same."""
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
        ("times without a gateway, whose frames nobody received: another one began then", 1),
        ("Auto_GearFeedBack: frames lost, by the alive counter", 2),
    ]


def test_two_gateways_under_one_name_are_told_and_no_loss_is_made_up() -> None:
    """Their samples and frames stand among each other, by turns."""
    log = Log()
    for number in range(30):
        for start, behind_ns in ((0, 0), (5000, 3 * MS)):
            frames = [(WALL_NS + number * 100 * MS + at * 10 * MS + behind_ns, feedback(at)) for at in range(10)]
            log.receive(sample_of(gear(start + number)), sample_of(batch(start + number, frames)))
    found = check(log.close())
    assert (found.missed, found.frames_lost) == (0, 0)
    assert {one.what for one in found.findings} == {
        "two gateways speak under one name: what either lost is not known"
    }
    assert not found.is_sound


def test_what_was_asked_for_later_is_not_missed() -> None:
    """It stands behind what came by itself; its time tells its place."""
    log = Log()
    told = [
        sample_of(Journal(WALL_NS + number * MS, number, run=7, first=number, count=0, inputs=b"\x90"))
        for number in range(7)
    ]
    replies = [FakeSample(one.key, one.encoding, one.payload, is_reply=True) for one in told]
    log.receive(told[3], *replies[:3], told[4], told[6])
    [channel] = check(log.close()).channels
    assert (channel.messages, channel.missed) == (6, 1)


def test_what_the_recorder_could_not_write_is_about_the_data() -> None:
    """As it says itself, by key and reason."""
    log = Log()
    log.receive(sample_of(gear(0)))
    for number, count in enumerate((3, 4)):
        gap = RecordGap(WALL_NS, number, "fleet/x", GapReason.QUEUE, WALL_NS + SECOND, WALL_NS + 2 * SECOND, count)
        log.add_own("fleet/@recorder/bench/gap", gap, 0)
    [finding] = check(log.close()).findings
    assert (finding.about, finding.topic, finding.count, finding.time_ns) == (
        About.DATA,
        "fleet/x",
        7,
        WALL_NS + SECOND,
    )
    assert finding.what == "not in the log, as its recorder says (queue)"


@pytest.mark.parametrize("size", [len(MAGIC), 60, len(LOG) // 2, len(LOG) - 1])
def test_a_cut_is_about_the_file(size: int) -> None:
    """What is before it is read."""
    found = check(LOG[:size])
    assert not found.whole
    assert said(found, About.FILE)


def test_every_flipped_byte_is_found() -> None:
    """No damage goes unseen."""
    for place in range(len(MAGIC), len(LOG)):
        damaged = bytearray(LOG)
        damaged[place] ^= 1 << place % 8
        assert not check(bytes(damaged)).whole, place


def test_any_noise_is_read_as_far_as_it_goes() -> None:
    """Random damage, many times over, in a log of ours and one of somebody else: never a traceback."""
    generator = random.Random(1)  # noqa: S311 - nothing here is secret
    ours = small_log()
    for data in (ours, foreign_log(compression=CompressionType.NONE), foreign_log(use_chunking=False)):
        for _ in range(150):
            damaged = bytearray(data)
            for _ in range(generator.randint(1, 8)):
                damaged[generator.randrange(8, len(data))] ^= generator.randint(1, 255)
            found = check(bytes(damaged))
            # What others leave without a checksum may be anything.
            assert not found.whole or data is not ours


@example(noise=b"\x05", place=0)
@given(st.binary(max_size=200), st.integers(0, 10_000))
def test_nothing_that_a_file_may_hold_raises(noise: bytes, place: int) -> None:
    """Noise in place of a file's bytes, or of the file."""
    place = len(MAGIC) + place % (len(LOG) - len(MAGIC))
    check(LOG[:place] + noise + LOG[place + len(noise) :])
    check(MAGIC + noise)


def test_damage_in_the_middle_costs_its_own_messages_only() -> None:
    """And nothing else is taken for wrong that is right."""
    data = bytearray(LOG)
    data[data.index(b"\x04\x00\x00\x00zstd") + 30] ^= 0xFF
    found = check(bytes(data))
    assert found.messages == 5
    assert {"the file says that it holds 10 messages; 5 were found"} <= set(said(found))
    assert "the summary's index of a chunk is wrong" not in said(found)


def test_chunks_of_many_channels_are_told_apart() -> None:
    """The one path of bulk and the other of single messages come to the same."""
    channels = [
        LogChannel(number, f"fleet/cruiser-{number}/chassis/gear", schema_name(Gear), descriptor_set(Gear))
        for number in (1, 2, 300)
    ]
    messages = [gear_message(number // 3, number, channels[number % 3].channel_id) for number in range(90)]
    del messages[31]
    data = own_log([messages], channels)
    found = check(data)
    assert {one.topic: (one.messages, one.missed) for one in found.channels} == {
        "fleet/cruiser-1/chassis/gear": (30, 0),
        "fleet/cruiser-2/chassis/gear": (29, 1),
        "fleet/cruiser-300/chassis/gear": (30, 0),
    }
    without_index = rebuilt(lambda one: None if isinstance(one, records.MessageIndex) else one, data)
    again = check(without_index)
    assert [(one.messages, one.missed) for one in again.channels] == [(30, 0), (29, 1), (30, 0)]


def test_a_message_without_data_is_in_its_own_chunk() -> None:
    """At the end of one, and alone in one."""
    chunks = [[gear_message(0, 10), (1, 1, 20, b"")], [(1, 2, 30, b"")]]
    assert check(own_log(chunks)).findings == []


def test_an_index_in_another_order_is_right() -> None:
    """As others may write it."""

    def change(record: records.McapRecord) -> records.McapRecord:
        if isinstance(record, records.MessageIndex):
            record.records.reverse()
        return record

    assert check(rebuilt(change)).findings == []


def test_many_findings_are_counted_and_the_first_are_told() -> None:
    """Output does not grow with the damage."""
    findings = Findings("x")
    for number in range(FINDINGS_MAX + 7):
        findings.file(f"{number}")
    assert (len(findings.told), findings.untold) == (FINDINGS_MAX, 7)
    assert findings.has(About.FILE)
    assert not findings.has(About.DATA)


def test_the_progress_comes_to_the_length_of_the_file(tmp_path: Path) -> None:
    """Each byte once."""
    told: list[int] = []
    check_log(saved(tmp_path / "log.mcap", LOG), told.append)
    assert sum(told) == len(LOG)
    assert min(told) >= 0


@pytest.mark.parametrize("steps_recorder", [False, True])
def test_a_step_of_the_robots_clock_is_no_loss(*, steps_recorder: bool) -> None:
    """The journal's monotonic times tell it; without them nobody can know."""
    rig = scenarios.stepped_clock(steps_recorder=steps_recorder)
    found = check(rig.log())
    assert (found.frames_lost, found.frames[0].outages) == (0, 1)
    assert any("steps of the robot's clock" in what for what in said(found))
    assert check(rig.log(without=("journal",))).frames_lost > 2_000_000
