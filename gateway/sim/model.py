"""The virtual chassis, commands in and feedback out, and a stand-in for a recorded one. No I/O, no clock.

It follows 'How the chassis behaves' of the protocol notes. Where those are silent, it does the plausible thing
that is worst for the gateway: above all it executes the last command indefinitely when commands cease.

A recorded run has the chassis's feedback to the recorded commands. If a rerun commands something else, ``StandIn``
replaces that feedback: at the recorded times, with the recorded alive counters. Lost, late or broken frames stay
so, and bumpers and the remote control stay as recorded.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Final

import msgspec

from gateway.chassis.frame import Frame
from gateway.chassis.layout import ChassisLayout, Decoded, Encoder, FrameDecoder, Signals, Value, check, checksum
from gateway.chassis.odometry import signed_speed_mps
from gateway.chassis.port import Chassis
from gateway.sim.body import FULL_PEDAL_PERCENT, NOMINAL, Conditions, Demand, Motion, StopMode
from gateway.sim.disturbances import Disturbance, Disturbances, FaultLine
from schemas.messages import BrakingStatus, Drive, Gear, GearPosition, Mode, ParkingStatus, Variant, WheelSpeed

Values = Mapping[str, Value]

_CHECKSUM_BYTE: Final = 7
_CHECKSUM_ERROR: Final = 0xA5  # flips bits of a bad checksum


class _Row(msgspec.Struct):
    """State of one feedback message."""

    name: str
    can_id: int
    period_ns: int
    next_ns: int
    sent: int = 0
    counter: int = 0
    frozen: Values | None = None


class FeedbackSender:
    """Makes the feedback frames, in the DBC's order, each at its period."""

    def __init__(self, layout: ChassisLayout, start_ns: int, rate_multiplier: float) -> None:
        self._start_ns = start_ns
        self._rate_multiplier = rate_multiplier
        self._rows = [_Row(message.name, message.can_id, message.period_ns, 0) for message in layout.feedback]
        for row in self._rows:
            self._plan(row)

    @property
    def next_ns(self) -> int:
        return min(row.next_ns for row in self._rows)

    def due(
        self,
        now_ns: int,
        wall_ns: int,
        encoder: Encoder,
        reports: Mapping[str, Callable[[], Values]],
        disturbances: Disturbances,
    ) -> list[Frame]:
        """Return the frames due now; ``reports`` gives the values of each message."""
        frames = []
        for row in self._rows:
            if row.next_ns <= now_ns:
                self._plan(row)
                if disturbances.rebooting:
                    row.counter = 0
                    continue
                data = _data(row, encoder, reports[row.name](), disturbances)
                if data:
                    frames.append(Frame(row.can_id, data, wall_ns))
        return frames

    def _plan(self, row: _Row) -> None:
        # Counted from the start, so that rounding never adds up and periods stay in step.
        row.sent += 1
        row.next_ns = self._start_ns + int(row.sent * row.period_ns / self._rate_multiplier)


def _data(row: _Row, encoder: Encoder, values: Values, disturbances: Disturbances) -> bytes:
    """Return the frame's bytes; none if it is not on the bus."""
    if not disturbances.quiet and disturbances.strike(Disturbance.SILENCE, row.name):
        return b""
    row.frozen = (row.frozen or values) if disturbances.strike(Disturbance.FREEZE, row.name) else None
    values = row.frozen or values
    data = encoder.encode(row.name, values, row.counter).data
    if disturbances.quiet:
        row.counter += 1
        return data
    if disturbances.strike(Disturbance.CHECKSUM, row.name):
        data = data[:_CHECKSUM_BYTE] + bytes([data[_CHECKSUM_BYTE] ^ _CHECKSUM_ERROR])
    if not disturbances.strike(Disturbance.STUCK, row.name):
        row.counter += disturbances.strike(Disturbance.SKIP, row.name) or 1
    return b"" if disturbances.strike(Disturbance.DROP, row.name) else data


_MOTION: Final = ("Auto_GearCmd", "Auto_SteeringCmd", "Auto_DriveCmd", "Auto_BrakingCmd", "Auto_ParkingCmd")
"""Auto mode needs the enable of each."""

_LAMPS: Final = ("Headlamp", "RightIndicator", "LeftIndicator")

_NS_PER_S: Final = 1_000_000_000
_GEARS: Final = {gear.value: gear for gear in (GearPosition.DRIVE, GearPosition.REVERSE)}
_OTHER: Final = {Variant.COARSE: Variant.FINE, Variant.FINE: Variant.COARSE}


class SimulatedState(msgspec.Struct, frozen=True):
    """The true state of the chassis, independent of its frames. For tests and demonstrations."""

    mode: Mode
    variant: Variant
    speed_mps: float  # signed, forward positive
    angle_deg: float
    x_m: float
    y_m: float
    yaw_rad: float
    mileage_m: float
    parking_status: ParkingStatus
    ignored_frames: int  # received frames that were no valid command


class VirtualChassis:
    """A Cruiser. Feed it frames with ``receive``, and call ``advance`` when ``next_due_ns`` has come."""

    def __init__(
        self,
        chassis: Chassis,
        variant: Variant,
        now_ns: int,
        *,
        rate_multiplier: float = 1.0,
        conditions: Conditions = NOMINAL,
    ) -> None:
        """Power up at standstill, parked, without commands; the first frames are due one period later."""
        layout = chassis.layout(variant)
        self._chassis = chassis
        self._first_layout = layout
        self._disturbances = Disturbances(tuple(message.name for message in layout.feedback))
        self._feedback = FeedbackSender(layout, now_ns, rate_multiplier)
        self._conditions = conditions
        self._motion = Motion(chassis.wheelbase_m, conditions)
        self._motion.parked = True
        self._park_wanted = True
        self._commands: dict[str, Signals] = {}
        self._last_ns = now_ns
        self._mode = Mode.STOP
        self._pedal_percent = 0.0
        self._ignored = 0
        self._reports: dict[str, Callable[[], Values]] = {
            "Auto_GearFeedBack": self._gear,
            "Auto_SteeringFeedBack": self._steering,
            "Auto_DriveFeedBack": self._drive,
            "Auto_BrakingFeedBack": self._braking,
            "Auto_ParkingFeedBack": self._parking,
            "Auto_WheelSpdFeedback": self._wheel_speed,
            "Auto_WheelPulseFeedback": self._wheel_pulse,
            "Auto_MileageAndBodyFeedback": self._body,
            "Auto_LightFeedback": self._light,
            "Auto_SpeakerFeedback": self._speaker,
        }
        self._use_firmware(layout)

    def receive(self, frame: Frame, now_ns: int) -> None:
        """Take a frame from the bus, and ignore it unless it is a valid command.

        A command takes effect at the next instant of ``advance``, as in a control unit with a fixed cycle.
        """
        del now_ns  # Commands have no timeout: their age never matters.
        decoded = self._decoder.decode(frame)
        if isinstance(decoded, Decoded) and not decoded.layout.is_feedback:
            self._commands[decoded.layout.name] = decoded.signals
        else:
            self._ignored += 1

    def adopt(self, *, speed_mps: float, angle_deg: float, gear: GearPosition, parked: bool) -> None:
        """Take over this motion, as far as a chassis can."""
        self._motion.adopt(speed_mps=speed_mps, angle_deg=angle_deg, gear=gear, parked=parked)
        self._park_wanted = parked

    def inject(self, line: FaultLine, at_ns: int) -> None:
        self._disturbances.inject(line, at_ns)

    @property
    def next_due_ns(self) -> int:
        """Time of the next instant of ``advance``."""
        return min(self._feedback.next_ns, self._disturbances.next_foreign_ns)

    def advance(self, now_ns: int, wall_ns: int = 0) -> list[Frame]:
        """Advance until now, and return the frames sent meanwhile, in order.

        The result does not depend on how often this is called: the chassis moves from one instant at which a frame
        is due to the next.
        """
        frames: list[Frame] = []
        while (instant_ns := self.next_due_ns) <= now_ns:
            self._live(instant_ns)
            frames += self._feedback.due(instant_ns, wall_ns, self._encoder, self._reports, self._disturbances)
            frames += self._disturbances.foreign_frames(instant_ns, wall_ns)
        return frames

    @property
    def state(self) -> SimulatedState:
        motion = self._motion
        return SimulatedState(
            mode=self._mode,
            variant=self._layout.variant,
            speed_mps=motion.speed_mps,
            angle_deg=motion.angle_deg,
            x_m=motion.x_m,
            y_m=motion.y_m,
            yaw_rad=motion.yaw_rad,
            mileage_m=motion.mileage_m,
            parking_status=self._parking_status,
            ignored_frames=self._ignored,
        )

    # Commands.

    def _live(self, instant_ns: int) -> None:
        self._disturbances.advance(instant_ns)
        firmware = self._disturbances.firmware
        wanted = self._first_layout if firmware is None else self._chassis.layout(firmware)
        if wanted is not self._layout:
            self._use_firmware(wanted)
        self._motion.conditions = self._disturbances.conditions(self._conditions)
        demand = self._demand()
        self._park_wanted = demand.parked
        self._pedal_percent = demand.pedal_percent
        self._motion.step(demand, (instant_ns - self._last_ns) / _NS_PER_S)
        self._last_ns = instant_ns
        if self._flag("Auto_OdometerCmd", "Enable") and self._flag("Auto_OdometerCmd", "ClearMileage"):
            self._motion.mileage_m = 0.0

    def _demand(self) -> Demand:
        if self._disturbances.rebooting:
            self._commands.clear()
            self._mode = Mode.STOP
            return Demand(GearPosition.NEUTRAL, 0.0, None, 0.0, self._motion.parked)
        if self._disturbances.remote:
            self._mode = Mode.REMOTE
            return self._remote_demand()
        if all(self._flag(name, "Enable") for name in _MOTION):
            self._mode = Mode.AUTO
            return self._auto_demand()
        self._mode = Mode.STOP
        return self._stop_demand()

    def _auto_demand(self) -> Demand:
        speed_mps = self._number("Auto_DriveCmd", "TargetVelocity") * self._drive_scale_ratio(command=True)
        # Park is reserved, and other values have no meaning: they count as neutral, the default.
        gear = _GEARS.get(str(self._commands["Auto_GearCmd"]["TargetGear"]), GearPosition.NEUTRAL)
        return Demand(
            gear=gear,
            speed_mps=speed_mps,
            angle_deg=self._number("Auto_SteeringCmd", "TargetAngle"),
            pedal_percent=self._number("Auto_BrakingCmd", "BrakePedal"),
            parked=self._flag("Auto_ParkingCmd", "ParkingRequest"),
        )

    def _remote_demand(self) -> Demand:
        sticks = self._disturbances.sticks
        if not sticks.speed_mps:
            return self._standstill(parked=False, angle_deg=sticks.angle_deg)
        gear = GearPosition.DRIVE if sticks.speed_mps > 0 else GearPosition.REVERSE
        return Demand(gear, abs(sticks.speed_mps), sticks.angle_deg, 0.0, parked=False)

    def _stop_demand(self) -> Demand:
        if self._conditions.stop_mode is StopMode.BRAKES:
            return self._standstill(parked=self._park_wanted)
        parked = self._park_wanted or self._conditions.stop_mode is StopMode.PARKS
        return Demand(GearPosition.NEUTRAL, 0.0, None, 0.0, parked)

    def _standstill(self, *, parked: bool, angle_deg: float | None = None) -> Demand:
        """Brake by the motor in gear, and hold; in neutral the robot would roll."""
        gear, speed_mps = self._motion.gear, self._motion.speed_mps
        if gear is GearPosition.NEUTRAL and speed_mps:
            gear = GearPosition.DRIVE if speed_mps > 0 else GearPosition.REVERSE
        return Demand(gear, 0.0, angle_deg, 0.0, parked)

    def _flag(self, message: str, signal: str) -> bool:
        signals = self._commands.get(message)
        return signals is not None and signals[signal] is True

    def _number(self, message: str, signal: str) -> float:
        return float(self._commands[message][signal])

    def _use_firmware(self, layout: ChassisLayout) -> None:
        self._layout = layout
        self._decoder = FrameDecoder(layout)
        self._encoder = Encoder(layout)
        own = layout.messages["Auto_DriveCmd"].signal("TargetVelocity").scale
        other = (
            self._chassis.layout(_OTHER[layout.variant]).messages["Auto_DriveCmd"].signal("TargetVelocity").scale
        )
        self._other_scale_ratio = other / own

    def _drive_scale_ratio(self, *, command: bool) -> float:
        """Return the factor for a drive speed: 1, unless the chassis uses the other variant's scale."""
        if not self._disturbances.wrong_scale:
            return 1.0
        return self._other_scale_ratio if command else 1 / self._other_scale_ratio

    # Feedback.

    @property
    def _gear_position(self) -> GearPosition:
        return GearPosition.PARK if self._motion.parked else self._motion.gear

    @property
    def _braking_status(self) -> BrakingStatus:
        if self._pedal_percent >= FULL_PEDAL_PERCENT:
            return BrakingStatus.FULLY_BRAKED
        return BrakingStatus.BRAKING if self._pedal_percent > 0 else BrakingStatus.RELEASED

    @property
    def _parking_status(self) -> ParkingStatus:
        return ParkingStatus.APPLIED if self._motion.parked else ParkingStatus.RELEASED

    def _shown(self, message: str, signal: str, value: float) -> float:
        """Clamp a value to the signal's range: a robot may roll faster than its frame can show."""
        limits = self._layout.messages[message].signal(signal)
        return max(limits.minimum, min(limits.maximum, value))

    def _active(self, command: str) -> bool:
        return self._mode is not Mode.REMOTE and self._flag(command, "Enable")

    def _gear(self) -> Values:
        return {"Active": self._active("Auto_GearCmd"), "GearPosition": self._gear_position.value}

    def _steering(self) -> Values:
        return {"Active": self._active("Auto_SteeringCmd"), "Angle": self._motion.angle_deg}

    def _drive(self) -> Values:
        speed_mps = abs(self._motion.speed_mps) * self._drive_scale_ratio(command=False)
        shown_mps = self._shown("Auto_DriveFeedBack", "Speed", speed_mps)
        return {"Active": self._active("Auto_DriveCmd"), "Speed": shown_mps}

    def _braking(self) -> Values:
        return {"Active": self._active("Auto_BrakingCmd"), "BrakingStatus": self._braking_status.value}

    def _parking(self) -> Values:
        return {"Active": self._active("Auto_ParkingCmd"), "ParkingStatus": self._parking_status.value}

    def _wheel_speed(self) -> Values:
        left_mps, right_mps = self._motion.wheel_speeds_mps
        name = "Auto_WheelSpdFeedback"
        return {
            "Valid": True,
            "RearLeftSpeed": self._shown(name, "RearLeftSpeed", left_mps),
            "RearRightSpeed": self._shown(name, "RearRightSpeed", right_mps),
        }

    def _wheel_pulse(self) -> Values:
        left, right = self._motion.wheel_pulses
        return {"Valid": True, "RearLeftPulses": left, "RearRightPulses": right}

    def _body(self) -> Values:
        # An odometer shows whole metres.
        mileage_km = self._shown(
            "Auto_MileageAndBodyFeedback", "TotalMileage", math.floor(self._motion.mileage_m) / 1000
        )
        return {
            "Valid": True,
            "TotalMileage": mileage_km,
            "FrontBumper": self._disturbances.is_hit("front"),
            "RearBumper": self._disturbances.is_hit("rear"),
            "Mode": self._mode.value,
        }

    def _light(self) -> Values:
        return {name: self._flag("Auto_LightCmd", name) for name in _LAMPS}

    def _speaker(self) -> Values:
        return {"Horn": self._flag("Auto_SpeakerCmd", "Horn")}


BODY: Final = "Auto_MileageAndBodyFeedback"
_BUMPERS: Final = ("FrontBumper", "RearBumper")
_COUNTER_BYTE: Final = 6


class StandIn:
    """Replaces recorded feedback by that of a simulated chassis. The variant must be known."""

    def __init__(self, design: Chassis, variant: Variant) -> None:
        self._design = design
        self._layout = design.layout(variant)
        self._decoder = FrameDecoder(self._layout)
        self._encoder = Encoder(self._layout)
        self._names = {message.can_id: message.name for message in self._layout.feedback}
        self._body = self._layout.messages[BODY].can_id
        self._recorded: dict[str, Frame] = {}
        self._heard: dict[int, Frame] = {}
        self._chassis: VirtualChassis | None = None
        self._own: dict[int, Frame] = {}

    @property
    def is_acting(self) -> bool:
        return self._chassis is not None

    @property
    def stands(self) -> bool:
        """Neither the recorded chassis nor the stand-in moves."""
        own = self._chassis
        return self._speed_mps() == 0 and (own is None or own.state.speed_mps == 0)

    def begin(self, now_ns: int) -> None:
        """Begin to simulate the chassis from its last recorded state, where commands begin to differ."""
        if self._chassis is None:
            chassis = self._chassis = VirtualChassis(self._design, self._layout.variant, now_ns)
            for frame in self._heard.values():
                chassis.receive(frame, now_ns)
            self._adopt(chassis)
            self._own.clear()

    def end(self) -> None:
        self._chassis = None

    def hear(self, frame: Frame, now_ns: int) -> None:
        self._heard[frame.can_id] = frame
        if self._chassis is not None:
            self._chassis.receive(frame, now_ns)

    def show(self, frame: Frame, now_ns: int) -> Frame:
        """Return the frame to use in place of a recorded one."""
        name = self._names.get(frame.can_id)
        if name is None or check(frame) is not None:
            return frame
        self._recorded[name] = frame
        chassis = self._chassis
        if chassis is None:
            return frame
        for own in chassis.advance(now_ns, frame.wall_ns):
            self._own[own.can_id] = own
        if self._is_remote:
            # Under the remote control the chassis moves as recorded.
            self._adopt(chassis)
            return frame
        shown = self._own.get(frame.can_id)
        if shown is None:
            return frame
        return self._as_body(frame, shown) if frame.can_id == self._body else _as_counted(frame, shown)

    @property
    def _is_remote(self) -> bool:
        return self._signals(BODY).get("Mode") == Mode.REMOTE.value

    def _signals(self, name: str) -> Signals:
        frame = self._recorded.get(name)
        decoded = None if frame is None else self._decoder.decode(frame)
        return decoded.signals if isinstance(decoded, Decoded) else {}

    def _as_body(self, recorded: Frame, shown: Frame) -> Frame:
        then, now = self._decoder.decode(recorded), self._decoder.decode(shown)
        if not isinstance(then, Decoded) or not isinstance(now, Decoded):
            return recorded
        values = {signal.name: now.signals[signal.name] for signal in now.layout.payload_signals}
        values |= {name: then.signals[name] for name in _BUMPERS}
        counter = recorded.data[_COUNTER_BYTE] >> 4
        return self._encoder.encode(BODY, values, counter, recorded.wall_ns)

    def _adopt(self, chassis: VirtualChassis) -> None:
        """Set the chassis to its recorded motion."""
        steering, gear = self._signals("Auto_SteeringFeedBack"), self._signals("Auto_GearFeedBack")
        parking = self._signals("Auto_ParkingFeedBack")
        position = gear.get("GearPosition")
        chassis.adopt(
            speed_mps=self._speed_mps(),
            angle_deg=float(steering.get("Angle", 0.0)),
            gear=_gear_of(position),
            parked=parking.get("ParkingStatus") != "released",
        )

    def _speed_mps(self) -> float:
        drive, wheels = self._signals("Auto_DriveFeedBack"), self._signals("Auto_WheelSpdFeedback")
        gear = self._signals("Auto_GearFeedBack")
        if not drive:
            return 0.0
        speed_mps = signed_speed_mps(
            Drive(0, 0, 0, active=True, speed_mps=float(drive["Speed"])),
            WheelSpeed(
                0,
                0,
                0,
                valid=True,
                rear_left_speed_mps=float(wheels["RearLeftSpeed"]),
                rear_right_speed_mps=float(wheels["RearRightSpeed"]),
            )
            if wheels
            else None,
            Gear(0, 0, 0, active=True, gear_position=_gear_of(gear.get("GearPosition"))),
        )
        return 0.0 if speed_mps is None else speed_mps


def _gear_of(position: object) -> GearPosition:
    moving = (GearPosition.DRIVE, GearPosition.REVERSE)
    return next((gear for gear in moving if gear.value == position), GearPosition.NEUTRAL)


def _as_counted(recorded: Frame, shown: Frame) -> Frame:
    """Return the simulated frame with the recorded one's alive counter and time."""
    data = bytearray(shown.data)
    data[_COUNTER_BYTE] = data[_COUNTER_BYTE] & 0x0F | recorded.data[_COUNTER_BYTE] & 0xF0
    data[7] = checksum(data)
    return Frame(recorded.can_id, bytes(data), recorded.wall_ns)
