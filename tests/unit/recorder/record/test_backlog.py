"""Queries for samples that gateways store."""

from collections.abc import Callable

import pytest

from recorder.record.actions import Query
from recorder.record.robots import ANSWER_NS, HELD, KEPT_SUBJECTS, TRIES, Backlog
from schemas.subjects import KEPT_PIECE
from tests.support.messages import MS, SECOND

JOURNAL = "fleet/cruiser-1/journal"
EVENT = "fleet/cruiser-1/safety/event"
PROOFS = {"fleet/cruiser-1/authority/statement"}
FIRSTS = {JOURNAL, EVENT, "fleet/cruiser-1/safety/decision", *PROOFS}


class Robot:
    """A gateway that stores the samples from ``oldest`` on, and a backlog; ``loses`` selects lost replies."""

    def __init__(self, key: str = JOURNAL, said: int = 0, oldest: int = 0) -> None:
        self.key, self.said, self.oldest = key, said, oldest
        self.loses: Callable[[int], bool] = lambda _sequence: False
        self.now_ns = 0
        self.got: list[int] = []
        self.counted = self.runs = 0
        self.asked: list[int] = []
        self.backlog = Backlog()
        self.backlog.see("fleet", "cruiser-1", 0)

    def say(self, *, is_restart: bool = False, is_lost: bool = False) -> None:
        if not is_lost:
            payload = self.payload(self.said)
            self.backlog.receive(self.key, self.said, payload, self.now_ns, is_restart=is_restart)
            self.got.append(self.said)
        self.said += 1

    def payload(self, sequence: int) -> bytes:
        return f"{self.runs} {sequence}".encode()

    def run(self, ticks: int = 200) -> None:
        for _ in range(ticks):
            self.now_ns += 50 * MS
            for query in self.backlog.queries(self.now_ns):
                self.answer(query)

    def answer(self, query: Query) -> None:
        assert query.first is not None
        if query.key != self.key:
            return
        self.asked.append(query.first)
        start = max(query.first, self.oldest)
        for sequence in range(start, min(self.said, start + KEPT_PIECE)):
            was_missing, was_counted = (
                (False, False)
                if self.loses(sequence)
                else self.backlog.receive_reply(self.key, sequence, self.payload(sequence))
            )
            self.got += [sequence] * was_missing
            self.counted += was_counted


def test_a_robot_that_is_new_is_asked_for_all_that_has_to_be_whole_and_its_proofs() -> None:
    assert {f"fleet/cruiser-1/{subject.name}" for subject in KEPT_SUBJECTS} == FIRSTS
    backlog = Backlog()
    backlog.see("fleet", "cruiser-1", 0)
    asked = [backlog.queries(0, most) for most in (0, 2, 0, 1, 9)]
    assert list(map(len, asked)) == [0, 2, 0, 1, len(FIRSTS) - 3]
    assert {query for queries in asked for query in queries} == {Query(key, 0) for key in FIRSTS}
    assert backlog.queries(MS) == []


def test_what_was_said_before_comes_piece_by_piece() -> None:
    robot = Robot(said=100)
    robot.say()
    robot.run()
    assert sorted(robot.got) == list(range(101))
    assert robot.asked == list(range(0, 100, KEPT_PIECE))
    assert robot.counted == 0


def test_a_gap_is_filled_and_was_counted() -> None:
    robot = Robot()
    robot.run()
    for number in range(60):
        robot.say(is_lost=20 <= number < 50)
    robot.run()
    assert sorted(robot.got) == list(range(60))
    assert robot.counted == 30


def test_replies_that_go_lost_are_asked_for_again() -> None:
    robot = Robot(said=40)
    robot.say()
    lost: list[int] = []
    robot.loses = lambda sequence: sequence == 7 and len(lost) < 1 and not lost.append(sequence)  # type: ignore[func-returns-value]
    robot.run()
    assert sorted(robot.got) == list(range(41))
    silent = Robot(said=40)
    silent.say()
    silent.loses = lambda _sequence: True
    silent.run(400)
    assert silent.asked == [0] * TRIES
    assert silent.now_ns > TRIES * ANSWER_NS


@pytest.mark.parametrize(("key", "expected"), [(JOURNAL, [100]), (EVENT, list(range(30, 101)))])
def test_of_a_past_that_is_cut_off_only_a_journal_is_worth_nothing(key: str, expected: list[int]) -> None:
    robot = Robot(key, said=100, oldest=30)
    robot.say()
    robot.run()
    assert sorted(robot.got) == expected


@pytest.mark.parametrize("has_asked", [True, False])
def test_the_end_is_asked_for_too(*, has_asked: bool) -> None:
    robot = Robot(EVENT)
    if has_asked:
        robot.run()
    robot.say()
    robot.say(is_lost=True)
    robot.backlog.ask_last()
    for query in robot.backlog.queries(robot.now_ns):
        robot.answer(query)
    assert robot.got == [0, 1]


def test_two_gateways_of_one_name_make_no_storm_of_questions() -> None:
    backlog = Backlog()
    backlog.see("fleet", "cruiser-1", 0)
    asked = 0
    for number in range(500):
        now_ns = number * 20 * MS
        backlog.receive(EVENT, 1000 + number, b"", now_ns, is_restart=False)
        backlog.receive(EVENT, number, b"", now_ns, is_restart=True)
        asked += sum(one.key == EVENT for one in backlog.queries(now_ns))
    assert 3 <= asked <= 6
    backlog.receive(EVENT, 7, b"", 60 * SECOND, is_restart=True)
    assert Query(EVENT, 0) in backlog.queries(60 * SECOND)


@pytest.mark.parametrize("place", [0, 3, 70, 500])
def test_who_repeats_samples_of_a_robot_has_nothing_recorded_twice(place: int) -> None:
    """It looks like a restart or a gap: the robot is queried, and known samples are not written again."""
    robot = Robot(EVENT, said=40)
    for _ in range(60):
        robot.say()
    robot.run()
    is_back = place <= 100
    robot.backlog.receive(EVENT, place, b"of somebody else", robot.now_ns, is_restart=is_back)
    robot.run(400)
    robot.say(is_restart=not is_back)
    robot.run(400)
    assert sorted(robot.got) == list(range(101))


def test_a_restart_has_its_own_samples_of_the_same_numbers_recorded() -> None:
    robot = Robot(EVENT)
    for _ in range(20):
        robot.say()
    robot.run()
    robot.said, robot.runs = 10, 1
    robot.say(is_restart=True)
    robot.run(400)
    assert sorted(robot.got) == sorted([*range(20), *range(11)])


def test_of_what_was_repeated_a_bounded_number_is_known_again() -> None:
    robot = Robot(EVENT)
    for _ in range(HELD + 5):
        robot.say()
    robot.run()
    robot.backlog.receive(EVENT, 0, b"of somebody else", robot.now_ns, is_restart=True)
    robot.say()
    robot.run(2 * HELD // KEPT_PIECE)
    assert len(robot.got) - robot.said <= 10
