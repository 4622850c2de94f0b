"""The chassis as the arbiter sees it, made from telemetry: the only link between the two flows. Pure."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import TypeVar

from gateway.chassis.cruiser.frames import (
    BODY,
    DRIVE,
    GEAR,
    PARKING,
    STEERING,
    WHEEL_PULSE,
    WHEEL_SPEED,
)
from gateway.chassis.odometry import DeadReckoning, signed_speed_mps, wrapped
from gateway.chassis.port import ChassisState, FeedbackRow
from gateway.chassis.supervision import VariantDetector, silence_ns
from schemas.can_word import COUNTER_SPAN
from schemas.cruiser import TURNING_RAW_MIN
from schemas.messages import (
    Body,
    ControllerState,
    Drive,
    Feedback,
    Gear,
    GearPosition,
    Mode,
    Parking,
    ParkingStatus,
    Steering,
    Variant,
    WheelPulse,
    WheelSpeed,
)
from schemas.settings import (
    CREEP_FRAME_PULSES,
    CREEP_PAUSE_FRAMES,
    CREEP_PULSES,
    PULSES_MOVING_FRAMES,
    PULSES_STEADY,
)

_Kind = TypeVar("_Kind", bound=Feedback)


class ChassisTracker:
    """Makes the chassis's state from the newest feedback, each tick."""

    def __init__(self, streams: Iterable[FeedbackRow], detector: VariantDetector, required: Iterable[str]) -> None:
        """Start without feedback. Without the ``required`` frames the robot is not commanded."""
        self._streams = {stream.layout.name: stream for stream in streams}
        self._required = {name: self._streams[name] for name in required}
        self._encoders = Encoders()
        self._hits = [False, False]
        self._detector = detector
        # A frame marked as not valid may last as long as a missing one.
        self._patience_ns = {
            name: silence_ns(self._streams[name].layout.period_ns) for name in (WHEEL_SPEED, BODY)
        }
        self._valid_ns = dict.fromkeys(self._patience_ns, 0)

    def note_hits(self) -> None:
        body = self._latest(BODY, Body)
        if body is not None:
            self._hits[0] |= body.front_bumper
            self._hits[1] |= body.rear_bumper

    def follow(self, message: Feedback | None, odometry: DeadReckoning) -> None:
        if isinstance(message, Drive):
            wheels, gear = self._latest(WHEEL_SPEED, WheelSpeed), self._latest(GEAR, Gear)
            steering = self._latest(STEERING, Steering)
            angle_deg = None if steering is None else steering.angle_deg
            odometry.move(message.time_ns, signed_speed_mps(message, wheels, gear), angle_deg)
        elif isinstance(message, WheelPulse) and message.valid:
            odometry.count(message.time_ns, message.rear_left_pulses, message.rear_right_pulses)

    def state(
        self, controller: ControllerState, variant: Variant, commander_ns: int | None, now_ns: int
    ) -> ChassisState:
        wheels, body = self._latest(WHEEL_SPEED, WheelSpeed), self._latest(BODY, Body)
        drive, gear = self._latest(DRIVE, Drive), self._latest(GEAR, Gear)
        steering = self._latest(STEERING, Steering)
        (front, rear), self._hits = self._hits, [False, False]
        parking = self._latest(PARKING, Parking)
        return ChassisState(
            controller=controller,
            missing=tuple(self._missing(wheels, body, now_ns)),
            faulty=tuple(self._faulty(now_ns)),
            absurd=tuple(self._absurd(now_ns)),
            variant=variant,
            confirmed=self._detector.confirmed,
            mode=body.mode if body is not None else Mode.UNDEFINED,
            gear=gear.gear_position if gear is not None else GearPosition.UNDEFINED,
            brake=parking.parking_status if parking is not None else ParkingStatus.UNDEFINED,
            speed_mps=drive.speed_mps if drive is not None else None,
            wheel_speed_mps=_mean_mps(wheels),
            fastest_wheel_mps=_fastest_mps(wheels),
            turns=self._turns(now_ns),
            pulses=self._encoders.direction(self._latest(WHEEL_PULSE, WheelPulse)),
            creeps=self._encoders.creeps,
            angle_deg=steering.angle_deg if steering is not None else None,
            front_bumper=front or (_bumper(body, body.front_bumper) if body is not None else None),
            rear_bumper=rear or (_bumper(body, body.rear_bumper) if body is not None else None),
            total_mileage_km=body.total_mileage_km if body is not None and body.valid else None,
            commander_ns=commander_ns,
        )

    def _latest(self, name: str, kind: type[_Kind]) -> _Kind | None:
        message = self._streams[name].latest
        return message if isinstance(message, kind) else None

    def _missing(self, wheels: WheelSpeed | None, body: Body | None, now_ns: int) -> Iterable[str]:
        for name, message in ((WHEEL_SPEED, wheels), (BODY, body)):
            if message is not None and message.valid:
                self._valid_ns[name] = now_ns
        for name, stream in self._required.items():
            if stream.supervisor.is_silent or (
                name in self._valid_ns
                and stream.latest is not None
                and now_ns - self._valid_ns[name] > self._patience_ns[name]
            ):
                yield name

    def _faulty(self, now_ns: int) -> Iterable[str]:
        for name, stream in self._required.items():
            supervisor = stream.supervisor
            # This runs for each frame in every tick, and nearly always there was no fault.
            checksums = supervisor.checksums
            if supervisor.alive.has_failed or (checksums.faults and checksums.has_failed(now_ns)):
                yield name

    def _absurd(self, now_ns: int) -> Iterable[str]:
        for name, stream in self._required.items():
            implausible = stream.supervisor.implausible
            if implausible.faults and implausible.has_failed(now_ns):
                yield name

    def _turns(self, now_ns: int) -> bool | None:
        """Return True if the drive feedback is not zero, in any scale; by the wheels if there is none."""
        drive, wheels = self._streams[DRIVE], self._streams[WHEEL_SPEED]
        if drive.data is not None:
            return int.from_bytes(drive.data[1:3], "little") >= TURNING_RAW_MIN
        if drive.supervisor.implausible.has_failed(now_ns):
            # Implausible speeds, as read in a wrong scale, are not zero either.
            return True
        return None if wheels.data is None else self._detector.evidence.turns(wheels.data)


class Encoders:
    """Reads the direction of motion from wheel pulses of unknown length."""

    def __init__(self) -> None:
        self._before: WheelPulse | None = None
        # Counts from one frame to the next, and their periods, because frames may be lost.
        self._counted: deque[tuple[int, int]] = deque(maxlen=PULSES_MOVING_FRAMES)
        self._direction = 0
        # Pulses in one direction while it creeps, and periods since the last of them.
        self._crept = self._pause = 0

    def direction(self, pulses: WheelPulse | None) -> int:
        """1 forward, -1 backward: both wheels together count that way in many frames, steadily; else 0.

        A robot that comes to rest counts slower and slower, and does not roll.
        """
        if pulses is None or not pulses.valid:
            self._before, self._direction, self._crept = None, 0, 0
            self._counted.clear()
        elif pulses != self._before:  # By value: a resumed core has two objects of one frame.
            if self._before is not None:
                count = _counted(pulses, self._before)
                periods = max(1, (pulses.alive_counter - self._before.alive_counter) % COUNTER_SPAN)
                self._counted.append((count, periods))
                self._direction = self._judge()
                self._creep(count, periods)
            self._before = pulses
        return self._direction

    @property
    def creeps(self) -> int:
        """1 forward, -1 backward: both wheels together have counted that way slowly for a while; else 0."""
        return _sign(self._crept) if abs(self._crept) >= CREEP_PULSES else 0

    def _creep(self, count: int, periods: int) -> None:
        self._pause = 0 if count else self._pause + periods
        is_other_way = count * self._crept < 0
        if is_other_way or self._pause >= CREEP_PAUSE_FRAMES or abs(count) > CREEP_FRAME_PULSES * periods:
            self._crept = 0
        else:
            self._crept += count

    def _judge(self) -> int:
        counted = list(self._counted)
        if len(counted) < PULSES_MOVING_FRAMES or len({_sign(count) for count, _ in counted}) > 1:
            return 0
        half = PULSES_MOVING_FRAMES // 2
        earlier, later = _rate(counted[:half]), _rate(counted[half:])
        return _sign(counted[0][0]) if later >= earlier * PULSES_STEADY else 0


def _rate(counted: list[tuple[int, int]]) -> float:
    """Pulses in a period, a magnitude."""
    return abs(sum(count for count, _ in counted)) / sum(periods for _, periods in counted)


def _counted(pulses: WheelPulse, before: WheelPulse) -> int:
    """Return the pulses of both wheels, across the wrap of the signed 16 bits."""
    left = pulses.rear_left_pulses - before.rear_left_pulses
    right = pulses.rear_right_pulses - before.rear_right_pulses
    return wrapped(left) + wrapped(right)


def _sign(number: int) -> int:
    return (number > 0) - (number < 0)


def _mean_mps(wheels: WheelSpeed | None) -> float | None:
    if wheels is None or not wheels.valid:
        return None
    return (wheels.rear_left_speed_mps + wheels.rear_right_speed_mps) / 2


def _fastest_mps(wheels: WheelSpeed | None) -> float | None:
    if wheels is None or not wheels.valid:
        return None
    return max(abs(wheels.rear_left_speed_mps), abs(wheels.rear_right_speed_mps))


def _bumper(body: Body, is_pressed: bool) -> bool | None:  # noqa: FBT001 - a field of the frame
    """A hit counts even in a frame marked as not valid; a clear bumper does not."""
    return is_pressed if body.valid else is_pressed or None
