"""``cruiser setup`` on a machine below a directory, with a virtual chassis, and services as processes."""

import os
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import patch

import msgspec
import pytest

from gateway.cli import setup
from gateway.cli.configuration_file import load_settings
from gateway.cli.setup import Machine
from gateway.doctor.facts import BusReport
from schemas.command_line import CommandError, ExitCode
from schemas.settings import ChassisSettings
from schemas.zenoh_session import split_endpoint
from tests.support import provisioning
from tests.support.commands import parsed
from tests.support.fakes.peer import free_endpoint
from tests.support.messages import HEALTH, STATE
from tests.support.processes.gateway import Running, chassis, gateway
from tests.support.provisioning import ProvisionedFleet

TOML = "/etc/cruiser/cruiser.toml"
WELL = "standing, feedback complete, guarded, recording, "
ELSEWHERE = ("realtime: ", "note: ")  # findings that depend on the test machine


class FakeSystemd:
    """A machine below a directory, whose services are processes of this test."""

    def __init__(self, root: Path, processes: ExitStack) -> None:
        self.root = root
        self.programs: list[str] = []
        self.listen = ""
        self._processes = processes

    def machine(self, *, has_systemd: bool = True) -> Machine:
        if has_systemd:
            (self.root / "run/systemd/system").mkdir(parents=True, exist_ok=True)
        return Machine(self.root, self)

    def __call__(self, words: Sequence[str]) -> bool:
        self.programs.append(" ".join(words))
        if words[:2] == ["systemctl", "restart"]:
            self._start(words[2])
        return True

    def _start(self, unit: str) -> None:
        file, keys = str(self.root / TOML[1:]), self.root / "etc/cruiser"
        listen = ["--listen", self.listen] if self.listen else []
        words, environment = {
            "cruiser-gateway.service": (["gateway", "--config", file, "--wait-for-bus", *listen], {}),
            "cruiser-recorder.service": (
                ["record", "--config", file],
                _zenoh_of(keys / "recorder/recorder.json5"),
            ),
            "cruiser-router.service": (["router"], _zenoh_of(keys / "router/router.json5")),
        }[unit]
        with patch.dict(os.environ, environment):
            running = self._processes.enter_context(Running(*words))
        running.wait_says(f"^{words[0]}: ")


def _zenoh_of(file: Path) -> dict[str, str]:
    if not file.exists():
        return {}
    return {"CRUISER_ZENOH_CONFIG": str(file), "CRUISER_AUTHORITY_DIRECTORY": str(file.parent)}


@pytest.fixture
def processes() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


@pytest.fixture
def bus(processes: ExitStack) -> str:
    return processes.enter_context(chassis())[1]


@pytest.fixture
def systemd(processes: ExitStack, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> FakeSystemd:
    root = tmp_path / "root"
    (root / "var/lib/cruiser/logs").mkdir(parents=True)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("CRUISER_GATEWAY_STATE_DIR", str(root / "var/lib/cruiser/gateway"))
    monkeypatch.setenv("CRUISER_RECORDER_DIRECTORY", str(root / "var/lib/cruiser/logs"))
    return FakeSystemd(root, processes)


def set_up(machine: Machine, *words: str) -> ExitCode:
    return setup.set_up(parsed(setup, *words), machine, lambda: False)


def of(bus: str) -> list[str]:
    return ["--defaults", "--interface", "socketcand", "--channel", bus]


def is_well(code: ExitCode, text: str) -> bool:
    """Return True if doctor finds nothing but what the test machine lacks."""
    findings = [line for line in text.splitlines() if " -> " in line and not line.startswith(ELSEWHERE)]
    return not findings and (code is ExitCode.OK) == (WELL in text)


def test_a_bare_machine_becomes_a_robot_that_is_recorded(
    bus: str, systemd: FakeSystemd, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    systemd.listen = free_endpoint()
    monkeypatch.setenv("CRUISER_ZENOH_CONNECT", systemd.listen)
    code = set_up(systemd.machine(), *of(bus), "--robot", "depot-3")
    said = capsys.readouterr().out
    assert is_well(code, said), said
    settings = load_settings(str(systemd.root / TOML[1:]), {}, {})
    assert (settings.robot.name, settings.can.channel) == ("depot-3", bus)
    assert "systemctl restart cruiser-gateway.service" in systemd.programs
    # What runs already is no gateway of systemd's here.
    with pytest.raises(CommandError, match="more than one gateway commands the bus") as caught:
        set_up(systemd.machine(), *of(bus))
    assert caught.value.code is ExitCode.REFUSED
    assert capsys.readouterr().out == ""


def test_a_robot_with_bundles_is_set_up_in_signed_mode(
    bus: str,
    systemd: FakeSystemd,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    _, _, port = split_endpoint(free_endpoint())
    fleet = ProvisionedFleet(tmp_path / "fleet", f"tls/127.0.0.1:{port}")
    keys = systemd.root / "etc/cruiser"
    for role, name, service in (
        ("router", "127.0.0.1", "router"),
        ("robot", "depot-3", "gateway"),
        ("recorder", "depot-3-log", "recorder"),
    ):
        request = tmp_path / f"{role}-{name}.request"
        provisioning.run(role, name, "--directory", keys / service, "-o", request)
        fleet.sign(request)
    named = [word for file in sorted(tmp_path.glob("*.bundle")) for word in ("--bundle", str(file))]
    with pytest.raises(CommandError, match="confirm it with --fingerprint, if .*" + fleet.fingerprint):
        set_up(systemd.machine(), *of(bus), *named)
    with pytest.raises(CommandError, match="not from the one given"):
        set_up(systemd.machine(), *of(bus), *named, "--fingerprint", "0000")
    compared = (*named, "--fingerprint", fleet.fingerprint)
    assert not (systemd.root / TOML[1:]).exists()
    monkeypatch.setenv("CRUISER_ZENOH_CONFIG", str(keys / "gateway/robot.json5"))
    monkeypatch.setenv("CRUISER_AUTHORITY_DIRECTORY", str(keys / "gateway"))
    code = set_up(systemd.machine(), *of(bus), *compared)
    said = capsys.readouterr().out
    assert is_well(code, said), said
    if code is ExitCode.OK:
        assert "authority valid until 20" in said
    text = (systemd.root / TOML[1:]).read_text()
    assert 'mode = "signed"' in text
    assert 'name = "depot-3"' in text
    assert [one for one in systemd.programs if "restart" in one] == [
        f"systemctl restart cruiser-{name}.service" for name in ("router", "gateway", "recorder")
    ]


def test_who_is_asked_has_to_have_compared_the_authority(
    systemd: FakeSystemd, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fleet = ProvisionedFleet(tmp_path / "fleet")
    bundle = fleet.sign(fleet.request("robot", "depot-3"))
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    for answer in ("", "y", fleet.fingerprint):

        def said(question: str, answer: str = answer) -> str:
            assert fleet.fingerprint in question
            return answer

        monkeypatch.setattr("builtins.input", said)
        with pytest.raises(CommandError, match="not installed: the bundle"):
            set_up(systemd.machine(), "--bundle", str(bundle))
    assert not (systemd.root / TOML[1:]).exists()


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can be somebody else")
def test_a_bundle_is_a_file_of_roots_or_of_who_asks(
    systemd: FakeSystemd, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "stranger.bundle").write_text("no bundle")
    fleet = ProvisionedFleet(tmp_path / "fleet")
    bundle = fleet.sign(fleet.request("robot", "depot-3"))
    os.chown(bundle, 65534, 65534)
    words = ("--defaults", "--bundle", str(bundle))
    with pytest.raises(CommandError, match="belongs to another user"):
        set_up(systemd.machine(), *words)
    monkeypatch.setenv("SUDO_UID", "65534")
    # It is read, and of an authority that is not known here.
    with pytest.raises(CommandError, match="confirm it with --fingerprint"):
        set_up(systemd.machine(), *words)


def test_without_systemd_the_settings_are_written(
    systemd: FakeSystemd, capsys: pytest.CaptureFixture[str]
) -> None:
    assert set_up(systemd.machine(has_systemd=False), "--defaults") is ExitCode.OK
    assert "no systemd on this machine" in capsys.readouterr().out
    assert (systemd.root / TOML[1:]).exists()
    assert systemd.programs == []


def test_another_gateway_on_the_bus_keeps_it_from_being_set_up(bus: str, systemd: FakeSystemd) -> None:
    with gateway(bus, free_endpoint()), pytest.raises(CommandError, match="more than one gateway"):
        set_up(systemd.machine(), *of(bus))


@pytest.mark.parametrize(("name", "says"), [("nothing", "is not there"), (__file__, "test_setup.py: ")])
def test_a_file_that_is_no_bundle_is_refused(bus: str, systemd: FakeSystemd, name: str, says: str) -> None:
    with pytest.raises(CommandError, match=says):
        set_up(systemd.machine(), *of(bus), "--bundle", name)
    assert not (systemd.root / "etc/cruiser/cruiser.toml").exists()


def test_without_a_terminal_it_wants_defaults(systemd: FakeSystemd) -> None:
    with pytest.raises(CommandError, match="use --defaults"):
        set_up(systemd.machine())


def bring_up(systemd: FakeSystemd) -> None:
    """Give the kernel a CAN interface that is up."""
    link = systemd.root / "sys/class/net/can0"
    link.mkdir(parents=True)
    for name, text in (("type", "280"), ("tx_queue_len", "10"), ("flags", "0x40081")):
        (link / name).write_text(text)


replace = msgspec.structs.replace

FEEDBACK = [replace(HEALTH.feedback[0], name=name) for name in ChassisSettings().required_feedback]
WELL_HEALTH = replace(HEALTH, feedback=FEEDBACK)
CHASSIS = BusReport("", WELL_HEALTH, replace(STATE, speed_mps=0.0))


@pytest.mark.parametrize(
    ("report", "says"),
    [
        (replace(CHASSIS, is_commanded=True), "another computer commands the chassis"),
        (replace(CHASSIS, state=replace(STATE, speed_mps=-0.4)), "moves at -0.40 m/s"),
    ],
)
def test_nothing_is_changed_while_somebody_drives(
    systemd: FakeSystemd, monkeypatch: pytest.MonkeyPatch, report: BusReport, says: str
) -> None:
    bring_up(systemd)
    monkeypatch.setattr(setup, "listen", lambda *_: report)
    with pytest.raises(CommandError, match=says) as caught:
        set_up(systemd.machine(), "--defaults", "--bitrate", "250000")
    assert caught.value.code is ExitCode.REFUSED
    assert systemd.programs == []
    assert not (systemd.root / "etc").exists()


def test_a_person_is_asked_what_no_flag_says(systemd: FakeSystemd, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []
    answers = iter(["Depot 3", "depot-3", "", "fast", "250000", ""])

    def answer(prompt: str) -> str:
        asked.append(prompt)
        return next(answers)

    monkeypatch.setattr("builtins.input", answer)
    monkeypatch.setattr("sys.stdin", SimpleNamespace(isatty=lambda: True))
    bring_up(systemd)
    monkeypatch.setattr(setup, "listen", lambda *_: CHASSIS)
    set_up(systemd.machine(has_systemd=False))
    assert asked == [
        "the robot's name [cruiser-1]: ",
        "the robot's name [cruiser-1]: ",
        "the CAN interface [can0]: ",
        "its bit rate [500000]: ",
        "its bit rate [500000]: ",
        "routers, separated by commas (empty: only this machine) []: ",
    ]
    found = load_settings(str(systemd.root / TOML[1:]), {}, {})
    assert (found.robot.name, found.can.bitrate) == ("depot-3", 250_000)
