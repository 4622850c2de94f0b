"""Hypothesis strategies of the chassis tests."""

from hypothesis import strategies as st

from gateway.chassis.cruiser.layout import load
from gateway.chassis.encode import to_raw
from gateway.chassis.frame import REMOTE, Frame
from gateway.chassis.layout import MessageLayout
from schemas.messages import Variant

VARIANTS = (Variant.COARSE, Variant.FINE)
LAYOUTS = [message for variant in VARIANTS for message in load(variant).messages.values()]
FEEDBACK = [message for message in LAYOUTS if message.is_feedback]
KNOWN_IDS = sorted({message.can_id for message in LAYOUTS})

payloads = st.binary(min_size=8, max_size=8)

can_ids = st.one_of(
    st.sampled_from(KNOWN_IDS),
    st.sampled_from(KNOWN_IDS).map(lambda can_id: can_id ^ 0x8000_0000),
    st.sampled_from(KNOWN_IDS).map(lambda can_id: can_id | 0x4000_0000),
    st.sampled_from(KNOWN_IDS).map(lambda can_id: can_id | 0x2000_0000),
    st.integers(0, 2**32 - 1),
)


@st.composite
def _frames(draw: st.DrawFn) -> Frame:
    can_id = draw(can_ids)
    return Frame(
        can_id,
        draw(st.one_of(payloads, st.binary(max_size=64))),
        draw(st.integers(0, 2**62)),
        draw(st.sampled_from([0, 0, 0, 4, 5, 7])),
        draw(st.integers(0, 8)) if can_id & REMOTE else 0,
    )


frames = _frames()


PLAUSIBLE_VALUES = {
    "Angle": st.floats(-24.9, 24.9),
    "Speed": st.floats(0, 3),
    "RearLeftSpeed": st.floats(-3, 3),
    "RearRightSpeed": st.floats(-3, 3),
    "GearPosition": st.integers(1, 4),
    "Mode": st.integers(0, 2),
}
"""Of those signals of which not every value can be; physical or of the value table."""


@st.composite
def plausible_payloads(draw: st.DrawFn, layout: MessageLayout) -> bytes:
    """Any data of a frame whose values this chassis can have."""
    word = int.from_bytes(draw(payloads), "little")
    for signal in layout.signals:
        if signal.name in PLAUSIBLE_VALUES:
            mask = (1 << signal.length) - 1
            raw = to_raw(signal, draw(PLAUSIBLE_VALUES[signal.name]))
            word = word & ~(mask << signal.start_bit) | raw << signal.start_bit
            if signal.name == "Mode":
                word |= 1  # Valid: mode auto needs it
    return word.to_bytes(8, "little")


def with_checksum(data: bytes) -> bytes:
    """The same data with the right checksum."""
    checksum = 0
    for byte in data[:7]:
        checksum ^= byte
    return data[:7] + bytes([checksum])


def identify(layout: MessageLayout) -> str:
    """A test's name for a layout."""
    wheel = "fine" if layout in load(Variant.FINE).messages.values() else "coarse"
    return f"{wheel}-{layout.name}"
