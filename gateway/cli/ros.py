"""``cruiser ros``: robots on a ROS 2 graph that uses rmw_zenoh."""

from __future__ import annotations

import argparse
import math
import os
import sys
import time
from collections.abc import Callable
from typing import Final

from gateway.ros.bridge import Bridge, RosChoice
from gateway.zenoh.ros import Arrivals, RosSession
from schemas import keys
from schemas.arguments import add_zenoh_arguments, ending_after, operator_name, robot_names, seconds
from schemas.command_line import CommandError, ExitCode, plain
from schemas.ros.wire import is_namespace
from schemas.settings import ROS_DISTRIBUTIONS, RosSettings, Settings

EXAMPLE: Final = """\
  cruiser ros                                      all robots, read only
  cruiser ros cruiser-1 --namespace /              one robot, topics without a namespace
  cruiser ros cruiser-1 --drive --speed-limit 0.5  take commands too
  cruiser ros --ros tcp/127.0.0.1:7449             rmw_zenohd is on another port"""

PUBLISHED: Final = """\
Publishes odom, tf, joint_states, diagnostics and remote_stop of each robot below its namespace, by
the middleware rmw_zenoh. With --drive it takes cmd_vel and ackermann_cmd, and serves engage,
disengage, park, unpark, stop and reset. See docs/ros2.md."""
DOMAIN_MAX: Final = 232  # ROS 2's own bound
DOMAIN_VARIABLE: Final = "ROS_DOMAIN_ID"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = f"{parser.description or ''}\n\n{PUBLISHED}"
    parser.add_argument(
        "robot", nargs="*", default=[keys.ALL], type=robot_names, metavar="ROBOT", help="the robots (default: all)"
    )
    parser.add_argument(
        "--ros",
        dest="ros.connect",
        metavar="ENDPOINT",
        help=f"Zenoh endpoint of rmw_zenohd (default {RosSettings().connect})",
    )
    parser.add_argument(
        "--distribution",
        dest="ros.distribution",
        choices=ROS_DISTRIBUTIONS,
        help=f"ROS 2 distribution (default {RosSettings().distribution}); humble has no type hashes",
    )
    parser.add_argument(
        "--domain", type=_domain, metavar="N", help=f"ROS domain (default ${DOMAIN_VARIABLE}, else 0)"
    )
    parser.add_argument(
        "--namespace",
        type=_namespace,
        metavar="NS",
        help="namespace of the one robot (default: its name); / for none",
    )
    parser.add_argument("--no-tf", dest="tf", action="store_false", help="no transform from odom to base_link")
    parser.add_argument("--drive", action="store_true", help="take commands and serve requests")
    parser.add_argument(
        "--speed-limit", type=_speed, metavar="M/S", help="lower speed limit while it is engaged from the graph"
    )
    parser.add_argument(
        "--operator", type=operator_name, metavar="NAME", help="operator's name (default: ros, or the grant's)"
    )
    parser.add_argument("--seconds", type=seconds, metavar="N", help="duration (default: until Ctrl-C)")
    add_zenoh_arguments(parser)


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    robots = list(dict.fromkeys(arguments.robot))
    is_one = len(robots) == 1 and "*" not in robots[0]
    if arguments.namespace is not None and not is_one:
        raise CommandError("--namespace is for one robot", ExitCode.USAGE)
    if arguments.drive and any("*" in robot for robot in robots):
        raise CommandError("name the robots that --drive may drive", ExitCode.USAGE)
    choice = RosChoice(
        tuple(robots),
        arguments.namespace,
        arguments.tf,
        arguments.drive,
        # Not the login name: the stops of whoever started it are not its own to reset.
        arguments.operator or ("" if settings.authority.mode == "signed" else "ros"),
        arguments.speed_limit,
    )
    arrivals = Arrivals()
    domain = arguments.domain
    if domain is None:
        try:
            domain = _domain(os.environ.get(DOMAIN_VARIABLE) or "0")
        except argparse.ArgumentTypeError as error:
            raise CommandError(f"{DOMAIN_VARIABLE}: {error}", ExitCode.USAGE) from None
    hashes = settings.ros.distribution != ROS_DISTRIBUTIONS[0]
    with RosSession.open(settings.ros.connect, arrivals, domain, hashes=hashes) as ros:
        bridge = Bridge(ros, arrivals, choice, settings)
        does = "drives" if choice.drive else "publishes, read only,"
        who = "all robots" if keys.ALL in robots else ", ".join(robots)
        sys.stderr.write(f"ros: {does} {who}; ROS domain {domain} at {plain(settings.ros.connect)}\n")
        try:
            bridge.run(ending_after(stopped, arguments.seconds, time.monotonic))
        finally:
            bridge.close()
    return int(ExitCode.OK)


def _speed(text: str) -> float:
    value = float(text)
    if not 0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"{text!r} is not a speed above 0")
    return value


def _domain(text: str) -> int:
    if not text.isdecimal() or int(text) > DOMAIN_MAX:
        raise argparse.ArgumentTypeError(f"{text!a} is no ROS domain: a number from 0 to {DOMAIN_MAX}")
    return int(text)


def _namespace(text: str) -> str:
    namespace = text.strip("/")
    if not is_namespace(namespace):
        raise argparse.ArgumentTypeError(
            f"{text!a} is no ROS namespace: letters, digits and _, no digit first, / between"
        )
    return namespace
