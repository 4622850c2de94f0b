"""The logs to delete, and whether recording may continue."""

import re

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from recorder.record.retention import RESUME_SHARE, ROLL_BYTES, DiskLimits, Judgement, LogEntry, judge
from schemas.settings import INCIDENT_SHARE

SCALE = ROLL_BYTES // 80
"""Sizes here are written in these, so that they are small."""

ENTRIES = st.lists(
    st.builds(
        LogEntry,
        name=st.text("abc", min_size=1, max_size=4),
        bytes=st.integers(0, 400).map(lambda size: size * SCALE),
        started=st.sampled_from([f"20270115T08000{second}Z" for second in range(10)]),
        number=st.integers(1, 11),
        is_incident=st.sampled_from([False, False, False, True]),
        is_open=st.sampled_from([False, False, False, True]),
        is_stuck=st.sampled_from([False, False, False, True]),
    ),
    max_size=12,
    unique_by=lambda entry: entry.name,
).map(
    lambda entries: [
        msgspec.structs.replace(entry, is_own=entry.is_open)
        for entry in entries
        if not (entry.is_open and entry.is_stuck)
    ]
)
LIMITS = st.builds(
    DiskLimits,
    budget_bytes=st.sampled_from([0, 500 * SCALE, 1000 * SCALE]),
    floor_bytes=st.sampled_from([0, 200 * SCALE]),
)
FREE = st.integers(0, 500).map(lambda size: size * SCALE)


def used(entries: list[LogEntry]) -> int:
    return sum(entry.bytes for entry in entries)


def without(entries: list[LogEntry], judgement: Judgement) -> list[LogEntry]:
    return [entry for entry in entries if entry.name not in judgement.delete]


def is_within(entries: list[LogEntry], free_bytes: int, limits: DiskLimits) -> bool:
    return free_bytes >= limits.floor_bytes and (not limits.budget_bytes or used(entries) <= limits.budget_bytes)


@given(ENTRIES, FREE, LIMITS, st.booleans())
def test_only_what_may_go_goes_the_oldest_first(
    entries: list[LogEntry],
    free_bytes: int,
    limits: DiskLimits,
    is_full: bool,  # noqa: FBT001 - drawn
) -> None:
    judgement = judge(entries, free_bytes, limits, is_full=is_full)
    may_go = [entry for entry in entries if not (entry.is_incident or entry.is_open or entry.is_stuck)]
    may_go.sort(key=lambda entry: (entry.started, entry.number, entry.name))
    assert list(judgement.delete) == [entry.name for entry in may_go[: len(judgement.delete)]]


@given(ENTRIES, FREE, LIMITS)
def test_where_there_is_room_the_limits_are_kept_and_no_log_goes_in_vain(
    entries: list[LogEntry], free_bytes: int, limits: DiskLimits
) -> None:
    judgement = judge(entries, free_bytes, limits, is_full=False)
    left = without(entries, judgement)
    freed_bytes = used(entries) - used(left)
    if not judgement.has_room:
        assert judgement.delete == ()
        may_go = [entry for entry in entries if not (entry.is_incident or entry.is_open or entry.is_stuck)]
        rest = [entry for entry in entries if entry not in may_go]
        assert not is_within(rest, free_bytes + used(may_go), limits)
    elif not judgement.roll:
        assert is_within(left, free_bytes + freed_bytes, limits)
        if judgement.delete:
            last = next(entry for entry in entries if entry.name == judgement.delete[-1])
            assert not is_within([*left, last], free_bytes + freed_bytes - last.bytes, limits) or not last.bytes


@given(ENTRIES, FREE, LIMITS)
def test_logs_are_ended_only_when_that_makes_room_and_is_worth_it(
    entries: list[LogEntry], free_bytes: int, limits: DiskLimits
) -> None:
    judgement = judge(entries, free_bytes, limits, is_full=False)
    if judgement.roll:
        assert judgement.has_room
        open_bytes = used([entry for entry in entries if entry.is_open and not entry.is_incident])
        assert open_bytes >= ROLL_BYTES
        ended = [
            msgspec.structs.replace(entry, is_open=entry.is_open and entry.is_incident, is_own=False)
            for entry in entries
        ]
        assert judge(ended, free_bytes, limits, is_full=False).has_room


@given(ENTRIES, FREE, LIMITS)
def test_a_recording_that_goes_on_does_not_stop_at_the_next_byte(
    entries: list[LogEntry], free_bytes: int, limits: DiskLimits
) -> None:
    judgement = judge(entries, free_bytes, limits, is_full=True)
    if judgement.has_room and not judgement.roll:
        left = without(entries, judgement)
        freed_bytes = used(entries) - used(left)
        spare = int(RESUME_SHARE * limits.floor_bytes)
        assert free_bytes + freed_bytes >= limits.floor_bytes + spare
        assert not limits.budget_bytes or used(left) * (1 + RESUME_SHARE) < limits.budget_bytes + 1


LOG = re.compile(r"(?P<robot>.+)@(?P<hour>\d+):(?P<size>\d+)(?P<flags>[+!~]*)")


def log(text: str) -> LogEntry:
    """A log, as robot@hour:size; + it is being written, ! it is an incident, ~ it is uploaded."""
    match = LOG.fullmatch(text)
    assert match, text
    robot, flags, start = match["robot"], match["flags"], f"20270115T{int(match['hour']):02}0000Z"
    is_open = "+" in flags
    return LogEntry(
        f"{robot}@{match['hour']}",
        int(match["size"]) * SCALE,
        start,
        robot=robot,
        is_incident="!" in flags,
        is_open=is_open,
        is_own=is_open,
        is_safe="~" in flags,
    )


def logs_of(text: str) -> list[LogEntry]:
    return [log(one) for one in text.split()]


def limits_of(text: str) -> DiskLimits:
    """Limits as budget/floor, and after a colon the known robot and how long its logs are kept."""
    (budget, floor), (known, keep) = (
        part.split("/") if part else ("", "0") for part in (text.partition(":")[0], text.partition(":")[2])
    )
    known_ones = frozenset({known} - {""})
    return DiskLimits(int(budget) * SCALE, int(floor) * SCALE, known=known_ones, keep_s=float(keep))


def ruling(text: str) -> Judgement:
    """The deleted logs; "full" without space, "crowded" without space for incidents, "roll"."""
    words = {"full", "crowded", "roll"}
    said = text.split()
    delete = tuple(word for word in said if word not in words)
    return Judgement(
        delete, has_room="full" not in said, has_incident_room="crowded" not in said, roll="roll" in said
    )


RULINGS = """
the ended one is just enough              | a@1:300 a@2:600+              | 600/0    | a@1
all of it together is just enough         | a@1:300 a@2:600+              | 0/900    | a@1 roll crowded
without limits nothing goes               | a@1:1000000                   | 0/0 full |
a budget that is used up is enough        | a@1:1000!                     | 1000/0   | crowded
beyond it recording stops                 | a@1:1000!                     | 999/0    | full crowded
and goes on with a part of it free        | a@1:1000!                     | 1020/0 full | crowded
which keeps it from fluttering            | a@1:1000!                     | 1019/0 full | full crowded
so it is with the floor                   | a@1:1000!                     | 0/1000@1000 |
below it recording stops                  | a@1:1000!                     | 0/1000@999 | full
and goes on well above it                 | a@1:1000!                     | 0/1000@1020 full |
and no sooner                             | a@1:1000!                     | 0/1000@1019 full | full
who takes most gives, others being older  | q@0:50 q@1:50 l@10:300 l@11:300 l@12:300 | 500/0 | l@10 l@11
an open file counts in a robot's share    | q@0:300 l@10:100 l@11:500+    | 850/0    | l@10
a stranger's open file is ended first     | c@0:300 c@1:100+ s@10:600+    | 900/0:c/7200 | roll
a known robot's own last hours go last    | c@0:300 c@1:300 c@2:300+      | 800/0:c/7200 | c@0
and then its open file is ended           | c@0:300 c@1:600+              | 200/0:c/7200 | c@0 roll
a stranger's open incident is no log yet  | s@0:600+! c@0:500             | 1000/0:c/0   | c@0 crowded
incidents take their share                | s@0:300! s@1:300!             | 1000/0   | crowded
but strangers' where robots are known     | s@0:300! s@1:300!             | 1000/0:c/0   |
and those go like logs                    | s@0:300! s@1:300! c@0:500     | 1000/0:c/0   | s@0
the safe one goes first, however young    | a@1:100 a@2:100~ a@3:100      | 200/0    | a@2
then the oldest of the rest               | a@1:100 a@2:100~ a@3:100      | 100/0    | a@2 a@1
last hours stay though they are safe      | s@0:100 c@0:100 c@1:100~      | 200/0:c/7200 | s@0
but go first where nothing else is left   | c@0:100 c@1:100~              | 100/0:c/7200 | c@1
an incident goes when it is safe and whole| a@1:100!~ a@2:100! a@3:100!~+ | 200/0    | a@1 crowded
safe incidents leave their room           | a@1:100!~ a@2:100!~           | 300/0    |
others do not                             | a@1:100! a@2:100!             | 300/0    | crowded
0 s: the newest of a known robot stays    | c@0:10 c@1:10 c@2:10 c@3:10 c@4:10 s@10:1 s@11:1 | 10/0:c/0    | {0}
1 s: a log reaches up to the next         | c@0:10 c@1:10 c@2:10 c@3:10 c@4:10 s@10:1 s@11:1 | 20/0:c/1    | {1}
an hour: the same                         | c@0:10 c@1:10 c@2:10 c@3:10 c@4:10 s@10:1 s@11:1 | 20/0:c/3600 | {1}
two hours                                 | c@0:10 c@1:10 c@2:10 c@3:10 c@4:10 s@10:1 s@11:1 | 30/0:c/7200 | {2}
what is ended is enough                   | a@1:402 a@2:300 a@3:99+       | 800/5000@6000 | a@1
only with what is being written it is     | a@1:402 a@2:300 a@3:950+      | 800/5000@6000 | a@1 a@2 roll
not even then                             | a@1:402 a@2:300 a@3:300+      | 800/5000@3000 | full
what is being written is worth it         | a@1:402 a@2:300 a@3:80+       | 800/5000@4220 | a@1 a@2 roll
and what is not                           | a@1:402 a@2:300 a@3:79+       | 800/5000@4220 | full
two hours and a second                    | c@0:10 c@1:10 c@2:10 c@3:10 c@4:10 s@10:1 s@11:1 | 40/0:c/7201 | {3}
""".format(*(" ".join([*(f"c@{hour}" for hour in range(4 - number)), "s@10 s@11"]) for number in range(4)))
ROWS = [[part.strip() for part in row.split("|")] for row in RULINGS.strip().splitlines()]


@pytest.mark.parametrize(("logs", "limits", "expected"), [row[1:] for row in ROWS], ids=[row[0] for row in ROWS])
def test_what_goes_and_whether_there_is_room(logs: str, limits: str, expected: str) -> None:
    """A row each: the logs, the limits with the free bytes behind "@", the ruling.

    Behind "full" recording had stopped.
    """
    limits, _, is_full = limits.partition(" ")
    limits, _, free = limits.partition("@")
    found = judge(logs_of(logs), int(free or 0) * SCALE, limits_of(limits), is_full=bool(is_full))
    assert found == ruling(expected)


def test_what_an_earlier_recorder_left_is_no_reason_to_end_files() -> None:
    left = LogEntry("1", 5000 * SCALE, "1", is_open=True)
    assert judge([left, log("a@2:100")], 0, limits_of("1000/0"), is_full=False) == ruling("full")


@pytest.mark.parametrize(("more_bytes", "has_room"), [(-1, True), (0, False)])
def test_incidents_may_fill_their_share_and_no_more(more_bytes: int, *, has_room: bool) -> None:
    incident = LogEntry("1", int(INCIDENT_SHARE * 1000 * SCALE) + more_bytes, "1", is_incident=True)
    assert judge([incident], 0, limits_of("1000/0"), is_full=False).has_incident_room is has_room


@pytest.mark.parametrize("starts", [("a", "b"), ("00010101T000000Z", "00010101T003000Z")])
def test_of_a_known_robot_whose_starts_are_no_times_the_newest_log_stays(starts: tuple[str, str]) -> None:
    own = [LogEntry(start, 100 * SCALE, start, robot="c") for start in starts]
    judgement = judge([*own, log("s@0:50")], 0, limits_of("150/0:c/3600"), is_full=False)
    assert judgement.delete == starts[:1]


def bytes_of(robot: str, entries: list[LogEntry]) -> int:
    return used([entry for entry in entries if entry.robot == robot]) // SCALE


def test_made_up_robots_cost_the_true_one_no_more_than_its_fair_share() -> None:
    """With known robots, a thousand made-up names have one share together."""
    own = [log(f"c@{hour}:100") for hour in range(10)]
    entries = own + [log(f"s{number}@{hour}:100") for number in range(9) for hour in range(10, 20)]
    left = without(entries, judge(entries, 0, limits_of("1000/0"), is_full=False))
    robots = {entry.robot for entry in entries}
    assert {robot: bytes_of(robot, left) for robot in robots} == dict.fromkeys(robots, 100)
    assert own[-1] in left
    entries = own + [log(f"s{number}@10:10") for number in range(1000)]
    left = without(entries, judge(entries, 0, limits_of("2000/0:c/0"), is_full=False))
    assert bytes_of("c", left) == 1000
    assert used(left) <= 2000 * SCALE


@pytest.mark.parametrize(("age_s", "goes"), [(3599.0, False), (3600.0, True)])
def test_an_incident_that_is_safe_elsewhere_stays_for_a_while(age_s: float, *, goes: bool) -> None:
    entry = LogEntry("safe", 100, "20270115T080000Z", is_incident=True, is_safe=True, age_s=age_s)
    judgement = judge([entry], 0, DiskLimits(budget_bytes=50, keep_incidents_s=3600.0), is_full=False)
    assert (judgement.delete == ("safe",), judgement.has_incident_room) == (goes, goes)
