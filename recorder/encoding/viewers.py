"""Records for viewers beside our own messages: event lines, a robot's pose as a transform, its outline. Pure.

The schemas are Foxglove's in protobuf (https://docs.foxglove.dev/docs/sdk/schemas): fields and numbers as
published there. A robot's frames are named by its keys, so that several robots in one view do not collide:
``fleet/cruiser-1/odom``, and ``fleet/cruiser-1/base_link``, the middle of the rear axle on the ground.
"""

from __future__ import annotations

from math import cos, sin, sqrt
from typing import Any, Final

import msgspec
from google.protobuf import duration_pb2, timestamp_pb2
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass

from schemas.command_line import short
from schemas.cruiser import TRACK_M, WHEEL_RADIUS_M, WHEELBASE_M
from schemas.decisions import SafetyEvent, Severity
from schemas.messages import Odometry
from schemas.recording import LOG_CHUNK, OUTLINE_CHUNK, TRANSFORM_CHUNK, RecorderEvent

LEVELS: Final = ("UNKNOWN", "DEBUG", "INFO", "WARNING", "ERROR", "FATAL")

_LEVEL_OF: Final = {severity: LEVELS.index(severity.name) for severity in Severity}

_ENUMS: Final = {
    "Log.Level": LEVELS,
    "LinePrimitive.Type": ("LINE_STRIP", "LINE_LOOP", "LINE_LIST"),
    "SceneEntityDeletion.Type": ("MATCHING_ID", "ALL"),
}

_MESSAGES: Final = {
    "Log": "timestamp:Timestamp level:Log.Level message:string name:string file:string line:fixed32",
    "FrameTransform": "timestamp:Timestamp parent_frame_id:string child_frame_id:string translation:Vector3 "
    "rotation:Quaternion",
    "SceneUpdate": "deletions:SceneEntityDeletion* entities:SceneEntity*",
    "SceneEntityDeletion": "timestamp:Timestamp type:SceneEntityDeletion.Type id:string",
    "SceneEntity": "timestamp:Timestamp frame_id:string id:string lifetime:Duration frame_locked:bool "
    "metadata:KeyValuePair* arrows:ArrowPrimitive* cubes:CubePrimitive* spheres:SpherePrimitive* "
    "cylinders:CylinderPrimitive* lines:LinePrimitive* triangles:TriangleListPrimitive* texts:TextPrimitive* "
    "models:ModelPrimitive*",
    "KeyValuePair": "key:string value:string",
    "ArrowPrimitive": "pose:Pose shaft_length:double shaft_diameter:double head_length:double "
    "head_diameter:double color:Color",
    "CubePrimitive": "pose:Pose size:Vector3 color:Color",
    "SpherePrimitive": "pose:Pose size:Vector3 color:Color",
    "CylinderPrimitive": "pose:Pose size:Vector3 bottom_scale:double top_scale:double color:Color",
    "LinePrimitive": "type:LinePrimitive.Type pose:Pose thickness:double scale_invariant:bool points:Point3* "
    "color:Color colors:Color* indices:fixed32*",
    "TriangleListPrimitive": "pose:Pose points:Point3* color:Color colors:Color* indices:fixed32*",
    "TextPrimitive": "pose:Pose billboard:bool font_size:double scale_invariant:bool color:Color text:string",
    "ModelPrimitive": "pose:Pose scale:Vector3 color:Color override_color:bool url:string media_type:string "
    "data:bytes",
    "Color": "r:double g:double b:double a:double",
    "Pose": "position:Vector3 orientation:Quaternion",
    "Point3": "x:double y:double z:double",
    "Vector3": "x:double y:double z:double",
    "Quaternion": "x:double y:double z:double w:double",
}
"""Each message's fields, numbered from 1; ``*`` is repeated."""

_WELL_KNOWN: Final = {
    name: FileDescriptorProto.FromString(module.DESCRIPTOR.serialized_pb)
    for name, module in (("Timestamp", timestamp_pb2), ("Duration", duration_pb2))
}


def _files(name: str) -> list[FileDescriptorProto]:
    """A file with a message and those that it holds, after the files that it needs."""
    file = FileDescriptorProto(name=f"foxglove/{name}.proto", package="foxglove", syntax="proto3")
    needed = []
    names = [name]
    for one in names:  # it grows
        message = file.message_type.add(name=one)
        for number, field in enumerate(_MESSAGES[one].split(), start=1):
            field_name, _, kind = field.partition(":")
            added = message.field.add(name=field_name, number=number, label=FieldDescriptorProto.LABEL_OPTIONAL)
            if kind.endswith("*"):
                kind, added.label = kind[:-1], FieldDescriptorProto.LABEL_REPEATED
            if kind in _ENUMS:
                added.type, added.type_name = FieldDescriptorProto.TYPE_ENUM, f".foxglove.{kind}"
                enum = message.enum_type.add(name=kind.partition(".")[2])
                for value, value_name in enumerate(_ENUMS[kind]):
                    enum.value.add(name=value_name, number=value)
            elif kind in _WELL_KNOWN:
                added.type, added.type_name = FieldDescriptorProto.TYPE_MESSAGE, f".google.protobuf.{kind}"
                if _WELL_KNOWN[kind] not in needed:
                    needed.append(_WELL_KNOWN[kind])
            elif kind in _MESSAGES:
                added.type, added.type_name = FieldDescriptorProto.TYPE_MESSAGE, f".foxglove.{kind}"
                if kind not in names:
                    names.append(kind)
            else:
                added.type = FieldDescriptorProto.Type.Value(f"TYPE_{kind.upper()}")
    file.dependency.extend(one.name for one in needed)
    return [*needed, file]


class Shown(msgspec.Struct, frozen=True):
    """A kind of record for viewers, on the topic ``{key}/{chunk}``."""

    chunk: str
    schema_name: str
    schema_data: bytes
    message: Any


def _shown(chunk: str, name: str) -> Shown:
    files, pool = _files(name), DescriptorPool()
    for file in files:
        pool.Add(file)
    message = GetMessageClass(pool.FindMessageTypeByName(f"foxglove.{name}"))
    data = FileDescriptorSet(file=files).SerializeToString(deterministic=True)
    return Shown(chunk, f"foxglove.{name}", data, message)


LINES: Final = _shown(LOG_CHUNK, "Log")
TRANSFORMS: Final = _shown(TRANSFORM_CHUNK, "FrameTransform")
OUTLINES: Final = _shown(OUTLINE_CHUNK, "SceneUpdate")
SHOWN: Final = (LINES, TRANSFORMS, OUTLINES)

TRANSFORM_NS: Final = 50_000_000  # shortest time between two transforms of a robot
OUTLINE_NS: Final = 10_000_000_000
"""The outline is repeated after this time: an incident's file, and a part of a log, have one too."""


def log_record(event: SafetyEvent | RecorderEvent, name: str) -> bytes:
    """An event as a log line of limited length; ``name`` is the sender."""
    operator = f" ({short(event.operator)})" if event.operator else ""
    kind = "" if event.text.startswith(event.kind.value) else f"{event.kind.value}: "
    text = f"{kind}{short(event.text)}{operator}"
    level = _LEVEL_OF.get(event.severity, LEVELS.index("UNKNOWN"))
    return _record(LINES, timestamp=_stamp(event.time_ns), level=level, message=text, name=name)


def transform_record(odometry: Odometry, robot: str) -> bytes:
    """The pose of a robot, by the beginning of its keys."""
    half = odometry.heading_rad / 2
    return _record(
        TRANSFORMS,
        timestamp=_stamp(odometry.time_ns),
        parent_frame_id=f"{robot}/odom",
        child_frame_id=f"{robot}/base_link",
        translation={"x": odometry.x_m, "y": odometry.y_m},
        rotation={"z": sin(half), "w": cos(half)},
    )


_BODY: Final = {"r": 0.35, "g": 0.5, "b": 0.65, "a": 0.85}
_WHEEL: Final = {"r": 0.12, "g": 0.12, "b": 0.13, "a": 1.0}
_FORWARD: Final = {"r": 0.1, "g": 0.62, "b": 0.44, "a": 1.0}
_TYRE_M: Final = 0.1  # width of a tyre as drawn
_UPRIGHT: Final = {"w": 1.0}
_ROLLS: Final = {"x": sqrt(0.5), "w": sqrt(0.5)}  # a cylinder's axis is z, a wheel's is y


def outline_record(time_ns: int, robot: str) -> bytes:
    """Wheels, a box from bumper to bumper, and an arrow forward. It lasts until the next one."""
    body = _xyz(WHEELBASE_M + 2 * WHEEL_RADIUS_M, TRACK_M - _TYRE_M, WHEEL_RADIUS_M)
    wheel = {
        "size": _xyz(2 * WHEEL_RADIUS_M, 2 * WHEEL_RADIUS_M, _TYRE_M),
        "bottom_scale": 1.0,
        "top_scale": 1.0,
        "color": _WHEEL,
    }
    arrow = {"shaft_length": 0.35, "shaft_diameter": 0.06, "head_length": 0.15, "head_diameter": 0.15}
    middle_m = WHEELBASE_M / 2
    places = [_xyz(x, y, WHEEL_RADIUS_M) for x in (0.0, WHEELBASE_M) for y in (-TRACK_M / 2, TRACK_M / 2)]
    entity = {
        "timestamp": _stamp(time_ns),
        "frame_id": f"{robot}/base_link",
        "id": robot,
        "frame_locked": True,
        "cubes": [{"pose": _pose(_xyz(middle_m, 0.0, 1.3 * WHEEL_RADIUS_M)), "size": body, "color": _BODY}],
        "cylinders": [{"pose": _pose(place, _ROLLS), **wheel} for place in places],
        "arrows": [{"pose": _pose(_xyz(middle_m, 0.0, 2 * WHEEL_RADIUS_M)), **arrow, "color": _FORWARD}],
    }
    return _record(OUTLINES, entities=[entity])


def _pose(position: dict[str, float], orientation: dict[str, float] = _UPRIGHT) -> dict[str, Any]:
    return {"position": position, "orientation": orientation}


def _xyz(x: float, y: float, z: float) -> dict[str, float]:
    return {"x": x, "y": y, "z": z}


def _stamp(time_ns: int) -> dict[str, int]:
    seconds, nanos = divmod(time_ns, 1_000_000_000)
    return {"seconds": seconds, "nanos": nanos}


def _record(shown: Shown, **content: Any) -> bytes:  # noqa: ANN401 - protobuf's fields
    data: bytes = shown.message(**content).SerializeToString(deterministic=True)
    return data
