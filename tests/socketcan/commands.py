"""Command frames of candump, decoded by the chassis's manual, without the gateway's code."""

import statistics
from collections.abc import Iterable
from functools import reduce
from itertools import pairwise
from operator import xor
from typing import Final, NamedTuple

from tests.socketcan.can_utils import Dumped

GEAR: Final = 0x18C4D1D0
STEERING: Final = 0x18C4D2D0
DRIVE: Final = 0x18C4D3D0
BRAKING: Final = 0x18C4D4D0
PARKING: Final = 0x18C4D5D0
ODOMETER: Final = 0x18C4D6D0
LIGHT: Final = 0x18C4D7D0
SPEAKER: Final = 0x18C4D8D0

BURST: Final = (DRIVE, GEAR, STEERING, BRAKING, PARKING)  # of every tick, in this order: the speed first

ALL: Final = frozenset((*BURST, ODOMETER, LIGHT, SPEAKER))

FILTER: Final = "18C4D0D0:1FFFF0FF"  # all of them, for candump
LAMP_FEEDBACK: Final = "18C4DAEF:1FFFFFFF"  # a frame every 50 ms, for candump

WHEEL_SPEEDS: Final = 0x18C4D7EF
"""The feedback by which time is seen to pass, every 50 ms, and the robot to move."""

FORWARD_GEAR: Final = 4
ANGLE_DEG_PER_BIT: Final = 0.043945


class Told(NamedTuple):
    """The content of a burst, its speed unscaled."""

    at_us: int
    enables: tuple[bool, ...]
    gear: int
    angle_deg: float
    speed_raw: int
    pedal_raw: int
    parking: bool


def of(frames: Iterable[Dumped]) -> list[Dumped]:
    return [frame for frame in frames if frame.can_id in ALL]


def counter(frame: Dumped) -> int:
    return _bits(frame, 52, 4)


def bursts(frames: list[Dumped]) -> list[Told]:
    """Split command frames into bursts: the five in their order, then auxiliary ones."""
    begun = [place for place, frame in enumerate(frames) if frame.can_id == BURST[0]]
    assert not frames or begun[:1] == [0], "it begins within a burst"
    told = []
    for place, end in pairwise([*begun, len(frames)]):
        found = tuple(frame.can_id for frame in frames[place:end])
        assert found[: len(BURST)] == BURST, _words(found)
        assert not set(found[len(BURST) :]) & set(BURST), _words(found)
        told.append(_told(*frames[place : place + len(BURST)]))
    return told


def check_bytes(frames: Iterable[Dumped]) -> None:
    """Check for eight bytes, the XOR checksum, and no bit that the manual does not define."""
    for frame in frames:
        assert len(frame.data) == 8, frame
        assert reduce(xor, frame.data) == 0, frame
        word = int.from_bytes(frame.data, "little") & ~(0xFFF << 52)
        assert not word & ~_SIGNAL_BITS[frame.can_id], frame


def check_counters(frames: Iterable[Dumped]) -> None:
    last: dict[int, int] = {}
    for frame in frames:
        if frame.can_id in last:
            assert counter(frame) == (last[frame.can_id] + 1) % 16, frame
        last[frame.can_id] = counter(frame)


def stands(frame: Dumped) -> bool:
    """Report whether wheel speeds of the fine variant are at rest: 32768 each."""
    return (_bits(frame, 8, 16), _bits(frame, 24, 16)) == (0x8000, 0x8000)


def median_period_ms(told: list[Told]) -> float:
    return statistics.median(later.at_us - earlier.at_us for earlier, later in pairwise(told)) / 1e3


_SIGNAL_BITS: Final = {
    GEAR: 1 | 0x7 << 8,
    STEERING: 1 | 0xFFF << 8,
    DRIVE: 1 | 0xFFFF << 8,
    BRAKING: 1 | 0xFF << 8,
    PARKING: 1 | 1 << 8,
    ODOMETER: 1 | 1 << 16,
    LIGHT: 1 | 1 << 8 | 1 << 16,
    SPEAKER: 1,
}


def _words(can_ids: Iterable[int]) -> list[str]:
    return [f"{can_id:08X}" for can_id in can_ids]


def _bits(frame: Dumped, start: int, length: int) -> int:
    return int.from_bytes(frame.data, "little") >> start & ((1 << length) - 1)


def _told(drive: Dumped, gear: Dumped, steering: Dumped, braking: Dumped, parking: Dumped) -> Told:
    return Told(
        at_us=drive.at_us,
        enables=tuple(bool(_bits(frame, 0, 1)) for frame in (gear, steering, drive, braking, parking)),
        gear=_bits(gear, 8, 3),
        angle_deg=_bits(steering, 8, 12) * ANGLE_DEG_PER_BIT - 90,
        speed_raw=_bits(drive, 8, 16),
        pedal_raw=_bits(braking, 8, 8),
        parking=bool(_bits(parking, 8, 1)),
    )
