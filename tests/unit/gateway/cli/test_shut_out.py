"""A service whose session does not open. That it waits: tests/system/gateway/cli/test_ended_certificate.py."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from gateway.cli import shut_out
from schemas.command_line import CommandError, ExitCode
from schemas.settings import ZenohSettings
from schemas.zenoh_session import SessionError


@pytest.mark.parametrize(
    "error",
    [
        CommandError("no such thing", ExitCode.USAGE),
        CommandError("the address is taken", ExitCode.UNREACHABLE),
        SessionError("cannot open Zenoh", "Can not create a new TCP listener bound to tcp/127.0.0.1:7447"),
    ],
)
def test_what_no_other_attempt_cures_is_not_waited_for(
    monkeypatch: pytest.MonkeyPatch, error: CommandError
) -> None:
    told: list[str] = []
    manager = SimpleNamespace(alive=told.append, close=lambda: None)
    monkeypatch.setattr(shut_out, "ServiceManager", SimpleNamespace(of=lambda _: manager))
    assert not shut_out.has_waited(error, ZenohSettings(), lambda: False)
    assert told == []
