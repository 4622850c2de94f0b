from enum import Enum

import msgspec
import pytest

from gateway.chassis.cruiser import frames
from gateway.chassis.layout import MessageLayout
from schemas.messages import Variant
from schemas.requests import Leased
from schemas.subjects import (
    BY_DBC_MESSAGE,
    COMMANDS,
    SUBJECTS,
    Subject,
)

VARIANTS = (Variant.COARSE, Variant.FINE)
FRAMES = [(variant, frame) for variant in VARIANTS for frame in frames.load(variant).feedback]
FRAME_IDS = [f"{variant.value}-{frame.name}" for variant, frame in FRAMES]


def fields_of(subject: Subject) -> dict[str, object]:
    common = {"time_ns", "sequence", "alive_counter"}
    return {field.name: field.type for field in msgspec.structs.fields(subject.type) if field.name not in common}


def test_an_encoding_names_one_class() -> None:
    kinds: set[tuple[str, type]] = {(subject.encoding, subject.type) for subject in SUBJECTS}
    kinds |= {(command.encoding, command.request) for command in COMMANDS}
    kinds |= {(command.reply_encoding, command.reply) for command in COMMANDS}
    assert len({encoding for encoding, _ in kinds}) == len({kind for _, kind in kinds}) == len(kinds)


def test_a_late_joiner_gets_the_last_of_what_is_said_seldom() -> None:
    """A cached health would make a hung gateway look well: it has no history."""
    history = {subject.name: subject.qos.history for subject in SUBJECTS if subject.qos.history}
    assert history == {
        "safety/state": 1,
        "safety/decision": 1000,
        "safety/event": 1000,
        "authority/statement": 64,
    }


def test_only_who_may_have_no_lease_needs_none() -> None:
    without = {command.verb for command in COMMANDS if not issubclass(command.request, Leased)}
    assert without == {"acquire", "take", "stop"}


@pytest.mark.parametrize("variant", VARIANTS)
def test_every_feedback_frame_has_a_subject(variant: Variant) -> None:
    assert {frame.name for frame in frames.load(variant).feedback} == set(BY_DBC_MESSAGE)


@pytest.mark.parametrize(("variant", "frame"), FRAMES, ids=FRAME_IDS)
def test_a_message_is_what_the_dbc_says_of_its_frame(variant: Variant, frame: MessageLayout) -> None:
    del variant
    fields = fields_of(BY_DBC_MESSAGE[frame.name])
    assert list(fields) == [signal.field for signal in frame.payload_signals]
    assert BY_DBC_MESSAGE[frame.name].rate == f"{1_000_000_000 // frame.period_ns} Hz"
    for signal in frame.payload_signals:
        kind = fields[signal.field]
        if signal.kind == "choice":
            assert isinstance(kind, type)
            assert issubclass(kind, Enum)
            assert {member.value for member in kind} == {*signal.choices.values(), "undefined"}
        elif signal.kind == "flag":
            assert kind is bool
