"""Which messages of a ROS graph may become drive commands: the rules as a table."""

from math import inf, nan, radians
from typing import Any

import pytest

from gateway.client.link import SetPoint
from gateway.ros.commands import AGE_MAX_NS, CommandReader, RosCommand
from schemas.ros import types
from schemas.ros.cdr import encode
from schemas.ros.face import stamp
from schemas.ros.wire import NO_HASH, Attachment, key_of

NOW_NS = 50_000_000_000
WALL_NS = 1_700_000_000_000_000_000
DAY_NS = 86_400_000_000_000
HELD_DEG = 7.0
ONE, OTHER = b"\1" * 16, b"\2" * 16


def command(type_name: str, fields: dict[str, Any], gid: bytes = ONE, arrived_ns: int = NOW_NS) -> RosCommand:
    attachment = Attachment(1, WALL_NS, gid).encode()
    return RosCommand(key_of(0, "cruiser_1/cmd_vel", type_name), encode(type_name, fields), attachment, arrived_ns)


def twist(speed_mps: float, yaw_radps: float = 0.0) -> dict[str, Any]:
    return {"linear": {"x": speed_mps}, "angular": {"z": yaw_radps}}


def stamped(stamp_ns: int, speed_mps: float = 0.5) -> RosCommand:
    return command(types.TWIST_STAMPED, {"header": {"stamp": stamp(stamp_ns)}, "twist": twist(speed_mps)})


def ackermann(speed_mps: float, angle_rad: float) -> RosCommand:
    return command(types.ACKERMANN, {"drive": {"speed": speed_mps, "steering_angle": angle_rad}})


TWIST = command(types.TWIST, twist(0.5, 0.2))
CASES = [
    # (message, set point or None, words of the note)
    (TWIST, SetPoint(0.5, yaw_rate_radps=0.2), ""),
    (command(types.TWIST, twist(-0.5, 0.2)), SetPoint(-0.5, yaw_rate_radps=0.2), ""),
    (command(types.TWIST, twist(0.0)), SetPoint(0.0, angle_deg=HELD_DEG), ""),
    (command(types.TWIST, twist(0.0, 1.0)), SetPoint(0.0, angle_deg=HELD_DEG), "cannot turn on the spot"),
    (ackermann(0.5, radians(12)), SetPoint(0.5, angle_deg=12.000000333930423), ""),
    (stamped(WALL_NS), SetPoint(0.5, yaw_rate_radps=0.0), ""),
    (stamped(0), SetPoint(0.5, yaw_rate_radps=0.0), ""),  # not stamped
    (stamped(WALL_NS - AGE_MAX_NS), SetPoint(0.5, yaw_rate_radps=0.0), ""),
    (stamped(WALL_NS - AGE_MAX_NS - 1), None, "its stamp is 0.3 s old"),
    (stamped(WALL_NS + DAY_NS), None, "its stamp is 86400.0 s ahead of this computer's clock"),
    (command(types.TWIST, twist(0.5), arrived_ns=NOW_NS - AGE_MAX_NS - 1), None, "it waited 0.3 s"),
    (command(types.TWIST, twist(nan)), None, "not finite"),
    (command(types.TWIST, twist(0.5, inf)), None, "not finite"),
    (ackermann(0.5, nan), None, "not finite"),
    (RosCommand(TWIST.key, TWIST.payload, b"", NOW_NS), None, "no attachment of rmw_zenoh"),
    (RosCommand(TWIST.key, TWIST.payload[:-3], TWIST.attachment, NOW_NS), None, "it ends 3 bytes early"),
    (RosCommand(TWIST.key, b"\0\0\0\0" + TWIST.payload[4:], TWIST.attachment, NOW_NS), None, "little-endian"),
    (RosCommand(TWIST.key[:-1] + "0", TWIST.payload, TWIST.attachment, NOW_NS), None, "another version"),
    (RosCommand("0/x/y", TWIST.payload, TWIST.attachment, NOW_NS), None, "not understood"),
    (
        RosCommand(TWIST.key.rpartition("/")[0] + f"/{NO_HASH}", TWIST.payload, TWIST.attachment, NOW_NS),
        SetPoint(0.5, yaw_rate_radps=0.2),
        "",
    ),
]


@pytest.mark.parametrize(("given", "wanted", "note"), CASES)
def test_a_message_becomes_a_set_point_or_is_dropped(
    given: RosCommand, wanted: SetPoint | None, note: str
) -> None:
    """ros2.md A.5: SI units, left positive; the angle of a turn on the spot is that of now."""
    reader = CommandReader()
    assert reader.read(given, NOW_NS, WALL_NS, HELD_DEG) == wanted
    assert note in reader.note
    assert bool(note) == bool(reader.note)
    # What is dropped is no sign of a publisher either.
    assert reader.arrives(NOW_NS) == (wanted is not None)


ZERO, MOVING = command(types.TWIST, twist(0.0)), command(types.TWIST, twist(0.5))


@pytest.mark.parametrize(
    ("commands", "publishers", "later_ns", "says"),
    [
        ([ZERO], ["/planner"], 0, ""),
        ([MOVING, ZERO], ["/planner"], 0, ""),
        ([ZERO], [], 0, ""),  # its token may come after its messages
        ([], ["/planner"], 0, "no drive command arrives"),
        ([ZERO], ["/planner"], AGE_MAX_NS + 1, "no drive command arrives"),
        ([MOVING], ["/planner"], 0, "not zero"),
        ([ZERO, MOVING], ["/planner"], 0, "not zero"),
        ([ZERO], ["/planner", "/teleop"], 0, "2 publishers send drive commands (/planner, /teleop)"),
    ],
)
def test_engage_wants_one_publisher_that_says_zero(
    commands: list[RosCommand], publishers: list[str], later_ns: int, says: str
) -> None:
    reader = CommandReader()
    for one in commands:
        reader.read(one, NOW_NS, WALL_NS, HELD_DEG)
    why = reader.why_not_engage(publishers, NOW_NS + later_ns)
    assert says in why
    assert bool(why) == bool(says)


def test_one_publisher_an_engagement() -> None:
    """Another one is foreign until the robot is engaged again."""
    reader = CommandReader()
    reader.read(ZERO, NOW_NS, WALL_NS, HELD_DEG)
    reader.begin()
    assert not reader.is_foreign
    reader.read(command(types.TWIST, twist(0.0), OTHER), NOW_NS, WALL_NS, HELD_DEG)
    assert reader.is_foreign
    assert reader.publisher == OTHER.hex()
    reader.end()
    assert not reader.is_foreign
    reader.begin()
    assert not reader.is_foreign


def test_only_commands_that_move_keep_a_robot_from_being_reset() -> None:
    reader = CommandReader()
    reader.read(MOVING, NOW_NS, WALL_NS, HELD_DEG)
    assert reader.moves(NOW_NS)
    assert not reader.moves(NOW_NS + AGE_MAX_NS + 1)
    reader.read(ZERO, NOW_NS, WALL_NS, HELD_DEG)
    assert not reader.moves(NOW_NS)
