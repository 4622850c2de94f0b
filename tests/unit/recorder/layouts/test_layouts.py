"""The layouts that a recorder attaches to each log: for Foxglove and Lichtblick, and for PlotJuggler."""

import json
import re
from typing import Any
from xml.etree.ElementTree import Element, fromstring

import foxglove.layouts
import pytest
from msgspec import inspect

from recorder.encoding.protobuf import fields, message_class, optional_part
from recorder.encoding.viewers import OUTLINES, TRANSFORMS, outline_record, transform_record
from recorder.layouts.attached import COUNT, RobotKeys, layouts
from recorder.record.actions import DeclareChannel
from schemas.decisions import EventKind
from schemas.keys import parse
from schemas.messages import Odometry
from tests.support.logs import Log
from tests.support.messages import logged_topics, safety_event, sample_of

ROBOT = RobotKeys("fleet/cruiser-1", "can0")

CONFIGURATIONS = {
    "Plot": foxglove.layouts.PlotConfig,
    "StateTransitions": foxglove.layouts.StateTransitionsConfig,
    "RosOut": foxglove.layouts.LogConfig,
    "RawMessages": foxglove.layouts.RawMessagesConfig,
    "Table": foxglove.layouts.TableConfig,
    "3D": foxglove.layouts.ThreeDeeConfig,
}
"""Foxglove's own words for the configuration of each kind of panel."""

TITLES = {"foxglovePanelTitle", "lichtblickPanelTitle"}

PATH = re.compile(r'"(?P<topic>[^"]+)"(?P<fields>(\.\w+)*)(\[:\])?(\.@negative)?')


def layout(robot: RobotKeys = ROBOT) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(layouts(robot)[0].data)
    return found


def paths(found: Any) -> list[str]:  # noqa: ANN401 - a part of JSON
    if isinstance(found, dict):
        own = [found[key] for key in ("value", "topicPath") if key in found]
        return own + [path for value in found.values() for path in paths(value)]
    return [path for one in found for path in paths(one)] if isinstance(found, list) else []


def leaves(split: str | dict[str, Any]) -> list[str]:
    if isinstance(split, str):
        return [split]
    assert split["direction"] in {"row", "column"}
    assert 0 < split["splitPercentage"] < 100
    return leaves(split["first"]) + leaves(split["second"])


def test_each_path_leads_to_a_field_of_a_topic_that_a_recorder_writes() -> None:
    topics = logged_topics()
    found = paths(layout())
    assert len(found) > 15
    for path in found:
        match = PATH.fullmatch(path)
        assert match is not None, path
        message = message_class(topics[match["topic"]])()
        for field in filter(None, match["fields"].split(".")):
            assert field in message.DESCRIPTOR.fields_by_name, path


def test_every_panel_is_arranged_once_and_of_a_kind_that_viewers_know() -> None:
    found = layout()
    assert sorted(leaves(found["layout"])) == sorted(found["configById"])
    for name, configuration in found["configById"].items():
        known = CONFIGURATIONS[name.partition("!")[0]]
        words = json.loads(json.dumps(known()._to_dict(), default=lambda _: None))
        titles = {word: title for word, title in configuration.items() if word in TITLES}
        assert configuration.keys() - titles.keys() <= words.keys(), name
        assert not titles or titles.keys() == TITLES, f"{name}: each viewer reads a title of its own"
        assert len(set(titles.values())) <= 1, name


def test_it_has_what_a_viewer_refuses_to_be_without() -> None:
    """Lichtblick accepts no layout without these."""
    found = layout()
    assert all(isinstance(found[name], dict) for name in ("configById", "globalVariables", "userNodes"))
    assert isinstance(found["playbackConfig"]["speed"], int)


def test_events_are_listed() -> None:
    log = Log()
    log.receive(sample_of(safety_event(EventKind.STOP)))
    declared = {one.channel.topic: one.channel for one in log.done if isinstance(one, DeclareChannel)}
    (panel,) = (value for name, value in layout()["configById"].items() if name.startswith("RosOut"))
    assert declared[panel["topicToRender"]].schema_name == "foxglove.Log"


def test_the_robot_is_drawn_in_its_frames() -> None:
    key = "fleet/cruiser-1/chassis/odometry"
    panel = layout()["configById"]["3D!robot"]
    transform = TRANSFORMS.message.FromString(transform_record(Odometry(0, 0, *[0.0] * 11), ROBOT.key))
    scene = OUTLINES.message.FromString(outline_record(0, ROBOT.key))
    assert list(panel["topics"]) == [f"{key}/{OUTLINES.chunk}"]
    assert panel["followTf"] == transform.child_frame_id == scene.entities[0].frame_id
    assert panel["layers"]["grid"]["frameId"] == transform.parent_frame_id


@pytest.mark.parametrize("bus", ["", 'a"b', "a/b"])
def test_a_bus_that_is_not_known_is_can0(bus: str) -> None:
    assert [path for path in paths(layout(RobotKeys("fleet/cruiser-1", bus))) if "/can/" in path] == [
        '"fleet/cruiser-1/can/can0/rx"'
    ]


def test_a_point_in_a_root_does_not_end_the_topic() -> None:
    found = paths(layout(RobotKeys("v1.fleet/cruiser-1", "vcan0.100")))
    topics = {match["topic"] for match in map(PATH.fullmatch, found) if match is not None}
    assert len(topics) == 4
    assert all(parse(topic) is not None for topic in topics)


def test_they_are_few_and_small_and_always_the_same() -> None:
    made = layouts(ROBOT)
    assert len(made) == len({layout.name for layout in made}) == COUNT
    assert sum(len(layout.data) for layout in made) < 16_000
    assert made == layouts(ROBOT)


def plots(robot: RobotKeys) -> Element:
    return fromstring(layouts(robot)[1].data)  # noqa: S314 - our own words


@pytest.mark.parametrize("key", ["fleet/cruiser-1", "depot.1/hall/r-2"])
def test_each_curve_is_a_number_of_a_topic_that_a_recorder_writes(key: str) -> None:
    topics = logged_topics(key)
    curves = [curve.attrib["name"] for curve in plots(RobotKeys(key)).iter("curve")]
    assert len(curves) > 12
    for curve in curves:
        topic, _, field = curve.rpartition("/")
        kinds = {name: kind for name, _, kind in fields(topics[topic])}
        kind = optional_part(kinds[field]) or kinds[field]
        assert isinstance(kind, inspect.IntType | inspect.FloatType | inspect.BoolType), curve


def test_plots_are_built_as_plotjuggler_builds_it() -> None:
    """root, tabbed_widget, Tab, Container, DockSplitter, DockArea, plot, curve."""
    root = plots(RobotKeys("fleet/cruiser-1"))
    assert root.tag == "root"
    (tabs,) = root.findall("tabbed_widget")
    assert tabs.attrib == {"parent": "main_window", "name": "Main Window"}
    for tab in tabs.findall("Tab"):
        (splitter,) = tab.findall("Container/DockSplitter")
        areas = splitter.findall("DockArea")
        shares = [float(share) for share in splitter.attrib["sizes"].split(";")]
        assert int(splitter.attrib["count"]) == len(areas) == len(shares) > 1
        assert sum(shares) == pytest.approx(1, abs=1e-3)
        assert all(len(area.findall("plot")) == 1 for area in areas)
        assert all(area.find("plot/curve") is not None for area in areas)
    assert tabs.find("currentTabIndex") is not None
