"""SocketCAN's frames, drops and failures, without a kernel that has CAN; ``tests/socketcan`` has one."""

import errno
import os
import socket
import struct
from collections.abc import Iterator

import pytest
from hypothesis import given

from gateway.can.can_bus import (
    RECEIVE_BUFFER_BYTES,
    SEND_BUFFER_BYTES,
    BusFull,
    BusLost,
    SocketCanBus,
    check_up,
    open_socket,
)
from gateway.can.open_bus import open_bus
from gateway.chassis.frame import BITRATE_SWITCH, ERROR, ERROR_STATE_INDICATOR, EXTENDED, FD, REMOTE, Frame
from schemas.command_line import CommandError
from schemas.settings import CanSettings
from tests.support.strategies import frames
from tests.unit.gateway.can.test_can_bus import consistent

SO_RCVBUFFORCE = 33
SO_TIMESTAMPNS = 35
SO_RXQ_OVFL = 40

CLASSIC = struct.Struct("=IB3x8s")
FLEXIBLE = struct.Struct("=IBB2x64s")


class FakeSocket:
    """A CAN socket with failure knobs. What is sent is in ``sent``.

    Attributes:
        waiting: what is read: a frame, its time in seconds and nanoseconds, the drops before it; or an error.
        may_force: the buffer may be larger than the system's limit.
    """

    def __init__(self) -> None:
        self._end, self._other = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.waiting: list[tuple[bytes, tuple[int, int] | None, int] | OSError] = []
        self.sent: list[bytes] = []
        self.options: dict[int, int] = {}
        self.fails: OSError | None = None
        self.may_force = True

    def fileno(self) -> int:
        return self._end.fileno()

    def wake(self) -> None:
        """Who waits for it sees that there is something."""
        self._other.send(b"!")

    def setsockopt(self, level: int, option: int, value: int | bytes) -> None:
        assert isinstance(value, int)
        assert level == socket.SOL_SOCKET
        if option == SO_RCVBUFFORCE and not self.may_force:
            raise PermissionError(errno.EPERM, os.strerror(errno.EPERM))
        self.options[option] = value

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


def test_drops_are_the_kernels_count(below: FakeSocket) -> None:
    """It comes with the frame after them, and stays."""
    bus = opened(below)
    frame = CLASSIC.pack(0x123, 0, bytes(8))
    below.waiting += [(frame, (1, 0), drops) for drops in (0, 3, 3, 5)]
    drops = []
    while bus.receive(0) is not None:
        drops.append(bus.drops)
    assert drops == [0, 3, 3, 5]


def test_who_waits_is_woken_by_a_frame(below: FakeSocket) -> None:
    """Or by the end of the time."""
    bus = opened(below)
    assert bus.receive(0.001) is None
    below.wake()
    below.waiting += [BlockingIOError(), (CLASSIC.pack(0x123, 0, bytes(8)), (0, 1), 0)]
    assert bus.receive(100) == Frame(0x123, b"", 1)
    assert bus.receive(100) is None, "what had woken it was no frame"


@pytest.mark.parametrize(
    ("number", "text"), [(errno.ENETDOWN, "the interface is down"), (errno.ENODEV, "No such device")]
)
def test_a_lost_interface_is_told_by_reading_and_sending(below: FakeSocket, number: int, text: str) -> None:
    """In words that say what it is."""
    bus = opened(below)
    below.waiting.append(error(number))
    with pytest.raises(BusLost, match=text):
        bus.receive(0)
    below.fails = error(number)
    with pytest.raises(BusLost, match=text):
        bus.send(Frame(0x123, b""))


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


class OpeningSocket:
    """A socket that notes in order what it is asked for; an interface with the name ``gone`` is gone."""

    def __init__(self, *_kind: int) -> None:
        self.asked: list[tuple[object, ...]] = []
        self.is_closed = False
        OPENED.append(self)

    def setsockopt(self, level: int, option: int, value: int | bytes) -> None:
        self.asked.append((level, option, value))

    def bind(self, address: tuple[str]) -> None:
        self.asked.append(address)
        if address == ("gone",):
            raise error(errno.ENODEV)

    def close(self) -> None:
        self.is_closed = True


OPENED: list[OpeningSocket] = []
RAW = socket.SOL_CAN_RAW
ALWAYS = [(RAW, 2, 0x1FFFFFFF), (socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)]
MASK = EXTENDED | REMOTE | 0x1FFFFFFF


@pytest.mark.parametrize(
    ("identifiers", "fd", "asked"),
    [
        ((), False, ALWAYS),
        ((), True, [(RAW, socket.CAN_RAW_FD_FRAMES, 1), *ALWAYS]),
        (
            (EXTENDED | 0x18C4D1EF, 0x123),
            False,
            [
                *ALWAYS,
                (RAW, socket.CAN_RAW_FILTER, struct.pack("=IIII", EXTENDED | 0x18C4D1EF, MASK, 0x123, MASK)),
            ],
        ),
    ],
    ids=["all", "fd", "some"],
)
def test_the_kernel_is_asked_for_the_identifiers_alone(
    monkeypatch: pytest.MonkeyPatch, identifiers: tuple[int, ...], *, fd: bool, asked: list[tuple[object, ...]]
) -> None:
    """Each of its own kind, all its bits, and no requests for it; before the socket hears anything of the bus."""
    monkeypatch.setattr("gateway.can.can_bus.socket.socket", OpeningSocket)
    open_socket("can0", identifiers, fd=fd)
    assert OPENED.pop().asked == [*asked, ("can0",)]


def test_an_interface_that_goes_while_it_is_opened_is_given_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever opens a bus again and again must not run out of sockets."""
    monkeypatch.setattr("gateway.can.can_bus.socket.socket", OpeningSocket)
    with pytest.raises(OSError, match="No such device"):
        open_socket("gone")
    assert OPENED.pop().is_closed


def test_socketcan_has_one_option() -> None:
    """Another one is a wrong setting, and not ignored."""
    with pytest.raises(CommandError, match=r"socketcan has fd alone, and not 'loopback'"):
        open_bus(CanSettings(interface="socketcan", channel="can0", options={"fd": True, "loopback": False}))


@pytest.mark.parametrize("may_force", [True, False])
def test_the_buffers_are_asked_for(below: FakeSocket, *, may_force: bool) -> None:
    """A large one to receive, beyond the system's limit if that is allowed; a small one to send."""
    below.may_force = may_force
    opened(below)
    assert below.options == {
        SO_RXQ_OVFL: 1,
        socket.SO_SNDBUF: SEND_BUFFER_BYTES,
        SO_RCVBUFFORCE if may_force else socket.SO_RCVBUF: RECEIVE_BUFFER_BYTES,
    }


def test_closing_never_raises(below: FakeSocket, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever the kernel says to it."""

    def fail() -> None:
        raise error(errno.EIO)

    bus = opened(below)
    with monkeypatch.context() as patched:
        patched.setattr(below, "close", fail)
        bus.close()


def test_an_interface_that_is_up_is_no_problem() -> None:
    """The loopback is one on every machine."""
    check_up("lo")


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
