"""``SocketCanBus`` on a real interface, with can-utils at the other side."""

import re
import socket
import subprocess
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from typing import Final

import msgspec
import pytest

from gateway.can.can_bus import BusLost, SocketCanBus, open_socket
from gateway.chassis.frame import BITRATE_SWITCH, ERROR, ERROR_STATE_INDICATOR, EXTENDED, FD, REMOTE, Frame
from tests.socketcan.can_utils import Candump
from tests.socketcan.interface import Vcan
from tests.support.waiting import wait_until

LONGEST: Final = bytes(range(64))

FRAMES: Final = {
    "123#": Frame(0x123, b""),
    "123#0102": Frame(0x123, b"\x01\x02"),
    "00000123#0102": Frame(EXTENDED | 0x123, b"\x01\x02"),
    "18C4D1EF#0104000000000005": Frame(EXTENDED | 0x18C4D1EF, bytes.fromhex("0104000000000005")),
    "1FFFFFFF#00": Frame(EXTENDED | 0x1FFFFFFF, b"\x00"),
    "123#R": Frame(REMOTE | 0x123, b""),
    "18C4D1EF#R8": Frame(EXTENDED | REMOTE | 0x18C4D1EF, b"", 0, 0, 8),
    "123##0": Frame(0x123, b"", 0, FD),
    "123##1AABBCC": Frame(0x123, b"\xaa\xbb\xcc", 0, FD | BITRATE_SWITCH),
    f"18C4D1EF##3{LONGEST.hex().upper()}": Frame(
        EXTENDED | 0x18C4D1EF, LONGEST, 0, FD | BITRATE_SWITCH | ERROR_STATE_INDICATOR
    ),
}
"""As can-utils write them, and as we have them."""

SATURATED_HZ: Final = 7_500


@contextmanager
def opened(
    vcan: Vcan, identifiers: Collection[int] = (), *, fd: bool = False
) -> Iterator[tuple[SocketCanBus, socket.socket]]:
    below = open_socket(vcan.name, identifiers, fd=fd)
    bus = SocketCanBus(below)
    try:
        yield bus, below
    finally:
        bus.close()


def cansend(vcan: Vcan, text: str) -> None:
    subprocess.run(["cansend", vcan.name, text], check=True, timeout=30)


def cangen(vcan: Vcan, count: int) -> None:
    command = ["cangen", vcan.name, "-g", "0", "-n", str(count), "-e", "-I", "18C4D1EF", "-L", "8"]
    subprocess.run(command, check=True, timeout=100)


def waiting(bus: SocketCanBus) -> list[Frame]:
    frames = iter(lambda: bus.receive(0), None)
    return [msgspec.structs.replace(frame, wall_ns=0) for frame in frames]


def dumped(candump: Candump) -> list[tuple[int, str]]:
    """Return time in microseconds and frame of each line, without the FD flag that only some kernels set."""
    text = re.sub("##(.)", lambda flags: f"##{int(flags[1], 16) & 3}", candump.path.read_text(encoding="ascii"))
    lines = [line.split() for line in text.splitlines()]
    return [(int(at.strip("()").replace(".", "")), text) for at, _, text in lines if text != "7FF#"]


def test_every_kind_of_frame_is_read_as_it_was_sent(vcan: Vcan, candump: Candump) -> None:
    with opened(vcan, fd=True) as (bus, _):
        for text in FRAMES:
            cansend(vcan, text)
        received = [bus.receive(10) for _ in FRAMES]
        assert bus.drops == 0
    frames = [frame for frame in received if frame is not None]
    assert [msgspec.structs.replace(frame, wall_ns=0) for frame in frames] == list(FRAMES.values())
    wait_until(lambda: len(dumped(candump)) == len(FRAMES))
    assert [(frame.wall_ns // 1000, text) for frame, text in zip(frames, FRAMES, strict=True)] == dumped(candump)


def test_every_kind_of_frame_is_sent_as_it_is(vcan: Vcan, candump: Candump) -> None:
    with opened(vcan, fd=True) as (bus, _):
        for frame in FRAMES.values():
            bus.send(frame)
        wait_until(lambda: len(dumped(candump)) == len(FRAMES))
        assert waiting(bus) == []
    assert [text for _, text in dumped(candump)] == list(FRAMES)


def test_a_second_of_a_saturated_bus_may_wait_unread(vcan: Vcan) -> None:
    with opened(vcan) as (bus, _):
        cangen(vcan, SATURATED_HZ)
        assert len(waiting(bus)) == SATURATED_HZ
        cansend(vcan, "123#")
        assert len(waiting(bus)) == 1
        assert bus.drops == 0


def test_a_filter_passes_its_identifiers_and_errors_alone(vcan: Vcan) -> None:
    with opened(vcan, {EXTENDED | 0x18C4D1EF, EXTENDED | 0x123, 0x1EF}) as (bus, _):
        for text in (
            *("18C4D1EF#01", "18C4D1EE#02", "08C4D1EF#03", "18C4D1EF#R8"),
            *("00000123#04", "123#05", "00000123#R"),
            *("1EF#06", "000001EF#07", "1EE#08", "1EF#R"),
            *("2000007F#0900000000000000", "18C4D1EF#0A"),
        ):
            cansend(vcan, text)
        assert waiting(bus) == [
            Frame(EXTENDED | 0x18C4D1EF, b"\x01"),
            Frame(EXTENDED | 0x123, b"\x04"),
            Frame(0x1EF, b"\x06"),
            Frame(ERROR | 0x07F, b"\x09" + bytes(7)),
            Frame(EXTENDED | 0x18C4D1EF, b"\x0a"),
        ]


def test_an_interface_that_goes_down_is_told_once_by_reading(vcan: Vcan) -> None:
    with opened(vcan) as (bus, _):
        vcan.down()
        with pytest.raises(BusLost, match="the interface is down"):
            bus.receive(100)
        with pytest.raises(BusLost, match="the interface is down"):
            bus.send(Frame(0x123, b""))
        vcan.up()
        bus.send(Frame(0x123, b""))
        cansend(vcan, "123#01")
        assert waiting(bus) == [Frame(0x123, b"\x01")]
