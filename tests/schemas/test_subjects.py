from enum import Enum

import msgspec
import pytest

from gateway.chassis import layout
from gateway.chassis.layout import MessageLayout
from schemas import messages
from schemas.messages import Variant
from schemas.subjects import BY_DBC_MESSAGE, SUBJECTS, Subject

VARIANTS = (Variant.COARSE, Variant.FINE)
FRAMES = [(variant, frame) for variant in VARIANTS for frame in layout.load(variant).feedback]
FRAME_IDS = [f"{variant.value}-{frame.name}" for variant, frame in FRAMES]


def fields_of(subject: Subject) -> dict[str, object]:
    """The fields of a message class that a frame's signals fill, with their types."""
    common = {"time_ns", "sequence", "alive_counter"}
    return {field.name: field.type for field in msgspec.structs.fields(subject.type) if field.name not in common}


def test_no_two_subjects_share_a_name_or_a_type() -> None:
    """A name, a message class and an encoding each say which subject it is."""
    for values in (
        [subject.name for subject in SUBJECTS],
        [subject.type for subject in SUBJECTS],
        [subject.encoding for subject in SUBJECTS],
    ):
        assert len(set(values)) == len(values)


@pytest.mark.parametrize("subject", SUBJECTS, ids=lambda subject: subject.name)
def test_every_message_class_says_what_it_is(subject: Subject) -> None:
    """Each message class has a docstring of its own, and a version that its encoding names."""
    assert subject.type.__doc__ != messages.Message.__doc__
    assert subject.encoding == f"application/msgpack;cruiser.{subject.type.__name__}/{subject.type.version}"


@pytest.mark.parametrize("variant", VARIANTS)
def test_every_feedback_frame_has_a_subject(variant: Variant) -> None:
    """The chassis sends nothing that has no subject, and no subject waits for a frame that does not exist."""
    assert {frame.name for frame in layout.load(variant).feedback} == set(BY_DBC_MESSAGE)


@pytest.mark.parametrize(("variant", "frame"), FRAMES, ids=FRAME_IDS)
def test_a_message_has_the_signals_of_its_frame_as_fields(variant: Variant, frame: MessageLayout) -> None:
    """The fields are exactly the signals: CamelCase as snake_case, the unit as a suffix, in the same order."""
    del variant
    fields = fields_of(BY_DBC_MESSAGE[frame.name])
    assert list(fields) == [signal.field for signal in frame.payload_signals]


@pytest.mark.parametrize(("variant", "frame"), FRAMES, ids=FRAME_IDS)
def test_a_value_table_has_the_values_of_its_enumeration(variant: Variant, frame: MessageLayout) -> None:
    """Each enumeration is its value table's names and ``undefined``, neither more nor fewer."""
    del variant
    fields = fields_of(BY_DBC_MESSAGE[frame.name])
    for signal in frame.payload_signals:
        kind = fields[signal.field]
        if signal.kind == "choice":
            assert isinstance(kind, type)
            assert issubclass(kind, Enum)
            assert {member.value for member in kind} == {*signal.choices.values(), "undefined"}
        elif signal.kind == "flag":
            assert kind is bool


@pytest.mark.parametrize(("variant", "frame"), FRAMES, ids=FRAME_IDS)
def test_the_rate_in_the_table_is_the_cycle_time_of_the_frame(variant: Variant, frame: MessageLayout) -> None:
    """What the key table promises is what the DBC says."""
    del variant
    assert BY_DBC_MESSAGE[frame.name].rate == f"{1_000_000_000 // frame.period_ns} Hz"
