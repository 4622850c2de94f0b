"""Open a bus by its settings, claim it, and reopen it after a loss."""

from __future__ import annotations

import errno
import gc
import hashlib
import logging
import socket
import threading
import time
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Final, Self

from gateway.can.can_bus import (
    CONNECT_TIMEOUT_S,
    HANDSHAKE_TIMEOUT_S,
    Bus,
    BusFull,
    BusLost,
    CanBus,
    SocketCanBus,
    SocketcandBus,
    check_up,
    open_socket,
)
from gateway.chassis.frame import Frame
from schemas.command_line import CommandError, ExitCode
from schemas.settings import RECONNECT_MAX_S, RECONNECT_MIN_S, CanSettings

SOCKETCAN: Final = "socketcan"
SOCKETCAND: Final = "socketcand"
FD: Final = "fd"  # the option of SocketCAN for CAN FD frames


def open_bus(settings: CanSettings, identifiers: Collection[int] = ()) -> Bus:
    """Open the bus of the settings, filtered by identifiers where possible. Raises BusLost, CommandError."""
    try:
        if settings.interface == SOCKETCAN:
            if other := sorted(settings.options.keys() - {FD}):
                raise CommandError(f"can.options: socketcan has only {FD}, not {other[0]!r}", ExitCode.USAGE)
            check_up(settings.channel)
            return SocketCanBus(open_socket(settings.channel, identifiers, fd=bool(settings.options.get(FD))))
        if settings.interface == SOCKETCAND:
            return CanBus(SocketcandBus(*_socketcand_place(settings)))
    except OSError as error:
        raise BusLost(f"{describe(settings)}: {error}") from error
    # Imported here, because it takes memory and time. A bus is opened before the loop begins.
    from gateway.can.python_can import open_driver  # noqa: PLC0415

    return CanBus(open_driver(settings))


def describe(settings: CanSettings) -> str:
    return f"{settings.interface} {settings.channel}"


def _socketcand_place(settings: CanSettings) -> tuple[str, int, str]:
    address, _, name = settings.channel.partition("/")
    host, colon, port = address.rpartition(":")
    if not colon or not port.isdecimal() or not 0 < int(port) < 65536:
        raise CommandError(
            f"can.channel {settings.channel!r}: socketcand wants HOST:PORT or HOST:PORT/BUS", ExitCode.USAGE
        )
    return host.strip("[]"), int(port), name or settings.bus


_PREFIX: Final = "\0cruiser-gateway/"
"""Prefix of abstract socket names. They belong to a network namespace, as CAN interfaces do, and are free again as
soon as their process has ended."""

SOCKETS: Final = Path("/proc/net/unix")  # the kernel's list of socket names in this network namespace
CLAIMS_MAX: Final = 8  # most gateways on one bus that are counted


class BusClaim:
    """Announces to other gateways on this computer that this one commands a bus. It does not lock the bus."""

    def __init__(self, settings: CanSettings) -> None:
        self.is_shared = False  # another gateway has claimed it before
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        # Later gateways take further names, so that 'cruiser doctor' can count them.
        for name in _names(settings):
            try:
                self._socket.bind(name)
            except OSError as error:
                if error.errno != errno.EADDRINUSE:
                    return
                self.is_shared = True
            else:
                return

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_raised: object) -> None:
        self._socket.close()


def count_claims(settings: CanSettings) -> int:
    try:
        taken = {line.rpartition(" ")[2].strip() for line in SOCKETS.read_text("ascii").splitlines()}
    except OSError:
        return 0
    return sum(name.replace("\0", "@") in taken for name in _names(settings))


def _names(settings: CanSettings) -> list[str]:
    digest = hashlib.sha256(describe(settings).encode()).hexdigest()[:32]
    return [f"{_PREFIX}{digest}", *(f"{_PREFIX}{digest}/{number}" for number in range(2, CLAIMS_MAX + 1))]


log = logging.getLogger(__name__)


class ReconnectingBus:
    """A bus that is reopened after a loss, with growing pauses, on a separate thread.

    Opening a bus and closing a lost one may take seconds: neither happens on the caller's thread. While the bus is
    away ``receive`` waits and returns None.
    """

    def __init__(
        self,
        opener: Callable[[], Bus],
        bus: Bus | None,
        *,
        first_pause_s: float = RECONNECT_MIN_S,
        longest_pause_s: float = RECONNECT_MAX_S,
    ) -> None:
        self._open = opener
        self._bus = bus
        self._first_pause_s = first_pause_s
        self._longest_pause_s = longest_pause_s
        self._pause_s = first_pause_s
        self._opened_s = time.monotonic()
        self._opened: Bus | None = None
        self._wake = threading.Event()
        self._closing = threading.Event()
        self._thread: threading.Thread | None = None
        self.is_up = bus is not None
        self.detail = "" if bus is not None else "not opened yet"
        self.losses = 0
        self._drops_before = 0
        if bus is None:
            self._start_opening(lost=None)

    @property
    def drops(self) -> int:
        """Frames dropped before they were read, since the start."""
        return self._drops_before + (self._bus.drops if self._bus is not None else 0)

    def receive(self, timeout_s: float) -> Frame | None:
        """Return the next frame, or None after the timeout or while the bus is away."""
        bus = self._bus
        if bus is None:
            if self._wake.wait(timeout_s):
                self._take_opened()
            return None
        try:
            return bus.receive(timeout_s)
        except BusLost as error:
            self._lose(bus, str(error))
            return None

    def send(self, frames: list[Frame]) -> int:
        """Hand frames to the bus, without waiting. Returns the number it accepted.

        It stops at the first frame that is not accepted: the frames belong together.
        """
        bus = self._bus
        for count, frame in enumerate(frames):
            if bus is None:
                return count
            try:
                bus.send(frame)
            except BusFull as error:
                log.debug("the bus did not accept a frame: %s", error)
                return count
            except BusLost as error:
                self._lose(bus, str(error))
                return count
        return len(frames)

    def close(self) -> None:
        self._closing.set()
        if self._thread is not None:
            self._thread.join(timeout=CONNECT_TIMEOUT_S + HANDSHAKE_TIMEOUT_S)
        self._take_opened()
        if self._bus is not None:
            self._bus.close()

    def _lose(self, bus: Bus, why: str) -> None:
        self._drops_before = self.drops
        self._bus = None
        self.is_up = False
        self.detail = why
        self.losses += 1
        # A bus that is lost again at once needs growing pauses like one that does not open.
        lasted = time.monotonic() - self._opened_s > self._longest_pause_s
        self._pause_s = self._first_pause_s if lasted else self._next_pause_s()
        self._start_opening(lost=bus)

    def _next_pause_s(self) -> float:
        return min(2 * self._pause_s, self._longest_pause_s)

    def _start_opening(self, lost: Bus | None) -> None:
        self._wake.clear()
        self._thread = threading.Thread(target=self._keep_opening, args=[lost], name="bus-opener", daemon=True)
        self._thread.start()

    def _keep_opening(self, lost: Bus | None) -> None:
        # Close a lost bus before opening it again: an interface may allow only one user.
        if lost is not None:
            lost.close()
        while not self._closing.wait(self._pause_s):
            try:
                self._opened = self._open()
            except (BusLost, CommandError, OSError) as error:
                self.detail = str(error)
                self._pause_s = self._next_pause_s()
                # The loop runs without garbage collection, and each failure leaves a self-referencing traceback.
                gc.collect()
            else:
                self._wake.set()
                return

    def _take_opened(self) -> None:
        if self._opened is not None:
            self._bus, self._opened = self._opened, None
            self._opened_s = time.monotonic()
            self.is_up = True
            self.detail = ""
