"""From an actuation to frames, their layouts against the DBC files, and which firmware variant it is."""

from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.chassis.cruiser import frames as layout_module
from gateway.chassis.cruiser.bursts import FrameMaker
from gateway.chassis.cruiser.frames import MOTION_FRAMES, StandstillEvidence, load
from gateway.chassis.cruiser.layout_file import FILE, layouts_text
from gateway.chassis.frame import FaultKind, Frame
from gateway.chassis.layout import Decoded, Encoder, FrameDecoder
from gateway.chassis.port import AT_REST, Actuation, AuxiliaryFrame
from gateway.chassis.supervision import VariantDetector
from schemas.cruiser import dbc_text
from schemas.messages import GearPosition, Variant
from tests.support.strategies import VARIANTS

FULL = Actuation(True, GearPosition.REVERSE, 2.222, -24.0, parking=False)  # noqa: FBT003


def signals(frames: list[Frame], variant: Variant) -> dict[str, dict[str, object]]:
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


@pytest.fixture
def _read_anew() -> Iterator[None]:
    load.cache_clear()
    yield
    load.cache_clear()


def test_the_file_is_current() -> None:
    """``make generate`` writes it."""
    assert FILE.read_text("utf-8") == layouts_text()


@pytest.mark.usefixtures("_read_anew")
def test_a_layout_of_another_dbc_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    """Somebody changed a scale in the DBC beside it: the gateway does not start with the former one."""
    changed = dbc_text(Variant.FINE).replace("(0.001,0)", "(0.002,0)")
    assert changed != dbc_text(Variant.FINE)
    monkeypatch.setattr(layout_module, "dbc_text", lambda _: changed)
    with pytest.raises(ValueError, match=r"was not made from this cruiser-fine\.dbc; run 'make generate'"):
        load(Variant.FINE)


COARSE_STANDING = bytes.fromhex("01c800c800000001")
FINE_STANDING = bytes.fromhex("0100800080000001")


def wheels(variant: Variant, left_mps: float, right_mps: float) -> bytes:
    values: dict[str, float | bool] = {"Valid": True, "RearLeftSpeed": left_mps, "RearRightSpeed": right_mps}
    return Encoder(load(variant)).encode("Auto_WheelSpdFeedback", values, 0).data


@pytest.mark.parametrize(("data", "variant"), [(COARSE_STANDING, Variant.COARSE), (FINE_STANDING, Variant.FINE)])
def test_a_frame_with_a_bit_that_the_variant_does_not_have_is_no_evidence(data: bytes, variant: Variant) -> None:
    """It is another layout, whose speeds may lie elsewhere."""
    evidence = StandstillEvidence()
    signals = load(variant).messages["Auto_WheelSpdFeedback"].signals
    used = {signal.start_bit + bit for signal in signals for bit in range(signal.length)}
    unused = set(range(64)) - used
    assert len(unused) == {Variant.COARSE: 33, Variant.FINE: 19}[variant]
    for bit in unused:
        strange = (int.from_bytes(data, "little") | 1 << bit).to_bytes(8, "little")
        assert evidence.of(strange) is Variant.UNKNOWN, bit


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("speed_mps", [-2.222, -0.5, -0.12, 0.12, 0.5, 2.222])
def test_a_moving_robot_is_no_evidence(variant: Variant, speed_mps: float) -> None:
    """Only a standing robot tells; an invalid frame does not either."""
    evidence = StandstillEvidence()
    assert evidence.of(wheels(variant, speed_mps, speed_mps)) is Variant.UNKNOWN
    assert evidence.of(wheels(variant, 0.0, speed_mps)) is Variant.UNKNOWN
    assert evidence.of(b"\x00" + wheels(variant, 0, 0)[1:]) is Variant.UNKNOWN


FRAMES = {"c": COARSE_STANDING, "f": FINE_STANDING, "m": wheels(Variant.COARSE, 1, 1)}
"""A standing robot in either variant, and a moving one."""


@pytest.mark.parametrize(
    ("configured", "frames", "found", "is_contradicted", "faults"),
    [
        (Variant.UNKNOWN, "cccc", Variant.UNKNOWN, False, 0),
        (Variant.UNKNOWN, "ccccmcccc", Variant.UNKNOWN, False, 0),
        (Variant.UNKNOWN, "ccccc", Variant.COARSE, False, 0),
        (Variant.UNKNOWN, "fffff", Variant.FINE, False, 0),
        # A chassis that was changed; else the configured variant stays, and is in doubt.
        (Variant.UNKNOWN, "fffffccccc", Variant.COARSE, False, 5),
        (Variant.FINE, "", Variant.FINE, False, 0),
        (Variant.FINE, "ccccc", Variant.FINE, True, 5),
        (Variant.FINE, "cccccfffff", Variant.FINE, False, 5),
        # The bus was away, and another chassis may be on it.
        (Variant.UNKNOWN, "fffff-", Variant.UNKNOWN, False, 0),
        (Variant.COARSE, "ccccc-", Variant.COARSE, False, 0),
    ],
)
def test_five_frames_in_a_row_decide(
    configured: Variant, frames: str, found: Variant, *, is_contradicted: bool, faults: int
) -> None:
    """Each frame of another variant is a fault; "-" is a reset."""
    detector = VariantDetector(configured, StandstillEvidence())
    seen = [detector.receive(FRAMES[one]) for one in frames if one in FRAMES]
    if frames.endswith("-"):
        detector.reset()
    assert seen.count(FaultKind.VARIANT_CONTRADICTED) == faults
    assert (detector.variant, detector.contradicted) == (found, is_contradicted)
    assert detector.confirmed is (frames[-5:] in {"ccccc", "fffff"} and not is_contradicted)
