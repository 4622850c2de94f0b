"""What logs lack."""

import pytest

from recorder.backfill.holes import Hole, HoleKind, HoleTally
from tests.support.backfill_logs import (
    CAMERA,
    GAP,
    GEAR,
    HEALTH,
    INFO,
    MS,
    ROBOT,
    RX,
    START_NS,
    Row,
    found_in,
    gap_row,
    gear_rows,
    log_of,
    row,
)

SEQUENCE, RESTART, DROPPED, SILENCE = HoleKind


def at(milliseconds: float) -> int:
    """A time after the start."""
    return START_NS + round(milliseconds * MS)


def holes_of(*logs: list[Row]) -> list[Hole]:
    """The holes of logs."""
    return found_in(*map(log_of, logs)).holes()


def shown(holes: list[Hole]) -> list[tuple[str, HoleKind, int, int, int | None]]:
    """What of a hole matters to people."""
    return [(hole.topic, hole.kind, hole.from_ns, hole.to_ns, hole.missing) for hole in holes]


ROWS = gear_rows(50)
WITHOUT_SEQUENCES = [
    *(row(number * 7 % 5, number, CAMERA) for number in range(20)),
    *(row(number, number, topic) for topic in ("fleet/@recorder/depot/health", INFO) for number in (1, 9)),
]


@pytest.mark.parametrize(
    "logs",
    [
        pytest.param([], id="nothing"),
        pytest.param([ROWS], id="no loss"),
        pytest.param([ROWS[:10] + ROWS[20:], ROWS[10:20]], id="a second log fills the hole"),
        pytest.param([ROWS[20:] + ROWS[:20]], id="what was asked for later stands behind what came by itself"),
        pytest.param([WITHOUT_SEQUENCES], id="unknown keys, recorders and gateway/info have no sequence"),
        pytest.param([gear_rows(100, first=1000), gear_rows(50, at_ms=5000)], id="two gateways of one name"),
        pytest.param([ROWS + gear_rows(50, first=50, at_ms=2000)], id="a clock set back while sequences run on"),
        pytest.param([[gap_row("**", at(0), at(1), 5)]], id="dropped keys that nobody counted one by one"),
        pytest.param([[row(0, 0, GAP, b"\xff\xff\xff")]], id="a gap message that cannot be read"),
    ],
)
def test_what_is_no_loss_is_no_hole(logs: list[list[Row]]) -> None:
    """Nothing would be asked for."""
    assert holes_of(*logs) == []


def test_a_gap_is_a_hole_between_the_messages_around_it() -> None:
    """Its size is known."""
    rows = [one for one in gear_rows(50) if one.sequence not in {10, 11, 12, 30}]
    assert shown(holes_of(rows)) == [
        (GEAR, SEQUENCE, at(900), at(1300) + 1, 3),
        (GEAR, SEQUENCE, at(2900), at(3100) + 1, 1),
    ]


def test_a_restart_is_a_hole_whose_size_nobody_knows() -> None:
    """Between the last message of the old gateway and the first of the new one."""
    rows = gear_rows(10) + gear_rows(10, at_ms=2500)
    assert shown(holes_of(rows))[-1] == (GEAR, RESTART, at(900), at(2500) + 1, None)


def test_a_batch_that_is_lost_is_one_sample() -> None:
    """Of raw frames, each with its own time."""
    rows = [row(number // 5, number, RX) for number in range(50) if number // 5 != 6]
    assert shown(holes_of(rows)) == [(RX, SEQUENCE, at(29), at(35) + 1, 1)]


def test_the_files_of_a_recording_are_followed() -> None:
    """In whatever order they are given."""
    first, second = gear_rows(10), gear_rows(10, first=15, at_ms=1500)
    expected = [(GEAR, SEQUENCE, at(900), at(1500) + 1, 5)]
    assert shown(holes_of(first, second)) == shown(holes_of(second, first)) == expected


def test_a_cut_is_a_hole_of_all_that_the_robot_says() -> None:
    """Also of topics that had no message meanwhile, or have no sequence."""
    rows = [one for one in gear_rows(100) if not 2000 < (one.publish_ns - START_NS) // MS < 7000]
    rows += [row(number, number * 1000, HEALTH) for number in (0, 1, 2, 7, 8, 9)]
    found = shown(holes_of(sorted(rows)))
    assert (f"{ROBOT}/**", SILENCE, at(2000), at(7000) + 1, None) in found
    assert (GEAR, SEQUENCE, at(2000), at(7000) + 1, 49) in found
    assert (HEALTH, SEQUENCE, at(2000), at(7000) + 1, 4) in found
    assert len(found) == 3


def test_a_silence_in_which_nothing_is_missing_is_none() -> None:
    """A robot that said nothing."""
    rows = gear_rows(10) + gear_rows(10, first=10, at_ms=100_000)
    assert holes_of(rows) == []
    rows += gear_rows(10, first=21, at_ms=101_100)
    assert [hole.kind for hole in holes_of(rows)] == [SEQUENCE]


def test_what_the_recorder_dropped_is_a_hole() -> None:
    """Where no sequence tells of it."""
    rows = [gap_row(CAMERA, at(5000), at(6000), 3), *gear_rows(5)]
    assert shown(holes_of(rows)) == [(CAMERA, DROPPED, at(3000), at(8000), 3)]


def test_what_sequences_tell_already_is_not_counted_twice() -> None:
    """A gap that the recorder tells of is as wide as its own times, for a batch may be lost in part."""
    rows = [one for one in gear_rows(100) if not 40 <= one.sequence < 50]
    told = gap_row(GEAR, at(4000), at(4900), 10)
    found = shown(holes_of([*rows, told]))
    assert found[0][:2] == (GEAR, DROPPED)
    assert found[0][4] is None
    assert (GEAR, SEQUENCE, at(3900), at(5000) + 1, 10) in found
    assert sum(one[4] or 0 for one in found) == 10


def test_what_the_recorder_dropped_within_a_gap_is_told_by_the_gap() -> None:
    """Nothing more is missing."""
    rows = [one for one in gear_rows(200) if not 40 <= one.sequence < 160]
    found = holes_of([*rows, gap_row(GEAR, at(9000), at(9500), 5)])
    assert {hole.kind for hole in found} == {SEQUENCE, SILENCE}


def test_what_another_recorder_dropped_is_not_known_to_be_missing_here() -> None:
    """The sequences run on."""
    (found,) = holes_of([*gear_rows(100), gap_row(GEAR, at(4000), at(5000), 10)])
    assert (found.kind, found.missing) == (DROPPED, None)


def test_the_clocks_of_robot_and_recorder_may_differ() -> None:
    """A gap is told by the recorder's clock, and a hole is one of the robot's."""
    hour_ms = 3_600_000
    rows = [row(number, number * 100, lag_ms=hour_ms) for number in range(100)]
    (found,) = holes_of([*rows, gap_row(GEAR, at(hour_ms + 5000), at(hour_ms + 6000), 3)])
    assert (found.from_ns, found.to_ns) == (at(3000), at(8000))


def tally(
    missing: int | None = 3, before: tuple[int, int] | None = (10, 100), after: tuple[int, int] | None = (14, 500)
) -> HoleTally:
    """What fills a hole."""
    kind = DROPPED if before is None else RESTART if missing is None else SEQUENCE
    return HoleTally(Hole(GEAR, kind, 100, 501, missing, before, after))


def test_a_hole_is_filled_by_what_was_missing() -> None:
    """In any order, and each message but once."""
    one = tally()
    assert (one.filled, one.still_missing) == (0, 3)
    one.add(13, 400)
    one.add(11, 200)
    assert (one.filled, one.still_missing) == (2, 1)
    one.add(12, 300)
    assert (one.filled, one.still_missing) == (3, 0)


def test_a_restart_within_a_gap_left_fewer_than_it_seemed() -> None:
    """The old gateway's last, and the new one's first."""
    one = tally(missing=3)
    one.add(11, 150)
    for sequence in range(14):
        one.add(sequence, 200 + sequence)
    assert one.still_missing == 0


def test_nobody_knows_what_a_restart_lost_until_something_of_it_is_there() -> None:
    """Then its own gaps tell."""
    one = tally(missing=None, after=(0, 500))
    assert one.still_missing is None
    one.add(11, 200)
    assert one.still_missing is None
    one.add(13, 400)
    assert one.still_missing == 1


@pytest.mark.parametrize(("missing", "expected"), [(3, 2), (1, 0), (0, 0), (None, None)])
def test_of_dropped_messages_the_count_is_all_that_is_known(missing: int | None, expected: int | None) -> None:
    """It is the recorder's, of samples or of messages."""
    one = tally(missing=missing, before=None, after=None)
    one.add(0, 1)
    assert one.still_missing == expected


def test_topics_are_known_by_robot() -> None:
    """What else was said of each."""
    finder = found_in(log_of([row(0, 0, GEAR), row(0, 0, RX), row(0, 0, CAMERA), row(0, 0, GAP)]))
    assert finder.topics == {ROBOT: {GEAR, RX}}
