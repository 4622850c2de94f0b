"""Frames for tests: a chassis that stands still, as it would send them."""

from collections.abc import Iterator, Mapping

from gateway.chassis.cruiser.frames import load
from gateway.chassis.frame import Frame
from gateway.chassis.layout import Encoder, Value
from schemas.messages import Variant

MS = 1_000_000
WALL_NS = 1_700_000_000_000_000_000
CHALLENGE = b"\1\2\3\4\5\6\7\10"

STANDING: dict[str, dict[str, Value]] = {
    "Auto_GearFeedBack": {"GearPosition": "park"},
    "Auto_SteeringFeedBack": {"Angle": 0.0},
    "Auto_DriveFeedBack": {"Speed": 0.0},
    "Auto_BrakingFeedBack": {"BrakingStatus": "released"},
    "Auto_ParkingFeedBack": {"ParkingStatus": "applied"},
    "Auto_WheelSpdFeedback": {"Valid": True, "RearLeftSpeed": 0.0, "RearRightSpeed": 0.0},
    "Auto_WheelPulseFeedback": {"Valid": True},
    "Auto_MileageAndBodyFeedback": {"Valid": True, "TotalMileage": 1.5, "Mode": "stop"},
    "Auto_LightFeedback": {},
    "Auto_SpeakerFeedback": {},
}


class Feedback:
    def __init__(self, variant: Variant) -> None:
        self._encoder = Encoder(load(variant))
        self._alive = dict.fromkeys(STANDING, 0)

    def frame(self, name: str, values: Mapping[str, Value] | None = None, wall_ns: int = WALL_NS) -> Frame:
        """The next frame of this name; other signals have the values of a standing chassis."""
        counter = self._alive[name]
        self._alive[name] = (counter + 1) % 16
        return self._encoder.encode(name, STANDING[name] | dict(values or {}), counter, wall_ns)

    def all(self) -> Iterator[Frame]:
        for name in STANDING:
            yield self.frame(name)

    def second(self) -> Iterator[tuple[int, Frame]]:
        """One second of a standing chassis: 630 frames, each with its due time in ns."""
        layout = load(Variant.COARSE)
        for at_ms in range(0, 1000, 10):
            for name in STANDING:
                if at_ms * MS % layout.messages[name].period_ns == 0:
                    yield at_ms * MS, self.frame(name, wall_ns=WALL_NS + at_ms * MS)
