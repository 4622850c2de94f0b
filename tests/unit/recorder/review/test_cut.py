"""A part of a log."""

from pathlib import Path

import pytest

from recorder.encoding.protobuf_schema import descriptor_set, schema_name
from recorder.mcap.channel import LogChannel
from recorder.reading.faults import Faults
from recorder.reading.logs import find_logs
from recorder.reading.rows import END_OF_TIME_NS, Selection
from recorder.review.check import check_log
from recorder.review.cut import cut
from recorder.review.info import CUT_NAME, read_info
from recorder.review.joining.joining import Joined
from schemas.exit_codes import CommandError
from schemas.messages import Drive, Gear
from tests.support.logs import GEAR_TOPIC, foreign_log, gears, own_log, saved, small_log
from tests.support.reading import Read

ALWAYS = (0, END_OF_TIME_NS)
DRIVE_TOPIC = "fleet/cruiser-1/chassis/drive"
TWO_CHANNELS = [
    LogChannel(1, GEAR_TOPIC, schema_name(Gear), descriptor_set(Gear)),
    LogChannel(2, DRIVE_TOPIC, schema_name(Drive), descriptor_set(Drive)),
]
LOG = own_log(
    [[*gears(5 * number, 5, 100 * number), (2, number, 100 * number + 41, b"")] for number in range(1, 5)],
    TWO_CHANNELS,
    metadata=[("m", {"a": "b"})],
    attachments=[("x", b"abc")],
)


def part(directory: Path, data: bytes, period: tuple[int, int] = ALWAYS, *topics: str) -> tuple[Joined, Read]:
    """A part of a file with this content; and what the mcap package reads of it."""
    faults = Faults()
    out = directory / "out.mcap"
    joined = cut(
        find_logs([saved(directory / "log.mcap", data)], faults),
        out,
        Selection(from_ns=period[0], to_ns=period[1]),
        topics,
        faults,
    )
    assert not faults
    assert check_log(out).whole
    return joined, Read(out)


@pytest.mark.parametrize(
    ("period", "expected"),
    [
        (ALWAYS, range(5, 25)),
        ((120, 320), range(7, 17)),
        ((121, 321), range(8, 18)),
        ((0, 100), []),
        ((440, END_OF_TIME_NS), [24]),
        ((150, 200), []),
    ],
)
def test_a_time_begins_with_its_first_and_ends_before_its_last(
    tmp_path: Path, period: tuple[int, int], expected: list[int]
) -> None:
    """By log time."""
    joined, read = part(tmp_path, LOG, period, GEAR_TOPIC)
    assert [message[1] for message in read.messages] == list(expected)
    assert joined.messages == len(list(expected))


@pytest.mark.parametrize(
    ("topics", "expected"),
    [
        ([], {GEAR_TOPIC, DRIVE_TOPIC}),
        (["*/gear"], {GEAR_TOPIC}),
        (["*/drive", "*/gear"], {GEAR_TOPIC, DRIVE_TOPIC}),
        (["*chassis*"], {GEAR_TOPIC, DRIVE_TOPIC}),
        (["fleet/cruiser-?/chassis/[dg]*"], {GEAR_TOPIC, DRIVE_TOPIC}),
    ],
)
def test_topics_are_chosen_by_patterns(tmp_path: Path, topics: list[str], expected: set[str]) -> None:
    """Channels that are not wanted are not declared, nor are their schemas."""
    _, read = part(tmp_path, LOG, ALWAYS, *topics)
    assert {channel.topic for channel in read.channels} == {message[0] for message in read.messages} == expected
    assert len(read.schemas) == len(expected)


@pytest.mark.parametrize("pattern", ["gear", "*/GEAR"])
def test_a_part_of_no_topic_is_none(tmp_path: Path, pattern: str) -> None:
    """Nothing is written: it would look like an empty drive."""
    with pytest.raises(CommandError, match="no topic is of these patterns"):
        part(tmp_path, LOG, ALWAYS, pattern)
    assert not (tmp_path / "out.mcap").exists()


def test_it_is_complete_in_itself_and_says_what_it_is(tmp_path: Path) -> None:
    """Metadata and attachments are there, and where it was cut."""
    _, read = part(tmp_path, LOG, (120, 320), "*/gear")
    assert [(one.name, one.data) for one in read.attachments] == [("x", b"abc")]
    metadata = {one.name: one.metadata for one in read.metadata}
    assert metadata["m"] == {"a": "b"}
    assert metadata[CUT_NAME] == {"files": "log.mcap", "from_ns": "120", "to_ns": "320", "topics": "*/gear"}
    info = read_info(tmp_path / "out.mcap")
    assert (info.is_cut, info.whole, info.messages) == (True, True, 10)


def test_a_cut_log_has_no_losses_of_its_own(tmp_path: Path) -> None:
    """What was there without a gap is so in the part."""
    part(tmp_path, small_log())
    assert check_log(tmp_path / "out.mcap").is_sound


def test_what_is_twice_in_one_log_stays_twice(tmp_path: Path) -> None:
    """A part shows the log as it is."""
    joined, _ = part(tmp_path, own_log([gears(0, 2, 10), gears(0, 2, 10)]))
    assert (joined.messages, joined.duplicates) == (4, 0)


def test_a_part_of_somebody_elses_file(tmp_path: Path) -> None:
    """Without chunks, too."""
    joined, read = part(tmp_path, foreign_log(range(100), use_chunking=False), (10, 20), "/*")
    assert joined.messages == 10
    assert read.channels[0].message_encoding == "json"


def test_chunks_outside_of_the_time_are_not_read(tmp_path: Path) -> None:
    """Damage there is no matter."""
    data = bytearray(LOG)
    data[data.index(b"zstd") + 20] ^= 0xFF
    joined, _ = part(tmp_path, bytes(data), (200, END_OF_TIME_NS), "*/gear")
    assert joined.messages == 15
