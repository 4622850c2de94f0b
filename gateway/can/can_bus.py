"""A CAN bus by python-can, the kernel's SocketCAN, or socketcand.

A CAN bus through python-can, whatever its interface: frames in and out, one exception when it is lost.

A client of a socketcand server as a driver of python-can.

Its words for frames are python-can's; the connection is ours. python-can's client connects by IPv4 alone, tries
for 10 s at full processor load, takes what has come for the whole answer, and the end of the stream for silence.

A bus of the kernel's (SocketCAN): its receive times, what it dropped, and only the identifiers asked for.

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
import sys
import termios
import time
from collections.abc import Collection
from typing import Final, Protocol

import can
from can.interfaces.socketcand.socketcand import (
    convert_ascii_message_to_can_message,
    convert_can_message_to_ascii_message,
)

from gateway.chassis.frame import (
    BITRATE_SWITCH,
    ERROR,
    ERROR_STATE_INDICATOR,
    EXTENDED,
    FD,
    IDENTIFIER_MASK,
    REMOTE,
    Frame,
)

CONNECT_TIMEOUT_S: Final = 1.0
HANDSHAKE_TIMEOUT_S: Final = 5.0
"""For each answer."""

MESSAGE_MAX_BYTES: Final = 512
"""A message without its end after this many bytes is dropped."""

_GREETING: Final = b"< hi >"
_READ_BYTES: Final = 4096


class SocketcandBus(can.BusABC):
    """A bus that a server shows over TCP."""

    def __init__(self, host: str, port: int, channel: str) -> None:
        """Connect, and open the bus.

        Raises:
            OSError: there is no server, or it does not answer.
            can.CanError: it answers otherwise.
        """
        try:
            self.stream = socket.create_connection((host, port), CONNECT_TIMEOUT_S)
        except (OSError, UnicodeError) as error:  # A host name that cannot be one is a UnicodeError.
            raise can.CanInitializationError(f"no server there: {error}") from error
        self._buffer = b""
        try:
            self._open(channel)
        except BaseException:
            self.stream.close()
            raise
        self.stream.settimeout(None)
        super().__init__(channel=channel)

    def _open(self, channel: str) -> None:
        if self._answer(_GREETING) != _GREETING:
            raise can.CanInitializationError("the server does not speak the socketcand protocol")
        for request in (f"< open {channel} >", "< rawmode >"):
            self.stream.sendall(request.encode())
            if (said := self._answer(b"< ")) != b"< ok >":
                raise can.CanInitializationError(f"the server answered {said.decode('ascii', 'replace')!r}")

    def _answer(self, start: bytes) -> bytes:
        """Return the next answer; what has come of it once it cannot be one that begins so."""
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

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if b">" not in self._buffer:
            if not select.select([self.stream], [], [], timeout)[0]:
                return None, False
            self._read()
        line, end, rest = self._buffer.partition(b">")
        if not end and len(line) <= MESSAGE_MAX_BYTES:
            return None, False
        self._buffer = rest
        # What comes before the last '<' is a message whose end was lost.
        message = convert_ascii_message_to_can_message((line[max(line.rfind(b"<"), 0) :] + end).decode("ascii"))
        if message is None:
            raise ValueError(f"no message that is known: {line[:60]!r}")
        return message, False

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Hand a frame to the connection."""
        del timeout
        self.stream.sendall(convert_can_message_to_ascii_message(msg).encode("ascii"))

    def shutdown(self) -> None:
        """Hang up."""
        super().shutdown()
        self.stream.close()


log = logging.getLogger(__name__)

TIMESTAMP_TOLERANCE_NS: Final = 2_000_000_000
TIMESTAMP_MAX_S: Final = 2**33
SEND_WAITING_MAX_BYTES: Final = 2_048
"""No further frame goes to a TCP socket while more than this waits in it: nine ticks of five frames, 90 ms.

A receiver that is well may leave 40 ms unacknowledged.
"""

SEND_STALL_S: Final = 0.2
"""A TCP socket in which so much waits for this long is lost, with all that waits."""

SEND_TIMEOUT_US: Final = 2_000
"""Whatever happens, the kernel holds nobody who sends for longer than this, in ticks of its own."""

GARBLED_MAX: Final = 20
"""So many lines in a row that could not be read are a lost bus; one alone is noise on an adapter's line."""

DATA_MAX_BYTES: Final = 64
"""A CAN FD frame has no more; a text protocol may say so all the same, and the rest is cut off."""


class BusLost(Exception):  # noqa: N818 - it is named for what happened; the caller opens the bus again
    """The bus is gone: cable, interface down, server gone."""


class BusFull(Exception):  # noqa: N818 - it is named for what happened; the frame is lost, the bus is not
    """The bus does not take a frame now: transmit buffer full, interface in error. It is never sent later."""


class Bus(Protocol):
    """A CAN bus as the loops use it.

    Attributes:
        drops: frames that came and were not read, since it was opened: too late for the kernel, or garbled.
    """

    drops: int

    def receive(self, timeout_s: float) -> Frame | None:
        """The next frame, or None if there was none in time. Raises BusLost."""
        ...

    def send(self, frame: Frame) -> None:
        """Hand a frame to the bus, without waiting. Raises BusLost, BusFull."""
        ...

    def close(self) -> None:
        """Give the bus back. Never raises."""
        ...


class CanBus:
    """A bus that python-can has opened. Whatever its driver raises is a garbled line, or a lost bus."""

    def __init__(self, bus: can.BusABC) -> None:
        self.drops = 0
        self._drops_in_row = 0
        self._bus = bus
        self._socket = bus.stream if isinstance(bus, SocketcandBus) else None
        if self._socket is not None:
            _tune(self._socket)
        self._full_since_s: float | None = None
        self._keeps_epoch: bool | None = None

    def receive(self, timeout_s: float) -> Frame | None:
        """The next frame, or None if there was none in time.

        Raises:
            BusLost: the bus is gone.
        """
        while True:
            try:
                message = self._bus.recv(timeout_s)
                frame = None if message is None else to_frame(message, self._time_ns(message.timestamp))
            except Exception as error:  # noqa: BLE001 - foreign code raises what it likes
                self._drop(error)
                timeout_s = 0
                continue
            if frame is not None:
                self._drops_in_row = 0
            return frame

    def _drop(self, error: Exception) -> None:
        """Count a line that could not be read.

        Raises:
            BusLost: it is one of many in a row, or the driver means the bus.
        """
        wrapped = error.__cause__ if isinstance(error, can.CanError) else None
        if isinstance(wrapped or error, can.CanError | OSError):
            raise BusLost(first_line(error)) from error
        self.drops += 1
        self._drops_in_row += 1
        if self._drops_in_row >= GARBLED_MAX:
            raise BusLost(f"{GARBLED_MAX} lines in a row cannot be read: {first_line(error)}") from error
        log.debug("a line of the adapter cannot be read: %r", error)
        if wrapped is not None and (flush := getattr(self._bus, "flush", None)) is not None:
            # python-can's slcan keeps what it could not decode, and would fail at it for ever.
            try:
                flush()
            except Exception as failed:
                raise BusLost(first_line(failed)) from failed

    def _time_ns(self, timestamp_s: float) -> int:
        """Return a frame's time of receipt since the epoch: by the interface's clock, if that keeps epoch time.

        Some interfaces count from their own start, or give no time. The first frame decides until the bus is
        closed: judged one by one, frames that waited while this process was suspended would pass for new ones.
        """
        # Not a number, infinite or absurd, as a broken server may send it: no time at all.
        wall_ns = int(timestamp_s * 1e9) if 0 <= timestamp_s < TIMESTAMP_MAX_S else 0
        if self._keeps_epoch is None:
            self._keeps_epoch = abs(time.time_ns() - wall_ns) <= TIMESTAMP_TOLERANCE_NS
        return wall_ns if self._keeps_epoch else time.time_ns()

    def send(self, frame: Frame) -> None:
        """Hand a frame to the bus, without waiting.

        Raises:
            BusFull: it does not take the frame now. Whether the bus is lost, ``receive`` finds out.
            BusLost: the bus is gone, or takes nothing.
        """
        if self._socket is not None:
            self._check_room(self._socket)
        try:
            self._bus.send(to_message(frame))
        except can.CanOperationError as error:
            raise BusFull(first_line(error)) from error
        except Exception as error:
            if self._socket is not None:
                _abort(self._socket)
            raise BusLost(first_line(error)) from error

    def _check_room(self, stream: socket.socket) -> None:
        """A TCP socket takes far more than can leave in time: what waits must stay little, or be thrown away."""
        if _waiting_bytes(stream) <= SEND_WAITING_MAX_BYTES:
            self._full_since_s = None
            return
        now_s = time.monotonic()
        if self._full_since_s is None:
            self._full_since_s = now_s
        if now_s - self._full_since_s < SEND_STALL_S:
            raise BusFull("the server does not take what was sent")
        _abort(stream)
        raise BusLost("the server takes nothing any more")

    def close(self) -> None:
        """Give the bus back. Never raises."""
        shut_down(self._bus)


def shut_down(bus: can.BusABC) -> None:
    """Give a bus of python-can back, whatever its driver makes of that."""
    try:
        bus.shutdown()
    except Exception as error:  # noqa: BLE001 - foreign code raises what it likes
        log.debug("closing the bus: %r", error)


def first_line(error: Exception) -> str:
    """Return the first line of an error's text; python-can puts whole tracebacks behind it."""
    message = str(error).partition("Traceback (most recent call last)")[0].strip()
    return (message.splitlines() or [type(error).__name__])[0]


def _tune(stream: socket.socket) -> None:
    """Frames leave at once or not at all: no waiting for more, no waiting for room."""
    stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    stream.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, struct.pack("@ll", 0, SEND_TIMEOUT_US))


def _waiting_bytes(stream: socket.socket) -> int:
    """Return the number of sent bytes that have not arrived; 0 if the connection is gone."""
    try:
        answer = fcntl.ioctl(stream, termios.TIOCOUTQ, b"\0" * 4)
    except OSError:
        return 0  # It is gone: the next call says so.
    return int.from_bytes(answer, sys.byteorder)


def _abort(stream: socket.socket) -> None:
    """Throw away what has not left yet: a command must not arrive late."""
    try:
        stream.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("@ii", 1, 0))
    except OSError as error:
        log.debug("the socket is gone already: %s", error)


def to_frame(message: can.Message, wall_ns: int) -> Frame:
    """Our frame of python-can's message, received at this time since the epoch."""
    can_id = message.arbitration_id & IDENTIFIER_MASK
    if message.is_extended_id:
        can_id |= EXTENDED
    if message.is_error_frame:
        can_id |= ERROR
    remote_length = 0
    if message.is_remote_frame:
        can_id |= REMOTE
        remote_length = message.dlc
    fd_flags = 0
    if message.is_fd:
        fd_flags = (
            FD
            | (BITRATE_SWITCH if message.bitrate_switch else 0)
            | (ERROR_STATE_INDICATOR if message.error_state_indicator else 0)
        )
    return Frame(can_id, bytes(message.data[:DATA_MAX_BYTES]), wall_ns, fd_flags, remote_length)


def to_message(frame: Frame) -> can.Message:
    """python-can's message of our frame."""
    remote = bool(frame.can_id & REMOTE)
    return can.Message(
        timestamp=frame.wall_ns / 1e9,
        arbitration_id=frame.identifier,
        is_extended_id=bool(frame.can_id & EXTENDED),
        is_remote_frame=remote,
        is_error_frame=bool(frame.can_id & ERROR),
        is_fd=bool(frame.fd_flags & FD),
        bitrate_switch=bool(frame.fd_flags & BITRATE_SWITCH),
        error_state_indicator=bool(frame.fd_flags & ERROR_STATE_INDICATOR),
        dlc=frame.length,
        data=None if remote else frame.data,
    )


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
        _tune_kernel(self._socket)

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


def _tune_kernel(bus: socket.socket) -> None:
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
