"""The simulated chassis in place of a recorded one."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.chassis.cruiser.frames import load
from gateway.chassis.frame import Frame
from gateway.chassis.layout import Decoded, Encoder, Value, check, checksum
from gateway.choice.chassis import CHASSIS
from gateway.sim.model import StandIn
from schemas.messages import Variant
from tests.support.rigs.chassis import ENABLES, MS, ChassisRig
from tests.support.strategies import frames as any_frames


class Beside:
    """A driven chassis, and its stand-in with other commands."""

    def __init__(self, variant: Variant = Variant.COARSE) -> None:
        self.rig = ChassisRig(variant)
        self.stand_in = StandIn(CHASSIS, variant)
        self._encoder = Encoder(load(variant))
        self.recorded: dict[str, dict[str, object]] = {}
        self.shown: dict[str, dict[str, object]] = {}
        self.pairs: list[tuple[Frame, Frame]] = []

    def tell(self, speed_mps: float, angle_deg: float = 0.0) -> None:
        values: dict[str, dict[str, Value]] = {
            "Auto_GearCmd": {"TargetGear": "drive"},
            "Auto_SteeringCmd": {"TargetAngle": angle_deg},
            "Auto_DriveCmd": {"TargetVelocity": speed_mps},
            "Auto_BrakingCmd": {"BrakePedal": 0.0},
            "Auto_ParkingCmd": {"ParkingRequest": False},
        }
        for name in ENABLES:
            self.stand_in.hear(self._encoder.encode(name, {"Enable": True, **values[name]}, 0), self.rig.now_ns)

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds * 100)):
            for frame in self.rig.run(0.01):
                shown = self.stand_in.show(frame, self.rig.now_ns)
                self.pairs.append((frame, shown))
                self._read(frame, self.recorded)
                self._read(shown, self.shown)

    def _read(self, frame: Frame, into: dict[str, dict[str, object]]) -> None:
        decoded = self.rig.decoder.decode(frame)
        if isinstance(decoded, Decoded):
            into[decoded.layout.name] = dict(decoded.signals)

    def speeds_mps(self) -> tuple[float, float]:
        """Of the recorded chassis and of its stand-in."""
        recorded, shown = (side["Auto_DriveFeedBack"]["Speed"] for side in (self.recorded, self.shown))
        assert isinstance(recorded, float)
        assert isinstance(shown, float)
        return recorded, shown


@pytest.fixture
def beside() -> Beside:
    beside = Beside()
    beside.rig.command("drive", 1.0, 10.0)
    beside.tell(1.0, 10.0)
    beside.run(3)
    return beside


def test_it_goes_on_from_where_the_chassis_was_and_does_what_the_other_run_tells_it(beside: Beside) -> None:
    assert all(shown is frame for frame, shown in beside.pairs)
    beside.stand_in.begin(beside.rig.now_ns)
    beside.run(0.5)
    assert beside.speeds_mps()[1] == pytest.approx(beside.speeds_mps()[0], abs=0.05)
    assert beside.shown["Auto_SteeringFeedBack"]["Angle"] == pytest.approx(10, abs=0.1)
    for name in ("Auto_GearFeedBack", "Auto_ParkingFeedBack"):
        assert beside.shown[name] == beside.recorded[name]
    beside.pairs.clear()
    beside.tell(0.4, -5.0)
    beside.rig.fault("checksum Auto_DriveFeedBack for 3 frames")
    beside.run(2)
    assert beside.speeds_mps() == pytest.approx((1.0, 0.4), abs=0.05)
    assert beside.shown["Auto_SteeringFeedBack"]["Angle"] == pytest.approx(-5, abs=0.1)
    for frame, shown in beside.pairs:
        assert (shown.can_id, shown.wall_ns, shown.data[6] >> 4) == (
            frame.can_id,
            frame.wall_ns,
            frame.data[6] >> 4,
        )
        assert (check(shown) is None) is (check(frame) is None)
    broken = [(frame, shown) for frame, shown in beside.pairs if check(frame) is not None]
    assert len(broken) == sum(frame is shown for frame, shown in broken) == 3


def test_who_holds_the_transmitter_drives_as_recorded(beside: Beside) -> None:
    beside.stand_in.begin(beside.rig.now_ns)
    beside.tell(0.2)
    beside.rig.fault("transmitter remote for 2s")
    beside.rig.fault("sticks 0.6 -8")
    beside.run(1.9)
    assert beside.speeds_mps() == pytest.approx((0.6, 0.6), abs=0.05)
    beside.rig.fault("sticks 0.6 -8")
    beside.run(0.15)
    beside.run(3)
    assert beside.speeds_mps()[1] == pytest.approx(0.2, abs=0.05)


VALID = st.builds(
    lambda can_id, data: Frame(can_id, data + bytes([checksum(data)])),
    st.sampled_from([message.can_id for message in load(Variant.COARSE).feedback]),
    st.binary(min_size=7, max_size=7),
)


@given(st.lists(any_frames | VALID, max_size=40), st.integers(0, 40))
def test_whatever_was_on_the_bus_is_shown(frames: list[Frame], begins: int) -> None:
    stand_in = StandIn(CHASSIS, Variant.COARSE)
    for number, frame in enumerate(frames):
        if number == begins:
            stand_in.begin(number * 10 * MS)
        assert stand_in.show(frame, number * 10 * MS).can_id == frame.can_id
