"""``cruiser setup``: ask, write the settings, enable the services, and end with doctor's findings."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from pwd import getpwnam
from typing import Final

import msgspec

from gateway.authority.enrolment import Bundle, EnrolmentError, TransportRole, read_bundle
from gateway.can.open_bus import count_claims
from gateway.cli import doctor
from gateway.cli.configuration_file import load_settings
from gateway.doctor.checks import USUAL_BITRATE, diagnose
from gateway.doctor.facts import CanInterface, Facts
from gateway.host.looks import (
    can_interfaces,
    listen,
    look_at_disk,
    look_at_interface,
    look_at_units,
    owning,
    run_program,
)
from gateway.provisioning.issuer import install, unknown_of
from gateway.provisioning.key_files import KeyStore, replace_whole
from schemas.arguments import robot_name, whole_number
from schemas.authority.key_files import find
from schemas.command_line import CommandError, ExitCode, UsageError, plain
from schemas.configuration import write_key, write_value
from schemas.settings import STANDSTILL_MPS, CanSettings, Settings

CONFIGURATION: Final = "/etc/cruiser/cruiser.toml"
KEYS: Final = "/etc/cruiser"
STATE: Final = "/var/lib/cruiser/gateway"
LOGS: Final = "/var/lib/cruiser/logs"
NETWORK: Final = "/etc/systemd/network"
UNITS: Final = "/etc/systemd/system"

BUDGET_BYTES: Final = 20_000_000_000  # for logs; less on a disk of which BUDGET_SHARE is less

BUDGET_SHARE: Final = 0.7

QUEUE_FRAMES: Final = 10
RESTART_MS: Final = 100

SERVICES: Final = {"gateway": "robot", "recorder": "recorder", "router": "router"}
"""Services with the role of their certificates; their keys are in a directory of the service's name."""


class Answers(msgspec.Struct, frozen=True):
    """Answers of the person or the flags, and findings.

    Attributes:
        root: first chunks of every key; empty leaves the settings' own.
        interface, channel, bitrate: the bus; 0 bit/s: it has no bit rate, such as vcan.
        routers: Zenoh endpoints; none keeps the robot to its own machine, or to what its Zenoh file says.
        has_network_file: systemd-networkd has a file for the interface already: a drop-in says the bit rate.
        free_bytes: of the disk of the logs, with what the logs take.
    """

    name: str
    root: str
    interface: str
    channel: str
    bitrate: int
    routers: list[str] = []
    keys: frozenset[str] = frozenset()
    has_network_file: bool = False
    free_bytes: int = 0

    @property
    def is_signed(self) -> bool:
        return "gateway" in self.keys

    @property
    def is_kernels(self) -> bool:
        return self.interface == "socketcan"

    @property
    def services(self) -> list[str]:
        """Return the services to run here. In signed mode those without a certificate reach nothing."""
        wanted = ["gateway", "recorder"] if not self.is_signed else ["gateway"]
        return [name for name in ("router", "gateway", "recorder") if name in {*wanted, *self.keys}]


def configuration(answers: Answers, before: Mapping[str, Mapping[str, object]]) -> str:
    """Return the settings as TOML: the former ones, changed by the answers."""
    tables = {name: dict(table) for name, table in before.items()}

    def put(table: str, **values: object) -> None:
        tables.setdefault(table, {}).update(values)

    put("robot", name=answers.name, **({"root": answers.root} if answers.root else {}))
    put("can", interface=answers.interface, channel=answers.channel)
    if answers.bitrate:
        put("can", bitrate=answers.bitrate)
    put("gateway", state_dir=STATE)
    put("recorder", directory=LOGS)
    if "budget_bytes" not in tables["recorder"]:
        put("recorder", budget_bytes=min(BUDGET_BYTES, int(answers.free_bytes * BUDGET_SHARE)) or BUDGET_BYTES)
    zenoh = tables.setdefault("zenoh", {})
    if answers.is_signed:
        put("authority", mode="signed", directory=f"{KEYS}/gateway")
        zenoh["config"] = _zenoh_file("gateway")
        zenoh.pop("connect", None)
    elif answers.routers:
        zenoh["connect"] = answers.routers
    lines = ["# Written by 'cruiser setup'. All settings, with their start values: docs/configuration.md"]
    for name, table in tables.items():
        if table:
            lines += [
                "",
                f"[{name}]",
                *(f"{write_key(key)} = {write_value(value)}" for key, value in table.items()),
            ]
    return "\n".join(lines) + "\n"


def system_files(answers: Answers) -> dict[str, str]:
    """Return files besides the settings, by path: the bus, and the recorder's Zenoh file."""
    files: dict[str, str] = {}
    if answers.is_signed and "recorder" in answers.keys:
        files[f"{UNITS}/cruiser-recorder.service.d/zenoh.conf"] = (
            "# The settings file names the gateway's.\n"
            f"[Service]\nEnvironment=CRUISER_ZENOH_CONFIG={_zenoh_file('recorder')}\n"
        )
    if not answers.is_kernels or not answers.bitrate:
        return files
    name, channel = f"80-cruiser-{answers.channel}", answers.channel
    can = f"[CAN]\nBitRate={answers.bitrate}\n"
    if answers.has_network_file:
        return files | {f"{NETWORK}/{name}.network.d/bitrate.conf": can}
    return files | {
        f"{NETWORK}/{name}.link": (
            f"[Match]\nOriginalName={channel}\n\n"
            f"[Link]\nNamePolicy=keep kernel\nTransmitQueueLength={QUEUE_FRAMES}\n"
        ),
        f"{NETWORK}/{name}.network": (
            f"[Match]\nName={channel}\n\n[Link]\nRequiredForOnline=no\n\n{can}RestartSec={RESTART_MS}ms\n"
        ),
    }


def _zenoh_file(service: str) -> str:
    return f"{KEYS}/{service}/{SERVICES[service]}.json5"


def start_services(answers: Answers) -> list[list[str]]:
    """Return the programs that reload systemd and start the services, in order."""
    programs = [["systemctl", "daemon-reload"]]
    if answers.is_kernels and answers.bitrate:
        programs += [["systemctl", "enable", "--now", "systemd-networkd.service"], ["networkctl", "reload"]]
        programs += [["networkctl", "reconfigure", answers.channel]]
    for name in answers.services:
        unit = f"cruiser-{name}.service"
        programs += [["systemctl", "reenable", unit], ["systemctl", "restart", unit]]
    return programs


EXAMPLE: Final = """\
  sudo cruiser setup                                        asks, with what was found as default
  sudo cruiser setup --defaults --bundle robot-cruiser-1.bundle --fingerprint F"""

BITRATE: Final = whole_number(1, 1_000_000)

READY_S: Final = 60.0  # time for the services to start well

SERVICE_OF: Final = {TransportRole(role): service for service, role in SERVICES.items()}

# findings with which setup changes nothing: another process drives the robot
NOBODY_DRIVES: Final = frozenset({"other_commander", "two_gateways"})


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Asks what it needs, writes the settings, installs the authority's bundles and starts the services,\n"
        "unless the robot is being driven. Prints each step, and ends with 'cruiser doctor'. Sends no command."
    )
    parser.add_argument(
        "--defaults", action="store_true", help="no questions: use what was found for all that is not given"
    )
    parser.add_argument("--robot", type=robot_name, metavar="NAME", help="the robot's name")
    parser.add_argument("--interface", metavar="NAME", help="python-can interface (default socketcan)")
    parser.add_argument("--channel", metavar="CHANNEL", help="channel of the interface (default can0)")
    parser.add_argument("--bitrate", type=BITRATE, metavar="BIT/S", help=f"bit rate (default {USUAL_BITRATE})")
    parser.add_argument(
        "--router", action="append", metavar="ENDPOINT", help="router without certificates; may be repeated"
    )
    parser.add_argument(
        "--bundle",
        action="append",
        metavar="FILE",
        help="bundle from 'cruiser provision sign' for the robot, its recorder or its router; may be repeated",
    )
    parser.add_argument(
        "--fingerprint", metavar="F", help="fingerprint of the bundles' authority; asked for if left out"
    )
    parser.add_argument("--replace", action="store_true", help="overwrite installed certificates")


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    """Set the robot up. Returns the exit code of doctor at the end."""
    del settings  # The settings of the file to write count, not those of this call.
    if arguments.config is not None:
        raise UsageError(f"setup writes {CONFIGURATION}; --config is not supported")
    if os.geteuid() != 0:
        raise UsageError("setup writes system files: run it as root")
    return int(set_up(arguments, Machine(), stopped))


def run_in_sight(words: Sequence[str]) -> bool:
    """Run a system program, whose own errors the user sees. Returns True if it succeeded."""
    try:
        return subprocess.run(list(words), check=False).returncode == 0  # noqa: S603 - programs named in this tree
    except OSError:
        return False


class Machine:
    """Writes files and runs programs, and prints each step. Tests replace both."""

    def __init__(self, root: Path = Path("/"), program: Callable[[Sequence[str]], bool] = run_in_sight) -> None:
        self._root = root
        self._program = program

    def path(self, name: str) -> Path:
        return self._root / name.lstrip("/")

    def write(self, name: str, text: str) -> None:
        """Write a file that all may read, atomically. A changed file is saved beside it first."""
        path = self.path(name)
        try:
            if not path.exists():
                say(f"writing {name}")
                path.parent.mkdir(mode=0o755, parents=True, exist_ok=True)
            elif path.read_bytes() == text.encode():
                say(f"{name}: unchanged")
                return
            else:
                saved = path.with_name(f"{path.name}.before-{datetime.now(UTC):%Y%m%dT%H%M%SZ}")
                say(f"writing {name}, old file saved as {saved.name}")
                saved.hardlink_to(path)
            replace_whole(path, text, 0o644)
        except OSError as error:
            raise CommandError(f"{name} cannot be written: {(error.strerror or str(error)).lower()}") from error

    def run(self, programs: Iterable[Sequence[str]]) -> None:
        """Run programs. Failures are printed; doctor finds their effect."""
        for words in programs:
            say(f"running: {' '.join(words)}")
            if not self._program(words):
                say(f"'{' '.join(words)}' failed")


def set_up(arguments: argparse.Namespace, machine: Machine, stopped: Callable[[], bool]) -> ExitCode:
    bundles = _bundles(arguments.bundle or ())
    _compare(arguments, machine, bundles)
    file = machine.path(CONFIGURATION)
    before = load_settings(str(file) if file.exists() else None, {}, {})
    answers = _answers(arguments, machine, before, bundles.values())
    _refuse_where_driven(machine, answers, before, stopped)
    for bundle_file, bundle in bundles.items():
        _install(machine, bundle_file, bundle, replace=arguments.replace)
    tables = tomllib.loads(file.read_text("utf-8-sig")) if file.exists() else {}
    machine.write(CONFIGURATION, configuration(answers, tables))
    if not machine.path("/run/systemd/system").is_dir():
        say("no systemd on this machine: start 'cruiser gateway' and 'cruiser record' yourself")
        return ExitCode.OK
    for name, text in system_files(answers).items():
        machine.write(name, text)
    machine.run(start_services(answers))
    say("waiting for the gateway")
    settings, end_s = load_settings(str(file), os.environ, {}), time.monotonic() + READY_S
    while True:
        facts = doctor.look(settings, 3.0, stopped)
        found = diagnose(facts)
        if all(one.is_note for one in found) or stopped() or time.monotonic() > end_s:
            return doctor.report(facts, found, as_json=False)


def _answers(
    arguments: argparse.Namespace, machine: Machine, before: Settings, bundles: Iterable[Bundle]
) -> Answers:
    def ask(question: str, default: str, given: str | None, check: Callable[[str], object] = str) -> str:
        if given is None and not arguments.defaults:
            return _ask(f"{question} [{default}]: ", default, check)
        return default if given is None else given

    robot = next((one for one in bundles if one.role is TransportRole.ROBOT), None)
    name = robot.name if robot else ask("the robot's name", before.robot.name, arguments.robot, robot_name)
    if arguments.robot not in {None, name}:
        raise UsageError(f"the bundle is for {plain(name)}, not {arguments.robot}")
    interface = arguments.interface or before.can.interface
    channel, bitrate = before.can.channel, 0
    found = can_interfaces(machine.path("/sys/class/net"))
    if interface == "socketcan" and channel not in found and len(found) == 1:
        (channel,) = found
    channel = ask("the CAN interface", channel, arguments.channel)
    link = _interface(machine, interface, channel)
    if interface != "socketcand" and not (link and link.is_virtual):
        usual = (link and link.bitrate) or before.can.bitrate or USUAL_BITRATE
        bitrate = int(ask("its bit rate", str(usual), arguments.bitrate and str(arguments.bitrate), BITRATE))
    keys = {SERVICE_OF[one.role] for one in bundles}
    keys |= {one for one, role in SERVICES.items() if machine.path(f"{KEYS}/{one}/{role}.json5").exists()}
    routers = before.zenoh.connect
    if "gateway" not in keys:
        given = ",".join(arguments.router) if arguments.router else None
        router = ask("routers, separated by commas (empty: only this machine)", ",".join(routers), given)
        routers = [one for one in router.split(",") if one]
    logs = machine.path(LOGS)
    disk = look_at_disk(next((one for one in (logs, *logs.parents) if one.is_dir()), logs))
    return Answers(
        name,
        robot.fleet.root if robot else "",
        interface,
        channel,
        bitrate,
        routers,
        frozenset(keys),
        machine.path(f"{NETWORK}/80-cruiser-{channel}.network").exists(),
        disk.free_bytes + disk.used_bytes,
    )


def _ask(prompt: str, default: str, check: Callable[[str], object]) -> str:
    if not sys.stdin.isatty():
        raise UsageError("no terminal for questions: use --defaults")
    while True:
        try:
            answer = input(prompt).strip() or default
            check(answer)
        except EOFError as error:
            raise UsageError(f"no answer: {prompt}") from error
        except argparse.ArgumentTypeError as error:
            say(str(error))
        else:
            return answer


def _interface(machine: Machine, interface: str, channel: str) -> CanInterface | None:
    settings = Settings(can=CanSettings(interface=interface, channel=channel))
    return look_at_interface(settings, run_program, machine.path("/sys/class/net"))


def _refuse_where_driven(
    machine: Machine, answers: Answers, before: Settings, stopped: Callable[[], bool]
) -> None:
    """Listen to the bus before any change: refuse while the robot is being driven or moves."""
    can = msgspec.structs.replace(
        before.can, interface=answers.interface, channel=answers.channel, bitrate=answers.bitrate
    )
    settings = msgspec.structs.replace(before, can=can)
    link = _interface(machine, answers.interface, answers.channel)
    is_open = link is None or (link.is_present and link.is_up)
    is_running = any(unit.name == "cruiser-gateway.service" and unit.state == "active" for unit in look_at_units())
    facts = Facts(
        settings,
        "",
        time.time(),
        # The service's gateway will be restarted; any other one is in the way.
        claims=count_claims(can) + (0 if is_running else 1),
        bus=listen(settings, stopped) if is_open else None,
    )
    if found := next((one for one in diagnose(facts) if one.check in NOBODY_DRIVES), None):
        raise CommandError(f"{found.text} -> {found.cure}", ExitCode.REFUSED)
    speed_mps = facts.state.speed_mps if facts.state else None
    if speed_mps is not None and abs(speed_mps) > STANDSTILL_MPS:
        raise CommandError(f"the robot moves at {speed_mps:+.2f} m/s: nothing was changed", ExitCode.REFUSED)


# Keys and certificates.


def _bundles(files: Iterable[str]) -> dict[Path, Bundle]:
    bundles = {}
    for file in map(Path, files):
        name = plain(str(file))
        found = find(file)
        if not found.is_own and str(file.stat().st_uid) != os.environ.get("SUDO_UID"):
            raise UsageError(f"{name} belongs to another user; chown it to yours")
        try:
            bundle = read_bundle(found.content, int(time.time()))
        except EnrolmentError as error:
            raise UsageError(f"{name}: {error}") from error
        if bundle.role not in SERVICE_OF:
            raise CommandError(f"{name} is for a {bundle.role.value}: no service here uses it")
        bundles[file] = bundle
    return bundles


def _compare(arguments: argparse.Namespace, machine: Machine, bundles: dict[Path, Bundle]) -> None:
    """Have the user confirm an authority that is not known here."""
    fresh = []
    for file, bundle in bundles.items():
        if arguments.fingerprint not in {None, bundle.fingerprint}:
            raise UsageError(
                f"{plain(str(file))} is from the authority {bundle.fingerprint}, not from the one given"
            )
        store = KeyStore(machine.path(f"{KEYS}/{SERVICE_OF[bundle.role]}"))
        if arguments.fingerprint is None and unknown_of(store, bundle):
            fresh.append(bundle.fingerprint)
    for fingerprint in dict.fromkeys(fresh):
        showed = f"'cruiser provision authority' or 'sign' showed {fingerprint}"
        if arguments.defaults:
            raise UsageError(f"unknown authority: confirm it with --fingerprint, if {showed}")
        if _ask(f"unknown authority. Is it true that {showed}? yes or no [no]: ", "no", str) != "yes":
            raise UsageError("not installed: the bundle is from another authority")


def _install(machine: Machine, file: Path, bundle: Bundle, *, replace: bool) -> None:
    """Install a bundle in its service's directory, as that service's user."""
    service, name = SERVICE_OF[bundle.role], plain(str(file))
    directory = machine.path(f"{KEYS}/{service}")
    try:
        if not directory.exists():
            directory.mkdir(mode=0o700, parents=True)
            with suppress(KeyError):
                user = getpwnam(f"cruiser-{service}")
                os.chown(directory, user.pw_uid, user.pw_gid)
    except OSError as error:
        raise CommandError(f"{directory} cannot be made: {error.strerror}") from error
    with owning(directory):
        store, certificate = KeyStore(directory), f"{bundle.role.value}-tls.pem"
        if store.has(certificate) and store.read(certificate, "").decode(errors="replace") == bundle.certificate:
            say(f"{name}: already installed")
            return
        say(f"installing {name} in {directory}")
        try:
            files, _ = install(store, bundle, replace=replace, is_compared=True)
        except ValueError as error:
            raise UsageError(f"{name}: {error}") from error
    say(f"    {', '.join(files)}, from authority {bundle.fingerprint}")


def say(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()
