"""What the topics of logs are called where no key can stand: in SQL, and as a directory. Pure."""

from __future__ import annotations

import re
from collections.abc import Sequence
from fnmatch import fnmatchcase
from typing import Final

from recorder.foxglove_log import LOG_CHUNK
from recorder.review.rows import Wants
from recorder.review.topics import Topic
from schemas import keys
from schemas.messages import RawSample

RAW_CHUNK: Final = "@raw"
_SIDE_CHUNKS: Final = (LOG_CHUNK, RAW_CHUNK)
"""The last chunks of topics that a recorder makes beside the one of a key."""


def place_of(topic: Topic) -> tuple[str, str]:
    """The topic without root and robot, and the robot."""
    key, _, last = topic.name.rpartition("/")
    side = f"/{last}" if last in _SIDE_CHUNKS else ""
    parts = keys.parse(key if side else topic.name)
    if parts is None:
        return topic.name, ""
    if parts.recorder:
        return f"@recorder/{parts.recorder}/{parts.subject.name}{side}", ""
    return f"{parts.subject.name.format(bus=parts.bus)}{side}", parts.robot


def table_of(topic: Topic) -> str:
    """``can/can0/rx`` is ``can_rx``, whatever the bus is called: a column says that."""
    if topic.kind is RawSample:
        return "raw_sample"
    name = topic.name
    key, _, last = topic.name.rpartition("/")
    parts = keys.parse(key if last in _SIDE_CHUNKS else topic.name)
    if parts is not None:
        side = f"/{last}" if last in _SIDE_CHUNKS else ""
        name = parts.subject.name.replace("{bus}/", "") + side
        if parts.recorder:
            name = f"recorder/{name}"
    words = re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_").lower()
    return words if words and not words[0].isdigit() else f"topic_{words}"


def wants_of(patterns: Sequence[str]) -> Wants:
    """Whether a topic is wanted: by its name, by what follows the robot in it, or by its table; none wants all."""

    def wants(topic: Topic) -> bool:
        names = (topic.name, place_of(topic)[0], table_of(topic))
        return not patterns or any(fnmatchcase(name, pattern) for pattern in patterns for name in names)

    return wants
