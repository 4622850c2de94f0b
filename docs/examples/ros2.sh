#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Ten minutes with a real ROS 2 (Jazzy or later, with rmw_zenoh_cpp), a virtual robot and no hardware. Run it where
# both `ros2` and `cruiser` are found; it ends what it started. What you should see stands before each command.
set -eu
export RMW_IMPLEMENTATION=rmw_zenoh_cpp
ROS_PORT=7460 ROBOT_PORT=7462 CAN=127.0.0.1:29546
command -v ros2 >/dev/null && command -v cruiser >/dev/null || { echo "needs ros2 and cruiser" >&2; exit 1; }
export ZENOH_CONFIG_OVERRIDE="connect/endpoints=[\"tcp/127.0.0.1:$ROS_PORT\"]"
started=""
trap 'kill $started 2>/dev/null || true' EXIT

run() { echo "\$ $*"; "$@" || echo "  -> exit code $?"; }

ZENOH_CONFIG_OVERRIDE="listen/endpoints=[\"tcp/127.0.0.1:$ROS_PORT\"]" ros2 run rmw_zenoh_cpp rmw_zenohd &
started="$started $!"
cruiser sim --listen "$CAN" &
started="$started $!"
sleep 2
cruiser gateway --interface socketcand --channel "$CAN" --listen "tcp/127.0.0.1:$ROBOT_PORT" &
started="$started $!"
sleep 2
cruiser ros cruiser-1 --drive --connect "tcp/127.0.0.1:$ROBOT_PORT" --ros "tcp/127.0.0.1:$ROS_PORT" &
started="$started $!"
sleep 3
for process in $started; do
    kill -0 "$process" || { echo "a process has not started: see above" >&2; exit 1; }
done

echo "== a node /cruiser_1/cruiser_gateway"
run ros2 node list
echo "== cmd_vel, odom, tf, joint_states, diagnostics and remote_stop below /cruiser_1"
run ros2 topic list -t
echo "== a pose of zeros, frames odom and base_link"
run ros2 topic echo --once /cruiser_1/odom
echo "== data: false, although it was published before we came"
run ros2 topic echo --once --qos-durability transient_local --qos-reliability reliable /cruiser_1/remote_stop
echo "== success: false, 'no drive command arrives'"
run ros2 service call /cruiser_1/engage std_srvs/srv/Trigger
echo "== with a node that publishes zero: success: true, twice"
python3 "$(dirname "$0")/ros2_idle.py" --ros-args -r __ns:=/cruiser_1 &
idle=$!
started="$started $idle"
sleep 2
run ros2 service call /cruiser_1/engage std_srvs/srv/Trigger
run ros2 service call /cruiser_1/unpark std_srvs/srv/Trigger
echo "== three seconds at 0.3 m/s: linear x is about 0.3; then the robot has moved by about a metre, and stands"
ros2 topic pub -r 20 -t 60 /cruiser_1/cmd_vel_nav geometry_msgs/msg/TwistStamped \
    '{header: {stamp: now}, twist: {linear: {x: 0.3}}}' >/dev/null &
sleep 2
run ros2 topic echo --once --field twist.twist.linear /cruiser_1/odom
sleep 4
run ros2 topic echo --once --field pose.pose.position /cruiser_1/odom
echo "== a second publisher: the robot is disengaged, and engage names both"
ros2 topic pub -r 20 /cruiser_1/cmd_vel geometry_msgs/msg/Twist '{linear: {x: 0.3}}' >/dev/null &
other=$!
sleep 2
run ros2 service call /cruiser_1/engage std_srvs/srv/Trigger
kill "$other"
echo "== engaged again; the publisher is killed: the diagnostics say deadman"
sleep 2
run ros2 service call /cruiser_1/engage std_srvs/srv/Trigger
kill "$idle"
sleep 2
run ros2 topic echo --once --field status /cruiser_1/diagnostics
echo "== the remote stop: success: true; then remote_stop is true"
run ros2 service call /cruiser_1/stop std_srvs/srv/Trigger
run ros2 topic echo --once --qos-durability transient_local --qos-reliability reliable /cruiser_1/remote_stop
run ros2 service call /cruiser_1/reset std_srvs/srv/Trigger
echo "done: please tell us what differed"
