"""A layout for Foxglove and Lichtblick."""

import json
import re
from typing import Any

import foxglove.layouts
import pytest

from recorder.encoding.protobuf import message_class
from recorder.layouts.attached import RobotKeys, layouts
from recorder.record.actions import DeclareChannel
from schemas.decisions import EventKind
from schemas.keys import parse
from tests.support.logs import Log
from tests.support.messages import logged_topics, safety_event, sample_of

ROBOT = RobotKeys("fleet/cruiser-1", "can0")

CONFIGURATIONS = {
    "Plot": foxglove.layouts.PlotConfig,
    "StateTransitions": foxglove.layouts.StateTransitionsConfig,
    "RosOut": foxglove.layouts.LogConfig,
    "RawMessages": foxglove.layouts.RawMessagesConfig,
    "Table": foxglove.layouts.TableConfig,
}
"""Foxglove's own words for the configuration of each kind of panel."""

PATH = re.compile(r'"(?P<topic>[^"]+)"(?P<fields>(\.\w+)*)(\[:\])?(\.@negative)?')


def layout(robot: RobotKeys = ROBOT) -> dict[str, Any]:
    """As a viewer reads it."""
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
    """A slip in a name would be an empty chart."""
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
    """With words that Foxglove knows, but for the title, which is a panel's own."""
    found = layout()
    assert sorted(leaves(found["layout"])) == sorted(found["configById"])
    for name, configuration in found["configById"].items():
        known = CONFIGURATIONS[name.partition("!")[0]]
        words = json.loads(json.dumps(known()._to_dict(), default=lambda _: None))
        assert configuration.keys() - {"foxglovePanelTitle"} <= words.keys(), name


def test_it_has_what_a_viewer_refuses_to_be_without() -> None:
    """Lichtblick takes no layout that lacks one of these."""
    found = layout()
    assert all(isinstance(found[name], dict) for name in ("configById", "globalVariables", "userNodes"))
    assert isinstance(found["playbackConfig"]["speed"], int)


def test_events_are_listed() -> None:
    """From the topic on which a recorder writes them as foxglove.Log."""
    log = Log()
    log.receive(sample_of(safety_event(EventKind.STOP)))
    declared = {one.channel.topic: one.channel for one in log.done if isinstance(one, DeclareChannel)}
    (panel,) = (value for name, value in layout()["configById"].items() if name.startswith("RosOut"))
    assert declared[panel["topicToRender"]].schema_name == "foxglove.Log"


@pytest.mark.parametrize("bus", ["", 'a"b', "a/b"])
def test_a_bus_that_is_not_known_is_can0(bus: str) -> None:
    """So is a name that is none, which a gateway could make up."""
    assert [path for path in paths(layout(RobotKeys("fleet/cruiser-1", bus))) if "/can/" in path] == [
        '"fleet/cruiser-1/can/can0/rx"'
    ]


def test_a_point_in_a_root_does_not_end_the_topic() -> None:
    """It is quoted."""
    found = paths(layout(RobotKeys("v1.fleet/cruiser-1", "vcan0.100")))
    topics = {match["topic"] for match in map(PATH.fullmatch, found) if match is not None}
    assert len(topics) == 4
    assert all(parse(topic) is not None for topic in topics)
