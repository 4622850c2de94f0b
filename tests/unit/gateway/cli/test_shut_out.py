"""A service whose session does not open: what it waits for, what it says, and when it does not wait."""

from __future__ import annotations

import argparse
from typing import Any

import pytest

from gateway.cli import shut_out
from gateway.cli.shut_out import has_waited, is_service
from schemas.command_line import CommandError, ExitCode
from schemas.settings import ZenohSettings
from schemas.zenoh_session import SessionError

ENDPOINT = "tcp/router.example:7447"
AWAY = SessionError("cannot open Zenoh", f"Unable to connect to any of [Single({ENDPOINT})]")


class World:
    """A service manager, and a router that comes at the attempt of a number; with a knob for each.

    Attributes:
        ends_after: the pauses after which the service is stopped.
    """

    def __init__(self) -> None:
        self.refusals = 0
        self.is_managed = True
        self.told: list[str] = []
        self.tried: list[list[str]] = []
        self.pauses = 0
        self.ends_after = 100

    def of(self, _environment: object) -> World | None:
        return self if self.is_managed else None

    def alive(self, status: str) -> None:
        self.told.append(status)

    def close(self) -> None:
        self.told.append("closed")

    def open_session(self, _zenoh: ZenohSettings, connect: list[str], *_rest: object, **_more: object) -> Any:  # noqa: ANN401 - Zenoh's
        self.tried.append(connect)
        if len(self.tried) <= self.refusals:
            raise AWAY
        return "session"

    def wait(self, _time_s: float, _ends: object) -> None:
        self.pauses += 1

    def ends(self) -> bool:
        return self.pauses >= self.ends_after

    def waits(self, error: CommandError) -> bool:
        return has_waited(error, ZenohSettings(mode="client", connect=[ENDPOINT]), self.ends)


@pytest.fixture
def world(monkeypatch: pytest.MonkeyPatch) -> World:
    """A manager, and a router that is there at once."""
    found = World()
    monkeypatch.setattr(shut_out, "ServiceManager", found)
    monkeypatch.setattr(shut_out, "open_session", found.open_session)
    monkeypatch.setattr(shut_out, "close_session", lambda session: found.told.append(f"{session} closed"))
    monkeypatch.setattr(shut_out, "wait", found.wait)
    return found


def test_a_router_that_is_away_is_waited_for_and_said_once(world: World, caplog: pytest.LogCaptureFixture) -> None:
    """Each attempt feeds the status; the session that opened was only to see, and the status is gone."""
    world.refusals = 3
    assert world.waits(AWAY)
    assert world.tried == [[ENDPOINT]] * 4
    assert world.pauses == 4
    status = f"standby, off the network: {AWAY}"
    assert world.told == [*[status] * 4, "session closed", "", "closed"]
    assert [record.getMessage() for record in caplog.records] == [f"{AWAY}; off the network until then"]
    assert "look at the router" in caplog.text


def test_who_is_stopped_meanwhile_tries_no_more(world: World) -> None:
    """It has waited, and has not failed."""
    world.refusals, world.ends_after = 100, 2
    assert world.waits(AWAY)
    assert world.tried == [[ENDPOINT]] * 2


def test_who_is_not_started_by_a_service_manager_does_not_wait(world: World) -> None:
    """Somebody reads why it ended."""
    world.is_managed = False
    assert not world.waits(AWAY)
    assert world.tried == []


@pytest.mark.parametrize(
    "error",
    [
        CommandError("no such thing", ExitCode.USAGE),
        CommandError("the address is taken", ExitCode.UNREACHABLE),
        SessionError("cannot open Zenoh", "Can not create a new TCP listener bound to tcp/127.0.0.1:7447"),
    ],
)
def test_what_no_other_attempt_cures_is_not_waited_for(world: World, error: CommandError) -> None:
    """Nothing is tried, nothing is said."""
    assert not world.waits(error)
    assert world.tried == []
    assert world.told in ([], ["closed"])


def test_what_somebody_waits_for_is_no_service() -> None:
    """Whoever asks, stops or drives learns at once that nobody answers."""
    plain, acting = argparse.Namespace(), argparse.Namespace(action="start")
    assert all(is_service(name, plain) for name in ("record", "desk", "metrics", "router", "gateway"))
    assert not any(is_service(name, plain) for name in ("list", "why", "stop", "drive", "review"))
    assert not is_service("record", acting)
