"""Facts about the computer, a CAN interface and a bus."""

import json
import os
import time
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace

import pytest

from gateway.can.can_bus import BusLost
from gateway.chassis.cruiser.frames import MOTION_FRAMES, load
from gateway.chassis.frame import Frame
from gateway.chassis.layout import Encoder
from gateway.doctor.facts import BusReport, CanInterface, ServiceUnit
from gateway.host.looks import (
    can_interfaces,
    earliest_s,
    is_synchronised,
    listen,
    look_at_credentials,
    look_at_disk,
    look_at_interface,
    look_at_units,
    was_shut_down,
)
from gateway.host.signed_mode import AuthorityNote
from schemas.messages import Variant
from schemas.settings import AuthoritySettings, CanSettings, GatewaySettings, Settings
from tests.support.frames import Feedback
from tests.support.messages import SECOND
from tests.support.provisioning import ProvisionedFleet

DAY_S = 86_400


class FakeSystemd:
    """Answers for these services and for the journal."""

    def __init__(self, journal: str | None = None, **units: str) -> None:
        self._journal = journal
        self._units = units

    def __call__(self, words: Sequence[str]) -> str | None:
        if words[0] == "journalctl":
            return self._journal
        name = words[-1].removeprefix("cruiser-").removesuffix(".service")
        return self._units.get(name, "LoadState=not-found\nActiveState=inactive\n").replace(" ", "\n")


def test_services_that_are_enabled_or_run_are_looked_at() -> None:
    systemd = FakeSystemd(
        gateway="LoadState=loaded ActiveState=active UnitFileState=enabled Result=success NRestarts=3",
        recorder="LoadState=loaded ActiveState=failed UnitFileState=enabled Result=exit-code NRestarts=0",
        router="LoadState=loaded ActiveState=inactive UnitFileState=disabled Result=success",
    )
    gateway, recorder = look_at_units(systemd)
    assert (gateway.name, gateway.state, gateway.restarts) == ("cruiser-gateway.service", "active", 3)
    assert recorder == ServiceUnit("cruiser-recorder.service", "failed", "exit-code")
    assert look_at_units(lambda _: None) == []


@pytest.mark.parametrize("journal", [None, "", "no json", "[]", '{"UNIT_RESULT": "watchdog"}'])
def test_the_journal_knows_why_a_service_ended(journal: str | None) -> None:
    again = "LoadState=loaded ActiveState=active UnitFileState=enabled Result=success NRestarts=1"
    (unit,) = look_at_units(FakeSystemd(journal, gateway=again))
    assert (unit.result, unit.restarts, unit.ended_s) == ("success", 1, None)
    entry = '{"UNIT_RESULT": "watchdog", "__REALTIME_TIMESTAMP": "1800000000500000"}\n'
    (unit,) = look_at_units(FakeSystemd(entry, gateway=again))
    assert (unit.result, unit.ended_s) == ("watchdog", 1_800_000_000.5)


@pytest.mark.parametrize(
    ("before", "shutdown", "was"),
    [(None, None, None), ("", "", None), ("{}\n", None, None), ("{}\n", "", False), ("{}\n", "{}\n", True)],
)
def test_a_run_that_did_not_end_in_order_lost_its_power(
    before: str | None,
    shutdown: str | None,
    was: bool | None,  # noqa: FBT001 - a row of the table
) -> None:
    def journal(words: Sequence[str], kernel: str | None = None) -> str | None:
        if "--dmesg" in words:
            return kernel
        return shutdown if words[-1].startswith("MESSAGE_ID=") else before

    assert was_shut_down(journal) is was
    assert was_shut_down(lambda words: journal(words, "EXT4-fs (sda1): recovery complete")) is False


def a_file_system(flag: int = 0, free: int = 100) -> SimpleNamespace:
    return SimpleNamespace(f_flag=flag, f_bavail=free, f_blocks=1000, f_frsize=4096)


def test_a_disk_is_full_read_only_or_not_there(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(bytes(10_000))
    (tmp_path / "other.txt").write_bytes(bytes(100_000))
    missing = look_at_disk(tmp_path / "nothing")
    assert missing.why_not.endswith("nothing: no such file or directory")
    monkeypatch.setattr(os, "statvfs", lambda _: a_file_system(os.ST_RDONLY, 7))
    found = look_at_disk(tmp_path)
    assert found.is_read_only
    assert (found.free_bytes, found.size_bytes) == (7 * 4096, 1000 * 4096)
    assert 10_000 <= found.used_bytes < 20_000


@pytest.mark.parametrize(("said", "is_kept"), [("yes\n", True), ("no\n", False), ("", None), (None, None)])
def test_systemd_says_whether_a_time_server_keeps_the_clock(said: str | None, *, is_kept: bool | None) -> None:
    assert is_synchronised(lambda _: said) is is_kept


def test_what_the_authority_said_lately_is_past_for_certain(tmp_path: Path) -> None:
    settings = Settings(
        gateway=GatewaySettings(state_dir=str(tmp_path)), authority=AuthoritySettings(mode="signed")
    )
    installed_s = earliest_s(settings)
    assert 0 < installed_s <= time.time()
    path = AuthorityNote.of(settings).path
    assert path is not None
    path.write_text('{"floor_s": 4000000000}')
    assert earliest_s(settings) == 4_000_000_000
    assert earliest_s(Settings()) == installed_s


def test_certificates_and_grants_say_when_they_end_and_what_is_wrong(tmp_path: Path) -> None:
    directory = ProvisionedFleet(tmp_path).let_in("robot", "cruiser-1")
    settings = Settings(authority=AuthoritySettings(mode="signed", directory=str(directory)))
    files, now_s = [directory / "robot.json5"], time.time()

    def problems(at_s: float) -> list[str]:
        return [one.problem for one in look_at_credentials(settings, files, at_s)]

    well = look_at_credentials(settings, files, now_s)
    assert [(one.problem, one.warning) for one in well] == [("", ""), ("", "")]
    ends = [one.ends_s for one in well]
    assert ends == [pytest.approx(now_s + 30 * DAY_S, abs=600), pytest.approx(now_s + 90 * DAY_S, abs=600)]
    soon = look_at_credentials(settings, files, now_s + 85 * DAY_S)[1]
    assert "ends in 5.0 days; 'cruiser provision renew robot' asks for another" in soon.warning
    over = problems(now_s + 91 * DAY_S)
    assert "ended 61.0 days ago; 'cruiser provision renew robot'" in over[0]
    assert "the grant has expired" in over[1]
    (directory / "robot-tls.key").chmod(0o644)
    (directory / "robot.grant").unlink()
    shown, missing = problems(now_s)
    assert "can be read by others; chmod 600" in shown
    assert "robot.grant" in missing
    assert all("\n" not in one for one in (*over, shown, missing))


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can be somebody else")
def test_root_looks_with_the_owners_eyes(tmp_path: Path) -> None:
    directory = ProvisionedFleet(tmp_path).let_in("robot", "cruiser-1")
    for path in (tmp_path, *tmp_path.parents):
        if path.owner() == "root" and str(path).startswith("/tmp/"):  # noqa: S108 - pytest's own
            path.chmod(path.stat().st_mode | 0o011)
    for path in (directory, *directory.iterdir()):
        os.chown(path, 65534, 65534)
    settings = Settings(authority=AuthoritySettings(mode="signed", directory=str(directory)))
    found = look_at_credentials(settings, [directory / "robot.json5"], time.time())
    assert [one.problem for one in found] == ["", ""]
    assert os.geteuid() == os.getegid() == 0


SETTINGS = Settings(can=CanSettings(interface="socketcan", channel="can0"))


class FakeBus:
    """Delivers frames at a chassis's rate, repeatedly, on its own clock; it may be lost."""

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
    """The report of a bus with these frames, on which nothing is sent."""
    bus = FakeBus(frames)
    report = listen(SETTINGS, opener=lambda _: bus, monotonic_ns=bus.monotonic_ns)
    assert bus.sent == []
    assert bus.is_closed
    return report


def a_turn(variant: Variant) -> list[Frame]:
    """Sixteen rounds of a standing chassis, so that its counters wrap."""
    feedback = Feedback(variant)
    return [frame for _ in range(16) for frame in feedback.all()]


def test_frames_that_are_late_in_the_first_second_are_not_missing() -> None:
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
    encoder = Encoder(load(Variant.COARSE))
    command = encoder.encode(MOTION_FRAMES[0], {}, 1, 0)
    assert heard([*a_turn(Variant.COARSE), command]).is_commanded
    damaged = Frame(command.can_id, command.data[:7] + bytes([command.data[7] ^ 1]))
    assert not heard([*a_turn(Variant.COARSE), damaged]).is_commanded


def test_a_bus_that_cannot_be_opened_or_is_lost_says_why() -> None:
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
    files = place / name
    files.mkdir(parents=True)
    for file, text in (("flags", flags), ("tx_queue_len", "10"), ("type", kind)):
        (files / file).write_text(f"{text}\n")
    return place


def test_an_interface_is_read_from_the_kernel_and_from_iproute2(tmp_path: Path) -> None:
    networks = network(tmp_path)
    whole = look_at_interface(SETTINGS, lambda _: json.dumps([LINK]), networks)
    assert whole == CanInterface(
        is_present=True, is_up=True, bitrate=250_000, controller="BUS-OFF", restart_ms=100, queue_frames=10
    )
    without = look_at_interface(SETTINGS, lambda _: None, networks)
    assert without == CanInterface(is_present=True, is_up=True, queue_frames=10)


def test_an_interface_that_is_down_missing_or_virtual_is_said_to_be(tmp_path: Path) -> None:
    networks = network(tmp_path, flags="0x40080")
    virtual = json.dumps([{"linkinfo": {"info_kind": "vcan"}}])
    down = look_at_interface(SETTINGS, lambda _: virtual, networks)
    assert down == CanInterface(is_present=True, is_virtual=True, queue_frames=10)
    assert look_at_interface(SETTINGS, lambda _: "", tmp_path / "nothing") == CanInterface()
    assert look_at_interface(Settings(can=CanSettings(interface="pcan")), lambda _: "", networks) is None


def test_can_interfaces_are_found_by_their_kind(tmp_path: Path) -> None:
    network(tmp_path, "eth0", kind="1")
    network(tmp_path, "chassis")
    assert can_interfaces(network(tmp_path, "can1")) == ["can1", "chassis"]
    assert can_interfaces(tmp_path / "nothing") == []
