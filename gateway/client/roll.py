"""Which robots are connected, for who named one that is not."""

from __future__ import annotations

import time
from typing import Final

from gateway.zenoh.operator import CommandPort
from schemas import keys
from schemas.operator_name import login_operator
from schemas.settings import Settings

ROLL_S: Final = 1.0
"""How long robots are looked for: nodes find each other by gossip in less."""

NAMES_SHOWN: Final = 10

POLL_S: Final = 0.02


def who_is_there(settings: Settings, robot: str) -> str:
    """The end of a message that this robot was not found: those that are connected. Empty if it is one of them.

    Raises:
        CommandError: an endpoint is not of its form.
    """
    there: set[str] = set()
    deadline_s = time.monotonic() + ROLL_S
    with CommandPort.open(settings, keys.ALL, login_operator()) as port:
        while time.monotonic() < deadline_s:
            question = port.call_roll(max(POLL_S, deadline_s - time.monotonic()))
            while not question.is_over and time.monotonic() < deadline_s:
                found = (keys.robot_of_liveliness(settings.robot.root, one.key) for one in question.poll())
                there.update(name for name in found if name)
                time.sleep(POLL_S)
        if robot in there or not port.connected():
            return ""
    names = sorted(there)
    more = f" and {len(names) - NAMES_SHOWN} more" if len(names) > NAMES_SHOWN else ""
    return f"; connected: {', '.join(names[:NAMES_SHOWN])}{more}" if names else "; no robot is connected"
