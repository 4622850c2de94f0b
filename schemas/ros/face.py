"""The gateway's messages as those of ROS, in SI units by REP 103, with the frames of REP 105. Pure.

``base_link`` is the middle of the rear axle on the ground: x forward, y left, z up.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from math import cos, pi, radians, remainder, sin, tau
from typing import Any, Final

import msgspec

from schemas.decisions import ArbiterState, SafetyState
from schemas.messages import GatewayHealth, Odometry, RobotState
from schemas.reasons import Reason, cure_of, of_a_robot
from schemas.ros import types

ODOM_FRAME, BASE_FRAME = "odom", "base_link"
JOINTS: Final = ("rear_left_wheel", "rear_right_wheel", "front_steering")

TOPICS: Final = {
    "odom": types.ODOMETRY,
    "tf": types.TF,
    "joint_states": types.JOINT_STATE,
    "diagnostics": types.DIAGNOSTICS,
    "remote_stop": types.BOOL,
    "ackermann_output": types.ACKERMANN,
}
"""The types of a robot's topics, by their names below its namespace."""

UNKNOWN_VARIANCE: Final = 1e6  # of what a planar robot does not measure: z, roll, pitch, and speeds along them
OK, WARN, ERROR, STALE = range(4)
GAP_NS: Final = 500_000_000  # wheels are not turned further over a longer gap

_INT32_MAX: Final = 2**31 - 1


class RosMessage(msgspec.Struct, frozen=True):
    """A message for a topic.

    Attributes:
        topic: one of TOPICS.
        time_ns: when its fact became known, since 1970.
        fields: by the type's definition.
    """

    topic: str
    time_ns: int
    fields: dict[str, Any]


def stamp(time_ns: int) -> dict[str, int]:
    seconds, nanoseconds = divmod(max(time_ns, 0), 1_000_000_000)
    return {"sec": min(seconds, _INT32_MAX), "nanosec": nanoseconds}


def _header(time_ns: int, frame: str) -> dict[str, Any]:
    return {"stamp": stamp(time_ns), "frame_id": frame}


def time_of(header: dict[str, Any]) -> int:
    """The time of a header's stamp, in ns since 1970; 0 if the sender left it out."""
    found = header["stamp"]
    return int(found["sec"]) * 1_000_000_000 + int(found["nanosec"])


class RosFace:
    """A robot as ROS sees it: remembers what one topic says of several messages."""

    def __init__(self, robot: str, wheel_radius_m: float) -> None:
        self._robot = robot
        self._wheel_radius_m = wheel_radius_m
        self._turned = [0.0, 0.0]
        self._wheels_ns = 0
        self._stopped: bool | None = None
        self._safety: SafetyState | None = None
        self._chassis: RobotState | None = None

    def convert(self, message: object) -> Iterator[RosMessage]:
        """The ROS messages for one of the gateway's; none if it is not one that ROS is told."""
        match message:
            case Odometry():
                pose, transform = _odometry(message)
                yield RosMessage("odom", message.time_ns, pose)
                yield RosMessage("tf", message.time_ns, {"transforms": [transform]})
            case RobotState():
                self._chassis = message
                yield RosMessage("joint_states", message.time_ns, self._joints(message))
            case SafetyState():
                self._safety = message
                stopped = Reason.REMOTE_STOP in message.latched
                if stopped is not self._stopped:
                    self._stopped = stopped
                    yield RosMessage("remote_stop", message.time_ns, {"data": stopped})
                if message.engaged:
                    yield RosMessage("ackermann_output", message.time_ns, _output(message))
            case GatewayHealth():
                found = [*self._arbiter(), _gateway(self._robot, message)]
                fields = {"header": {"stamp": stamp(message.time_ns)}, "status": found}
                yield RosMessage("diagnostics", message.time_ns, fields)

    def _arbiter(self) -> list[dict[str, Any]]:
        """Why the robot stands still, with the cures; empty before its state is known."""
        state = self._safety
        if state is None:
            return []
        reasons = list(dict.fromkeys([*state.latched, *state.blocked_by]))
        idle = {Reason.NO_LEASE, Reason.NOT_ENGAGED}.issuperset(reasons)
        level = ERROR if state.latched else OK if idle else WARN
        whys = "; ".join(_why(reason, self._robot, reasons) for reason in reasons)
        values = {
            "state": state.state.value,
            "lease_holder": state.lease_holder,
            "latched": ", ".join(one.value for one in state.latched),
            "blocked_by": ", ".join(one.value for one in state.blocked_by),
            "stop_reason": state.stop_reason.value if state.state is not ArbiterState.ENGAGED else "",
            "speed_limit_mps": f"{state.speed_limit_mps:g}",
            "mode": self._chassis.mode.value if self._chassis is not None else "",
        }
        message = state.state.value if idle else whys
        return [status(level, f"{self._robot}: safety", message, self._robot, values)]

    def _joints(self, state: RobotState) -> dict[str, Any]:
        """Wheels turn by their speeds since the start; a joint that is not known is left out."""
        span_ns, self._wheels_ns = state.time_ns - self._wheels_ns, state.time_ns
        names, positions, velocities = [], [], []
        speeds = (state.rear_left_speed_mps, state.rear_right_speed_mps)
        for side, (name, speed_mps) in enumerate(zip(JOINTS, speeds, strict=False)):
            if speed_mps is not None:
                velocity = speed_mps / self._wheel_radius_m
                if 0 < span_ns <= GAP_NS:
                    self._turned[side] = remainder(self._turned[side] + velocity * span_ns / 1e9, tau)
                names.append(name)
                positions.append(self._turned[side])
                velocities.append(velocity)
        if state.angle_deg is not None:
            names.append(JOINTS[2])
            positions.append(radians(state.angle_deg))
            velocities.append(0.0)
        header = _header(state.time_ns, BASE_FRAME)
        return {"header": header, "name": names, "position": positions, "velocity": velocities}


def status(level: int, name: str, message: str, hardware: str, values: dict[str, str]) -> dict[str, Any]:
    """A diagnostic_msgs/DiagnosticStatus."""
    pairs = [{"key": key, "value": value} for key, value in values.items()]
    return {"level": level, "name": name, "message": message, "hardware_id": hardware, "values": pairs}


def _why(reason: Reason, robot: str, beside: Iterable[Reason]) -> str:
    text = of_a_robot(reason, list(beside))
    cure = cure_of(text.cure, robot)
    return f"{text.means} ({reason.value})" + (f"; {cure}" if cure else "")


def _gateway(robot: str, health: GatewayHealth) -> dict[str, Any]:
    level = ERROR if not health.bus_up else WARN if health.notes else OK
    message = health.bus_detail if not health.bus_up else "; ".join(health.notes) or "ok"
    values = {
        "bus": health.bus,
        "frames_per_s": f"{health.frames_per_s:g}",
        "bus_drops": str(health.bus_drops),
        "tick_lateness_p99_ms": f"{health.tick_lateness_p99_ms:.2f}",
        "cpu_percent": f"{health.cpu_percent:.1f}",
        "variant": health.variant.value,
        "version": health.gateway_version,
    }
    return status(level, f"{robot}: gateway", message, robot, values)


def _odometry(odometry: Odometry) -> tuple[dict[str, Any], dict[str, Any]]:
    """A pose in odom with the speeds in base_link, and the transform between these frames."""
    frames = {"header": _header(odometry.time_ns, ODOM_FRAME), "child_frame_id": BASE_FRAME}
    half = min(max(odometry.heading_rad, -pi), pi) / 2
    place, turn = {"x": odometry.x_m, "y": odometry.y_m}, {"z": sin(half), "w": cos(half)}
    twist = {"linear": {"x": odometry.speed_mps}, "angular": {"z": odometry.yaw_rate_radps}}
    of_pose = _covariance(odometry.x_variance_m2, odometry.y_variance_m2, odometry.heading_variance_rad2)
    speed_variance = odometry.speed_variance_m2ps2  # The middle of the rear axle does not slip aside.
    of_twist = _covariance(speed_variance, speed_variance, odometry.yaw_rate_variance_rad2ps2)
    return {
        **frames,
        "pose": {"pose": {"position": place, "orientation": turn}, "covariance": of_pose},
        "twist": {"twist": twist, "covariance": of_twist},
    }, {**frames, "transform": {"translation": place, "rotation": turn}}


def _output(state: SafetyState) -> dict[str, Any]:
    drive = {"steering_angle": radians(state.output_angle_deg), "speed": state.output_speed_mps}
    return {"header": _header(state.time_ns, BASE_FRAME), "drive": drive}


def _covariance(x: float, y: float, yaw: float) -> list[float]:
    """The 6 by 6 matrix, row by row: x, y, z, roll, pitch, yaw."""
    matrix = [0.0] * 36
    matrix[::7] = (x, y, UNKNOWN_VARIANCE, UNKNOWN_VARIANCE, UNKNOWN_VARIANCE, yaw)
    return matrix
