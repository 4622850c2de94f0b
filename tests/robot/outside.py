"""Outside the box: the virtual chassis, and the far end of the wire, which writes down all that passes.

The chassis is no part of the robot's computer: it obeys its last command while that is off.
"""

import socket
import struct
import threading
import time
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from select import select
from typing import Final, NamedTuple, Self

from gateway.can.can_bus import SocketcandBus
from gateway.chassis.cruiser.early_stop import DRIVE, DRIVE_COMMAND, EXTRAS, MOTION
from gateway.chassis.cruiser.frames import load
from gateway.chassis.frame import Frame
from gateway.chassis.layout import Decoded, FrameDecoder
from schemas.messages import Variant
from tests.robot.bridge import CAN_HEADER, CAN_TYPE, LIFE, LIFE_TYPE
from tests.support.waiting import wait_until

FRAME: Final = struct.Struct("=IB3x8s")
ETHERNET_BYTES: Final = len(CAN_HEADER)
MOVES_MPS: Final = 0.01
SENDERS: Final = (*MOTION, *EXTRAS)


class Speed(NamedTuple):
    """Feedback of the speed; ``at_s`` is the host's time.monotonic()."""

    at_s: float
    mps: float


class Told(NamedTuple):
    at_s: float
    can_id: int
    data: bytes

    @property
    def enables(self) -> bool:
        return bool(self.data[0] & 1)

    @property
    def speed_raw(self) -> int:
        return self.data[1] | self.data[2] << 8


class Life(NamedTuple):
    """A sign of life of the guest: host time, its time of day, its uptime, and its interface."""

    at_s: float
    wall_ns: int
    up_s: float
    bus_is_up: bool


class Outside:
    """The far end of the wire; ``chassis`` is HOST:PORT of ``cruiser sim --listen``."""

    def __init__(self, directory: Path, chassis: str) -> None:
        self.card = directory / "chassis.sock"
        self.speeds: list[Speed] = []
        self.told: list[Told] = []
        self.lives: list[Life] = []
        self._decoder = FrameDecoder(load(Variant.FINE))
        self._server = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._server.bind(str(self.card))
        self._server.listen()
        host, _, port = chassis.rpartition(":")
        self._chassis = SocketcandBus(host, int(port), "can0")
        self._chassis.stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._guest: socket.socket | None = None
        self._is_over = False
        self._thread = threading.Thread(target=self._run)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._is_over = True
        self._thread.join()
        for each in (self._server, self._chassis.stream, self._guest):
            if each is not None:
                each.close()

    @property
    def speed_mps(self) -> float:
        return self.speeds[-1].mps if self.speeds else 0.0

    def distance_m(self, since_s: float) -> float:
        speeds = [speed for speed in self.speeds if speed.at_s >= since_s]
        return sum((b.at_s - a.at_s) * a.mps for a, b in pairwise(speeds))

    def wait_steady(self, mps: float, seconds: float, deadline_s: float) -> None:
        def is_steady() -> bool:
            since_s = time.monotonic() - seconds
            late = [speed.mps for speed in self.speeds[-int(200 * seconds) :] if speed.at_s >= since_s]
            return len(late) > 10 * seconds and min(late) >= mps

        wait_until(is_steady, deadline_s=deadline_s)

    def wait_stands(self, deadline_s: float) -> None:
        wait_until(lambda: self.speed_mps < MOVES_MPS, deadline_s=deadline_s)

    def first_life(self, since_s: float, *, bus_is_up: bool) -> Life | None:
        """Return the first sign of life since then, or the first with the interface up."""
        lives = (life for life in self.lives if life.at_s >= since_s and (life.bus_is_up or not bus_is_up))
        return next(lives, None)

    def first_zero_s(self, since_s: float) -> float | None:
        return next((told.at_s for told in self.told if told.at_s >= since_s and self._tells_zero(told)), None)

    def moves_since(self, since_s: float) -> list[Speed]:
        return [speed for speed in self.speeds if speed.at_s >= since_s and speed.mps >= MOVES_MPS]

    def drives_since(self, since_s: float) -> list[Told]:
        return [
            told
            for told in self.told
            if told.at_s >= since_s and told.can_id == DRIVE_COMMAND and told.enables and told.speed_raw
        ]

    def _tells_zero(self, told: Told) -> bool:
        return told.can_id == DRIVE_COMMAND and told.speed_raw == 0

    def _run(self) -> None:
        while not self._is_over:
            sockets = [self._server, self._chassis.stream, *([self._guest] if self._guest else [])]
            ready, _, _ = select(sockets, [], [], 0.1)
            if self._server in ready:
                # A computer that came up again: the one before is gone.
                if self._guest is not None:
                    self._guest.close()
                self._guest, _ = self._server.accept()
                self._guest.settimeout(0)
            elif self._guest is not None and self._guest in ready:
                self._from_guest(self._guest)
            if self._chassis.stream in ready:
                self._from_chassis()

    def _from_guest(self, guest: socket.socket) -> None:
        try:
            packet = guest.recv(2048)
        except OSError:
            packet = b""
        if not packet:
            guest.close()
            self._guest = None
            return
        kind, content, now_s = int.from_bytes(packet[12:14], "big"), packet[ETHERNET_BYTES:], time.monotonic()
        if kind == LIFE_TYPE:
            wall_ns, up_ns, bus_is_up = LIFE.unpack(content[: LIFE.size])
            self.lives.append(Life(now_s, wall_ns, up_ns / 1e9, bus_is_up))
        elif kind == CAN_TYPE:
            can_id, length, data = FRAME.unpack(content[: FRAME.size])
            self._chassis.send(Frame(can_id, data[:length]))
            if can_id in SENDERS:
                self.told.append(Told(now_s, can_id, data))

    def _from_chassis(self) -> None:
        while (frame := self._chassis.recv(0)) is not None:
            if self._guest is not None:
                with suppress(OSError):
                    self._guest.send(CAN_HEADER + FRAME.pack(frame.can_id, len(frame.data), frame.data))
            decoded = self._decoder.decode(frame) if frame.can_id == DRIVE else None
            if isinstance(decoded, Decoded):
                speed = next(float(value) for name, value in decoded.signals.items() if "peed" in name)
                self.speeds.append(Speed(time.monotonic(), speed))
