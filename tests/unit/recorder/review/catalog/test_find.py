"""The named searches: each condition, with rows that do and do not match."""

from typing import Any

import msgspec
import pytest

from recorder.cli.find import SEARCHES as OFFERED
from recorder.review.catalog.directory import to_table
from recorder.review.catalog.find import SEARCHES, FindConditions, find
from recorder.review.catalog.log_row import CatalogRow, LoggedDrive, LoggedDriver, LoggedMoment, LoggedRobot
from tests.support.messages import SECOND, WALL_NS

ROW = CatalogRow(
    file="a.mcap",
    bytes=1000,
    modified_ns=WALL_NS,
    messages=10,
    start_ns=WALL_NS,
    end_ns=WALL_NS + 60 * SECOND,
    is_whole=True,
    robots=[LoggedRobot("fleet", "cruiser-1")],
    names=["cruiser-1"],
)
"""A log of a minute in which nothing happened."""

TEXT = "stopping: the front bumper was hit"
BUMPER = ("stop", "warning", "front_bumper")
STOP = LoggedMoment(WALL_NS, WALL_NS, "cruiser-1", *BUMPER, "", "alice", count=1, is_stop=True, text=TEXT)
DRIVE = LoggedDrive(WALL_NS, WALL_NS + 10 * SECOND, "cruiser-1", 12.5, 0.0, 1, 0, "warning", TEXT)


def row(**changes: Any) -> CatalogRow:  # noqa: ANN401 - any field of a row
    return msgspec.structs.replace(ROW, **changes)


def moment(at_s: int, **changes: Any) -> LoggedMoment:  # noqa: ANN401 - any field of a moment
    time_ns = WALL_NS + at_s * SECOND
    return msgspec.structs.replace(STOP, **{"time_ns": time_ns, "last_ns": time_ns, **changes})


def found(search: str, rows: list[CatalogRow], **conditions: Any) -> list[dict[str, Any]]:  # noqa: ANN401 - any
    return find(to_table(rows).select(list(SEARCHES[search].columns)), search, FindConditions(**conditions))


MOMENTS = [
    moment(1),
    moment(2, last_ns=WALL_NS + 9 * SECOND, kind="fault", reason="deadman", holder="", is_stop=False),
    moment(3, robot="mule", kind="incident", reason="none", is_stop=False),
    moment(4, robot="mule", kind="gateway", reason="none", operator="bob"),
]


@pytest.mark.parametrize(
    ("search", "conditions", "seconds"),
    [
        ("events", {}, [1, 2, 3, 4]),
        ("stops", {}, [1, 4]),
        ("incidents", {}, [3]),
        ("events", {"robots": ["mule"]}, [3, 4]),
        ("events", {"robots": ["cruiser-1", "mule"]}, [1, 2, 3, 4]),
        ("events", {"robots": []}, []),
        ("events", {"reason": "deadman"}, [2]),
        ("stops", {"reason": "deadman"}, []),
        ("events", {"operator": "bob"}, [4]),
        ("stops", {"operator": "alice"}, [1, 4]),
        ("events", {"operator": "bo%"}, []),
        ("events", {"operator": "' OR true --"}, []),
        ("events", {"since_ns": WALL_NS + 3 * SECOND}, [2, 3, 4]),
        ("events", {"until_ns": WALL_NS + 3 * SECOND}, [1, 2]),
    ],
)
def test_each_condition_on_what_happened(search: str, conditions: dict[str, Any], seconds: list[int]) -> None:
    """No text of a condition is part of the statement."""
    rows = [row(names=["cruiser-1", "mule"], moments=MOMENTS)]
    assert [one["time_ns"] for one in found(search, rows, **conditions)] == [
        WALL_NS + at * SECOND for at in seconds
    ]


@pytest.mark.parametrize(
    ("conditions", "files"),
    [
        ({}, ["a.mcap", "b.mcap"]),
        ({"robots": ["mule"]}, ["b.mcap"]),
        ({"reason": "front_bumper"}, ["a.mcap"]),
        ({"operator": "alice"}, ["a.mcap"]),
        ({"since_ns": WALL_NS + 61 * SECOND}, ["b.mcap"]),
        ({"until_ns": WALL_NS + 61 * SECOND}, ["a.mcap"]),
    ],
)
@pytest.mark.parametrize("search", ["drives", "logs"])
def test_each_condition_on_drives_and_logs(search: str, conditions: dict[str, Any], files: list[str]) -> None:
    start_ns = WALL_NS + 100 * SECOND
    drivers = [LoggedDriver("cruiser-1", "alice", 1.0, 2.0)]
    later = msgspec.structs.replace(DRIVE, robot="mule", start_ns=start_ns, end_ns=start_ns + SECOND)
    rows = [
        row(drives=[DRIVE], moments=[moment(1), moment(99)], operators=drivers, stops={"front_bumper": 1}),
        row(file="b.mcap", names=["mule"], start_ns=start_ns, end_ns=start_ns + SECOND, drives=[later]),
    ]
    assert [one["file"] for one in found(search, rows, **conditions)] == files


def test_a_drive_is_of_its_own_robot_s_operators_and_stops() -> None:
    mule = msgspec.structs.replace(DRIVE, robot="mule")
    drivers = [LoggedDriver("cruiser-1", "alice", 1.0, 2.0), LoggedDriver("mule", "bob", 1.0, 2.0)]
    moments = [moment(1), moment(2, robot="mule", reason="deadman")]
    rows = [row(drives=[DRIVE, mule], moments=moments, operators=drivers)]
    for condition in ({"operator": "alice"}, {"reason": "front_bumper"}):
        assert [one["robot"] for one in found("drives", rows, **condition)] == ["cruiser-1"]


def test_what_several_logs_hold_is_one_answer_and_a_covered_incident_none() -> None:
    later = row(file="a-later.mcap", start_ns=WALL_NS + 1, moments=[STOP], drives=[DRIVE])
    first = row(file="b-first.mcap", moments=[STOP], drives=[DRIVE])
    covered = row(file="c.mcap", is_covered=True, moments=[moment(7)])
    for search in ("stops", "drives"):
        assert [one["file"] for one in found(search, [later, first, covered])] == ["b-first.mcap"]
    assert len(found("logs", [later, first, covered])) == 2


def test_the_newest_are_the_last_ones_and_nothing_is_found_in_nothing() -> None:
    columns = list(SEARCHES["events"].columns)
    rows = to_table([row(moments=MOMENTS)]).select(columns)
    assert [one["kind"] for one in find(rows, "events", FindConditions(), 2)] == ["incident", "gateway"]
    for search in SEARCHES:
        assert found(search, []) == []


def test_a_log_is_answered_with_all_but_its_moments() -> None:
    (answer,) = found("logs", [row(stops={"deadman": 2}, distance_m=float("inf"), lost=None)])
    assert answer == {
        name: value
        for name, value in msgspec.to_builtins(row(stops={"deadman": 2}, distance_m=float("inf"))).items()
        if name != "moments"
    }
    assert answer["file"] == ROW.file


def test_the_command_offers_every_search() -> None:
    assert set(OFFERED) == set(SEARCHES)
