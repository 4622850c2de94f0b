"""Logs of later versions are read as far as they are known; for earlier ones see ``test_golden_logs``."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorSet
from mcap import records

from gateway.cli.main import main

from recorder.encoding.protobuf import LOGGED, compile_encoder, descriptor_set, message_class, schema_name  # isort: skip
from recorder.mcap.writer import LogChannel
from recorder.reading.topics import means_the_same, topic_of
from recorder.review.checking import faults_of_schema
from schemas.codec import is_foreign
from schemas.decisions import EventKind, SafetyEvent
from schemas.reasons import Reason
from tests.support.logs import own_log
from tests.support.messages import WALL_NS, event, key_of


def newer_schema(kind: type = SafetyEvent) -> FileDescriptorSet:
    """A newer version's schema: one more field, and more values of two enumerations."""
    files = FileDescriptorSet.FromString(descriptor_set(kind))
    for file in files.file:
        for message in file.message_type:
            message.field.add(
                name="new_field",
                number=len(message.field) + 1,
                type=FieldDescriptorProto.TYPE_DOUBLE,
                label=FieldDescriptorProto.LABEL_OPTIONAL,
            )
        for enum in file.enum_type:
            prefix = enum.value[0].name.rpartition("_")[0] if enum.name == "Reason" else enum.name.upper()
            enum.value.add(name=f"{prefix}_ICE", number=len(enum.value))
    for file in files.file:
        for enum in file.enum_type:
            if enum.name == "EventKind":
                enum.value[-1].name = "EVENT_KIND_SKID"
    return files


def newer_event(number: int = 0) -> bytes:
    told = message_class(SafetyEvent).FromString(compile_encoder(SafetyEvent)(event(number)))
    told.kind, told.reason = len(EventKind), len(Reason)  # type: ignore[attr-defined]  # made at run time
    return told.SerializeToString() + b"\x49" + bytes(8)  # Field 9, of 8 bytes.


def schema_record(data: bytes, kind: type = SafetyEvent) -> records.Schema:
    return records.Schema(id=1, name=schema_name(kind), encoding="protobuf", data=data)


def test_a_newer_log_is_read_with_its_own_words() -> None:
    """Its schema names the numbers that are unknown here."""
    data = newer_schema().SerializeToString()
    channel = records.Channel(1, key_of(SafetyEvent), "protobuf", {}, 1)
    topic = topic_of(channel, schema_record(data))
    assert topic.kind is SafetyEvent
    assert topic.decode is not None
    said = topic.decode(newer_event())
    assert (said.kind.value, said.reason.value) == ("skid", "ice")
    assert is_foreign(said.kind)
    assert said.text == event(0).text
    assert faults_of_schema(schema_record(data)) == []


@pytest.mark.parametrize("question", ["info", "check", "events", "why", "export"])
def test_a_newer_log_answers_every_question(
    question: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Unknown kinds and reasons are shown by their names."""
    monkeypatch.chdir(tmp_path)
    channel = LogChannel(1, key_of(SafetyEvent), schema_name(SafetyEvent), newer_schema().SerializeToString())
    chunk = [(1, number, WALL_NS + number, newer_event(number)) for number in range(3)]
    Path("newer.mcap").write_bytes(own_log([chunk], [channel]))
    code = main(["review", question, "newer.mcap", *(["-o", "out"] if question == "export" else [])])
    shown = capsys.readouterr()
    assert code in {0, 1, 3}, shown.err
    assert "Traceback" not in shown.err
    if question == "events":
        assert "ice" in shown.out


@pytest.mark.parametrize("kind", LOGGED)
def test_what_is_added_at_the_end_means_the_same(kind: type) -> None:
    """In every class, in both directions of time."""
    assert means_the_same(kind, descriptor_set(kind))
    assert means_the_same(kind, newer_schema(kind).SerializeToString())
    older = FileDescriptorSet.FromString(descriptor_set(kind))
    del older.file[-1].message_type[0].field[-1]
    assert means_the_same(kind, older.SerializeToString())


def swap(ones: Any, first: int, second: int) -> None:  # noqa: ANN401 - fields or values of a descriptor
    ones[first].name, ones[second].name = ones[second].name, ones[first].name


class Parts(NamedTuple):
    """The schema of safety/event: its files, fields, and values of its reasons."""

    files: FileDescriptorSet
    fields: Any
    values: Any


def decoy(files: FileDescriptorSet, values: Any) -> None:  # noqa: ANN401 - of a descriptor
    """Right values in an enumeration of this name in another package, wrong ones in ours."""
    elsewhere = files.file.add(name="elsewhere.proto", package="elsewhere", syntax="proto3")
    for value in values:
        values_there = elsewhere.enum_type or [elsewhere.enum_type.add(name="Reason")]
        values_there[0].value.add(name=value.name, number=value.number)
    swap(values, 1, 2)


DOUBLE = FieldDescriptorProto.TYPE_DOUBLE
CHANGES: dict[str, Callable[[Parts], object]] = {
    "another syntax": lambda of: setattr(of.files.file[-1], "syntax", "proto2"),
    "another name in JSON": lambda of: setattr(of.fields[2], "json_name", "tack"),
    "a number below zero": lambda of: of.values.add(name="REASON_ICE", number=-1),
    "a number left out": lambda of: of.values.add(name="REASON_ICE", number=len(of.values) + 1),
    "two fields swapped": lambda of: swap(of.fields, 2, 6),
    "a field of another type": lambda of: setattr(of.fields[2], "type", DOUBLE),
    "a field renamed": lambda of: setattr(of.fields[2], "name", "tack"),
    "two values swapped": lambda of: swap(of.values, 1, 2),
    "a value replaced": lambda of: setattr(of.values[3], "name", "REASON_ICE"),
    "two values swapped, and right ones elsewhere": lambda of: decoy(of.files, of.values),
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_a_number_that_means_something_else_is_never_taken_for_ours(
    change: Callable[[Parts], object],
) -> None:
    """The log's own schema decodes it, and a check reports it."""
    files = FileDescriptorSet.FromString(descriptor_set(SafetyEvent))
    values = next(enum for file in files.file for enum in file.enum_type if enum.name == "Reason").value
    change(Parts(files, files.file[-1].message_type[0].field, values))
    data = files.SerializeToString()
    assert not means_the_same(SafetyEvent, data)
    topic = topic_of(records.Channel(1, key_of(SafetyEvent), "protobuf", {}, 1), schema_record(data))
    assert topic.kind is None
    assert topic.decode is not None
    assert faults_of_schema(schema_record(data)) == ["the schema cruiser.SafetyEvent differs from this version's"]


@pytest.mark.parametrize("data", [b"", b"\xff", b"\x0a\x05nope!"])
def test_a_schema_that_is_none_makes_nothing_raise(data: bytes) -> None:
    topic = topic_of(records.Channel(1, key_of(SafetyEvent), "protobuf", {}, 1), schema_record(data))
    assert topic.schema == "cruiser.SafetyEvent"
