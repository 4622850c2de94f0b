"""The last gate before the bus. Default deny: it admits what its own table allows, and nothing else.

It knows nothing of leases, states or limits in force, and trusts nobody: it reads the bytes. What it refuses is a
fault of the gateway's own. The table is written here by hand, from the manual, and not from the DBC that the
encoder uses: one mistake must not pass both.
"""

from __future__ import annotations

from collections import deque
from typing import Final

import msgspec

from gateway.chassis.frame import EXTENDED, Frame
from schemas.messages import Variant

_GEAR: Final = 0x18C4D1D0 | EXTENDED
_STEERING: Final = 0x18C4D2D0 | EXTENDED
_DRIVE: Final = 0x18C4D3D0 | EXTENDED
_BRAKING: Final = 0x18C4D4D0 | EXTENDED
_PARKING: Final = 0x18C4D5D0 | EXTENDED
_ODOMETER: Final = 0x18C4D6D0 | EXTENDED
_LIGHT: Final = 0x18C4D7D0 | EXTENDED
_SPEAKER: Final = 0x18C4D8D0 | EXTENDED

MOTION: Final = (_DRIVE, _GEAR, _STEERING, _BRAKING, _PARKING)
"""The five of a burst, in their order."""

_ALIVE_BITS: Final = 0xF << 52

USED_BITS: Final[dict[int, int]] = {
    _GEAR: 0x1 | 0x7 << 8 | _ALIVE_BITS,
    _STEERING: 0x1 | 0xFFF << 8 | _ALIVE_BITS,
    _DRIVE: 0x1 | 0xFFFF << 8 | _ALIVE_BITS,
    _BRAKING: 0x1 | 0xFF << 8 | _ALIVE_BITS,
    _PARKING: 0x1 | 0x1 << 8 | _ALIVE_BITS,
    _ODOMETER: 0x1 | 0x1 << 16 | _ALIVE_BITS,
    _LIGHT: 0x1 | 0x1 << 8 | 0x1 << 16 | _ALIVE_BITS,
    _SPEAKER: 0x1 | _ALIVE_BITS,
}
"""The bits of bytes 0 to 6 that may be set, by identifier (manual V2.0, section 5)."""

REVERSE, NEUTRAL, DRIVE = 2, 3, 4
"""Raw gears. Park, 1, is reserved."""

ANGLE_RAW: Final = range(1502, 2595)
"""-24 to 24 deg at 0.043945 deg/bit from -90 deg."""

SPEED_RAW_MAX: Final = {Variant.COARSE: 55, Variant.FINE: 2222, Variant.UNKNOWN: 0}
"""2.222 m/s at 0.04 or 0.001 m/s a bit. In an unknown scale only zero is safe."""

SPEED_RISE_RAW: Final = {Variant.COARSE: 1, Variant.FINE: 16, Variant.UNKNOWN: 0}
"""Most that the speed may rise from one burst to the next: 1.6 m/s2, or one bit."""

ANGLE_STEP_RAW: Final = 15
"""Most that the angle may change from one burst to the next: 60 deg/s, and rounding."""

BURST_MAX_FRAMES: Final = 8
"""The five and one of each other frame."""

RATE_FRAMES: Final = 12
"""At most this many frames of one identifier..."""

RATE_WINDOW_NS: Final = 100_000_000
"""...in 100 ms; 10 is nominal."""

FORGET_NS: Final = 200_000_000
"""After a pause the next burst is not held against the one before."""


class GateFault(msgspec.Struct, frozen=True):
    """Why the gate refused a burst."""

    can_id: int
    detail: str


class _Motion(msgspec.Struct, frozen=True):
    """The five frames of a burst, read back from their bytes."""

    enables: tuple[int, ...]
    gear: int
    angle_raw: int
    speed_raw: int
    pedal_raw: int
    parking: int


class Gate:
    """Admits a burst as a whole or not at all.

    Attributes:
        counters: the last alive counter of each identifier that was ever sent.
    """

    def __init__(self) -> None:
        self.counters: dict[int, int] = {}
        self._times_ns: dict[int, deque[int]] = {can_id: deque(maxlen=RATE_FRAMES) for can_id in USED_BITS}
        self._before: _Motion | None = None
        self._before_ns = 0

    def admit(
        self, frames: list[Frame], variant: Variant, now_ns: int, *, stopping: bool = False
    ) -> GateFault | None:
        """Why these frames must not be sent together, or None if they may.

        Args:
            frames: a burst.
            variant: the scale of the speed in it.
            now_ns: monotonic.
            stopping: they belong to a stop. Only a stop may begin with a speed, and in a stop no speed rises.
        """
        if len(frames) > BURST_MAX_FRAMES or len({frame.can_id for frame in frames}) != len(frames):
            return GateFault(0, "too many frames, or one twice")
        for frame in frames:
            fault = self._frame_fault(frame, now_ns)
            if fault:
                return GateFault(frame.can_id, fault)
        if tuple(frame.can_id for frame in frames[: len(MOTION)]) != MOTION:
            return GateFault(0, "a burst begins with the five motion frames")
        before = self._before if now_ns - self._before_ns < FORGET_NS else None
        fault = _motion_fault(_read(frames), before, variant, stopping=stopping)
        return GateFault(_DRIVE, fault) if fault else None

    def sent(self, frames: list[Frame], now_ns: int) -> None:
        """These were sent, the first of a burst that was admitted: what follows is held against them."""
        for frame in frames:
            self.counters[frame.can_id] = frame.data[6] >> 4
            self._times_ns[frame.can_id].append(now_ns)
        if len(frames) >= len(MOTION):
            self._before = _read(frames)
            self._before_ns = now_ns

    def pause(self) -> None:
        """Nothing is sent, on purpose: somebody else may command meanwhile, and what follows begins anew."""
        self._before = None

    def _frame_fault(self, frame: Frame, now_ns: int) -> str:
        allowed = USED_BITS.get(frame.can_id)
        if allowed is None:
            return "this identifier is not sent"
        data = frame.data
        if len(data) != 8 or frame.fd_flags or frame.remote_length:
            return "a command frame is a classic one of 8 bytes"
        if data[0] ^ data[1] ^ data[2] ^ data[3] ^ data[4] ^ data[5] ^ data[6] != data[7]:
            return "the checksum is wrong"
        if int.from_bytes(data[:7], "little") & ~allowed:
            return "a bit is set that has no meaning"
        last = self.counters.get(frame.can_id)
        if last is not None and data[6] >> 4 != (last + 1) & 0xF:
            return "the alive counter does not follow the last one"
        times_ns = self._times_ns[frame.can_id]
        if len(times_ns) == RATE_FRAMES and now_ns - times_ns[0] < RATE_WINDOW_NS:
            return "too many frames of this identifier"
        return ""


def _read(frames: list[Frame]) -> _Motion:
    drive, gear, steering, braking, parking = (int.from_bytes(frame.data, "little") for frame in frames[:5])
    return _Motion(
        enables=tuple(word & 1 for word in (gear, steering, drive, braking, parking)),
        gear=gear >> 8 & 0x7,
        angle_raw=steering >> 8 & 0xFFF,
        speed_raw=drive >> 8 & 0xFFFF,
        pedal_raw=braking >> 8 & 0xFF,
        parking=parking >> 8 & 1,
    )


def _motion_fault(motion: _Motion, before: _Motion | None, variant: Variant, *, stopping: bool) -> str:
    """What is wrong with the five frames taken together, or with the step from those before."""
    rules = (
        (motion.gear in {REVERSE, NEUTRAL, DRIVE}, "this gear is not commanded"),
        (motion.angle_raw in ANGLE_RAW, "the angle is beyond 24 deg"),
        (motion.speed_raw <= SPEED_RAW_MAX[variant], "the speed is beyond what this variant may be told"),
        (len(set(motion.enables)) == 1, "the five enables differ"),
        (not motion.speed_raw or motion.enables[0] == 1, "a speed without the enables"),
        (motion.gear == NEUTRAL or motion.enables[0] == 1, "a gear without the enables"),
        (not motion.speed_raw or motion.gear != NEUTRAL, "a speed in neutral"),
        (not motion.speed_raw or not motion.parking, "a speed against the parking brake"),
        (not motion.speed_raw or not motion.pedal_raw, "a speed against the brake pedal"),
    )
    for holds, fault in rules:
        if not holds:
            return fault
    if before is None:
        return "" if stopping or not motion.speed_raw else "a speed out of silence"
    return _step_fault(motion, before, 0 if stopping else SPEED_RISE_RAW[variant])


def _step_fault(motion: _Motion, before: _Motion, rise_raw: int) -> str:
    rises = motion.speed_raw - before.speed_raw
    shifts = motion.gear != before.gear
    rules = (
        (rises <= rise_raw, "the speed rises too fast"),
        (abs(motion.angle_raw - before.angle_raw) <= ANGLE_STEP_RAW, "the angle changes too fast"),
        (not shifts or not before.speed_raw, "the gear changes at speed"),
        (not shifts or NEUTRAL in {motion.gear, before.gear}, "the direction changes without neutral"),
    )
    return next((fault for holds, fault in rules if not holds), "")
