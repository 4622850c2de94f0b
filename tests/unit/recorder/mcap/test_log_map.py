"""Where chunks and channels stand, in logs in any state."""

import random
import re
from io import BytesIO

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.writer import Writer

from recorder.mcap import log_map
from recorder.mcap.log_map import EARLY_NS, LATE_NS, LogMap
from recorder.mcap.proof import SEARCH_BYTES
from tests.support.backfill_logs import (
    GEAR,
    MS,
    RX,
    SECOND,
    START_NS,
    Row,
    gear_rows,
    log_of,
    map_of,
    row,
)
from tests.support.nights import by_night

ROWS = [*gear_rows(40), row(0, 4000, RX, b"frame")]
LOG = log_of(ROWS)
OPEN = log_of(ROWS, is_finished=False)
CHUNKS = [found.start() - 41 for found in re.finditer(b"zstd", OPEN)]


def rows_of(data: bytes, chart: LogMap) -> list[Row]:
    """All messages that are found by a map."""
    return [
        Row(one.publish_ns, chart.channels[one.channel_id].topic, one.sequence, one.log_ns, one.data)
        for one in chart.messages(BytesIO(data))
    ]


@pytest.mark.parametrize("data", [LOG, OPEN])
def test_a_log_is_read_whether_it_is_whole_or_being_written(data: bytes) -> None:
    """Every message, its channel, and nothing damaged."""
    chart = map_of(data)
    assert rows_of(data, chart) == ROWS
    assert {one.topic: one.schema_name for one in chart.channels.values()} == {
        GEAR: "cruiser.Gear",
        RX: "cruiser.CanFrame",
    }
    assert (chart.damaged, chart.is_complete, len(chart)) == (0, True, 5)
    assert chart.start_ns == ROWS[0].log_ns
    assert chart.end_ns == ROWS[-1].log_ns


@pytest.mark.parametrize("step", [1, 5, 23])
def test_a_map_grows_with_its_log(step: int) -> None:
    """Wherever the writer has come to: the next look goes on from there, and reads nothing twice."""
    chart = LogMap()
    for size in range(0, len(LOG), step):
        chart.read_on(BytesIO(LOG[:size]), size)
    chart.read_on(BytesIO(LOG), len(LOG))
    assert rows_of(LOG, chart) == ROWS
    assert chart.damaged == 0


def test_only_chunks_that_may_hold_a_time_are_near_it() -> None:
    """Until one has been read its log time decides, with room for clocks and for what was asked for later."""
    chart = map_of(log_of(gear_rows(100, 60_000)))
    minute = 60 * SECOND
    starts = [START_NS + number * 10 * minute + 5 * MS for number in range(10)]
    from_ns, to_ns = START_NS + 25 * minute, START_NS + 26 * minute
    expected = [
        number
        for number, start_ns in enumerate(starts)
        if start_ns <= to_ns + LATE_NS and start_ns + 9 * minute >= from_ns - EARLY_NS
    ]
    assert chart.near(from_ns, to_ns) == expected == [2, 3]


def test_a_chunk_that_has_been_read_is_near_its_publish_times_only() -> None:
    """What was asked for later has spans of its own."""
    rows = [row(number + 100, 300_000 + number) for number in range(9)] + [row(9, 1000, lag_ms=299_100)]
    data = log_of(rows)
    chart = map_of(data)
    assert chart.near(START_NS + 100 * SECOND, START_NS + 101 * SECOND) == [0]
    chart.read(BytesIO(data), 0)
    assert chart.near(START_NS + 100 * SECOND, START_NS + 101 * SECOND) == []
    assert chart.near(START_NS + 300 * SECOND, START_NS + 301 * SECOND) == [0]
    assert chart.near(START_NS + SECOND, START_NS + SECOND + 1) == [0]
    assert chart.near(START_NS, START_NS + SECOND) == []


def test_chunks_out_of_order_are_found() -> None:
    """A clock that was set back."""
    rows = gear_rows(20, 1000) + gear_rows(20, 1000, first=20, at_ms=-5_000_000)
    chart = map_of(log_of(rows))
    assert chart.near(rows[20].publish_ns, rows[29].publish_ns) == [2, 3]
    assert chart.near(rows[0].publish_ns, rows[9].publish_ns) == [0, 1]


def test_a_log_cut_off_anywhere_is_read_up_to_there() -> None:
    """Never an exception."""
    for size in range(len(OPEN)):
        found = rows_of(OPEN[:size], map_of(OPEN[:size]))
        assert found == ROWS[: len(found)]
    assert len(found) >= 40


@pytest.mark.parametrize("step", [3, by_night(1)])
@pytest.mark.parametrize("data", [LOG, OPEN], ids=["whole", "open"])
def test_a_flipped_bit_costs_at_most_its_chunk_or_channel(data: bytes, step: int) -> None:
    """Each so many bytes: no exception, no message that was not written, and the loss is counted."""
    chooser = random.Random(5)  # noqa: S311 - reproducible, not secret
    for place in range(0, len(data), step):
        flipped = bytearray(data)
        flipped[place] ^= 1 << chooser.randrange(8)
        chart = map_of(bytes(flipped))
        found = rows_of(bytes(flipped), chart)
        assert [one for one in found if one not in ROWS] == []
        lost_gear = sum(one.topic == GEAR for one in ROWS) - sum(one.topic == GEAR for one in found)
        is_declaration = place < data.index(b"zstd")
        assert lost_gear <= 10 or is_declaration
        # What is no chunk any more cannot be missed, and the last write may look as if it were not all there yet.
        assert chart.damaged or found == ROWS[: len(found)] or place in CHUNKS


@given(st.binary(min_size=1, max_size=200), st.integers(0, len(OPEN) - 1))
def test_garbage_anywhere_never_raises_and_never_invents(garbage: bytes, place: int) -> None:
    """Overwritten, as by a bad block."""
    data = OPEN[:place] + garbage + OPEN[place + len(garbage) :]
    assert [one for one in rows_of(data, map_of(data)) if one not in ROWS] == []


@given(st.binary(max_size=500))
def test_what_is_no_log_holds_nothing(data: bytes) -> None:
    """Never an exception."""
    chart = map_of(data)
    assert (len(chart), rows_of(data, chart)) == (0, [])


def test_a_chunk_whose_length_is_damaged_hides_no_other() -> None:
    """The next one is found by what proves it."""
    damaged = bytearray(OPEN)
    assert damaged[CHUNKS[1]] == Opcode.CHUNK
    damaged[CHUNKS[1] + 4] ^= 0x10
    chart = map_of(bytes(damaged))
    assert rows_of(bytes(damaged), chart) == ROWS[:10] + ROWS[20:]
    assert chart.damaged == 1


def test_a_declaration_that_nobody_means_costs_no_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """A schema that says it is longer than any may be is damage, and is not read."""
    monkeypatch.setattr(log_map, "DECLARATION_MAX", 1000)
    stream = Watched(OPEN + b"\x03" + (5 * SEARCH_BYTES).to_bytes(8, "little") + bytes(5 * SEARCH_BYTES + 100))
    chart = LogMap()
    chart.read_on(stream, len(stream.getvalue()))
    assert max(stream.lengths) < 2 * SEARCH_BYTES
    assert len(chart) == 5


def test_a_map_leaves_the_rest_for_later_when_it_is_told_to() -> None:
    """It goes on where it stopped."""
    chart = LogMap()
    chart.read_on(BytesIO(LOG), len(LOG), chunks_max=2)
    assert (len(chart), chart.is_complete) == (2, False)
    many = log_of(gear_rows(2000))
    chart = LogMap()
    chart.read_on(BytesIO(many), len(many), lambda: True)
    assert 0 < len(chart) < 200
    assert not chart.is_complete
    chart.read_on(BytesIO(many), len(many))
    assert (len(chart), chart.is_complete) == (200, True)


def test_channels_that_are_no_protobuf_are_left_alone() -> None:
    """A log of others in the same directory."""
    stream = BytesIO()
    writer = Writer(stream, use_chunking=False)
    writer.start("", "other")
    writer.register_channel("t", "json", writer.register_schema("s", "jsonschema", b"{}"))
    writer.register_channel("u", "json", writer.register_schema("s", "protobuf", b""))
    writer.register_channel("v", "protobuf", writer.register_schema("s", "jsonschema", b"{}"))
    writer.finish()
    data = stream.getvalue()
    assert map_of(data).channels == {}


class Watched(BytesIO):
    """A stream that knows what was read."""

    def __init__(self, data: bytes) -> None:
        super().__init__(data)
        self.lengths: set[int] = set()

    def read(self, size: int | None = -1, /) -> bytes:
        self.lengths.add(size or 0)
        return super().read(size)
