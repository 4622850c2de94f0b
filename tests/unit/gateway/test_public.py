"""The public names of the package: ``from gateway import Robot``."""

from types import FunctionType

import pytest

import gateway
from gateway.client import remote_stop, robot
from gateway.client.link import RobotLink, SetPoint
from gateway.client.refusal import LeaseLost, Refused, Stopped, Unreachable
from gateway.client.robot import Lease, Robot
from schemas.command_line import CommandError
from schemas.subjects import BY_VERB

SENDERS = {
    "acquire": Robot.lease,
    "renew": RobotLink._renew,
    "release": Lease.__exit__,
    "take": Robot.take,
    "engage": Lease.engage,
    "disengage": Lease.disengage,
    "reset": robot._reset,
    "park": Lease.park,
    "unpark": Lease.unpark,
    "light": Lease.light,
    "horn": Lease.horn,
    "clear_odometer": Lease.clear_odometer,
    "reset_odometry": Lease.reset_odometry,
    "drive": SetPoint.command,
}


def test_the_operator_s_library_is_the_package_s_own() -> None:
    """A mistaken name is an error as of any module."""
    assert gateway.Robot is Robot
    with pytest.raises(AttributeError, match="no attribute 'Robto'"):
        gateway.Robto  # noqa: B018


def test_every_fault_of_a_robot_is_caught_by_one_class() -> None:
    """Those that a program tells apart are the package's own too."""
    for kind in (Refused, Stopped, LeaseLost, Unreachable):
        assert getattr(gateway, kind.__name__) is kind
        assert issubclass(kind, gateway.CommandError)
    assert gateway.CommandError is CommandError


def test_the_library_sends_each_verb() -> None:
    assert {*SENDERS, remote_stop.STOP.verb} == BY_VERB.keys()
    for verb, sender in SENDERS.items():
        assert isinstance(sender, FunctionType)
        assert BY_VERB[verb].request.__name__ in sender.__code__.co_names, verb
