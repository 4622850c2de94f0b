"""Frames to signals and messages."""

import json
from functools import cache
from pathlib import Path
from typing import Any

import cantools
import msgspec
import pytest
from cantools.database.can import Database
from hypothesis import given
from hypothesis import strategies as st

from gateway.chassis.decode import Decoded, Decoder, Value, compile_message, compile_signals
from gateway.chassis.encode import Encoder
from gateway.chassis.faults import FaultKind, FrameFault
from gateway.chassis.frame import ERROR, EXTENDED, FD, REMOTE, Frame
from gateway.chassis.layout import MessageLayout, SignalLayout, dbc_text, load
from schemas.messages import Variant
from tests.gateway.chassis.strategies import FEEDBACK, LAYOUTS, VARIANTS, frames, identify, payloads, with_checksum

EXAMPLES = json.loads(Path(__file__).with_name("manual_examples.json").read_text(encoding="utf-8"))


@cache
def reference(variant: Variant) -> Database:
    """What cantools makes of a variant's DBC."""
    database = cantools.database.load_string(dbc_text(variant), database_format="dbc")
    assert isinstance(database, Database)
    return database


READERS = {
    variant: {name: compile_signals(row) for name, row in load(variant).messages.items()} for variant in VARIANTS
}
DECODERS = {variant: Decoder(load(variant)) for variant in VARIANTS}


def as_number(signal: SignalLayout, value: Value) -> float:
    """Our value as cantools gives it without its value table."""
    if isinstance(value, str):
        return next(raw for raw, name in signal.choices.items() if name == value)
    return value


@pytest.mark.parametrize("variant", VARIANTS)
@given(data=payloads)
def test_every_message_decodes_as_cantools_decodes_it(variant: Variant, data: bytes) -> None:
    """On any eight bytes, every signal of every message has exactly the value that cantools computes."""
    for layout in load(variant).messages.values():
        expected = reference(variant).get_message_by_name(layout.name).decode_simple(data, decode_choices=False)
        ours = READERS[variant][layout.name](data)
        assert {name: as_number(layout.signal(name), value) for name, value in ours.items()} == expected


@pytest.mark.parametrize("layout", FEEDBACK, ids=identify)
@given(data=payloads)
def test_a_message_says_what_the_signals_say(layout: MessageLayout, data: bytes) -> None:
    """The typed message holds the same values as the signals, under the fields' names."""
    decoder = compile_message(layout)
    message = decoder.build(data, 17, 4)
    fields: dict[str, Any] = msgspec.to_builtins(message)
    assert (fields.pop("time_ns"), fields.pop("sequence")) == (17, 4)
    signals = compile_signals(layout)(data)
    for signal in layout.signals:
        if signal.name == "Checksum":
            continue
        value = signals[signal.name]
        undefined = signal.kind == "choice" and not isinstance(value, str)
        assert fields.pop(signal.field) == ("undefined" if undefined else value)
    assert fields == {}


@pytest.mark.parametrize("layout", FEEDBACK, ids=identify)
@given(data=payloads)
def test_undefined_is_told_when_a_value_table_has_no_name(layout: MessageLayout, data: bytes) -> None:
    """``undefined`` is true exactly when the message says ``undefined`` somewhere."""
    decoder = compile_message(layout)
    fields = msgspec.to_builtins(decoder.build(data, 0, 0))
    has_undefined = decoder.undefined is not None and decoder.undefined(data)
    assert has_undefined == ("undefined" in fields.values())


@given(frame=frames)
def test_wire_input_never_raises(frame: Frame) -> None:
    """Any identifier, length and kind of frame gives signals or a fault; signals only if it is valid."""
    decoded = DECODERS[Variant.COARSE].decode(frame)
    valid = (
        frame.can_id in {layout.can_id for layout in LAYOUTS}
        and len(frame.data) == 8
        and not frame.fd_flags
        and with_checksum(frame.data) == frame.data
    )
    assert isinstance(decoded, Decoded) == valid


GEAR = load(Variant.COARSE).messages["Auto_GearFeedBack"].can_id
GOOD = bytes.fromhex("0104000000000005")


@pytest.mark.parametrize(
    ("frame", "kind"),
    [
        (Frame(GEAR, GOOD[:7]), FaultKind.LENGTH),
        (Frame(GEAR, b""), FaultKind.LENGTH),
        (Frame(GEAR, GOOD, fd_flags=FD), FaultKind.FD_FRAME),
        (Frame(GEAR, GOOD * 8, fd_flags=FD), FaultKind.FD_FRAME),
        (Frame(GEAR, GOOD[:7] + b"\x04"), FaultKind.CHECKSUM),
        (Frame(GEAR | REMOTE, b"", remote_length=8), FaultKind.REMOTE_FRAME),
        (Frame(GEAR | ERROR, bytes(8)), FaultKind.ERROR_FRAME),
        (Frame(GEAR & ~EXTENDED, GOOD), FaultKind.UNKNOWN_IDENTIFIER),
        (Frame(0x123, GOOD), FaultKind.UNKNOWN_IDENTIFIER),
        (Frame(0x123 | REMOTE, b""), FaultKind.UNKNOWN_IDENTIFIER),
        (Frame(GEAR + 0x100000, GOOD), FaultKind.UNKNOWN_IDENTIFIER),
    ],
)
def test_a_fault_has_its_kind(frame: Frame, kind: FaultKind) -> None:
    """Each way to be malformed is told by its own kind."""
    fault = DECODERS[Variant.COARSE].decode(frame)
    assert isinstance(fault, FrameFault)
    assert fault.kind is kind


@given(data=payloads, bit=st.integers(0, 63))
def test_any_single_bit_error_is_found(data: bytes, bit: int) -> None:
    """The checksum finds every single flipped bit, those of byte 6 and of the checksum included.

    Published drivers of this family have a precedence slip that disables the checksum.
    """
    good = with_checksum(data)
    bad = (int.from_bytes(good, "little") ^ 1 << bit).to_bytes(8, "little")
    decoder = DECODERS[Variant.COARSE]
    assert isinstance(decoder.decode(Frame(GEAR, good)), Decoded)
    fault = decoder.decode(Frame(GEAR, bad))
    assert isinstance(fault, FrameFault)
    assert fault.kind is FaultKind.CHECKSUM


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda e: f"{e['example']}-{e['role']}-{e['id']}")
def test_the_manuals_examples_in_both_directions(example: dict[str, str]) -> None:
    """Every frame that the manual prints decodes, and its signals encode to the same bytes again."""
    layout = load(Variant.COARSE)
    frame = Frame(int(example["id"], 16) | EXTENDED, bytes.fromhex(example["data"]))
    decoded = Decoder(layout).decode(frame)
    assert isinstance(decoded, Decoded)
    values = {signal.name: decoded.signals[signal.name] for signal in decoded.layout.payload_signals}
    encoded = Encoder(layout).encode(decoded.layout.name, values, alive_counter=0)
    if decoded.layout.name == "Auto_OdometerCmd":
        # Contradiction 3: the example sets bit 8, which no table of the manual defines; the mileage is bit 16.
        assert decoded.signals["ClearMileage"] is False
        assert encoded.data == bytes.fromhex("0100000000000001")
    else:
        assert encoded.data == frame.data


VALUES = {
    ("gear D", "0x18C4D1D0"): ("TargetGear", "drive"),
    ("gear D", "0x18C4D1EF"): ("GearPosition", "drive"),
    ("parking apply", "0x18C4D1EF"): ("GearPosition", "park"),
    ("parking apply", "0x18C4D5EF"): ("ParkingStatus", "applied"),
    ("steering +24 deg", "0x18C4D2EF"): ("Angle", 24.0),
    ("steering +24 deg", "0x18C4D1D0"): ("TargetGear", "neutral"),
    ("drive 1 m/s", "0x18C4D3D0"): ("TargetVelocity", 1.0),
    ("drive 1 m/s", "0x18C4D3EF"): ("Speed", 1.0),
    ("drive 1 m/s", "0x18C4D7EF"): ("RearRightSpeed", 1.0),
    ("drive 1 m/s", "0x18C4D8EF"): ("RearLeftPulses", 0x0202),
    ("headlamp on", "0x18C4DAEF"): ("Headlamp", True),
    ("horn on", "0x18C4DBEF"): ("Horn", True),
}


@pytest.mark.parametrize(("example", "identifier"), VALUES)
def test_the_manuals_examples_mean_what_the_manual_says(example: str, identifier: str) -> None:
    """The physical value in the manual's text is the one we decode, to half a step of the signal."""
    row = next(row for row in EXAMPLES if row["example"] == example and row["id"] == identifier)
    decoded = DECODERS[Variant.COARSE].decode(Frame(int(identifier, 16) | EXTENDED, bytes.fromhex(row["data"])))
    assert isinstance(decoded, Decoded)
    name, value = VALUES[example, identifier]
    if isinstance(value, float):
        assert decoded.signals[name] == pytest.approx(value, abs=decoded.layout.signal(name).scale / 2)
    else:
        assert decoded.signals[name] == value
