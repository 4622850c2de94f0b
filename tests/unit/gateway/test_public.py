"""What the package offers: ``from gateway import Robot``."""

import pytest

import gateway
from gateway.client.robot import Robot


def test_the_operator_s_library_is_the_package_s_own() -> None:
    """A mistaken name is an error as of any module."""
    assert gateway.Robot is Robot
    with pytest.raises(AttributeError, match="no attribute 'Robto'"):
        gateway.Robto  # noqa: B018
