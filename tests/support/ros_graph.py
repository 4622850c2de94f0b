"""A ROS graph without ROS: a second reading of rmw_zenoh's conventions, over rosbags' types and bytes."""

import json
import re
import secrets
import struct
import threading
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Self

import msgspec
import zenoh
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from zenoh import ext

STORE = get_typestore(Stores.ROS2_JAZZY)
STORE.register(get_types_from_msg("bool success\nstring message", "std_srvs/msg/Trigger_Response"))
TRIGGER = "std_srvs::srv::dds_::Trigger_/RIHS01_eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f"
TOKEN = re.compile(
    r"@ros2_lv/(?P<domain>\d+)/(?P<session>[0-9a-f]+)/(?P<node>\d+)/(?P<id>\d+)/(?P<kind>NN|MP|MS|SS|SC)/%"
    r"/(?P<namespace>%\w*)/(?P<name>\w+)"
    r"(/(?P<topic>[%\w]+)/(?P<package>\w+)::(?P<group>msg|srv)::dds_::(?P<type>\w+)_/(?P<hash>\w+)/(?P<qos>[\d:,]+))?"
)


class Seen(msgspec.Struct, frozen=True):
    """A token as a person would read it."""

    kind: str
    node: str
    topic: str = ""
    type: str = ""
    qos: str = ""


class Graph:
    """A client of the graph's router.

    Attributes:
        tokens: of all that is there now.
        messages: what was received, by topic.
    """

    def __init__(self, endpoint: str) -> None:
        config = zenoh.Config()
        for path, value in (
            ("mode", "client"),
            ("connect/endpoints", [endpoint]),
            ("scouting/multicast/enabled", False),
            ("timestamping/enabled", True),
        ):
            config.insert_json5(path, json.dumps(value))
        self.session = zenoh.open(config)
        self.tokens: dict[str, Seen] = {}
        self.messages: defaultdict[str, list[Any]] = defaultdict(list)
        self._calls = 0
        self._declared: list[Any] = [
            self.session.liveliness().declare_subscriber("@ros2_lv/0/**", self._meet, history=True)
        ]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.session.close()

    def _meet(self, sample: zenoh.Sample) -> None:
        key = str(sample.key_expr)
        if sample.kind == zenoh.SampleKind.DELETE:
            self.tokens.pop(key, None)
            return
        found = TOKEN.fullmatch(key)
        assert found is not None, key
        node = f"{found['namespace']}%{found['name']}".replace("%", "/").replace("//", "/")
        if found["topic"] is None:
            assert found["node"] == found["id"]
            self.tokens[key] = Seen(found["kind"], node)
            return
        name = f"{found['package']}/{found['group']}/{found['type']}"
        if found["group"] == "msg" and name in STORE.fielddefs:
            assert found["hash"] in {STORE.hash_rihs01(name), "TypeHashNotSupported"}
        self.tokens[key] = Seen(found["kind"], node, found["topic"].replace("%", "/"), name, found["qos"])

    def topics(self, kind: str) -> dict[str, set[str]]:
        """The types of each topic or service of which there is such an endpoint."""
        found: defaultdict[str, set[str]] = defaultdict(set)
        for one in list(self.tokens.values()):
            if one.kind == kind:
                found[one.topic].add(one.type)
        return dict(found)

    def subscribe(self, topic: str, type_name: str, *, latched: bool = False) -> list[Any]:
        """Receive a topic. Returns the list that its messages are put into."""
        package, _, name = type_name.split("/")
        key = f"0{topic}/{package}::msg::dds_::{name}_/{STORE.hash_rihs01(type_name)}"
        into = self.messages[topic]

        def keep(sample: zenoh.Sample) -> None:
            attachment = sample.attachment
            assert attachment is not None
            assert len(attachment.to_bytes()) == 33
            into.append(STORE.deserialize_cdr(sample.payload.to_bytes(), type_name))

        if latched:
            history = ext.HistoryConfig(detect_late_publishers=True, max_samples=1)
            self._declared.append(ext.declare_advanced_subscriber(self.session, key, keep, history=history))
        else:
            self._declared.append(self.session.declare_subscriber(key, keep))
        return into

    def call(self, service: str) -> tuple[bool, str]:
        """Call a Trigger service. Returns its answer, which must be to this call."""
        (answer,) = self.call_all(service)
        return answer

    def call_all(self, service: str) -> list[tuple[bool, str]]:
        """The answers of all that serve it."""
        self._calls = calls = self._calls + 1
        gid = secrets.token_bytes(16)
        attachment = struct.pack("<qq", calls, time.time_ns()) + b"\x10" + gid
        answers: list[tuple[bool, str]] = []
        for found in self.session.get(
            f"0{service}/{TRIGGER}",
            payload=b"\0\1\0\0\0",
            attachment=attachment,
            target=zenoh.QueryTarget.ALL_COMPLETE,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=20.0,
        ):
            reply = found.ok
            assert reply is not None
            assert reply.attachment is not None
            sequence, _, length, theirs = struct.unpack("<qqB16s", reply.attachment.to_bytes())
            assert (sequence, length, theirs) == (calls, 16, gid)
            answer: Any = STORE.deserialize_cdr(reply.payload.to_bytes(), "std_srvs/msg/Trigger_Response")
            answers.append((answer.success, answer.message))
        return answers

    @contextmanager
    def twists(self, topic: str, node: str = "planner") -> Iterator[list[float]]:
        """Publish geometry_msgs/Twist at 20 Hz: the speed and yaw rate that the list holds."""
        gid, target, ended = secrets.token_bytes(16), [0.0, 0.0], threading.Event()
        name = f"geometry_msgs::msg::dds_::Twist_/{STORE.hash_rihs01('geometry_msgs/msg/Twist')}"
        mangled = topic.replace("/", "%")
        token = f"@ros2_lv/0/{self.session.info.zid()}/1/2/MP/%/%/{node}/{mangled}/{name}/1:2:1,10:,:,:,,"
        vector: Any = STORE.types["geometry_msgs/msg/Vector3"]
        twist: Any = STORE.types["geometry_msgs/msg/Twist"]

        def publish() -> None:
            sequence = 0
            while not ended.wait(0.05):
                sequence += 1
                message = twist(vector(target[0], 0.0, 0.0), vector(0.0, 0.0, target[1]))
                attachment = struct.pack("<qq", sequence, time.time_ns()) + b"\x10" + gid
                payload = bytes(STORE.serialize_cdr(message, "geometry_msgs/msg/Twist"))
                self.session.put(f"0{topic}/{name}", payload, attachment=attachment)

        thread = threading.Thread(target=publish)
        with self.session.liveliness().declare_token(token):
            thread.start()
            try:
                yield target
            finally:
                ended.set()
                thread.join()
