"""What logs answer: complete, once, in order, and in bounds."""

import random
import tracemalloc
from collections.abc import Iterator
from functools import partial
from io import BytesIO
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader

from recorder.backfill import excerpt as module
from recorder.backfill.excerpt import PIECE_NAME, Excerpt, LogCopy, LoggedBytes
from recorder.encoding.protobuf_schema import descriptor_set
from recorder.mcap.chunk import ChunkBuilder
from recorder.mcap.log_map import LogMap
from recorder.mcap.reader import LoggedMessage
from recorder.mcap.writer import McapFile
from schemas.messages import Gear
from schemas.recording import Backfill, BackfillPiece
from tests.support.backfill_logs import (
    CAMERA,
    GEAR,
    HEALTH,
    MS,
    RX,
    SECOND,
    START_NS,
    Row,
    channel_of,
    copies,
    excerpt,
    gear_rows,
    log_of,
    map_of,
    row,
    rows_of,
)
from tests.support.nights import by_night

HOUR_NS = 3600 * SECOND
REQUEST = Backfill("**", START_NS, START_NS + HOUR_NS)


def asked_to_the_end(logs: list[bytes], request: Backfill) -> list[BackfillPiece]:
    """All pieces, as who asks again gets them."""
    found: list[BackfillPiece] = []
    from_ns = request.from_ns
    while from_ns < request.to_ns:
        again = Backfill(request.key, from_ns, request.to_ns, request.max_bytes)
        pieces = list(Excerpt(copies(*logs), lambda _: True, again, bool).pieces())
        assert [piece.is_last for piece in pieces] == [False] * (len(pieces) - 1) + [True]
        assert pieces[-1].next_ns > from_ns
        from_ns = pieces[-1].next_ns
        found += pieces
    return found


ROWS = st.lists(
    st.builds(
        lambda sequence, at_ms, topic, size, lag_ms: row(sequence, at_ms, topic, bytes(size), lag_ms),
        sequence=st.integers(0, 2**32 - 1),
        at_ms=st.integers(0, 200) | st.integers(0, 2_000_000),
        topic=st.sampled_from([GEAR, RX, HEALTH, CAMERA]),
        size=st.integers(0, 300),
        lag_ms=st.integers(-50_000, 500_000),
    ),
    max_size=60,
    unique=True,
)


@given(
    ROWS,
    st.integers(1, 8),
    st.integers(1, 2000),
    st.integers(0, 2_000_000),
    st.integers(1, 2_000_000),
    st.booleans(),
)
def test_an_answer_holds_what_was_asked_for_once_and_in_order(
    rows: list[Row],
    chunk_messages: int,
    max_bytes: int,
    from_ms: int,
    length_ms: int,
    is_finished: bool,  # noqa: FBT001 - Hypothesis gives it
) -> None:
    """Whatever order the logs have it in, over two logs, and however often it has to be asked again."""
    third = len(rows) // 3
    parts = rows[: 2 * third], rows[third:]
    logs = [log_of(part, chunk_messages, is_finished=is_finished) for part in parts]
    from_ns = START_NS + from_ms * MS
    request = Backfill("**", from_ns, from_ns + length_ms * MS, max_bytes)
    pieces = asked_to_the_end(logs, request)
    expected = [one for one in rows if request.from_ns <= one.publish_ns < request.to_ns]
    found = rows_of(pieces)
    # The copies of one message in two logs are one, and its time of receipt is that of either.
    assert {(one.publish_ns, one.topic, one.sequence, one.data) for one in expected} == {
        (one.publish_ns, one.topic, one.sequence, one.data) for one in found
    }
    assert len(found) == len({(one.publish_ns, one.topic, one.sequence, one.data) for one in found})
    assert [one for one in found if one not in expected] == []
    times = [one.publish_ns for one in found]
    assert times == sorted(times)
    assert sum(piece.messages for piece in pieces) == len(found)


@given(ROWS, st.integers(1, 8), st.integers(300, 3000))
def test_all_before_next_ns_has_been_answered(rows: list[Row], chunk_messages: int, piece_bytes: int) -> None:
    """After every piece, and each begins where the one before it ended."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "PIECE_BYTES", piece_bytes)
        pieces = list(Excerpt(copies(log_of(rows, chunk_messages)), lambda _: True, REQUEST, bool).pieces())
    expected = {one for one in rows if one.publish_ns < REQUEST.to_ns}
    so_far: set[Row] = set()
    for piece in pieces:
        so_far |= set(rows_of([piece]))
        assert {one for one in expected if one.publish_ns < piece.next_ns} <= so_far
    assert so_far == expected
    assert pieces[-1].next_ns == REQUEST.to_ns
    abouts = [about(piece) for piece in pieces if piece.mcap]
    assert [one["number"] for one in abouts] == [str(number) for number in range(len(abouts))]
    ends = [REQUEST.from_ns, *(piece.next_ns for piece in pieces)]
    assert [int(one["from_ns"]) for one in abouts] == ends[: len(abouts)]
    assert all(piece.mcap for piece in pieces) or not expected


def about(piece: BackfillPiece) -> dict[str, str]:
    """What a piece says of itself."""
    (found,) = make_reader(BytesIO(piece.mcap)).iter_metadata()
    assert found.name == PIECE_NAME
    return found.metadata


@given(ROWS, st.integers(1, 5000))
def test_slices_that_are_cut_short_lose_nothing(rows: list[Row], gather_bytes: int) -> None:
    """However little may be held."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "GATHER_BYTES", gather_bytes)
        pieces = list(Excerpt(copies(log_of(rows)), lambda _: True, REQUEST, bool).pieces())
    assert sorted(rows_of(pieces)) == sorted(one for one in rows if one.publish_ns < REQUEST.to_ns)


def test_topics_that_are_not_wanted_are_left_out() -> None:
    """And their schemas."""
    rows = [row(number, number, topic) for number in range(5) for topic in (GEAR, RX)]
    pieces = excerpt([log_of(rows)], is_wanted=lambda topic: topic == RX)
    assert {one.topic for one in rows_of(pieces)} == {RX}
    assert b"cruiser.Gear" not in pieces[0].mcap


def test_nothing_is_one_empty_last_piece() -> None:
    """From no log at all, and from logs of another time."""
    for logs in ([], [log_of(gear_rows(10))]):
        (piece,) = excerpt(logs, from_ms=10_000_000, to_ms=20_000_000)
        assert (piece.ok, piece.is_last, piece.messages, piece.mcap) == (True, True, 0, b"")
        assert piece.next_ns == START_NS + 20_000_000 * MS


def test_the_bytes_of_an_answer_are_bounded() -> None:
    """No more than asked for, but at least one instant, and no instant in part: so it always gets further."""
    rows = [row(number, number // 2, data=bytes(100)) for number in range(1000)]
    size = 131
    for max_bytes in (1, size, 10 * size, 99 * size):
        pieces = excerpt([log_of(rows)], max_bytes=max_bytes)
        count = sum(piece.messages for piece in pieces)
        assert count == max(2, -(-(max_bytes // size) // 2) * 2)
        assert pieces[-1].next_ns == rows[count].publish_ns
        assert pieces[-1].is_last


def test_pieces_are_small_and_whole_files() -> None:
    """A message that is larger than a piece is one of its own."""
    sizes = [1000] * 600 + [400_000] + [1000] * 10
    rows = [row(number, number, data=bytes(size)) for number, size in enumerate(sizes)]
    pieces = excerpt([log_of(rows)])
    assert rows_of(pieces) == rows
    for piece in pieces:
        found = rows_of([piece])
        assert sum(31 + len(one.data) for one in found) <= module.PIECE_BYTES or len(found) == 1
    assert len(pieces) == 5


def test_schemas_of_two_versions_are_in_two_pieces() -> None:
    """A file has one schema of a name."""
    other = descriptor_set(Gear) + b"\xfa\x01\x00"
    logs = [log_of(gear_rows(5)), log_of(gear_rows(5, first=5, at_ms=500), schema_data=other)]
    pieces = excerpt(logs)
    assert len(pieces) == 2
    for piece, expected in zip(pieces, (descriptor_set(Gear), other), strict=True):
        reader = make_reader(BytesIO(piece.mcap))
        assert {schema.data for schema, _, _ in reader.iter_messages() if schema} == {expected}


def test_the_time_of_an_answer_is_bounded() -> None:
    """It stops between any two chunks; what it says has been answered has, and asking again gets further."""
    rows = gear_rows(400)
    request = Backfill("**", START_NS, START_NS + HOUR_NS)
    logs = copies(log_of(rows))
    for looks in range(1, 60):
        left = iter(range(looks))
        pieces = list(Excerpt(logs, lambda _: True, request, lambda left=left: next(left, None) is None).pieces())  # type: ignore[misc] # mypy cannot infer a lambda with a default
        assert pieces[-1].is_last
        found = rows_of(pieces)
        assert found == [one for one in rows if one.publish_ns < pieces[-1].next_ns]
    assert found


def test_an_instant_without_end_takes_no_more_time_than_any_other(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is answered in pieces that are put together once, and broken off when the time is over."""
    monkeypatch.setattr(module, "GATHER_BYTES", 50_000)
    monkeypatch.setattr(module, "PIECE_BYTES", 10_000)
    monkeypatch.setattr(module, "LOOK_EVERY", 100)
    rows = [row(number % 50, 0, topic, number.to_bytes(2), 1) for number in range(1000) for topic in (GEAR, RX)]
    logs = copies(log_of(rows, 1000), log_of(rows[:700]))
    sorts = 0

    def earliest(found: list[LoggedBytes], end: module.Place) -> tuple[list[LoggedBytes], module.Place, int]:
        nonlocal sorts
        sorts += len(found)
        return was(found, end)

    was = module._earliest
    monkeypatch.setattr(module, "_earliest", earliest)
    pieces = list(Excerpt(logs, lambda _: True, REQUEST, bool).pieces())
    found = rows_of(pieces)
    assert len(found) == len(rows)
    assert {(one.topic, one.sequence, one.data) for one in found} == {
        (one.topic, one.sequence, one.data) for one in rows
    }
    assert pieces[-1].next_ns == REQUEST.to_ns
    # Each time that it is gone through a message is sorted once or twice, and it is a dozen times.
    assert sorts < 100 * len(rows)
    ends = set()

    def is_over(left: Iterator[int]) -> bool:
        return next(left, None) is None

    for looks in range(1, 400, 7):
        left = iter(range(looks))
        some = list(Excerpt(logs, lambda _: True, REQUEST, partial(is_over, left)).pieces())
        assert some[-1].is_last
        assert {one.data for one in rows_of(some)} <= {one.data for one in rows}
        ends.add(some[-1].next_ns)
    assert ends >= {START_NS}


def test_an_answer_is_broken_off_within_an_instant_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """When the time is over no more than a piece follows; what has been answered is all before that instant."""
    monkeypatch.setattr(module, "PIECE_BYTES", 1000)
    logs = copies(log_of([row(number, 0) for number in range(1000)], 1000))
    came: list[BackfillPiece] = []
    answer = Excerpt(logs, lambda _: True, REQUEST, lambda: len(came) >= 3).pieces()
    while (piece := next(answer, None)) is not None:
        came.append(piece)
    assert len(came) <= 5
    assert (came[-1].is_last, came[-1].next_ns) == (True, START_NS)
    assert len(rows_of(came)) == sum(piece.messages for piece in came) > 60


def test_the_time_is_looked_at_within_a_chunk(monkeypatch: pytest.MonkeyPatch) -> None:
    """A chunk may hold half a million messages."""
    monkeypatch.setattr(module, "LOOK_EVERY", 100)
    looks = 0

    def is_expired() -> bool:
        nonlocal looks
        looks += 1
        return False

    logs = copies(log_of(gear_rows(2000, period_ms=1), chunk_messages=2000))
    assert len(rows_of(Excerpt(logs, lambda _: True, REQUEST, is_expired).pieces())) == 2000
    assert looks >= 20


def test_no_chunk_is_read_when_the_time_is_over(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is looked at before each."""
    read: list[int] = []

    def watched(_chart: LogMap, _stream: object, number: int) -> list[LoggedMessage]:
        read.append(number)
        return []

    monkeypatch.setattr(LogMap, "read", watched)
    logs = copies(log_of(gear_rows(400)))
    list(Excerpt(logs, lambda _: True, REQUEST, lambda: len(read) == 7).pieces())
    assert len(read) == 7


def test_a_log_that_cannot_be_read_is_left_out_and_named() -> None:
    """The others are answered."""

    class Broken(BytesIO):
        def read(self, _size: int | None = -1, /) -> bytes:
            raise OSError(5, "Input/output error")

    good = gear_rows(20)
    broken = LogCopy("bad.mcap", Broken, map_of(log_of(gear_rows(20, first=50))))
    pieces = list(Excerpt([broken, *copies(log_of(good))], lambda _: True, REQUEST, bool).pieces())
    assert rows_of(pieces) == good
    assert pieces[-1].detail == "bad.mcap: Input/output error"


def test_damaged_chunks_are_left_out_and_counted() -> None:
    """The rest of the log is answered."""
    data = bytearray(log_of(gear_rows(30)))
    data[data.index(b"zstd", data.index(b"zstd") + 1) + 30] ^= 1
    pieces = excerpt([bytes(data)])
    assert [one.sequence for one in rows_of(pieces)] == [*range(10), *range(20, 30)]
    assert pieces[-1].detail == "1 damaged places were skipped"


@given(st.data())
def test_truncated_and_flipped_logs_never_raise(data: st.DataObject) -> None:
    """Nor bring a message that was not written."""
    rows = [row(number, number * 10, topic, bytes(20)) for number in range(30) for topic in (GEAR, CAMERA)]
    log = bytearray(log_of(rows, 7, is_finished=data.draw(st.booleans())))
    for place in data.draw(st.lists(st.integers(0, len(log) - 1), max_size=4)):
        log[place] ^= 1 << data.draw(st.integers(0, 7))
    cut = bytes(log[: data.draw(st.integers(0, len(log)))])
    pieces = asked_to_the_end([cut], REQUEST)
    assert [one for one in rows_of(pieces) if one not in rows] == []


@pytest.mark.parametrize("period_ns", [by_night(MS), by_night(1), 0])
def test_memory_does_not_grow_with_the_log_or_the_answer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, period_ns: int
) -> None:
    """Neither with a long one, nor where all of it is published at the same time, or nearly."""
    monkeypatch.setattr(module, "GATHER_BYTES", 1_000_000)
    path = tmp_path / "long.mcap"
    count = 8_000
    _write_long(path, count, period_ns)
    stream = path.open("rb")
    with stream:
        chart = map_of(stream.read())
    log = LogCopy("long", lambda: path.open("rb"), chart)
    request = Backfill("**", START_NS, START_NS + HOUR_NS, 256_000_000)
    messages = 0
    tracemalloc.start()
    for piece in Excerpt([log], lambda _: True, request, bool).pieces():
        messages += piece.messages
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert messages == count
    assert path.stat().st_size > 900 * count
    assert peak < 2 * module.GATHER_BYTES + 3_000_000


def _write_long(path: Path, count: int, period_ns: int) -> None:
    """A log of data that does not compress."""
    noise = _noise()
    with path.open("wb", buffering=0) as stream:
        file = McapFile(stream, "test")
        file.add_channel(channel_of(GEAR, 1))
        builder = ChunkBuilder()
        for number in range(count):
            publish_ns = START_NS + number * period_ns
            builder.add(1, number, publish_ns, publish_ns, next(noise))
            if len(builder) > 262_144:
                chunk = builder.seal()
                assert chunk is not None
                file.write_chunk(chunk)
        chunk = builder.seal()
        assert chunk is not None
        file.write_chunk(chunk)
        file.finish()


def _noise() -> Iterator[bytes]:
    chooser = random.Random(1)  # noqa: S311 - reproducible, not secret
    block = chooser.randbytes(1 << 20)
    while True:
        start = chooser.randrange(len(block) - 1000)
        yield block[start : start + 500] + chooser.randbytes(500)


def test_long_silences_cost_nothing() -> None:
    """A request for all of time is answered by looking where logs are."""
    logs = [log_of(gear_rows(5)), log_of(gear_rows(5, at_ms=30 * 86_400_000, first=5))]
    request = Backfill("**", 0, 2**63 - 1)
    looks = 0

    def is_expired() -> bool:
        nonlocal looks
        looks += 1
        return False

    pieces = list(Excerpt(copies(*logs), lambda _: True, request, is_expired).pieces())
    assert len(rows_of(pieces)) == 10
    assert looks < 10_000
    assert all(one.next_ns <= other.next_ns for one, other in pairwise(pieces))
