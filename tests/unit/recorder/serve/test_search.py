"""What is found by words, held against a plain look at every row."""

import shlex
from collections.abc import Callable, Sequence
from fnmatch import fnmatchcase
from typing import Any

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from recorder.review.catalog.rows import CatalogRow, LoggedDriver, LoggedMoment
from recorder.review.catalog.table import to_table
from recorder.serve.search import (
    FIELDS,
    KINDS,
    FindAnswer,
    FindSubject,
    FoundDrive,
    FoundMoment,
    columns_of,
    find,
    newest,
    read_words,
)
from schemas.exit_codes import CommandError, ExitCode
from tests.support.catalog import DRIVE, ROW, STOP, row
from tests.support.messages import SECOND, WALL_NS

NOW_NS = WALL_NS + 100 * SECOND


def found(words: str, rows: Sequence[CatalogRow], now_ns: int = NOW_NS) -> list[FindAnswer]:
    """What is found in a catalog of these rows."""
    query = read_words(words, now_ns)
    return find(to_table(rows).select(columns_of(query)), query)


def moment(**changes: Any) -> LoggedMoment:  # noqa: ANN401 - any field of a moment
    """A moment that is otherwise ``STOP``."""
    return msgspec.structs.replace(STOP, **changes)


# The oracle: what each field is, in plain Python, and what each sign means.

MOMENT_FIELDS = ("file", "robot", "kind", "reason", "severity", "operator", "text", "count")


def of_moment(field: str, file: str, one: LoggedMoment) -> Any:  # noqa: ANN401 - texts, or a number
    """A field of a moment."""
    if field == "count":
        return one.count
    return [file if field == "file" else getattr(one, field)]


LOG_FIELDS: dict[str, Callable[[CatalogRow], Any]] = {
    "robot": lambda one: one.names,
    "operator": lambda one: [driver.name for driver in one.operators],
    "reason": lambda one: list(one.stops),
    "version": lambda one: list(one.versions.values()),
    "settings": lambda one: one.settings,
    "whole": lambda one: ["yes" if one.is_whole else "no"],
    "incident": lambda one: ["yes" if one.is_incident else "no"],
    "distance_m": lambda one: one.distance_m,
    "duration_s": lambda one: (one.end_ns - one.start_ns) / 1e9,
    "lost": lambda one: one.lost,
    "drives": lambda one: len(one.drives),
}


def holds(value: Any, sign: str, wanted: str) -> bool:  # noqa: ANN401 - a list of texts, a number or nothing
    """A condition holds for a value, by the rules."""
    if isinstance(value, list):
        fits = any(fnmatchcase(one.lower(), part.lower()) for one in value for part in wanted.split(","))
        return fits == (sign == "=")
    if value is None:
        return False
    number = float(wanted)
    truths = {
        "=": value == number,
        "!=": value != number,
        "<": value < number,
        "<=": value <= number,
        ">": value > number,
        ">=": value >= number,
    }
    return bool(truths[sign])


NAMES = st.sampled_from(["cruiser-1", "cruiser-2", "Mule"])
PEOPLE = st.sampled_from(["alice", "bob", ""])
TIMES = st.integers(-5, 5).map(lambda number: WALL_NS + number * 10 * SECOND)
REASONS = st.sampled_from(["front_bumper", "deadman", "none"])
MOMENTS = st.builds(
    lambda time_ns, length_ns, **fields: moment(time_ns=time_ns, last_ns=time_ns + length_ns, **fields),
    time_ns=TIMES,
    length_ns=st.sampled_from([0, 15 * SECOND]),
    robot=NAMES,
    kind=st.sampled_from(KINDS),
    severity=st.sampled_from(["info", "warning", "error"]),
    reason=REASONS,
    operator=PEOPLE,
    count=st.integers(1, 3),
    is_stop=st.booleans(),
    text=st.sampled_from(["the front bumper was hit", "stopped, by name", "a [b] c"]),
)
ROWS = st.lists(
    st.builds(
        row,
        file=st.uuids().map(lambda one: f"{one}.mcap"),
        start_ns=TIMES,
        end_ns=TIMES.map(lambda time_ns: time_ns + 100 * SECOND),
        is_whole=st.booleans(),
        is_incident=st.booleans(),
        is_covered=st.booleans(),
        names=st.lists(NAMES, max_size=2, unique=True),
        distance_m=st.sampled_from([0.0, 1.5, 20.0]),
        operators=st.lists(PEOPLE.map(lambda name: LoggedDriver("cruiser-1", name, 1.0, 1.0)), max_size=2),
        stops=st.dictionaries(REASONS, st.just(1), max_size=2),
        versions=st.dictionaries(st.just("recorder_version"), st.sampled_from(["0.1.0", "0.2.0"])),
        settings=st.lists(st.sampled_from(["ab12", "cd34"]), max_size=2, unique=True),
        lost=st.sampled_from([None, 0, 7]),
        drives=st.lists(st.just(DRIVE), max_size=2),
        moments=st.lists(MOMENTS, max_size=4),
    ),
    max_size=6,
)
TEXT_SIGNS = st.sampled_from(["=", "!="])
NUMBER_SIGNS = st.sampled_from(["=", "!=", "<", "<=", ">", ">="])
PATTERNS = {
    "robot": ["cruiser-*", "cruiser-?", "MULE", "*[2e]", "cruiser-1,mule", "nobody"],
    "kind": ["stop", "*", "gap,incident"],
    "reason": ["front_bumper", "*bumper", "deadman,none"],
    "severity": ["error", "warning,error"],
    "operator": ["alice", "*", "?*", "bob,alice"],
    "text": ["*bumper*", "stopped?*", "nothing"],
    "version": ["0.1.*", "9"],
    "settings": ["ab*"],
    "whole": ["yes", "no"],
    "incident": ["yes"],
    "file": ["*.mcap", "0*"],
}


def conditions(fields: Sequence[str]) -> st.SearchStrategy[list[tuple[str, str, str]]]:
    """Up to three conditions, of these fields."""

    def one(field: str) -> st.SearchStrategy[tuple[str, str, str]]:
        if field in PATTERNS:
            return st.tuples(st.just(field), TEXT_SIGNS, st.sampled_from(PATTERNS[field]))
        return st.tuples(st.just(field), NUMBER_SIGNS, st.sampled_from(["0", "1", "1.5", "2", "100", "1e3"]))

    return st.lists(st.sampled_from(list(fields)).flatmap(one), max_size=3)


def answered(words: str, rows: Sequence[CatalogRow], known: set[str], robots: Sequence[str]) -> Any:  # noqa: ANN401
    """What is found; None, and rightly so, where it is asked for a robot that is in no log."""
    unknown = [
        pattern
        for wanted in robots
        for pattern in wanted.split(",")
        if not any(fnmatchcase(name.lower(), pattern.lower()) for name in known)
    ]
    if unknown:
        with pytest.raises(CommandError, match="the logs hold nothing of"):
            found(words, rows)
        return None
    return found(words, rows)


@settings(max_examples=3 * settings().max_examples)
@given(
    rows=ROWS,
    asked=conditions(MOMENT_FIELDS),
    subject=st.sampled_from(["event", "stop", "fault", "incident", "gap"]),
    last_s=st.sampled_from([None, 80, 105]),
)
def test_moments_are_those_of_a_plain_look(
    rows: list[CatalogRow], asked: list[tuple[str, str, str]], subject: str, last_s: int | None
) -> None:
    """Every condition holds; by time, each once, of the first log; none of an incident that other logs hold."""
    words = shlex.join([subject, *("".join(one) for one in asked)]) + (f" last {last_s}s" if last_s else "")
    left = [one for one in rows if not one.is_covered]
    got = answered(words, rows, {name for one in left for name in one.names}, _robots(asked))
    if got is None:
        return
    from_ns = NOW_NS - last_s * SECOND if last_s else 0
    expected = {
        one
        for log in left
        for one in log.moments
        if one.last_ns >= from_ns
        and (one.is_stop if subject == "stop" else subject in {"event", one.kind})
        and all(holds(of_moment(field, log.file, one), sign, wanted) for field, sign, wanted in asked)
    }
    assert [one.moment.time_ns for one in got] == sorted(one.time_ns for one in expected)
    assert {one.moment for one in got} == expected
    files = {log.file: log.moments for log in left}
    assert all(one.moment in files[one.file] for one in got)


@settings(max_examples=3 * settings().max_examples)
@given(rows=ROWS, asked=conditions(list(LOG_FIELDS)))
def test_logs_are_those_of_a_plain_look(rows: list[CatalogRow], asked: list[tuple[str, str, str]]) -> None:
    """What is in a list holds where it does for one of the list; ``!=`` where it does for none."""
    words = shlex.join(["log", *("".join(one) for one in asked)])
    left = [one for one in rows if not one.is_covered]
    got = answered(words, rows, {name for one in left for name in one.names}, _robots(asked))
    if got is None:
        return
    expected = [
        one for one in left if all(holds(LOG_FIELDS[field](one), sign, wanted) for field, sign, wanted in asked)
    ]
    assert {one.file for one in got} == {one.file for one in expected}
    bare = {one.file: msgspec.structs.replace(one, moments=[]) for one in expected}
    assert all(one == bare[one.file] for one in got)


def _robots(asked: Sequence[tuple[str, str, str]]) -> list[str]:
    return [wanted for field, sign, wanted in asked if (field, sign) == ("robot", "=")]


def test_stops_of_a_robot_in_the_last_days() -> None:
    """Of the reason that is asked for, and no older."""
    old, new = moment(time_ns=WALL_NS - 40 * 86400 * SECOND, last_ns=WALL_NS - 40 * 86400 * SECOND), STOP
    other = moment(robot="mule", reason="deadman")
    rows = [row(moments=[old, new, other], names=["cruiser-1", "mule"])]
    words = "stop reason=front_bumper robot=cruiser-* last 30d"
    assert found(words, rows) == [FoundMoment("a.mcap", new)]
    assert found("stop reason=front_bumper last 41d", rows) == [
        FoundMoment("a.mcap", old),
        FoundMoment("a.mcap", new),
    ]


@pytest.mark.parametrize(
    ("words", "times"),
    [
        ("event robot!=cruiser-1", [3]),
        ("event reason!=front_bumper,none", [2]),
        ("event operator=ALICE", [1, 3]),
        ("event operator=", [2]),
        ("event count>1", [2]),
        ("event count!=2", [1, 3]),
        ("stop", [1, 3]),
        ("event kind=stop", [1]),
        ("takeover", [3]),
        ("event last 98s", [2, 3]),
        ("event last 92s", [2]),
        ("event last 90s", []),
        ("event to 2027-01-15T08:00:02Z", [1]),
        ("event to 2027-01-15T08:00:02.5Z from 2027-01-15T08:00:01.5Z", [2]),
        ("event text='*by name*'", [3]),
        ("event file=b*", []),
    ],
)
def test_each_sign_and_word(words: str, times: list[int]) -> None:
    """Of three moments, 1, 2 and 3 s after the beginning; the second one lasts until 9 s after it."""
    rows = [
        row(
            names=["cruiser-1", "mule"],
            moments=[
                moment(time_ns=WALL_NS + SECOND, last_ns=WALL_NS + SECOND),
                moment(
                    time_ns=WALL_NS + 2 * SECOND,
                    last_ns=WALL_NS + 9 * SECOND,
                    kind="fault",
                    reason="deadman",
                    operator="",
                    count=2,
                    is_stop=False,
                ),
                moment(
                    time_ns=WALL_NS + 3 * SECOND,
                    last_ns=WALL_NS + 3 * SECOND,
                    robot="mule",
                    kind="takeover",
                    reason="none",
                    text="taken by name",
                ),
            ],
        )
    ]
    got = found(words, rows)
    assert [one.moment.time_ns for one in got if isinstance(one, FoundMoment)] == [
        WALL_NS + time_s * SECOND for time_s in times
    ]


def test_drives() -> None:
    """By length, by time and by what happened in them."""
    long = msgspec.structs.replace(DRIVE, distance_m=500.0, stops=0, severity="info", text="")
    rows = [row(drives=[DRIVE, long]), row(file="b.mcap", drives=[DRIVE])]
    assert found("drive", rows) == [FoundDrive("a.mcap", DRIVE), FoundDrive("a.mcap", long)]
    assert found("drive distance_m>100", rows) == [FoundDrive("a.mcap", long)]
    assert found("drive duration_s>=10 stops=1 severity=warning text=*bumper*", rows) == [
        FoundDrive("a.mcap", DRIVE)
    ]
    assert not found("drive to 2026-01-02", rows)
    assert len(found("drive from 2026-01-02 to 2099-01-02T03:04:05Z", rows)) == 2


def test_the_newest_of_many_are_the_last_ones_and_all_are_counted() -> None:
    """What two logs hold is one answer, and a row for each of them."""
    rows = [row(file=file, moments=[moment(time_ns=WALL_NS + at) for at in range(5)]) for file in ("a", "b")]
    query = read_words("event", NOW_NS)
    table = to_table(rows).select(columns_of(query))
    assert newest(table, query, 4) == (find(table, query)[-2:], 10)
    assert newest(table, query, 100) == (find(table, query), 10)
    assert newest(table.slice(0, 0), query, 4) == ([], 0)


def test_without_a_subject_it_is_logs() -> None:
    """And without any word all of them."""
    assert found("", [ROW]) == [ROW]
    assert found("messages>9 bytes<=1000", [ROW]) == [ROW]


def test_a_time_without_logs_is_empty() -> None:
    """Nothing is in no log."""
    assert found("stop", []) == []
    assert found("log last 1s", [ROW]) == []


def test_every_field_can_be_asked_for() -> None:
    """Of each subject, of a catalog with a row and of one without."""
    of_subject = {FindSubject.MOMENTS: "event", FindSubject.DRIVES: "drive", FindSubject.LOGS: "log"}
    full = row(moments=[STOP], drives=[DRIVE], stops={"front_bumper": 1})
    for subject, fields in FIELDS.items():
        for name, field in fields.items():
            value = "0" if not hasattr(field, "words") else "*"
            words = f"{of_subject[subject]} {name}!={value}"
            assert isinstance(found(words, [full]), list)
            assert found(words, []) == []


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("stopp", "did you mean stop?"),
        ("stop drive", "two subjects, stop and drive"),
        ("bumper", "is no subject and no condition"),
        ("stop reason=front_bumpr", "did you mean front_bumper?"),
        ("stop severity=bad", "one of error, info, warning"),
        ("stop distance_m>1", "'distance_m' is no field of stop: it has file, robot"),
        ("log distance_m>far", "distance_m is a number, and 'far' is none"),
        ("stop robot>cruiser-1", "robot is a text: give robot=PATTERN"),
        ("stop last", "'last ' is no time"),
        ("stop last 30", "give a number and its unit, s, min, h, d, w, as in 30d"),
        ("stop last 3months", "'last 3months' is no time"),
        ("stop from yesterday", "'from yesterday' is no time: give a date"),
        ("stop to 12.5", "'to 12.5' is no time"),
        ("stop to 2026-11-27 from 2026-11-28", "there is no time between"),
        ("log last 1d to 2026-11-27", "there is no time between"),
        ("stop text='open", "closing quotation"),
        ("log robot=cruiser-9", "the logs hold nothing of cruiser-9, but of cruiser-1"),
        ("log whole=maybe", "one of no, yes"),
    ],
)
def test_words_that_mean_nothing_are_a_matter_of_usage(words: str, said: str) -> None:
    """An empty answer would look as if nothing had happened; the text says what can be asked."""
    with pytest.raises(CommandError) as caught:
        found(words, [ROW])
    assert said in str(caught.value)
    assert caught.value.code is ExitCode.USAGE
