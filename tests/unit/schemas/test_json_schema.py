import json
from typing import Any

import jsonschema
import msgpack
import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas import json_schema
from schemas.codec import PayloadFault, decode_request, encode
from schemas.json_schema import KINDS
from schemas.requests import Request
from schemas.subjects import Command
from tests.support.strategies import ANYTHING, any_of, commands_and_requests

VALIDATORS = {name: jsonschema.Draft202012Validator(json_schema.schema(name)) for name in KINDS}


@st.composite
def names_and_contents(draw: st.DrawFn) -> tuple[str, msgspec.Struct]:
    name = draw(st.sampled_from(list(KINDS)))
    content: msgspec.Struct = draw(any_of(KINDS[name]))
    return name, content


def test_the_files_are_current(capsys: pytest.CaptureFixture[str]) -> None:
    assert json_schema.main(["--check"]) == 0, capsys.readouterr().err


@pytest.mark.parametrize("name", KINDS)
def test_every_schema_is_a_right_json_schema(name: str) -> None:
    schema = json.loads(json_schema.schema_text(name))
    jsonschema.Draft202012Validator.check_schema(schema)
    assert schema["$schema"] == json_schema.DIALECT
    assert schema["$id"] == f"{name}-{KINDS[name].version}.schema.json"
    assert schema["description"]


@given(pair=names_and_contents())
def test_every_payload_is_valid_under_its_schema(pair: tuple[str, msgspec.Struct]) -> None:
    name, content = pair
    for read in (msgpack.unpackb(encode(content)), json.loads(msgspec.json.encode(content))):
        VALIDATORS[name].validate(read)


@given(pair=names_and_contents(), data=st.data())
def test_a_payload_without_one_of_its_fields_is_not_valid(
    pair: tuple[str, msgspec.Struct], data: st.DataObject
) -> None:
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
    command, request = pair
    fields: dict[str, Any] = msgpack.unpackb(encode(request))
    name = data.draw(st.sampled_from([*fields, "novelty"]))
    fields[name] = data.draw(ANYTHING)
    answer = decode_request(command, msgpack.packb(fields))
    assert VALIDATORS[command.schema_name].is_valid(fields) or isinstance(answer, PayloadFault)
