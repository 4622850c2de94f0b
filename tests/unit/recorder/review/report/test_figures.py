"""The charts of a robot, as plotly wants them."""

from pathlib import Path

import msgspec
import plotly.graph_objects
import pytest

from recorder.review.report.figures import (
    COLOURS,
    MARKS,
    ON_MAP,
    STOP_LINES_MAX,
    band_colours,
    clock,
    hover_text,
    on_map,
    over_time,
    placed,
    shown,
)
from recorder.review.report.findings import RobotCharts
from recorder.review.report.odometry import Place
from recorder.review.timeline.entries import EntryKind
from schemas.decisions import ArbiterState, EventKind
from schemas.messages import Mode
from tests.support.drives import HOSTILE, drive_messages, restart, write_messages
from tests.support.messages import PERIOD_NS, WALL_NS, arbiter, event, state
from tests.support.reading import report_of


def charts_of(tmp_path: Path, *more: object) -> RobotCharts:
    """Of a short drive, and what else is given."""
    messages = [*drive_messages(100), *more]
    return report_of(write_messages(tmp_path / "a.mcap", messages)).robots[0].charts  # type: ignore[arg-type]


def test_plotly_accepts_every_property(tmp_path: Path) -> None:
    """Its own classes know each name and value; a slip would be drawn as nothing."""
    charts = charts_of(tmp_path, *(event(100 + number, kind) for number, kind in enumerate(EventKind)))
    for figure in (on_map(charts), over_time(charts)):
        assert plotly.graph_objects.Figure(figure).data


def test_charts_of_nothing_are_charts() -> None:
    """A robot of which only events are known has no path."""
    bare = RobotCharts({}, {}, [], [], 0, [])
    for figure in (on_map(bare), over_time(bare)):
        plotly.graph_objects.Figure(figure)
    assert placed([])["time_ms"] == []


def test_all_time_charts_share_one_axis(tmp_path: Path) -> None:
    """So that zooming in one zooms in all."""
    figure = over_time(charts_of(tmp_path))
    assert {trace["xaxis"] for trace in figure["data"]} == {"x"}
    assert {trace["yaxis"] for trace in figure["data"]} == {"y", "y2", "y3"}


def test_stops_stand_on_map_and_axis_with_reason_and_operator(tmp_path: Path) -> None:
    """Both say the same, and a line crosses all charts."""
    charts = charts_of(tmp_path, event(50, operator="operator-7"))
    texts = [
        next(trace for trace in figure["data"] if trace["name"] == "stop")["text"]
        for figure in (on_map(charts), over_time(charts))
    ]
    assert texts[0] == texts[1]
    assert "operator: operator-7" in texts[0][0]
    assert "reason: the front bumper was hit" in texts[0][0]
    assert len(over_time(charts)["layout"]["shapes"]) == 2


def test_too_many_stops_are_marks_alone(tmp_path: Path) -> None:
    """Lines across the charts would hide them."""
    many = [event(101 + number) for number in range(STOP_LINES_MAX)]
    assert len(over_time(charts_of(tmp_path, *many[:-1]))["layout"]["shapes"]) == STOP_LINES_MAX
    assert over_time(charts_of(tmp_path, *many))["layout"]["shapes"] == []


def test_every_kind_of_event_is_in_the_legend(tmp_path: Path) -> None:
    """Its symbol is explained below the chart, once."""
    charts = charts_of(tmp_path, *(event(100 + number, kind) for number, kind in enumerate(EventKind)))
    figure = over_time(charts)
    explained = [trace["name"] for trace in figure["data"] if trace.get("legend") == "legend2"]
    assert sorted(explained) == sorted({moment.kind for moment in charts.moments})
    assert all(trace["showlegend"] for trace in figure["data"] if trace.get("legend") == "legend2")
    assert "legend2" in figure["layout"]


def test_a_gateway_that_died_is_shaded_and_marked(tmp_path: Path) -> None:
    """Until another one began; on the map too."""
    (robot,) = report_of(write_messages(tmp_path / "a.mcap", restart(100, 60))).robots
    figure = over_time(robot.charts)
    (shape,) = figure["layout"]["shapes"]
    assert (shape["type"], shape["x0"], shape["x1"]) == (
        "rect",
        round((WALL_NS + 99 * PERIOD_NS) / 1e6, 1),
        round((WALL_NS + 160 * PERIOD_NS) / 1e6, 1),
    )
    for one in (figure, on_map(robot.charts)):
        assert plotly.graph_objects.Figure(one).data
        assert {"gap", "gateway"} <= {trace["name"] for trace in one["data"]}


def test_too_many_outages_are_marks_alone(tmp_path: Path) -> None:
    """As too many stops are."""
    charts = charts_of(tmp_path)
    spans = [(WALL_NS + number, WALL_NS + number + 1) for number in range(STOP_LINES_MAX + 1)]
    for drawn, expected in ((spans, 0), (spans[1:], STOP_LINES_MAX)):
        shapes = over_time(msgspec.structs.replace(charts, outages=drawn))["layout"]["shapes"]
        assert [shape["type"] for shape in shapes].count("rect") == expected


def test_who_held_the_lease_is_told_where_nobody_did_it(tmp_path: Path) -> None:
    """A stop by the bumper is nobody's, and somebody drove."""
    (robot,) = report_of(write_messages(tmp_path / "a.mcap", drive_messages(100))).robots
    stop = next(moment for moment in robot.charts.moments if moment.kind == "stop")
    assert "holder of the lease: operator-1" in hover_text(stop)


def test_what_a_log_says_is_text_to_plotly(tmp_path: Path) -> None:
    """It reads tags and entities; none of the log's are left, and templates are not filled from it."""
    hostile = event(101, text=HOSTILE, operator="%{customdata}<a href='http://evil.test'>")
    holders = [arbiter(101 + number, lease_holder="<b>%{x}</b>") for number in range(3)]
    charts = charts_of(tmp_path, hostile, *holders)
    encoded = msgspec.json.encode([on_map(charts), over_time(charts)]).decode()
    for tag in ("<script", "<img", "<a ", "<b>x", "\u202e"):
        assert tag not in encoded.replace("<b>stop</b>", "")
    assert "&lt;script&gt;" in encoded
    templates = [trace.get("hovertemplate", "") for trace in over_time(charts)["data"]]
    assert not any("%{x}" in template for template in templates)
    assert "%{x}" in encoded


def test_a_broken_path_is_drawn_broken() -> None:
    """And the page finds places by time alone."""
    places = [Place(2, 1.0, 0.0, 0.0, begins=True), Place(3, 2.0, 0.0, 0.0, begins=False)]
    places += [Place(1, 2.0, 0.0, 0.0, begins=True), Place(4_000_000, 3.0, 0.0, 0.0, begins=False)]
    path = on_map(RobotCharts({}, {}, places, [], 0, []))["data"][0]
    assert path["x"] == [1.0, 2.0, None, 2.0, 3.0]
    assert placed(places)["x_m"] == [2.0, 1.0, 2.0, 3.0]
    assert placed(places)["begins"] == [0, 1]


def test_every_state_and_event_has_a_look_of_its_own() -> None:
    """The arbiter's states and the chassis's modes have colours; all kinds of events marks that differ."""
    assert {state.value for state in ArbiterState} <= COLOURS.keys()
    assert {mode.value for mode in Mode if mode is not Mode.UNDEFINED} <= COLOURS.keys()
    in_tables = {EntryKind.REFUSAL, EntryKind.REQUEST}
    assert MARKS.keys() == {kind.value for kind in EntryKind if kind not in in_tables}
    assert len(set(MARKS.values())) == len(MARKS)
    assert not ON_MAP - MARKS.keys()
    assert (
        band_colours(["operator-1", "operator-2"])["operator-1"] != band_colours(["x", "operator-1"])["operator-1"]
    )


def test_bands_have_rows(tmp_path: Path) -> None:
    """A band that had none would be drawn above all others."""
    charts = charts_of(tmp_path, state(101, mode=Mode.STOP))
    axis = over_time(charts)["layout"]["yaxis3"]
    assert set(charts.bands) | {"events"} == set(axis["categoryarray"])
    assert axis["range"] == [-0.5, len(axis["categoryarray"]) - 0.5]


@pytest.mark.parametrize("time_ns", [0, WALL_NS, 2**64])
def test_every_time_has_words(time_ns: int) -> None:
    """MCAP's times reach further than the calendar's."""
    assert clock(time_ns)
    assert shown("a\x1b[31m<b>") == "a\\x1b[31m&lt;b&gt;"
