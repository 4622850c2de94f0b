"""``cruiser stop`` and ``cruiser why``: what they print."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from contextlib import nullcontext
from types import SimpleNamespace

import msgspec
import pytest

from gateway.authority.session import Unmet
from gateway.cli import stop, why
from gateway.client import remote_stop
from gateway.client.link import Sighting
from gateway.client.remote_stop import StopReport
from schemas.command_line import CommandError, ExitCode
from schemas.decisions import EventKind
from schemas.reasons import Reason
from schemas.settings import Settings
from tests.support.commands import run_command
from tests.support.messages import HEALTH, ROBOT, SECOND, STANDBY, WALL_NS, safety_event


def run(monkeypatch: pytest.MonkeyPatch, report: StopReport, *words: str) -> int:
    def stop_from_here(*_: object, told: Callable[[StopReport], None], **__: object) -> StopReport:
        told(report)
        return report

    monkeypatch.setattr(remote_stop, "stop_from_here", stop_from_here)
    return run_command(stop, *words)


def test_an_answer_that_is_not_verified_is_neither_a_stop_nor_silence(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 3, nothing on stdout, and a line with why it is not verified, and the cure."""
    unmet = Unmet(Reason.GRANT_EXPIRED, "its grant is over", "renew ROBOT")
    report = StopReport([], {}, {}, [], linked=True, unverified={"cruiser-1": unmet})
    assert run(monkeypatch, report, "cruiser-1") == ExitCode.PARTIAL
    said = "cruiser-1: ITS ANSWER CANNOT BE VERIFIED: its grant is over. Cure: renew cruiser-1. Use the button"
    assert capsys.readouterr() == ("", f"{said} on the robot\n")


def test_a_viewer_who_stops_all_learns_that_it_may_not_have_reached_them(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """With the command that does."""
    report = StopReport([], {}, {}, ["cruiser-1"], linked=True, reached_all=False)
    with pytest.raises(CommandError, match="nobody answered") as error:
        run(monkeypatch, report, "--all")
    assert error.value.code is ExitCode.UNREACHABLE
    assert capsys.readouterr().err == (
        "cruiser-1: NO ANSWER; a viewer's certificate stops one robot at a time: 'cruiser stop cruiser-1'. "
        "Use the button on the robot\n"
    )


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
