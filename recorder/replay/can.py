"""Sends a log's frames to a CAN bus, through python-can; and distinguishes virtual buses from real ones."""

from __future__ import annotations

import ipaddress
import logging
import re
import socket
import struct
from pathlib import Path
from typing import Any, Final

import can
import msgspec

from recorder.replay.frames import ReplayedFrame
from recorder.replay.run import Halt
from schemas.exit_codes import CommandError, ExitCode

log = logging.getLogger(__name__)

SOCKETCAND: Final = "socketcand"
VIRTUAL_DEVICES: Final = Path("/sys/devices/virtual/net")
"""Linux's directory of the network devices that no hardware is behind."""

VCAN: Final = re.compile(r"vcan[A-Za-z0-9_-]*")

CONNECT_TIMEOUT_S: Final = 1.0
ANSWER_MAX_BYTES: Final = 1024
ASKED: Final = b"< fault replay >"
ANSWERED: Final = b"< error there is no fault 'replay'"
"""Only a virtual chassis of ours understands faults. A server of real buses knows no such command, and says so."""

SEND_TIMEOUT_S: Final = 1
"""A server that does not read holds nobody up for longer."""

FAILURES_MAX: Final = 100
"""A bus that has not taken so many frames in a row is lost."""

DRAINED: Final = 1000
"""Frames of others that are thrown away at a time: nobody here wants them, and their queue must not grow."""


class CanPlace(msgspec.Struct, frozen=True):
    """The place of a bus.

    Attributes:
        interface: of python-can.
        channel: its channel; for socketcand HOST:PORT or HOST:PORT/BUS.
        bitrate: in bit/s, for interfaces that set it; 0 leaves it alone.
        is_fd: the bus is to take CAN FD frames.
    """

    interface: str
    channel: str
    bitrate: int = 0
    is_fd: bool = False


def is_virtual(place: CanPlace, devices: Path = VIRTUAL_DEVICES) -> bool:
    """Report whether it is certain that no robot is on the bus.

    A socketcand server of this machine may well serve a real bus, so it is asked what it is.
    """
    match place.interface:
        case "virtual":
            return True
        case "socketcan":
            # Anybody can name an interface; a device of that name without hardware is what it says.
            return VCAN.fullmatch(place.channel) is not None and (devices / place.channel).is_dir()
        case "socketcand":
            host, port, _ = _address(place)
            return _is_loopback(host) and _is_simulator(host, port)
        case _:
            return False


def _is_loopback(host: str) -> bool:
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _is_simulator(host: str, port: int) -> bool:
    try:
        with socket.create_connection((host, port), CONNECT_TIMEOUT_S) as connection:
            _answer(connection)
            connection.sendall(ASKED)
            return _answer(connection).startswith(ANSWERED)
    except OSError as error:
        raise CommandError(
            f"no socketcand server at {host}:{port}: {error.strerror or error}", ExitCode.UNREACHABLE
        ) from error


def _answer(connection: socket.socket) -> bytes:
    data = b""
    while not data.endswith(b">") and len(data) < ANSWER_MAX_BYTES:
        received = connection.recv(ANSWER_MAX_BYTES)
        if not received:
            break
        data += received
    return data


class CanOutlet:
    """A bus that frames are sent to, from its beginning to ``close``. Nothing is sent periodically.

    Args:
        place: the address of the bus.

    Attributes:
        sent: frames that the bus took...
        failed: ...and those that it did not.

    Raises:
        CommandError: it cannot be opened.
    """

    def __init__(self, place: CanPlace) -> None:
        self.sent = self.failed = 0
        self._failures = 0
        self._why = ""
        # Its messages hold tracebacks; what matters of them is in what is told here.
        logging.getLogger("can").setLevel(logging.CRITICAL)
        where = f"{place.interface} {place.channel}"
        try:
            self._bus = can.Bus(**_arguments(place), ignore_config=True)
        except (can.CanInterfaceNotImplementedError, ImportError, TypeError, NotImplementedError) as error:
            raise CommandError(f"{where} cannot be used: {_first_line(error)}", ExitCode.USAGE) from error
        except Exception as error:
            # Each vendor's driver raises errors of its own.
            raise CommandError(f"{where}: {_first_line(error)}", ExitCode.UNREACHABLE) from error
        for value in vars(self._bus).values():
            if isinstance(value, socket.socket) and value.type == socket.SOCK_STREAM:
                value.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                value.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, struct.pack("@ll", SEND_TIMEOUT_S, 0))

    def send(self, item: ReplayedFrame, _shift_ns: int) -> None:
        """Send a frame: it goes now or never. Never raises."""
        if self._failures >= FAILURES_MAX:
            self.failed += 1
            return
        frame = item.frame
        try:
            self._bus.send(
                can.Message(
                    arbitration_id=frame.identifier,
                    is_extended_id=frame.is_extended,
                    is_remote_frame=frame.is_remote,
                    is_fd=frame.is_fd,
                    bitrate_switch=frame.bitrate_switch,
                    error_state_indicator=frame.error_state_indicator,
                    dlc=frame.dlc,
                    data=None if frame.is_remote else frame.data,
                    check=True,
                )
            )
        except (can.CanError, OSError, ValueError) as error:
            self.failed += 1
            # A frame that is none says nothing about the bus.
            self._failures += not isinstance(error, ValueError)
            self._why = _first_line(error)
            log.debug("the bus did not take a frame: %s", self._why)
        else:
            self.sent += 1
            self._failures = 0

    def attend(self) -> Halt | None:
        """Throw away what others send. Why the replay must end, if the bus is lost."""
        if self._failures >= FAILURES_MAX:
            return Halt(f"the bus takes nothing any more: {self._why}", ExitCode.UNREACHABLE)
        try:
            for _ in range(DRAINED):
                if self._bus.recv(0) is None:
                    return None
        except (can.CanError, OSError, ValueError) as error:
            return Halt(f"the bus is lost: {_first_line(error)}", ExitCode.UNREACHABLE)
        return None

    def close(self) -> None:
        """Give the bus back. Never raises."""
        try:
            self._bus.shutdown()
        except (can.CanError, OSError) as error:
            log.debug("closing the bus: %s", error)


def _arguments(place: CanPlace) -> dict[str, Any]:
    arguments: dict[str, Any] = {"interface": place.interface, "channel": place.channel}
    if place.interface == SOCKETCAND:
        host, port, name = _address(place)
        return arguments | {"host": host, "port": port, "channel": name}
    if place.bitrate:
        arguments["bitrate"] = place.bitrate
    if place.is_fd:
        arguments["fd"] = True
    return arguments


def _address(place: CanPlace) -> tuple[str, int, str]:
    """Host, port and the bus's name of a socketcand channel."""
    address, _, name = place.channel.partition("/")
    host, colon, port = address.rpartition(":")
    if not colon or not port.isdecimal() or not 0 < int(port) < 65536:
        raise CommandError(
            f"--channel {place.channel!a}: socketcand wants HOST:PORT or HOST:PORT/BUS", ExitCode.USAGE
        )
    return host.strip("[]"), int(port), name or "can0"


def _first_line(error: Exception) -> str:
    # python-can puts whole tracebacks behind it.
    message = str(error).partition("Traceback (most recent call last)")[0].strip()
    return (message.splitlines() or [type(error).__name__])[0]
