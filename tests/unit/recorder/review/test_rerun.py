"""Reruns: journals in order, and the comparison of recorded and rerun messages."""

from collections.abc import Callable, Iterable, Iterator
from functools import cache
from pathlib import Path
from random import Random
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.rerun import rerun
from recorder.encoding.protobuf import compile_encoder
from recorder.mcap.writer import LogChannel
from recorder.reading.logs import Faults, find_logs
from recorder.reading.rows import Row
from recorder.reading.survey import CONFIGURATION
from recorder.reading.topics import Topic, typed_decoder
from recorder.review import rerun as module
from recorder.review.rerun import (
    BATCH_NS,
    RECEIVED,
    Comparison,
    Key,
    PartEnd,
    RerunPlayer,
    RerunResult,
    Tape,
    rerun_parts,
)
from recorder.review.what_if import TriedSettings, rerun_tasks
from schemas.codec import Sample
from schemas.configuration import to_toml
from schemas.decisions import EventKind, Journal, SafetyEvent, Severity
from schemas.journal import Kind
from schemas.messages import Variant
from schemas.reasons import Reason
from schemas.settings import CommandSettings, Settings
from tests.support.logs import Log, mcap_log, saved, small_log
from tests.support.messages import MS, SECOND, WALL_NS, FakeSample, info, sample_of
from tests.support.reading import Read
from tests.support.rigs.day import Day

# The journals of a robot: given rows of a log, the parts of its runs.


def topic(subject: str) -> Topic:
    decode = typed_decoder(Journal) if subject == "journal" else None
    name, robot = f"fleet/cruiser-1/{subject}", "cruiser-1"
    return Topic(name, "", "protobuf", "protobuf", b"", None, robot, robot, subject, decode)


JOURNAL, STATE = topic("journal"), topic("state")
ENCODE_JOURNAL = compile_encoder(Journal)
SHUFFLED = [(7, 2 * place) for place in range(20)] * 2
Random(3).shuffle(SHUFFLED)  # noqa: S311 - nothing here is secret


def row_of(given: tuple[int, int] | int | bytes) -> Row:
    """A journal of two inputs by run and first place, another message by its number, or these bytes."""
    if isinstance(given, int):
        return Row(STATE, given, 0, given, b"")
    if isinstance(given, bytes):
        return Row(JOURNAL, 0, 0, 0, given)
    run, first = given
    message = Journal(1000 * run + first, first, run=run, first=first, count=2, inputs=b"xx")
    return Row(JOURNAL, first, 0, message.time_ns, ENCODE_JOURNAL(message))


def played(
    rows: Iterable[tuple[int, int] | int | bytes], faults: Faults | None = None
) -> Iterator[tuple[list[int], PartEnd, list[int]]]:
    """Of each part the places of its journals, its end, and the other messages."""
    taken: list[int] = []
    tape = Tape(map(row_of, rows), lambda row: taken.append(row.sequence), Faults() if faults is None else faults)
    while tape.next_part():
        begins_ns = tape.next_time_ns
        firsts = [one.first for one in tape.journals()]
        assert firsts == list(range(tape.end.first, tape.end.first + tape.end.inputs, 2))
        assert begins_ns // 1000 == tape.end.run
        yield firsts, tape.end, list(taken)
        taken.clear()


LACKING = "inputs 2 to 5 are missing"
TAPES: dict[str, tuple[Iterable[tuple[int, int] | int | bytes], list[PartEnd], list[int], int]] = {
    "in order, and the rest between": ([1, (7, 0), 2, (7, 2), 3], [PartEnd(7, 0, 4, "")], [1, 2, 3], 0),
    "whatever order, and twice": (SHUFFLED, [PartEnd(7, 0, 40, "")], [], 0),
    # A recorder that came after the gateway asks for its beginning while it hears what follows.
    "a beginning that comes late": (
        [*((7, first) for first in range(20, 40, 2)), *((7, first) for first in range(0, 20, 2))],
        [PartEnd(7, 0, 40, "")],
        [],
        0,
    ),
    "a gap": ([(7, 0), (7, 6), (7, 8)], [PartEnd(7, 0, 2, LACKING), PartEnd(7, 6, 4, LACKING)], [], 0),
    "without its beginning": ([(7, 10), (7, 12)], [PartEnd(7, 10, 4, "inputs 0 to 9 are missing")], [], 0),
    # What is left of a run that is over changes nothing.
    "each run of a gateway": (
        [(7, 0), (8, 0), (7, 2), (8, 2), (9, 4)],
        [PartEnd(7, 0, 2, ""), PartEnd(8, 0, 4, ""), PartEnd(9, 4, 2, "inputs 0 to 3 are missing")],
        [],
        0,
    ),
    "what cannot be read": ([(7, 0), b"\xff", (7, 2)], [PartEnd(7, 0, 4, "")], [], 1),
}


@pytest.mark.parametrize("row", TAPES)
def test_the_journals_of_a_run_come_in_their_order(row: str) -> None:
    rows, ends, taken, fault_count = TAPES[row]
    faults = Faults()
    parts = list(played(rows, faults))
    assert [end for _, end, _ in parts] == ends
    assert [number for _, _, numbers in parts for number in numbers] == taken
    assert faults.count == fault_count


@pytest.mark.parametrize(("name", "bound"), [("HELD_MAX", 10), ("HELD_BYTES", 10)])
def test_what_waits_for_its_turn_is_bounded(monkeypatch: pytest.MonkeyPatch, name: str, bound: int) -> None:
    monkeypatch.setattr(module, name, bound)
    rows = [*((7, first) for first in range(2, 200, 2)), (7, 0), (8, 0)]
    assert [(firsts[0], len(firsts), end.run) for firsts, end, _ in played(rows)] == [(2, 99, 7), (0, 1, 8)]


@given(st.lists(st.integers(0, 30), max_size=60), st.integers(1, 12))
def test_every_journal_is_played_once_and_in_order_within_its_part(order: list[int], held: int) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "HELD_MAX", held)
        firsts = [first for part, _, _ in played([(7, 2 * place) for place in order]) for first in part]
    assert firsts == sorted(set(firsts))
    assert set(firsts) <= {2 * place for place in order}
    if held > len(set(order)):
        assert len(firsts) == len(set(order))


def test_a_journal_that_is_longer_than_any_gateway_says_is_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "JOURNAL_BYTES", 1)
    faults = Faults()
    assert not list(played([(7, 0)], faults))
    assert "is too long" in faults.told[0]


# Both sides: given what was recorded and what comes out again, what is compared.

EVENT = "safety/event"
ENCODE_EVENT = compile_encoder(SafetyEvent)


def event(number: int, operator: str = "", text: str = "") -> bytes:
    about = (Severity.INFO, EventKind.LEASE, Reason.NONE)
    return ENCODE_EVENT(SafetyEvent(number, number, 7, *about, operator=operator, text=text))


def key(number: int, subject: str = EVENT) -> Key:
    return subject, number, number


def compared(steps: str = "") -> Comparison:
    """A comparison after these steps.

    r1 is recorded and a1 rerun, each with its number; ! has another text, f is a frame, + a state that comes much
    later.
    """
    comparison = Comparison(lambda _, data: typed_decoder(SafetyEvent)(data))
    for step in steps.split():
        if step == "+":
            comparison.say_again(key(BATCH_NS + 9, "safety/state"), event(9))
            continue
        number = int(step.strip("raf!"))
        take = comparison.record if step[0] == "r" else comparison.say_again
        take(key(number, RECEIVED if "f" in step else EVENT), event(number, "x" if "!" in step else ""))
    return comparison


@pytest.mark.parametrize(
    ("steps", "same", "unrecorded", "differing", "later"),
    [
        ("r0 a0 a1! r1 +", 1, 0, [1], []),
        # What the log lost is counted by itself. Of the last tenth of a second nobody knows whether it was lost.
        ("a0 a1 a2 a3 a4 r3 + a100000005", 1, 4, [], []),
        # What was recorded and does not come again is a difference; later than the end it belongs to the next run.
        ("a0 + r0 r1 r12", 1, 0, [1], [12]),
        # A recorder may have asked for what it had, and two recorders write each message.
        ("a0 r0 a1 r1 a2 r2 r1 +", 3, 0, [], []),
        ("rf0 af0 rf0 a1 r1 rf0 +", 2, 0, [], []),
        # A run that begins in its midst has said much before, and none of it is a difference; a frame begins none.
        ("r0 r1 r2 r3 r4 a3 +", 1, 0, [4], []),
        ("r1 af2 rf2 r3 a4 r4 +", 2, 0, [], []),
        # What was put in under the key of another: before it or behind it, before it comes again or after that.
        ("a0 r0 r1 r1! a1 a2 r2 +", 3, 0, [1], []),
        ("a0 r0 r1! r1 a1 a2 r2 +", 3, 0, [1], []),
        ("a0 r0 r1 a1 a2 r2 r1! +", 3, 0, [1], []),
        ("a0 r0 r1! a1 a2 r2 r1 +", 2, 0, [1, 1], []),
    ],
)
def test_each_message_is_compared_with_its_counterpart(
    steps: str, same: int, unrecorded: int, differing: list[int], later: list[int]
) -> None:
    comparison = compared(steps)
    assert [one[1] for one, _ in comparison.end()] == later
    assert comparison.same.total() == same
    assert comparison.unrecorded.total() == unrecorded
    assert [one.time_ns for one in comparison.differences] == differing
    assert (comparison.difference_count, comparison.given_up) == (len(differing), 0)
    for one in comparison.differences:
        assert one.fields in ({"operator": ("", "x")}, {"operator": ("x", "")}) or one.message is not None


def test_other_words_are_no_difference() -> None:
    comparison = Comparison(lambda _, data: typed_decoder(SafetyEvent)(data))
    for number, again in enumerate((event(0, text="as now"), event(1, "bob", "as now"))):
        comparison.record(key(number), event(number, text="as then"))
        comparison.say_again(key(number), again)
    assert (comparison.reworded, [one.time_ns for one in comparison.differences]) == (1, [1])


@given(st.lists(st.booleans(), min_size=1, max_size=60), st.integers(0, 2**32))
def test_either_side_may_be_ahead(changed: list[bool], seed: int) -> None:
    sides = [letter for letter in "ra" for _ in changed]
    Random(seed).shuffle(sides)  # noqa: S311 - nothing here is secret
    # Each side alone is in its order.
    numbers = {letter: iter(range(len(changed))) for letter in "ra"}
    steps = [(side, next(numbers[side])) for side in sides]
    words = (f"{side}{number}{'!' * (side == 'a' and changed[number])}" for side, number in steps)
    comparison = compared(" ".join(words))
    assert comparison.end() == []
    assert (comparison.same[EVENT], comparison.difference_count) == (changed.count(False), changed.count(True))
    assert all(one.fields == {"operator": ("", "x")} for one in comparison.differences)
    assert not comparison.unrecorded


def test_memory_and_output_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "WAITING_MAX", 3)
    monkeypatch.setattr(module, "DIFFERENCES_MAX", 2)
    comparison = compared("a9 r0 r1 r2 r3 r4")
    assert comparison.given_up == 2
    assert compared("r0 r1 r2 r3 r4").given_up == 0
    for number in range(5):
        comparison.say_again(key(number), event(number, "x"))
    assert (comparison.difference_count, len(comparison.differences)) == (3, 2)
    monkeypatch.setattr(module, "COPIES_MAX", 2)
    pairs = " ".join(f"a{number} r{number}" for number in range(5))
    assert compared(f"{pairs} r4").given_up == 0
    late = compared(f"{pairs} r4 r1")
    assert (late.given_up, late.difference_count) == (1, 0)


# Whole logs.


@cache
def day_log() -> bytes:
    day = Day(1, Variant.COARSE, ticks=1500)
    day.live()
    return day.rig.log()


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "cruiser-1-20260102T030405Z.mcap"
    path.write_bytes(day_log())
    return path


def run_again(path: Path) -> tuple[list[RerunResult], Faults]:
    faults = Faults()
    found: list[RerunResult] = []
    for task in rerun_tasks(find_logs([path], faults), TriedSettings(None, "", {}), faults):
        player = RerunPlayer(task.robot, task.logs, task.configurations, faults, lambda _: None)
        found += rerun_parts(player)
    return found, faults


def of_depot() -> bytes:
    return day_log().replace(b"fleet/", b"depot/")


def without_configuration() -> bytes:
    return day_log().replace(CONFIGURATION.encode(), CONFIGURATION.replace("f", "g").encode())


@pytest.mark.parametrize(
    ("others", "results"),
    [
        # A second copy of a frame or of a decision is no other one.
        ([day_log], [("cruiser-1", True, "")]),
        ([of_depot], [("depot/cruiser-1", True, ""), ("fleet/cruiser-1", True, "")]),
        ([small_log], [("cruiser-1", True, "")]),
        # Start values would give decisions that nobody made.
        ([None, without_configuration], [("cruiser-1", False, "the log does not hold the robot's configuration")]),
        ([None, small_log], []),
    ],
    ids=["two recorders", "two roots", "beside one without a journal", "no configuration", "no journal"],
)
def test_logs_of_a_directory_are_run_again(
    log: Path, others: list[Callable[[], bytes] | None], results: list[tuple[str, bool, str]]
) -> None:
    for number, data in enumerate(others):
        if data is None:
            log.unlink()
        else:
            log.with_name(f"other-{number}.mcap").write_bytes(data())
    found, faults = run_again(log.parent)
    assert bool(faults) == any(one in {of_depot, without_configuration} for one in others)
    assert [(one.robot, one.inputs > 0, one.detail) for one in found] == results
    assert sum(one.difference_count for one in found) == 0


@pytest.mark.parametrize("topic", ["can/can0/rx", "can/can0/tx", "safety/state", "safety/event"])
@pytest.mark.parametrize("is_put_in", [True, False])
def test_what_was_changed_or_put_in_is_a_difference(
    tmp_path: Path, log: Path, topic: str, *, is_put_in: bool
) -> None:
    read = Read(log)
    places = [place for place, one in enumerate(read.messages) if one[0].endswith(topic)]
    place = places[len(places) // 2]
    *head, data = read.messages[place]
    forged: Any = (*head, data[:-1] + bytes([data[-1] ^ 1]))
    read.messages[place : place + (not is_put_in)] = [forged]
    channels = {
        one.topic: LogChannel(one.id, one.topic, schema.name, schema.data)
        for one in read.channels
        if (schema := read.schemas.get(one.schema_id))
    }
    # In this log all times of receipt are the same.
    rows = [
        (channels[topic].channel_id, sequence, log_ns + number, publish_ns, data)
        for number, (topic, sequence, log_ns, publish_ns, data) in enumerate(read.messages)
    ]
    attachments = [(one.name, one.data) for one in read.attachments]
    changed = saved(tmp_path / "changed.mcap", mcap_log(channels.values(), [rows], attachments=attachments))
    [result], _ = run_again(changed)
    if topic.startswith("safety/") and not is_put_in:  # The last byte is one of the words.
        assert (result.reworded, result.difference_count) == (1, 0)
        return
    assert result.difference_count > 0
    assert result.differences[0].subject.rpartition("/")[2] == topic.rpartition("/")[2]


def said_journal(run: int, inputs: bytes, time_ns: int) -> FakeSample:
    return sample_of(Journal(time_ns, 0, run=run, first=0, count=1, inputs=inputs))  # type: ignore[return-value]


SHUT_DOWN = msgspec.msgpack.encode([[Kind.SHUT_DOWN, 1]])


def test_each_run_has_its_own_configuration(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = Log()
    begins = [(1, WALL_NS, 0.5), (2, WALL_NS + 5 * SECOND, 0.5), (3, WALL_NS + 9 * SECOND, 1.0)]
    for number, (run, time_ns, limit_mps) in enumerate(begins):
        text = to_toml(Settings(command=CommandSettings(speed_limit_mps=limit_mps)))
        answer = msgspec.structs.replace(info(sequence=number), started_ns=time_ns - MS, configuration=text)
        log.receive(said_journal(run, SHUT_DOWN, time_ns), sample_of(answer), wall_ns=time_ns)
    (tmp_path / "log.mcap").write_bytes(log.close())
    seen: list[float] = []

    def watch(settings: Settings, journals: Iterable[Journal]) -> Iterator[Sample]:
        seen.append(settings.command.speed_limit_mps)
        return rerun(settings, journals)

    monkeypatch.setattr(module, "rerun", watch)
    run_again(tmp_path / "log.mcap")
    assert seen == [0.5, 0.5, 1.0]


@pytest.mark.parametrize("inputs", [b"\xc1", b"\x05", *map(msgspec.msgpack.encode, ([[99, 1]], [[Kind.TICK, 1]]))])
def test_a_journal_that_makes_no_sense_ends_its_part(tmp_path: Path, inputs: bytes) -> None:
    log = Log()
    log.receive(sample_of(info()), said_journal(1, inputs, WALL_NS), said_journal(2, SHUT_DOWN, WALL_NS + SECOND))
    (tmp_path / "log.mcap").write_bytes(log.close())
    results, faults = run_again(tmp_path / "log.mcap")
    assert [(one.run, "cannot be rerun" in one.detail) for one in results] == [(1, True), (2, False)]
    assert faults.count == 1
