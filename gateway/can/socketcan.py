"""A bus of the kernel's (SocketCAN): its receive times, what it dropped, and only the identifiers asked for.

python-can opens the socket and sets the filters. Frames go through it as linux/can.h lays them out, and our words
for them are the same.
"""

from __future__ import annotations

import errno
import fcntl
import logging
import os
import select
import socket
import struct
import time
from collections.abc import Collection
from typing import Final

import can

from gateway.can.can_bus import BusFull, BusLost, shut_down
from gateway.chassis.frame import EXTENDED, FD, IDENTIFIER_MASK, REMOTE, Frame

log = logging.getLogger(__name__)

RECEIVE_BUFFER_BYTES: Final = 4_000_000
"""Asked for. The kernel counts twice this, and 770 to 900 for a frame: a second of a saturated bus, and more."""

SEND_BUFFER_BYTES: Final = 3_400
"""The same for sending: eight frames or nine; a tick has eight at most. What is not taken must not wait."""

_UNFILTERED_MAX_FRAMES: Final = 1_000
"""More than a new socket holds, as long as no larger buffer was asked for."""

_FRAME: Final = struct.Struct("=IB3x8s")
_FD_FRAME: Final = struct.Struct("=IBB2x64s")
_TIME: Final = struct.Struct("@ll")
_COUNT: Final = struct.Struct("@I")
_FULL: Final = frozenset({errno.ENOBUFS, errno.EAGAIN})

# From the kernel's headers: asm-generic/socket.h, linux/sockios.h, linux/if.h.
_SO_RCVBUFFORCE: Final = 33
_SO_TIMESTAMPNS: Final = 35
_SO_RXQ_OVFL: Final = 40
_SIOCGIFFLAGS: Final = 0x8913
_IFF_UP: Final = 1
_NAME_MAX_BYTES: Final = 15
_FLAGS_REQUEST: Final = struct.Struct("@16sh14x")
_ANCILLARY_BYTES: Final = socket.CMSG_SPACE(_TIME.size) + socket.CMSG_SPACE(_COUNT.size)


class SocketCanBus:
    """A SocketCAN interface that python-can has opened.

    Attributes:
        drops: frames that the kernel dropped since this was opened, because they were not read in time.
    """

    def __init__(self, bus: can.BusABC, identifiers: Collection[int] = ()) -> None:
        """Use python-can's bus.

        Args:
            bus: of python-can's interface ``socketcan``.
            identifiers: with their flags; the kernel hands over these alone. All, if there are none.

        Raises:
            BusLost: the interface is down, or gone.
        """
        self.drops = 0
        self._bus = bus
        self._socket: socket.socket = bus.socket  # type: ignore[attr-defined] # of its SocketcanBus
        if identifiers:
            bus.set_filters(
                [
                    {
                        "can_id": can_id & IDENTIFIER_MASK,
                        "can_mask": IDENTIFIER_MASK | REMOTE,
                        "extended": bool(can_id & EXTENDED),
                    }
                    for can_id in identifiers
                ]
            )
            self._discard_waiting()
        _tune(self._socket)

    def _discard_waiting(self) -> None:
        """A socket takes everything until its filters are set, and that was not asked for."""
        try:
            for _ in range(_UNFILTERED_MAX_FRAMES):
                self._socket.recv(_FD_FRAME.size, socket.MSG_DONTWAIT)
        except BlockingIOError:
            return
        except OSError as error:
            self.close()
            raise BusLost(_in_words(error)) from error

    def receive(self, timeout_s: float) -> Frame | None:
        """The next frame, or None if there was none in time.

        Raises:
            BusLost: the interface is down, or gone.
        """
        try:
            return self._read()
        except BlockingIOError:
            if timeout_s <= 0 or not select.select([self._socket], [], [], timeout_s)[0]:
                return None
        except OSError as error:
            raise BusLost(_in_words(error)) from error
        return self.receive(0)

    def _read(self) -> Frame:
        content, ancillary, _, _ = self._socket.recvmsg(_FD_FRAME.size, _ANCILLARY_BYTES, socket.MSG_DONTWAIT)
        wall_ns = 0
        for _, kind, value in ancillary:
            if kind == _SO_TIMESTAMPNS:
                seconds, nanoseconds = _TIME.unpack(value)
                wall_ns = seconds * 1_000_000_000 + nanoseconds
            elif kind == _SO_RXQ_OVFL:
                self.drops = _COUNT.unpack(value)[0]
        return _frame(content, wall_ns or time.time_ns())

    def send(self, frame: Frame) -> None:
        """Hand a frame to the interface, without waiting.

        While the controller is off the bus the kernel accepts frames and discards them. Error frames report that.

        Raises:
            BusFull: its queue is full.
            BusLost: the interface is down, or gone.
        """
        if frame.fd_flags:
            content = _FD_FRAME.pack(frame.can_id, frame.length, frame.fd_flags, frame.data)
        else:
            content = _FRAME.pack(frame.can_id, frame.length, frame.data)
        try:
            self._socket.send(content, socket.MSG_DONTWAIT)
        except OSError as error:
            if error.errno in _FULL:
                raise BusFull(_in_words(error)) from error
            raise BusLost(_in_words(error)) from error

    def close(self) -> None:
        """Give the interface back. Never raises."""
        shut_down(self._bus)


def check_up(channel: str) -> None:
    """See whether an interface is there and up: the kernel opens one that is down, and fails at the first read.

    Raises:
        BusLost: it is not.
    """
    name = os.fsencode(channel)
    if len(name) > _NAME_MAX_BYTES:
        raise BusLost(f"socketcan {channel}: {os.strerror(errno.ENODEV)}")
    request = _FLAGS_REQUEST.pack(name, 0)
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
            _, flags = _FLAGS_REQUEST.unpack(fcntl.ioctl(asking, _SIOCGIFFLAGS, request))
    except OSError as error:
        raise BusLost(f"socketcan {channel}: {error.strerror or error}") from error
    if not flags & _IFF_UP:
        raise BusLost(f"socketcan {channel} is down: ip link set {channel} up")


def _tune(bus: socket.socket) -> None:
    bus.setsockopt(socket.SOL_SOCKET, _SO_RXQ_OVFL, 1)
    bus.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
    try:
        bus.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, RECEIVE_BUFFER_BYTES)
    except PermissionError:
        # As much as net.core.rmem_max allows.
        bus.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)
        log.info(
            "the receive buffer is smaller than asked for (CAP_NET_ADMIN, or net.core.rmem_max, would allow it)"
        )


def _frame(content: bytes, wall_ns: int) -> Frame:
    if len(content) == _FD_FRAME.size:
        can_id, length, flags, data = _FD_FRAME.unpack(content)
        return Frame(can_id, data[:length], wall_ns, flags | FD)
    can_id, length, data = _FRAME.unpack(content)
    if can_id & REMOTE:
        return Frame(can_id, b"", wall_ns, 0, length)
    return Frame(can_id, data[:length], wall_ns)


def _in_words(error: OSError) -> str:
    if error.errno == errno.ENETDOWN:
        return "the interface is down"
    return error.strerror or str(error)
