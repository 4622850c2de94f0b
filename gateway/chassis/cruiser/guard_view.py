"""The chassis's state as the guard reads it from the bus: mode, standstill, counters of command frames. Pure."""

from __future__ import annotations

from typing import Final

from gateway.chassis.cruiser.frames import (
    BODY,
    DRIVE,
    GEAR,
    MOTION_FRAMES,
    PARKING,
    STEERING,
    WHEEL_SPEED,
    StandstillEvidence,
    load,
)
from gateway.chassis.frame import Frame
from gateway.chassis.layout import Signals, check, compile_signals
from gateway.chassis.supervision import silence_ns
from schemas.can_word import COUNTER_SPAN
from schemas.cruiser import TURNING_RAW_MIN
from schemas.messages import GearPosition, Mode, Variant
from schemas.settings import GUARD_SILENT_NS, REMOTE_FRAMES, STANDSTILL_MPS, STANDSTILL_TICKS, TICK_NS

_WATCHED: Final = (GEAR, STEERING, DRIVE, PARKING, BODY, WHEEL_SPEED)

_STANDS_NS: Final = STANDSTILL_TICKS * TICK_NS


class ChassisView:
    """The newest feedback and commands on the bus."""

    def __init__(self) -> None:
        layout = load(Variant.COARSE)
        self._feedback = {layout.messages[name].can_id: layout.messages[name] for name in _WATCHED}
        self._commands = {message.can_id: message.name for message in layout.commands}
        self._read = {
            variant: {name: compile_signals(load(variant).messages[name]) for name in _WATCHED}
            for variant in (Variant.COARSE, Variant.FINE)
        }
        self._silence_ns = {name: silence_ns(layout.messages[name].period_ns) for name in _WATCHED}
        self._evidence = StandstillEvidence()
        self._latest: dict[str, tuple[bytes, int]] = {}
        self._remote_frames = 0
        self._slow_since_ns: int | None = None
        self.next_counters: dict[str, int] = {}
        self.commander_ns: int | None = None

    def receive(self, frame: Frame, now_ns: int) -> None:
        command = self._commands.get(frame.can_id)
        if command is not None:
            if check(frame) is None:
                self.next_counters[command] = ((frame.data[6] >> 4) + 1) % COUNTER_SPAN
                if command in MOTION_FRAMES:
                    self.commander_ns = now_ns
            return
        layout = self._feedback.get(frame.can_id)
        if layout is None or check(frame) is not None:
            return
        before = self._latest.get(layout.name)
        # A frame that repeats its counter carries no news, and becomes stale like a missing one.
        if before is None or before[0][6] >> 4 != frame.data[6] >> 4:
            self._latest[layout.name] = (frame.data, now_ns)
            if layout.name == BODY:
                self._remote_frames = (
                    self._remote_frames + 1 if _mode(self._body(frame.data)) is Mode.REMOTE else 0
                )

    def has_feedback(self, now_ns: int) -> bool:
        return any(now_ns - heard_ns < GUARD_SILENT_NS for _, heard_ns in self._latest.values())

    def mode(self, now_ns: int) -> Mode:
        data = self._fresh(BODY, now_ns)
        mode = Mode.UNDEFINED if data is None else _mode(self._body(data))
        return Mode.UNDEFINED if mode is Mode.REMOTE and self._remote_frames < REMOTE_FRAMES else mode

    def stands(self, variant: Variant, now_ns: int) -> bool:
        if not self._is_slow(variant, now_ns):
            self._slow_since_ns = None
            return False
        if self._slow_since_ns is None:
            self._slow_since_ns = now_ns
        return now_ns - self._slow_since_ns >= _STANDS_NS

    def gear(self, now_ns: int) -> GearPosition:
        data = self._fresh(GEAR, now_ns)
        told = "" if data is None else str(self._read[Variant.COARSE][GEAR](data)["GearPosition"])
        return _GEARS.get(told, GearPosition.UNDEFINED)

    def angle_deg(self, now_ns: int) -> float:
        data = self._fresh(STEERING, now_ns)
        return 0.0 if data is None else float(self._read[Variant.COARSE][STEERING](data)["Angle"])

    def slowest_mps(self, variant: Variant, now_ns: int) -> float | None:
        drive_mps, wheels_mps = self._drive_mps(variant, now_ns), self._fastest_wheel_mps(variant, now_ns)
        return drive_mps if drive_mps is None or wheels_mps is None else min(drive_mps, wheels_mps)

    def fastest_mps(self, variant: Variant, now_ns: int) -> float | None:
        speeds = (self._drive_mps(variant, now_ns), self._fastest_wheel_mps(variant, now_ns))
        return max((speed for speed in speeds if speed is not None), default=None)

    def wheel_speed_mps(self, variant: Variant, now_ns: int) -> float | None:
        wheels = self._wheels_mps(variant, now_ns)
        return None if wheels is None else sum(wheels) / 2

    def moves(self, variant: Variant, now_ns: int) -> bool:
        """The robot is seen to move; by raw drive feedback and wheel speeds if their scale is unknown."""
        if variant is not Variant.UNKNOWN:
            return (self.fastest_mps(variant, now_ns) or 0.0) > STANDSTILL_MPS
        drive, wheels = self._fresh(DRIVE, now_ns), self._fresh(WHEEL_SPEED, now_ns)
        turns = drive is not None and int.from_bytes(drive[1:3], "little") >= TURNING_RAW_MIN
        # Standstill in one variant is many m/s in the other, or no wheel speed at all.
        return turns or (
            wheels is not None and bool(wheels[0] & 1) and self._evidence.of(wheels) is Variant.UNKNOWN
        )

    def is_braked(self, now_ns: int) -> bool | None:
        data = self._fresh(PARKING, now_ns)
        return None if data is None else self._read[Variant.COARSE][PARKING](data)["ParkingStatus"] == "applied"

    def is_complete(self, now_ns: int) -> bool:
        return all(self._fresh(name, now_ns) is not None for name in (GEAR, STEERING, DRIVE, BODY))

    def evidence_data(self, now_ns: int) -> bytes | None:
        return self._fresh(WHEEL_SPEED, now_ns)

    def _is_slow(self, variant: Variant, now_ns: int) -> bool:
        if variant is Variant.UNKNOWN:
            wheels, drive = self._fresh(WHEEL_SPEED, now_ns), self._fresh(DRIVE, now_ns)
            if wheels is None or drive is None:
                return False
            # Zero is the same in both scales, and standing wheels of one scale cannot be standing in the other.
            return not any(drive[1:3]) and self._evidence.of(wheels) is not Variant.UNKNOWN
        speeds_mps = (self._drive_mps(variant, now_ns), self._fastest_wheel_mps(variant, now_ns))
        return all(speed_mps is not None and speed_mps < STANDSTILL_MPS for speed_mps in speeds_mps)

    def _drive_mps(self, variant: Variant, now_ns: int) -> float | None:
        data = self._fresh(DRIVE, now_ns)
        if data is None or variant is Variant.UNKNOWN:
            return None
        return float(self._read[variant][DRIVE](data)["Speed"])

    def _fastest_wheel_mps(self, variant: Variant, now_ns: int) -> float | None:
        wheels = self._wheels_mps(variant, now_ns)
        # Each separately: a wheel forward and one backward are no standstill.
        return None if wheels is None else max(map(abs, wheels))

    def _wheels_mps(self, variant: Variant, now_ns: int) -> tuple[float, float] | None:
        """Rear left and rear right, forward positive."""
        data = self._fresh(WHEEL_SPEED, now_ns)
        if data is None or variant is Variant.UNKNOWN:
            return None
        speeds = self._read[variant][WHEEL_SPEED](data)
        return (float(speeds["RearLeftSpeed"]), float(speeds["RearRightSpeed"])) if speeds["Valid"] else None

    def _fresh(self, name: str, now_ns: int) -> bytes | None:
        latest = self._latest.get(name)
        if latest is None or now_ns - latest[1] > self._silence_ns[name]:
            return None
        return latest[0]

    def _body(self, data: bytes) -> Signals:
        return self._read[Variant.COARSE][BODY](data)


_GEARS: Final = {gear.value: gear for gear in GearPosition}
_MODES: Final = {mode.value: mode for mode in Mode}


def _mode(body: Signals) -> Mode:
    """Return the mode in a body frame; eight zero bytes would read auto, but are not valid."""
    return _MODES.get(str(body["Mode"]), Mode.UNDEFINED) if body["Valid"] else Mode.UNDEFINED
