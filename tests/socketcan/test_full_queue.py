"""A bus that accepts nothing: a kernel interface whose adapter does not send."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

import pytest

from gateway.can.can_bus import BusFull, SocketCanBus, open_socket
from gateway.chassis.frame import EXTENDED, Frame
from gateway.chassis.supervision import controller_state
from schemas.messages import ControllerState
from tests.socketcan.serial_adapter import SerialAdapter
from tests.support.bus_rules import DRIVE
from tests.support.waiting import wait_until

CAN_ID: Final = EXTENDED | DRIVE

TICK_FRAMES: Final = 8  # commands of a tick: the five that move it, odometer, light and horn

IN_THE_ADAPTER: Final = 1
TRIES: Final = 100


@contextmanager
def opened(adapter: SerialAdapter) -> Iterator[SocketCanBus]:
    bus = SocketCanBus(open_socket(adapter.name))
    try:
        yield bus
    finally:
        bus.close()


def numbered(number: int) -> Frame:
    return Frame(CAN_ID, number.to_bytes(8, "little"))


def taken(bus: SocketCanBus, first: int) -> list[int]:
    """Return the numbers of the frames that the bus accepted."""
    numbers = []
    for number in range(first, first + TRIES):
        try:
            bus.send(numbered(number))
        except BusFull:
            continue
        numbers.append(number)
    return numbers


def test_a_tick_waits_for_the_bus_and_no_more() -> None:
    with SerialAdapter() as adapter, opened(adapter) as bus:
        first = taken(bus, 0)
        # Kernels count a frame as 770 to 900 bytes.
        assert first == list(range(len(first)))
        assert TICK_FRAMES <= len(first) - IN_THE_ADAPTER <= TICK_FRAMES + 1
        wait_until(lambda: len(adapter.frames) >= len(first))
        bus.send(numbered(TRIES))
        wait_until(lambda: len(adapter.frames) > len(first))
        assert adapter.frames == [(DRIVE, numbered(number).data) for number in (*first, TRIES)]


@pytest.mark.parametrize(
    ("letter", "errors", "state"),
    [("w", 96, ControllerState.WARNING), ("p", 128, ControllerState.PASSIVE), ("b", 255, ControllerState.BUS_OFF)],
)
def test_a_drivers_own_error_frames_tell_its_state(letter: str, errors: int, state: ControllerState) -> None:
    with SerialAdapter() as adapter, opened(adapter) as bus:
        adapter.report(letter, receive_errors=0, send_errors=errors)
        assert told(bus) is state
        adapter.report("a", receive_errors=0, send_errors=0)
        assert told(bus) is ControllerState.ACTIVE


def test_off_the_bus_frames_are_thrown_away() -> None:
    with SerialAdapter() as adapter:
        with opened(adapter) as bus:
            assert len(taken(bus, 0)) >= TICK_FRAMES + IN_THE_ADAPTER
            adapter.report("b", receive_errors=0, send_errors=255)
            assert told(bus) is ControllerState.BUS_OFF
            wait_until(lambda: len(taken(bus, TRIES)) == TRIES)
        adapter.restart()
        with opened(adapter) as bus:
            bus.send(numbered(2 * TRIES))
            wait_until(lambda: (DRIVE, numbered(2 * TRIES).data) in adapter.frames)
        assert len(adapter.frames) <= IN_THE_ADAPTER + 1


def told(bus: SocketCanBus) -> ControllerState | None:
    frame = bus.receive(10)
    assert frame is not None
    return controller_state(frame)
