"""Samples that never came: by their sequences in one log, and between several."""

import itertools
from random import Random

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from recorder.encoding.samples import SEQUENCE_SPAN
from recorder.review import checking
from recorder.review.checking import ChannelEnds, FollowingCount, InTimeCount, between

SECOND = 1_000_000_000
GEAR = "fleet/cruiser-1/chassis/gear"
STEERING = "fleet/cruiser-1/chassis/steering"
OTHER = "fleet/cruiser-2/chassis/gear"


def take(line: InTimeCount, messages: list[tuple[int, int]]) -> None:
    """Count messages, by their sequences and publish times."""
    if messages:
        sequences, times_ns = zip(*messages, strict=True)
        line.take(np.array(sequences, np.int64), np.array(times_ns, np.uint64))


def gaps_of(messages: list[tuple[int, int]]) -> list[tuple[int, int, int | None]]:
    """The gaps: the sequences around each, and what is missing."""
    line = InTimeCount()
    take(line, messages[: len(messages) // 3])
    take(line, messages[len(messages) // 3 :])
    return [(before.last, after.first, missing) for before, after, missing in line.gaps()]


@given(st.sets(st.integers(0, 120), min_size=1), st.integers(0, SEQUENCE_SPAN - 1), st.randoms())
def test_what_is_missing_is_found_in_any_order(there: set[int], start: int, chooser: object) -> None:
    """Each gap, its ends and its size, across the end of the numbers too."""
    messages = [((start + number) % SEQUENCE_SPAN, number * SECOND) for number in sorted(there)]
    ordered = sorted(there)
    expected = [
        ((start + one) % SEQUENCE_SPAN, (start + other) % SEQUENCE_SPAN, other - one - 1)
        for one, other in itertools.pairwise(ordered)
        if other - one > 1
    ]
    assert gaps_of(messages) == expected
    chooser.shuffle(messages)  # type: ignore[attr-defined] # Hypothesis's Random
    assert gaps_of(messages) == expected
    # A second copy, as an incident's log is one, changes nothing.
    assert gaps_of(messages + messages[: len(messages) // 2]) == expected


def test_the_frames_of_a_batch_share_its_sequence() -> None:
    """However many there are."""
    assert gaps_of([(number // 3, number) for number in range(30)]) == []
    assert gaps_of([(number // 3, number) for number in range(30) if number // 3 != 4]) == [(3, 5, 1)]


def test_messages_that_follow_each_other_are_one_run() -> None:
    """Memory grows with the gaps alone."""
    frames, woven = InTimeCount(), InTimeCount()
    take(frames, [(number // 3, number) for number in range(900)])
    take(woven, [one for number in range(300) for one in ((number, number), (1000 + number, 10_000 + number))])
    assert [(run.first, run.last) for run in frames.runs()] == [(0, 299)]
    assert [(run.first, run.last) for run in woven.runs()] == [(0, 299), (1000, 1299)]


def test_a_restart_at_the_same_number_is_one() -> None:
    """The frames of a batch come together; the same number much later is another gateway's."""
    first = [(number, number) for number in range(6)]
    assert gaps_of([*first, (5, 200 * SECOND), (6, 201 * SECOND)]) == [(5, 5, None)]


def test_a_step_back_is_a_gap_of_unknown_size() -> None:
    """The gateway began anew, at whatever number."""
    first = [(number, number * SECOND) for number in range(100)]
    for start in (0, 5):
        second = [(number, (200 + number) * SECOND) for number in range(start, 50)]
        assert gaps_of(first + second) == [(99, start, None)]
        assert gaps_of(second + first) == [(99, start, None)]


def test_a_loss_after_a_restart_is_none_of_the_life_before() -> None:
    """Although the sequence then goes on where the old gateway's ended."""
    old = [(number, number * SECOND) for number in range(6)]
    new = [(number, (100 + number) * SECOND) for number in (0, 1, 2, 3, 4, 6, 7)]
    assert gaps_of(old + new) == [(5, 0, None), (4, 6, 1)]


def test_what_was_asked_for_later_is_in_its_place() -> None:
    """Piece by piece between what comes by itself."""
    past = [(number, number * SECOND) for number in range(40)]
    present = [(number, number * SECOND) for number in range(40, 80)]
    woven = [message for pair in zip(past, present, strict=True) for message in pair]
    assert gaps_of(woven) == []
    assert gaps_of([one for one in woven if one[0] != 20]) == [(19, 21, 1)]


def test_runs_do_not_pile_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """What has come together meanwhile is one run."""
    monkeypatch.setattr(checking, "RUNS_MAX", 64)
    line = InTimeCount()
    most = 0
    for number in (*range(0, 6400, 2), *range(1, 6400, 2)):
        take(line, [(number, number)])
        most = max(most, len(line._runs))
    assert most < 6000
    assert [(run.first, run.last) for run in line.runs()] == [(0, 6399)]


def ends(first: int, last: int, start: int = 0) -> ChannelEnds:
    """A channel's, of which a message came each nanosecond, the one of sequence 0 at ``start``."""
    return ChannelEnds(first % 2**32, last % 2**32, start + first, start + last)


def test_the_samples_of_a_robot_are_one_answer() -> None:
    """Those of all its keys together, with the logs before and after, and from when to when."""
    found = between(
        [
            ("b", {GEAR: ends(15, 20), STEERING: ends(13, 20)}),
            ("a", {GEAR: ends(0, 10), STEERING: ends(0, 11)}),
            ("c", {OTHER: ends(50, 60)}),
        ]
    )
    (one,) = found
    assert (one.robot, one.samples, one.topics) == ("fleet/cruiser-1", 5, 2)
    assert (one.from_ns, one.to_ns, one.before, one.after) == (10, 15, "a", "b")


@given(st.lists(st.tuples(st.integers(1, 50), st.integers(0, 5)), min_size=1, max_size=8), st.randoms())
def test_what_was_left_out_is_found(parts: list[tuple[int, int]], shuffle: Random) -> None:
    """However many logs there are, in whatever order, and where the sequence wraps."""
    logs, at, left_out = [], 2**32 - 40, 0
    for number, (length, gap) in enumerate(parts):
        logs.append((str(number), {GEAR: ends(at, at + length)}))
        at += length + 1 + gap
        left_out += gap
    shuffle.shuffle(logs)
    assert sum(one.samples for one in between(logs)) == left_out - parts[-1][1]


def test_logs_that_overlap_lack_nothing() -> None:
    """Neither where two recorders have the same, nor where an incident lies within another log."""
    whole, later = ("a", {GEAR: ends(0, 100)}), ("c", {GEAR: ends(95, 200)})
    incident = ("b", {GEAR: ends(20, 40)})
    assert between([whole, incident, later]) == []


def test_of_a_gateway_that_began_anew_nothing_is_known() -> None:
    """Its sequence begins at 0."""
    assert between([("a", {GEAR: ends(0, 100)}), ("b", {GEAR: ends(0, 10, start=1000)})]) == []


def test_a_topic_of_no_robot_is_told_by_its_name() -> None:
    """Logs may hold anything."""
    (one,) = between([("a", {"elsewhere": ends(0, 1)}), ("b", {"elsewhere": ends(3, 4)})])
    assert (one.robot, one.samples) == ("elsewhere", 1)


@pytest.mark.parametrize("parts", [1, 2, 5, 100])
@pytest.mark.parametrize(
    ("sequences", "missed", "first"),
    [
        (range(20), 0, None),
        ((0, 1, 1, 1, 2), 0, None),  # the frames of a batch
        ((5, 8, 9, 12), 4, 1),
        ((SEQUENCE_SPAN - 2, SEQUENCE_SPAN - 1, 0, 2), 1, 3),
        ((7, 8, 0, 1, 4), 2, 4),  # a gateway that started again
        ((0, 2**24 + 1, 2**24 + 2), 0, None),  # as well
        ([one + place for one in range(20) for place in (0, 500)], None, None),  # two gateways by turns
        ((0, 1, 3, 2, 4), 2, 2),  # one that was overtaken
    ],
)
def test_what_follows_each_other_is_counted(
    sequences: list[int], missed: int | None, first: int | None, parts: int
) -> None:
    """In however many pieces it comes; ``first`` is the message behind the first gap."""
    count = FollowingCount()
    for part in np.array_split(np.array(sequences), parts):
        if len(part):
            count.take(part, part)
    assert count.has_two_sources == (missed is None)
    if missed is not None:
        assert (count.missed, count.first_ns) == (missed, None if first is None else list(sequences)[first])
