"""Several logs in one."""

import json
import random
from collections.abc import Sequence
from pathlib import Path

import msgspec
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType

from recorder.encoding.protobuf_schema import descriptor_set, schema_name
from recorder.mcap.channel import LogChannel
from recorder.reading.faults import Faults
from recorder.reading.logs import find_logs
from recorder.record.accounting import COMPLETENESS_NAME, KeyReport
from recorder.record.robots import METADATA_NAME
from recorder.review.check import check_log
from recorder.review.info import read_info
from recorder.review.joining import ordered
from recorder.review.joining.joining import Joined, Recent
from recorder.review.merge import MERGED_NAME, merge
from schemas.exit_codes import CommandError
from schemas.messages import Drive, Gear
from tests.support.logs import GEAR_TOPIC, foreign_log, gear_message, gears, own_log, saved, small_log
from tests.support.reading import Read


def merged(directory: Path, *contents: bytes, faults: Faults | None = None) -> tuple[Joined, Read]:
    """Files with these contents, merged; and what the mcap package reads of the result."""
    paths = [saved(directory / f"{number}.mcap", data) for number, data in enumerate(contents)]
    found = Faults() if faults is None else faults
    out = directory / "out.mcap"
    out.unlink(missing_ok=True)
    joined = merge(find_logs(paths, Faults()), out, found)
    assert faults is not None or not found.told
    assert check_log(out).whole or faults is not None
    return joined, Read(out)


def log_times(read: Read) -> list[int]:
    """In the order of the file."""
    return [message[2] for message in read.messages]


def test_messages_come_in_the_order_of_their_log_times(tmp_path: Path) -> None:
    """Whichever file they are from."""
    joined, read = merged(tmp_path, own_log([gears(0, 5, 100, 20)]), own_log([gears(5, 5, 110, 20)]))
    assert log_times(read) == list(range(100, 200, 10))
    assert (joined.messages, joined.duplicates, joined.channels) == (10, 0, 1)
    assert (joined.start_ns, joined.end_ns) == (100, 190)
    assert joined.bytes == (tmp_path / "out.mcap").stat().st_size


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.lists(st.lists(st.lists(st.integers(0, 50), min_size=1, max_size=6), max_size=5), min_size=1, max_size=3)
)
def test_any_order_in_the_files_becomes_that_of_time(tmp_path: Path, files: Sequence[list[list[int]]]) -> None:
    """Chunks that overlap, times that go backwards within them: nothing is lost."""
    number = 0
    contents, every = [], []
    for chunks in files:
        made = []
        for times in chunks:
            made.append([gear_message(number + place, time_ns) for place, time_ns in enumerate(times)])
            every += made[-1]
            number += len(times)
        contents.append(own_log(made))
    _, read = merged(tmp_path, *contents)
    assert log_times(read) == sorted(time_ns for _, _, time_ns, _ in every)
    assert sorted(message[1] for message in read.messages) == list(range(number))


def test_what_is_in_two_files_is_there_once(tmp_path: Path) -> None:
    """Though the recorders received it at different times; the earlier one stays."""
    later = [(1, sequence, 500 + log_ns, data) for _, sequence, log_ns, data in gears(0, 5, 100)]
    early = own_log([gears(0, 5, 100)])
    joined, read = merged(tmp_path, early, early)
    assert (joined.messages, joined.duplicates) == (5, 5)
    assert log_times(read) == [100, 110, 120, 130, 140]
    # Published at another time it is another message.
    assert merged(tmp_path, early, own_log([later]))[0].duplicates == 0


@pytest.mark.parametrize("other", [(1, 0, 100, b""), gear_message(1, 100), (1, 0, 101, gear_message(0, 100)[3])])
def test_only_the_same_in_all_is_a_duplicate(tmp_path: Path, other: tuple[int, int, int, bytes]) -> None:
    """Topic, publish time, sequence and data."""
    joined, _ = merged(tmp_path, own_log([gears(0, 1, 100)]), own_log([[other]]), faults=Faults())
    assert (joined.messages, joined.duplicates) == (2, 0)


def test_ids_of_channels_and_schemas_are_made_to_fit(tmp_path: Path) -> None:
    """The same id means another channel in each file; the same channel has other ids."""
    drive = LogChannel(1, "fleet/cruiser-1/chassis/drive", schema_name(Drive), descriptor_set(Drive))
    gear = LogChannel(2, GEAR_TOPIC, schema_name(Gear), descriptor_set(Gear))
    second = own_log([[(1, 0, 5, b""), gear_message(7, 6, 2)]], [drive, gear])
    joined, read = merged(tmp_path, own_log([gears(0, 2, 1, 1)]), second)
    assert [(topic, sequence) for topic, sequence, *_ in read.messages] == [
        (GEAR_TOPIC, 0),
        (GEAR_TOPIC, 1),
        ("fleet/cruiser-1/chassis/drive", 0),
        (GEAR_TOPIC, 7),
    ]
    assert joined.channels == len(read.channels) == len(read.schemas) == 2


def test_schemas_of_one_name_that_differ_are_both_kept(tmp_path: Path) -> None:
    """Each message keeps the one that it was written by."""
    old = LogChannel(1, GEAR_TOPIC, schema_name(Gear), descriptor_set(Gear).replace(b"active", b"activf"))
    _, read = merged(tmp_path, own_log([gears(0, 2, 1)]), own_log([gears(2, 2, 100)], [old]), faults=Faults())
    assert len(read.channels) == len(read.schemas) == 2
    assert {schema.data for schema in read.schemas.values()} == {descriptor_set(Gear), old.schema_data}


def test_channels_without_messages_are_kept(tmp_path: Path) -> None:
    """Somebody may look for them."""
    drive = LogChannel(2, "fleet/cruiser-1/chassis/drive", schema_name(Drive), descriptor_set(Drive))
    gear = LogChannel(1, GEAR_TOPIC, schema_name(Gear), descriptor_set(Gear))
    _, read = merged(tmp_path, own_log([gears(0, 2, 1)], [gear, drive]))
    assert {channel.topic for channel in read.channels} == {gear.topic, drive.topic}


@pytest.mark.parametrize("compression", CompressionType)
@pytest.mark.parametrize("use_chunking", [True, False])
def test_files_of_others_are_copied_as_they_are(
    tmp_path: Path,
    compression: CompressionType,
    use_chunking: bool,  # noqa: FBT001 - a parameter
) -> None:
    """Encodings, schemas, metadata of channels, the header's profile; with no word of ours about them."""
    schema = ("pkg/msg/Thing", "ros2msg", b"int8 x")
    data = foreign_log(
        encoding="cdr",
        schema=schema,
        data=b"\x00\x01",
        compression=compression,
        use_chunking=use_chunking,
        profile="ros2",
    )
    _, read = merged(tmp_path, data)
    [channel] = read.channels
    found = read.schemas[channel.schema_id]
    assert (channel.topic, channel.message_encoding, channel.metadata) == ("/t", "cdr", {"who": "else"})
    assert (found.name, found.encoding, found.data) == schema
    assert read.header.profile == "ros2"
    assert [(sequence, log_ns, data) for _, sequence, log_ns, _, data in read.messages] == [
        (number, number, b"\x00\x01") for number in range(10)
    ]
    [attachment] = read.attachments
    assert (attachment.name, attachment.log_time, attachment.create_time) == ("note", 4, 3)
    assert ("origin", {"by": "somebody"}) in [(one.name, one.metadata) for one in read.metadata]


def test_a_channel_without_a_schema_has_none_afterwards(tmp_path: Path) -> None:
    """Which MCAP allows."""
    _, read = merged(tmp_path, foreign_log(schema=None), faults=Faults())
    assert (read.channels[0].schema_id, read.schemas) == (0, {})


def test_metadata_and_attachments_are_kept_once(tmp_path: Path) -> None:
    """The same name with another content is another."""
    first = own_log([gears(0, 1, 1)], metadata=[("m", {"a": "1"})], attachments=[("x", b"1"), ("y", b"1")])
    second = own_log(
        [gears(1, 1, 9)], metadata=[("m", {"a": "1"}), ("m", {"a": "2"})], attachments=[("x", b"2"), ("y", b"1")]
    )
    _, read = merged(tmp_path, first, second)
    assert sorted((one.name, one.data) for one in read.attachments) == [("x", b"1"), ("x", b"2"), ("y", b"1")]
    assert [one.metadata for one in read.metadata if one.name == "m"] == [{"a": "1"}, {"a": "2"}]
    assert [one.metadata for one in read.metadata if one.name == MERGED_NAME] == [{"files": "0.mcap,1.mcap"}]


def test_the_last_word_is_about_all_files(tmp_path: Path) -> None:
    """Of a name of which the last record holds: all robots, and the sums of what was lost."""
    logs = [
        own_log(
            [gears(number, 1, number)],
            metadata=[
                (METADATA_NAME, {"robots": "early"}),
                (METADATA_NAME, {"robots": f"r-{number}", f"r-{number}.variant": "fine"}),
                (COMPLETENESS_NAME, {"t": json.dumps({"received": 10 + number, "written": 5, "lost_link": 1})}),
            ],
        )
        for number in range(2)
    ]
    merged(tmp_path, *logs)
    info = read_info(tmp_path / "out.mcap")
    assert info.robots == ["r-0", "r-1"]
    assert info.variants == {"r-0": "fine", "r-1": "fine"}
    assert info.completeness == {"t": KeyReport(received=21, written=10, lost_link=2)}


@pytest.mark.parametrize(("robots", "device"), [(("r-0", "r-0"), "r-0"), (("r-0", "r-1"), None)])
def test_logs_of_two_robots_are_filed_under_neither(
    robots: tuple[str, str], device: str | None, tmp_path: Path
) -> None:
    """Foxglove reads the last record of the name; those of one robot stay that robot's."""
    logs = [
        own_log(
            [gears(number, 1, number)],
            metadata=[(METADATA_NAME, {"robots": robot}), ("foxglove", {"deviceName": robot})],
        )
        for number, robot in enumerate(robots)
    ]
    _, read = merged(tmp_path, *logs)
    assert [one.metadata for one in read.metadata if one.name == "foxglove"][-1].get("deviceName") == device


def test_damage_costs_what_is_damaged(tmp_path: Path) -> None:
    """It is told, and the rest is in the new file, which is whole."""
    data = bytearray(own_log([gears(0, 3, 10), gears(3, 3, 100), gears(6, 3, 200)]))
    second = data.index(b"zstd", data.index(b"zstd") + 4)
    data[second + 20] ^= 0xFF
    faults = Faults()
    _, read = merged(tmp_path, bytes(data), faults=faults)
    assert [message[1] for message in read.messages] == [0, 1, 2, 6, 7, 8]
    assert len(faults.told) == 1
    assert "a chunk cannot be read" in faults.told[0]
    assert check_log(tmp_path / "out.mcap").whole


def test_a_part_is_merged_as_far_as_it_goes(tmp_path: Path) -> None:
    """A log that its recorder could not finish."""
    data = own_log([gears(0, 3, 10), gears(3, 3, 100)], metadata=[("m", {"a": "b"})])
    faults = Faults()
    _, read = merged(tmp_path, data[: data.index(b"\x0f\x04\x00\x00\x00\x00\x00\x00\x00") + 4], faults=faults)
    assert len(read.messages) == 6
    assert "m" in [one.name for one in read.metadata]
    assert faults


def test_any_noise_still_makes_a_whole_file(tmp_path: Path) -> None:
    """Random damage, many times over: never a traceback, and the result is sound."""
    generator = random.Random(3)  # noqa: S311 - nothing here is secret
    ours = small_log()
    for data in (ours, ours[:-300], foreign_log(use_chunking=False), foreign_log()):
        for _ in range(15):
            damaged = bytearray(data)
            for _ in range(generator.randint(1, 6)):
                damaged[generator.randrange(8, len(data))] ^= generator.randint(1, 255)
            merged(tmp_path, bytes(damaged), ours, faults=Faults())
            assert not [one for one in check_log(tmp_path / "out.mcap").findings if "index" in one.what]


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    """Neither a file nor a part; and both are as they were."""
    logs = find_logs([saved(tmp_path / "a.mcap", small_log())], Faults())
    for name in ("out.mcap", "out.mcap.part"):
        path = saved(tmp_path / name, b"precious")
        with pytest.raises(CommandError, match="exists, and is not overwritten"):
            merge(logs, tmp_path / "out.mcap", Faults())
        assert path.read_bytes() == b"precious"
        path.unlink()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.mcap"]


def test_a_place_that_takes_no_file_is_one_clear_error(tmp_path: Path) -> None:
    """Nothing is left of it."""
    logs = find_logs([saved(tmp_path / "a.mcap", small_log())], Faults())
    with pytest.raises(CommandError, match=r"cannot write .*No such file or directory"):
        merge(logs, tmp_path / "nowhere" / "out.mcap", Faults())


def test_an_interruption_leaves_nothing(tmp_path: Path) -> None:
    """As by Ctrl-C, in the middle."""
    logs = find_logs([saved(tmp_path / "a.mcap", small_log())], Faults())

    def interrupt(_: int) -> None:
        assert (tmp_path / "out.mcap.part").exists()
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        merge(logs, tmp_path / "out.mcap", Faults(), interrupt)
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap"]


def test_where_too_much_overlaps_the_order_is_given_up_and_nothing_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Memory is bounded; it is told."""
    monkeypatch.setattr(ordered, "HELD_BYTES_MAX", 1000)
    chunks = [
        [gear_message(2 * number, number), gear_message(2 * number + 1, 1000 - number)] for number in range(50)
    ]
    faults = Faults()
    _, read = merged(tmp_path, own_log(chunks), faults=faults)
    assert sorted(message[1] for message in read.messages) == list(range(100))
    assert faults.told == ["too much overlaps in time: the messages are not all in the order of their log times"]


@given(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 3), st.integers(0, 3), st.binary(max_size=1))))
def test_what_came_by_lately_is_remembered(messages: list[tuple[int, int, int, bytes]]) -> None:
    """Exactly, among the last so many; no message is ever taken for another one."""
    recent = Recent(1000)
    for place, message in enumerate(messages):
        assert recent.is_new(*message) == (message not in messages[:place])
    short = Recent(2)
    assert [short.is_new(1, number, 0, b"") for number in (1, 2, 1, 3, 4, 5, 6, 1)] == [
        True,
        True,
        False,
        True,
        True,
        True,
        True,
        True,
    ]


def test_the_answer_is_json(tmp_path: Path) -> None:
    """For programs."""
    joined, _ = merged(tmp_path, small_log())
    assert json.loads(msgspec.json.encode(joined))["messages"] == 12
