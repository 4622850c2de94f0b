# SPDX-License-Identifier: Apache-2.0
"""Passes drive commands from cmd_vel_nav on to cmd_vel, and publishes zero speed while there are none.

A planner that is idle publishes nothing, and the robot would be stopped and disengaged. Each command is passed on
once, with its own stamp: if the planner hangs while it drives, the robot slows down to zero and stays engaged.
Needs ROS 2 Jazzy: python3 ros2_idle.py --ros-args -r __ns:=/cruiser_1
"""

from contextlib import suppress

import rclpy
from geometry_msgs.msg import TwistStamped
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node

PERIOD_S = 0.05
SILENT_NS = 200_000_000


class Idle(Node):
    """The one publisher of cmd_vel."""

    def __init__(self) -> None:
        super().__init__("cmd_vel_idle")
        self.publisher = self.create_publisher(TwistStamped, "cmd_vel", 1)
        self.create_subscription(TwistStamped, "cmd_vel_nav", self.pass_on, 1)
        self.create_timer(PERIOD_S, self.fill)
        self.heard = self.get_clock().now()

    def pass_on(self, command: TwistStamped) -> None:
        self.heard = self.get_clock().now()
        self.publisher.publish(command)

    def fill(self) -> None:
        now = self.get_clock().now()
        if (now - self.heard).nanoseconds > SILENT_NS:
            zero = TwistStamped()
            zero.header.stamp = now.to_msg()
            self.publisher.publish(zero)


rclpy.init()
with suppress(KeyboardInterrupt, ExternalShutdownException):
    rclpy.spin(Idle())
