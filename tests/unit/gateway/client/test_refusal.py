"""Refusals and reasons, in words."""

import pytest

from gateway.client.refusal import LeaseLost, Refused, RobotError, Stopped, event_line, refused
from schemas.decisions import EventKind, Reply, SafetyEvent, Severity
from schemas.reasons import TEXTS, Reason


@pytest.mark.parametrize("kind", [Refused, Stopped, LeaseLost])
@pytest.mark.parametrize("reason", Reason)
def test_a_cure_names_the_robot(kind: type[RobotError], reason: Reason) -> None:
    """Whatever the reason: its commands can be copied."""
    error = kind("it does not", reason, robot="cruiser-7")
    assert "ROBOT" not in str(error)
    assert error.cure in str(error)


def test_so_does_that_of_a_reply() -> None:
    """The robot's own words quote commands for any robot."""
    cure = "ask at ROBOT"
    error = refused("cruiser-7", "unpark", Reply(ok=False, reason=Reason.NOT_ENGAGED, detail="", cure=cure), "ann")
    assert error.cure == "ask at cruiser-7"


def test_another_session_of_the_same_person_is_called_so() -> None:
    """By ann, to ann, would say nothing."""
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
    """A moment newer than the state is now; far ahead of it, by a clock that was set back, no age can be told."""
    assert event_line(EVENT, AT_NS + round(later_s * 1e9)) == f"{told}: info: engaged"
