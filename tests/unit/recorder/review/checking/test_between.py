"""Samples that are in none of several logs."""

from random import Random

from hypothesis import given
from hypothesis import strategies as st

from recorder.review.checking.between import ChannelEnds, between

GEAR = "fleet/cruiser-1/chassis/gear"
STEERING = "fleet/cruiser-1/chassis/steering"
OTHER = "fleet/cruiser-2/chassis/gear"


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
