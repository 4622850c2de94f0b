"""What an operator is told instead of success."""

import pytest

from gateway.client.refusal import LeaseLost, Refused, RobotError, Stopped, refused
from schemas.decisions import Reply
from schemas.reasons import Reason


@pytest.mark.parametrize("kind", [Refused, Stopped, LeaseLost])
@pytest.mark.parametrize("reason", Reason)
def test_a_cure_names_the_robot(kind: type[RobotError], reason: Reason) -> None:
    """Whatever the reason: its commands can be copied."""
    error = kind("it does not", reason, robot="cruiser-7")
    assert "ROBOT" not in str(error)
    assert error.cure in str(error)


def test_so_does_that_of_a_reply() -> None:
    """The robot's own words quote commands for any robot."""
    cure = "engage with 'cruiser drive ROBOT'"
    error = refused("cruiser-7", "unpark", Reply(ok=False, reason=Reason.NOT_ENGAGED, detail="", cure=cure))
    assert error.cure == "engage with 'cruiser drive cruiser-7'"
