"""``cruiser gateway`` as it starts again with renewed files."""

from __future__ import annotations

import argparse
from pathlib import Path

import pytest

from gateway.cli import gateway
from gateway.command.carried import Carried
from gateway.host.stop_note import StopNote
from schemas.exit_codes import CommandError, ExitCode
from schemas.settings import GatewaySettings, Settings

TAKEN = CommandError("a gateway of the name cruiser-1 is connected already", ExitCode.REFUSED)


def run(
    monkeypatch: pytest.MonkeyPatch,
    settings: Settings,
    *outcomes: Carried | CommandError | None,
    is_ended: bool = False,
) -> list[object]:
    """Run the command, whose starts end so. Returns what each was given."""
    waiting = iter(outcomes)
    given: list[object] = []

    def run_once(_settings: Settings, _ends: object, former: Carried | None = None) -> Carried | None:
        given.append(former)
        outcome = next(waiting)
        if isinstance(outcome, CommandError):
            raise outcome
        return outcome

    monkeypatch.setattr(gateway, "_run_once", run_once)
    monkeypatch.setattr(gateway, "AGAIN_S", 0.0)
    assert gateway.run(argparse.Namespace(seconds=None), settings, lambda: is_ended) == ExitCode.OK
    assert not list(waiting)
    return given


@pytest.fixture
def settings(tmp_path: Path) -> Settings:
    """With a place for the note."""
    return Settings(gateway=GatewaySettings(state_dir=str(tmp_path)))


def test_each_start_is_given_what_the_one_before_carried_over(
    monkeypatch: pytest.MonkeyPatch, settings: Settings
) -> None:
    """The first nothing."""
    first, second = Carried({"remote_stop": ""}), Carried({"guard": "late"})
    assert run(monkeypatch, settings, first, second, None) == [None, first, second]
    assert not StopNote.of(settings).read()


def test_a_gateway_that_cannot_start_again_tries_on(monkeypatch: pytest.MonkeyPatch, settings: Settings) -> None:
    """Somebody who is in its way while it takes over renewed files does not end it, nor clear what is latched."""
    first, second = Carried({"remote_stop": ""}), Carried()
    given = run(monkeypatch, settings, first, TAKEN, TAKEN, second, TAKEN, None)
    assert given == [None, first, first, first, second, second]


def test_a_first_start_that_fails_ends_the_command(monkeypatch: pytest.MonkeyPatch, settings: Settings) -> None:
    """With one clear line, as ever."""
    with pytest.raises(CommandError, match="connected already"):
        run(monkeypatch, settings, TAKEN, None)


def test_a_gateway_that_is_ended_while_it_cannot_start_again_says_why(
    monkeypatch: pytest.MonkeyPatch, settings: Settings
) -> None:
    """It does not try on for ever."""
    with pytest.raises(CommandError, match="connected already"):
        run(monkeypatch, settings, Carried(), TAKEN, None, is_ended=True)
