"""ROS messages as bytes, and the hashes of their types, against two independent libraries."""

import struct
from functools import cache
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ros2_pyterfaces.core import hash_rihs01
from ros2_pyterfaces.core.std_srvs import srv
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from schemas.ros import types
from schemas.ros.cdr import ITEMS_MAX, CdrError, decode, definition, encode, fields_of, type_hash
from schemas.ros.face import TOPICS

SPOKEN = sorted({*TOPICS.values(), types.TWIST, types.TWIST_STAMPED})
DISTRIBUTIONS = (Stores.ROS2_JAZZY, Stores.ROS2_KILTED, Stores.ROS2_LYRICAL)

KNOWN = {
    types.BOOL: "feb91e995ff9ebd09c0cb3d2aed18b11077585839fb5db80193b62d74528f6c9",
    types.ODOMETRY: "3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0",
    types.TF: "e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
    types.JOINT_STATE: "a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e",
    types.DIAGNOSTICS: "5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e",
    types.TWIST: "9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a",
    types.TWIST_STAMPED: "5f0fcd4f81d5d06ad9b4c4c63e3ea51b82d6ae4d0558f1d475229b1121db6f64",
    types.ACKERMANN: "48ca7612a08d3bb72744fd98b71b7cf2ea24c6ad50fa4e1aa0bbad963c90d8cf",
    types.TRIGGER: "eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f",
}
"""As rosbags and ros2-pyterfaces have them."""


@cache
def store_of(distribution: Stores) -> Any:  # noqa: ANN401 - its classes are made at run time
    """The library's types; ackermann_msgs, which it lacks, from our definitions."""
    store = get_typestore(distribution)
    for name in ("ackermann_msgs/msg/AckermannDrive", types.ACKERMANN):
        store.register(get_types_from_msg(types.DEFINITIONS[name], name))
    return store


@pytest.mark.parametrize("type_name", KNOWN)
def test_the_hash_of_a_type_is_that_of_ros(type_name: str) -> None:
    assert type_hash(type_name) == f"RIHS01_{KNOWN[type_name]}"
    if type_name == types.TRIGGER:
        assert hash_rihs01(srv.Trigger) == type_hash(type_name)
    else:
        assert {store_of(one).hash_rihs01(type_name) for one in DISTRIBUTIONS} == {type_hash(type_name)}


_PRIMITIVES: dict[str, st.SearchStrategy[Any]] = {
    "bool": st.booleans(),
    "byte": st.integers(0, 127),  # rosbags takes it for signed
    "char": st.integers(0, 255),
    "uint8": st.integers(0, 255),
    "int32": st.integers(-(2**31), 2**31 - 1),
    "uint32": st.integers(0, 2**32 - 1),
    "int64": st.integers(-(2**63), 2**63 - 1),
    "float32": st.floats(width=32, allow_nan=False),
    "float64": st.floats(allow_nan=False),
    "string": st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=9),
}


def messages(type_name: str) -> st.SearchStrategy[dict[str, Any]]:
    """Any message of a type."""
    fields: dict[str, st.SearchStrategy[Any]] = {}
    for field in fields_of(type_name):
        one = messages(field.nested) if field.nested else _PRIMITIVES[field.base]
        least, most = (
            (field.length, field.length) if field.length and field.array == 48 else (0, field.length or 3)
        )
        fields[field.name] = st.lists(one, min_size=least, max_size=most) if field.array else one
    return st.fixed_dictionaries(fields)


def as_theirs(store: Any, type_name: str, value: dict[str, Any]) -> Any:  # noqa: ANN401 - as above
    """A message as an object of rosbags."""
    import numpy as np  # noqa: PLC0415 - theirs

    fields = []
    for field, (name, (node, kind)) in zip(fields_of(type_name), store.fielddefs[type_name][1], strict=True):
        given_value = value[name]
        if node == Nodetype.NAME:
            fields.append(as_theirs(store, field.nested, given_value))
        elif node != Nodetype.BASE and field.nested:
            fields.append([as_theirs(store, field.nested, one) for one in given_value])
        elif node != Nodetype.BASE and field.base != "string":
            fields.append(np.array(given_value, dtype=kind[0][1][0]))
        else:
            fields.append(given_value)
    return store.types[type_name](*fields)


@pytest.mark.parametrize("type_name", SPOKEN)
@settings(max_examples=25)
@given(data=st.data())
def test_a_message_has_the_bytes_of_rosbags_and_comes_back(type_name: str, data: st.DataObject) -> None:
    store = store_of(Stores.ROS2_JAZZY)
    message = data.draw(messages(type_name))
    ours = encode(type_name, message)
    assert ours == bytes(store.serialize_cdr(as_theirs(store, type_name, message), type_name))
    assert decode(type_name, ours) == message


def test_a_definition_holds_all_types_within_it() -> None:
    """As rosbags reads it from a bag."""
    for type_name in SPOKEN:
        found = get_types_from_msg(definition(type_name), type_name)
        theirs = store_of(Stores.ROS2_JAZZY)
        assert {name: found[name] for name in found} == {name: theirs.fielddefs[name] for name in found}
        assert type_name in found


TWIST = encode(types.TWIST, {"linear": {"x": 1.0}})


@pytest.mark.parametrize(
    ("type_name", "data", "says"),
    [
        (types.TWIST, b"", "its header is missing"),
        (types.TWIST, TWIST[4:], "its header is 00 00 00 00"),
        (types.TWIST, b"\0\0\0\0" + TWIST[4:], "its header is 00 00 00 00"),  # big endian
        (types.TWIST, TWIST[:-1], "it ends 1 bytes early"),
        (types.TWIST, TWIST + bytes(8), "8 bytes follow"),
        (types.BOOL, TWIST, "bytes follow"),
        (types.JOINT_STATE, TWIST[:4] + bytes(8) + struct.pack("<I", 2**31), "a length of 2147483648"),
        (types.TRIGGER_RESPONSE, TWIST[:4] + b"\1\0\0\0\2\0\0\0\xff\0", "message is not UTF-8"),
        (f"{types.TRIGGER}_Event", TWIST[:4] + bytes(40) + struct.pack("<I", 2), "request has 2 items, not 1"),
    ],
)
def test_bytes_that_are_no_such_message_are_refused(type_name: str, data: bytes, says: str) -> None:
    with pytest.raises(CdrError, match=says):
        decode(type_name, data)


@given(st.sampled_from(SPOKEN), st.binary(max_size=200))
def test_any_bytes_are_a_message_or_an_error(type_name: str, data: bytes) -> None:
    try:
        message = decode(type_name, b"\0\1\0\0" + data)
    except CdrError:
        return
    assert max(map(len, map(str, message.values()))) < 100 * ITEMS_MAX


def test_a_fixed_array_has_its_length() -> None:
    with pytest.raises(ValueError, match="covariance has 2 items, not 36"):
        encode(types.ODOMETRY, {"pose": {"covariance": [0.0, 1.0]}})
