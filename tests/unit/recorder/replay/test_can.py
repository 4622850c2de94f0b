"""A log's frames on a virtual bus of python-can, and how it is told from a real one."""

from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import can
import pytest

from recorder.replay.can import FAILURES_MAX, CanOutlet, CanPlace, is_virtual
from recorder.replay.frames import ReplayedFrame
from schemas.exit_codes import CommandError, ExitCode
from schemas.messages import CanFrame
from tests.support.messages import WALL_NS, can_frame


def as_frame(message: can.Message) -> CanFrame:
    """What was received, as a log has it."""
    return can_frame(
        message.arbitration_id,
        WALL_NS,
        bytes(message.data),
        is_extended=message.is_extended_id,
        is_remote=message.is_remote_frame,
        is_fd=message.is_fd,
    )


@contextmanager
def bus(channel: str) -> Iterator[can.BusABC]:
    """Another one on a virtual bus."""
    with can.Bus(interface="virtual", channel=channel) as one:
        yield one


def test_a_virtual_bus_gets_the_frames_in_their_order() -> None:
    """Of every kind, bit by bit."""
    frames = [
        *(can_frame(0x18C4D1EF, data=bytes([number] * 8)) for number in range(200)),
        can_frame(0x7FF, data=b"\1", is_extended=False),
        can_frame(0x123, data=b"", is_extended=False, is_remote=True),
        can_frame(0x456, data=bytes(64), is_fd=True),
    ]
    with bus("order") as other, closing(CanOutlet(CanPlace("virtual", "order", is_fd=True))) as outlet:
        for frame in frames:
            outlet.send(ReplayedFrame(WALL_NS, frame), 0)
        assert [as_frame(message) for message in iter(lambda: other.recv(0), None)] == frames
        assert (outlet.sent, outlet.failed) == (len(frames), 0)


def test_nothing_is_sent_after_the_end() -> None:
    """There is no periodic task that outlives the replay."""
    with bus("end") as other:
        outlet = CanOutlet(CanPlace("virtual", "end"))
        outlet.send(ReplayedFrame(WALL_NS, can_frame()), 0)
        outlet.close()
        assert other.recv(0) is not None
        assert other.recv(0.2) is None
        outlet.send(ReplayedFrame(WALL_NS, can_frame()), 0)
        assert outlet.failed == 1


def test_what_others_send_does_not_pile_up() -> None:
    """Nobody here reads it."""
    with bus("pile") as other, closing(CanOutlet(CanPlace("virtual", "pile"))) as outlet:
        for _ in range(50):
            other.send(can.Message(arbitration_id=1))
        assert outlet.attend() is None
        assert outlet._bus.recv(0) is None


def test_a_bus_that_takes_nothing_is_lost() -> None:
    """Each failure is counted; after so many in a row it is told, and nothing is tried any more."""

    class Broken(can.BusABC):
        tried = 0
        refuses = True

        def __init__(self) -> None:
            self.channel_info = "broken"
            super().__init__("broken")

        def send(self, _message: can.Message, timeout: float | None = None) -> None:
            del timeout
            self.tried += 1
            if self.refuses:
                raise can.CanOperationError("No buffer space available")

        def _recv_internal(self, timeout: float | None) -> tuple[None, bool]:
            del timeout
            return None, False

    outlet = CanOutlet(CanPlace("virtual", "broken"))
    outlet.close()
    broken = Broken()
    outlet._bus = broken
    frame = ReplayedFrame(WALL_NS, can_frame())
    for _ in range(FAILURES_MAX - 1):
        outlet.send(frame, 0)
    broken.refuses = False
    outlet.send(frame, 0)
    broken.refuses = True
    assert outlet.attend() is None
    for _ in range(FAILURES_MAX + 10):
        outlet.send(frame, 0)
    halt = outlet.attend()
    assert halt is not None
    assert halt.code is ExitCode.UNREACHABLE
    assert "No buffer space" in halt.detail
    assert (outlet.sent, outlet.failed, broken.tried) == (1, 2 * FAILURES_MAX + 9, 2 * FAILURES_MAX)
    outlet.close()


def test_a_frame_that_is_none_says_nothing_of_the_bus() -> None:
    """A log may hold anything; the bus goes on."""
    with bus("none") as other, closing(CanOutlet(CanPlace("virtual", "none"))) as outlet:
        for _ in range(2 * FAILURES_MAX):
            outlet.send(ReplayedFrame(WALL_NS, can_frame(0x1FFFFFFF, is_extended=False)), 0)
        outlet.send(ReplayedFrame(WALL_NS, can_frame(data=bytes(9))), 0)
        assert outlet.attend() is None
        outlet.send(ReplayedFrame(WALL_NS, can_frame()), 0)
        assert (outlet.sent, outlet.failed) == (1, 2 * FAILURES_MAX + 1)
        assert other.recv(0) is not None


def test_a_server_elsewhere_is_not_asked() -> None:
    """Whatever it would say: it is not this machine."""
    assert not is_virtual(CanPlace("socketcand", "192.0.2.1:29536"))
    assert not is_virtual(CanPlace("socketcand", "example.invalid:29536"))


@pytest.mark.parametrize(
    ("interface", "channel"),
    [("socketcan", "can0"), ("socketcan", "vcan1"), ("socketcan", ""), ("socketcan", "vcan0/../eth0"),
     ("pcan", "vcan0"), ("slcan", "/dev/vcan0"), ("udp_multicast", "vcan0"), ("", "")],
)  # fmt: skip
def test_what_is_not_known_is_real(tmp_path: Path, interface: str, channel: str) -> None:
    """A name is not enough: the device has to be one that no hardware is behind."""
    for name in ("vcan0", "eth0"):
        (tmp_path / name).mkdir()
    assert not is_virtual(CanPlace(interface, channel), tmp_path)


def test_a_vcan_interface_is_virtual(tmp_path: Path) -> None:
    """And so is python-can's own."""
    (tmp_path / "vcan0").mkdir()
    assert is_virtual(CanPlace("socketcan", "vcan0"), tmp_path)
    assert is_virtual(CanPlace("virtual", "anything"), tmp_path)


def test_a_bus_that_cannot_be_opened_is_one_line() -> None:
    """An interface that python-can does not have is a mistake; one that is not there is unreachable."""
    with pytest.raises(CommandError) as caught:
        CanOutlet(CanPlace("teapot", "0"))
    assert caught.value.code is ExitCode.USAGE
    with pytest.raises(CommandError) as caught:
        CanOutlet(CanPlace("socketcan", "vcan-none"))
    assert caught.value.code is ExitCode.UNREACHABLE
    assert "\n" not in str(caught.value)


def test_the_settings_of_a_place_reach_python_can(monkeypatch: pytest.MonkeyPatch) -> None:
    """Bit rate and CAN FD where they are given; for socketcand its address in parts."""
    opened: list[dict[str, Any]] = []

    def fake(**arguments: Any) -> can.BusABC:  # noqa: ANN401 - python-can's own arguments
        opened.append(arguments)
        raise can.CanInitializationError("enough")

    monkeypatch.setattr("recorder.replay.can.can.Bus", fake)
    for place in (
        CanPlace("pcan", "PCAN_USBBUS1", 500_000, is_fd=True),
        CanPlace("vector", "0"),
        CanPlace("socketcand", "127.0.0.1:29536/vcan3"),
    ):
        with pytest.raises(CommandError):
            CanOutlet(place)
    common = {"ignore_config": True}
    assert opened == [
        {"interface": "pcan", "channel": "PCAN_USBBUS1", "bitrate": 500_000, "fd": True} | common,
        {"interface": "vector", "channel": "0"} | common,
        {"interface": "socketcand", "channel": "vcan3", "host": "127.0.0.1", "port": 29536} | common,
    ]
