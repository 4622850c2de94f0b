"""A node of zenoh-ros2-sdk as a process: ``python -m tests.support.ros_peer PORT DIRECTORY``.

It publishes /cruiser_1/cmd_vel as TwistStamped, 20 times a second: speed and yaw rate are read from stdin, a line
each time they change. What it reads of /cruiser_1/odom and /cruiser_1/remote_stop goes to stdout, a line each. Its
definitions are those of rosbags.
"""

import sys
import threading
import time
from pathlib import Path
from typing import Any

from rosbags.typesys import Stores, get_typestore
from zenoh_ros2_sdk import ROS2Publisher, ROS2Subscriber, get_registry

TWIST, ODOMETRY, BOOL = "geometry_msgs/msg/TwistStamped", "nav_msgs/msg/Odometry", "std_msgs/msg/Bool"
PERIOD_S = 0.05


def write_definitions(directory: Path) -> None:
    """The ``.msg`` files that the library would fetch from a network."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for name in store.fielddefs:
        text, _ = store.generate_msgdef(name, ros_version=2)
        path = directory / f"{name}.msg"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text.partition("=" * 80)[0])


def main(port: int, directory: Path) -> None:
    write_definitions(directory)
    registry = get_registry()
    registry.messages_dir = directory
    router = {"router_ip": "127.0.0.1", "router_port": port}
    said = threading.Lock()

    def say(*words: object) -> None:
        with said:
            print(*words, flush=True)  # noqa: T201 - it is what the process is for

    publisher = ROS2Publisher("/cruiser_1/cmd_vel", TWIST, node_name="planner", **router)
    ROS2Subscriber("/cruiser_1/odom", ODOMETRY, lambda found: say("odom", found.twist.twist.linear.x), **router)
    ROS2Subscriber("/cruiser_1/remote_stop", BOOL, lambda found: say("remote_stop", found.data), **router)
    store: Any = publisher.session_mgr.store.types
    target = [0.0, 0.0]

    def publish() -> None:
        while True:
            seconds, nanoseconds = divmod(time.time_ns(), 1_000_000_000)
            stamp = store["builtin_interfaces/msg/Time"](seconds, nanoseconds)
            vector = store["geometry_msgs/msg/Vector3"]
            twist = store["geometry_msgs/msg/Twist"](vector(target[0], 0.0, 0.0), vector(0.0, 0.0, target[1]))
            publisher.publish(header=store["std_msgs/msg/Header"](stamp, "base_link"), twist=twist)
            time.sleep(PERIOD_S)

    threading.Thread(target=publish, daemon=True).start()
    say("ready")
    for line in sys.stdin:
        target[:] = map(float, line.split())


if __name__ == "__main__":
    main(int(sys.argv[1]), Path(sys.argv[2]))
