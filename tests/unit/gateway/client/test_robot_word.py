"""Robots in one line: so many of each word."""

import msgspec

from gateway.client.fleet import ALARM, FINE, LOOK, WORDS, RobotStatus, summary
from schemas.decisions import ArbiterState
from schemas.messages import Mode
from schemas.reasons import Reason
from tests.support.messages import HEALTH, STANDBY, STATE

AUTO = msgspec.structs.replace(STATE, mode=Mode.AUTO, bus_up=True, speed_mps=0.5, silent=[])
DRIVING = RobotStatus(
    robot="cruiser-1",
    connected=True,
    state=AUTO,
    state_age_s=0.05,
    health=HEALTH,
    health_age_s=0.5,
    unreadable="",
    linked=True,
    safety=msgspec.structs.replace(STANDBY, state=ArbiterState.ENGAGED, engaged=True, latched=[]),
)
LATCHED = msgspec.structs.replace(
    DRIVING, safety=msgspec.structs.replace(STANDBY, latched=[Reason.REMOTE_STOP], engaged=False)
)
BUS_DOWN = msgspec.structs.replace(DRIVING, state=msgspec.structs.replace(AUTO, bus_up=False))
SILENT = msgspec.structs.replace(DRIVING, state=None, state_age_s=9.0)
NEW = msgspec.structs.replace(DRIVING, state=None, state_age_s=None)
MUTE = msgspec.structs.replace(NEW, health=None)


def test_a_thousand_robots_are_read_in_one_line() -> None:
    """So many of each word; those that need a person stand at the end."""
    robots = [DRIVING] * 1000 + [NEW, MUTE, SILENT, BUS_DOWN, LATCHED]
    assert summary(robots) == "1000 driving, 1 bus down, 1 needs reset, 3 offline"


def test_the_words_are_in_the_order_of_their_levels() -> None:
    """So that what needs a person is not behind what is fine."""
    levels = list(WORDS.values())
    assert levels == sorted(levels, reverse=True)
    assert set(levels) == {FINE, LOOK, ALARM}
