"""The CAN bus, through python-can: frames in and out, one exception when the bus is lost."""

from __future__ import annotations

import fcntl
import logging
import socket
import struct
import sys
import termios
import time
from typing import Any, Final, Protocol

import can

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
from schemas.exit_codes import CommandError, ExitCode
from schemas.settings import CanSettings

log = logging.getLogger(__name__)

CONNECT_TIMEOUT_S: Final = 1.0
HANDSHAKE_TIMEOUT_S: Final = 5.0
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

DATA_MAX_BYTES: Final = 64
"""A CAN FD frame has no more; a text protocol may say so all the same, and the rest is cut off."""


class BusLost(Exception):  # noqa: N818 - it is named for what happened; the caller opens the bus again
    """The bus is gone: cable, interface down, server gone."""


class BusFull(Exception):  # noqa: N818 - it is named for what happened; the frame is lost, the bus is not
    """The bus does not take a frame now: transmit buffer full, interface in error. It is never sent later."""


class Bus(Protocol):
    """What the loops need of a bus."""

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
    """A bus that python-can has opened."""

    def __init__(self, bus: can.BusABC) -> None:
        self._bus = bus
        self._socket = _stream_socket(bus)
        if self._socket is not None:
            _tune(self._socket)
        self._full_since_s: float | None = None
        self._keeps_epoch: bool | None = None

    def receive(self, timeout_s: float) -> Frame | None:
        """The next frame, or None if there was none in time.

        Raises:
            BusLost: the bus is gone.
        """
        try:
            message = self._bus.recv(timeout_s)
        except (can.CanError, OSError, ValueError) as error:
            raise BusLost(_first_line(error)) from error
        if message is not None:
            return to_frame(message, self._time_ns(message.timestamp))
        if timeout_s > 0 and self._socket is not None and _has_hung_up(self._socket):
            raise BusLost("the server closed the connection")
        return None

    def _time_ns(self, timestamp_s: float) -> int:
        """When a frame was received, since the epoch: by the interface's clock, if that keeps epoch time.

        Some interfaces count from their own start, or give no time. The first frame tells, for as long as the bus
        is open: judged one by one, frames that waited while this process stood still would be taken for new ones.
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
            raise BusFull(_first_line(error)) from error
        except (can.CanError, OSError, ValueError) as error:
            if self._socket is not None:
                _abort(self._socket)
            raise BusLost(_first_line(error)) from error

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
        try:
            self._bus.shutdown()
        except (can.CanError, OSError) as error:
            log.debug("closing the bus: %s", error)


def open_bus(settings: CanSettings) -> CanBus:
    """Open the bus of the settings.

    Raises:
        CommandError: the settings name an interface that python-can does not have.
        BusLost: the bus is not there (yet).
    """
    # Its messages hold tracebacks; what matters of them is in the BusLost that we raise.
    logging.getLogger("can").setLevel(logging.CRITICAL)
    arguments = _bus_arguments(settings)
    if "host" in arguments:
        _probe(arguments["host"], arguments["port"])
    try:
        bus = can.Bus(**arguments, ignore_config=True)
    except (can.CanInterfaceNotImplementedError, ImportError, TypeError, NotImplementedError) as error:
        raise CommandError(
            f"can.interface {settings.interface!r} cannot be used: {error}", ExitCode.USAGE
        ) from error
    except Exception as error:
        # Each vendor's driver raises errors of its own.
        if _is_library_missing(error):
            raise CommandError(
                f"can.interface {settings.interface!r} cannot be used: its driver is not installed "
                f"({_first_line(error)})",
                ExitCode.USAGE,
            ) from error
        raise BusLost(f"{describe(settings)}: {error}") from error
    return CanBus(bus)


def describe(settings: CanSettings) -> str:
    """The bus in a few words, for people."""
    return f"{settings.interface} {settings.channel}"


def _bus_arguments(settings: CanSettings) -> dict[str, Any]:
    arguments: dict[str, Any] = {"interface": settings.interface, **settings.options}
    if settings.bitrate:
        arguments["bitrate"] = settings.bitrate
    if settings.interface != "socketcand":
        return arguments | {"channel": settings.channel}
    address, _, name = settings.channel.partition("/")
    host, colon, port = address.rpartition(":")
    if not colon or not port.isdecimal() or not 0 < int(port) < 65536:
        raise CommandError(
            f"can.channel {settings.channel!r}: socketcand wants HOST:PORT or HOST:PORT/BUS", ExitCode.USAGE
        )
    return arguments | {"host": host.strip("[]"), "port": int(port), "channel": name or settings.bus}


def _probe(host: str, port: int) -> None:
    """Find out whether the server answers: python-can itself would try for 10 s, at full processor load."""
    try:
        with socket.create_connection((host, port), CONNECT_TIMEOUT_S) as probe:
            probe.settimeout(HANDSHAKE_TIMEOUT_S)
            if not probe.recv(16).startswith(b"< hi >"):
                raise BusLost(f"{host}:{port} does not speak the socketcand protocol")
    except (OSError, UnicodeError) as error:  # A host name that cannot be one is a UnicodeError.
        raise BusLost(f"no socketcand server at {host}:{port}: {error}") from error


def _is_library_missing(error: Exception) -> bool:
    """Whether the vendor's library could not be loaded: waiting for the bus is then in vain.

    ctypes, and python-can's pcan, say so with an OSError that has no number, as no system call failed. Its kvaser
    goes on without the library, and stumbles over the first name from it.
    """
    return (type(error) is OSError and error.errno is None) or isinstance(error, NameError)


def _first_line(error: Exception) -> str:
    """What an error says; python-can puts whole tracebacks behind it."""
    return (str(error).splitlines() or [type(error).__name__])[0]


def _stream_socket(bus: can.BusABC) -> socket.socket | None:
    """The TCP socket of a bus that has one.

    python-can's socketcand reads an end of stream as "no message" for ever; only the socket itself can tell.
    """
    for value in vars(bus).values():
        if isinstance(value, socket.socket) and value.type == socket.SOCK_STREAM:
            return value
    return None


def _tune(stream: socket.socket) -> None:
    """Frames leave at once or not at all: no waiting for more, no waiting for room."""
    stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    stream.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, struct.pack("@ll", 0, SEND_TIMEOUT_US))


def _waiting_bytes(stream: socket.socket) -> int:
    """What was sent and has not arrived."""
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


def _has_hung_up(stream: socket.socket) -> bool:
    try:
        return stream.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT) == b""
    except BlockingIOError:
        return False
    except OSError:
        return True


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
