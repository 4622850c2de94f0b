"""The gateway's messages as those of ROS."""

from math import cos, pi, radians, sin
from typing import Any

import msgspec
import pytest

from schemas.decisions import ArbiterState, SafetyState
from schemas.messages import GatewayHealth, Odometry, RobotState
from schemas.reasons import Reason
from schemas.ros.cdr import decode, encode
from schemas.ros.face import ERROR, OK, TOPICS, WARN, RosFace, RosMessage, stamp, time_of
from tests.support.messages import HEALTH, STANDBY, STATE

RADIUS_M = 0.21
TIME_NS = 1_700_000_000_123_456_789


def standby(**fields: Any) -> SafetyState:  # noqa: ANN401 - any field of the message
    return msgspec.structs.replace(STANDBY, **fields)


def face() -> RosFace:
    return RosFace("cruiser-1", RADIUS_M)


def said(messages: list[RosMessage], topic: str) -> dict[str, Any]:
    """The fields of the one message on a topic, as a subscriber reads them."""
    found = [one for one in messages if one.topic == topic]
    assert len(found) == 1
    return decode(TOPICS[topic], encode(TOPICS[topic], found[0].fields))


def odometry(heading_rad: float = pi / 2) -> Odometry:
    return Odometry(TIME_NS, 0, 1.0, 2.0, heading_rad, -0.5, 0.25, 3.0, 0.01, 0.02, 0.03, 0.04, 0.05)


def test_odometry_is_that_of_rep_105() -> None:
    """Pose in odom, speeds in base_link; what a planar robot does not measure is no zero variance."""
    messages = list(face().convert(odometry()))
    found = said(messages, "odom")
    assert (found["header"]["frame_id"], found["child_frame_id"]) == ("odom", "base_link")
    assert time_of(found["header"]) == TIME_NS
    pose, twist = found["pose"]["pose"], found["twist"]["twist"]
    assert pose["position"] == {"x": 1.0, "y": 2.0, "z": 0.0}
    assert pose["orientation"] == {"x": 0.0, "y": 0.0, "z": sin(pi / 4), "w": cos(pi / 4)}
    assert (twist["linear"]["x"], twist["angular"]["z"]) == (-0.5, 0.25)
    assert found["pose"]["covariance"][::7] == [0.01, 0.02, 1e6, 1e6, 1e6, 0.03]
    assert found["twist"]["covariance"][::7] == [0.04, 0.04, 1e6, 1e6, 1e6, 0.05]
    (transform,) = said(messages, "tf")["transforms"]
    assert (transform["header"], transform["child_frame_id"]) == (found["header"], "base_link")
    assert transform["transform"] == {"translation": pose["position"], "rotation": pose["orientation"]}


def state(time_ns: int, left_mps: float | None, right_mps: float | None, angle_deg: float | None) -> RobotState:
    return msgspec.structs.replace(
        STATE, time_ns=time_ns, rear_left_speed_mps=left_mps, rear_right_speed_mps=right_mps, angle_deg=angle_deg
    )


def test_joints_turn_with_the_wheels() -> None:
    """In rad and rad/s; over a gap nothing turns, and a joint that is not known is left out."""
    robot = face()
    said(list(robot.convert(state(TIME_NS, 0.42, -0.21, 10.0))), "joint_states")
    found = said(list(robot.convert(state(TIME_NS + 100_000_000, 0.42, -0.21, 10.0))), "joint_states")
    assert found["name"] == ["rear_left_wheel", "rear_right_wheel", "front_steering"]
    assert found["position"] == pytest.approx([0.2, -0.1, radians(10.0)])
    assert found["velocity"] == pytest.approx([2.0, -1.0, 0.0])
    found = said(list(robot.convert(state(TIME_NS + 2_000_000_000, 0.42, -0.21, None))), "joint_states")
    assert found["position"] == pytest.approx([0.2, -0.1])
    assert said(list(robot.convert(state(TIME_NS, None, None, None))), "joint_states")["name"] == []


def test_the_remote_stop_is_said_when_it_changes() -> None:
    """And at first, for who comes later finds the newest."""
    robot = face()
    stopped = standby(latched=[Reason.REMOTE_STOP])
    found = [
        one.fields["data"]
        for message in (standby(), standby(), stopped, stopped, standby())
        for one in robot.convert(message)
        if one.topic == "remote_stop"
    ]
    assert found == [False, True, False]


def test_what_is_commanded_is_said_while_the_robot_is_engaged() -> None:
    engaged = standby(state=ArbiterState.ENGAGED, engaged=True, output_speed_mps=-0.5, output_angle_deg=10.0)
    drive = said(list(face().convert(engaged)), "ackermann_output")["drive"]
    assert drive["speed"] == -0.5
    assert drive["steering_angle"] == pytest.approx(radians(10.0))
    assert not [one for one in face().convert(standby()) if one.topic == "ackermann_output"]


@pytest.mark.parametrize(
    ("latched", "blocked_by", "health", "levels", "words"),
    [
        ([], [Reason.NO_LEASE, Reason.NOT_ENGAGED], {}, [OK, OK], "standby"),
        ([], [Reason.HAND_TRANSMITTER], {}, [WARN, OK], "hand_transmitter"),
        ([Reason.FRONT_BUMPER], [Reason.FRONT_BUMPER], {}, [ERROR, OK], "'cruiser reset cruiser-1'"),
        ([], [], {"notes": ["a certificate ends"]}, [OK, WARN], "a certificate ends"),
        ([], [], {"bus_up": False, "bus_detail": "can0 is down"}, [OK, ERROR], "can0 is down"),
    ],
)
def test_diagnostics_say_why_with_the_cure(
    latched: list[Reason], blocked_by: list[Reason], health: dict[str, Any], levels: list[int], words: str
) -> None:
    robot = face()
    list(robot.convert(standby(latched=latched, blocked_by=blocked_by)))
    healthy: GatewayHealth = msgspec.structs.replace(HEALTH, bus_up=True, notes=[])
    found = said(list(robot.convert(msgspec.structs.replace(healthy, **health))), "diagnostics")["status"]
    assert [one["name"] for one in found] == ["cruiser-1: safety", "cruiser-1: gateway"]
    assert [one["level"] for one in found] == levels
    assert any(words in one["message"] for one in found)
    assert {one["hardware_id"] for one in found} == {"cruiser-1"}


def test_a_time_beyond_ros_is_its_last() -> None:
    """A stamp has 31 bits of seconds: up to 2038."""
    assert stamp(2**62) == {"sec": 2**31 - 1, "nanosec": 2**62 % 10**9}
    assert stamp(-1) == {"sec": 0, "nanosec": 0}
