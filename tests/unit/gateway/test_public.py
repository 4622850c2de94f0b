"""The public names of the package: ``from gateway import Robot``."""

import pytest

import gateway
from gateway.client.refusal import LeaseLost, Refused, Stopped, Unreachable
from gateway.client.robot import Robot
from schemas.command_line import CommandError


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
