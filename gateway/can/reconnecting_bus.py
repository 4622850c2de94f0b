"""A CAN bus that is opened again when it is lost, without the caller ever waiting for it."""

from __future__ import annotations

import gc
import logging
import threading
import time
from collections.abc import Callable

from gateway.can.can_bus import Bus, BusFull, BusLost
from gateway.can.socketcand import CONNECT_TIMEOUT_S, HANDSHAKE_TIMEOUT_S
from gateway.chassis.frame import Frame
from schemas.command_line import CommandError
from schemas.settings import RECONNECT_MAX_S, RECONNECT_MIN_S

log = logging.getLogger(__name__)


class ReconnectingBus:
    """A bus that is opened again when it is lost, with growing pauses, on a thread of its own.

    Opening may take seconds, and so may closing a lost one: neither happens on the caller's thread. While the bus
    is away ``receive`` waits its time and returns None.

    Attributes:
        is_up: the bus is open.
        detail: why it is not, for people.
        losses: number of times that it was lost.
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
        """Frames that were dropped before they were read, since the start."""
        return self._drops_before + (self._bus.drops if self._bus is not None else 0)

    def receive(self, timeout_s: float) -> Frame | None:
        """The next frame, or None if there was none in time or the bus is away."""
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
        """Hand frames to the bus, without waiting. Returns how many it took.

        Those after the first that it did not take are not tried: they belong together.
        """
        bus = self._bus
        for count, frame in enumerate(frames):
            if bus is None:
                return count
            try:
                bus.send(frame)
            except BusFull as error:
                log.debug("the bus does not take a frame: %s", error)
                return count
            except BusLost as error:
                self._lose(bus, str(error))
                return count
        return len(frames)

    def close(self) -> None:
        """Give the bus back."""
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
        # A bus that opens and is lost again at once needs the growing pauses as much as one that does not open.
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
        # A lost bus is given back before it is opened again: an interface may allow one user only.
        if lost is not None:
            lost.close()
        while not self._closing.wait(self._pause_s):
            try:
                self._opened = self._open()
            except (BusLost, CommandError, OSError) as error:
                self.detail = str(error)
                self._pause_s = self._next_pause_s()
                # The loop runs without collections, and each failure leaves a traceback that refers to itself.
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
