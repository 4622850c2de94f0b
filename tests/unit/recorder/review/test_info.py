"""What a log holds."""

from pathlib import Path
from typing import Any

import pytest
from mcap.writer import CompressionType

from recorder.cli.info import describe
from recorder.record.incidents import INCIDENT_NAME
from recorder.review.info import LogInfo, LogSourceInfo, read_info
from schemas.messages import Gear
from tests.support.logs import NO_INDEXES, channel_of, foreign_log, gear_message, gears, own_log, small_log


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "log.mcap"


def info_of(path: Path, data: bytes) -> LogInfo:
    path.write_bytes(data)
    return read_info(path)


def test_all_incidents_are_named(path: Path) -> None:
    about = [{"file": name, "because": name[:1]} for name in ("", "a.incident.mcap", "b.incident.mcap")]
    chunk = [gears(0, 1, 1)]
    named = info_of(path, own_log(chunk, metadata=[(INCIDENT_NAME, about[place]) for place in (0, 1, 2, 1)]))
    assert (named.incidents, named.incident) == (about[1:], about[1])
    assert info_of(path, own_log(chunk, metadata=[(INCIDENT_NAME, about[0])])).incidents == about[:1]
    assert info_of(path, own_log(chunk)).incidents == []
    said = [line for line in describe(named) if "incident.mcap" in line]
    assert said == ["  incident a.incident.mcap: a", "  incident b.incident.mcap: b"]


def test_an_end_that_is_damaged_is_not_believed(path: Path) -> None:
    data = small_log()
    summary_start = int.from_bytes(data[-28:-20], "little")
    for place in range(summary_start, len(data), 97):
        damaged = bytearray(data)
        damaged[place] ^= 0x10
        found = info_of(path, bytes(damaged))
        assert (found.source, found.messages) == (LogSourceInfo.RECORDS, 12)


def test_no_chunk_of_a_whole_log_is_read(path: Path) -> None:
    data = bytearray(own_log([gears(0, 5, 100), gears(5, 5, 200)]))
    data[data.index(b"zstd") + 20] ^= 0xFF
    found = info_of(path, bytes(data))
    assert (found.whole, found.source, found.messages) == (True, LogSourceInfo.SUMMARY, 10)


def test_each_channel_has_its_own_times(path: Path) -> None:
    channels = [channel_of(Gear, number, f"t/{number}") for number in (1, 2, 3, 4)]
    chunks = [
        [gear_message(0, 10), gear_message(1, 20, 2)],
        [gear_message(2, 30), gear_message(3, 31, 3)],
        [gear_message(4, 40), gear_message(5, 60, 2)],
    ]
    found = info_of(path, own_log(chunks, channels))
    assert found.source is LogSourceInfo.SUMMARY
    spans = [(one.messages, one.first_ns, one.last_ns) for one in found.channels]
    assert spans == [(3, 10, 40), (2, 20, 60), (1, 31, 31), (0, None, None)]
    rates = [pytest.approx(2 / 30e-9), pytest.approx(1 / 40e-9), None, None]
    assert [one.rate_hz for one in found.channels] == rates
    # In chunks that are not in order the first one of a channel is not the earliest.
    found = info_of(path, own_log([gears(0, 5, 500), gears(5, 5, 100)]))
    [channel] = found.channels
    assert (found.source, channel.first_ns, channel.last_ns) == (LogSourceInfo.RECORDS, 100, 540)


@pytest.mark.parametrize("compression", CompressionType)
@pytest.mark.parametrize(
    "given",
    [
        {},
        {"use_chunking": False},
        {"use_statistics": False},
        {"use_summary_offsets": False},
        {"repeat_channels": False},
        {"repeat_schemas": False},
        {"index_types": NO_INDEXES},
        {"enable_crcs": False},
    ],
)
def test_files_of_others_tell_the_same(path: Path, compression: CompressionType, given: dict[str, Any]) -> None:
    found = info_of(path, foreign_log(range(10, 20), compression=compression, **given))
    [channel] = found.channels
    assert (found.whole, found.messages, found.start_ns, found.end_ns) == (True, 10, 10, 19)
    assert (channel.topic, channel.schema, channel.encoding, channel.messages) == ("/t", "thing", "json", 10)
    assert (channel.first_ns, channel.last_ns) == (10, 19)
    assert [(one.name, one.bytes) for one in found.attachments] == [("note", 10)]
    assert found.metadata == {"origin": {"by": "somebody"}}
    assert (found.robots, found.completeness) == ([], {})
