import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.chassis.cruiser import frames
from gateway.chassis.frame import hex_identifier
from gateway.chassis.layout import Encoder, FrameDecoder, MessageLayout
from gateway.cli.decode import MAX_LINE_BYTES, describe
from schemas.messages import Variant
from schemas.subjects import BY_DBC_MESSAGE

VARIANTS = (Variant.COARSE, Variant.FINE)
DECODERS = {variant: FrameDecoder(frames.load(variant)) for variant in VARIANTS}
DECODER = DECODERS[Variant.COARSE]
FRAMES = [(variant, frame) for variant in VARIANTS for frame in frames.load(variant).messages.values()]
GEAR = "(1436509052.249713) vcan0 18C4D1EF#0104000000000005"


def test_a_valid_frame_has_its_signals_under_the_field_names() -> None:
    """Time, bus, identifier, name, and the signals as in the message: names with units, choices by name."""
    assert describe(DECODER, GEAR.encode(), 1) == {
        "time": 1436509052.249713,
        "time_ns": 1436509052249713000,
        "bus": "vcan0",
        "id": "18C4D1EF",
        "name": "Auto_GearFeedBack",
        "signals": {"active": True, "gear_position": "drive", "alive_counter": 0},
    }


@pytest.mark.parametrize(("variant", "frame"), FRAMES, ids=[f"{v.value}-{f.name}" for v, f in FRAMES])
def test_every_frame_of_either_variant_is_decoded(variant: Variant, frame: MessageLayout) -> None:
    """Each frame has all its signals but the checksum, and feedback has the fields of its message."""
    sent = Encoder(frames.load(variant)).encode(frame.name, {}, alive_counter=5)
    record = describe(DECODERS[variant], f"(1.0) c {hex_identifier(sent.can_id)}#{sent.data.hex()}".encode(), 1)
    assert record is not None
    assert record["name"] == frame.name
    assert record["signals"]["alive_counter"] == 5
    assert set(record["signals"]) == {signal.field for signal in frame.payload_signals} | {"alive_counter"}
    if frame.is_feedback:
        message = BY_DBC_MESSAGE[frame.name].type
        assert set(record["signals"]) == set(message.__struct_fields__) - {"time_ns", "sequence"}


@pytest.mark.parametrize(
    ("text", "kind", "name"),
    [
        ("18C4D1EF#0104000000000006", "checksum", "Auto_GearFeedBack"),
        ("18C4D1EF#01", "length", "Auto_GearFeedBack"),
        ("18C4D1EF##10104000000000005", "fd_frame", "Auto_GearFeedBack"),
        ("18C4D1EF#R8", "remote_frame", None),
        ("123#00", "unknown_identifier", None),
        ("20000004#0004000000000000", "error_frame", None),
    ],
)
def test_a_frame_that_is_not_valid_has_its_fault(text: str, kind: str, name: str | None) -> None:
    """The fault's kind stands where the signals would, and with the frame's name if it has one."""
    record = describe(DECODER, f"(1.0) can0 {text}".encode(), 1)
    assert record is not None
    assert record["fault"]["kind"] == kind
    assert record.get("name") == name
    assert "signals" not in record


def test_a_line_that_is_not_candumps_says_which_line() -> None:
    """The line's number and its beginning help to find it; a line far too long is not looked at."""
    assert describe(DECODER, b"junk\x1b[31m", 7) == {
        "line": 7,
        "fault": {"kind": "not_candump", "detail": "junk\\x1b[31m"},
    }
    padded = GEAR.encode() + b" " * MAX_LINE_BYTES
    record = describe(DECODER, padded, 1)
    assert record is not None
    assert record["fault"]["kind"] == "not_candump"


@given(raw=st.binary() | st.text("()0123456789. canRTX[]#_ABCDEF'\t").map(str.encode))
def test_no_bytes_make_decoding_raise(raw: bytes) -> None:
    """Any line gives a record that JSON can hold, or nothing if it is empty."""
    record = describe(DECODER, raw, 1)
    assert record is None or json.loads(json.dumps(record)) == record


@given(data=st.binary(max_size=8), identifier=st.sampled_from([f"{i:02X}" for i in range(0xD0, 0xDF)]))
def test_no_data_make_decoding_raise(data: bytes, identifier: str) -> None:
    """Whatever an identifier of the chassis carries, it is signals or a fault."""
    record = describe(DECODER, f"(1.0) can0 18C4{identifier}EF#{data.hex()}".encode(), 1)
    assert record is not None
    assert ("signals" in record) != ("fault" in record)
