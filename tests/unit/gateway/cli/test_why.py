"""``cruiser why``: what it prints."""

import argparse
from contextlib import nullcontext
from types import SimpleNamespace

import msgspec
import pytest

from gateway.cli import why
from gateway.client.link import Sighting
from schemas.decisions import EventKind
from schemas.settings import Settings
from tests.support.messages import HEALTH, ROBOT, SECOND, STANDBY, WALL_NS, safety_event


def test_events_are_dated_by_the_robots_clock(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """It need not be that of the machine on which somebody asks."""
    state = msgspec.structs.replace(STANDBY, time_ns=WALL_NS + 3 * SECOND)
    robot = SimpleNamespace(
        name=ROBOT,
        state=lambda: Sighting(state, 0.5, None, HEALTH),
        events=lambda: [safety_event(EventKind.STOP)],
    )
    monkeypatch.setattr(why, "connect", lambda *_: nullcontext(robot))
    monkeypatch.setattr(why, "EVENTS_S", 0)
    why.run(argparse.Namespace(json=False), Settings(), lambda: False)
    assert "lately:\n  3.5 s ago: warning: as it were\n" in capsys.readouterr().out
