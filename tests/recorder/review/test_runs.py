"""Runs out of logs."""

from collections.abc import Iterator
from random import Random

import pytest

from recorder.review import runs as runs_module
from recorder.review.faults import Faults
from recorder.review.rows import Row
from recorder.review.runs import RunEnd, Tape
from recorder.review.topics import Topic, typed_decoder
from recorder.transcode import compile_encoder
from schemas.decisions import Journal


def topic(subject: str) -> Topic:
    """A topic of a robot."""
    decode = typed_decoder(Journal) if subject == "journal" else None
    return Topic(f"fleet/cruiser-1/{subject}", "", "protobuf", "protobuf", b"", None, "cruiser-1", subject, decode)


JOURNAL, STATE = topic("journal"), topic("state")
ENCODE = compile_encoder(Journal)


def journal(run: int, first: int, count: int = 2) -> Row:
    """A message of a journal."""
    message = Journal(1000 * run + first, first, run=run, first=first, count=count, inputs=b"x" * count)
    return Row(JOURNAL, first, 0, message.time_ns, ENCODE(message))


def state(number: int) -> Row:
    """Something else."""
    return Row(STATE, number, 0, number, b"")


def played(rows: list[Row]) -> Iterator[tuple[list[int], RunEnd, list[int]]]:
    """Of each run the places of its journals, how far it goes, and what was taken meanwhile."""
    taken: list[int] = []
    ends: list[RunEnd] = []
    tape = Tape(iter(rows), lambda row: taken.append(row.sequence), Faults())
    while tape.next_run():
        firsts = [one.first for one in tape.journals(ends.append)]
        yield firsts, ends[-1], list(taken)
        taken.clear()


def test_journals_come_in_their_order_and_the_rest_between_them() -> None:
    """One run that is all there."""
    rows = [state(1), journal(7, 0), state(2), journal(7, 2), state(3)]
    assert list(played(rows)) == [([0, 2], RunEnd(7, 4, ""), [1, 2, 3])]


@pytest.mark.parametrize("seed", range(5))
def test_what_came_late_is_put_into_its_place(seed: int) -> None:
    """Whatever the order in the log, and however often a journal is there."""
    rows = [journal(7, first) for first in range(0, 40, 2)] * 2
    Random(seed).shuffle(rows)  # noqa: S311 - nothing here is secret
    assert [(firsts, end) for firsts, end, _ in played(rows)] == [(list(range(0, 40, 2)), RunEnd(7, 40, ""))]


def test_a_gap_ends_a_run_and_is_told() -> None:
    """With the numbers of what is missing."""
    rows = [journal(7, 0), journal(7, 6), journal(7, 8)]
    [(firsts, end, _)] = played(rows)
    assert firsts == [0]
    assert end == RunEnd(7, 2, "inputs 2 to 5 are missing")


def test_a_log_that_begins_later_has_no_run() -> None:
    """And says why."""
    [(firsts, end, _)] = played([journal(7, 10), journal(7, 12)])
    assert not firsts
    assert (end.inputs, end.detail.partition(";")[0]) == (0, "inputs 0 to 9 are missing")
    assert "begins later" in end.detail


def test_each_run_of_a_gateway_is_one() -> None:
    """What is left of one that is over changes nothing."""
    rows = [journal(7, 0), journal(8, 0), journal(7, 2), journal(8, 2), journal(9, 4)]
    assert [(firsts, end.run, end.inputs) for firsts, end, _ in played(rows)] == [
        ([0], 7, 2),
        ([0, 2], 8, 4),
        ([], 9, 0),
    ]


def test_what_waits_for_its_turn_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """A run whose beginning never comes does not fill the memory; the next one is read all the same."""
    monkeypatch.setattr(runs_module, "HELD_BYTES", 10)
    rows = [*(journal(7, first) for first in range(2, 200, 2)), journal(7, 0), journal(8, 0)]
    assert [(firsts, end.run) for firsts, end, _ in played(rows)] == [([], 7), ([0], 8)]


def test_a_journal_that_cannot_be_read_is_a_fault() -> None:
    """It is told, and the run ends there."""
    faults = Faults()
    broken = Row(JOURNAL, 0, 0, 0, b"\xff")
    tape = Tape(iter([journal(7, 0), broken, journal(7, 2)]), lambda _: None, faults)
    assert tape.next_run()
    assert tape.next_time_ns == 7000
    assert len(list(tape.journals(lambda _: None))) == 2
    assert faults.count == 1
