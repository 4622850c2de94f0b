"""Zenoh keys: ``{root}/{robot}/{subject}``.

The root is one or more chunks, the robot is one chunk of lower-case letters, digits and hyphens, the subject is
a row of the subject table.
"""

from __future__ import annotations

import re
from typing import Final

import msgspec

from schemas.subjects import LIVELINESS_CHUNK, SUBJECTS, Subject

ROBOT_PATTERN: Final = r"[a-z0-9-]+"
BUS_PATTERN: Final = r"[A-Za-z0-9_.-]+"
ROOT_PATTERN: Final = r"[A-Za-z0-9_.-]+(/[A-Za-z0-9_.-]+)*"


class KeyParts(msgspec.Struct, frozen=True):
    """What a key says.

    Attributes:
        bus: the CAN bus's name; empty where the subject has none.
    """

    root: str
    robot: str
    subject: Subject
    bus: str = ""


def build(root: str, robot: str, subject: Subject, bus: str = "") -> str:
    """The key of a subject of a robot.

    Raises:
        ValueError: a part is not of its form, or the bus is missing or not wanted.
    """
    for text, pattern, what in ((root, ROOT_PATTERN, "root"), (robot, ROBOT_PATTERN, "robot")):
        if re.fullmatch(pattern, text) is None:
            raise ValueError(f"{what} {text!r} is not of the form {pattern}")
    if ("{bus}" in subject.name) != bool(bus):
        raise ValueError(f"subject {subject.name!r} and bus {bus!r} do not fit")
    if bus and re.fullmatch(BUS_PATTERN, bus) is None:
        raise ValueError(f"bus {bus!r} is not of the form {BUS_PATTERN}")
    return f"{root}/{robot}/{subject.name.format(bus=bus)}"


def _compile(subject: Subject) -> re.Pattern[str]:
    name = re.escape(subject.name).replace(r"\{bus\}", f"(?P<bus>{BUS_PATTERN})")
    return re.compile(rf"(?P<root>{ROOT_PATTERN})/(?P<robot>{ROBOT_PATTERN})/{name}")


_PATTERNS: Final = tuple((subject, _compile(subject)) for subject in SUBJECTS)


def parse(key: str) -> KeyParts | None:
    """What the key says, or None if it is no key of ours."""
    for subject, pattern in _PATTERNS:
        match = pattern.fullmatch(key)
        if match is not None:
            parts = match.groupdict()
            return KeyParts(parts["root"], parts["robot"], subject, parts.get("bus", ""))
    return None


def liveliness(root: str, robot: str = "*") -> str:
    """The key of a gateway's liveliness token; of every gateway's with the default robot."""
    return f"{root}/{robot}/{LIVELINESS_CHUNK}"


def robot_of_liveliness(root: str, key: str) -> str | None:
    """The robot of a liveliness key under this root, or None if it is no such key."""
    match = re.fullmatch(rf"{re.escape(root)}/({ROBOT_PATTERN})/{LIVELINESS_CHUNK}", key)
    return match[1] if match else None
