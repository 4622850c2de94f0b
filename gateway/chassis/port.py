"""The interface of a chassis: what the arbiter sees and decides, and ``Chassis`` as one value."""

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
    """The chassis, the bus and the guard now. An unknown field is None or UNDEFINED.

    Attributes:
        missing: required feedback frames that never came, are silent, or are marked as not valid.
        faulty: required feedback frames with failed checksums or alive counters.
        absurd: required feedback frames with repeated implausible values.
        variant: the firmware variant in force; UNKNOWN if in doubt.
        confirmed: evidence from the bus agrees with the variant.
        speed_mps: the drive feedback, a magnitude.
        wheel_speed_mps: mean of the rear wheels, signed.
        fastest_wheel_mps: the faster of the two, a magnitude.
        turns: the robot moves, in any scale: the raw drive feedback is not zero, or there is none and the raw
            wheel speeds are not those of standstill.
        pulses: the direction in which the wheel encoders count, 1 forward, -1 backward; 0 at standstill or if
            unknown. Without a known resolution they give no speed.
        creeps: the direction in which they have counted for a while, but not in each frame; 0 if not.
        commander_ns: when another computer's command frame was last received; None if never.
        guard_sends: the guard is stopping the robot in our place.
        guard_stops: number of stops that it has begun since the start.
        guard_says: cause and end of its last stop; empty if none.
        is_behind: frames arrive faster than they can be read, so this state is old.
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
        """Both speeds are known and below the standstill bound."""
        return (
            self.speed_mps is not None
            and self.fastest_wheel_mps is not None
            and self.speed_mps < STANDSTILL_MPS
            and self.fastest_wheel_mps < STANDSTILL_MPS
        )

    @property
    def is_slow(self) -> bool:
        """Both speeds are below the standstill bound, and no encoder counts."""
        return self.reads_zero and not self.pulses

    @property
    def moves(self) -> bool:
        """Drive feedback, wheels or encoders show motion."""
        # The raw drive feedback counts only in doubt of the scale; else a fine one would never be at rest.
        is_scaled = self.confirmed and self.speed_mps is not None
        turns = bool(self.turns) and not is_scaled
        return turns or bool(self.pulses or self.creeps) or (self.fastest_mps or 0.0) > STANDSTILL_MPS

    @property
    def slowest_mps(self) -> float:
        """The lowest measured speed, a magnitude, so that no single faulty sensor sets the robot in motion."""
        return min(self._known_mps, default=0.0)

    @property
    def fastest_mps(self) -> float | None:
        """The highest measured speed, a magnitude; None if unknown."""
        return max(self._known_mps, default=None)

    @property
    def _known_mps(self) -> list[float]:
        return [speed for speed in (self.speed_mps, self.fastest_wheel_mps) if speed is not None]


class AuxiliaryFrame(msgspec.Struct, frozen=True):
    """A frame to send beside the motion, by its name in the DBC, with its signals."""

    name: str
    values: Signals


class FeedbackRow(Protocol):
    """The newest state of one feedback frame."""

    layout: MessageLayout
    latest: Feedback | None
    data: bytes | None
    supervisor: FrameSupervisor


class Tracker(Protocol):
    """Makes the chassis's state from its feedback."""

    def follow(self, message: Feedback | None, odometry: DeadReckoning) -> None:
        """Advance the odometry after a feedback message."""

    def note_hits(self) -> None:
        """Note bumper hits in the newest frame: they count at the next tick, even if a later frame reads clear."""

    def state(
        self, controller: ControllerState, variant: Variant, commander_ns: int | None, now_ns: int
    ) -> ChassisState:
        """Return the chassis's state, without the fields of bus and guard."""


class BurstMaker(Protocol):
    """Makes the frames of a tick.

    Attributes:
        counters: the next alive counter of each command frame, by the frame's name.
        is_torn: the bus accepted only a part of the last burst.
    """

    counters: dict[str, int]
    is_torn: bool

    def make(self, actuation: Actuation, auxiliary: list[AuxiliaryFrame], variant: Variant) -> list[Frame]:
        """Return the frames of this tick: the motion frames, then others that were requested."""

    def restore(self, sent: Mapping[int, int]) -> None:
        """Continue after these counters, by identifier."""

    def sent(self, frames: list[Frame]) -> None:
        """Advance the counters of the frames that were sent, the first ones of a burst."""


class BusGate(Protocol):
    """Admits a burst as a whole or not at all.

    Attributes:
        counters: the last sent alive counter of each identifier.
    """

    counters: dict[int, int]

    def admit(
        self, frames: list[Frame], variant: Variant, now_ns: int, *, stopping: bool = False
    ) -> GateFault | None:
        """Return why these frames must not be sent together, or None if they may."""

    def sent(self, frames: list[Frame], now_ns: int) -> None:
        """Note the frames that were sent, the first ones of an admitted burst."""

    def pause(self) -> None:
        """Note an intended pause."""


class BusView(Protocol):
    """The chassis as the guard reads it from the bus; speeds are magnitudes but for that of the wheels.

    Attributes:
        next_counters: the next counter of each received command frame, by name.
        commander_ns: when a command frame that moves the robot was last received; None if never.
    """

    next_counters: dict[str, int]
    commander_ns: int | None

    def receive(self, frame: Frame, now_ns: int) -> None:
        """Take a frame from the bus."""

    def has_feedback(self, now_ns: int) -> bool:
        """True if any feedback arrives."""

    def is_complete(self, now_ns: int) -> bool:
        """Mode, gear, angle and speed are known, from which a stop begins."""

    def mode(self, now_ns: int) -> Mode:
        """Return the mode; UNDEFINED if unknown, or remote in a single frame only."""

    def gear(self, now_ns: int) -> GearPosition:
        """The gear feedback."""

    def angle_deg(self, now_ns: int) -> float:
        """The steering feedback; straight ahead if there is none."""

    def is_braked(self, now_ns: int) -> bool | None:
        """True if the parking brake reads applied; None if unknown."""

    def stands(self, variant: Variant, now_ns: int) -> bool:
        """The robot was slow at every call in the last 50 ms. False also if that cannot be seen."""

    def moves(self, variant: Variant, now_ns: int) -> bool:
        """True if the robot is seen to move."""

    def slowest_mps(self, variant: Variant, now_ns: int) -> float | None:
        """The lowest measured speed; None without drive feedback or a known scale."""

    def fastest_mps(self, variant: Variant, now_ns: int) -> float | None:
        """The highest measured speed; None if unknown."""

    def wheel_speed_mps(self, variant: Variant, now_ns: int) -> float | None:
        """The mean speed of the wheels, forward positive; None if unknown."""

    def evidence_data(self, now_ns: int) -> bytes | None:
        """The newest evidence frame of the variant; None if silent."""


class Chassis(msgspec.Struct, frozen=True):
    """All in which a chassis differs from others. Built once, for core, guard and simulation.

    Frames are named as in the DBC.

    Attributes:
        dbc_files: the DBC's name, by firmware variant.
        rules: plausible values, each with feedback frame and signal. All rules of a frame must hold.
        evidence, tracker, maker, gate, view: make these parts in their initial state. A gate with ``may_release``
            allows one release of the parking brake in a stop that comes first.
        light: the frame that switches all lamps off.
        lamps: its signals of headlamp, left and right indicator.
        horn, odometer: the frame that switches it off, and the one that sounds or clears it.
        scaled_frames: the feedback frames of speeds, whose layout depends on the variant.
        speed_bit_mps: the smallest speed that a command can carry, by variant.
        scale_ratio: of the coarse variant's speed scale to the fine one's.
        track_m: between the middles of an axle's wheels.
        top_speed_mps, top_angle_deg: limits of the chassis, in either direction.
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
    track_m: float
    wheel_radius_m: float
    top_speed_mps: float
    top_angle_deg: float

    @property
    def common(self) -> ChassisLayout:
        """The layout of the first variant, for frames that are the same in all variants."""
        return self.layout(next(iter(self.dbc_files)))

    def decoder(self, layout: MessageLayout) -> MessageDecoder:
        """The decoder of a feedback frame, which rejects implausible values. Raises KeyError, ValueError."""
        return compile_message(
            layout, [(signal, rule) for name, signal, rule in self.rules if name == layout.name]
        )

    @property
    def hazard(self) -> AuxiliaryFrame:
        """The light frame of a latched robot: both indicators."""
        return msgspec.structs.replace(self.light, values=self.light.values | dict.fromkeys(self.indicators, True))

    @property
    def indicators(self) -> tuple[str, ...]:
        """The indicator signals of the light frame."""
        return self.lamps[1:]


_HAIR: Final = 1e-6
"""Tolerance, in bits, so that a whole number of bits is not rounded to the one below."""


def toward_zero(value: float, scale: float) -> float:
    """Round toward zero to a whole number of bits."""
    return floor(abs(value) / scale + _HAIR) * scale * (-1 if value < 0 else 1)
