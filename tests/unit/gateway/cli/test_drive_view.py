import msgspec

from gateway.cli.drive import BINDINGS, NOTHING, Cockpit, panel
from gateway.client.link import Sighting
from tests.unit.gateway.client.test_drive_stream import ENGAGED
from tests.unit.gateway.client.test_view import drawn

COCKPIT = Cockpit(
    robot="cruiser-1",
    lease=7,
    sighting=Sighting(state=ENGAGED, age_s=0.0, chassis=None),
    speed_mps=0.4,
    angle_deg=15.0,
    wish=NOTHING,
    message="",
)
OTHER_KEYS = {"+", "-", "g", "r", "x", "q"}
"""What these do: tests/system/gateway/client/test_drive_by_keys.py."""


def test_the_keys_that_are_shown_exist_and_all_of_them_are_shown() -> None:
    """Whoever drives by what is shown is not surprised."""
    shown = drawn(panel(COCKPIT)).split("hold to move", 1)[1]
    letters = {word.strip(",;:") for word in shown.split() if len(word.strip(",;:")) == 1} - {"│", "╰", "a"}
    named = {key for key in BINDINGS if len(key) == 1} | OTHER_KEYS
    assert letters == named - {"a"}
    assert "a d steer" in shown
    assert "arrows" in shown


def test_what_the_limit_leaves_of_the_chosen_speed_is_shown() -> None:
    """A speed above the limit is not shown as if it were driven."""
    slow = msgspec.structs.replace(ENGAGED, speed_limit_mps=1.0)
    fast = msgspec.structs.replace(COCKPIT, sighting=Sighting(slow, 0.0, None), speed_mps=1.5)
    assert "speed (1.50 m/s, of which the limit leaves 1.00)" in drawn(panel(fast))
    assert "speed (0.40 m/s)" in drawn(panel(COCKPIT))
