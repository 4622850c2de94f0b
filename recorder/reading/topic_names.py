"""Names for topics where a key cannot be used: in SQL, and as a directory. Pure."""

from __future__ import annotations

import re
from collections.abc import Sequence
from fnmatch import fnmatchcase
from urllib.parse import quote

from recorder.reading.rows import Wants
from recorder.reading.topics import Topic, key_of
from schemas import keys
from schemas.messages import RawSample


def place_of(topic: Topic) -> tuple[str, str]:
    """The topic without root and robot, and the robot."""
    key, side = key_of(topic.name)
    parts = keys.parse(key)
    if parts is None:
        return topic.name, ""
    if parts.recorder:
        return f"@recorder/{parts.recorder}/{parts.subject.name}{side}", ""
    return f"{parts.subject.name.format(bus=parts.bus)}{side}", topic.owner


def table_of(topic: Topic) -> str:
    """``can/can0/rx`` is ``can_rx``, whatever the bus is called: a column says that."""
    if topic.kind is RawSample:
        return "raw_sample"
    name = topic.name
    key, side = key_of(topic.name)
    parts = keys.parse(key)
    if parts is not None:
        name = parts.subject.name.replace("{bus}/", "") + side
        if parts.recorder:
            name = f"recorder/{name}"
    words = re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_").lower()
    return words if words and not words[0].isdigit() else f"topic_{words}"


def wants_of(patterns: Sequence[str]) -> Wants:
    """Return a test of a topic by its name, its part behind the robot, or its table; without patterns all pass."""

    def wants(topic: Topic) -> bool:
        names = (topic.name, place_of(topic)[0], table_of(topic))
        return not patterns or any(fnmatchcase(name, pattern) for pattern in patterns for name in names)

    return wants


def file_name(topic: str) -> str:
    """``fleet/cruiser-1/state`` is ``fleet.cruiser-1.state``; what a name may not hold is escaped as in a URL."""
    chunks = [quote(chunk, safe="@ ", errors="replace").replace(".", "%2E") for chunk in topic.split("/")]
    name = ".".join(chunks)
    # ROS's topics begin with a slash. A name with a dot in front is a hidden file's, one with a dash an option.
    first = {".": "%2F", "-": "%2D"}.get(name[:1], name[:1])
    return f"{first}{name[1:]}"[:200] or "%"
