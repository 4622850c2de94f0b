"""Command frames of candump, judged by ``bus_rules``, which were written from the manual."""

from collections.abc import Iterable
from itertools import pairwise
from typing import Final

from gateway.chassis.frame import EXTENDED, Frame
from tests.socketcan.can_utils import Dumped
from tests.support.bus_rules import BURST, DRIVE, FINE_UMPS, PICTURES, Told, is_well_formed, read, value

FILTER: Final = "18C4D0D0:1FFFF0FF"  # all of them, for candump
LAMP_FEEDBACK: Final = "18C4DAEF:1FFFFFFF"  # a frame every 50 ms, for candump

WHEEL_SPEEDS: Final = 0x18C4D7EF
"""The feedback by which time is seen to pass, every 50 ms, and the robot to move."""


def of(frames: Iterable[Dumped]) -> list[Dumped]:
    return [frame for frame in frames if frame.can_id in PICTURES]


def drives(frames: Iterable[Dumped]) -> list[Dumped]:
    return [frame for frame in frames if frame.can_id == DRIVE]


def checked(frames: list[Dumped]) -> list[Told]:
    """Check the bytes, counters and order of command frames. Returns their bursts, in the fine scale."""
    counters: dict[int, int] = {}
    for frame in frames:
        assert is_well_formed(frame.can_id, frame.data), frame
        counter = value(frame.can_id, "c", frame.data)
        assert counter == (counters.get(frame.can_id, counter - 1) + 1) % 16, frame
        counters[frame.can_id] = counter
    begun = [place for place, frame in enumerate(frames) if frame.can_id == DRIVE]
    assert begun[:1] == [0], "it begins within a burst"
    told = []
    for place, end in pairwise([*begun, len(frames)]):
        burst = [Frame(frame.can_id | EXTENDED, frame.data) for frame in frames[place:end]]
        found = tuple(frame.identifier for frame in burst)
        assert found[: len(BURST)] == BURST, [hex(can_id) for can_id in found]
        assert not set(found[len(BURST) :]) & set(BURST), [hex(can_id) for can_id in found]
        told.append(read(burst, FINE_UMPS))
    return told
