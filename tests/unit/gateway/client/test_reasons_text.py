"""The reasons for which a robot does not move, in words."""

import pytest

from gateway.client.refusal import event_line
from schemas.decisions import EventKind, SafetyEvent, Severity
from schemas.reasons import Reason

AT_NS = 1_800_000_000 * 10**9
EVENT = SafetyEvent(AT_NS, 0, 0, Severity.INFO, EventKind.ENGAGED, Reason.NONE, "", "engaged")


@pytest.mark.parametrize(
    ("later_s", "told"),
    [
        (3.24, "3.2 s ago"),
        (-0.05, "0.0 s ago"),
        (-3585.5, "at 08:00:00 UTC by the robot's clock"),
    ],
)
def test_an_event_is_told_by_its_age_or_by_its_clock(later_s: float, told: str) -> None:
    """A moment newer than the state is now; far ahead of it, by a clock that was set back, no age can be told."""
    assert event_line(EVENT, AT_NS + round(later_s * 1e9)) == f"{told}: info: engaged"
