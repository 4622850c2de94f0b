"""The charts of a robot, as data."""

from itertools import accumulate
from pathlib import Path
from typing import Any

import msgspec
import pytest

from recorder.review.entries import EntryKind
from recorder.review.report.findings import BANDS, Drawn, Place, RobotReport
from recorder.review.report.page import (
    COLOURS,
    LINES,
    MARKS,
    STOP_LINES_MAX,
    band_colours,
    clock,
    figures,
    hover_text,
)
from schemas.decisions import ArbiterState, EventKind
from schemas.messages import Mode
from tests.support.drives import HOSTILE, drive_messages, restart, write_messages
from tests.support.messages import MS, PERIOD_NS, WALL_NS, arbiter, event, state
from tests.support.reading import report_of

NOTHING = Drawn(WALL_NS, WALL_NS, None, {}, {}, [], [], [])


def drawn_of(robot: RobotReport) -> dict[str, Any]:
    """Its charts."""
    (drawn,) = robot.drawn
    return figures(robot.summary, drawn)


def robot_of(tmp_path: Path, *more: object) -> RobotReport:
    """Of a short drive, and what else is given."""
    messages = [*drive_messages(100), *more]
    return report_of(write_messages(tmp_path / "a.mcap", messages)).robots[0]  # type: ignore[arg-type]


def with_charts(robot: RobotReport, drawn: Drawn) -> dict[str, Any]:
    """The charts of a robot of which this is known."""
    return figures(robot.summary, drawn)


def line_of(found: dict[str, Any], key: str) -> list[tuple[int, float | None]]:
    """Times, since the robot's first, and values of a line."""
    steps, values = found["lines"][[line.key for line in LINES].index(key)]
    return list(zip((time_ms - found["from_ms"] for time_ms in accumulate(steps)), values, strict=True))


def test_charts_of_nothing_are_charts(tmp_path: Path) -> None:
    """A robot of which only events are known has no path."""
    found = with_charts(robot_of(tmp_path), NOTHING)
    assert found["lines"] == [([], [])] * len(LINES)
    assert found["bands"] == [[]] * len(BANDS)
    assert found["path"]["time_ms"] == []


def test_a_line_has_the_values_of_its_time_and_breaks_off(tmp_path: Path) -> None:
    """Where it breaks there is no value right behind the last one."""
    robot = robot_of(tmp_path)
    begin = robot.summary.start_ns
    points = [(begin, 1.0), (begin + 20 * MS, 1.00049), None, (begin + 900 * MS, 2.0)]
    found = with_charts(robot, msgspec.structs.replace(robot.drawn[0], lines={"speed_mps": points}))
    assert line_of(found, "speed_mps") == [(0, 1.0), (20, 1.0), (21, None), (900, 2.0)]
    assert line_of(found, "angle_deg") == []
    measured = line_of(drawn_of(robot), "speed_mps")
    assert measured[0] == (0, 1.0)
    assert measured[-1][0] == 99 * PERIOD_NS // MS


def test_a_stop_has_its_place_reason_and_operator(tmp_path: Path) -> None:
    """And lines across the charts, as those of all stops."""
    found = drawn_of(robot_of(tmp_path, event(50, operator="operator-7")))
    stop = next(one for one in found["moments"] if one["kind"] == "stop")
    assert "operator: operator-7" in stop["text"].splitlines()
    assert "reason: the front bumper was hit" in stop["text"].splitlines()
    assert stop["at"] is not None
    assert found["stops"] == [stop["ms"]]


def test_too_many_stops_and_outages_are_marks_alone(tmp_path: Path) -> None:
    """Lines and shades across the charts would hide them."""
    engaged = [event(101 + 2 * number, EventKind.ENGAGED) for number in range(STOP_LINES_MAX)]
    many = [one for number, first in enumerate(engaged) for one in (first, event(102 + 2 * number))]
    assert len(drawn_of(robot_of(tmp_path, *many[:-2]))["stops"]) == STOP_LINES_MAX
    robot = robot_of(tmp_path, *many)
    assert not drawn_of(robot)["stops"]
    spans = [(WALL_NS + number, WALL_NS + number + 1) for number in range(STOP_LINES_MAX + 1)]
    for outages, expected in ((spans, 0), (spans[1:], STOP_LINES_MAX)):
        found = with_charts(robot, msgspec.structs.replace(robot.drawn[0], outages=outages))
        assert len(found["outages"]) == expected


def test_a_gateway_that_died_is_shaded_and_marked(tmp_path: Path) -> None:
    """Until another one began."""
    (robot,) = report_of(write_messages(tmp_path / "a.mcap", restart(100, 60))).robots
    found = drawn_of(robot)
    assert found["outages"] == [((WALL_NS + 99 * PERIOD_NS) // MS, (WALL_NS + 160 * PERIOD_NS) // MS)]
    assert {"gap", "gateway"} <= {one["kind"] for one in found["moments"]}


def test_who_held_the_lease_is_told_where_nobody_did_it(tmp_path: Path) -> None:
    """A stop by the bumper is nobody's, and somebody drove."""
    (robot,) = report_of(write_messages(tmp_path / "a.mcap", drive_messages(100))).robots
    stop = next(moment for moment in robot.drawn[0].moments if moment.kind == "stop")
    assert "holder of the lease: operator-1" in hover_text(stop)


def test_what_a_log_says_rules_no_line(tmp_path: Path) -> None:
    """It is shown as text, which the page's tests see; characters that rule the line are written out."""
    hostile = event(101, text=HOSTILE, operator="a\x1b[31m\nb")
    holders = [arbiter(101 + number, lease_holder=HOSTILE) for number in range(3)]
    encoded = msgspec.json.encode(drawn_of(robot_of(tmp_path, hostile, *holders))).decode()
    assert "\u202e" not in encoded
    assert "operator: a\\\\x1b[31m\\\\nb" in encoded


def test_a_broken_path_is_drawn_broken_and_in_its_order(tmp_path: Path) -> None:
    """Though a clock was set back in it."""
    places = [Place(2 * MS, 1.0, 0.0, 0.0, begins=True), Place(3 * MS, 2.0, 0.0, 0.0, begins=False)]
    places += [Place(1 * MS, 2.0, 0.0, 0.0, begins=True), Place(4 * MS, 3.0, 0.0, 0.0, begins=False)]
    path = with_charts(robot_of(tmp_path), msgspec.structs.replace(NOTHING, places=places))["path"]
    assert list(accumulate(path["time_ms"])) == [2, 3, 1, 4]
    assert path["x_m"] == [1.0, 2.0, 2.0, 3.0]
    assert path["begins"] == [0, 2]


def test_every_state_and_event_has_a_look_of_its_own() -> None:
    """The arbiter's states and the chassis's modes have colours; all kinds of events marks that differ."""
    assert {state.value for state in ArbiterState} <= COLOURS.keys()
    assert {mode.value for mode in Mode if mode is not Mode.UNDEFINED} <= COLOURS.keys()
    in_tables = {EntryKind.REFUSAL, EntryKind.REQUEST}
    assert MARKS.keys() == {kind.value for kind in EntryKind if kind not in in_tables}
    assert len(set(MARKS.values())) == len(MARKS)
    assert (
        band_colours(["operator-1", "operator-2"])["operator-1"] != band_colours(["x", "operator-1"])["operator-1"]
    )


def test_bands_have_rows(tmp_path: Path) -> None:
    """One that had none would not be seen."""
    robot = robot_of(tmp_path, state(101, mode=Mode.STOP))
    assert set(robot.drawn[0].bands) <= set(BANDS)
    spans = drawn_of(robot)["bands"][BANDS.index("mode")]
    assert [value for _, _, value, _ in spans] == ["auto", "stop"]


@pytest.mark.parametrize("time_ns", [0, WALL_NS, 2**64])
def test_every_time_has_words(time_ns: int) -> None:
    """MCAP's times reach further than the calendar's."""
    assert clock(time_ns)
