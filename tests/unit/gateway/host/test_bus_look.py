"""What is said of a CAN interface, and of a bus: a directory instead of the kernel, frames instead of a bus."""

import json
from collections.abc import Sequence
from pathlib import Path

import pytest

from gateway.can.can_bus import BusLost
from gateway.chassis.cruiser.frames import MOTION_FRAMES, load
from gateway.chassis.frame import ERROR, EXTENDED, Frame
from gateway.chassis.layout import Encoder
from gateway.doctor.facts import BusReport, CanInterface
from gateway.host.looks import can_interfaces, listen, look_at_interface
from schemas.messages import Variant
from schemas.settings import CanSettings, ChassisSettings, Settings
from tests.support.frames import Feedback
from tests.support.messages import SECOND

SETTINGS = Settings(can=CanSettings(interface="socketcan", channel="can0"))


class FakeBus:
    """Gives one frame after the other at a chassis's pace, again and again; it may be lost. It keeps the time."""

    def __init__(self, frames: Sequence[Frame], lost: str = "") -> None:
        self.drops = 0
        self.sent: list[Frame] = []
        self.is_closed = False
        self._frames = frames
        self._given = 0
        self._lost = lost
        self._now_ns = 0

    def receive(self, timeout_s: float) -> Frame | None:
        if self._lost:
            raise BusLost(self._lost)
        if self._given < len(self._frames) * 50 * self._now_ns / SECOND:
            self._given += 1
            return self._frames[(self._given - 1) % len(self._frames)]
        self._now_ns += round(min(timeout_s, 0.002) * SECOND) + 1
        return None

    def monotonic_ns(self) -> int:
        return self._now_ns

    def send(self, frame: Frame) -> None:
        self.sent.append(frame)

    def close(self) -> None:
        self.is_closed = True


def heard(frames: Sequence[Frame]) -> BusReport:
    """What is reported of a bus with these frames. Nothing is sent on it, whatever they are."""
    bus = FakeBus(frames)
    report = listen(SETTINGS, opener=lambda _: bus, monotonic_ns=bus.monotonic_ns)
    assert bus.sent == []
    assert bus.is_closed
    return report


def a_turn(variant: Variant) -> list[Frame]:
    """Sixteen turns of a standing chassis: its counters come round."""
    feedback = Feedback(variant)
    return [frame for _ in range(16) for frame in feedback.all()]


@pytest.mark.parametrize("variant", [Variant.COARSE, Variant.FINE])
def test_a_chassis_is_recognised_with_its_variant(variant: Variant) -> None:
    """All that a gateway needs is heard, it stands, and nobody commands it."""
    report = heard(a_turn(variant))
    assert report.health is not None
    assert report.health.variant is variant
    valid = {row.name for row in report.health.feedback if row.valid and not row.silent}
    assert valid >= set(ChassisSettings().required_feedback)
    assert report.state is not None
    assert report.state.speed_mps == 0.0
    assert not report.is_commanded


def test_frames_that_are_late_in_the_first_second_are_not_missing() -> None:
    """The computer was busy, and not the chassis silent; a frame that never comes is missing in the end."""
    feedback = Feedback(Variant.COARSE)
    late = load(Variant.COARSE).messages["Auto_DriveFeedBack"].can_id
    turns = [[frame for frame in feedback.all() if frame.can_id != late or turn >= 60] for turn in range(160)]
    bus = FakeBus([frame for turn in turns for frame in turn])
    health = listen(SETTINGS, opener=lambda _: bus, monotonic_ns=bus.monotonic_ns).health
    assert health is not None
    assert not next(row for row in health.feedback if row.name == "Auto_DriveFeedBack").silent
    never = heard([frame for frame in a_turn(Variant.COARSE) if frame.can_id != late]).health
    assert never is not None
    assert next(row for row in never.feedback if row.name == "Auto_DriveFeedBack").silent


def test_another_computers_commands_are_heard() -> None:
    """Frames that move the chassis, with a right checksum; a wrong one is nobody's."""
    encoder = Encoder(load(Variant.COARSE))
    command = encoder.encode(MOTION_FRAMES[0], {}, 1, 0)
    assert heard([*a_turn(Variant.COARSE), command]).is_commanded
    damaged = Frame(command.can_id, command.data[:7] + bytes([command.data[7] ^ 1]))
    assert not heard([*a_turn(Variant.COARSE), damaged]).is_commanded


def test_strangers_and_error_frames_are_counted() -> None:
    """That is how a bus without this chassis is told from one at another bit rate."""
    strange = heard([Frame(0x200, bytes(8)), Frame(0x18FF50E5 | EXTENDED, bytes(8))]).health
    assert strange is not None
    assert set(strange.unknown_identifiers) == {"200", "18FF50E5"}
    broken = heard([Frame(0x004 | ERROR, bytes(8))]).health
    assert broken is not None
    assert broken.faults["error_frame"] > 1


def test_a_bus_that_cannot_be_opened_or_is_lost_says_why() -> None:
    """In the words of whoever knows."""

    def not_there(_settings: Settings) -> FakeBus:
        raise BusLost("socketcan can0: No such device")

    assert listen(SETTINGS, opener=not_there).why_not == "socketcan can0: No such device"
    bus = FakeBus([], lost="the interface is down")
    assert listen(SETTINGS, opener=lambda _: bus).why_not == "the interface is down"
    assert bus.is_closed


LINK = {
    "ifname": "can0",
    "linkinfo": {
        "info_kind": "can",
        "info_data": {"state": "BUS-OFF", "restart_ms": 100, "bittiming": {"bitrate": 250000, "tq": 125}},
    },
}


def network(place: Path, name: str = "can0", flags: str = "0x40081", kind: str = "280") -> Path:
    """What the kernel shows of an interface."""
    files = place / name
    files.mkdir(parents=True)
    for file, text in (("flags", flags), ("tx_queue_len", "10"), ("type", kind)):
        (files / file).write_text(f"{text}\n")
    return place


def test_an_interface_is_read_from_the_kernel_and_from_iproute2(tmp_path: Path) -> None:
    """Bit rate, controller and restart stand in the latter alone."""
    networks = network(tmp_path)
    whole = look_at_interface(SETTINGS, lambda _: json.dumps([LINK]), networks)
    assert whole == CanInterface(
        is_present=True, is_up=True, bitrate=250_000, controller="BUS-OFF", restart_ms=100, queue_frames=10
    )
    without = look_at_interface(SETTINGS, lambda _: None, networks)
    assert without == CanInterface(is_present=True, is_up=True, queue_frames=10)


def test_an_interface_that_is_down_missing_or_virtual_is_said_to_be(tmp_path: Path) -> None:
    """One of python-can's is not looked at."""
    networks = network(tmp_path, flags="0x40080")
    virtual = json.dumps([{"linkinfo": {"info_kind": "vcan"}}])
    down = look_at_interface(SETTINGS, lambda _: virtual, networks)
    assert down == CanInterface(is_present=True, is_virtual=True, queue_frames=10)
    assert look_at_interface(SETTINGS, lambda _: "", tmp_path / "nothing") == CanInterface()
    assert look_at_interface(Settings(can=CanSettings(interface="pcan")), lambda _: "", networks) is None


def test_can_interfaces_are_found_by_their_kind(tmp_path: Path) -> None:
    """Whatever they are called."""
    network(tmp_path, "eth0", kind="1")
    network(tmp_path, "chassis")
    assert can_interfaces(network(tmp_path, "can1")) == ["can1", "chassis"]
    assert can_interfaces(tmp_path / "nothing") == []
