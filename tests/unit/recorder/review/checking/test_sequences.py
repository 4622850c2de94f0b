"""Runs of sequences, in whatever order the messages come."""

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from recorder.encoding.key_counters import SEQUENCE_SPAN
from recorder.review.checking import sequences
from recorder.review.checking.sequences import SequenceLine

SECOND = 1_000_000_000


def gaps_of(messages: list[tuple[int, int]]) -> list[tuple[int, int, int | None]]:
    """The gaps: the sequences around each, and what is missing."""
    line = SequenceLine()
    for sequence, publish_ns in messages:
        line.add(sequence, publish_ns)
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
    """While they come: memory grows with the gaps alone."""
    frames, woven = SequenceLine(), SequenceLine()
    for number in range(300):
        frames.add(number // 3, number)
        woven.add(number, number)
        woven.add(1000 + number, 10_000 + number)
    assert len(frames._runs) == 1
    assert len(woven._runs) == 2


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
    monkeypatch.setattr(sequences, "RUNS_MAX", 64)
    line = SequenceLine()
    most = 0
    for number in (*range(0, 6400, 2), *range(1, 6400, 2)):
        line.add(number, number)
        most = max(most, len(line._runs))
    assert most < 6000
    assert [(run.first, run.last) for run in line.runs()] == [(0, 6399)]
