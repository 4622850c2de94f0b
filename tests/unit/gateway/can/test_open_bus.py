"""Errors on opening a bus, and reopening after a loss."""

import re
import threading
import time
import tomllib
from pathlib import Path

import can
import pytest

from gateway.can.can_bus import BusFull, BusLost
from gateway.can.open_bus import ReconnectingBus, open_bus
from gateway.chassis.frame import EXTENDED, Frame
from schemas.command_line import CommandError, ExitCode
from schemas.settings import CanSettings
from tests.support.waiting import DEADLINE_S, wait_until


class FakeBus:
    def __init__(self) -> None:
        self.frames: list[Frame] = []
        self.drops = 0
        self.lost = ""
        self.room = 100
        self.lost_after = 100
        self.tried = 0
        self.closed = False
        self.may_close = threading.Event()
        self.may_close.set()

    def receive(self, timeout_s: float) -> Frame | None:
        if self.lost:
            raise BusLost(self.lost)
        if not self.frames:
            time.sleep(min(timeout_s, 0.001))
            return None
        return self.frames.pop(0)

    def send(self, frame: Frame) -> None:
        self.tried += 1
        if self.tried > self.lost_after:
            raise BusLost("Network is down")
        if self.room == 0:
            # The next one would have room again.
            self.room = 1
            raise BusFull("Transmit buffer full")
        self.room -= 1
        self.frames.append(frame)

    def close(self) -> None:
        assert self.may_close.wait(DEADLINE_S)
        self.closed = True


FRAME = Frame(EXTENDED | 0x18C4D1EF, bytes(8))


def test_a_lost_bus_is_opened_again() -> None:
    first, second = FakeBus(), FakeBus()
    outcomes: list[FakeBus | str] = ["no such device", "no such device", second]

    def opener() -> FakeBus:
        outcome = outcomes.pop(0)
        if isinstance(outcome, str):
            raise BusLost(outcome)
        return outcome

    bus = ReconnectingBus(opener, first, first_pause_s=0.001, longest_pause_s=0.004)
    first.frames.append(FRAME)
    assert bus.receive(0.01) == FRAME
    first.drops = 3
    first.lost = "Network is down"
    assert bus.receive(0.01) is None
    assert (bus.is_up, bus.losses, bus.drops) == (False, 1, 3)
    assert bus.detail
    wait_until(lambda: (bus.receive(0.001), bus.is_up)[1])
    second.frames.append(FRAME)
    second.drops = 4
    assert bus.receive(0.01) == FRAME
    assert (bus.is_up, bus.detail, bus.losses, bus.drops) == (True, "", 1, 7)
    assert first.closed
    bus.close()
    assert second.closed


def test_a_lost_bus_that_is_slow_to_close_does_not_stop_the_loop() -> None:
    first, second = FakeBus(), FakeBus()
    closed_before: list[bool] = []

    def opener() -> FakeBus:
        closed_before.append(first.closed)
        return second

    bus = ReconnectingBus(opener, first, first_pause_s=0.001)
    first.may_close.clear()
    first.lost = "Network is down"
    assert bus.receive(0.01) is None
    assert (bus.losses, bus.is_up, first.closed) == (1, False, False)
    assert bus.receive(0.01) is None
    assert closed_before == []
    first.may_close.set()
    wait_until(lambda: (bus.receive(0.001), bus.is_up)[1])
    assert closed_before == [True]
    bus.close()


def test_closing_ends_the_search() -> None:
    def opener() -> FakeBus:
        raise BusLost("never")

    bus = ReconnectingBus(opener, None, first_pause_s=0.001)
    wait_until(lambda: bus.detail == "never")
    bus.close()
    assert not any(thread.name == "bus-opener" for thread in threading.enumerate())


BURST = [Frame(EXTENDED | 0x18C4D1D0 + 0x10000 * number, bytes(8)) for number in range(5)]


def never_opened() -> FakeBus:
    raise BusLost("never")


@pytest.mark.parametrize("room", range(5))
def test_a_burst_ends_with_the_first_frame_that_is_not_taken(room: int) -> None:
    first = FakeBus()
    bus = ReconnectingBus(never_opened, first)
    first.room = room
    assert bus.send(BURST) == room
    assert first.tried == room + 1
    assert (bus.is_up, bus.losses) == (True, 0)
    first.room = 100
    assert bus.send(BURST) == 5
    assert first.frames == BURST[:room] + BURST
    bus.close()


@pytest.mark.parametrize("room", range(5))
def test_a_bus_that_is_lost_in_the_midst_of_a_burst_says_how_far_it_came(room: int) -> None:
    first, second = FakeBus(), FakeBus()
    bus = ReconnectingBus(lambda: second, first, first_pause_s=0.001)
    first.lost_after = room
    assert bus.send(BURST) == room
    assert (bus.is_up, bus.losses, bus.detail) == (False, 1, "Network is down")
    assert bus.send(BURST) == 0
    wait_until(lambda: (bus.receive(0.001), bus.is_up)[1])
    assert second.frames == []
    assert bus.send(BURST[:2]) == 2
    assert (first.frames, second.frames) == (BURST[:room], BURST[:2])
    bus.close()


def test_a_bus_that_opens_and_is_lost_at_once_is_not_tried_without_end() -> None:
    opened: list[FakeBus] = []

    def opener() -> FakeBus:
        bus = FakeBus()
        bus.lost = "Network is down"
        opened.append(bus)
        return bus

    bus = ReconnectingBus(opener, opener(), first_pause_s=0.001, longest_pause_s=60)
    wait_until(lambda: (bus.receive(0.001), bus.losses >= 5)[1])
    assert bus._pause_s >= 0.001 * 2**4
    bus.close()
    assert all(one.closed for one in opened)


def test_a_serial_adapter_without_pyserial_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("can.interfaces.slcan.serial", None)
    with pytest.raises(CommandError, match=re.escape("pip install -e '.[serial]'")) as error:
        open_bus(CanSettings(interface="slcan", channel="/dev/ttyACM0"))
    assert error.value.code is ExitCode.USAGE
    project = tomllib.loads((Path(__file__).parents[4] / "pyproject.toml").read_text("utf-8"))["project"]
    (requirement,) = project["optional-dependencies"]["serial"]
    assert requirement.startswith("python-can[serial]")


def given(interface: str, channel: str, **options: bool) -> CanSettings:
    return CanSettings(interface=interface, channel=channel, options={**options})


@pytest.mark.parametrize(
    ("settings", "raised", "words"),
    [
        (given("no-such", "x"), CommandError, "no-such"),
        *(
            (given("socketcand", channel), CommandError, "HOST:PORT")
            for channel in ("can0", "127.0.0.1", "127.0.0.1:", "127.0.0.1:0", "127.0.0.1:x/can0")
        ),
        (
            given("socketcan", "can0", fd=True, loopback=False),
            CommandError,
            "socketcan has only fd, not 'loopback'",
        ),
        *(
            (given("socketcan", channel), BusLost, f"socketcan {channel}: No such device")
            for channel in ("nosuchcan", "no-such-interface-of-this-name", "")
        ),
        (given("socketcan", "lo"), BusLost, "socketcan lo: "),
    ],
)
def test_what_keeps_a_bus_from_being_opened(settings: CanSettings, raised: type[Exception], words: str) -> None:
    """A missing interface may come later; a wrong setting may not."""
    with pytest.raises(raised, match=re.escape(words)) as error:
        open_bus(settings)
    assert getattr(error.value, "code", ExitCode.USAGE) is ExitCode.USAGE


@pytest.mark.parametrize(
    ("error", "raised", "words"),
    [
        # A library that is not installed will not appear; a device may be plugged in later.
        (OSError("pcanbasic library not found."), CommandError, "its driver is not installed (pcanbasic"),
        (NameError("name 'canOpenChannel' is not defined"), CommandError, "its driver is not installed (name"),
        (can.CanInitializationError("A PCAN Channel has no"), BusLost, "pcan PCAN_USBBUS1: A PCAN Channel"),
    ],
)
def test_a_vendors_driver_or_device_that_is_missing_is_told_apart(
    monkeypatch: pytest.MonkeyPatch, error: Exception, raised: type[Exception], words: str
) -> None:
    def fail(**_arguments: object) -> can.BusABC:
        raise error

    monkeypatch.setattr(can, "Bus", fail)
    with pytest.raises(raised, match=re.escape(words)):
        open_bus(given("pcan", "PCAN_USBBUS1"))
