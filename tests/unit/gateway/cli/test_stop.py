"""``cruiser stop`` and ``cruiser why``: what they print."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from contextlib import nullcontext
from types import SimpleNamespace

import msgspec
import pytest

from gateway.cli import stop, why
from gateway.client import remote_stop
from gateway.client.link import Sighting
from gateway.client.remote_stop import StopReport, Unverified
from schemas.command_line import CommandError, ExitCode
from schemas.decisions import EventKind
from schemas.settings import Settings
from tests.support.commands import run_command
from tests.support.messages import HEALTH, ROBOT, SECOND, STANDBY, WALL_NS, safety_event


def run(monkeypatch: pytest.MonkeyPatch, report: StopReport, *words: str) -> int:
    """Run the command, whose stop ends so."""

    def stop_from_here(*_: object, told: Callable[[StopReport], None] | None) -> StopReport:
        if told is not None:
            told(report)
        return report

    monkeypatch.setattr(remote_stop, "stop_from_here", stop_from_here)
    return run_command(stop, *words)


@pytest.mark.parametrize(
    ("word", "said"),
    [
        (
            Unverified(stops=True, says="it replied", why="its grant is over", cure="renew ROBOT"),
            (
                "cruiser-1: SAYS THAT IT STOPS, NOT VERIFIED: it replied. This cannot be verified: its grant "
                "is over. Cure: renew cruiser-1. Look at the robot, and use its button if it moves\n"
            ),
        ),
        (
            Unverified(stops=False, says="it moves", why="its grant is over", cure=""),
            (
                "cruiser-1: NOT KNOWN TO STOP, NOT VERIFIED: it moves. This cannot be verified: its grant is over."
                " Use the button on the robot\n"
            ),
        ),
    ],
)
def test_an_answer_that_is_not_verified_is_neither_a_stop_nor_silence(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], word: Unverified, said: str
) -> None:
    """Exit code 3, nothing on stdout, and a line with what it says, why it is not verified, and the cure."""
    report = StopReport([], {}, {}, [], linked=True, unverified={"cruiser-1": word})
    assert run(monkeypatch, report, "cruiser-1") == ExitCode.PARTIAL
    assert capsys.readouterr() == ("", said)


def test_a_viewer_who_stops_all_learns_that_it_may_not_have_reached_them(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """With the command that does, and what is seen of the robot."""
    seen = {"cruiser-1": "its states say: no remote stop is latched, and it moves at 0.40 m/s"}
    report = StopReport([], {}, {}, ["cruiser-1"], linked=True, seen=seen, reached_all=False)
    with pytest.raises(CommandError, match="nobody answered") as error:
        run(monkeypatch, report, "--all")
    assert error.value.code is ExitCode.UNREACHABLE
    assert capsys.readouterr().err == (
        "cruiser-1: NO ANSWER; a viewer's certificate stops one robot at a time: 'cruiser stop cruiser-1'; "
        "its states say: no remote stop is latched, and it moves at 0.40 m/s. Use the button on the robot\n"
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
