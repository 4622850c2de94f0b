"""Runs out of logs."""

from collections.abc import Iterator
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from recorder.encoding.protobuf import compile_encoder
from recorder.reading.logs import Faults
from recorder.reading.rows import Row
from recorder.reading.topics import Topic, typed_decoder
from recorder.review import rerun as runs_module
from recorder.review.rerun import PartEnd, Tape
from schemas.decisions import Journal


def topic(subject: str) -> Topic:
    """A topic of a robot."""
    decode = typed_decoder(Journal) if subject == "journal" else None
    return Topic(
        f"fleet/cruiser-1/{subject}",
        "",
        "protobuf",
        "protobuf",
        b"",
        None,
        "cruiser-1",
        "cruiser-1",
        subject,
        decode,
    )


JOURNAL, STATE = topic("journal"), topic("state")
ENCODE = compile_encoder(Journal)


def journal(run: int, first: int, count: int = 2) -> Row:
    """A message of a journal."""
    message = Journal(1000 * run + first, first, run=run, first=first, count=count, inputs=b"x" * count)
    return Row(JOURNAL, first, 0, message.time_ns, ENCODE(message))


def state(number: int) -> Row:
    """Something else."""
    return Row(STATE, number, 0, number, b"")


def played(rows: list[Row]) -> Iterator[tuple[list[int], PartEnd, list[int]]]:
    """Of each run the places of its journals, how far it goes, and what was taken meanwhile."""
    taken: list[int] = []
    tape = Tape(iter(rows), lambda row: taken.append(row.sequence), Faults())
    while tape.next_part():
        firsts = [one.first for one in tape.journals()]
        yield firsts, tape.end, list(taken)
        taken.clear()


def test_journals_come_in_their_order_and_the_rest_between_them() -> None:
    """One run that is all there."""
    rows = [state(1), journal(7, 0), state(2), journal(7, 2), state(3)]
    assert list(played(rows)) == [([0, 2], PartEnd(7, 0, 4, ""), [1, 2, 3])]


@pytest.mark.parametrize("seed", range(5))
def test_what_came_late_is_put_into_its_place(seed: int) -> None:
    """Whatever the order in the log, and however often a journal is there."""
    rows = [journal(7, first) for first in range(0, 40, 2)] * 2
    Random(seed).shuffle(rows)  # noqa: S311 - nothing here is secret
    assert [(firsts, end) for firsts, end, _ in played(rows)] == [(list(range(0, 40, 2)), PartEnd(7, 0, 40, ""))]


def test_a_gap_parts_a_run_and_is_told() -> None:
    """With the numbers of what is missing."""
    rows = [journal(7, 0), journal(7, 6), journal(7, 8)]
    assert [(firsts, end) for firsts, end, _ in played(rows)] == [
        ([0], PartEnd(7, 0, 2, "inputs 2 to 5 are missing")),
        ([6, 8], PartEnd(7, 6, 4, "inputs 2 to 5 are missing")),
    ]


def test_a_log_that_begins_later_has_the_rest_of_the_run() -> None:
    """And says what is missing."""
    [(firsts, end, _)] = played([journal(7, 10), journal(7, 12)])
    assert firsts == [10, 12]
    assert end == PartEnd(7, 10, 4, "inputs 0 to 9 are missing")


def test_a_beginning_that_comes_late_is_waited_for() -> None:
    """A recorder that came after the gateway asks for it while it hears what follows."""
    rows = [*(journal(7, first) for first in range(20, 40, 2)), *(journal(7, first) for first in range(0, 20, 2))]
    assert [(firsts, end) for firsts, end, _ in played(rows)] == [(list(range(0, 40, 2)), PartEnd(7, 0, 40, ""))]


def test_each_run_of_a_gateway_is_one() -> None:
    """What is left of one that is over changes nothing."""
    rows = [journal(7, 0), journal(8, 0), journal(7, 2), journal(8, 2), journal(9, 4)]
    assert [(firsts, end.run, end.inputs) for firsts, end, _ in played(rows)] == [
        ([0], 7, 2),
        ([0, 2], 8, 4),
        ([4], 9, 2),
    ]


def test_what_waits_for_its_turn_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """A run whose beginning never comes does not fill the memory; what comes too late for it is left."""
    monkeypatch.setattr(runs_module, "HELD_MAX", 10)
    rows = [*(journal(7, first) for first in range(2, 200, 2)), journal(7, 0), journal(8, 0)]
    parts = [(firsts[0], len(firsts), end.run) for firsts, end, _ in played(rows)]
    assert parts == [(2, 99, 7), (0, 1, 8)]


@given(st.lists(st.integers(0, 30), max_size=60), st.integers(1, 12))
def test_every_journal_is_played_once_and_in_order_within_its_part(order: list[int], held: int) -> None:
    """Whatever is missing, twice, or out of place; but what comes too late for its place is left out."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runs_module, "HELD_MAX", held)
        parts = list(played([journal(7, 2 * place) for place in order]))
    firsts = [first for part, _, _ in parts for first in part]
    assert firsts == sorted(set(firsts))
    assert set(firsts) <= {2 * place for place in order}
    if held > len(set(order)):
        assert len(firsts) == len(set(order))
    for part, end, _ in parts:
        assert part == list(range(end.first, end.first + end.inputs, 2))


def test_a_journal_that_cannot_be_read_is_a_fault() -> None:
    """It is told, and the run ends there."""
    faults = Faults()
    broken = Row(JOURNAL, 0, 0, 0, b"\xff")
    tape = Tape(iter([journal(7, 0), broken, journal(7, 2)]), lambda _: None, faults)
    assert tape.next_part()
    assert tape.next_time_ns == 7000
    assert len(list(tape.journals())) == 2
    assert faults.count == 1


def test_a_journal_that_is_longer_than_any_gateway_says_is_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its inputs would take a hundred times its length, once they are read."""
    monkeypatch.setattr(runs_module, "JOURNAL_BYTES", 1)
    faults = Faults()
    assert not Tape(iter([journal(7, 0)]), lambda _: None, faults).next_part()
    assert "which no gateway says" in faults.told[0]


def test_the_length_of_what_waits_for_its_turn_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """As its number is."""
    monkeypatch.setattr(runs_module, "HELD_BYTES", 10)
    rows = [*(journal(7, first) for first in range(2, 200, 2)), journal(7, 0)]
    assert [(firsts[0], len(firsts)) for firsts, _, _ in played(rows)] == [(2, 99)]
