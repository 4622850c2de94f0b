"""Which messages of a ROS graph may become drive commands: the rules as a table."""

from itertools import count
from math import inf, nan, radians
from typing import Any

import pytest
from msgspec.structs import replace

from gateway.client.link import SetPoint
from gateway.ros.commands import AGE_MAX_NS, DRIFT, TOPICS, CommandReader
from gateway.telemetry.samples import Received
from schemas.ros import types
from schemas.ros.cdr import encode
from schemas.ros.face import stamp
from schemas.ros.wire import NO_HASH, Attachment, key_of

NOW_NS = 50_000_000_000
WALL_NS = 1_700_000_000_000_000_000
DAY_NS = 86_400_000_000_000
HELD_DEG = 7.0
ONE, OTHER = b"\1" * 16, b"\2" * 16

Arrived = tuple[Received, int]

SEQUENCE = count(1)


def command(
    type_name: str, fields: dict[str, Any], gid: bytes = ONE, arrived_ns: int = NOW_NS, sent_ns: int = WALL_NS
) -> Arrived:
    """A message of a topic, and when it arrived."""
    attachment = Attachment(next(SEQUENCE), sent_ns, gid).encode()
    topic = next(topic for topic, names in TOPICS.items() if type_name in names)
    key = key_of(0, f"cruiser_1/{topic}", type_name)
    return Received(key, "", encode(type_name, fields), attachment), arrived_ns


def twist(speed_mps: float, yaw_radps: float = 0.0) -> dict[str, Any]:
    return {"linear": {"x": speed_mps}, "angular": {"z": yaw_radps}}


def stamped(stamp_ns: int, speed_mps: float = 0.5) -> Arrived:
    return command(types.TWIST_STAMPED, {"header": {"stamp": stamp(stamp_ns)}, "twist": twist(speed_mps)})


def ackermann(speed_mps: float, angle_rad: float) -> Arrived:
    return command(types.ACKERMANN, {"drive": {"speed": speed_mps, "steering_angle": angle_rad}})


TWIST, _ = command(types.TWIST, twist(0.5, 0.2))


def changed(**fields: str | bytes) -> Arrived:
    return replace(TWIST, **fields), NOW_NS


CASES = [
    # (message, set point or None, words of the note)
    ((TWIST, NOW_NS), SetPoint(0.5, yaw_rate_radps=0.2), ""),
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
    (changed(attachment=b""), None, "no attachment of rmw_zenoh"),
    (changed(payload=TWIST.payload[:-3]), None, "it ends 3 bytes early"),
    (changed(payload=b"\0\0\0\0" + TWIST.payload[4:]), None, "little-endian"),
    (changed(key=TWIST.key[:-1] + "0"), None, "another version"),
    (changed(key="0/x/y"), None, "not understood"),
    (changed(key=key_of(0, "cruiser_1/ackermann_cmd", types.TWIST)), None, "not taken on this topic"),
    (changed(key=TWIST.key.rpartition("/")[0] + f"/{NO_HASH}"), SetPoint(0.5, yaw_rate_radps=0.2), ""),
]


@pytest.mark.parametrize(("given", "wanted", "note"), CASES)
def test_a_message_becomes_a_set_point_or_is_dropped(given: Arrived, wanted: SetPoint | None, note: str) -> None:
    """ros2.md A.5: SI units, left positive; the angle of a turn on the spot is that of now."""
    reader = CommandReader()
    assert reader.read(*given, NOW_NS, WALL_NS, HELD_DEG) == wanted
    assert note in reader.note
    assert bool(note) == bool(reader.note)
    # What is dropped is no sign of a publisher either.
    assert reader.arrives(NOW_NS) == (wanted is not None)


@pytest.mark.parametrize(
    ("speeds_mps", "publishers", "later_ns", "says"),
    [
        ([0.0], ["/planner"], 0, ""),
        ([0.5, 0.0], ["/planner"], 0, ""),
        ([0.0], [], 0, ""),  # its token may come after its messages
        ([], ["/planner"], 0, "no drive command arrives"),
        ([0.0], ["/planner"], AGE_MAX_NS + 1, "no drive command arrives"),
        ([0.5], ["/planner"], 0, "not zero"),
        ([0.0, 0.5], ["/planner"], 0, "not zero"),
        ([0.0], ["/planner", "/teleop"], 0, "2 publishers send drive commands (/planner, /teleop)"),
    ],
)
def test_engage_wants_one_publisher_that_says_zero(
    speeds_mps: list[float], publishers: list[str], later_ns: int, says: str
) -> None:
    reader = CommandReader()
    for speed_mps in speeds_mps:
        reader.read(*command(types.TWIST, twist(speed_mps)), NOW_NS, WALL_NS, HELD_DEG)
    why = reader.why_not_engage(publishers, NOW_NS + later_ns)
    assert says in why
    assert bool(why) == bool(says)


def test_one_publisher_an_engagement() -> None:
    """Another one is foreign until the robot is engaged again."""
    reader = CommandReader()
    reader.read(*command(types.TWIST, twist(0.0)), NOW_NS, WALL_NS, HELD_DEG)
    assert not reader.begin(["/planner"], NOW_NS)
    for given, foreign in (
        (command(types.TWIST, twist(0.0)), ""),
        (command(types.TWIST, twist(0.0), OTHER), OTHER.hex()),
        # Whether its message would be taken does not matter.
        (command(types.TWIST, twist(nan), OTHER), OTHER.hex()),
        (command(types.TWIST, twist(0.0), OTHER, arrived_ns=0), OTHER.hex()),
        (changed(attachment=b""), ""),  # no publisher of rmw_zenoh: it drives nothing either
    ):
        reader.end()
        assert not reader.begin(["/planner"], NOW_NS)
        reader.read(*given, NOW_NS, WALL_NS, HELD_DEG)
        assert reader.foreign == foreign
        assert bool(reader.confirm(["/planner"], NOW_NS)) == bool(foreign)
        reader.end()
        assert not reader.foreign
        reader.read(*command(types.TWIST, twist(0.0)), NOW_NS, WALL_NS, HELD_DEG)


def test_what_passes_while_a_robot_is_engaged_and_after() -> None:
    """Until it is confirmed, zero alone, and the wheels do not turn; after the end nothing, even if confirmed."""
    reader, turned, moving = CommandReader(), SetPoint(0.0, angle_deg=20.0), SetPoint(0.5)
    held = SetPoint(0.0, angle_deg=HELD_DEG)

    def passing() -> tuple[SetPoint | None, SetPoint | None]:
        return reader.admit(turned, HELD_DEG), reader.admit(moving, HELD_DEG)

    assert passing() == (None, None)
    reader.read(*command(types.TWIST, twist(0.0)), NOW_NS, WALL_NS, HELD_DEG)
    assert not reader.begin([], NOW_NS)
    assert passing() == (held, None)
    # It takes seconds to engage, and the planner begins meanwhile.
    reader.read(*command(types.TWIST, twist(0.5)), NOW_NS, WALL_NS, HELD_DEG)
    assert "not zero" in reader.confirm([], NOW_NS)
    assert passing() == (held, None)
    reader.read(*command(types.TWIST, twist(0.0)), NOW_NS, WALL_NS, HELD_DEG)
    assert not reader.confirm([], NOW_NS)
    assert passing() == (turned, moving)
    reader.end()
    assert passing() == (None, None)
    assert reader.confirm([], NOW_NS) == "it was stopped meanwhile"
    assert passing() == (None, None)


MS = 1_000_000


@pytest.mark.parametrize(
    ("sent", "passed"),
    [
        # (sent, arrived) in ms, by clocks that differ
        ([(0, 5000), (50, 5051), (100, 5099)], [True] * 3),
        ([(0, 5000), (50, 5400), (100, 5400)], [True, False, True]),  # the second waited for 350 ms
        # A hang of 2 s: what waited goes, what was sent at its end is taken.
        ([(0, 5000), (100, 7100), (1850, 7100), (2100, 7101)], [True, False, True, True]),
        # The clock was an hour ahead: it looks like a queue, until the publisher is restarted.
        ([(3_600_000, 5000), (0, 5050), (20_000, 25_000)], [True, False, False]),
        # A queue that grows by a twentieth of the time is found; a clock that runs off is none.
        ([(at, 5000 + at * 21 // 20) for at in range(0, 8000, 1000)], [True] * 7 + [False]),
        ([(at, 5000 + at + at // (2 * DRIFT)) for at in range(0, 1_000_000, 50_000)], [True] * 20),
        ([(-WALL_NS // MS, 5000)], [False]),  # without a time
    ],
)
def test_a_message_that_waited_in_a_queue_is_dropped(sent: list[tuple[int, int]], passed: list[bool]) -> None:
    """By the times of one publisher alone: its clock need not be ours."""
    reader = CommandReader()
    for (sent_ms, arrived_ms), is_passed in zip(sent, passed, strict=True):
        given = command(
            types.TWIST, twist(0.5), arrived_ns=arrived_ms * MS, sent_ns=max(0, WALL_NS + sent_ms * MS)
        )
        found = reader.read(*given, arrived_ms * MS, WALL_NS, HELD_DEG)
        assert (found is not None) is is_passed, (sent_ms, reader.note)
        assert is_passed or "on its way" in reader.note or "no time" in reader.note


def test_a_message_is_passed_on_once() -> None:
    """A publisher that counts from one again is taken after a pause."""
    reader = CommandReader()
    again = command(types.TWIST, twist(0.5))
    assert reader.read(*again, NOW_NS, WALL_NS, HELD_DEG) is not None
    assert reader.read(*again, NOW_NS, WALL_NS, HELD_DEG) is None
    assert "again" in reader.note
    later_ns = NOW_NS + AGE_MAX_NS + 1
    assert reader.read(again[0], later_ns, later_ns, WALL_NS, HELD_DEG) is not None


def test_only_commands_that_move_keep_a_robot_from_being_reset() -> None:
    reader = CommandReader()
    reader.read(*command(types.TWIST, twist(0.5)), NOW_NS, WALL_NS, HELD_DEG)
    assert reader.moves(NOW_NS)
    assert not reader.moves(NOW_NS + AGE_MAX_NS + 1)
    reader.read(*command(types.TWIST, twist(0.0)), NOW_NS, WALL_NS, HELD_DEG)
    assert not reader.moves(NOW_NS)
