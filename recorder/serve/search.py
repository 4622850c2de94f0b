"""The search of catalogs by words, for moments, drives or logs; no log is opened.

Words stand apart by blanks, in quotes as in a shell where they hold some:

    [SUBJECT] [FIELD=PATTERN] [FIELD!=PATTERN] [FIELD<NUMBER] [FIELD>=NUMBER] [last 30d] [from TIME] [to TIME]

All conditions have to hold. A pattern is one of the shell's (``*``, ``?``, ``[ab]``), or several with commas
between; large and small letters count alike.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Iterable, Mapping, Sequence
from difflib import get_close_matches
from enum import Enum
from fnmatch import fnmatchcase
from typing import Any, Final

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from recorder.reading.times import date_of
from recorder.review.catalog.rows import INCIDENT, CatalogRow, LoggedDrive, LoggedMoment
from recorder.review.catalog.table import SCHEMA
from recorder.review.timeline.entries import EntryKind
from schemas.decisions import Severity
from schemas.exit_codes import CommandError, ExitCode
from schemas.printable import plain
from schemas.reasons import Reason

UNITS_S: Final = {"s": 1, "min": 60, "h": 3600, "d": 86400, "w": 7 * 86400}
"""The units of ``last``."""

_CONDITION: Final = re.compile(r"([a-z_]+)(!=|<=|>=|=|<|>)(.*)", re.DOTALL)
_SPAN: Final = re.compile(r"(\d+(?:\.\d+)?)([a-z]+)")
_LISTED_MAX: Final = 20
_NS_PER_S: Final = 1_000_000_000
_ALWAYS_NS: Final = 2**63 - 1

Array = Any
"""An array of pyarrow, which has no types."""


class FindSubject(Enum):
    """The part of the catalog that is looked through."""

    MOMENTS = "moments"
    DRIVES = "drives"
    LOGS = "logs"


class FindCondition(msgspec.Struct, frozen=True):
    """A condition: a field, ``=``, ``!=``, ``<``, ``<=``, ``>`` or ``>=``, and a pattern or a number."""

    field: str
    operator: str
    value: str


class FindQuery(msgspec.Struct, frozen=True):
    """A search.

    Attributes:
        kinds: of moments; empty is every kind.
        only_stops: moments with which the robot was commanded no longer, or its gateway died.
        from_ns, to_ns: the time that moments, drives or logs have to reach into, since 1970.
    """

    subject: FindSubject
    conditions: tuple[FindCondition, ...] = ()
    kinds: frozenset[str] = frozenset()
    only_stops: bool = False
    from_ns: int = 0
    to_ns: int = _ALWAYS_NS


class FoundMoment(msgspec.Struct, frozen=True):
    """A moment, and the log that holds it."""

    file: str
    moment: LoggedMoment


class FoundDrive(msgspec.Struct, frozen=True):
    """A drive, and the log that holds it."""

    file: str
    drive: LoggedDrive


FindAnswer = FoundMoment | FoundDrive | CatalogRow

KINDS: Final = (*(kind.value for kind in EntryKind if kind is not EntryKind.REQUEST), INCIDENT)

SUBJECTS: Final[Mapping[str, tuple[FindSubject, frozenset[str]]]] = {
    "log": (FindSubject.LOGS, frozenset()),
    "drive": (FindSubject.DRIVES, frozenset()),
    "event": (FindSubject.MOMENTS, frozenset()),
    **{kind: (FindSubject.MOMENTS, frozenset({kind})) for kind in KINDS},
    "stop": (FindSubject.MOMENTS, frozenset()),
}
"""The words for subjects. A stop is whatever ended the command of a robot, as in a report."""


class _Texts(msgspec.Struct, frozen=True):
    """A field of texts.

    Attributes:
        values: of the rows, and of each the number of its row.
        words: all values that there can be; none if there can be any.
    """

    values: Callable[[pa.Table], tuple[Array, Array]]
    words: tuple[str, ...] = ()


class _Numbers(msgspec.Struct, frozen=True):
    """A field of numbers: those of the rows."""

    values: Callable[[pa.Table], Array]


def _array(table: pa.Table, name: str) -> Array:
    found = table.column(name).combine_chunks()
    return found if isinstance(found, pa.Array) else pa.concat_arrays(found.chunks)


def _text(name: str, *words: str) -> _Texts:
    return _Texts(lambda table: (_array(table, name), np.arange(table.num_rows)), words)


def _number(name: str) -> _Numbers:
    return _Numbers(lambda table: table.column(name))


def _each(name: str, child: str = "", *words: str) -> _Texts:
    """The texts of a list in each row, or those of the structs in it."""

    def values(table: pa.Table) -> tuple[Array, Array]:
        lists = _array(table, name)
        flat = pc.list_flatten(lists)
        return (pc.struct_field(flat, child) if child else flat), pc.list_parent_indices(lists).to_numpy()

    return _Texts(values, words)


def _each_of_map(name: str, *, keys: bool, words: tuple[str, ...] = ()) -> _Texts:
    def values(table: pa.Table) -> tuple[Array, Array]:
        pairs = _array(table, name)
        parents = np.repeat(np.arange(len(pairs)), np.diff(pairs.offsets.to_numpy()))
        begin, end = pairs.offsets[0].as_py(), pairs.offsets[-1].as_py()
        return (pairs.keys if keys else pairs.items)[begin:end], parents

    return _Texts(values, words)


def _length_s(start: str, end: str) -> _Numbers:
    return _Numbers(lambda table: pc.divide(_float(pc.subtract(table.column(end), table.column(start))), 1e9))


def _float(numbers: Array) -> Array:
    return pc.cast(numbers, pa.float64(), safe=False)


_REASONS: Final = tuple(reason.value for reason in Reason)
_SEVERITIES: Final = tuple(severity.value for severity in Severity)
_YES_NO: Final = ("yes", "no")


def _truth(name: str) -> _Texts:
    return _Texts(
        lambda table: (pc.if_else(_array(table, name), *_YES_NO), np.arange(table.num_rows)),
        _YES_NO,
    )


def _count(name: str) -> _Numbers:
    return _Numbers(lambda table: pc.list_value_length(table.column(name)))


FIELDS: Final[Mapping[FindSubject, Mapping[str, _Texts | _Numbers]]] = {
    FindSubject.MOMENTS: {
        "file": _text("file"),
        "robot": _text("robot"),
        "kind": _text("kind", *KINDS),
        "reason": _text("reason", *_REASONS),
        "severity": _text("severity", *_SEVERITIES),
        "operator": _text("operator"),
        "text": _text("text"),
        "count": _number("count"),
    },
    FindSubject.DRIVES: {
        "file": _text("file"),
        "robot": _text("robot"),
        "severity": _text("severity", *_SEVERITIES),
        "text": _text("text"),
        "distance_m": _number("distance_m"),
        "duration_s": _length_s("start_ns", "end_ns"),
        "stops": _number("stops"),
    },
    FindSubject.LOGS: {
        "file": _text("file"),
        "robot": _each("names"),
        "operator": _each("operators", "name"),
        "grant": _each("grants", "id"),
        "reason": _each_of_map("stops", keys=True, words=_REASONS),
        "variant": _each("variants"),
        "version": _each_of_map("versions", keys=False),
        "settings": _each("settings"),
        "whole": _truth("is_whole"),
        "incident": _truth("is_incident"),
        "bytes": _number("bytes"),
        "messages": _number("messages"),
        "duration_s": _length_s("start_ns", "end_ns"),
        "distance_m": _number("distance_m"),
        "moving_s": _number("moving_s"),
        "top_mps": _number("top_mps"),
        "drives": _count("drives"),
        "outages": _number("outages"),
        "refused": _number("refused"),
        "lost": _number("lost"),
        "gap_s": _number("gap_s"),
        "faults": _number("faults"),
    },
}
"""The fields of each subject. What is in a list holds where it does for one of the list."""


def read_words(text: str, now_ns: int) -> FindQuery:
    """Read what is looked for.

    Args:
        text: see the module.
        now_ns: the present, since 1970; ``last`` counts from it.

    Raises:
        CommandError: it cannot be understood; the text says what can.
    """
    try:
        words = iter(shlex.split(text))
    except ValueError as error:
        raise _misunderstood(f"{text!r}: {error}".lower()) from None
    subject: str | None = None
    conditions = []
    from_ns, to_ns = 0, _ALWAYS_NS
    for word in words:
        if match := _CONDITION.fullmatch(word):
            conditions.append(FindCondition(*match.groups()))
        elif word == "last":
            from_ns = max(from_ns, now_ns - _span_ns(next(words, "")))
        elif word == "from":
            from_ns = max(from_ns, _date(word, next(words, "")))
        elif word == "to":
            to_ns = min(to_ns, _date(word, next(words, "")))
        elif word in SUBJECTS and subject is None:
            subject = word
        else:
            raise _meaningless(word, subject)
    if from_ns >= to_ns:
        raise _misunderstood("there is no time between that beginning and that end")
    kind, kinds = SUBJECTS[subject or "log"]
    for one in conditions:
        _check(kind, one, subject or "log")
    return FindQuery(kind, tuple(conditions), kinds, subject == "stop", from_ns, to_ns)


def _misunderstood(text: str) -> CommandError:
    return CommandError(plain(text), ExitCode.USAGE)


def _meaningless(word: str, subject: str | None) -> CommandError:
    if word in SUBJECTS:
        return _misunderstood(f"there are two subjects, {subject} and {word}: give one")
    near = get_close_matches(word, [*SUBJECTS, "last", "from", "to"], 1)
    hint = f"did you mean {near[0]}?" if near else f"a subject is one of {', '.join(SUBJECTS)}"
    return _misunderstood(f"{word!r} is no subject and no condition: {hint}")


def _span_ns(text: str) -> int:
    match = _SPAN.fullmatch(text)
    if match is None or match[2] not in UNITS_S:
        units = ", ".join(UNITS_S)
        raise _misunderstood(f"'last {text}' is no time: give a number and its unit, {units}, as in 30d")
    return int(float(match[1]) * UNITS_S[match[2]] * _NS_PER_S)


def _date(word: str, text: str) -> int:
    time_ns = date_of(text)
    if time_ns is None or not 0 <= time_ns <= _ALWAYS_NS:
        raise _misunderstood(f"'{word} {text}' is no time: give a date, as in 2026-01-02 or 2026-01-02T03:04:05Z")
    return time_ns


def _check(subject: FindSubject, condition: FindCondition, called: str) -> None:
    field = FIELDS[subject].get(condition.field)
    if field is None:
        raise _misunderstood(f"{condition.field!r} is no field of {called}: it has {', '.join(FIELDS[subject])}")
    is_comparison = condition.operator not in {"=", "!="}
    if isinstance(field, _Numbers):
        try:
            float(condition.value)
        except ValueError:
            raise _misunderstood(f"{condition.field} is a number, and {condition.value!r} is none") from None
        return
    if is_comparison:
        raise _misunderstood(f"{condition.field} is a text: give {condition.field}=PATTERN")
    for pattern in condition.value.split(",") if field.words else ():
        if not any(_fits(word, pattern) for word in field.words):
            near = get_close_matches(pattern, field.words, 1)
            hint = f"did you mean {near[0]}?" if near else f"it is one of {', '.join(sorted(field.words))}"
            raise _misunderstood(f"there is no {condition.field} {pattern!r}: {hint}")


def _fits(text: str, pattern: str) -> bool:
    return fnmatchcase(text.lower(), pattern.lower())


def columns_of(query: FindQuery) -> list[str]:
    """The columns of the catalog that an answer needs."""
    if query.subject is FindSubject.LOGS:
        return [field.name for field in SCHEMA if field.name != "moments"]
    return ["file", "is_covered", "names", "faults", query.subject.value]


def find(table: pa.Table, query: FindQuery) -> list[FindAnswer]:
    """Return the answers by their time; what several logs hold once, of the log that comes first.

    Args:
        table: the rows of catalogs, with the columns of ``columns_of``. An incident that the other logs hold
            does not count.
        query: what is looked for.

    Raises:
        CommandError: no log is of a robot that is asked for.
    """
    return _answers(matching(table, query), query)


def newest(table: pa.Table, query: FindQuery, most: int) -> tuple[list[FindAnswer], int]:
    """Return the last answers by their time, and the number of all; see ``find``.

    Args:
        table: the rows of catalogs.
        query: what is looked for.
        most: from so many rows answers are made. What several logs hold is a row for each of them.

    Raises:
        CommandError: no log is of a robot that is asked for.
    """
    rows = matching(table, query)
    return _answers(rows.slice(max(0, rows.num_rows - most)), query), rows.num_rows


def matching(table: pa.Table, query: FindQuery) -> pa.Table:
    """Return the moments, drives or logs of which all conditions hold, by their time, each with its file.

    Raises:
        CommandError: no log is of a robot that is asked for.
    """
    table = table.filter(pc.invert(table.column("is_covered")))
    _check_robots(table, query)
    if query.subject is FindSubject.LOGS:
        return _kept(table, query, "start_ns", "end_ns").sort_by("start_ns")
    if query.subject is FindSubject.DRIVES:
        return _kept(_flat(table, "drives"), query, "start_ns", "end_ns").sort_by("start_ns")
    flat = _flat(table, "moments")
    if query.only_stops:
        flat = flat.filter(flat.column("is_stop"))
    if query.kinds:
        flat = flat.filter(pc.is_in(flat.column("kind"), pa.array(sorted(query.kinds))))
    return _kept(flat, query, "time_ns", "last_ns").sort_by("time_ns")


def _answers(found: pa.Table, query: FindQuery) -> list[FindAnswer]:
    rows = found.to_pylist(maps_as_pydicts="strict")
    if query.subject is FindSubject.LOGS:
        return list(msgspec.convert(rows, list[CatalogRow]))
    if query.subject is FindSubject.DRIVES:
        drives = [FoundDrive(row.pop("file"), msgspec.convert(row, LoggedDrive)) for row in rows]
        return _once(drives, lambda one: one.drive)
    moments = [FoundMoment(row.pop("file"), msgspec.convert(row, LoggedMoment)) for row in rows]
    return _once(moments, lambda one: one.moment)


def _once(found: Iterable[Any], what: Callable[[Any], Any]) -> list[Any]:
    once: dict[Any, Any] = {}
    for one in found:
        once.setdefault(what(one), one)
    return list(once.values())


def _flat(table: pa.Table, name: str) -> pa.Table:
    """A table of the structs of a list column, with the file of each."""
    lists = _array(table, name)
    structs = pc.list_flatten(lists)
    files = _array(table, "file").take(pc.list_parent_indices(lists))
    children = [field.name for field in structs.type]
    return pa.table([files, *structs.flatten()], ["file", *children])


def _kept(table: pa.Table, query: FindQuery, start: str, end: str) -> pa.Table:
    """The rows of which all conditions hold."""
    if query.from_ns or query.to_ns < _ALWAYS_NS:
        is_within = pc.and_(
            pc.greater_equal(table.column(end), query.from_ns), pc.less(table.column(start), query.to_ns)
        )
        table = table.filter(is_within)
    for one in query.conditions:
        table = table.filter(pa.array(_holds(table, FIELDS[query.subject][one.field], one)))
    return table


def _holds(table: pa.Table, field: _Texts | _Numbers, condition: FindCondition) -> Array:
    """Of each row: the condition holds."""
    if isinstance(field, _Numbers):
        compare = _COMPARISONS[condition.operator]
        values = _float(field.values(table))
        return np.asarray(pc.fill_null(compare(values, float(condition.value)), False))  # noqa: FBT003
    values, parents = field.values(table)
    patterns = condition.value.split(",")
    # There are few values, and many rows.
    fitting = [one for one in pc.unique(values).to_pylist() if any(_fits(one, pattern) for pattern in patterns)]
    fits = np.asarray(pc.is_in(values, pa.array(fitting, pa.string())))
    found = np.zeros(table.num_rows, bool)
    found[np.asarray(parents)[fits]] = True
    return ~found if condition.operator == "!=" else found


_COMPARISONS: Final[Mapping[str, Callable[..., Array]]] = {
    "=": pc.equal,
    "!=": pc.not_equal,
    "<": pc.less,
    "<=": pc.less_equal,
    ">": pc.greater,
    ">=": pc.greater_equal,
}


def _check_robots(table: pa.Table, query: FindQuery) -> None:
    """An empty answer would look as if nothing had happened."""
    wanted = [one for one in query.conditions if one.field == "robot" and one.operator == "="]
    if not wanted:
        return
    robots = sorted(pc.unique(pc.list_flatten(_array(table, "names"))).to_pylist())
    for one in wanted:
        for pattern in one.value.split(","):
            if not any(_fits(robot, pattern) for robot in robots):
                raise _misunderstood(f"the logs hold nothing of {pattern}{_but(robots)}")


def _but(robots: Sequence[str]) -> str:
    if not robots:
        return ""
    more = f" and {len(robots) - _LISTED_MAX} more" if len(robots) > _LISTED_MAX else ""
    return f", but of {', '.join(robots[:_LISTED_MAX])}{more}"
