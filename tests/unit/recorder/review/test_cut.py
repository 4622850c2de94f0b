"""A part of a log."""

import random
from pathlib import Path

import pytest
from mcap.writer import CompressionType

from recorder.reading.logs import Faults, find_logs
from recorder.reading.rows import END_OF_TIME_NS, Selection
from recorder.review.check import check_log
from recorder.review.cut import CutLog, cut
from recorder.review.info import CUT_NAME, read_info
from schemas.command_line import CommandError
from schemas.messages import Drive, Gear
from tests.support.commands import review
from tests.support.logs import GEAR_TOPIC, channel_of, foreign_log, gears, own_log, saved, small_log
from tests.support.reading import Read

ALWAYS = (0, END_OF_TIME_NS)
DRIVE_TOPIC = "fleet/cruiser-1/chassis/drive"
TWO_CHANNELS = [channel_of(Gear, 1, GEAR_TOPIC), channel_of(Drive, 2, DRIVE_TOPIC)]
LOG = own_log(
    [[*gears(5 * number, 5, 100 * number), (2, number, 100 * number + 41, b"")] for number in range(1, 5)],
    TWO_CHANNELS,
    metadata=[("m", {"a": "b"})],
    attachments=[("x", b"abc")],
)


def part(
    directory: Path, data: bytes, period: tuple[int, int] = ALWAYS, *topics: str, told: Faults | None = None
) -> tuple[CutLog, Read]:
    faults = Faults() if told is None else told
    out = directory / "out.mcap"
    out.unlink(missing_ok=True)
    [log] = find_logs([saved(directory / "log.mcap", data)], faults)
    made = cut(log, out, Selection(from_ns=period[0], to_ns=period[1]), topics, faults)
    assert told is not None or (not faults and check_log(out).whole)
    return made, Read(out)


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
def test_a_period_excludes_its_end(tmp_path: Path, period: tuple[int, int], expected: list[int]) -> None:
    made, read = part(tmp_path, LOG, period, GEAR_TOPIC)
    assert [message[1] for message in read.messages] == list(expected)
    assert (made.messages, made.channels) == (len(list(expected)), 1)
    # Of a time without messages too.
    assert [channel.topic for channel in read.channels] == [GEAR_TOPIC]


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
    _, read = part(tmp_path, LOG, ALWAYS, *topics)
    assert {channel.topic for channel in read.channels} == {message[0] for message in read.messages} == expected
    assert len(read.schemas) == len(expected)


def test_it_is_complete_in_itself_and_says_what_it_is(tmp_path: Path) -> None:
    _, read = part(tmp_path, LOG, (120, 320), "*/gear")
    assert [(one.name, one.data) for one in read.attachments] == [("x", b"abc")]
    metadata = {one.name: one.metadata for one in read.metadata}
    assert metadata["m"] == {"a": "b"}
    assert metadata[CUT_NAME] == {"files": "log.mcap", "from_ns": "120", "to_ns": "320", "topics": "*/gear"}
    info = read_info(tmp_path / "out.mcap")
    assert (info.is_cut, info.whole, info.messages) == (True, True, 10)


@pytest.mark.parametrize("compression", CompressionType)
@pytest.mark.parametrize("schema", [("pkg/msg/Thing", "ros2msg", b"int8 x"), None])
@pytest.mark.parametrize("use_chunking", [True, False])
def test_files_of_others_are_copied_as_they_are(
    tmp_path: Path,
    compression: CompressionType,
    schema: tuple[str, str, bytes] | None,
    use_chunking: bool,  # noqa: FBT001 - a parameter
) -> None:
    data = foreign_log(
        range(100),
        encoding="cdr",
        schema=schema,
        data=b"\x00\x01",
        compression=compression,
        use_chunking=use_chunking,
        profile="ros2",
    )
    made, read = part(tmp_path, data, (10, 20), "/*", told=Faults())
    [channel] = read.channels
    assert (channel.topic, channel.message_encoding, channel.metadata) == ("/t", "cdr", {"who": "else"})
    assert [(one.name, one.encoding, one.data) for one in read.schemas.values()] == ([schema] if schema else [])
    assert read.header.profile == "ros2"
    assert [message[1:] for message in read.messages] == [(one, one, one, b"\x00\x01") for one in range(10, 20)]
    assert (made.messages, made.start_ns, made.end_ns) == (10, 10, 19)
    [attachment] = read.attachments
    assert (attachment.name, attachment.log_time, attachment.create_time) == ("note", 4, 3)
    assert ("origin", {"by": "somebody"}) in [(one.name, one.metadata) for one in read.metadata]


def test_any_noise_still_makes_a_whole_file(tmp_path: Path) -> None:
    generator = random.Random(3)  # noqa: S311 - nothing here is secret
    for data in (small_log(), small_log()[:-300], foreign_log(use_chunking=False), foreign_log()):
        for _ in range(15):
            damaged = bytearray(data)
            for _ in range(generator.randint(1, 6)):
                damaged[generator.randrange(8, len(data))] ^= generator.randint(1, 255)
            part(tmp_path, bytes(damaged), told=Faults())
            assert not [one for one in check_log(tmp_path / "out.mcap").findings if "index" in one.what]


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    [log] = find_logs([saved(tmp_path / "a.mcap", small_log())], Faults())
    for name in ("out.mcap", "out.mcap.part"):
        path = saved(tmp_path / name, b"precious")
        with pytest.raises(CommandError, match="exists, and is not overwritten"):
            cut(log, tmp_path / "out.mcap", Selection(), [], Faults())
        assert path.read_bytes() == b"precious"
        path.unlink()
    with pytest.raises(CommandError, match=r"cannot write .*No such file or directory"):
        cut(log, tmp_path / "nowhere" / "out.mcap", Selection(), [], Faults())
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.mcap"]


def test_whoever_is_told_to_stop_leaves_nothing(tmp_path: Path) -> None:
    log = saved(tmp_path / "in" / "a.mcap", own_log([gears(0, 3, 10)]))
    with pytest.raises(KeyboardInterrupt):
        review("cut", str(log), "-o", str(tmp_path / "out.mcap"), is_stopped=True)
    assert [path.name for path in tmp_path.iterdir()] == ["in"]
