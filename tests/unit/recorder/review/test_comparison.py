"""What was recorded, against what comes out again."""

from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from recorder.encoding.protobuf import compile_encoder
from recorder.reading.topics import typed_decoder
from recorder.review import rerun as comparison_module
from recorder.review.rerun import BATCH_NS, SAME_RUN_NS, Comparison, RecordedOutput
from schemas.decisions import EventKind, SafetyEvent, Severity
from schemas.reasons import Reason

SUBJECT = "safety/event"
ENCODE = compile_encoder(SafetyEvent)


def event(number: int, text: str = "") -> RecordedOutput:
    """The record of an event."""
    message = SafetyEvent(
        number, number % 2**32, 7, Severity.INFO, EventKind.LEASE, Reason.NONE, operator="operator-1", text=text
    )
    return RecordedOutput(number, ENCODE(message))


def compared() -> Comparison:
    """A comparison of events."""
    return Comparison(lambda _, data: typed_decoder(SafetyEvent)(data))


@given(st.lists(st.booleans(), min_size=1, max_size=60), st.integers(0, 2**32))
def test_either_side_may_be_ahead(changed: list[bool], seed: int) -> None:
    """In whatever order the two sides come, each pair is compared once and right."""
    comparison = compared()
    steps = [(number, side) for number in range(len(changed)) for side in (0, 1)]
    Random(seed).shuffle(steps)  # noqa: S311 - nothing here is secret
    # Each side alone is in its order.
    numbers = [sorted(number for number, side in steps if side == which) for which in (0, 1)]
    for _, side in steps:
        number = numbers[side].pop(0)
        if side:
            comparison.say_again((SUBJECT, number), event(number, "x" if changed[number] else ""))
        else:
            comparison.record((SUBJECT, number), event(number))
    assert comparison.end() == []
    assert comparison.same[SUBJECT] == changed.count(False)
    assert comparison.difference_count == changed.count(True)
    assert all(one.fields == {"text": ("", "x")} for one in comparison.differences)
    assert not comparison.unrecorded


def test_what_the_log_lost_is_no_difference() -> None:
    """It is counted by itself."""
    comparison = compared()
    for number in range(5):
        comparison.say_again((SUBJECT, number), event(number))
    comparison.record((SUBJECT, 3), event(3))
    # Of the last tenth of a second nobody knows whether it was lost.
    comparison.say_again((SUBJECT, BATCH_NS + 4), event(BATCH_NS + 4))
    comparison.end()
    assert (comparison.same[SUBJECT], comparison.unrecorded[SUBJECT], comparison.difference_count) == (1, 4, 0)


def test_what_was_recorded_and_does_not_come_again_is_one() -> None:
    """With the whole message; what is later than the end belongs to the next run."""
    comparison = compared()
    comparison.say_again((SUBJECT, 0), event(0))
    comparison.say_again(("safety/state", 9), event(BATCH_NS + 9))
    comparison.record((SUBJECT, 0), event(0))
    comparison.record((SUBJECT, 1), event(1))
    comparison.record((SUBJECT, 12), event(12))
    assert comparison.end() == [((SUBJECT, 12), event(12))]
    [difference] = comparison.differences
    assert (difference.what, difference.time_ns, difference.message.sequence) == ("only recorded", 1, 1)


def test_a_second_copy_in_the_log_is_no_difference() -> None:
    """A recorder may have asked for what it had."""
    comparison = compared()
    for number in range(3):
        comparison.say_again((SUBJECT, number), event(number))
        comparison.record((SUBJECT, number), event(number))
    comparison.record((SUBJECT, 1), event(1))
    assert comparison.end() == []
    assert (comparison.same[SUBJECT], comparison.difference_count) == (3, 0)


def test_memory_and_output_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """What waits too long is given up and counted; only the first differences are told."""
    monkeypatch.setattr(comparison_module, "WAITING_MAX", 3)
    monkeypatch.setattr(comparison_module, "DIFFERENCES_TOLD", 2)
    comparison = compared()
    comparison.say_again(("safety/state", 0), event(0))
    for number in range(5):
        comparison.record((SUBJECT, number), event(number))
    assert comparison.given_up == 2
    for number in range(5):
        comparison.say_again((SUBJECT, number), event(number, "x"))
    assert (comparison.difference_count, len(comparison.differences)) == (3, 2)


def test_what_was_recorded_before_anything_came_again_is_not_compared() -> None:
    """A run that begins in its midst has said much before, and none of it is a difference."""
    comparison = compared()
    for number in range(5):
        comparison.record((SUBJECT, number), event(number))
    comparison.say_again((SUBJECT, 3), event(3))
    comparison.say_again(("safety/state", 9), event(BATCH_NS + 9))
    assert comparison.end() == []
    assert (comparison.same[SUBJECT], comparison.difference_count) == (1, 1)


def test_a_sequence_that_began_anew_is_another_message() -> None:
    """The states of a new gateway are there before its journal, and are none that the log lost before."""
    comparison = compared()
    for number in range(1, 4):
        comparison.say_again((SUBJECT, number), event(number))
    comparison.say_again((SUBJECT, 9), event(9))
    later = event(60 * SAME_RUN_NS)
    comparison.record((SUBJECT, 2), later)
    assert comparison.end() == [((SUBJECT, 2), later)]
    assert comparison.difference_count == 0


def test_a_second_copy_of_what_has_no_sequence_is_no_difference() -> None:
    """As of the frames that were sent."""
    comparison = compared()
    for number in range(3):
        key = (SUBJECT, (number, b"id"))
        comparison.record(key, event(number))
        comparison.say_again(key, event(number))
        comparison.record(key, event(number))
    comparison.say_again(("safety/state", 9), event(BATCH_NS + 9))
    assert comparison.end() == []
    assert (comparison.same[SUBJECT], comparison.difference_count) == (3, 0)


@pytest.mark.parametrize("is_first", [True, False])
@pytest.mark.parametrize("is_late", [True, False])
def test_what_was_put_in_beside_a_message_is_a_difference(is_first: bool, is_late: bool) -> None:  # noqa: FBT001
    """Under its key, before it or after it, before it comes out again or after that."""
    comparison = compared()
    copies = [event(1), RecordedOutput(1, event(1, "forged").data)]
    comparison.say_again((SUBJECT, 0), event(0))
    recorded = copies[::-1] if is_first else copies
    comparison.record((SUBJECT, 1), recorded[0])
    if not is_late:
        comparison.record((SUBJECT, 1), recorded[1])
    comparison.say_again((SUBJECT, 1), event(1))
    comparison.say_again((SUBJECT, 2), event(2))
    if is_late:
        comparison.record((SUBJECT, 1), recorded[1])
    comparison.say_again(("safety/state", 9), event(BATCH_NS + 9))
    assert comparison.end() == []
    assert comparison.difference_count >= 1
    assert {one.time_ns for one in comparison.differences} == {1}


def test_a_copy_that_comes_too_late_to_tell_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whether it is one is not known any more."""
    monkeypatch.setattr(comparison_module, "COPIES_MAX", 2)
    comparison = compared()
    for number in range(5):
        comparison.say_again((SUBJECT, number), event(number))
        comparison.record((SUBJECT, number), event(number))
    comparison.record((SUBJECT, 4), event(4))
    assert comparison.given_up == 0
    comparison.record((SUBJECT, 1), event(1))
    assert (comparison.given_up, comparison.difference_count) == (1, 0)
