"""The messages of logs, as rows."""

from array import array
from io import BytesIO
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from recorder.encoding.protobuf import descriptor_set, schema_name
from recorder.mcap.framing import MAGIC, encode_index
from recorder.mcap.reader import PackedChunk, read_pieces
from recorder.mcap.writer import LogChannel
from recorder.reading.logs import Faults, LogFile, find_logs
from recorder.reading.rows import END_OF_TIME_NS, LogReader, Row, Selection, decoded_rows, read_rows
from schemas.messages import Drive, Gear
from tests.support.logs import GEAR_TOPIC, foreign_log, gears, own_log, saved

DRIVE_TOPIC = "fleet/cruiser-1/chassis/drive"
CHANNELS = [
    LogChannel(1, GEAR_TOPIC, schema_name(Gear), descriptor_set(Gear)),
    LogChannel(2, DRIVE_TOPIC, schema_name(Drive), descriptor_set(Drive)),
]
LOG = own_log(
    [gears(0, 5, 100), [(2, 0, 200, b"")], gears(5, 5, 300), [(2, 1, 400, b"")]],
    CHANNELS,
)


def rows(directory: Path, selection: Selection, *contents: bytes, faults: Faults | None = None) -> list[Row]:
    """The rows of files with these contents."""
    found = Faults() if faults is None else faults
    paths = [saved(directory / f"{number}.mcap", data) for number, data in enumerate(contents)]
    read = list(read_rows(find_logs(paths, found), selection, found))
    assert faults is not None or not found.told
    return read


def of_subject(name: str) -> Selection:
    """Only this subject."""
    return Selection(wants=lambda topic: topic.subject == name)


def test_every_row_has_its_topic_and_its_times(tmp_path: Path) -> None:
    """And is decoded by the topic."""
    first = rows(tmp_path, Selection(), LOG)[0]
    assert (first.topic.name, first.topic.robot, first.topic.subject) == (GEAR_TOPIC, "cruiser-1", "chassis/gear")
    assert (first.sequence, first.log_ns, first.publish_ns) == (0, 100, 100)
    assert first.topic.decode is not None
    assert first.topic.decode(first.data).sequence == 0


def test_what_is_not_of_its_schema_is_a_fault_and_left_out(tmp_path: Path) -> None:
    """The rows before and behind it come with their messages."""
    path = saved(
        tmp_path / "log.mcap", own_log([[*gears(0, 1, 5), (1, 1, 6, b"\xff"), *gears(2, 1, 7)]], CHANNELS)
    )
    faults = Faults()
    found = list(decoded_rows(find_logs([path], faults), Selection(), faults))
    assert [(row.log_ns, type(message), message.sequence) for row, message in found] == [
        (5, Gear, 0),
        (7, Gear, 2),
    ]
    assert [line.partition(":")[0] for line in faults.told] == [GEAR_TOPIC]


def test_rows_of_several_files_come_by_log_time(tmp_path: Path) -> None:
    """Those that overlap, and one that begins when another has ended."""
    found = rows(
        tmp_path,
        Selection(),
        own_log([gears(0, 5, 100)]),
        own_log([gears(5, 5, 105)]),
        own_log([gears(10, 2, 900)]),
    )
    assert [row.log_ns for row in found] == [*range(100, 150, 5), 900, 910]


@pytest.mark.parametrize(
    ("from_ns", "to_ns", "count"),
    [(0, END_OF_TIME_NS, 12), (0, 100, 0), (100, 101, 1), (140, 301, 3), (400, 401, 1), (401, END_OF_TIME_NS, 0)],
)
def test_a_time_begins_with_its_first_and_ends_before_its_last(
    tmp_path: Path, from_ns: int, to_ns: int, count: int
) -> None:
    """By log time."""
    found = rows(tmp_path, Selection(from_ns=from_ns, to_ns=to_ns), LOG)
    assert len(found) == count
    assert all(from_ns <= row.log_ns < to_ns for row in found)


def test_only_wanted_topics_come(tmp_path: Path) -> None:
    """By whatever is known of a topic."""
    assert {row.topic.name for row in rows(tmp_path, of_subject("chassis/drive"), LOG)} == {DRIVE_TOPIC}
    assert rows(tmp_path, of_subject("nothing"), LOG) == []


def test_a_chunk_without_wanted_topics_is_not_unpacked(tmp_path: Path) -> None:
    """Damage in it is no matter; of the same file, to who wants the others, it is."""
    data = bytearray(LOG)
    data[data.index(b"zstd") + 20] ^= 0xFF
    assert len(rows(tmp_path, of_subject("chassis/drive"), bytes(data))) == 2
    faults = Faults()
    assert len(rows(tmp_path, of_subject("chassis/gear"), bytes(data), faults=faults)) == 5
    assert len(faults.told) == 1
    assert "a chunk cannot be read" in faults.told[0]


def test_a_chunk_outside_of_the_time_is_not_unpacked(tmp_path: Path) -> None:
    """Nor is that."""
    data = bytearray(LOG)
    data[data.index(b"zstd") + 20] ^= 0xFF
    assert len(rows(tmp_path, Selection(from_ns=150), bytes(data))) == 7


@pytest.mark.parametrize("entries", [[100, 1], [100, 10**6], [100, 2**63]])
def test_wrong_message_indexes_are_told_and_all_is_read(tmp_path: Path, entries: list[int]) -> None:
    """The chunk itself is asked then."""
    good = array("Q", [value for number in range(5) for value in (100 + 10 * number, 0)])
    start = LOG.index(encode_index(1, good)[:15])
    wrong = encode_index(1, array("Q", 5 * entries))
    faults = Faults()
    found = rows(tmp_path, Selection(), LOG[:start] + wrong + LOG[start + len(wrong) :], faults=faults)
    assert [row.log_ns for row in found] == [row.log_ns for row in rows(tmp_path, Selection(), LOG)]
    assert any("the message indexes behind a chunk are wrong" in fault for fault in faults.told)


@pytest.mark.parametrize("use_chunking", [True, False])
@pytest.mark.parametrize("has_end", [True, False])
def test_channels_that_are_declared_in_chunks_are_known(
    tmp_path: Path,
    use_chunking: bool,  # noqa: FBT001 - a parameter
    has_end: bool,  # noqa: FBT001 - a parameter
) -> None:
    """As the mcap package's writer does; also where the summary is lost."""
    data = foreign_log(use_chunking=use_chunking)
    faults = Faults()
    found = rows(tmp_path, Selection(), data if has_end else data[:-30], faults=faults)
    assert [row.log_ns for row in found] == list(range(10))
    assert {row.topic.name for row in found} == {"/t"}
    assert bool(faults) != has_end


def test_what_is_behind_damage_is_found_again(tmp_path: Path) -> None:
    """A record that makes no sense costs itself."""
    data = bytearray(LOG)
    second = data.index(b"zstd", data.index(b"zstd") + 4)
    data[second - 41] = 0
    faults = Faults()
    found = rows(tmp_path, Selection(), bytes(data), faults=faults)
    assert [row.log_ns for row in found if row.topic.name == GEAR_TOPIC][-1] == 340
    assert faults


def test_a_message_of_a_lost_channel_is_told(tmp_path: Path) -> None:
    """Nothing is known of it but that it is there."""
    faults = Faults()
    found = rows(tmp_path, Selection(), own_log([[*gears(0, 1, 5), (9, 0, 6, b"")]]), faults=faults)
    assert len(found) == 1
    assert any("channel 9, which the file does not hold" in fault for fault in faults.told)


def test_a_file_that_is_gone_meanwhile_costs_itself(tmp_path: Path) -> None:
    """The others are read."""
    faults = Faults()
    paths = [saved(tmp_path / name, own_log([gears(0, 2, 5)])) for name in ("a.mcap", "b.mcap")]
    logs = find_logs(paths, faults)
    paths[0].unlink()
    assert len(list(read_rows(logs, Selection(), faults))) == 2
    assert "No such file" in faults.told[0]


def test_the_progress_comes_to_the_length_of_the_file(tmp_path: Path) -> None:
    """Bytes passed over count as well."""
    told: list[int] = []
    log = find_logs([saved(tmp_path / "a.mcap", LOG)], Faults())
    list(read_rows(log, of_subject("nothing"), Faults(), told.append))
    assert sum(told) == len(LOG)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.binary(max_size=200), st.integers(0, 10_000))
def test_nothing_that_a_file_may_hold_raises(tmp_path: Path, noise: bytes, place: int) -> None:
    """Noise in place of a file's bytes."""
    place = 8 + place % (len(LOG) - 8)
    rows(tmp_path, Selection(), LOG[:place] + noise + LOG[place + len(noise) :], faults=Faults())


def test_wherever_a_file_is_cut_off_its_whole_chunks_are_read() -> None:
    """Also where the cut goes through the message indexes behind the last one."""
    data = own_log([[*gears(0, 3, 100), (2, 0, 115, b""), *gears(3, 2, 130)]], CHANNELS)
    [chunk] = [piece for piece in read_pieces(BytesIO(data), len(data)) if isinstance(piece, PackedChunk)]
    for size in range(len(MAGIC), len(data)):
        log = LogFile(Path("log"), size, 0, 0)
        found = list(LogReader(BytesIO(data[:size]), log, Selection(), Faults()).rows())
        assert len(found) == (6 if size >= chunk.offset + chunk.length else 0)
