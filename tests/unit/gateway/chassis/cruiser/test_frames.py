"""From an actuation to frames."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.chassis.cruiser.bursts import FrameMaker
from gateway.chassis.cruiser.frames import MOTION_FRAMES, load
from gateway.chassis.frame import Frame
from gateway.chassis.layout import Decoded, FrameDecoder
from gateway.chassis.port import AT_REST, Actuation, AuxiliaryFrame
from schemas.messages import GearPosition, Variant
from tests.support.strategies import VARIANTS

FULL = Actuation(True, GearPosition.REVERSE, 2.222, -24.0, parking=False)  # noqa: FBT003


def signals(frames: list[Frame], variant: Variant) -> dict[str, dict[str, object]]:
    """What the DBC reads from them."""
    decoder = FrameDecoder(load(variant))
    read: dict[str, dict[str, object]] = {}
    for frame in frames:
        decoded = decoder.decode(frame)
        assert isinstance(decoded, Decoded)
        read[decoded.layout.name] = dict(decoded.signals)
    return read


@pytest.mark.parametrize("variant", VARIANTS)
def test_five_frames_in_their_order(variant: Variant) -> None:
    """Gear, steering, drive, braking, parking: each with its enable and its value, checksum last."""
    read = signals(FrameMaker().make(FULL, [], variant), variant)
    assert tuple(read) == MOTION_FRAMES
    assert [values["Enable"] for values in read.values()] == [True] * 5
    assert read["Auto_GearCmd"]["TargetGear"] == "reverse"
    assert read["Auto_SteeringCmd"]["TargetAngle"] == pytest.approx(-24, abs=0.044)
    assert read["Auto_DriveCmd"]["TargetVelocity"] == pytest.approx(2.2 if variant is Variant.COARSE else 2.222)
    assert read["Auto_BrakingCmd"]["BrakePedal"] == 0
    assert read["Auto_ParkingCmd"]["ParkingRequest"] is False


def test_at_rest_all_is_off_but_the_parking_brake() -> None:
    """Disabled, neutral, parked."""
    read = signals(FrameMaker().make(AT_REST, [], Variant.COARSE), Variant.COARSE)
    assert [values["Enable"] for values in read.values()] == [False] * 5
    assert read["Auto_GearCmd"]["TargetGear"] == "neutral"
    assert read["Auto_ParkingCmd"]["ParkingRequest"] is True


def test_in_an_unknown_variant_the_speed_is_zero() -> None:
    """Which is the same in both; the rest of a stop goes out all the same."""
    frames = FrameMaker().make(FULL, [], Variant.UNKNOWN)
    for variant in VARIANTS:
        assert signals(frames, variant)["Auto_DriveCmd"]["TargetVelocity"] == 0
        assert signals(frames, variant)["Auto_GearCmd"]["TargetGear"] == "reverse"


@given(speed_mps=st.floats(0, 2.222), angle_deg=st.floats(-24, 24), variant=st.sampled_from(VARIANTS))
def test_rounding_never_goes_beyond_what_is_asked(speed_mps: float, angle_deg: float, variant: Variant) -> None:
    """Down to the bit, and toward straight ahead; by less than a bit."""
    made = FrameMaker().make(Actuation(True, GearPosition.DRIVE, speed_mps, angle_deg), [], variant)  # noqa: FBT003
    bit_mps = 0.04 if variant is Variant.COARSE else 0.001
    read = signals(made, variant)
    told_mps = float(str(read["Auto_DriveCmd"]["TargetVelocity"]))
    told_deg = float(str(read["Auto_SteeringCmd"]["TargetAngle"]))
    assert speed_mps - bit_mps < told_mps <= speed_mps + 1e-6 * bit_mps + 1e-12
    # The wire's 0 deg is 0.00064 deg off: 90 is no whole number of bits.
    assert abs(angle_deg) - 0.0447 < abs(told_deg) <= abs(angle_deg) + 0.0007


@given(bits=st.integers(0, 55))
def test_a_whole_number_of_bits_is_that_number(bits: int) -> None:
    """And not the one below."""
    frame = FrameMaker().make(Actuation(True, GearPosition.DRIVE, bits * 0.04), [], Variant.COARSE)[0]  # noqa: FBT003
    assert frame.data[1] == bits


def test_counters_rise_with_what_was_sent_and_only_with_that() -> None:
    """+1 for each frame of an identifier, 15 wraps to 0; what was not sent is made again with the same counter."""
    maker = FrameMaker()
    horn = AuxiliaryFrame("Auto_SpeakerCmd", {"Horn": True})
    for sent in range(40):
        frames = maker.make(AT_REST, [horn] if sent % 2 else [], Variant.COARSE)
        assert {frame.data[6] >> 4 for frame in frames[:5]} == {sent % 16}
        again = maker.make(AT_REST, [horn] if sent % 2 else [], Variant.COARSE)
        assert again == frames
        maker.sent(frames)
    assert maker.counters["Auto_SpeakerCmd"] == 20 % 16
    maker.sent(maker.make(AT_REST, [], Variant.COARSE)[:2])
    assert [maker.counters[name] for name in MOTION_FRAMES] == [9, 9, 8, 8, 8]
    assert maker.counters["Auto_LightCmd"] == 0
