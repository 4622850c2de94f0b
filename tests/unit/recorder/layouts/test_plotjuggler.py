"""A layout for PlotJuggler."""

from xml.etree.ElementTree import Element, fromstring

import pytest
from msgspec import inspect

from recorder.encoding.protobuf import fields, optional_part
from recorder.layouts.attached import RobotKeys, layouts
from tests.support.messages import logged_topics

NUMBERS = (inspect.IntType, inspect.FloatType, inspect.BoolType)


def layout(robot: RobotKeys) -> Element:
    return fromstring(layouts(robot)[1].data)  # noqa: S314 - our own words


@pytest.mark.parametrize("key", ["fleet/cruiser-1", "depot.1/hall/r-2"])
def test_each_curve_is_a_number_of_a_topic_that_a_recorder_writes(key: str) -> None:
    """Its name is topic and field, as PlotJuggler's parser of protobuf joins them; it plots numbers alone."""
    topics = logged_topics(key)
    curves = [curve.attrib["name"] for curve in layout(RobotKeys(key)).iter("curve")]
    assert len(curves) > 12
    for curve in curves:
        topic, _, field = curve.rpartition("/")
        kinds = {name: kind for name, _, kind in fields(topics[topic])}
        kind = optional_part(kinds[field]) or kinds[field]
        assert isinstance(kind, NUMBERS), curve


def test_it_is_built_as_plotjuggler_builds_it() -> None:
    """root, tabbed_widget, Tab, Container, DockSplitter, DockArea, plot, curve; as many areas as it says."""
    root = layout(RobotKeys("fleet/cruiser-1"))
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
