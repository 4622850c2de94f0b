"""Refusals and reasons as texts."""

import pytest

from gateway.client.refusal import LeaseLost, Refused, RobotError, Stopped, event_line, refused
from schemas.decisions import EventKind, Reply, SafetyEvent, Severity
from schemas.reasons import TEXTS, Reason


@pytest.mark.parametrize("kind", [Refused, Stopped, LeaseLost])
@pytest.mark.parametrize("reason", Reason)
def test_a_cure_names_the_robot(kind: type[RobotError], reason: Reason) -> None:
    error = kind("it does not", reason, robot="cruiser-7")
    assert "ROBOT" not in str(error)
    assert error.cure in str(error)


def test_another_session_of_the_same_person_is_called_so() -> None:
    means = TEXTS[Reason.LEASE_HELD].means
    held = Reply(ok=False, reason=Reason.LEASE_HELD, detail=f"{means}; by ann, expires in 1.9 s", cure="")
    said = refused("cruiser-7", "acquire", held, "ann")
    assert "another session of ann holds the lease; it expires in 1.9 s" in str(said)
    assert "by ann, expires" in str(refused("cruiser-7", "acquire", held, "bob"))


AT_NS = 1_800_000_000 * 10**9
EVENT = SafetyEvent(AT_NS, 0, 0, Severity.INFO, EventKind.ENGAGED, Reason.NONE, "", "engaged")


@pytest.mark.parametrize(
    ("later_s", "told"),
    [(3.24, "3.2 s ago"), (-0.05, "0.0 s ago"), (-3585.5, "at 08:00:00 UTC by the robot's clock")],
)
def test_an_event_is_told_by_its_age_or_by_its_clock(later_s: float, told: str) -> None:
    assert event_line(EVENT, AT_NS + round(later_s * 1e9)) == f"{told}: info: engaged"
