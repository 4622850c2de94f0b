"""The infos of robots."""

from itertools import pairwise

import msgspec
import pytest

from recorder.record import robots as robots_module
from recorder.record.actions import LogAction, Query, WriteAttachment, WriteMetadata
from recorder.record.robots import ASK_AGAIN_MAX_NS, ASK_AGAIN_NS, Robots
from schemas.messages import Variant
from tests.support.messages import SECOND, WALL_NS, info

KEY = "fleet/cruiser-1/gateway/info"
ANYBODY = {"recorder_version": "1.0", "robots": ""}
LAYOUTS = ["cruiser-1/layout.foxglove.json", "cruiser-1/layout.plotjuggler.xml"]


def seen() -> Robots:
    robots = Robots("x", "1.0")
    robots.see("fleet", "cruiser-1", 0)
    return robots


def names(effects: list[LogAction]) -> list[str]:
    return [one.name for one in effects if isinstance(one, WriteAttachment)]


def test_a_new_robot_is_asked_at_once_and_again_ever_more_rarely() -> None:
    robots = seen()
    asked = [now for now in range(0, 400 * SECOND, SECOND // 10) if robots.queries(now) == [Query(KEY)]]
    pauses = [later - earlier for earlier, later in pairwise(asked)]
    assert asked[0] == 0
    assert pauses[0] == ASK_AGAIN_NS
    assert pauses == sorted(pauses)
    assert pauses[-1] == ASK_AGAIN_MAX_NS


def test_robots_beyond_the_limit_are_neither_asked_nor_described(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(robots_module, "ROBOT_LIMIT", 2)
    robots = Robots("x", "1.0")
    assert [robots.see("fleet", f"r{number}", 0) for number in (0, 1, 2, 0)] == ["r0", "r1", "r2", "r0"]
    assert robots.queries(0) == [Query(f"fleet/r{number}/gateway/info") for number in (0, 1)]
    assert robots.receive_info("r2", info(), WALL_NS) == []
    robots.see_restart("r2", 0)
    assert robots.describe() == [
        WriteMetadata("x", "cruiser", {"recorder_version": "1.0", "robots": "r0,r1"}, lasts=True)
    ]


def test_an_answer_becomes_metadata_and_attachments() -> None:
    robots = seen()
    robots.queries(0)
    effects = robots.receive_info("cruiser-1", info(), WALL_NS)
    assert names(effects) == ["cruiser-1/configuration.toml", "cruiser-1/cruiser-coarse.dbc", *LAYOUTS]
    *_, metadata, device = effects
    assert isinstance(metadata, WriteMetadata)
    assert device == WriteMetadata("x", "foxglove", {"deviceName": "cruiser-1"}, lasts=True)
    assert metadata.entries == {
        "recorder_version": "1.0",
        "robots": "cruiser-1",
        "cruiser-1.variant": "coarse",
        "cruiser-1.bus": "can0",
        "cruiser-1.started_ns": str(WALL_NS - SECOND),
        "cruiser-1.configuration_sha256": "ab" * 32,
        "cruiser-1.versions.cruiser-gateway": "0.1.0",
    }
    robots.ask_last(10**15)
    assert robots.queries(10**15) == []
    assert robots.describe() == []


def test_a_robot_whose_variant_is_unknown_is_asked_again() -> None:
    robots = seen()
    robots.queries(0)
    first = robots.receive_info("cruiser-1", info(Variant.UNKNOWN, dbc=""), WALL_NS)
    assert names(first) == ["cruiser-1/configuration.toml", *LAYOUTS]
    assert robots.queries(1) == []
    robots.ask_last(1)
    assert robots.queries(1, 0) == []
    assert robots.queries(1) == [Query(KEY)]
    assert names(robots.receive_info("cruiser-1", info(), WALL_NS)) == ["cruiser-1/cruiser-coarse.dbc"]


def test_layouts_are_those_of_the_robot_and_its_bus() -> None:
    robots = Robots("x", "1.0")
    robots.see("depot/hall-2", "cruiser-1", 0)
    effects = robots.receive_info("cruiser-1", info(), WALL_NS)
    layout = next(one for one in effects if isinstance(one, WriteAttachment) and one.name == LAYOUTS[0])
    assert b"depot/hall-2/cruiser-1/can/can0/rx" in layout.data
    other = msgspec.structs.replace(info(), bus="can1")
    assert names(robots.receive_info("cruiser-1", other, WALL_NS)) == LAYOUTS
    assert names(robots.receive_info("cruiser-1", other, WALL_NS)) == []


def test_a_gateway_that_began_anew_is_asked_again() -> None:
    robots = seen()
    robots.receive_info("cruiser-1", info(), WALL_NS)
    robots.see_restart("cruiser-1", 5)
    assert robots.queries(5) == []
    robots.see_restart("cruiser-1", 6)
    assert robots.queries(ASK_AGAIN_NS) == [Query(KEY)]
    assert robots.receive_info("cruiser-1", info(), WALL_NS) == []


def test_robots_of_one_name_under_two_roots_are_told_apart() -> None:
    robots = seen()
    assert robots.see("other/base", "cruiser-1", 0) == "other/base/cruiser-1"
    assert robots.see("fleet", "cruiser-1", 0) == "cruiser-1"
    assert robots.queries(0) == [Query(KEY), Query("other/base/cruiser-1/gateway/info")]


def test_a_log_is_filed_under_its_robot_as_long_as_it_has_but_one() -> None:
    """Foxglove reads the last record of the name; for several robots it is empty."""
    robots = Robots("x", "1.0")
    assert [one for one in robots.describe() if one != WriteMetadata("x", "cruiser", ANYBODY, lasts=True)] == []
    robots.see("fleet", "cruiser-1", 0)
    assert robots.describe()[-1] == WriteMetadata("x", "foxglove", {"deviceName": "cruiser-1"}, lasts=True)
    robots.see("fleet", "cruiser-2", 0)
    assert robots.describe()[-1] == WriteMetadata("x", "foxglove", {}, lasts=True)
