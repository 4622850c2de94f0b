import json
from pathlib import Path
from typing import Any

import jsonschema
import msgpack
import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas import json_schema, subjects
from schemas.codec import encode
from schemas.messages import Message
from schemas.subjects import SUBJECTS, Subject
from tests.schemas.random_messages import subjects_and_messages

UNIT_SUFFIXES = {
    "_ns": "ns",
    "_ms": "ms",
    "_mps": "m/s",
    "_radps": "rad/s",
    "_deg": "deg",
    "_km": "km",
    "_hz": "Hz",
    "uptime_s": "s",
    "_per_s": "Hz",
    "_percent": "%",
}
VALIDATORS = {subject.name: jsonschema.Draft202012Validator(json_schema.schema(subject)) for subject in SUBJECTS}


def test_the_files_are_current(capsys: pytest.CaptureFixture[str]) -> None:
    """schemas/json/ is what the message classes say; 'make generate' makes it so."""
    assert json_schema.main(["--check"]) == 0, capsys.readouterr().err


@pytest.mark.parametrize("subject", SUBJECTS, ids=lambda subject: subject.name)
def test_every_schema_is_a_right_json_schema(subject: Subject) -> None:
    """Each schema is valid under its own dialect, and names itself by its file."""
    schema = json.loads(json_schema.schema_text(subject))
    jsonschema.Draft202012Validator.check_schema(schema)
    assert schema["$schema"] == json_schema.DIALECT
    assert schema["$id"] == f"{subject.schema_name}-{subject.type.version}.schema.json"
    assert schema["description"]


@given(pair=subjects_and_messages())
def test_every_payload_is_valid_under_its_schema(pair: tuple[Subject, Message]) -> None:
    """What any MessagePack library reads from a payload is what the schema describes."""
    subject, message = pair
    VALIDATORS[subject.name].validate(msgpack.unpackb(encode(message)))


@given(pair=subjects_and_messages())
def test_every_message_as_json_is_valid_under_its_schema(pair: tuple[Subject, Message]) -> None:
    """Turned into JSON, with bytes as base64 text, a message is still what the schema describes."""
    subject, message = pair
    VALIDATORS[subject.name].validate(json.loads(msgspec.json.encode(message)))


@given(pair=subjects_and_messages(), data=st.data())
def test_a_payload_without_one_of_its_fields_is_not_valid(
    pair: tuple[Subject, Message], data: st.DataObject
) -> None:
    """Every field is required."""
    subject, message = pair
    fields: dict[str, Any] = msgpack.unpackb(encode(message))
    del fields[data.draw(st.sampled_from(sorted(fields)))]
    assert not VALIDATORS[subject.name].is_valid(fields)


@pytest.mark.parametrize("wrong", [1, None, True, [], {}])
def test_a_bytes_field_is_nothing_else(wrong: object) -> None:
    """The schema of a bytes field, which JSON has no type for, refuses what is neither bytes nor text."""
    subject = subjects.BY_NAME["can/{bus}/rx"]
    data = json_schema.schema(subject)["properties"]["data"]["items"]
    validator = jsonschema.Draft202012Validator(data)
    assert validator.is_valid(b"\x00")
    assert not validator.is_valid(wrong)


@pytest.mark.parametrize("subject", SUBJECTS, ids=lambda subject: subject.name)
def test_a_name_with_a_unit_has_it_under_the_unit_keyword(subject: Subject) -> None:
    """A field whose name ends in a unit has that unit in the schema, and no other field has one."""
    schema = json_schema.schema(subject)
    parts = [schema, *(part for part in schema.get("$defs", {}).values() if "properties" in part)]
    for part in parts:
        for name, value in part["properties"].items():
            wanted = next((unit for suffix, unit in UNIT_SUFFIXES.items() if name.endswith(suffix)), None)
            assert value.get("unit") == wanted, name


def test_a_stale_file_is_found_and_made_current(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A changed, a missing and a left-over file are each named by --check, and put right without it."""
    directory = ["--directory", str(tmp_path / "json")]
    assert json_schema.main(directory) == 0
    capsys.readouterr()
    files = sorted((tmp_path / "json").iterdir())
    assert [file.name for file in files] == sorted(json_schema.files())
    files[0].write_text("{}", encoding="utf-8")
    files[1].unlink()
    files[0].with_name("cruiser.Gone-1.schema.json").write_text("{}", encoding="utf-8")
    assert json_schema.main([*directory, "--check"]) == 1
    assert len(capsys.readouterr().err.splitlines()) == 3
    assert json_schema.main(directory) == 0
    assert json_schema.main([*directory, "--check"]) == 0


def test_schemas_are_found_by_their_name() -> None:
    """``gateway/info`` carries every schema under its schema name."""
    texts = json_schema.schema_texts()
    assert list(texts) == [subject.schema_name for subject in SUBJECTS]
    assert all(json.loads(text)["title"] == name for name, text in texts.items())
