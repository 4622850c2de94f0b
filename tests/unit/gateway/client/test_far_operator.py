"""Row 'travel delay': a robot behind a bad link, driven by the library's stream, in simulated time."""

import pytest

from schemas.decisions import ArbiterState
from schemas.reasons import TEXTS, Reason
from tests.support.links import LINKS, LinkProfile
from tests.support.nights import by_night
from tests.support.rigs.far_operator import FarOperator, LossyLink, trip
from tests.support.rigs.gateway import GatewayRig

BY_DAY = ("Wi-Fi", "LTE bad")  # a link that stalls often, and one that loses much too


@pytest.mark.parametrize(
    "profile",
    [profile if profile.name in BY_DAY else by_night(profile) for profile in LINKS],
    ids=lambda profile: profile.name,
)
def test_every_link_of_the_table_can_be_driven_over(profile: LinkProfile) -> None:
    """One late command lowers the limit for 300 ms, and then the robot only speeds up again."""
    made = trip(profile, speed_mps=2.2, seconds=12)
    assert made.moving >= 0.85
    assert made.stops == []
    braking_m = made.reached_mps**2 / (2 * 1.2)
    assert made.after_cut_m <= 1.0 + braking_m + 0.1


def test_a_link_that_is_too_slow_is_not_engaged_over() -> None:
    rig = GatewayRig()
    operator = FarOperator(rig, LossyLink(LinkProfile("moon", 0.6), 1), 0.5)
    operator.run(20)
    engages = [one for one in rig.decided if one.request == "engage"]
    assert len(engages) > 2
    assert {one.reason for one in engages} == {Reason.LINK_TOO_SLOW}
    assert all(one.detail.startswith(TEXTS[Reason.LINK_TOO_SLOW].means) for one in engages)
    assert rig.speed_mps == 0


def test_a_link_that_becomes_too_slow_stops_the_robot_and_the_library_says_why() -> None:
    rig, link = GatewayRig(), LossyLink(LinkProfile("LAN", 0.001), 1)
    operator = FarOperator(rig, link, 0.5)
    operator.run(5)
    assert rig.says.engaged
    link.profile = LinkProfile("moon", 0.6)
    operator.run(3)
    assert rig.says.state is not ArbiterState.ENGAGED
    ending = operator.endings[0]
    assert ending.reason is Reason.DEADMAN
    assert ending.detail.startswith(TEXTS[Reason.DEADMAN].means)
