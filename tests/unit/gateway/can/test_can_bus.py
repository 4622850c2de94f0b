"""Frames, drops and failures of a bus of python-can; tests/socketcan has the kernel's."""

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
    back = to_frame(to_message(frame), frame.wall_ns)
    assert (back.can_id, back.data, back.fd_flags, back.length) == (
        frame.can_id,
        frame.data,
        frame.fd_flags,
        frame.length,
    )
    assert abs(back.wall_ns - frame.wall_ns) < 2000


class Driver(can.BusABC):
    """Reads its outcomes, message times or errors; a CanError repeats until a flush. Sending raises the last."""

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


def reading(*outcomes: Exception | float) -> closing[CanBus]:
    return closing(CanBus(PythonCan(Driver(*outcomes))))


@pytest.mark.parametrize("start_s", [0.0, 12.5, 1e12, float("nan"), float("inf"), -1e300])
def test_a_clock_that_does_not_keep_epoch_time_is_not_believed(start_s: float) -> None:
    """Interfaces that count from their own start would date frames to 1970 or the far future."""
    with reading(start_s, start_s + 1, time.time()) as bus:
        frames = [bus.receive(1) for _ in range(3)]
    assert all(frame is not None and abs(frame.wall_ns - time.time_ns()) < 10**10 for frame in frames)


def test_frames_that_waited_keep_their_times() -> None:
    times_s = [time.time() + offset_s for offset_s in (0, -20, -19.99)]
    with reading(*times_s) as bus:
        times_ns = [frame.wall_ns for _ in range(3) if (frame := bus.receive(1)) is not None]
    assert times_ns == pytest.approx([time_s * 1e9 for time_s in times_s], abs=1000)


FRAME = Frame(EXTENDED | 0x18C4D1EF, bytes(8))


@pytest.mark.parametrize("separator", ["\n", "  "])
def test_a_frame_that_the_driver_does_not_take_is_full_and_a_failing_receive_is_a_loss(separator: str) -> None:
    """A full transmit buffer and a lost cable look the same to a sender."""
    text = f"Transmit buffer full{separator}Traceback (most recent call last):\n  File ..."
    with reading(can.CanOperationError(text)) as bus:
        with pytest.raises(BusFull, match=r"^Transmit buffer full$"):
            bus.send(FRAME)
        with pytest.raises(BusLost, match=r"^Transmit buffer full$"):
            bus.receive(0)


@pytest.mark.parametrize(
    "error", [OSError("Network is down"), ValueError("fd -1"), can.CanError("gone"), IndexError("of a driver")]
)
def test_sending_on_a_closed_bus_is_a_loss(error: Exception) -> None:
    with reading(error) as bus, pytest.raises(BusLost, match=str(error)):
        bus.send(FRAME)


def undecodable() -> can.CanError:
    """The error of python-can's slcan for a line that is not ASCII."""
    error = can.CanOperationError("Could not read from serial device")
    error.__cause__ = UnicodeDecodeError("ascii", b"\xff", 0, 1, "ordinal not in range")
    return error


@pytest.mark.parametrize(
    "error", [IndexError("string index out of range"), ValueError("non-hexadecimal number"), undecodable()]
)
def test_lines_that_cannot_be_read_are_counted_and_many_in_a_row_are_a_lost_bus(error: Exception) -> None:
    for row in (1, GARBLED_MAX - 1):
        with reading(*([error] * row + [0.0]) * 3) as bus:
            assert all(bus.receive(1) is not None for _ in range(3))
        assert bus.drops == 3 * row
    with (
        reading(*[error] * 2 * GARBLED_MAX) as bus,
        pytest.raises(BusLost, match=f"^{GARBLED_MAX} lines in a row cannot be read"),
    ):
        bus.receive(1)
