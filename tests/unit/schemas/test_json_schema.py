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
from schemas.codec import PayloadFault, decode_request, encode
from schemas.json_schema import KINDS
from schemas.requests import Request
from schemas.subjects import COMMANDS, SUBJECTS, Command
from tests.support.strategies import ANYTHING, any_of, commands_and_requests

UNIT_SUFFIXES = {
    "_m2ps2": "m2/s2",
    "_rad2ps2": "rad2/s2",
    "_m2": "m2",
    "_rad2": "rad2",
    "_rad": "rad",
    "_ns": "ns",
    "_ms": "ms",
    "_mps": "m/s",
    "_mps2": "m/s2",
    "_1pm": "1/m",
    "_degps": "deg/s",
    "_radps": "rad/s",
    "_deg": "deg",
    "_km": "km",
    "_hz": "Hz",
    "_per_s": "Hz",
    "_s": "s",
    "_m": "m",
    "_bytes": "B",
    "_percent": "%",
}
VALIDATORS = {name: jsonschema.Draft202012Validator(json_schema.schema(name)) for name in KINDS}


@st.composite
def names_and_contents(draw: st.DrawFn) -> tuple[str, msgspec.Struct]:
    """Any schema and anything of its class."""
    name = draw(st.sampled_from(list(KINDS)))
    content: msgspec.Struct = draw(any_of(KINDS[name]))
    return name, content


def test_the_files_are_current(capsys: pytest.CaptureFixture[str]) -> None:
    """schemas/json/ is what the message classes say; 'make generate' makes it so."""
    assert json_schema.main(["--check"]) == 0, capsys.readouterr().err


@pytest.mark.parametrize("name", KINDS)
def test_every_schema_is_a_right_json_schema(name: str) -> None:
    """Each schema is valid under its own dialect, and names itself by its file."""
    schema = json.loads(json_schema.schema_text(name))
    jsonschema.Draft202012Validator.check_schema(schema)
    assert schema["$schema"] == json_schema.DIALECT
    assert schema["$id"] == f"{name}-{KINDS[name].version}.schema.json"
    assert schema["description"]


@pytest.mark.parametrize("name", KINDS)
def test_every_enumeration_and_record_within_is_described(name: str) -> None:
    """What a field refers to says what it is, in plain text, whichever module it is from."""
    for part in json_schema.schema(name).get("$defs", {}).values():
        assert part["description"]
        assert not set(part["description"]) & set("\n`")


@given(pair=names_and_contents())
def test_every_payload_is_valid_under_its_schema(pair: tuple[str, msgspec.Struct]) -> None:
    """As any MessagePack library reads it, and turned into JSON, with bytes as base64 text."""
    name, content = pair
    for read in (msgpack.unpackb(encode(content)), json.loads(msgspec.json.encode(content))):
        VALIDATORS[name].validate(read)


@given(pair=names_and_contents(), data=st.data())
def test_a_payload_without_one_of_its_fields_is_not_valid(
    pair: tuple[str, msgspec.Struct], data: st.DataObject
) -> None:
    """Every field of what the gateway sends is required; a request may leave out what has a start value."""
    name, content = pair
    fields: dict[str, Any] = msgpack.unpackb(encode(content))
    if not fields:
        return  # only ``stop`` has none
    left_out = data.draw(st.sampled_from(sorted(fields)))
    del fields[left_out]
    may_be_left_out = isinstance(content, Request) and left_out in START_VALUES[name]
    assert VALIDATORS[name].is_valid(fields) == may_be_left_out


START_VALUES = {
    name: {field.name for field in msgspec.structs.fields(kind) if not field.required}
    for name, kind in KINDS.items()
}


@given(pair=commands_and_requests(), data=st.data())
def test_a_request_that_is_understood_is_valid_under_its_schema(
    pair: tuple[Command, Request], data: st.DataObject
) -> None:
    """Whatever stands in one of its fields, or in one more: what the schema refuses, the gateway refuses."""
    command, request = pair
    fields: dict[str, Any] = msgpack.unpackb(encode(request))
    name = data.draw(st.sampled_from([*fields, "novelty"]))
    fields[name] = data.draw(ANYTHING)
    if not VALIDATORS[command.schema_name].is_valid(fields):
        assert isinstance(decode_request(command, msgpack.packb(fields)), PayloadFault)


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command.verb)
def test_no_request_takes_a_field_that_it_does_not_have(command: Command) -> None:
    """A client is told so by the schema before it asks."""
    assert json_schema.schema(command.schema_name)["additionalProperties"] is False


@pytest.mark.parametrize("wrong", [1, None, True, [], {}])
def test_a_bytes_field_is_nothing_else(wrong: object) -> None:
    """The schema of a bytes field, which JSON has no type for, refuses what is neither bytes nor text."""
    subject = subjects.BY_NAME["can/{bus}/rx"]
    data = json_schema.schema(subject.schema_name)["properties"]["data"]["items"]
    validator = jsonschema.Draft202012Validator(data)
    assert validator.is_valid(b"\x00")
    assert not validator.is_valid(wrong)


@pytest.mark.parametrize("name", KINDS)
def test_a_name_with_a_unit_has_it_under_the_unit_keyword(name: str) -> None:
    """A field whose name ends in a unit has that unit in the schema, and no other field has one."""
    schema = json_schema.schema(name)
    parts = [schema, *(part for part in schema.get("$defs", {}).values() if "properties" in part)]
    for part in parts:
        for field, value in part["properties"].items():
            wanted = next((unit for suffix, unit in UNIT_SUFFIXES.items() if field.endswith(suffix)), None)
            assert value.get("unit") == wanted, field


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
    """``gateway/info`` carries every schema under its schema name: of messages, requests and replies."""
    texts = json_schema.robot_schema_texts()
    wanted = {subject.schema_name for subject in SUBJECTS}
    wanted |= {name for command in COMMANDS for name in (command.schema_name, command.reply_schema_name)}
    assert set(texts) == wanted
    assert all(json.loads(text)["title"] == name for name, text in texts.items())
