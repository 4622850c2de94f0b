"""Messages of a newer version are read as far as possible; commands are refused."""

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas import codec
from schemas.codec import (
    PayloadFault,
    Understood,
    decode_request,
    encoding_fault,
    is_foreign,
    member_of,
    names_schema,
    other_version,
    understand,
)
from schemas.reasons import OF_A_ROBOT, TEXTS, Reason
from schemas.requests import Request
from schemas.subjects import ALL_SUBJECTS, ALL_VERBS, Command
from tests.support.messages import HEALTH
from tests.support.newer import (
    NEW_WORD,
    READ,
    enumerations,
    growing_fields,
    is_new,
    newer,
    value_at,
    with_new_fields,
    with_new_word,
)
from tests.support.requests import REQUESTS
from tests.support.strategies import ANYTHING, any_of, commands_and_requests

ENCODINGS = sorted(
    {
        *(subject.encoding for subject in ALL_SUBJECTS),
        *(verb.encoding for verb in ALL_VERBS),
        *(verb.reply_encoding for verb in ALL_VERBS),
    }
)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_another_version_of_any_schema_is_said_with_who_has_to_be_upgraded(encoding: str) -> None:
    assert names_schema(encoding)
    schema, _, version = encoding.partition(";")[2].rpartition("/")
    said = encoding_fault(newer(encoding), encoding, "the reader", "the writer")
    assert said == f"version {int(version) + 1} of {schema}, and the reader knows {version}: upgrade the reader"
    assert encoding_fault(newer(encoding, -1), encoding, "the reader", "the writer").endswith("upgrade the writer")
    assert [other_version(newer(encoding, by), encoding) for by in (-1, 0, 1)] == ["older", "", "newer"]


@given(grown=growing_fields())
def test_a_value_that_an_enumeration_got_later_is_kept_as_its_word(
    grown: tuple[msgspec.Struct, tuple[str, ...]],
) -> None:
    message, path = grown
    payload = with_new_word(message, path)
    read = understand(type(message), payload)
    assert isinstance(read, Understood)
    assert is_new(value_at(read.message, path))
    assert read.unknown == (f"{path[-1]} {NEW_WORD}",)
    assert msgspec.msgpack.decode(msgspec.msgpack.encode(read.message)) == msgspec.msgpack.decode(payload)


@given(data=st.data(), kind=st.sampled_from(READ))
def test_fields_that_were_added_later_are_left_out_and_named(
    data: st.DataObject, kind: type[msgspec.Struct]
) -> None:
    message = data.draw(any_of(kind))
    assert understand(kind, with_new_fields(message, new=1, newer="b")) == Understood(
        message, ("field 'new'", "field 'newer'")
    )


@pytest.mark.parametrize("name", [b"\xa3\xff\xff\xff", b"\xa3\xec\xa7a", b"\x93\x01\x02\x03"])
def test_a_field_whose_name_is_none_is_a_fault_and_no_exception(name: bytes) -> None:
    payload = with_new_fields(HEALTH, new=1).replace(b"\xa3new", name)
    assert isinstance(understand(type(HEALTH), payload), PayloadFault)


@given(kind=st.sampled_from(READ), value=ANYTHING)
def test_nothing_makes_reading_raise(kind: type[msgspec.Struct], value: object) -> None:
    assert isinstance(understand(kind, msgspec.msgpack.encode(value)), PayloadFault)
    if enumerations(kind) and not isinstance(value, str):
        name = enumerations(kind)[0][0]
        assert isinstance(understand(kind, msgspec.msgpack.encode({name: value})), PayloadFault)


@pytest.mark.parametrize("word", ["", "Ice", "two words", "9", "\x1b[2J", "a" * 65, "é"])
def test_only_a_word_is_kept_as_one(word: str) -> None:
    assert member_of(Reason, word) is None


def test_a_word_of_a_newer_version_is_one_member() -> None:
    ice = member_of(Reason, "ice")
    assert ice is not None
    assert ice is member_of(Reason, "ice")
    assert is_foreign(ice)
    assert not any(map(is_foreign, Reason))
    assert ice not in set(Reason)
    for texts in (TEXTS, OF_A_ROBOT):
        assert "ice, which this version does not know" in texts[ice].means
        assert "upgrade" in texts[ice].cure
        assert ice not in texts


@given(pair=commands_and_requests())
def test_a_command_is_never_read_in_part(pair: tuple[Command, Request]) -> None:
    command, request = pair
    fault = decode_request(command, with_new_fields(request))
    assert isinstance(fault, PayloadFault)
    assert "new_field" in fault.detail
    for path in enumerations(command.request):
        payload = with_new_fields(request, **{path[-1]: NEW_WORD})
        assert isinstance(decode_request(command, payload), PayloadFault)


@pytest.mark.parametrize("verb", REQUESTS)
def test_a_request_says_no_more_than_it_means(verb: str) -> None:
    command = next(one for one in ALL_VERBS if one.verb == verb)
    asked = msgspec.convert(REQUESTS[verb], command.request)
    assert msgspec.msgpack.decode(codec.encode(asked)).keys() == REQUESTS[verb].keys()
