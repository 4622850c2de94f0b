"""The last gate before the bus. Default deny: it admits what its own table allows, and nothing else.

It knows nothing of leases, states or limits in force, and trusts nobody: it reads the bytes. What it refuses is a
fault of the gateway's own. Its table, ``gateway.chassis.cruiser.gate_table``, is not the encoder's.
"""

from __future__ import annotations

from collections import deque
from typing import Final

import msgspec

from gateway.chassis.cruiser.gate_table import (
    ANGLE_RAW,
    ANGLE_STEP_RAW,
    BRAKE_FIRST,
    DRIVE_ID,
    ENABLES,
    GEARS,
    MOTION,
    NEUTRAL,
    SPEED_RAW_MAX,
    SPEED_RISE_RAW,
    UNUSED_BITS,
    USED_BITS,
    MotionBurst,
    read_motion,
)
from gateway.chassis.frame import Frame
from schemas.messages import Variant

BURST_MAX_FRAMES: Final = 8
"""The five and one of each other frame."""

RATE_FRAMES: Final = 12
"""Frames of one identifier that pass at most in ``RATE_WINDOW_NS``; 10 are nominal."""

RATE_WINDOW_NS: Final = 100_000_000
"""Window of the rate limit, 100 ms."""

FORGET_NS: Final = 200_000_000
"""After a pause the next burst is not held against the one before."""


class GateFault(msgspec.Struct, frozen=True):
    """The fault for which the gate refused a burst."""

    can_id: int
    detail: str


class Gate:
    """Admits a burst as a whole or not at all.

    Attributes:
        counters: the last alive counter of each identifier that was ever sent.
    """

    def __init__(self, *, may_release: bool = False) -> None:
        """Nothing was sent yet.

        Args:
            may_release: what is sent first is a stop of an engagement, which may release the parking brake once.
        """
        self.counters: dict[int, int] = {}
        self._times_ns: dict[int, deque[int]] = {can_id: deque(maxlen=RATE_FRAMES) for can_id in USED_BITS}
        self._before: MotionBurst | None = None
        self._before_ns = 0
        self._is_stopping = self._is_torn = False
        # In a stop the parking brake is released once at most, by a robot that it does not hold.
        self._may_release = may_release

    def admit(
        self, frames: list[Frame], variant: Variant, now_ns: int, *, stopping: bool = False
    ) -> GateFault | None:
        """Return the fault for which these frames must not be sent together, or None if they may.

        One stop is always admitted, whatever was admitted before: zero speed, gear and angle of the burst before,
        the parking request, all enables and no pedal.

        Args:
            frames: a burst.
            variant: the scale of the speed in it.
            now_ns: monotonic.
            stopping: they belong to a stop. Only a stop may begin with the parking brake released; in a stop no
                speed rises, and the parking brake stays applied, but for one release at zero speed.
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
        """These were sent, the first of a burst that was admitted: what follows is held against them."""
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
        """Nothing is sent, on purpose: somebody else may command meanwhile, and what follows begins anew."""
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
    """Return the fault of a frame's eight bytes, read as one little-endian number; empty if there is none.

    Args:
        can_id: one of ``USED_BITS``.
        word: the bytes.
        last_counter: the alive counter sent last under this identifier; None if none was.
    """
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
        (motion.speed_raw <= SPEED_RAW_MAX[variant], "the speed is beyond what this variant may be told"),
        (motion.enables in ENABLES, "the five enables differ"),
        # Disabled is neutral, neutral is parked, parked is at zero speed: each of these follows from the next.
        (motion.gear == NEUTRAL or motion.enables, "a gear without the enables"),
        (motion.gear != NEUTRAL or motion.parking, "neutral without the parking brake"),
        (not moves or not motion.parking, "a speed against the parking brake"),
        (not motion.pedal_raw, "the brake pedal is never pressed"),
    )
    return _broken(rules)


def step_fault(
    motion: MotionBurst, before: MotionBurst | None, variant: Variant, *, stopping: bool, may_release: bool
) -> str:
    """Return the fault of the step from one burst to the next; empty if there is none.

    Args:
        motion: the burst; neither it nor the one before has a motion fault.
        before: the one before; None out of silence.
        variant: the scale of the speeds.
        stopping: the burst belongs to a stop.
        may_release: this stop may release the parking brake, for there was an engagement before it, and no release
            since.
    """
    if before is None:
        return "" if stopping or motion.parking else "released out of silence"
    moves = motion.speed_raw > 0
    rise_raw = 0 if stopping else SPEED_RISE_RAW[variant]
    shifts = motion.gear != before.gear
    releases = before.parking > motion.parking
    rules = (
        (motion.speed_raw - before.speed_raw <= rise_raw, "the speed rises too fast"),
        (abs(motion.angle_raw - before.angle_raw) <= ANGLE_STEP_RAW, "the angle changes too fast"),
        # Parked is at zero speed: this keeps the gear at speed as well.
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
