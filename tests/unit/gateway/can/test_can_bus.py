"""Frames, drops and failures of a bus: python-can, and SocketCAN without a kernel that has CAN."""

import errno
import os
import socket
import struct
import time
from collections.abc import Iterator
from contextlib import closing

import can
import pytest
from hypothesis import given

from gateway.can.can_bus import GARBLED_MAX, BusFull, BusLost, CanBus, SocketCanBus
from gateway.can.python_can import PythonCan, to_frame, to_message
from gateway.chassis.frame import BITRATE_SWITCH, ERROR, ERROR_STATE_INDICATOR, EXTENDED, FD, REMOTE, Frame
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


SO_TIMESTAMPNS = 35
SO_RXQ_OVFL = 40

CLASSIC = struct.Struct("=IB3x8s")
FLEXIBLE = struct.Struct("=IBB2x64s")


class FakeSocket:
    """A CAN socket with failure knobs: ``waiting`` has frames, with time and drops, or errors."""

    def __init__(self) -> None:
        self._end, self._other = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.waiting: list[tuple[bytes, tuple[int, int] | None, int] | OSError] = []
        self.sent: list[bytes] = []
        self.fails: OSError | None = None

    def fileno(self) -> int:
        return self._end.fileno()

    def setsockopt(self, level: int, option: int, value: int | bytes) -> None:
        assert (level, isinstance(value, int)) == (socket.SOL_SOCKET, True), option

    def recvmsg(self, size: int, _: int, flags: int) -> tuple[bytes, list[tuple[int, int, bytes]], int, None]:
        assert flags == socket.MSG_DONTWAIT
        if not self.waiting:
            raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))
        first = self.waiting.pop(0)
        if isinstance(first, OSError):
            raise first
        content, time, drops = first
        ancillary = [(socket.SOL_SOCKET, SO_TIMESTAMPNS, struct.pack("@ll", *time))] if time else []
        if drops:
            ancillary.append((socket.SOL_SOCKET, SO_RXQ_OVFL, struct.pack("@I", drops)))
        return content[:size], ancillary, 0, None

    def recv(self, size: int, flags: int) -> bytes:
        return self.recvmsg(size, 0, flags)[0]

    def send(self, content: bytes, flags: int) -> int:
        assert flags == socket.MSG_DONTWAIT
        if self.fails is not None:
            raise self.fails
        self.sent.append(content)
        return len(content)

    def close(self) -> None:
        self._end.close()
        self._other.close()


@pytest.fixture
def below() -> Iterator[FakeSocket]:
    fake = FakeSocket()
    yield fake
    fake.close()


def opened(below: FakeSocket) -> SocketCanBus:
    return SocketCanBus(below)  # type: ignore[arg-type] # it has what is used


def error(number: int) -> OSError:
    return OSError(number, os.strerror(number))


@pytest.mark.parametrize(
    ("content", "frame"),
    [
        (CLASSIC.pack(0x123, 0, bytes(8)), Frame(0x123, b"", 1)),
        (CLASSIC.pack(0x98C4D1EF, 8, bytes(range(8))), Frame(EXTENDED | 0x18C4D1EF, bytes(range(8)), 1)),
        (CLASSIC.pack(0x123, 2, b"\x01\x02rubbis"), Frame(0x123, b"\x01\x02", 1)),
        (CLASSIC.pack(0xD8C4D1EF, 8, bytes(8)), Frame(EXTENDED | REMOTE | 0x18C4D1EF, b"", 1, 0, 8)),
        (CLASSIC.pack(0x20000040, 8, bytes(8)), Frame(ERROR | 0x40, bytes(8), 1)),
        (FLEXIBLE.pack(0x123, 0, 0, bytes(64)), Frame(0x123, b"", 1, FD)),
        (FLEXIBLE.pack(0x123, 3, 4 | 1, b"abcrubbish"), Frame(0x123, b"abc", 1, FD | BITRATE_SWITCH)),
        (
            FLEXIBLE.pack(0x98C4D1EF, 64, 2, bytes(range(64))),
            Frame(EXTENDED | 0x18C4D1EF, bytes(range(64)), 1, FD | ERROR_STATE_INDICATOR),
        ),
    ],
    ids=["empty", "extended", "short", "remote", "error", "fd-unmarked", "fd-short", "fd-long"],
)
def test_a_frame_is_read_as_linux_lays_it_out(below: FakeSocket, content: bytes, frame: Frame) -> None:
    """Sixteen bytes, or seventy-two for CAN FD, whose flag may be missing."""
    bus = opened(below)
    below.waiting.append((content, (0, 1), 0))
    assert bus.receive(0) == frame
    below.waiting.append((content, None, 0))
    assert (untimed := bus.receive(0)) is not None
    assert untimed.wall_ns > 1, "without a time of the kernel it has ours"
    assert bus.receive(0) is None
    bus.send(frame)
    (sent,) = below.sent
    assert (len(sent), sent[:5]) == (len(content), content[:5])


@pytest.mark.parametrize("number", [errno.ENOBUFS, errno.EAGAIN])
def test_a_full_queue_is_no_loss(below: FakeSocket, number: int) -> None:
    bus = opened(below)
    below.fails = error(number)
    with pytest.raises(BusFull):
        bus.send(Frame(0x123, b"\x01"))
    below.fails = None
    bus.send(Frame(0x123, b"\x02"))
    assert below.sent == [CLASSIC.pack(0x123, 1, b"\x02")]
