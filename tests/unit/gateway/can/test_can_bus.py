"""Frames to python-can's messages and back, and what becomes of its errors."""

import time
from contextlib import closing

import can
import pytest
from hypothesis import given

from gateway.can.can_bus import GARBLED_MAX, BusFull, BusLost, CanBus
from gateway.can.python_can import PythonCan, to_frame, to_message
from gateway.chassis.frame import ERROR, EXTENDED, REMOTE, Frame
from tests.support.strategies import frames


def consistent(frame: Frame) -> Frame:
    """The frame as a driver can deliver it: no remote FD frames, no remote data, 11 bits if standard."""
    can_id = frame.can_id if frame.can_id & EXTENDED else frame.can_id & ~0x1FFF_F800
    remote = bool(can_id & REMOTE) and not can_id & ERROR
    can_id = can_id if remote else can_id & ~REMOTE
    fd_flags = 0 if remote or can_id & ERROR else frame.fd_flags
    data = b"" if remote else frame.data[: 64 if fd_flags else 8]
    return Frame(can_id, data, frame.wall_ns, fd_flags, frame.remote_length if remote else 0)


@given(frame=frames.map(consistent))
def test_a_frame_survives_the_way_through_python_can(frame: Frame) -> None:
    """Identifier, kind, data, FD flags and length are the same after python-can's message as before."""
    back = to_frame(to_message(frame), frame.wall_ns)
    assert (back.can_id, back.data, back.fd_flags, back.length) == (
        frame.can_id,
        frame.data,
        frame.fd_flags,
        frame.length,
    )
    assert abs(back.wall_ns - frame.wall_ns) < 2000


class Driver(can.BusABC):
    """Reads what it is told to, a message with its time or an error, which it repeats if that does not flush.

    It sends nothing, with the last error.
    """

    def __init__(self, *outcomes: Exception | float) -> None:
        super().__init__(channel="none")
        self.outcomes = list(outcomes)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        error = self.outcomes[-1]
        assert isinstance(error, Exception), (msg, timeout)
        raise error

    def flush(self) -> None:
        del self.outcomes[0]

    def shutdown(self) -> None:
        super().shutdown()
        raise AttributeError("the port was closed before")

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        del timeout
        if isinstance(outcome := self.outcomes[0], can.CanError):
            raise outcome
        if isinstance(outcome := self.outcomes.pop(0), Exception):
            raise outcome
        return can.Message(timestamp=outcome), True


@pytest.mark.parametrize("start_s", [0.0, 12.5, 1e12, float("nan"), float("inf"), -1e300])
def test_a_clock_that_does_not_keep_epoch_time_is_not_believed(start_s: float) -> None:
    """Interfaces that count from their own start would put frames into 1970 or the far future."""
    bus = CanBus(PythonCan(Driver(start_s, start_s + 1, time.time())))
    for _ in range(3):
        frame = bus.receive(1)
        assert frame is not None
        assert abs(frame.wall_ns - time.time_ns()) < 10**10
    bus.close()


def test_frames_that_waited_keep_their_times() -> None:
    """Once the interface's clock is known to keep epoch time, a frame that comes late is old, not new."""
    now_s = time.time()
    bus = CanBus(PythonCan(Driver(now_s, now_s - 20, now_s - 19.99)))
    times_ns = [frame.wall_ns for _ in range(3) if (frame := bus.receive(1)) is not None]
    assert times_ns == pytest.approx([now_s * 1e9, (now_s - 20) * 1e9, (now_s - 19.99) * 1e9], abs=1000)
    bus.close()


FRAME = Frame(EXTENDED | 0x18C4D1EF, bytes(8))


@pytest.mark.parametrize("separator", ["\n", "  "])
def test_a_frame_that_the_driver_does_not_take_is_full_and_a_failing_receive_is_a_loss(separator: str) -> None:
    """A full transmit buffer and a lost cable look alike to who sends; ``receive`` tells them apart."""
    said = f"Transmit buffer full{separator}Traceback (most recent call last):\n  File ..."
    with closing(CanBus(PythonCan(Driver(can.CanOperationError(said))))) as bus:
        with pytest.raises(BusFull, match=r"^Transmit buffer full$"):
            bus.send(FRAME)
        with pytest.raises(BusLost, match=r"^Transmit buffer full$"):
            bus.receive(0)


@pytest.mark.parametrize(
    "error", [OSError("Network is down"), ValueError("fd -1"), can.CanError("gone"), IndexError("of a driver")]
)
def test_sending_on_a_closed_bus_is_a_loss(error: Exception) -> None:
    """Nothing that a driver raises leaves the port, nor when it is closed."""
    bus = CanBus(PythonCan(Driver(error)))
    with pytest.raises(BusLost, match=str(error)):
        bus.send(FRAME)
    bus.close()


def undecodable() -> can.CanError:
    """What python-can's slcan makes of a line that is not ASCII."""
    error = can.CanOperationError("Could not read from serial device")
    error.__cause__ = UnicodeDecodeError("ascii", b"\xff", 0, 1, "ordinal not in range")
    return error


GARBLED = [IndexError("string index out of range"), ValueError("non-hexadecimal number"), undecodable()]


@pytest.mark.parametrize("error", GARBLED)
def test_a_line_that_cannot_be_read_is_dropped_and_counted(error: Exception) -> None:
    """The next frame is read at once; a frame in between ends a row."""
    for row in (1, GARBLED_MAX - 1):
        bus = CanBus(PythonCan(Driver(*([error] * row + [0.0]) * 3)))
        assert all(bus.receive(1) is not None for _ in range(3))
        assert bus.drops == 3 * row
        bus.close()


@pytest.mark.parametrize("error", GARBLED)
def test_many_lines_in_a_row_that_cannot_be_read_are_a_lost_bus(error: Exception) -> None:
    """Such as a wrong bit rate, or a driver whose port is gone."""
    bus = CanBus(PythonCan(Driver(*[error] * 2 * GARBLED_MAX)))
    with pytest.raises(BusLost, match=f"^{GARBLED_MAX} lines in a row cannot be read"):
        bus.receive(1)
    bus.close()
