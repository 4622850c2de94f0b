"""Logs as a rosbag2 directory, for ROS 2's tools, PlotJuggler and Foxglove: ``metadata.yaml`` and an MCAP file.

It holds what ``schemas.ros.face`` makes of the gateway's messages, each robot's below its namespace. All else
is left out: rosbag2 wants every channel of a file in CDR. The log stays the evidence.
"""

from __future__ import annotations

import json
import struct
from collections import Counter
from collections.abc import Collection, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Final

import msgspec

from gateway.chassis.odometry import DeadReckoning
from gateway.choice.chassis import CHASSIS
from recorder.disk.files import give_name, new_path, staging
from recorder.mcap.writer import ChunkBuilder, LogChannel, LogStream, McapFile
from recorder.reading.logs import Faults, LogFile
from recorder.reading.rows import Progress, Selection, decoded_rows
from recorder.reading.survey import survey
from schemas.command_line import CommandError, plain
from schemas.decisions import SafetyState
from schemas.messages import GatewayHealth, Odometry, RobotState
from schemas.ros.cdr import definition, encode, type_hash
from schemas.ros.face import TOPICS, RosFace, RosMessage
from schemas.ros.wire import namespace_of

VERSION: Final = 9  # of metadata.yaml, as Jazzy and later write it
DISTRIBUTION: Final = "jazzy"
METADATA: Final = "metadata.yaml"
CHUNK_BYTES: Final = 1 << 20

_TOLD: Final = (Odometry, RobotState, SafetyState, GatewayHealth)
_ENDLESS: Final = {"sec": 9223372036, "nsec": 854775807}
_LATCHED: Final = "remote_stop"


class Bag(msgspec.Struct, frozen=True):
    """A bag that was written.

    Attributes:
        topics: messages by topic.
    """

    directory: str
    messages: int
    topics: dict[str, int]


def export_bag(
    logs: Sequence[LogFile],
    directory: Path,
    selection: Selection,
    faults: Faults,
    progress: Progress = lambda _: None,
) -> Bag | None:
    """Write a bag. Returns None if the logs hold nothing that ROS is told.

    Raises:
        CommandError: a bag is there already, the names of two robots give one namespace, or the disk does not
            take it.
    """
    wants = selection.wants
    told = msgspec.structs.replace(selection, wants=lambda topic: topic.kind in _TOLD and wants(topic))
    topics = survey(logs, Faults()).topics.values()
    namespaces: dict[str, str] = {}
    for robot in sorted({topic.robot for topic in topics if topic.kind in _TOLD and wants(topic)}):
        if (other := namespaces.setdefault(namespace_of(robot), robot)) != robot:
            raise CommandError(
                f"{plain(other)} and {plain(robot)} are both /{namespace_of(robot)}: export one alone"
            )
    try:
        directory.mkdir(parents=True, exist_ok=True)
        metadata = new_path(directory, "metadata", ".yaml")
        file = new_path(directory, f"{directory.resolve().name}_0", ".mcap")
        with staging(directory) as hidden:
            with (hidden / file.name).open("wb", buffering=0) as stream:
                bag = _BagWriter(stream, {topic.robot for topic in topics if topic.kind is Odometry})
                for row, message in decoded_rows(logs, told, faults, progress):
                    try:
                        bag.add(row.topic.robot, row.log_ns, message)
                    except (ArithmeticError, ValueError, struct.error) as error:
                        faults.add(f"{plain(row.topic.robot)}: a value that no ROS message holds: {error}")
                bag.close()
            if not bag.counts:
                return None
            (hidden / METADATA).write_text(bag.metadata(file.name), encoding="utf-8")
            give_name(hidden / file.name, file)
            give_name(hidden / METADATA, metadata)
    except OSError as error:
        raise CommandError(f"cannot write {plain(str(directory))}: {error.strerror or error}") from error
    return Bag(str(directory), bag.counts.total(), dict(sorted(bag.counts.items())))


class _BagWriter:
    def __init__(self, stream: LogStream, reckoned: Collection[str]) -> None:
        """Begin; of robots that are not ``reckoned`` the log has no odometry, and their states give it."""
        self._reckoned = reckoned
        self._reckonings: dict[str, DeadReckoning] = {}
        self.counts: Counter[str] = Counter()
        self._file = McapFile(stream, f"cruiser-gateway {version('cruiser-gateway')}", "ros2")
        self._chunk = ChunkBuilder(CHUNK_BYTES)
        self._faces: dict[str, RosFace] = {}
        self._channels: dict[str, int] = {}
        self._first_ns = self._last_ns = 0

    def add(self, robot: str, log_ns: int, message: object) -> None:
        face = self._faces.setdefault(robot, RosFace(robot, CHASSIS.wheel_radius_m))
        found = [message]
        if isinstance(message, RobotState) and robot not in self._reckoned:
            reckoning = self._reckonings.setdefault(robot, DeadReckoning(CHASSIS.wheelbase_m))
            reckoning.move(message.time_ns, message.speed_mps, message.angle_deg)
            found.append(reckoning.report())
        for one in found:
            for said in face.convert(one):
                self._write(f"/{namespace_of(robot)}/{said.topic}", log_ns, said)

    def _write(self, topic: str, log_ns: int, said: RosMessage) -> None:
        type_name = TOPICS[said.topic]
        data = encode(type_name, said.fields)
        if topic not in self._channels:
            self._channels[topic] = channel = len(self._channels) + 1
            about = {"offered_qos_profiles": _qos(topic), "topic_type_hash": type_hash(type_name)}
            schema = definition(type_name).encode()
            self._file.add_channel(LogChannel(channel, topic, type_name, schema, "ros2msg", "cdr", about))
        if not self.counts:
            self._first_ns = log_ns
        self._first_ns, self._last_ns = min(self._first_ns, log_ns), max(self._last_ns, log_ns)
        self.counts[topic] += 1
        self._chunk.add(self._channels[topic], self.counts[topic], log_ns, said.time_ns, data)
        if self._chunk.is_full:
            self._seal()

    def close(self) -> None:
        self._seal()
        self._file.finish()

    def _seal(self) -> None:
        if (chunk := self._chunk.seal()) is not None:
            self._file.write_chunk(chunk)

    def metadata(self, file: str) -> str:
        """The text of metadata.yaml: JSON, which is YAML too."""
        span = {
            "starting_time": {"nanoseconds_since_epoch": self._first_ns},
            "duration": {"nanoseconds": self._last_ns - self._first_ns},
            "message_count": self.counts.total(),
        }
        topics = []
        for topic, count in sorted(self.counts.items()):
            type_name = TOPICS[topic.rpartition("/")[2]]
            about = {
                "name": topic,
                "type": type_name,
                "serialization_format": "cdr",
                "offered_qos_profiles": json.loads(_qos(topic)),
                "type_description_hash": type_hash(type_name),
            }
            topics.append({"topic_metadata": about, "message_count": count})
        bag = {
            "version": VERSION,
            "storage_identifier": "mcap",
            **span,
            "topics_with_message_count": topics,
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [file],
            "files": [{"path": file, **span}],
            "custom_data": None,
            "ros_distro": DISTRIBUTION,
        }
        return json.dumps({"rosbag2_bagfile_information": bag}, indent=2) + "\n"


def _qos(topic: str) -> str:
    """The offered QoS of a topic, as rosbag2 writes it: a list, in YAML."""
    is_latched = topic.endswith(f"/{_LATCHED}")
    profile = {
        "history": "keep_last",
        "depth": 1 if is_latched else 10,
        "reliability": "reliable",
        "durability": "transient_local" if is_latched else "volatile",
        "deadline": _ENDLESS,
        "lifespan": _ENDLESS,
        "liveliness": "automatic",
        "liveliness_lease_duration": _ENDLESS,
        "avoid_ros_namespace_conventions": False,
    }
    return json.dumps([profile])
