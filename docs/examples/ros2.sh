#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Ten minutes with a real ROS 2 (Jazzy or later, with rmw_zenoh_cpp), a virtual robot and no hardware. Run it where
# both `ros2` and `cruiser` are found; it ends what it started. What you should see stands before each command.
set -eu
export RMW_IMPLEMENTATION=rmw_zenoh_cpp
ROS_PORT=7448 ROBOT_PORT=7449
export ZENOH_CONFIG_OVERRIDE="connect/endpoints=[\"tcp/127.0.0.1:$ROS_PORT\"]"
started=""
trap 'kill $started 2>/dev/null || true' EXIT

run() { echo "\$ $*"; "$@" || echo "  -> exit code $?"; }

ZENOH_CONFIG_OVERRIDE="listen/endpoints=[\"tcp/127.0.0.1:$ROS_PORT\"]" ros2 run rmw_zenoh_cpp rmw_zenohd &
started="$started $!"
cruiser sim --listen 127.0.0.1:29536 &
started="$started $!"
sleep 2
cruiser gateway --interface socketcand --channel 127.0.0.1:29536 --listen "tcp/127.0.0.1:$ROBOT_PORT" &
started="$started $!"
sleep 2
cruiser ros cruiser-1 --drive --connect "tcp/127.0.0.1:$ROBOT_PORT" --ros "tcp/127.0.0.1:$ROS_PORT" &
started="$started $!"
sleep 3

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
echo "== with a publisher of zero: success: true, twice"
ros2 topic pub -r 20 /cruiser_1/cmd_vel geometry_msgs/msg/Twist '{}' >/dev/null &
zero=$!
sleep 2
run ros2 service call /cruiser_1/engage std_srvs/srv/Trigger
run ros2 service call /cruiser_1/unpark std_srvs/srv/Trigger
echo "== a second publisher: the robot is disengaged, and engage names both"
ros2 topic pub -r 20 /cruiser_1/cmd_vel geometry_msgs/msg/Twist '{linear: {x: 0.3}}' >/dev/null &
other=$!
sleep 2
run ros2 service call /cruiser_1/engage std_srvs/srv/Trigger
kill "$zero" "$other"
echo "== the remote stop: success: true; then remote_stop is true"
run ros2 service call /cruiser_1/stop std_srvs/srv/Trigger
run ros2 topic echo --once --qos-durability transient_local --qos-reliability reliable /cruiser_1/remote_stop
run ros2 service call /cruiser_1/reset std_srvs/srv/Trigger
echo "done: please tell us what differed"
