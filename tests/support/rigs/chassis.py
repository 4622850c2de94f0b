"""A virtual chassis on the bench: commands in by name, feedback out by name."""

from gateway.chassis.cruiser.frames import load
from gateway.chassis.frame import Frame
from gateway.chassis.layout import Decoded, Encoder, FrameDecoder, Value
from gateway.choice.chassis import CHASSIS
from gateway.sim.body import NOMINAL, Conditions
from gateway.sim.disturbances import FaultLine, parse
from gateway.sim.model import VirtualChassis
from schemas.messages import Variant

MS = 1_000_000
S = 1_000_000_000

ENABLES = ("Auto_GearCmd", "Auto_SteeringCmd", "Auto_DriveCmd", "Auto_BrakingCmd", "Auto_ParkingCmd")


def fault_line(text: str) -> FaultLine:
    line = parse(text)
    assert isinstance(line, FaultLine), line
    return line


class ChassisRig:
    """Time, and the latest feedback of each name."""

    def __init__(
        self,
        variant: Variant = Variant.COARSE,
        rate_multiplier: float = 1.0,
        conditions: Conditions = NOMINAL,
    ) -> None:
        layout = load(variant)
        self.chassis = VirtualChassis(CHASSIS, variant, 0, rate_multiplier=rate_multiplier, conditions=conditions)
        self.encoder = Encoder(layout)
        self.decoder = FrameDecoder(layout)
        self.now_ns = 0
        self.seen: dict[str, dict[str, Value]] = {}

    def send(self, name: str, **values: Value) -> None:
        self.chassis.receive(self.encoder.encode(name, values, 0), self.now_ns)

    def command(
        self, gear: str = "neutral", speed_mps: float = 0.0, angle_deg: float = 0.0, **others: Value
    ) -> None:
        """The five frames of auto mode, all enabled; ``pedal_percent`` and ``park`` besides."""
        self.send("Auto_GearCmd", Enable=True, TargetGear=gear)
        self.send("Auto_SteeringCmd", Enable=True, TargetAngle=angle_deg)
        self.send("Auto_DriveCmd", Enable=True, TargetVelocity=speed_mps)
        self.send("Auto_BrakingCmd", Enable=True, BrakePedal=others.get("pedal_percent", 0.0))
        self.send("Auto_ParkingCmd", Enable=True, ParkingRequest=others.get("park", False))

    def fault(self, text: str) -> None:
        self.chassis.inject(fault_line(text), self.now_ns)

    def run(self, seconds: float) -> list[Frame]:
        self.now_ns += round(seconds * S)
        frames = self.chassis.advance(self.now_ns)
        for frame in frames:
            decoded = self.decoder.decode(frame)
            if isinstance(decoded, Decoded):
                self.seen[decoded.layout.name] = decoded.signals
        return frames

    def named(self, name: str, frames: list[Frame]) -> list[Frame]:
        """The frames with this name's identifier."""
        can_id = load(Variant.COARSE).messages[name].can_id
        return [frame for frame in frames if frame.can_id == can_id]

    def counters(self, name: str, frames: list[Frame]) -> list[int]:
        return [frame.data[6] >> 4 for frame in self.named(name, frames)]

    @property
    def speed_mps(self) -> float:
        return self.chassis.state.speed_mps
