"""Opening the CAN bus of the settings, through python-can."""

from __future__ import annotations

import logging
from collections.abc import Collection
from typing import Any, Final

import can

from gateway.can.can_bus import Bus, BusLost, CanBus, first_line
from gateway.can.socketcan import SocketCanBus, check_up
from gateway.can.socketcand import SocketcandBus
from schemas.command_line import CommandError, ExitCode, how_to_get
from schemas.settings import CanSettings

SOCKETCAN: Final = "socketcan"
SOCKETCAND: Final = "socketcand"


def open_bus(settings: CanSettings, identifiers: Collection[int] = ()) -> Bus:
    """Open the bus of the settings.

    Args:
        settings: the bus's interface and channel.
        identifiers: with their flags; where the kernel can choose, it hands over no others. If none, all.

    Raises:
        CommandError: the settings name an interface that python-can does not have.
        BusLost: the bus is not there (yet).
    """
    # Its messages hold tracebacks; what matters of them is in the BusLost that we raise.
    logging.getLogger("can").setLevel(logging.CRITICAL)
    if settings.interface == SOCKETCAN:
        check_up(settings.channel)
    place = _socketcand_place(settings) if settings.interface == SOCKETCAND else None
    try:
        bus = SocketcandBus(*place) if place else can.Bus(**_bus_arguments(settings), ignore_config=True)
        return SocketCanBus(bus, identifiers) if settings.interface == SOCKETCAN else CanBus(bus)
    except (can.CanInterfaceNotImplementedError, ImportError, TypeError, NotImplementedError) as error:
        cure = how_to_get("serial") if "serial module" in str(error) else ""
        raise CommandError(
            f"can.interface {settings.interface!r} cannot be used: {error}{cure}", ExitCode.USAGE
        ) from error
    except Exception as error:
        # Each vendor's driver raises errors of its own.
        if _is_library_missing(error):
            raise CommandError(
                f"can.interface {settings.interface!r} cannot be used: its driver is not installed "
                f"({first_line(error)})",
                ExitCode.USAGE,
            ) from error
        raise BusLost(f"{describe(settings)}: {error}") from error


def describe(settings: CanSettings) -> str:
    """The bus in a few words, for people."""
    return f"{settings.interface} {settings.channel}"


def _bus_arguments(settings: CanSettings) -> dict[str, Any]:
    arguments = {"interface": settings.interface, **settings.options, "channel": settings.channel}
    return arguments | ({"bitrate": settings.bitrate} if settings.bitrate else {})


def _socketcand_place(settings: CanSettings) -> tuple[str, int, str]:
    """Return host, port, and the name of the bus there."""
    address, _, name = settings.channel.partition("/")
    host, colon, port = address.rpartition(":")
    if not colon or not port.isdecimal() or not 0 < int(port) < 65536:
        raise CommandError(
            f"can.channel {settings.channel!r}: socketcand wants HOST:PORT or HOST:PORT/BUS", ExitCode.USAGE
        )
    return host.strip("[]"), int(port), name or settings.bus


def _is_library_missing(error: Exception) -> bool:
    """Report whether the vendor's library could not be loaded: waiting for the bus is then in vain.

    ctypes, and python-can's pcan, say so with an OSError that has no number, as no system call failed. Its kvaser
    continues without the library, and fails at the first name from it.
    """
    return (type(error) is OSError and error.errno is None) or isinstance(error, NameError)
