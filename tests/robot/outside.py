"""Outside the box: the virtual chassis, and the far end of the wire, which writes down all that passes.

The chassis is no part of the robot's computer: it obeys its last command while that is off.
"""

import re
import socket
import struct
import threading
import time
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from select import select
from typing import Final, NamedTuple, Self

from gateway.chassis.cruiser.early_stop import DRIVE, DRIVE_COMMAND, EXTENDED, EXTRAS, MOTION
from gateway.chassis.cruiser.frames import load
from gateway.chassis.frame import Frame
from gateway.chassis.layout import Decoded, FrameDecoder
from schemas.messages import Variant
from tests.robot.bridge import CAN_HEADER, CAN_TYPE, LIFE, LIFE_TYPE
from tests.support.waiting import wait_until

LINE: Final = re.compile(rb"< frame ([0-9A-Fa-f]+) ([0-9.]+) ([0-9A-Fa-f]*) >")
FRAME: Final = struct.Struct("=IB3x8s")
ETHERNET_BYTES: Final = len(CAN_HEADER)
MOVES_MPS: Final = 0.01
SENDERS: Final = (*MOTION, *EXTRAS)


class Speed(NamedTuple):
    """What the chassis says of its motion.

    Attributes:
        at_s: time.monotonic() out here.
    """

    at_s: float
    mps: float


class Told(NamedTuple):
    """A command frame that reached the chassis."""

    at_s: float
    can_id: int
    data: bytes

    @property
    def enables(self) -> bool:
        """It has its enable bit set."""
        return bool(self.data[0] & 1)

    @property
    def speed_raw(self) -> int:
        """Of a drive command."""
        return self.data[1] | self.data[2] << 8


class Life(NamedTuple):
    """The guest's sign of life.

    Attributes:
        wall_ns: its time of day.
        up_s: since it booted.
        bus_is_up: its CAN interface is.
    """

    at_s: float
    wall_ns: int
    up_s: float
    bus_is_up: bool


class Outside:
    """The far end of the wire, until the block ends.

    Args:
        directory: of the sockets.
        chassis: HOST:PORT of ``cruiser sim --listen``.
    """

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
        self._chassis = socket.create_connection((host, int(port)))
        self._chassis.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._guest: socket.socket | None = None
        self._buffer = b""
        self._is_over = False
        self._thread = threading.Thread(target=self._run)

    def __enter__(self) -> Self:
        for word in (b"< open can0 >", b"< rawmode >"):
            self._chassis.sendall(word)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._is_over = True
        self._thread.join()
        for each in (self._server, self._chassis, self._guest):
            if each is not None:
                each.close()

    @property
    def speed_mps(self) -> float:
        """What the chassis said last."""
        return self.speeds[-1].mps if self.speeds else 0.0

    def distance_m(self, since_s: float) -> float:
        """How far it has gone since then."""
        speeds = [speed for speed in self.speeds if speed.at_s >= since_s]
        return sum((b.at_s - a.at_s) * a.mps for a, b in pairwise(speeds))

    def wait_steady(self, mps: float, seconds: float, deadline_s: float) -> None:
        """Wait until it has gone at least so fast for so long."""

        def is_steady() -> bool:
            since_s = time.monotonic() - seconds
            late = [speed.mps for speed in self.speeds[-int(200 * seconds) :] if speed.at_s >= since_s]
            return len(late) > 10 * seconds and min(late) >= mps

        wait_until(is_steady, deadline_s=deadline_s)

    def wait_stands(self, deadline_s: float) -> None:
        """Wait until the chassis stands."""
        wait_until(lambda: self.speed_mps < MOVES_MPS, deadline_s=deadline_s)

    def first_life(self, since_s: float, *, bus_is_up: bool) -> Life | None:
        """The guest's first sign of life since then; with its interface up, if that is asked."""
        lives = (life for life in self.lives if life.at_s >= since_s and (life.bus_is_up or not bus_is_up))
        return next(lives, None)

    def first_zero_s(self, since_s: float) -> float | None:
        """When, since then, the chassis was first told zero speed."""
        return next((told.at_s for told in self.told if told.at_s >= since_s and self._tells_zero(told)), None)

    def moves_since(self, since_s: float) -> list[Speed]:
        """Where it moved since then."""
        return [speed for speed in self.speeds if speed.at_s >= since_s and speed.mps >= MOVES_MPS]

    def drives_since(self, since_s: float) -> list[Told]:
        """Commands since then that ask for motion."""
        return [
            told
            for told in self.told
            if told.at_s >= since_s and told.can_id == DRIVE_COMMAND and told.enables and told.speed_raw
        ]

    def _tells_zero(self, told: Told) -> bool:
        return told.can_id == DRIVE_COMMAND and told.speed_raw == 0

    def _run(self) -> None:
        while not self._is_over:
            sockets = [self._server, self._chassis, *([self._guest] if self._guest else [])]
            ready, _, _ = select(sockets, [], [], 0.1)
            if self._server in ready:
                # A computer that came up again: the one before is gone.
                if self._guest is not None:
                    self._guest.close()
                self._guest, _ = self._server.accept()
                self._guest.settimeout(0)
            elif self._guest is not None and self._guest in ready:
                self._from_guest(self._guest)
            if self._chassis in ready:
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
            self._chassis.sendall(
                b"< send %08X %d %s >" % (can_id & ~EXTENDED, length, data[:length].hex(" ").encode())
            )
            if can_id in SENDERS:
                self.told.append(Told(now_s, can_id, data))

    def _from_chassis(self) -> None:
        self._buffer += self._chassis.recv(65536)
        end = 0
        for line in LINE.finditer(self._buffer):
            end = line.end()
            can_id, data = (
                int(line[1], 16) | (EXTENDED if len(line[1]) == 8 else 0),
                bytes.fromhex(line[3].decode()),
            )
            if self._guest is not None:
                with suppress(OSError):
                    self._guest.send(CAN_HEADER + FRAME.pack(can_id, len(data), data))
            if can_id == DRIVE:
                decoded = self._decoder.decode(Frame(can_id, data))
                if isinstance(decoded, Decoded):
                    speed = next(float(value) for name, value in decoded.signals.items() if "peed" in name)
                    self.speeds.append(Speed(time.monotonic(), speed))
        self._buffer = self._buffer[end:]
