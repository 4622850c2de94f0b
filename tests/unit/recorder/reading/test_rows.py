"""The messages of logs as rows."""

from array import array
from pathlib import Path

import pytest

from recorder.mcap.framing import encode_index
from recorder.reading.logs import Faults, find_logs
from recorder.reading.rows import END_OF_TIME_NS, Row, Selection, decoded_rows, read_rows
from schemas.messages import Drive, Gear
from tests.support.logs import GEAR_TOPIC, channel_of, flipped, foreign_log, gears, own_log, saved

DRIVE_TOPIC = "fleet/cruiser-1/chassis/drive"
CHANNELS = [channel_of(Gear, 1, GEAR_TOPIC), channel_of(Drive, 2, DRIVE_TOPIC)]
LOG = own_log([gears(0, 5, 100), [(2, 0, 200, b"")], gears(5, 5, 300), [(2, 1, 400, b"")]], CHANNELS)


def rows(directory: Path, selection: Selection, *contents: bytes, faults: Faults | None = None) -> list[Row]:
    found = Faults() if faults is None else faults
    paths = [saved(directory / f"{number}.mcap", data) for number, data in enumerate(contents)]
    read = list(read_rows(find_logs(paths, found), selection, found))
    assert faults is not None or not found.told
    return read


def of_subject(name: str) -> Selection:
    return Selection(wants=lambda topic: topic.subject == name)


def test_what_is_not_of_its_schema_is_a_fault_and_left_out(tmp_path: Path) -> None:
    data = own_log([[*gears(0, 1, 5), (1, 1, 6, b"\xff"), *gears(2, 1, 7)]], CHANNELS)
    path = saved(tmp_path / "log.mcap", data)
    faults = Faults()
    found = list(decoded_rows(find_logs([path], faults), Selection(), faults))
    assert [(row.log_ns, type(one), one.sequence) for row, one in found] == [(5, Gear, 0), (7, Gear, 2)]
    assert [line.partition(":")[0] for line in faults.told] == [GEAR_TOPIC]


def test_rows_of_several_files_come_by_log_time(tmp_path: Path) -> None:
    found = rows(
        tmp_path,
        Selection(),
        own_log([gears(0, 5, 100)]),
        own_log([gears(5, 5, 105)]),
        own_log([gears(10, 2, 900)]),
    )
    assert [row.log_ns for row in found] == [*range(100, 150, 5), 900, 910]


GEARS = [*range(100, 150, 10)], [*range(300, 350, 10)]
ALL = [*GEARS[0], 200, *GEARS[1], 400]
FIRST = LOG.index(b"zstd")
DAMAGED = flipped(LOG)
SECOND = LOG.index(b"zstd", FIRST + 4)


def indexed(*entries: int) -> bytes:
    """The log with other message indexes behind its first chunk."""
    good = array("Q", [value for number in range(5) for value in (100 + 10 * number, 0)])
    start, wrong = LOG.index(encode_index(1, good)[:15]), encode_index(1, array("Q", 5 * entries))
    return LOG[:start] + wrong + LOG[start + len(wrong) :]


@pytest.mark.parametrize(
    ("selection", "data", "log_ns", "fault"),
    [
        # A time begins with its first and ends before its last.
        *(
            (Selection(from_ns=first, to_ns=last), LOG, [one for one in ALL if first <= one < last], "")
            for first, last in ((0, END_OF_TIME_NS), (0, 100), (100, 101), (140, 301), (400, 401), (401, 10**9))
        ),
        (of_subject("chassis/drive"), LOG, [200, 400], ""),
        (of_subject("nothing"), LOG, [], ""),
        # A chunk without wanted topics, or outside of the time, is not unpacked: damage in it is no matter.
        (of_subject("chassis/drive"), DAMAGED, [200, 400], ""),
        (of_subject("chassis/gear"), DAMAGED, GEARS[1], "a chunk cannot be read"),
        (Selection(from_ns=150), DAMAGED, ALL[5:], ""),
        # A record that makes no sense costs itself.
        (of_subject("chassis/gear"), LOG[: SECOND - 41] + b"\0" + LOG[SECOND - 40 :], GEARS[0] + GEARS[1], " "),
        # The chunk itself is asked where its indexes are wrong.
        *(
            (Selection(), indexed(100, wrong), ALL, "indexes behind a chunk are wrong")
            for wrong in (1, 10**6, 2**63)
        ),
        # Of a lost channel nothing is known but that the message is there.
        (Selection(), own_log([[*gears(0, 1, 5), (9, 0, 6, b"")]]), [5], "9, which the file does not hold"),
        # Channels that are declared in chunks are known, as of the mcap package's writer, also without a summary.
        *((Selection(), foreign_log(use_chunking=chunks), [*range(10)], "") for chunks in (True, False)),
        *((Selection(), foreign_log(use_chunking=chunks)[:-30], [*range(10)], " ") for chunks in (True, False)),
    ],
)
def test_what_is_read_of_a_file(
    tmp_path: Path, selection: Selection, data: bytes, log_ns: list[int], fault: str
) -> None:
    faults = Faults()
    assert [row.log_ns for row in rows(tmp_path, selection, data, faults=faults)] == log_ns
    assert bool(faults) == bool(fault)
    assert any(fault in one for one in faults.told) == bool(fault)
