import pytest

from gateway.choice import CHASSIS
from gateway.command.flow import CommandFlow
from gateway.guard.stopper import GuardView
from gateway.host.guard_process import start_guard
from schemas.settings import CanSettings, GatewaySettings, Settings


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        (Settings(can=CanSettings(interface="virtual")), "virtual"),
        (Settings(can=CanSettings(interface="pcan")), "pcan"),
        (Settings(gateway=GatewaySettings(listen_only=True)), "only listens"),
    ],
)
def test_where_no_guard_can_be_the_link_says_why(settings: Settings, says: str) -> None:
    """An interface that is not known to be shared has no guard, nor has a gateway that sends nothing."""
    link = start_guard(settings)
    assert says in link.why_not
    link.beat(1, CommandFlow(CHASSIS, settings, 1))
    link.close()
    assert link.look() == GuardView()
