"""A CAN bus by SocketCAN, by socketcand, or by a driver, with one exception for its loss.

SocketCAN and socketcand are implemented here. python-can opens every other interface (``gateway.can.python_can``):
it takes 6 MiB of memory, and a third of a process's start.

SocketCAN gives the kernel's receive times and drop counts, and filters by identifier. Frames are laid out as in
linux/can.h.
"""

from __future__ import annotations

import errno
import fcntl
import logging
import os
import select
import socket
import struct
import sys
import termios
import time
from collections.abc import Collection
from typing import Final, Protocol

import msgspec

from gateway.chassis.frame import ERROR, EXTENDED, FD, IDENTIFIER_MASK, REMOTE, Frame, hex_identifier

CONNECT_TIMEOUT_S: Final = 1.0
HANDSHAKE_TIMEOUT_S: Final = 5.0  # for each answer
MESSAGE_MAX_BYTES: Final = 512  # a message without its end after this many bytes is dropped

_GREETING: Final = b"< hi >"
_READ_BYTES: Final = 4096


class SocketcandBus:
    """A bus served over TCP."""

    def __init__(self, host: str, port: int, channel: str) -> None:
        """Connect, and open the bus. Raises OSError: there is no server, or it does not answer as expected."""
        try:
            self.stream = socket.create_connection((host, port), CONNECT_TIMEOUT_S)
        except (OSError, UnicodeError) as error:  # A host name that cannot be one is a UnicodeError.
            raise ConnectionError(f"no server there: {error}") from error
        self._buffer = b""
        try:
            self._open(channel)
        except BaseException:
            self.stream.close()
            raise
        self.stream.settimeout(None)

    def _open(self, channel: str) -> None:
        if self._answer(_GREETING) != _GREETING:
            raise ConnectionError("the server does not speak the socketcand protocol")
        for request in (f"< open {channel} >", "< rawmode >"):
            self.stream.sendall(request.encode())
            if (answer := self._answer(b"< ")) != b"< ok >":
                raise ConnectionError(f"the server answered {answer.decode('ascii', 'replace')!r}")

    def _answer(self, start: bytes) -> bytes:
        """Return the next answer, or its beginning as soon as that differs from ``start``."""
        end_s = time.monotonic() + HANDSHAKE_TIMEOUT_S
        while b">" not in self._buffer and self._buffer.startswith(start[: len(self._buffer)]):
            self.stream.settimeout(max(end_s - time.monotonic(), 0.001))
            try:
                self._read()
            except TimeoutError as error:
                raise TimeoutError(f"the server did not answer within {HANDSHAKE_TIMEOUT_S:g} s") from error
        answer, end, self._buffer = self._buffer.partition(b">")
        return answer + end

    def _read(self) -> None:
        data = self.stream.recv(_READ_BYTES)
        if not data:
            raise ConnectionError("the server closed the connection")
        self._buffer += data

    def recv(self, timeout_s: float) -> Frame | None:
        """Return the next frame, with the server's time; None after the timeout. Raises ValueError, OSError."""
        end_s = time.monotonic() + timeout_s
        while b">" not in self._buffer and len(self._buffer) <= MESSAGE_MAX_BYTES:
            if not select.select([self.stream], [], [], max(0.0, end_s - time.monotonic()))[0]:
                return None
            self._read()
        line, end, self._buffer = self._buffer.partition(b">")
        # Anything before the last '<' is a message whose end was lost.
        return frame_of((line[max(line.rfind(b"<"), 0) :] + end).decode("ascii"))

    def send(self, frame: Frame) -> None:
        self.stream.sendall(send_line(frame))

    def shutdown(self) -> None:
        self.stream.close()


_FRAME_LINE, _ERROR_LINE = "< frame ", "< error "


def send_line(frame: Frame) -> bytes:
    """Return the line that sends a frame, as python-can writes it: a remote frame has a length without data."""
    data = " ".join(f"{byte:x}" for byte in frame.data)
    return f"< send {hex_identifier(frame.can_id)} {frame.length:X} {data} >".encode("ascii")


def frame_of(line: str) -> Frame:
    """Parse a line into a frame. Raises ValueError or IndexError if it has none."""
    if not (line.startswith((_FRAME_LINE, _ERROR_LINE)) and line.endswith(" >")):
        raise ValueError(f"unknown message {line[:60]!r}")
    identifier, time_s, *data = line[len(_FRAME_LINE) : -2].split(" ")
    can_id, wall_ns = int(identifier, 16) & IDENTIFIER_MASK, epoch_ns(float(time_s))
    if line.startswith(_ERROR_LINE):
        return Frame(ERROR | EXTENDED | can_id, b"\0", wall_ns)
    kind = 0 if len(identifier) == 3 else EXTENDED
    return Frame(kind | can_id, bytes.fromhex(data[0])[:DATA_MAX_BYTES], wall_ns)


log = logging.getLogger(__name__)

TIMESTAMP_TOLERANCE_NS: Final = 2_000_000_000
TIMESTAMP_MAX_S: Final = 2**33
SEND_WAITING_MAX_BYTES: Final = 2_048
"""Unsent data above which a TCP socket gets no further frame: nine ticks of five frames, 90 ms.

A healthy receiver may leave 40 ms unacknowledged.
"""

SEND_STALL_S: Final = 0.2
"""A TCP socket that stays above that limit for this long counts as lost, with its unsent data."""

SEND_TIMEOUT_US: Final = 2_000  # longest time that the kernel blocks a send, rounded up to its ticks

GARBLED_MAX: Final = 20
"""Unreadable lines in a row that count as a lost bus; a single one is noise on an adapter's line."""

DATA_MAX_BYTES: Final = 64
"""The limit of CAN FD. Longer data in a text protocol is cut off."""


class BusLost(Exception):  # noqa: N818 - it is named for what happened; the caller opens the bus again
    """The bus is gone: cable, interface down, server gone."""


class BusFull(Exception):  # noqa: N818 - it is named for what happened; the frame is lost, the bus is not
    """The bus does not accept a frame now: transmit buffer full, interface in error. It is never sent later."""


class Bus(Protocol):
    """A CAN bus as the loops use it."""

    drops: int  # frames since the opening that the kernel dropped, or that were garbled

    def receive(self, timeout_s: float) -> Frame | None:
        """Return the next frame, or None after the timeout. Raises BusLost."""

    def send(self, frame: Frame) -> None:
        """Hand a frame to the bus, without waiting. Raises BusLost, BusFull."""

    def close(self) -> None:
        """Close the bus. Never raises."""


class BusDriver(Protocol):
    """A reader and writer of a bus. ``CanBus`` maps all of its exceptions."""

    @property
    def stream(self) -> socket.socket | None:
        """Its TCP connection, if it has one."""

    def recv(self, timeout_s: float) -> Frame | None:
        """Return the next frame, with the interface's time, or None. An OSError means that the bus is lost."""

    def send(self, frame: Frame) -> None:
        """Hand a frame to the bus. Raises BusFull."""

    def shutdown(self) -> None:
        """Close the bus."""


class CanBus:
    """A bus by a driver. Any exception of the driver counts as a garbled line or a lost bus."""

    def __init__(self, driver: BusDriver) -> None:
        self.drops = 0
        self._drops_in_row = 0
        self._driver = driver
        self._socket = driver.stream
        if self._socket is not None:
            # Frames leave at once or not at all, without waiting for more data or for space.
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, struct.pack("@ll", 0, SEND_TIMEOUT_US))
        self._full_since_s: float | None = None
        self._keeps_epoch: bool | None = None

    def receive(self, timeout_s: float) -> Frame | None:
        while True:
            try:
                frame = self._driver.recv(timeout_s)
            except BusLost:
                raise
            except Exception as error:  # noqa: BLE001 - foreign code raises what it likes
                self._drop(error)
                timeout_s = 0
                continue
            if frame is None:
                return None
            self._drops_in_row = 0
            return frame if self._is_in_time(frame) else msgspec.structs.replace(frame, wall_ns=time.time_ns())

    def _drop(self, error: Exception) -> None:
        if isinstance(error, OSError):
            raise BusLost(first_line(error)) from error
        self.drops += 1
        self._drops_in_row += 1
        if self._drops_in_row >= GARBLED_MAX:
            raise BusLost(f"{GARBLED_MAX} lines in a row cannot be read: {first_line(error)}") from error
        log.debug("a line of the adapter cannot be read: %r", error)

    def _is_in_time(self, frame: Frame) -> bool:
        """Return True if the interface's clock keeps epoch time.

        Some interfaces count from their own start, or give no time. The first frame decides until the bus is
        closed: judged one by one, frames that waited while this process was suspended would count as new.
        """
        if self._keeps_epoch is None:
            self._keeps_epoch = abs(time.time_ns() - frame.wall_ns) <= TIMESTAMP_TOLERANCE_NS
        return self._keeps_epoch

    def send(self, frame: Frame) -> None:
        """Hand a frame to the bus, without waiting. Raises BusFull, BusLost."""
        if self._socket is not None:
            self._check_room(self._socket)
        try:
            self._driver.send(frame)
        except BusFull:
            raise
        except Exception as error:
            if self._socket is not None:
                _abort(self._socket)
            raise BusLost(first_line(error)) from error

    def _check_room(self, stream: socket.socket) -> None:
        """Bound the unsent data: a TCP socket accepts far more than can leave in time."""
        if _waiting_bytes(stream) <= SEND_WAITING_MAX_BYTES:
            self._full_since_s = None
            return
        now_s = time.monotonic()
        if self._full_since_s is None:
            self._full_since_s = now_s
        if now_s - self._full_since_s < SEND_STALL_S:
            raise BusFull("the server does not read what was sent")
        _abort(stream)
        raise BusLost("the server no longer reads what is sent")

    def close(self) -> None:
        try:
            self._driver.shutdown()
        except Exception as error:  # noqa: BLE001 - foreign code raises what it likes
            log.debug("closing the bus: %r", error)


def epoch_ns(time_s: float) -> int:
    """Convert an interface's time; 0 if it is not a number, infinite or absurd, as from a broken server."""
    return int(time_s * 1e9) if 0 <= time_s < TIMESTAMP_MAX_S else 0


def first_line(error: Exception) -> str:
    """Return the first line of an error's text, without the traceback that python-can appends."""
    message = str(error).partition("Traceback (most recent call last)")[0].strip()
    return (message.splitlines() or [type(error).__name__])[0]


def _waiting_bytes(stream: socket.socket) -> int:
    """Return the number of sent bytes that have not arrived; 0 if the connection is gone."""
    try:
        answer = fcntl.ioctl(stream, termios.TIOCOUTQ, b"\0" * 4)
    except OSError:
        return 0  # The next call reports the lost connection.
    return int.from_bytes(answer, sys.byteorder)


def _abort(stream: socket.socket) -> None:
    """Discard unsent data: a command must not arrive late."""
    try:
        stream.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("@ii", 1, 0))
    except OSError as error:
        log.debug("the socket is gone already: %s", error)


RECEIVE_BUFFER_BYTES: Final = 4_000_000
"""The kernel doubles it, and counts 770 to 900 bytes for a frame: over a second of a saturated bus."""

SEND_BUFFER_BYTES: Final = 3_400
"""Holds eight or nine frames; a tick has eight at most. Further frames are refused and do not wait."""

_FRAME: Final = struct.Struct("=IB3x8s")
_FD_FRAME: Final = struct.Struct("=IBB2x64s")
_FILTER: Final = struct.Struct("=II")
_TIME: Final = struct.Struct("@ll")
_COUNT: Final = struct.Struct("@I")
_FULL: Final = frozenset({errno.ENOBUFS, errno.EAGAIN})

# From the kernel's headers: asm-generic/socket.h, linux/sockios.h, linux/if.h, linux/can/raw.h.
_SO_RCVBUFFORCE: Final = 33
_SO_TIMESTAMPNS: Final = 35
_SO_RXQ_OVFL: Final = 40
_CAN_RAW_ERR_FILTER: Final = 2
_ALL_ERRORS: Final = 0x1FFFFFFF
_SIOCGIFFLAGS: Final = 0x8913
_IFF_UP: Final = 1
_NAME_MAX_BYTES: Final = 15
_FLAGS_REQUEST: Final = struct.Struct("@16sh14x")
_ANCILLARY_BYTES: Final = socket.CMSG_SPACE(_TIME.size) + socket.CMSG_SPACE(_COUNT.size)


def open_socket(channel: str, identifiers: Collection[int] = (), *, fd: bool = False) -> socket.socket:
    """Open a kernel interface for these identifiers, or for all. Raises OSError."""
    bus = socket.socket(socket.AF_CAN, socket.SOCK_RAW | socket.SOCK_CLOEXEC, socket.CAN_RAW)
    try:
        if fd:
            bus.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
        bus.setsockopt(socket.SOL_CAN_RAW, _CAN_RAW_ERR_FILTER, _ALL_ERRORS)
        bus.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
        if identifiers:
            # Before the socket is bound, so that no other frame comes in.
            bits = IDENTIFIER_MASK | EXTENDED
            filters = b"".join(_FILTER.pack(can_id & bits, bits | REMOTE) for can_id in identifiers)
            bus.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, filters)
        bus.bind((channel,))
    except BaseException:
        bus.close()
        raise
    return bus


class SocketCanBus:
    """A SocketCAN interface."""

    def __init__(self, bus: socket.socket) -> None:
        """Own a socket of ``open_socket``."""
        self.drops = 0
        self._socket = bus
        _tune_kernel(self._socket)

    def receive(self, timeout_s: float) -> Frame | None:
        """Return the next frame, or None after the timeout. Raises BusLost: the interface is down, or gone."""
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
        """Hand a frame to the interface, without waiting. Raises BusFull, BusLost.

        While the controller is off the bus the kernel accepts frames and discards them; error frames report that.
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
        try:
            self._socket.close()
        except OSError as error:
            log.debug("closing the bus: %s", error)


def check_up(channel: str) -> None:
    """Raise BusLost if an interface is missing or down: the kernel opens one that is down."""
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


def _tune_kernel(bus: socket.socket) -> None:
    bus.setsockopt(socket.SOL_SOCKET, _SO_RXQ_OVFL, 1)
    bus.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
    try:
        bus.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, RECEIVE_BUFFER_BYTES)
    except PermissionError:
        # Up to net.core.rmem_max.
        bus.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)
        log.info(
            "the receive buffer is smaller than requested (CAP_NET_ADMIN, or net.core.rmem_max, would allow it)"
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
