"""Signals to frames."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.chassis.cruiser.frames import load
from gateway.chassis.layout import Decoded, Encoder, MessageLayout, SignalLayout
from schemas.messages import Variant
from tests.support.strategies import LAYOUTS, VARIANTS, identify
from tests.unit.gateway.chassis.test_decode import DECODERS, reference


def physical(signal: SignalLayout) -> st.SearchStrategy[float]:
    """Physical values that fit into the signal."""
    low, high = (0, (1 << signal.length) - 1)
    if signal.is_signed:
        low, high = -(1 << signal.length - 1), (1 << signal.length - 1) - 1
    return st.integers(low, high).map(lambda raw: raw * signal.scale + signal.offset)


@pytest.mark.parametrize("variant", VARIANTS)
@given(data=st.data(), alive=st.integers(0, 15))
def test_every_message_encodes_as_cantools_encodes_it(variant: Variant, data: st.DataObject, alive: int) -> None:
    """On any values that fit, every message has exactly the bytes that cantools makes."""
    for layout in load(variant).messages.values():
        values = {signal.name: data.draw(physical(signal)) for signal in layout.payload_signals}
        frame = Encoder(load(variant)).encode(layout.name, values, alive)
        message = reference(variant).get_message_by_name(layout.name)
        fields: dict[str, Any] = {**values, "AliveCounter": alive, "Checksum": frame.data[7]}
        assert frame.data == message.encode(fields, strict=False)
        assert frame.identifier == message.frame_id


@pytest.mark.parametrize("layout", LAYOUTS, ids=identify)
@given(alive=st.integers(0, 255))
def test_the_alive_counter_has_the_high_nibble_of_byte_6_alone(layout: MessageLayout, alive: int) -> None:
    """The counter takes four bits, 52 to 55, and leaves the low nibble alone; the checksum comes after it.

    Published drivers of this family add 1 to the whole of byte 6, or wrap at 3.
    """
    frame = Encoder(load(Variant.COARSE)).encode(layout.name, {}, alive)
    assert frame.data[6] == (alive % 16) << 4
    assert isinstance(DECODERS[Variant.COARSE].decode(frame), Decoded)


def test_a_signal_that_is_not_named_has_its_start_value() -> None:
    """The default gear is neutral and the default angle 0, as in the manual's examples; all else is zero."""
    encoder = Encoder(load(Variant.COARSE))
    assert encoder.encode("Auto_GearCmd", {"Enable": True}, 0).data == bytes.fromhex("0103000000000002")
    assert encoder.encode("Auto_SteeringCmd", {"Enable": True}, 0).data == bytes.fromhex("0100080000000009")
    assert encoder.encode("Auto_DriveCmd", {"Enable": True}, 0).data == bytes.fromhex("0100000000000001")


def test_the_wheel_speeds_do_not_overlap() -> None:
    """Left and right stand where the table says, 8 and 24 (a published driver computes ``a + b << 8``)."""
    for variant, expected in ((Variant.COARSE, "01e100c800000028"), (Variant.FINE, "01e883008000002a")):
        values: dict[str, float | bool] = {"Valid": True, "RearLeftSpeed": 1.0, "RearRightSpeed": 0.0}
        frame = Encoder(load(variant)).encode("Auto_WheelSpdFeedback", values, 0)
        decoded = DECODERS[variant].decode(frame)
        assert isinstance(decoded, Decoded)
        assert decoded.signals["RearLeftSpeed"] == pytest.approx(1.0)
        assert decoded.signals["RearRightSpeed"] == pytest.approx(0.0)
        assert frame.data[:5].hex() == expected[:10]


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("Auto_DriveCmd", {"TargetVelocity": -0.04}),
        ("Auto_DriveCmd", {"TargetVelocity": 3000.0}),
        ("Auto_SteeringCmd", {"TargetAngle": 90.1}),
        ("Auto_SteeringCmd", {"TargetAngle": -90.1}),
        ("Auto_GearCmd", {"TargetGear": "fast"}),
        ("Auto_GearCmd", {"TargetGear": 8}),
    ],
)
def test_a_value_that_does_not_fit_is_our_own_bug(name: str, values: dict[str, Any]) -> None:
    """No value is wrapped, cut or ignored on its way to the bus, a negative speed included."""
    with pytest.raises(ValueError, match=next(iter(values))):
        Encoder(load(Variant.COARSE)).encode(name, values, 0)


def test_an_unknown_signal_is_our_own_bug() -> None:
    """A misspelt signal raises instead of being left out."""
    with pytest.raises(KeyError, match="Speed"):
        Encoder(load(Variant.COARSE)).encode("Auto_DriveCmd", {"Speed": 1.0}, 0)


@given(st.lists(st.tuples(st.floats(-24, 24), st.booleans(), st.integers(0, 15)), min_size=2, max_size=10))
def test_what_was_encoded_before_changes_nothing(rows: list[tuple[float, bool, int]]) -> None:
    """Each frame is the one that a new encoder makes, though the values be changed in place afterwards."""
    encoder = Encoder(load(Variant.COARSE))
    values: dict[str, Any] = {}
    for angle_deg, enable, alive in rows:
        values["TargetAngle"], values["Enable"] = angle_deg, enable
        expected = Encoder(load(Variant.COARSE)).encode("Auto_SteeringCmd", values, alive)
        assert encoder.encode("Auto_SteeringCmd", values, alive) == expected
        assert encoder.encode("Auto_SteeringCmd", values, alive) == expected
