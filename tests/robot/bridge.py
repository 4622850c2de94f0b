"""Inside the box: the wire between ``can0`` and the chassis outside, and the guest's sign of life.

    python3 -I -S -E bridge.py

A frame is a ``struct can_frame`` behind an Ethernet header on ``vec0``, in both directions. Each 50 ms, and when
the interface has come up, the host is told what time it is in here, and whether it is up: that is the box's last
word when its power goes. One file of the standard library, for it has to be there before the interface.
"""

import fcntl
import os
import socket
import struct
import threading
import time
from contextlib import suppress

CARD, BUS = "vec0", "can0"
CAN_TYPE, LIFE_TYPE = 0x88B5, 0x88B6
HEADER = b"\xff" * 6 + b"\x02\x00\x00\x00\x00\x01"
CAN_HEADER, LIFE_HEADER = HEADER + CAN_TYPE.to_bytes(2, "big"), HEADER + LIFE_TYPE.to_bytes(2, "big")
LIFE = struct.Struct("<QQ?")
LIFE_S = 0.05
LOOK_S = 0.01
FRAME_BYTES = 16
GET_FLAGS, SET_FLAGS, UP = 0x8913, 0x8914, 1


def flags(sock: socket.socket, name: str) -> int:
    """Return the interface's flags. Raises OSError if it does not exist."""
    request = struct.pack("@16sh14x", name.encode(), 0)
    return int(struct.unpack("@16sh14x", fcntl.ioctl(sock, GET_FLAGS, request))[1])


class Wire:
    """Both ends. One thread per direction, so that a frame takes two system calls, which are slow here."""

    def __init__(self) -> None:
        self._card = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(CAN_TYPE))
        request = struct.pack("@16sh14x", CARD.encode(), flags(self._card, CARD) | UP)
        fcntl.ioctl(self._card, SET_FLAGS, request)
        self._card.bind((CARD, CAN_TYPE))
        self._bus: socket.socket | None = None

    def from_chassis(self) -> None:
        while True:
            frame = self._card.recv(256)[len(CAN_HEADER) :][:FRAME_BYTES]
            bus = self._bus
            if bus is not None:
                with suppress(OSError):
                    bus.send(frame)

    def to_chassis(self) -> None:
        """Forward frames, and reopen the interface whenever it comes back."""
        while True:
            try:
                if flags(self._card, BUS) & UP:
                    with socket.socket(socket.PF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as bus:
                        bus.bind((BUS,))
                        self._bus = bus
                        self._tell_life()
                        while True:
                            self._card.send(CAN_HEADER + bus.recv(FRAME_BYTES))
            except OSError:
                self._bus = None
            time.sleep(LOOK_S)

    def live(self) -> None:
        while True:
            self._tell_life()
            time.sleep(LIFE_S)

    def _tell_life(self) -> None:
        with suppress(OSError):
            life = LIFE.pack(time.time_ns(), time.monotonic_ns(), self._bus is not None)
            self._card.send(LIFE_HEADER + life)


def notify_ready() -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.connect(os.environ["NOTIFY_SOCKET"])
        manager.send(b"READY=1")


def main() -> None:
    wire = Wire()
    for direction in (wire.to_chassis, wire.from_chassis):
        threading.Thread(target=direction).start()
    notify_ready()
    wire.live()


if __name__ == "__main__":
    main()
