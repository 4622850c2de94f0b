"""What keeps a bus from being opened, and whether waiting helps."""

import re
import tomllib
from contextlib import closing
from pathlib import Path

import can
import pytest

from gateway.can.can_bus import (
    BusLost,
)
from gateway.can.open_bus import open_bus
from gateway.chassis.frame import EXTENDED, Frame
from schemas.command_line import CommandError, ExitCode
from schemas.settings import CanSettings


def test_frames_go_from_bus_to_bus() -> None:
    """Two buses on python-can's virtual interface hear each other."""
    settings = CanSettings(interface="virtual", channel="test-two")
    with closing(open_bus(settings)) as one, closing(open_bus(settings)) as other:
        one.send(Frame(EXTENDED | 0x18C4D1EF, b"\x01\x04", 0))
        received = other.receive(1)
        assert received is not None
        assert (received.can_id, received.data) == (EXTENDED | 0x18C4D1EF, b"\x01\x04")
        assert other.receive(0) is None


def test_a_serial_adapter_without_pyserial_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    """The extra that it names is one of ours, and brings what python-can asks for."""
    monkeypatch.setattr("can.interfaces.slcan.serial", None)
    with pytest.raises(CommandError, match=re.escape("pip install -e '.[serial]'")) as error:
        open_bus(CanSettings(interface="slcan", channel="/dev/ttyACM0"))
    assert error.value.code is ExitCode.USAGE
    project = tomllib.loads((Path(__file__).parents[4] / "pyproject.toml").read_text("utf-8"))["project"]
    (requirement,) = project["optional-dependencies"]["serial"]
    assert requirement.startswith("python-can[serial]")


def test_an_unknown_interface_is_a_wrong_setting() -> None:
    """It names the interface, and is a matter of usage."""
    with pytest.raises(CommandError, match="no-such") as error:
        open_bus(CanSettings(interface="no-such", channel="x"))
    assert error.value.code is ExitCode.USAGE


@pytest.mark.parametrize("channel", ["can0", "127.0.0.1", "127.0.0.1:", "127.0.0.1:0", "127.0.0.1:x/can0"])
def test_a_socketcand_channel_needs_host_and_port(channel: str) -> None:
    """Anything else is a wrong setting, and the line says what is wanted."""
    with pytest.raises(CommandError, match="HOST:PORT"):
        open_bus(CanSettings(interface="socketcand", channel=channel))


@pytest.mark.parametrize(
    "error", [OSError("pcanbasic library not found."), NameError("name 'canOpenChannel' is not defined")]
)
def test_a_missing_driver_is_no_matter_of_waiting(monkeypatch: pytest.MonkeyPatch, error: Exception) -> None:
    """A library that is not installed will not come by itself: a matter of usage, which names the driver."""

    def without_library(**_arguments: object) -> can.BusABC:
        raise error

    monkeypatch.setattr(can, "Bus", without_library)
    with pytest.raises(CommandError, match=r"'pcan' cannot be used: its driver is not installed \(.*n") as caught:
        open_bus(CanSettings(interface="pcan", channel="PCAN_USBBUS1"))
    assert caught.value.code is ExitCode.USAGE
    assert str(error) in str(caught.value)


def test_a_vendors_device_that_is_missing_is_a_lost_bus(monkeypatch: pytest.MonkeyPatch) -> None:
    """It may be plugged in later."""

    def without_device(**_arguments: object) -> can.BusABC:
        raise can.CanInitializationError("A PCAN Channel has not been initialized yet")

    monkeypatch.setattr(can, "Bus", without_device)
    with pytest.raises(BusLost, match="pcan PCAN_USBBUS1: A PCAN Channel"):
        open_bus(CanSettings(interface="pcan", channel="PCAN_USBBUS1"))
