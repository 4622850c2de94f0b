"""Command-line options that several commands share."""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Callable
from typing import Final

from schemas.keys import OPERATOR_PATTERN, ROBOT_PATTERN, ROBOTS_PATTERN


def add_zenoh_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options that name the robots' network: the Zenoh options and ``--root``."""
    add_link_arguments(parser)
    parser.add_argument("--root", dest="robot.root", metavar="ROOT", help="root of all keys (default fleet)")


def add_link_arguments(parser: argparse._ActionsContainer) -> None:
    """Add the options that select the Zenoh network to a parser, or to a group of one."""
    parser.add_argument(
        "--connect",
        dest="zenoh.connect",
        action="append",
        metavar="ENDPOINT",
        help="Zenoh endpoint to connect to, such as tcp/10.0.0.5:7447; may be repeated",
    )
    parser.add_argument("--zenoh-config", dest="zenoh.config", metavar="FILE", help="Zenoh configuration file")


def add_bus_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--robot", dest="robot.name", metavar="NAME", help="name of the robot, as in its keys")
    parser.add_argument("--interface", dest="can.interface", metavar="NAME", help="python-can interface")
    parser.add_argument("--channel", dest="can.channel", metavar="CHANNEL", help="channel of the interface")
    parser.add_argument("--bitrate", dest="can.bitrate", metavar="BIT/S", type=int, help="bit rate of the bus")


def add_variant_argument(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--variant", dest="chassis.variant", metavar="V", help="firmware variant: auto, coarse or fine"
    )


def seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of seconds above 0")
    return value


def number(low: float, high: float, what: str) -> Callable[[str], float]:
    """Return a reader of numbers in a range; ``what`` names them in its error."""

    def read(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{text!a} is not {what} from {low:g} to {high:g}")
        return value

    return read


def whole_number(low: int, high: int) -> Callable[[str], int]:
    """Return a reader of whole numbers in a range."""

    def read(text: str) -> int:
        if not text.isascii() or not text.isdigit() or not low <= int(text[:20]) <= high:
            raise argparse.ArgumentTypeError(f"{text!a} is not a whole number from {low} to {high}")
        return int(text)

    return read


def ending_after(
    stopped: Callable[[], bool], duration_s: float | None, clock_s: Callable[[], float]
) -> Callable[[], bool]:
    """``stopped``, or True once the duration has passed; None is no limit."""
    if duration_s is None:
        return stopped
    end_s = clock_s() + duration_s
    return lambda: stopped() or clock_s() >= end_s


def _name_of(what: str, pattern: str, form: str) -> Callable[[str], str]:
    def read(text: str) -> str:
        if re.fullmatch(pattern, text) is None:
            raise argparse.ArgumentTypeError(f"{text!a} cannot be {what}: {form} is {pattern}")
        return text

    return read


robot_name: Final = _name_of("a robot", ROBOT_PATTERN, "its name")
robot_names: Final = _name_of("a robot, or several", ROBOTS_PATTERN, "its name")
operator_name: Final = _name_of("an operator", OPERATOR_PATTERN, "the name")
recorder_name: Final = _name_of("a recorder", ROBOT_PATTERN, "its name")
"""Argument types for names; they raise argparse.ArgumentTypeError."""
