"""Build, parse and declare Zenoh keys, ``{root}/{robot}/{subject}``; names of operators in them.

The root is one or more chunks, the robot one chunk, the subject a row of the subject table. A recorder's keys are
``{root}/@recorder/{recorder}/{subject}``.
"""

from __future__ import annotations

import getpass
import re
from collections.abc import Callable
from functools import lru_cache
from typing import Final

import msgspec

from schemas.subjects import (
    AUTHORITY_CHUNK,
    COMMAND_CHUNK,
    LIVELINESS_CHUNK,
    RECORDER_CHUNK,
    RECORDER_SUBJECTS,
    SUBJECTS,
    Subject,
)

LONGEST: Final = 64


def login_operator() -> str:
    try:
        login = getpass.getuser()
    except (KeyError, OSError):  # The user has no name, as in some containers.
        login = ""
    return fitting(login)


def fitting(login: str) -> str:
    return re.sub(r"[^A-Za-z0-9_.-]", "-", login)[:LONGEST] or "operator"


ROBOT_PATTERN: Final = r"[a-z0-9-]+"
ROBOTS_PATTERN: Final = r"[a-z0-9*-]+"  # a robot's name, or several with ``*`` for any part
_CHUNK_PATTERN: Final = r"([a-z0-9-]|\$\*)+"  # the chunk that ``chunk_of`` makes of it
BUS_PATTERN: Final = r"[A-Za-z0-9_.-]+"
OPERATOR_PATTERN: Final = r"[A-Za-z0-9_.-]{1,64}"
ROOT_PATTERN: Final = r"[A-Za-z0-9_.-]+(/[A-Za-z0-9_.-]+)*"

KEY_MAX_LENGTH: Final = 1000  # longer keys are not parsed: Zenoh allows 64 KiB, which take 35 ms
KEYS_KEPT: Final = 4096  # parsed keys in a cache; parsing one takes 20 us, most of the time to read a sample


class KeyParts(msgspec.Struct, frozen=True):
    """The parts of a key.

    Attributes:
        robot: empty in a recorder's key.
        bus: the CAN bus's name; empty if the subject has none.
    """

    root: str
    robot: str
    subject: Subject
    bus: str = ""
    recorder: str = ""


def build(root: str, robot: str, subject: Subject, bus: str = "") -> str:
    _check("root", root, ROOT_PATTERN)
    _check("robot", robot, ROBOT_PATTERN)
    if ("{bus}" in subject.name) != bool(bus):
        raise ValueError(f"subject {subject.name!r} and bus {bus!r} do not fit")
    if bus:
        _check("bus", bus, BUS_PATTERN)
    return f"{root}/{robot}/{subject.name.format(bus=bus)}"


def _check(what: str, text: object, pattern: str) -> None:
    if not isinstance(text, str) or re.fullmatch(pattern, text) is None:
        raise ValueError(f"{what} {text!r} is not of the form {pattern}")


def _compile(subject: Subject) -> re.Pattern[str]:
    name = re.escape(subject.name).replace(r"\{bus\}", f"(?P<bus>{BUS_PATTERN})")
    return re.compile(rf"(?P<root>{ROOT_PATTERN})/(?P<robot>{ROBOT_PATTERN})/{name}")


# The longest names first: "safety/state" is not the "state" of a robot named safety.
_PATTERNS: Final = tuple(
    (subject, _compile(subject)) for subject in sorted(SUBJECTS, key=lambda one: -one.name.count("/"))
)
_OF_RECORDERS: Final = {subject.name: subject for subject in RECORDER_SUBJECTS}
_RECORDER: Final = re.compile(
    rf"(?P<root>{ROOT_PATTERN})/{RECORDER_CHUNK}/(?P<recorder>{ROBOT_PATTERN})/(?P<subject>.+)"
)


def parse(key: str) -> KeyParts | None:
    return _parse(key) if len(key) <= KEY_MAX_LENGTH else None


@lru_cache(KEYS_KEPT)
def _parse(key: str) -> KeyParts | None:
    for subject, pattern in _PATTERNS:
        match = pattern.fullmatch(key)
        if match is not None:
            parts = match.groupdict()
            return KeyParts(parts["root"], parts["robot"], subject, parts.get("bus", ""))
    match = _RECORDER.fullmatch(key)
    own = _OF_RECORDERS.get(match["subject"]) if match else None
    return KeyParts(match["root"], "", own, recorder=match["recorder"]) if match and own else None


def of_recorder(root: str, recorder: str, rest: str = "") -> str:
    """The key of a recorder, or of its subject, its command or its liveliness token; ALL is any recorder."""
    _check("root", root, ROOT_PATTERN)
    if recorder != ALL:
        _check("recorder", recorder, ROBOT_PATTERN)
    return "/".join(filter(None, (root, RECORDER_CHUNK, recorder, rest)))


def recorder_command(root: str, recorder: str, operator: str, verb: str) -> str:
    """The key of a recorder's verb; ALL may stand for recorder, operator and verb."""
    if operator != ALL:
        _check("operator", operator, OPERATOR_PATTERN)
    return of_recorder(root, recorder, f"{COMMAND_CHUNK}/{operator}/{verb}")


def chunk_of(robots: str) -> str:
    """The chunk of a key expression for one or several robots: ``cruiser-*`` becomes ``cruiser-$*``."""
    return re.sub(r"\*+", "$*", robots) if robots.strip("*") else ALL


def in_order(name: str) -> list[str | tuple[int, str]]:
    """Sort key for names: ``cruiser-2`` before ``cruiser-10``."""
    parts = re.split(r"0*([0-9]+)", name)
    # Numbers may have any length: the longer one is larger.
    return [(len(part), part) if place % 2 else part for place, part in enumerate(parts)]


def liveliness(root: str, robot: str = "*") -> str:
    """The key of a gateway's liveliness token, by default of every gateway's."""
    return f"{root}/{robot}/{LIVELINESS_CHUNK}"


ANY_TOKEN: Final = f"**/{LIVELINESS_CHUNK}"  # the liveliness token of every gateway under any root


def robot_of_liveliness(root: str, key: str) -> str | None:
    """The robot of a liveliness key under this root; None for any other key."""
    match = re.fullmatch(rf"{re.escape(root)}/({ROBOT_PATTERN})/{LIVELINESS_CHUNK}", key)
    return match[1] if match else None


ALL: Final = "*"  # any robot, operator or verb in a key expression


def command(root: str, robot: str, operator: str, verb: str) -> str:
    """The key of a verb. ALL may stand for robot, operator and verb, a ``chunk_of`` for several robots."""
    _check("root", root, ROOT_PATTERN)
    if robot != ALL:
        _check("robot", robot, _CHUNK_PATTERN)
    if operator != ALL:
        _check("operator", operator, OPERATOR_PATTERN)
    return f"{root}/{robot}/{COMMAND_CHUNK}/{operator}/{verb}"


def authority(root: str, robot: str) -> str:
    """The key of the query that sends a robot, or all with ALL, a statement of its authority."""
    return command(root, robot, ALL, ALL).removesuffix(f"{COMMAND_CHUNK}/{ALL}/{ALL}") + AUTHORITY_CHUNK


_COMMAND: Final = re.compile(rf".+/{COMMAND_CHUNK}/([^/]+)/([^/]+)")


def parse_command(key: str) -> tuple[str, str]:
    """Operator and verb of a command key, empty where they are not of their form. Never raises."""
    match = _COMMAND.fullmatch(key)
    if match is None:
        return "", ""
    operator = match[1] if re.fullmatch(OPERATOR_PATTERN, match[1]) else ""
    return operator, match[2]


KEYS_MAX: Final = 20_000
"""Keys of a thousand robots: 40 MB here and 32 MB in the router, and 10 s and 4 s of processor time if all come at
once; 4,000 keys take 1.0 s and 0.5 s (Zenoh 1.10)."""


class DeclaredKeys:
    """Declares a publisher for each received key, once, and never puts with it.

    For a declared key a Zenoh session caches the matching subscribers; for others it searches them with each
    sample: two thirds of the desk's processor time with 200 robots, a quarter of a recorder's with ten. A
    publisher also makes the key known to the router, which otherwise searches the prefixes of robots behind
    another router.

    Args:
        declare: the session's ``declare_publisher``; the session forgets a key when the returned object goes.
    """

    def __init__(self, declare: Callable[[str], object], limit: int = KEYS_MAX) -> None:
        self._declare = declare
        self._limit = limit
        self._declared: dict[str, object] = {}

    def meet(self, key: str) -> None:
        """Declare a sample's key, unless it is declared already."""
        if key not in self._declared and len(self._declared) < self._limit:
            self._declared[key] = self._declare(key)
