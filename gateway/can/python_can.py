"""A CAN bus by python-can: every interface except SocketCAN and socketcand. Imported only when needed."""

from __future__ import annotations

import logging
from typing import Any, Final

import can

from gateway.can.can_bus import DATA_MAX_BYTES, BusFull, BusLost, epoch_ns, first_line
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
from schemas.command_line import CommandError, ExitCode, how_to_get
from schemas.settings import CanSettings


class PythonCan:
    """A driver for ``CanBus`` over a bus that python-can has opened."""

    stream: Final = None

    def __init__(self, bus: can.BusABC) -> None:
        self._bus = bus

    def recv(self, timeout_s: float) -> Frame | None:
        try:
            message = self._bus.recv(timeout_s)
        except can.CanError as error:
            wrapped = error.__cause__
            if wrapped is None or isinstance(wrapped, can.CanError | OSError):
                raise BusLost(first_line(error)) from error
            self._flush()
            raise
        return None if message is None else to_frame(message, epoch_ns(message.timestamp))

    def _flush(self) -> None:
        """Discard undecodable data: python-can's slcan would fail at it for ever."""
        if (flush := getattr(self._bus, "flush", None)) is not None:
            try:
                flush()
            except Exception as failed:
                raise BusLost(first_line(failed)) from failed

    def send(self, frame: Frame) -> None:
        try:
            self._bus.send(to_message(frame))
        except can.CanOperationError as error:
            raise BusFull(first_line(error)) from error

    def shutdown(self) -> None:
        self._bus.shutdown()


def open_driver(settings: CanSettings) -> PythonCan:
    """Open the bus of the settings. Raises CommandError, BusLost."""
    # Its log has tracebacks; the BusLost raised here has the essential text.
    logging.getLogger("can").setLevel(logging.CRITICAL)
    try:
        return PythonCan(can.Bus(**_bus_arguments(settings), ignore_config=True))
    except (can.CanInterfaceNotImplementedError, ImportError, TypeError, NotImplementedError) as error:
        cure = how_to_get("serial") if "serial module" in str(error) else ""
        raise CommandError(
            f"can.interface {settings.interface!r} cannot be used: {error}{cure}", ExitCode.USAGE
        ) from error
    except Exception as error:
        # Each vendor's driver has different exceptions.
        if _is_library_missing(error):
            raise CommandError(
                f"can.interface {settings.interface!r} cannot be used: its driver is not installed "
                f"({first_line(error)})",
                ExitCode.USAGE,
            ) from error
        raise BusLost(f"{settings.interface} {settings.channel}: {error}") from error


def _bus_arguments(settings: CanSettings) -> dict[str, Any]:
    arguments = {"interface": settings.interface, **settings.options, "channel": settings.channel}
    return arguments | ({"bitrate": settings.bitrate} if settings.bitrate else {})


def _is_library_missing(error: Exception) -> bool:
    """Report whether the vendor's library is missing: waiting for the bus would be in vain.

    ctypes, and python-can's pcan, then raise an OSError without errno, as no system call failed. Its kvaser
    continues without the library, and fails with a NameError.
    """
    return (type(error) is OSError and error.errno is None) or isinstance(error, NameError)


def to_frame(message: can.Message, wall_ns: int) -> Frame:
    """Convert a message of python-can, received at this time since the epoch."""
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
    """Convert a frame to a message of python-can."""
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
