"""The library's stop: what it raises."""

from types import SimpleNamespace
from typing import Any

import pytest

from gateway.client import remote_stop
from gateway.client.refusal import Refused
from gateway.client.remote_stop import StopReport, Unverified
from gateway.client.robot import Robot
from schemas.command_line import ExitCode
from schemas.reasons import Reason


def test_a_stop_whose_answer_cannot_be_verified_is_not_said_to_be_done(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is an exception with what was answered, why that is not verified, and the cure."""
    word = Unverified(stops=True, says="it replied that it stops", why="it is not signed", cure="see ROBOT")
    report = StopReport([], {}, {}, [], linked=True, unverified={"cruiser-1": word})
    monkeypatch.setattr(remote_stop, "stop", lambda *_, **__: report)
    link: Any = SimpleNamespace(robot="cruiser-1", commands=None, look=list, doubt=None)
    with pytest.raises(Refused, match="cruiser-1 is not known to stop") as refused:
        Robot(link, "ann", "fleet").stop()
    said = refused.value
    assert (said.reason, said.code, said.cure) == (Reason.NOT_CONFIRMED, ExitCode.REFUSED, "see cruiser-1")
    assert said.detail == "it replied that it stops, which cannot be verified: it is not signed"
