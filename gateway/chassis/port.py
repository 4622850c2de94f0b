"""The seam between a chassis and all else: what the arbiter sees and decides, and ``Chassis`` as one value."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from math import floor
from typing import Final, Protocol

import msgspec

from gateway.chassis.frame import Frame, GateFault
from gateway.chassis.layout import ChassisLayout, MessageDecoder, MessageLayout, Rule, Signals, compile_message
from gateway.chassis.odometry import DeadReckoning
from gateway.chassis.supervision import FrameSupervisor, VariantDetector, VariantEvidence
from schemas.messages import ControllerState, Feedback, GearPosition, Mode, ParkingStatus, Variant
from schemas.settings import STANDSTILL_MPS


class Actuation(msgspec.Struct, frozen=True):
    """The five command frames of a tick.

    Attributes:
        enabled: the enables of all five.
        gear: neutral, drive or reverse. Park is reserved and never commanded (manual V2.0, table of gears).
        speed_mps: a magnitude; the gear gives the direction.
        angle_deg: left is positive.
    """

    enabled: bool = False
    gear: GearPosition = GearPosition.NEUTRAL
    speed_mps: float = 0.0
    angle_deg: float = 0.0
    parking: bool = True

    @property
    def signed_speed_mps(self) -> float:
        """Forward is positive."""
        return -self.speed_mps if self.gear is GearPosition.REVERSE else self.speed_mps


AT_REST: Final = Actuation()
"""Disabled, neutral, parked."""


class ChassisState(msgspec.Struct, frozen=True):
    """The chassis, the bus and the guard now. A field that is not known is None or UNDEFINED.

    Attributes:
        missing: required feedback frames that were never seen, are silent, or say that they are not valid.
        faulty: required feedback frames whose checksums or alive counters have failed.
        absurd: required feedback frames whose values this chassis cannot have, again and again.
        variant: the firmware variant in force; UNKNOWN while there is any doubt.
        confirmed: evidence from the bus agrees with the variant.
        speed_mps: the drive feedback, a magnitude.
        wheel_speed_mps: mean of the rear wheels, signed.
        fastest_wheel_mps: the faster of the two, a magnitude.
        turns: the raw drive feedback is not zero, or there is none and the raw wheel speeds are not those of
            standstill: the robot moves, in whatever scale.
        pulses: the direction in which the wheel encoders count, 1 forward, -1 backward; 0 while they stand still
            or are not known. The manual gives no resolution, so they give a direction and no speed.
        creeps: the direction in which they have counted for a while, but not in each frame; 0 if they have not.
        commander_ns: when another computer's command frame was last received; None if never.
        guard_sends: the guard is stopping the robot in our place.
        guard_stops: number of stops that it has begun since the start.
        guard_says: why it last did, and how that ended; empty if it never did.
        is_behind: frames come faster than they can be read, so what is seen is old.
    """

    bus_up: bool = False
    bus_losses: int = 0
    controller: ControllerState = ControllerState.UNKNOWN
    missing: tuple[str, ...] = ()
    faulty: tuple[str, ...] = ()
    absurd: tuple[str, ...] = ()
    variant: Variant = Variant.UNKNOWN
    confirmed: bool = False
    mode: Mode = Mode.UNDEFINED
    gear: GearPosition = GearPosition.UNDEFINED
    brake: ParkingStatus = ParkingStatus.UNDEFINED
    speed_mps: float | None = None
    wheel_speed_mps: float | None = None
    fastest_wheel_mps: float | None = None
    turns: bool | None = None
    pulses: int = 0
    angle_deg: float | None = None
    front_bumper: bool | None = None
    rear_bumper: bool | None = None
    total_mileage_km: float | None = None
    commander_ns: int | None = None
    guarded: bool = False
    guard_sends: bool = False
    guard_stops: int = 0
    guard_says: str = ""
    is_behind: bool = False
    realtime: bool = False
    creeps: int = 0

    @property
    def reads_zero(self) -> bool:
        """Both speeds are known and are those of a standing robot."""
        return (
            self.speed_mps is not None
            and self.fastest_wheel_mps is not None
            and self.speed_mps < STANDSTILL_MPS
            and self.fastest_wheel_mps < STANDSTILL_MPS
        )

    @property
    def is_slow(self) -> bool:
        """Both speeds are those of a standing robot, and no encoder counts."""
        return self.reads_zero and not self.pulses

    @property
    def moves(self) -> bool:
        """Drive feedback, wheels or encoders show a robot that moves, whichever does."""
        # Where the scale is in doubt the raw drive feedback counts; else a fine one would never be at rest.
        is_scaled = self.confirmed and self.speed_mps is not None
        turns = bool(self.turns) and not is_scaled
        return turns or bool(self.pulses or self.creeps) or (self.fastest_mps or 0.0) > STANDSTILL_MPS

    @property
    def slowest_mps(self) -> float:
        """The lowest speed that a sensor shows, a magnitude: no single faulty one sets the robot going."""
        return min(self._known_mps, default=0.0)

    @property
    def fastest_mps(self) -> float | None:
        """The highest speed that a sensor shows, a magnitude; None if none shows any."""
        return max(self._known_mps, default=None)

    @property
    def _known_mps(self) -> list[float]:
        return [speed for speed in (self.speed_mps, self.fastest_wheel_mps) if speed is not None]


class AuxiliaryFrame(msgspec.Struct, frozen=True):
    """A frame to send beside the motion, by its name in the DBC, with its signals."""

    name: str
    values: Signals


class FeedbackRow(Protocol):
    """The newest of one feedback frame, as a tracker reads it."""

    layout: MessageLayout
    latest: Feedback | None
    data: bytes | None
    supervisor: FrameSupervisor


class Tracker(Protocol):
    """Makes the chassis's state of its feedback."""

    def follow(self, message: Feedback | None, odometry: DeadReckoning) -> None:
        """A feedback message came: the odometry goes on with what it, and those beside it, say."""

    def note_hits(self) -> None:
        """A frame came in which a bumper may read hit: that counts at the next tick, whatever comes after it."""

    def state(
        self, controller: ControllerState, variant: Variant, commander_ns: int | None, now_ns: int
    ) -> ChassisState:
        """The chassis now, but for what the loop knows of the bus and the guard."""


class BurstMaker(Protocol):
    """Makes the frames of a tick.

    Attributes:
        counters: the next alive counter of each command frame, by the frame's name.
        is_torn: the bus took only a part of the last burst that it took anything of.
    """

    counters: dict[str, int]
    is_torn: bool

    def make(self, actuation: Actuation, auxiliary: list[AuxiliaryFrame], variant: Variant) -> list[Frame]:
        """Return the frames of this tick: the motion frames, then others that were requested."""

    def restore(self, sent: Mapping[int, int]) -> None:
        """These counters, by identifier, were sent last."""

    def sent(self, frames: list[Frame]) -> None:
        """These were sent, the first of a burst: their counters advance."""


class BusGate(Protocol):
    """Admits a burst as a whole or not at all.

    Attributes:
        counters: the last alive counter of each identifier that was ever sent.
    """

    counters: dict[int, int]

    def admit(
        self, frames: list[Frame], variant: Variant, now_ns: int, *, stopping: bool = False
    ) -> GateFault | None:
        """Return the fault for which these frames must not be sent together, or None if they may."""

    def sent(self, frames: list[Frame], now_ns: int) -> None:
        """These were sent, the first of a burst that was admitted."""

    def pause(self) -> None:
        """Nothing is sent, on purpose."""


class BusView(Protocol):
    """The chassis as the guard reads it from the bus; speeds are magnitudes but for that of the wheels.

    Attributes:
        next_counters: the counter that each received command frame would have next, by its name.
        commander_ns: when a command frame that moves the robot was last received; None if never.
    """

    next_counters: dict[str, int]
    commander_ns: int | None

    def receive(self, frame: Frame, now_ns: int) -> None:
        """A frame came from the bus."""

    def has_feedback(self, now_ns: int) -> bool:
        """Feedback comes."""

    def is_complete(self, now_ns: int) -> bool:
        """All that a stop has to begin from is there: mode, gear, angle and speed."""

    def mode(self, now_ns: int) -> Mode:
        """Return the mode; UNDEFINED if none is reported, or remote in a single frame only."""

    def gear(self, now_ns: int) -> GearPosition:
        """The gear feedback."""

    def angle_deg(self, now_ns: int) -> float:
        """The steering feedback; straight ahead if there is none."""

    def is_braked(self, now_ns: int) -> bool | None:
        """True if the parking brake reads applied; None if it is not reported."""

    def stands(self, variant: Variant, now_ns: int) -> bool:
        """The robot was slow whenever this was asked in the last 50 ms. False also when that cannot be seen."""

    def moves(self, variant: Variant, now_ns: int) -> bool:
        """The robot is seen to move."""

    def slowest_mps(self, variant: Variant, now_ns: int) -> float | None:
        """The lowest speed that a sensor shows; None if there is no drive feedback, or no known scale."""

    def fastest_mps(self, variant: Variant, now_ns: int) -> float | None:
        """The highest speed that a sensor shows; None if none shows any."""

    def wheel_speed_mps(self, variant: Variant, now_ns: int) -> float | None:
        """The mean speed of the wheels, forward positive; None if they do not report it."""

    def evidence_data(self, now_ns: int) -> bytes | None:
        """The newest frame that is evidence of the variant; None if it is silent."""


class Chassis(msgspec.Struct, frozen=True):
    """A chassis: all in which it differs from another. Built once, and handed to core, guard and simulation.

    Frames are named as in the DBC.

    Attributes:
        dbc_files: the DBC's name, by firmware variant.
        rules: of plausible values, each with its feedback frame and signal. All of a frame's must hold.
        evidence, tracker, maker, gate, view: make these parts, each as it is at a start. A gate with
            ``may_release`` admits one release of the parking brake by a stop that it sees first.
        light: the frame that says that all lamps are off.
        lamps: its signals of headlamp, left and right indicator.
        horn, odometer: the frame that is off, and the one that sounds it or clears it.
        scaled_frames: the feedback frames whose layout depends on the variant: those of speeds.
        speed_bit_mps: the smallest speed that a command can carry, by variant.
        scale_ratio: between the speed scales of the coarse variant and of the fine one.
        top_speed_mps, top_angle_deg: the chassis drives no faster and steers no further, either way.
    """

    dbc_files: Mapping[Variant, str]
    dbc_text: Callable[[Variant], str]
    layout: Callable[[Variant], ChassisLayout]
    rules: tuple[tuple[str, str, Rule], ...]
    evidence: Callable[[], VariantEvidence]
    tracker: Callable[[Iterable[FeedbackRow], VariantDetector, Iterable[str]], Tracker]
    maker: Callable[[], BurstMaker]
    gate: Callable[[bool], BusGate]
    view: Callable[[], BusView]
    light: AuxiliaryFrame
    lamps: tuple[str, str, str]
    horn: Mapping[bool, AuxiliaryFrame]
    odometer: Mapping[bool, AuxiliaryFrame]
    motion_frames: tuple[str, ...]
    scaled_frames: tuple[str, ...]
    evidence_frame: str
    bumper_frame: str
    speed_bit_mps: Mapping[Variant, float]
    scale_ratio: float
    wheelbase_m: float
    top_speed_mps: float
    top_angle_deg: float

    @property
    def common(self) -> ChassisLayout:
        """The layout for the frames that are the same in all variants: that of the first."""
        return self.layout(next(iter(self.dbc_files)))

    def decoder(self, layout: MessageLayout) -> MessageDecoder:
        """The decoder of a feedback frame, which rejects implausible values. Raises KeyError, ValueError."""
        return compile_message(
            layout, [(signal, rule) for name, signal, rule in self.rules if name == layout.name]
        )

    @property
    def hazard(self) -> AuxiliaryFrame:
        """The light frame by which a robot says that it is latched: both indicators."""
        return msgspec.structs.replace(self.light, values=self.light.values | dict.fromkeys(self.indicators, True))

    @property
    def indicators(self) -> tuple[str, ...]:
        """The signals of the light frame that blink."""
        return self.lamps[1:]


_HAIR: Final = 1e-6
"""Of a bit, so that a value that is a whole number of bits is not taken for the one below."""


def toward_zero(value: float, scale: float) -> float:
    """Return the value of the nearest whole number of bits that is not beyond it."""
    return floor(abs(value) / scale + _HAIR) * scale * (-1 if value < 0 else 1)
