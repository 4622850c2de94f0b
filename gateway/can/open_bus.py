"""Opening the CAN bus of the settings, through python-can."""

from __future__ import annotations

import logging
import select
import socket
from collections.abc import Collection
from contextlib import ExitStack, suppress
from typing import Any, Final

import can
from can.interfaces.socketcand import SocketCanDaemonBus

from gateway.can.can_bus import Bus, BusLost, CanBus, first_line, stream_socket
from gateway.can.socketcan import SocketCanBus, check_up
from schemas.exit_codes import CommandError, ExitCode
from schemas.settings import CanSettings

CONNECT_TIMEOUT_S: Final = 1.0
HANDSHAKE_TIMEOUT_S: Final = 5.0

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
    arguments = _bus_arguments(settings)
    if settings.interface == SOCKETCAN:
        check_up(settings.channel)
    if "host" in arguments:
        _probe(arguments["host"], arguments["port"])
    try:
        driver = _SocketcandBus if settings.interface == SOCKETCAND else can.Bus
        bus = driver(**arguments, ignore_config=True)
    except (can.CanInterfaceNotImplementedError, ImportError, TypeError, NotImplementedError) as error:
        cure = "; pip install 'cruiser-gateway[serial]'" if "serial module" in str(error) else ""
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
    return SocketCanBus(bus, identifiers) if settings.interface == SOCKETCAN else CanBus(bus)


def describe(settings: CanSettings) -> str:
    """The bus in a few words, for people."""
    return f"{settings.interface} {settings.channel}"


def _bus_arguments(settings: CanSettings) -> dict[str, Any]:
    arguments: dict[str, Any] = {"interface": settings.interface, **settings.options}
    if settings.bitrate:
        arguments["bitrate"] = settings.bitrate
    if settings.interface != SOCKETCAND:
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


class _SocketcandBus(SocketCanDaemonBus):
    """python-can's socketcand client, but for how it reads the handshake's answers.

    python-can waits for them without end, and takes whatever has arrived by then for the answer: on a busy bus the
    first frames too, which fails the handshake.
    """

    def _expect_msg(self, msg: str) -> None:
        stream = stream_socket(self)
        if stream is None:  # A python-can that keeps it elsewhere.
            super()._expect_msg(msg)  # type: ignore[no-untyped-call]
            return
        with ExitStack() as failing:
            failing.callback(stream.close)
            answer = _read(stream, len(msg))
            if answer != msg.encode():
                with suppress(BlockingIOError):
                    answer += stream.recv(256, socket.MSG_DONTWAIT)
                said = answer.decode("ascii", "replace")
                raise can.CanError(f"the server answered {said!r}, not {msg!r}")
            failing.pop_all()


def _read(stream: socket.socket, count: int) -> bytes:
    """Return the next bytes of an answer, so many."""
    read = b""
    while len(read) < count:
        if not select.select([stream], [], [], HANDSHAKE_TIMEOUT_S)[0]:
            raise TimeoutError(f"the server did not answer within {HANDSHAKE_TIMEOUT_S:g} s")
        part = stream.recv(count - len(read))
        if not part:
            raise can.CanError("the server hung up instead of answering")
        read += part
    return read


def _is_library_missing(error: Exception) -> bool:
    """Report whether the vendor's library could not be loaded: waiting for the bus is then in vain.

    ctypes, and python-can's pcan, say so with an OSError that has no number, as no system call failed. Its kvaser
    continues without the library, and fails at the first name from it.
    """
    return (type(error) is OSError and error.errno is None) or isinstance(error, NameError)
