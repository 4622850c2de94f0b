"""SocketCAN's frames, drops and failures, without a kernel that has CAN; ``tests/socketcan`` has one."""

import errno
import os
import socket
import struct
from collections.abc import Iterator

import pytest
from hypothesis import given

from gateway.can.can_bus import (
    BusFull,
    BusLost,
    SocketCanBus,
    check_up,
)
from gateway.can.open_bus import open_bus
from gateway.chassis.frame import BITRATE_SWITCH, ERROR, ERROR_STATE_INDICATOR, EXTENDED, FD, REMOTE, Frame
from schemas.command_line import CommandError
from schemas.settings import CanSettings
from tests.support.strategies import frames
from tests.unit.gateway.can.test_can_bus import consistent

SO_TIMESTAMPNS = 35
SO_RXQ_OVFL = 40

CLASSIC = struct.Struct("=IB3x8s")
FLEXIBLE = struct.Struct("=IBB2x64s")


class FakeSocket:
    """A CAN socket with failure knobs. What is sent is in ``sent``.

    Attributes:
        waiting: what is read: a frame, its time in seconds and nanoseconds, the drops before it; or an error.
    """

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
    """Sixteen bytes, or seventy-two for CAN FD, whose flag need not be set; and sent as the same."""
    bus = opened(below)
    below.waiting.append((content, (0, 1), 0))
    assert bus.receive(0) == frame
    assert bus.receive(0) is None
    bus.send(frame)
    (sent,) = below.sent
    assert (len(sent), sent[:5]) == (len(content), content[:5])


@given(frame=frames.map(consistent))
def test_a_frame_that_was_sent_is_read_as_the_same(frame: Frame) -> None:
    """Whatever it is."""
    below = FakeSocket()
    bus = opened(below)
    bus.send(frame)
    below.waiting.append((below.sent[0], divmod(frame.wall_ns, 10**9), 0))
    received = bus.receive(0)
    bus.close()
    assert received is not None
    if frame.wall_ns == 0:
        assert received.wall_ns > 0, "without a time of the kernel's it has ours"
    else:
        assert received == frame


@pytest.mark.parametrize("number", [errno.ENOBUFS, errno.EAGAIN])
def test_a_full_queue_is_no_loss(below: FakeSocket, number: int) -> None:
    """Whether it is the interface's or the socket's own; the next frame may have room."""
    bus = opened(below)
    below.fails = error(number)
    with pytest.raises(BusFull):
        bus.send(Frame(0x123, b"\x01"))
    below.fails = None
    bus.send(Frame(0x123, b"\x02"))
    assert below.sent == [CLASSIC.pack(0x123, 1, b"\x02")]


def test_socketcan_has_one_option() -> None:
    """Another one is a wrong setting, and not ignored."""
    with pytest.raises(CommandError, match=r"socketcan has fd alone, and not 'loopback'"):
        open_bus(CanSettings(interface="socketcan", channel="can0", options={"fd": True, "loopback": False}))


@pytest.mark.parametrize("channel", ["nosuchcan", "no-such-interface-of-this-name", ""])
def test_an_interface_that_is_missing_is_named(channel: str) -> None:
    """Also one whose name is longer than any can be."""
    with pytest.raises(BusLost, match=f"socketcan {channel}: No such device"):
        check_up(channel)


@pytest.mark.parametrize(("channel", "says"), [("lo", ""), ("nosuchcan", "No such device")])
def test_an_interface_that_is_no_can_is_a_lost_bus(channel: str, says: str) -> None:
    """Whether the kernel has CAN or not; one that is missing may come later, and is no wrong setting."""
    with pytest.raises(BusLost, match=f"socketcan {channel}: {says}"):
        open_bus(CanSettings(interface="socketcan", channel=channel))
