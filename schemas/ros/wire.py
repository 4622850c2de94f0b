"""The conventions of rmw_zenoh: keys of topics and services, liveliness tokens, QoS and attachments. Pure.

Source: the design document and the sources of github.com/ros2/rmw_zenoh (liveliness_utils.cpp, qos.cpp,
attachment_helpers.cpp), 0.1.8 (Humble) to 0.10 (Lyrical).
"""

from __future__ import annotations

import re
import struct
from enum import Enum
from typing import Final

import msgspec

from schemas.ros.cdr import type_hash
from schemas.ros.types import DEFINITIONS

TOKENS: Final = "@ros2_lv"
NO_HASH: Final = "TypeHashNotSupported"  # stands for every hash in Humble
GID_BYTES: Final = 16

RELIABLE: Final = "1:2:1,10:,:,:,,"  # reliable, volatile, keep last 10
BEST_EFFORT: Final = "2:2:1,10:,:,:,,"
LATCHED: Final = "1:1:1,1:,:,:,,"  # reliable, transient local, keep last 1

_ATTACHMENT: Final = struct.Struct(f"<qqB{GID_BYTES}s")
_NAME: Final = re.compile(r"(?!.*__)[A-Za-z_][A-Za-z0-9_]*")


class EntityKind(Enum):
    """The kind of entity that a liveliness token announces."""

    NODE = "NN"
    PUBLISHER = "MP"
    SUBSCRIPTION = "MS"
    SERVER = "SS"
    CLIENT = "SC"


class Attachment(msgspec.Struct, frozen=True):
    """The attachment of each message, request and reply.

    Attributes:
        sequence: from 1, by endpoint; of a reply, the request's.
        time_ns: by the sender's clock, since 1970.
        gid: 16 bytes, constant for each endpoint; of a reply, the client's.
    """

    sequence: int
    time_ns: int
    gid: bytes

    def encode(self) -> bytes:
        return _ATTACHMENT.pack(self.sequence, self.time_ns, GID_BYTES, self.gid)


def read_attachment(data: bytes) -> Attachment | None:
    """The attachment in these bytes; None if they are none."""
    if len(data) != _ATTACHMENT.size or data[16] != GID_BYTES:
        return None
    sequence, time_ns, _, gid = _ATTACHMENT.unpack(data)
    return Attachment(sequence, time_ns, gid)


def is_namespace(text: str) -> bool:
    """Return True for a ROS namespace without outer slashes: empty, or names with slashes between."""
    return not text or all(map(_NAME.fullmatch, text.split("/")))


def namespace_of(robot: str) -> str:
    """The namespace of a robot: its name, with underscores for what a ROS name may not hold."""
    name = re.sub(r"_+", "_", re.sub(r"\W", "_", robot, flags=re.ASCII))
    return name if not name[:1].isdigit() else f"robot_{name}"


def dds_type(type_name: str) -> str:
    """``nav_msgs/msg/Odometry`` as ``nav_msgs::msg::dds_::Odometry_``."""
    package, group, name = type_name.split("/")
    return f"{package}::{group}::dds_::{name}_"


_BY_DDS_TYPE: Final = {dds_type(name): name for name in DEFINITIONS}


def key_of(domain: int, name: str, type_name: str, *, hashes: bool = True) -> str:
    """The key of a topic or service.

    Args:
        name: fully qualified, without the first slash: ``cruiser_1/odom``.
        hashes: False for Humble.
    """
    return f"{domain}/{name}/{dds_type(type_name)}/{type_hash(type_name) if hashes else NO_HASH}"


def type_of(key: str) -> str:
    """The type of the messages under this key.

    Raises:
        ValueError: it is no such key, of a type that is not known here, or of another version of the type.
    """
    *_, name, found = key.rsplit("/", 2)
    type_name = _BY_DDS_TYPE.get(name)
    if type_name is None:
        raise ValueError(f"messages of the type {name!a} are not understood")
    if found not in {NO_HASH, type_hash(type_name)}:
        raise ValueError(f"{type_name} of another version: its hash is {found!a}")
    return type_name


class Endpoint(msgspec.Struct, frozen=True):
    """A node, or a topic or service of it, as its token announces it.

    Attributes:
        session: the Zenoh session's identifier, in hexadecimal.
        node_id, endpoint_id: numbers that are unique in the session.
        namespace: without outer slashes; empty for the root.
        name: of the topic or service, fully qualified, without the first slash; empty for a node.
        type_name: ``nav_msgs::msg::dds_::Odometry_``; empty for a node.
        type_hash, qos: empty for a node.
    """

    domain: int
    session: str
    node_id: int
    endpoint_id: int
    kind: EntityKind
    namespace: str
    node: str
    name: str = ""
    type_name: str = ""
    type_hash: str = ""
    qos: str = ""

    def token(self) -> str:
        """The key of its liveliness token."""
        head = [TOKENS, self.domain, self.session, self.node_id, self.endpoint_id, self.kind.value]
        node = ["%", mangled(self.namespace), self.node]  # the enclave is the root
        topic = [mangled(self.name), self.type_name, self.type_hash, self.qos]
        return "/".join(map(str, head + node + (topic if self.kind is not EntityKind.NODE else [])))


def mangled(name: str) -> str:
    """A name as a part of a token."""
    return f"/{name}".replace("/", "%")


def read_token(key: str) -> Endpoint | None:
    """The endpoint of a token's key; None if it is no token."""
    try:
        root, domain, session, node_id, endpoint_id, kind, _enclave, namespace, node, *topic = key.split("/")
        head = (int(domain), session, int(node_id), int(endpoint_id), EntityKind(kind), _plain(namespace), node)
    except ValueError:
        return None
    if root != TOKENS or len(topic) != (0 if head[4] is EntityKind.NODE else 4):
        return None
    return Endpoint(*head, *map(_plain, topic[:1]), *topic[1:])


def _plain(mangled: str) -> str:
    return mangled.replace("%", "/").strip("/")
