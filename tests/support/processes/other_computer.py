"""Another computer on the bus, which drives a robot and goes away."""

from gateway.can.open_bus import open_bus
from gateway.chassis.cruiser.bursts import FrameMaker
from gateway.chassis.port import Actuation
from schemas.messages import GearPosition, Variant
from schemas.settings import CanSettings
from tests.support.processes.guard import Listener
from tests.support.waiting import wait_until

DRIVING = Actuation(enabled=True, gear=GearPosition.DRIVE, speed_mps=0.8, parking=False)


def leave_rolling(address: str, listener: Listener) -> None:
    """Another computer drove the robot and went away: it follows the last command for ever."""
    opened = open_bus(CanSettings(interface="socketcand", channel=address))
    maker = FrameMaker()

    def command() -> None:
        frames = maker.make(DRIVING, [], Variant.COARSE)
        for frame in frames:
            opened.send(frame)
        maker.sent(frames)

    try:
        wait_until(lambda: listener.speed_mps() > 0.6, command)
    finally:
        opened.close()
