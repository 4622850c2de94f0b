"""The CAN controller's state by an error frame, in the words of ISO 11898-1.

Linux makes error frames out of what the controller reports (linux/can/error.h); python-can has them of other
interfaces too, without these details.
"""

from __future__ import annotations

from typing import Final

from gateway.chassis.frame import Frame
from schemas.messages import ControllerState

_CONTROLLER: Final = 0x004
"""Data byte 1 says what it is."""

_BUS_OFF: Final = 0x040
_RESTARTED: Final = 0x100

_WARNING: Final = 0x0C
_PASSIVE: Final = 0x30
_ACTIVE: Final = 0x40
"""Of data byte 1, for receiving or sending."""


def controller_state(frame: Frame) -> ControllerState | None:
    """Return the state that an error frame reports; None if it reports none."""
    kinds = frame.identifier
    if kinds & _BUS_OFF:
        return ControllerState.BUS_OFF
    detail = frame.data[1] if kinds & _CONTROLLER and len(frame.data) > 1 else 0
    if detail & _PASSIVE:
        return ControllerState.PASSIVE
    if detail & _WARNING:
        return ControllerState.WARNING
    if detail & _ACTIVE or kinds & _RESTARTED:
        return ControllerState.ACTIVE
    return None
