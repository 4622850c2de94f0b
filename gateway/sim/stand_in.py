"""The chassis as it would have answered to other commands. Pure.

A recorded run holds the chassis's answers to the recorded commands. As soon as another run of the arbiter
commands something else, those answers no longer fit: this shows frames in their place. They come at
the recorded times, with the recorded alive counters, and what was lost, late or broken stays so; speed, steering,
gear, brakes and mode are those of the virtual chassis, which receives the other commands. What people and the
surroundings did stays as recorded: the bumpers, and all that the remote control does.
"""

from __future__ import annotations

from typing import Final

from gateway.chassis.cruiser.layout import load
from gateway.chassis.decode import Decoded, FrameDecoder, Signals, check
from gateway.chassis.encode import Encoder, checksum
from gateway.chassis.frame import Frame
from gateway.sim.model import VirtualChassis
from gateway.telemetry.state import signed_speed_mps
from schemas.messages import Drive, Gear, GearPosition, Mode, Variant, WheelSpeed

BODY: Final = "Auto_MileageAndBodyFeedback"
_BUMPERS: Final = ("FrontBumper", "RearBumper")
_COUNTER_BYTE: Final = 6


class StandIn:
    """Shows recorded frames as they would have been.

    Args:
        variant: of the chassis that was recorded; not UNKNOWN.
    """

    def __init__(self, variant: Variant) -> None:
        self._layout = load(variant)
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
        """Frames are shown otherwise than recorded."""
        return self._chassis is not None

    @property
    def stands(self) -> bool:
        """Neither the recorded chassis nor the one in its place moves."""
        own = self._chassis
        return self._speed_mps() == 0 and (own is None or own.state.speed_mps == 0)

    def begin(self, now_ns: int) -> None:
        """Begin to simulate the chassis, from its last recorded state: its commands differ from here on."""
        if self._chassis is None:
            chassis = self._chassis = VirtualChassis(self._layout, now_ns)
            for frame in self._heard.values():
                chassis.receive(frame, now_ns)
            self._adopt(chassis)
            self._own.clear()

    def end(self) -> None:
        """The recorded frames are true again."""
        self._chassis = None

    def hear(self, frame: Frame, now_ns: int) -> None:
        """A command frame that the chassis got in the other run."""
        self._heard[frame.can_id] = frame
        if self._chassis is not None:
            self._chassis.receive(frame, now_ns)

    def show(self, frame: Frame, now_ns: int) -> Frame:
        """The frame in place of a recorded one."""
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
            # Whoever holds the transmitter drives as recorded, and the chassis is where they took it.
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
        """Puts the chassis where the recorded frames say that it is."""
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
    """The shown frame with the recorded one's alive counter and time."""
    data = bytearray(shown.data)
    data[_COUNTER_BYTE] = data[_COUNTER_BYTE] & 0x0F | recorded.data[_COUNTER_BYTE] & 0xF0
    data[7] = checksum(data)
    return Frame(recorded.can_id, bytes(data), recorded.wall_ns)
