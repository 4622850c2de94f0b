"""Error frames as linux/can/error.h lays them out."""

import pytest

from gateway.chassis.frame import ERROR, Frame
from gateway.chassis.supervision import controller_state
from schemas.messages import ControllerState


@pytest.mark.parametrize(
    ("kinds", "detail", "state"),
    [
        (0x040, 0x00, ControllerState.BUS_OFF),
        (0x044, 0x20, ControllerState.BUS_OFF),
        (0x100, 0x00, ControllerState.ACTIVE),
        (0x004, 0x40, ControllerState.ACTIVE),
        (0x004, 0x04, ControllerState.WARNING),
        (0x004, 0x08, ControllerState.WARNING),
        (0x004, 0x10, ControllerState.PASSIVE),
        (0x004, 0x24, ControllerState.PASSIVE),
        (0x004, 0x01, None),
        (0x004, 0x00, None),
        (0x008, 0x30, None),
        (0x020, 0x00, None),
        (0x000, 0xFF, None),
    ],
)
def test_an_error_frame_tells_the_controllers_state_or_nothing(
    kinds: int, detail: int, state: ControllerState | None
) -> None:
    """The detail counts only where the frame says that it is about the controller."""
    assert controller_state(Frame(ERROR | kinds, bytes([0, detail, 0, 0, 0, 0, 0, 0]))) is state


def test_an_error_frame_that_is_cut_short_tells_nothing_of_what_is_not_there() -> None:
    """Of whatever length."""
    assert controller_state(Frame(ERROR | 0x004, b"\0")) is None
    assert controller_state(Frame(ERROR | 0x040, b"")) is ControllerState.BUS_OFF
