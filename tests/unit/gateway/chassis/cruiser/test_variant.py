"""Which firmware variant is it?"""

import pytest
from hypothesis import given

from gateway.chassis.cruiser.frames import StandstillEvidence, load
from gateway.chassis.frame import FaultKind
from gateway.chassis.layout import Encoder
from gateway.chassis.supervision import VariantDetector
from schemas.messages import Variant
from tests.support.strategies import VARIANTS, payloads

COARSE_STANDING = bytes.fromhex("01c800c800000001")
FINE_STANDING = bytes.fromhex("0100800080000001")


def wheels(variant: Variant, left_mps: float, right_mps: float) -> bytes:
    values: dict[str, float | bool] = {"Valid": True, "RearLeftSpeed": left_mps, "RearRightSpeed": right_mps}
    return Encoder(load(variant)).encode("Auto_WheelSpdFeedback", values, 0).data


def test_the_standstill_frames_of_the_protocol_notes_are_told_apart() -> None:
    """0xC8 0x00 is coarse, 0x00 0x80 is fine."""
    evidence = StandstillEvidence()
    assert evidence.of(COARSE_STANDING) is Variant.COARSE
    assert evidence.of(FINE_STANDING) is Variant.FINE


@given(data=payloads)
def test_no_frame_is_evidence_for_both(data: bytes) -> None:
    """Whatever the bytes, flipping the order of the question does not change the answer, and it never raises."""
    evidence = StandstillEvidence()
    answer = evidence.of(data)
    for variant in VARIANTS:
        if variant is not answer:
            alone = StandstillEvidence()
            alone._readers = {variant: alone._readers[variant]}
            assert alone.of(data) is Variant.UNKNOWN


@pytest.mark.parametrize(("data", "variant"), [(COARSE_STANDING, Variant.COARSE), (FINE_STANDING, Variant.FINE)])
def test_a_frame_with_a_bit_that_the_variant_does_not_have_is_no_evidence(data: bytes, variant: Variant) -> None:
    """Whatever sets a bit outside the signals is another layout, and its speeds may lie elsewhere too."""
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


@pytest.mark.parametrize(("data", "variant"), [(COARSE_STANDING, Variant.COARSE), (FINE_STANDING, Variant.FINE)])
def test_five_frames_in_a_row_confirm(data: bytes, variant: Variant) -> None:
    """Four do not; a frame without evidence between them begins the row anew."""
    detector = VariantDetector(Variant.UNKNOWN, StandstillEvidence())
    for _ in range(4):
        assert detector.receive(data) is None
    assert detector.variant is Variant.UNKNOWN
    detector.receive(wheels(variant, 1, 1))
    for _ in range(4):
        detector.receive(data)
    assert detector.variant is Variant.UNKNOWN
    detector.receive(data)
    assert detector.variant is variant
    assert detector.confirmed


def test_evidence_against_the_configured_variant_is_a_contradiction() -> None:
    """Each such frame is a fault, five in a row a contradiction, five of the right kind end it."""
    detector = VariantDetector(Variant.FINE, StandstillEvidence())
    faults = [detector.receive(COARSE_STANDING) for _ in range(5)]
    assert faults == [FaultKind.VARIANT_CONTRADICTED] * 5
    assert detector.contradicted
    assert not detector.confirmed
    assert detector.variant is Variant.FINE
    for _ in range(5):
        detector.receive(FINE_STANDING)
    assert detector.confirmed
    assert not detector.contradicted


def test_without_a_configured_variant_the_evidence_decides_again() -> None:
    """A chassis that was changed is found out by five frames; each of them counts as a contradiction."""
    detector = VariantDetector(Variant.UNKNOWN, StandstillEvidence())
    for _ in range(5):
        detector.receive(FINE_STANDING)
    faults = [detector.receive(COARSE_STANDING) for _ in range(5)]
    assert faults == [FaultKind.VARIANT_CONTRADICTED] * 5
    assert detector.variant is Variant.COARSE
    assert not detector.contradicted


def test_a_reset_forgets_what_was_found_but_not_what_was_configured() -> None:
    """After the bus was away another chassis may be on it."""
    detector = VariantDetector(Variant.UNKNOWN, StandstillEvidence())
    for _ in range(5):
        detector.receive(FINE_STANDING)
    detector.reset()
    assert detector.variant is Variant.UNKNOWN
    configured = VariantDetector(Variant.COARSE, StandstillEvidence())
    configured.reset()
    assert configured.variant is Variant.COARSE
    assert not configured.confirmed
