"""A CAN bus through python-can, whatever its interface: frames in and out, one exception when it is lost."""

from __future__ import annotations

import fcntl
import logging
import socket
import struct
import sys
import termios
import time
from typing import Final, Protocol

import can

from gateway.can.socketcand import SocketcandBus
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
