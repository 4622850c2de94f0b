"""The last gate before the bus. Default deny: it admits only what its own table allows.

It reads the bytes and trusts no other module; a refusal is an internal fault of the gateway. Its table is written
by hand from the manual, not from the encoder's DBC or shared constants, so that one mistake cannot pass both.
"""

from __future__ import annotations

from collections import deque
from typing import Final

import msgspec

from gateway.chassis.frame import EXTENDED, Frame, GateFault
from schemas.messages import Variant

_GEAR: Final = 0x18C4D1D0 | EXTENDED
_STEERING: Final = 0x18C4D2D0 | EXTENDED
DRIVE_ID: Final = 0x18C4D3D0 | EXTENDED
_BRAKING: Final = 0x18C4D4D0 | EXTENDED
_PARKING: Final = 0x18C4D5D0 | EXTENDED
_ODOMETER: Final = 0x18C4D6D0 | EXTENDED
_LIGHT: Final = 0x18C4D7D0 | EXTENDED
_SPEAKER: Final = 0x18C4D8D0 | EXTENDED

MOTION: Final = (DRIVE_ID, _GEAR, _STEERING, _BRAKING, _PARKING)
"""The five of a burst, in their order."""

BRAKE_FIRST: Final = (DRIVE_ID, _PARKING, _GEAR, _STEERING, _BRAKING)
"""Their order at zero speed, after a partly accepted burst."""

_ALIVE_BITS: Final = 0xF << 52

USED_BITS: Final[dict[int, int]] = {
    _GEAR: 0x1 | 0x7 << 8 | _ALIVE_BITS,
    _STEERING: 0x1 | 0xFFF << 8 | _ALIVE_BITS,
    DRIVE_ID: 0x1 | 0xFFFF << 8 | _ALIVE_BITS,
    _BRAKING: 0x1 | 0xFF << 8 | _ALIVE_BITS,
    _PARKING: 0x1 | 0x1 << 8 | _ALIVE_BITS,
    _ODOMETER: 0x1 | 0x1 << 16 | _ALIVE_BITS,
    _LIGHT: 0x1 | 0x1 << 8 | 0x1 << 16 | _ALIVE_BITS,
    _SPEAKER: 0x1 | _ALIVE_BITS,
}
"""The bits of bytes 0 to 6 that may be set, by identifier (manual V2.0, section 5)."""

UNUSED_BITS: Final = {can_id: (1 << 56) - 1 & ~bits for can_id, bits in USED_BITS.items()}

REVERSE, NEUTRAL, DRIVE = 2, 3, 4
"""Raw gears. Park, 1, is reserved."""

GEARS: Final = frozenset({REVERSE, NEUTRAL, DRIVE})

ENABLES: Final = frozenset({0, len(MOTION)})
"""None of the five, or all."""

ANGLE_RAW: Final = range(1502, 2595)
"""-24 to 24 deg at 0.043945 deg/bit from -90 deg."""

SPEED_RAW_MAX: Final = {Variant.COARSE: 55, Variant.FINE: 2222, Variant.UNKNOWN: 0}
"""2.222 m/s at 0.04 or 0.001 m/s a bit. In an unknown scale only zero is safe."""

SPEED_RISE_RAW: Final = {Variant.COARSE: 1, Variant.FINE: 16, Variant.UNKNOWN: 0}
"""Largest rise of the speed from one burst to the next: 1.6 m/s2, or one bit."""

ANGLE_STEP_RAW: Final = 15
"""Largest change of the angle from one burst to the next: 60 deg/s, and rounding."""


class MotionBurst(msgspec.Struct, frozen=True, gc=False):
    """The five frames of a burst, read back from their bytes.

    Attributes:
        enables: number of the five that are set.
        gear, angle_raw, speed_raw, pedal_raw: unscaled, as in the bytes.
        parking: the parking request.
    """

    enables: int
    gear: int
    angle_raw: int
    speed_raw: int
    pedal_raw: int
    parking: int


def read_motion(frames: list[Frame]) -> MotionBurst:
    """Read the first five frames of a burst, in any order."""
    words = {frame.can_id: int.from_bytes(frame.data, "little") for frame in frames[:5]}
    drive, gear, steering, braking, parking = (words[can_id] for can_id in MOTION)
    return MotionBurst(
        enables=(drive & 1) + (gear & 1) + (steering & 1) + (braking & 1) + (parking & 1),
        gear=gear >> 8 & 0x7,
        angle_raw=steering >> 8 & 0xFFF,
        speed_raw=drive >> 8 & 0xFFFF,
        pedal_raw=braking >> 8 & 0xFF,
        parking=parking >> 8 & 1,
    )


BURST_MAX_FRAMES: Final = 8
"""The five and one of each other frame."""

RATE_FRAMES: Final = 12
"""Most frames of one identifier in ``RATE_WINDOW_NS``; 10 are nominal."""

RATE_WINDOW_NS: Final = 100_000_000
"""Window of the rate limit, 100 ms."""

FORGET_NS: Final = 200_000_000
"""Pause after which a burst is not compared with the one before."""


class Gate:
    """Admits a burst as a whole or not at all."""

    def __init__(self, *, may_release: bool = False) -> None:
        """Start before the first burst. A stop of an engagement may release the parking brake once."""
        self.counters: dict[int, int] = {}
        self._times_ns: dict[int, deque[int]] = {can_id: deque(maxlen=RATE_FRAMES) for can_id in USED_BITS}
        self._before: MotionBurst | None = None
        self._before_ns = 0
        self._is_stopping = self._is_torn = False
        # A stop releases the parking brake at most once, if it does not hold the robot.
        self._may_release = may_release

    def admit(
        self, frames: list[Frame], variant: Variant, now_ns: int, *, stopping: bool = False
    ) -> GateFault | None:
        """Return why these frames must not be sent together, or None if they may.

        One stop is always admitted: zero speed, gear and angle of the previous burst, the parking request, all
        enables and no pedal. Only a stop may begin with the parking brake released; in a stop no speed rises, and
        the parking brake stays applied, except for one release at zero speed.
        """
        if len(frames) > BURST_MAX_FRAMES or len({frame.can_id for frame in frames}) != len(frames):
            return GateFault(0, "too many frames, or one twice")
        for frame in frames:
            fault = self._frame_fault(frame, now_ns)
            if fault:
                return GateFault(frame.can_id, fault)
        order = tuple(frame.can_id for frame in frames[: len(MOTION)])
        if order != MOTION and not (order == BRAKE_FIRST and self._is_torn):
            return GateFault(0, "a burst begins with the five motion frames")
        motion = read_motion(frames)
        if order != MOTION and motion.speed_raw:
            return GateFault(DRIVE_ID, "the parking frame comes second at zero speed alone")
        before = self._before if now_ns - self._before_ns < FORGET_NS else None
        self._is_stopping = stopping
        fault = motion_fault(motion, variant) or step_fault(
            motion, before, variant, stopping=stopping, may_release=self._may_release
        )
        return GateFault(DRIVE_ID, fault) if fault else None

    def sent(self, frames: list[Frame], now_ns: int) -> None:
        for frame in frames:
            self.counters[frame.can_id] = frame.data[6] >> 4
            self._times_ns[frame.can_id].append(now_ns)
        if frames:
            self._is_torn = len(frames) < len(MOTION)
        if len(frames) >= len(MOTION):
            motion, before = read_motion(frames), self._before
            if not self._is_stopping:
                self._may_release = True
            elif before is not None and before.parking > motion.parking:
                self._may_release = False
            self._before, self._before_ns = motion, now_ns

    def pause(self) -> None:
        """Note an intended pause: others may command meanwhile, so the next burst has no predecessor."""
        self._before = None

    def _frame_fault(self, frame: Frame, now_ns: int) -> str:
        can_id, data = frame.can_id, frame.data
        if can_id not in USED_BITS:
            return "this identifier is not sent"
        if len(data) != 8 or frame.fd_flags or frame.remote_length:
            return "a command frame is a classic one of 8 bytes"
        times_ns = self._times_ns[can_id]
        if len(times_ns) == RATE_FRAMES and now_ns - times_ns[0] < RATE_WINDOW_NS:
            return "too many frames of this identifier"
        return word_fault(can_id, int.from_bytes(data, "little"), self.counters.get(can_id))


def word_fault(can_id: int, word: int, last_counter: int | None) -> str:
    """Return the fault of a frame's eight bytes, little-endian, after the last counter; empty if there is none."""
    folded = word ^ word >> 32
    folded ^= folded >> 16
    if (folded ^ folded >> 8) & 0xFF:
        return "the checksum is wrong"
    if word & UNUSED_BITS[can_id]:
        return "a bit is set that has no meaning"
    if last_counter is not None and word >> 52 & 0xF != (last_counter + 1) & 0xF:
        return "the alive counter does not follow the last one"
    return ""


def motion_fault(motion: MotionBurst, variant: Variant) -> str:
    """Return the fault of the five frames together; empty if there is none."""
    moves = motion.speed_raw > 0
    rules = (
        (motion.gear in GEARS, "this gear is not commanded"),
        (motion.angle_raw in ANGLE_RAW, "the angle is beyond 24 deg"),
        (motion.speed_raw <= SPEED_RAW_MAX[variant], "the speed is beyond the limit of this variant"),
        (motion.enables in ENABLES, "the five enables differ"),
        # Disabled is neutral, neutral is parked, parked is at zero speed: each row implies the next.
        (motion.gear == NEUTRAL or motion.enables, "a gear without the enables"),
        (motion.gear != NEUTRAL or motion.parking, "neutral without the parking brake"),
        (not moves or not motion.parking, "a speed against the parking brake"),
        (not motion.pedal_raw, "the brake pedal is never pressed"),
    )
    return _broken(rules)


def step_fault(
    motion: MotionBurst, before: MotionBurst | None, variant: Variant, *, stopping: bool, may_release: bool
) -> str:
    """Return the fault of the step from the previous burst (None after silence); empty if there is none."""
    if before is None:
        return "" if stopping or motion.parking else "released out of silence"
    moves = motion.speed_raw > 0
    rise_raw = 0 if stopping else SPEED_RISE_RAW[variant]
    shifts = motion.gear != before.gear
    releases = before.parking > motion.parking
    rules = (
        (motion.speed_raw - before.speed_raw <= rise_raw, "the speed rises too fast"),
        (abs(motion.angle_raw - before.angle_raw) <= ANGLE_STEP_RAW, "the angle changes too fast"),
        # Parked is at zero speed, so the gear cannot change at speed either.
        (not shifts or motion.parking & before.parking, "the gear changes without the parking brake"),
        (not shifts or NEUTRAL in {motion.gear, before.gear}, "the direction changes without neutral"),
        (not releases or not stopping or may_release, "a stop releases the parking brake"),
        (not releases or not moves, "the parking brake is released at speed"),
    )
    return _broken(rules)


def _broken(rules: tuple[tuple[object, str], ...]) -> str:
    for holds, fault in rules:
        if not holds:
            return fault
    return ""
