"""The files that ``cruiser setup`` writes, and the programs that it runs."""

import re
import tomllib
from configparser import ConfigParser
from pathlib import Path

import msgspec
import pytest

from gateway.authority.enrolment import TransportRole
from gateway.cli.setup import (
    NOBODY_DRIVES,
    SERVICES,
    Answers,
    configuration,
    start_services,
    system_files,
)
from gateway.doctor.checks import CHECKS
from schemas.configuration import TomlSource, merge
from schemas.settings import Settings

DEPLOY = Path(__file__).parents[4] / "deploy"
"""Files of the package; those below ``etc`` stand as they do on a robot."""

ROBOT = Answers("depot-3", "", "socketcan", "can1", 250_000, free_bytes=100_000_000_000)
SIGNED = msgspec.structs.replace(ROBOT, root="fleet", keys=frozenset({"gateway", "recorder", "router"}))
VIRTUAL = msgspec.structs.replace(ROBOT, bitrate=0)
ELSEWHERE = Answers("depot-3", "", "socketcand", "127.0.0.1:29536", 0)


def settings(text: str) -> Settings:
    return merge(TomlSource("cruiser.toml", text), {}, {})


def test_the_settings_are_those_of_before_but_for_what_was_answered() -> None:
    before = '[command]\nspeed_limit_mps = 0.5\n[can]\nchannel = "can0"\noptions = {fd = true}\n'
    text = configuration(ROBOT, tomllib.loads(before))
    found = settings(text)
    assert (found.robot.name, found.can.channel, found.can.bitrate) == ("depot-3", "can1", 250_000)
    assert (found.command.speed_limit_mps, found.can.options) == (0.5, {"fd": True})
    assert (found.recorder.directory, found.recorder.budget_bytes) == ("/var/lib/cruiser/logs", 20_000_000_000)
    assert found.gateway.state_dir == "/var/lib/cruiser/gateway"
    assert configuration(ROBOT, tomllib.loads(text)) == text


def test_logs_take_no_more_than_a_small_disk_has() -> None:
    small = msgspec.structs.replace(ROBOT, free_bytes=10_000_000_000)
    assert settings(configuration(small, {})).recorder.budget_bytes == 7_000_000_000
    kept = settings(configuration(small, {"recorder": {"budget_bytes": 5}}))
    assert kept.recorder.budget_bytes == 5


def test_a_robot_with_keys_is_in_signed_mode_and_dials_the_routers_of_its_file() -> None:
    found = settings(configuration(SIGNED, {"zenoh": {"connect": ["tcp/10.0.0.5:7447"]}}))
    assert (found.authority.mode, found.authority.directory) == ("signed", "/etc/cruiser/gateway")
    assert (found.zenoh.config, found.zenoh.connect) == ("/etc/cruiser/gateway/robot.json5", [])
    drop_in = system_files(SIGNED)["/etc/systemd/system/cruiser-recorder.service.d/zenoh.conf"]
    assert "Environment=CRUISER_ZENOH_CONFIG=/etc/cruiser/recorder/recorder.json5" in drop_in
    routed = settings(configuration(msgspec.structs.replace(ROBOT, routers=["tcp/10.0.0.5:7447"]), {}))
    assert (routed.authority.mode, routed.zenoh.connect) == ("open", ["tcp/10.0.0.5:7447"])


def test_the_bit_rate_is_the_kernels_through_networkd() -> None:
    files = system_files(ROBOT)
    network = files["/etc/systemd/network/80-cruiser-can1.network"]
    assert "Name=can1" in network
    assert "BitRate=250000\nRestartSec=100ms" in network
    assert "TransmitQueueLength=10" in files["/etc/systemd/network/80-cruiser-can1.link"]
    beside = system_files(msgspec.structs.replace(ROBOT, has_network_file=True))
    assert beside["/etc/systemd/network/80-cruiser-can1.network.d/bitrate.conf"] == "[CAN]\nBitRate=250000\n"
    for answers in (VIRTUAL, ELSEWHERE):
        assert not any("/network/" in name for name in system_files(answers))
        assert not any("network" in word for program in start_services(answers) for word in program)


def parts(text: str) -> dict[str, dict[str, str]]:
    """Parse a file of systemd's; bit rates as numbers."""
    file = ConfigParser(delimiters=["="], interpolation=None)
    file.read_string(re.sub(r"(BitRate=\d+)K", r"\g<1>000", text))
    return {name: dict(file[name]) for name in file.sections()}


def test_what_is_written_for_can0_is_what_the_package_brings() -> None:
    usual = Answers("cruiser-1", "", "socketcan", "can0", 500_000, keys=frozenset(SERVICES))
    written = {name: text for name, text in system_files(usual).items() if "can0" in name}
    assert len(written) == 2
    for name, text in written.items():
        assert parts(text) == parts((DEPLOY / name[1:]).read_text("utf-8")), name
    for name, role in SERVICES.items():
        assert (DEPLOY / f"cruiser-{name}.service").exists()
        assert TransportRole(role)


@pytest.mark.parametrize(
    ("answers", "services"),
    [
        (ROBOT, ["gateway", "recorder"]),
        (SIGNED, ["router", "gateway", "recorder"]),
        (msgspec.structs.replace(SIGNED, keys=frozenset({"gateway"})), ["gateway"]),
    ],
)
def test_what_can_run_is_started_the_router_first(answers: Answers, services: list[str]) -> None:
    started = [program[-1] for program in start_services(answers) if program[1] == "restart"]
    assert started == [f"cruiser-{name}.service" for name in services]


def test_what_setup_refuses_are_findings_of_doctor() -> None:
    assert {check.name for check in CHECKS} >= NOBODY_DRIVES
