"""The conventions of rmw_zenoh: keys, tokens and attachments."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.ros import types
from schemas.ros.cdr import type_hash
from schemas.ros.wire import (
    LATCHED,
    NO_HASH,
    Attachment,
    Endpoint,
    EntityKind,
    is_namespace,
    key_of,
    namespace_of,
    read_attachment,
    read_token,
    type_of,
)

ODOMETRY = "nav_msgs::msg::dds_::Odometry_"
SESSION = "aac3178e146ba6f1fc6e6a4085e77f21"
NODE = Endpoint(2, SESSION, 10, 10, EntityKind.NODE, "robot1", "talker")
TOPIC = ("robot1/odom", ODOMETRY, "RIHS01_aa", LATCHED)
PUBLISHER = Endpoint(2, SESSION, 10, 11, EntityKind.PUBLISHER, "", "talker", *TOPIC)


@pytest.mark.parametrize(
    ("endpoint", "token"),
    [
        (NODE, f"@ros2_lv/2/{SESSION}/10/10/NN/%/%robot1/talker"),
        (PUBLISHER, f"@ros2_lv/2/{SESSION}/10/11/MP/%/%/talker/%robot1%odom/{ODOMETRY}/RIHS01_aa/1:1:1,1:,:,:,,"),
    ],
)
def test_a_token_is_as_rmw_zenoh_writes_it(endpoint: Endpoint, token: str) -> None:
    """liveliness_utils.cpp: an empty namespace is the root's slash, and a slash within a part is %."""
    assert endpoint.token() == token
    assert read_token(token) == endpoint


@pytest.mark.parametrize(
    "token",
    [
        "@ros2_lv/2/aa/1/1/NN/%/%",
        "@ros2_lv/2/aa/1/1/XX/%/%/talker",
        "@ros2_lv/x/aa/1/1/NN/%/%/talker",
        "@ros2_lv/2/aa/1/1/MP/%/%/talker",
        "@ros2_lv/2/aa/1/1/NN/%/%/talker/%odom/T/H/Q",
        "other/2/aa/1/1/NN/%/%/talker",
    ],
)
def test_what_is_no_token_is_none(token: str) -> None:
    assert read_token(token) is None


def test_a_key_names_type_and_hash() -> None:
    """Humble has a constant where the others have the hash; another version of a type is not read."""
    key = key_of(0, "cruiser_1/cmd_vel", types.TWIST)
    assert key == f"0/cruiser_1/cmd_vel/geometry_msgs::msg::dds_::Twist_/{type_hash(types.TWIST)}"
    humble = key_of(0, "cruiser_1/cmd_vel", types.TWIST, hashes=False)
    assert humble.endswith(f"Twist_/{NO_HASH}")
    assert type_of(key) == type_of(humble) == types.TWIST
    with pytest.raises(ValueError, match="another version: its hash is 'RIHS01_00"):
        type_of(key.rpartition("/")[0] + "/RIHS01_00")
    with pytest.raises(ValueError, match="not understood"):
        type_of("0/cmd_vel/std_msgs::msg::dds_::String_/RIHS01_00")


@given(st.integers(1, 2**63 - 1), st.integers(0, 2**63 - 1), st.binary(min_size=16, max_size=16))
def test_an_attachment_is_33_bytes(sequence: int, time_ns: int, gid: bytes) -> None:
    """Little endian; the length of the identifier is one byte (rmw_zenoh_cpp 0.2.4 and later)."""
    attachment = Attachment(sequence, time_ns, gid)
    assert attachment.encode() == struct.pack("<qq", sequence, time_ns) + b"\x10" + gid
    assert read_attachment(attachment.encode()) == attachment


@given(st.binary(max_size=60).filter(lambda data: len(data) != 33 or data[16] != 16))
def test_other_bytes_are_no_attachment(data: bytes) -> None:
    assert read_attachment(data) is None


@pytest.mark.parametrize(
    ("robot", "namespace"),
    [("cruiser-1", "cruiser_1"), ("a.b--c", "a_b_c"), ("7of9", "robot_7of9"), ("cruiser", "cruiser")],
)
def test_a_robot_s_name_becomes_a_namespace(robot: str, namespace: str) -> None:
    assert namespace_of(robot) == namespace
    assert is_namespace(namespace)


@pytest.mark.parametrize("text", ["a b", "1a", "a//b", "a/1", "a__b", "ä", "a%b", "a*", "/a"])
def test_odd_letters_make_no_namespace(text: str) -> None:
    assert not is_namespace(text)
    assert is_namespace("fleet/north_2")
    assert is_namespace("")
