"""The topics that a recorder writes of a robot, and what they hold."""

from schemas.messages import CanFrame, CanFrames
from schemas.subjects import BY_NAME


def logged_topics(key: str = "fleet/cruiser-1", bus: str = "can0") -> dict[str, type]:
    """By name: the class of their messages."""
    return {
        f"{key}/{name.format(bus=bus)}": CanFrame if subject.type is CanFrames else subject.type
        for name, subject in BY_NAME.items()
    }
