"""``cruiser decode``, and the lines that it reads."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.chassis.cruiser import frames
from gateway.chassis.frame import BITRATE_SWITCH, ERROR, EXTENDED, FD, REMOTE, Frame, hex_identifier
from gateway.chassis.layout import Encoder, FrameDecoder, MessageLayout
from gateway.cli.decode import MAX_LINE_BYTES, CandumpLine, describe, parse
from schemas.messages import Variant
from schemas.subjects import BY_DBC_MESSAGE

VARIANTS = (Variant.COARSE, Variant.FINE)
DECODERS = {variant: FrameDecoder(frames.load(variant)) for variant in VARIANTS}
DECODER = DECODERS[Variant.COARSE]
FRAMES = [(variant, frame) for variant in VARIANTS for frame in frames.load(variant).messages.values()]
GEAR = "(1436509052.249713) vcan0 18C4D1EF#0104000000000005"


def test_a_valid_frame_has_its_signals_under_the_field_names() -> None:
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
    record = describe(DECODER, f"(1.0) can0 {text}".encode(), 1)
    assert record is not None
    assert record["fault"]["kind"] == kind
    assert record.get("name") == name
    assert "signals" not in record


def test_a_line_that_is_not_candumps_says_which_line() -> None:
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
    record = describe(DECODER, raw, 1)
    assert record is None or json.loads(json.dumps(record)) == record


TIME = "(1436509052.249713) "
TIME_NS = 1_436_509_052_249_713_000


@pytest.mark.parametrize(
    ("text", "frame"),
    [
        ("18C4D1EF#0104000000000005", Frame(0x18C4D1EF | EXTENDED, bytes.fromhex("0104000000000005"))),
        ("123#", Frame(0x123, b"")),
        ("7ff#aB R", Frame(0x7FF, b"\xab")),
        ("00000123#00", Frame(0x123 | EXTENDED, b"\x00")),
        ("123#R", Frame(0x123 | REMOTE, b"")),
        ("123#R8", Frame(0x123 | REMOTE, b"", remote_length=8)),
        ("123##5AABB", Frame(0x123, b"\xaa\xbb", fd_flags=FD | BITRATE_SWITCH)),
        ("123##0" + "00" * 64, Frame(0x123, bytes(64), fd_flags=FD)),
        ("20000004#0004000000000000", Frame(ERROR | 4, bytes.fromhex("0004000000000000"))),
        ("123#0011223344556677_B", Frame(0x123, bytes.fromhex("0011223344556677"))),
    ],
)
def test_a_log_line_is_its_frame(text: str, frame: Frame) -> None:
    line = parse(f"{TIME}vcan0 {text}\r")
    assert line is not None
    assert line.bus == "vcan0"
    assert line.time_ns == TIME_NS
    assert line.frame == Frame(frame.can_id, frame.data, TIME_NS, frame.fd_flags, frame.remote_length)


@pytest.mark.parametrize(
    ("text", "frame"),
    [
        ("  vcan0  18C4D1EF   [2]  01 04", Frame(0x18C4D1EF | EXTENDED, b"\x01\x04")),
        ("  vcan0       123   [0] ", Frame(0x123, b"")),
        ("  vcan0       123   [0]  remote request", Frame(0x123 | REMOTE, b"")),
        ("  vcan0  TX B -       123  [02]  01 04", Frame(0x123, b"\x01\x04", fd_flags=FD)),
        ("  vcan0       123   [2]  41 42   'AB'", Frame(0x123, b"AB")),
        ("  vcan0  20000004   [2]  00 04   ERRORFRAME", Frame(ERROR | 4, b"\x00\x04")),
    ],
)
def test_a_classic_line_is_its_frame(text: str, frame: Frame) -> None:
    line = parse(text)
    assert line is not None
    assert (line.frame, line.time_ns) == (frame, None)
    timed = parse(f" {TIME} {text}")
    assert timed is not None
    assert timed.time_ns == TIME_NS


@pytest.mark.parametrize(
    "text",
    [
        "",
        "vcan0",
        f"{TIME}vcan0 123",
        f"{TIME}vcan0 1234#00",
        f"{TIME}vcan0 800#00",
        f"{TIME}vcan0 80000000#00",
        f"{TIME}vcan0 123#0",
        f"{TIME}vcan0 123#{'00' * 9}",
        f"{TIME}vcan0 123##1{'00' * 65}",
        f"{TIME}vcan0 123#R9",
        f"{TIME}vcan0 123#00 11",
        "(1436509052) vcan0 123#00",
        "vcan0 123#00",
        "  vcan0  123   [2]  01",
        "  vcan0  123   [1]  01 02",
        "  vcan0  123   [9]  01 02 03 04 05 06 07 08 09",
        "  vcan0  FFF   [1]  01",
    ],
)
def test_what_candump_would_not_write_is_no_line_of_it(text: str) -> None:
    assert parse(text) is None


@given(
    can_id=st.integers(0, 0x7FF) | st.integers(0, 0x1FFF_FFFF).map(lambda value: value | EXTENDED),
    data=st.binary(max_size=8),
    time_ns=st.integers(0, 10**19 - 1),
)
def test_every_data_frame_is_read_back(can_id: int, data: bytes, time_ns: int) -> None:
    word = f"{can_id & 0x1FFF_FFFF:08X}" if can_id & EXTENDED else f"{can_id:03X}"
    text = f"({time_ns // 10**9:010}.{time_ns % 10**9:09}) can0 {word}#{data.hex().upper()}"
    assert parse(text) == CandumpLine(Frame(can_id, data, time_ns), "can0", word, time_ns)
