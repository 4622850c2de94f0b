"""``cruiser stop`` and ``cruiser why``: what they print."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any

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


def report(*stopped: str, **named: Any) -> StopReport:  # noqa: ANN401 - the fields of a report
    fields: dict[str, Any] = {"refused": {}, "unconfirmed": {}, "silent": [], "linked": True}
    return StopReport([*stopped], **{**fields, **named})


UNMET = Unmet(Reason.GRANT_EXPIRED, "its grant is over", "renew ROBOT")
BUTTON = "Use the button on the robot"
ROWS: dict[str, tuple[StopReport, ExitCode, str]] = {
    "it stands": (report("cruiser-1"), ExitCode.OK, ""),
    "who else is there was not said": (
        report("cruiser-1", counted=False),
        ExitCode.PARTIAL,
        "there may be more robots: the list of connected robots did not arrive in time",
    ),
    "its stop sequence does not end": (
        report("cruiser-1", unfinished=["cruiser-1"]),
        ExitCode.PARTIAL,
        "cruiser-1: at standstill, but its stop sequence has not ended: 'cruiser why cruiser-1'",
    ),
    "an answer that is not verified: neither a stop nor silence": (
        report(unverified={"cruiser-1": UNMET}),
        ExitCode.PARTIAL,
        f"cruiser-1: REPLY NOT VERIFIED: its grant is over. Cure: renew cruiser-1. {BUTTON}",
    ),
    "it is not seen to stand": (
        report(unconfirmed={"cruiser-1": "it moves"}),
        ExitCode.PARTIAL,
        f"cruiser-1: NOT CONFIRMED STOPPED: it moves. {BUTTON}",
    ),
    "a viewer who stops all may not have reached them": (
        report(silent=["cruiser-1"], reached_all=False),
        ExitCode.UNREACHABLE,
        "cruiser-1: NO REPLY; a viewer's certificate stops one robot at a time: 'cruiser stop cruiser-1'. "
        + BUTTON,
    ),
}


@pytest.mark.parametrize("name", ROWS)
def test_what_came_of_a_stop_is_said_and_is_the_code(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    came, code, said = ROWS[name]

    def stop_from_here(*_: object, told: Callable[[StopReport], None], **__: object) -> StopReport:
        told(came)
        return came

    monkeypatch.setattr(remote_stop, "stop_from_here", stop_from_here)
    try:
        found = run_command(stop, "--all")
    except CommandError as error:
        found = error.code
    stands = "cruiser-1: stopped, latched until a reset\n" if came.stopped else ""
    assert (found, *capsys.readouterr()) == (code, stands, f"{said}\n" if said else "")


def test_events_are_dated_by_the_robots_clock(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    state = msgspec.structs.replace(STANDBY, time_ns=WALL_NS + 3 * SECOND)
    robot = SimpleNamespace(
        name=ROBOT, state=lambda: Sighting(state, 0.5, None, HEALTH), events=lambda: [safety_event(EventKind.STOP)]
    )
    monkeypatch.setattr(why, "connect", lambda *_: nullcontext(robot))
    monkeypatch.setattr(why, "EVENTS_S", 0)
    why.run(argparse.Namespace(json=False), Settings(), lambda: False)
    assert "last events:\n  3.5 s ago: warning: as it were\n" in capsys.readouterr().out
