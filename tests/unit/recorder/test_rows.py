"""The rows of a replay: each once, frames of a batch together, in the order of a time."""

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st

from recorder.reading.rows import Row
from recorder.reading.topics import Topic
from recorder.replay import By, ReplayRun, in_order, once, runs
from schemas.messages import CanFrame, RawSample
from schemas.settings import BATCH_MAX_FRAMES
from tests.support.drives import drive_samples, write_samples
from tests.support.messages import MS, SECOND, WALL_NS, can_frame
from tests.support.reading import row_of, rows_of, topic

RX = topic("fleet/cruiser-1/can/can0/rx")
TX = topic("fleet/cruiser-1/can/can0/tx")
RAW = topic("fleet/elsewhere", RawSample)


def frame_row(number: int, sequence: int, log_ms: int, of: Topic = RX) -> Row:
    """A frame of 1 ms times its number."""
    return row_of(of, can_frame(time_ns=WALL_NS + number * MS), sequence, WALL_NS + log_ms * MS)


def test_an_incident_and_another_recorders_log_repeat_nothing(tmp_path: Path) -> None:
    """What two files hold comes once, whenever each recorder received it."""
    samples = drive_samples(10)
    one = write_samples(tmp_path / "one.mcap", samples)
    two = write_samples(tmp_path / "two.mcap", samples[5:], offset_ns=53 * MS)
    alone = [(row.topic.name, row.sequence, row.data) for row in rows_of(one)]
    both = [(row.topic.name, row.sequence, row.data) for row in once(rows_of(one, two))]
    # What has no time of its own is not known again.
    assert sorted(row for row in both if row[0] != "fleet/elsewhere") == sorted(
        row for row in alone if row[0] != "fleet/elsewhere"
    )


def test_what_one_file_has_twice_was_twice() -> None:
    """Two frames of one moment are two frames."""
    rows = [frame_row(1, 1, 5), frame_row(1, 1, 5)]
    assert list(once(rows)) == rows


def test_what_is_remembered_is_bounded() -> None:
    """Files that repeat each other do so at about the same time; what is long past is forgotten."""
    other = topic(RX.name)
    rows = [frame_row(number, number, number) for number in range(100)]
    again = [row_of(other, can_frame(time_ns=row.publish_ns), row.sequence) for row in rows]
    assert len(list(once([*rows, *again[-10:]], remembered=10))) == 100
    assert len(list(once([*rows, *again[:10]], remembered=10))) == 110


def test_frames_of_one_batch_are_one_run() -> None:
    """By their sequence and receipt, at the place of the first, each topic for itself."""
    rows = [
        frame_row(1, 7, 50),
        frame_row(2, 7, 50, TX),
        frame_row(3, 7, 50),
        frame_row(4, 8, 50),
        frame_row(5, 9, 100),
    ]
    found = list(runs(rows, By.LOG))
    assert [[(row.publish_ns - WALL_NS) // MS for row in run.rows] for run in found] == [[1, 3], [4], [2], [5]]
    assert [run.time_ns for run in found] == [WALL_NS + 50 * MS] * 3 + [WALL_NS + 100 * MS]


def test_a_batch_has_an_end() -> None:
    """A log that puts all its frames into one is cut up."""
    rows = [frame_row(number, 0, 0) for number in range(BATCH_MAX_FRAMES + 1)]
    assert [len(run.rows) for run in runs(rows, By.LOG)] == [BATCH_MAX_FRAMES, 1]


def test_a_batch_was_published_when_its_last_frame_had_come() -> None:
    """Where the source's time counts."""
    (run,) = runs([frame_row(1, 7, 50), frame_row(3, 7, 50)], By.PUBLISH)
    assert run.time_ns == WALL_NS + 3 * MS


@given(st.lists(st.integers(0, 50), min_size=1, max_size=200), st.integers(1, 20))
def test_what_is_a_little_out_of_order_is_sorted(late_ms: list[int], every_ms: int) -> None:
    """Frames that reached the recorder up to the horizon late come in their order; nothing is lost."""
    rows = [
        row_of(
            RX,
            can_frame(time_ns=WALL_NS + number * every_ms * MS),
            number,
            WALL_NS + (number * every_ms + late) * MS,
        )
        for number, late in enumerate(late_ms)
    ]
    rows.sort(key=lambda row: row.log_ns)
    found = list(in_order(runs(rows, By.PUBLISH), horizon_ns=60 * MS))
    assert len(found) == len(rows)
    assert all(one.time_ns <= other.time_ns for one, other in pairwise(found))


def test_what_is_very_late_comes_late() -> None:
    """And holds nothing up: what is sorted is bounded in time and in number."""
    rows = [frame_row(number, number, number) for number in range(0, 10_000, 10)]
    late = frame_row(5, 1, 5_000)
    rows.insert(501, late)
    found = [run.rows[0] for run in in_order(runs(rows, By.PUBLISH), horizon_ns=SECOND)]
    assert len(found) == len(rows)
    assert 300 < found.index(late) <= 501
    held: list[int] = []

    def counted() -> Iterator[ReplayRun]:
        for number, run in enumerate(runs(rows, By.PUBLISH)):
            held.append(number)
            yield run

    for given_out, _ in enumerate(in_order(counted(), horizon_ns=10**18, limit=50)):
        assert held[-1] - given_out <= 51


def test_other_messages_are_runs_of_their_own() -> None:
    """At their place among the batches."""
    other = Row(RAW, 0, WALL_NS + 50 * MS, WALL_NS, b"")
    found = list(runs([frame_row(1, 1, 40), other, frame_row(2, 2, 60)], By.LOG))
    assert [run.topic for run in found] == [RX, RAW, RX]
    assert isinstance(found[1], ReplayRun)
    assert RX.kind is CanFrame
