"""``cruiser setup``: makes a robot of a computer that has the package, and ends with what doctor says."""

from __future__ import annotations

import argparse
import os
import sys
import time
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Final

import msgspec

from gateway.authority.enrolment import Bundle, EnrolmentError, EnrolmentRole, read_bundle
from gateway.can.bus_claim import count_claims
from gateway.cli import doctor
from gateway.cli.configuration_file import load_settings
from gateway.doctor import installation
from gateway.doctor.checks import USUAL_BITRATE, Diagnosis, diagnose
from gateway.doctor.facts import CanInterface, Facts
from gateway.doctor.installation import Answers
from gateway.host.bus_look import can_interfaces, listen, look_at_interface
from gateway.host.computer_look import earliest_s, look_at_disk, look_at_units, run_program
from gateway.host.machine import Machine
from gateway.provisioning.certificates import CertificateError, expires_s, read_certificates
from gateway.provisioning.key_store import KeyStore, find
from gateway.provisioning.machine_keys import install, unknown_of
from schemas.arguments import robot_name
from schemas.exit_codes import CommandError, ExitCode
from schemas.printable import plain
from schemas.settings import STANDSTILL_MPS, Settings

EXAMPLE: Final = """\
  sudo cruiser setup                                        asks; each default is what was found
  sudo cruiser setup --defaults --bundle robot-cruiser-1.bundle --fingerprint F
  cruiser setup --defaults --dry-run                        only says what it would do"""

READY_S: Final = 60.0
"""So long the services have to be well, after which what is wrong is said."""

SERVICE_OF: Final = {EnrolmentRole(role): service for service, role in installation.SERVICES.items()}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags."""
    parser.description = (
        "Asks what it must, listens to the CAN bus, and only then writes settings, installs bundles of the "
        "authority, and starts the services. It prints each step, and ends with what 'cruiser doctor' says. It "
        "sends no command."
    )
    parser.add_argument("--defaults", action="store_true", help="ask nothing: what is not given is what was found")
    parser.add_argument("--dry-run", action="store_true", help="do nothing, only say what would be done")
    parser.add_argument("--without-bus", action="store_true", help="do not listen to the bus: for a bench")
    parser.add_argument("--name", type=robot_name, metavar="NAME", help="the robot's name")
    parser.add_argument("--interface", metavar="NAME", help="python-can interface (socketcan)")
    parser.add_argument("--channel", metavar="CHANNEL", help="the interface's channel (can0)")
    parser.add_argument("--bitrate", type=_bitrate, metavar="BIT/S", help=f"of the bus ({USUAL_BITRATE})")
    parser.add_argument(
        "--router", action="append", metavar="ENDPOINT", help="a router without certificates; may be repeated"
    )
    parser.add_argument(
        "--bundle",
        action="append",
        metavar="FILE",
        help="what 'cruiser provision sign' made for the robot, its recorder, its router, a desk or a viewer; may "
        "be repeated",
    )
    parser.add_argument("--fingerprint", metavar="F", help="of the authority of the bundles; else it is asked for")
    parser.add_argument("--replace", action="store_true", help="write over certificates that are installed")
    parser.add_argument(
        "--output",
        default=installation.CONFIGURATION,
        metavar="FILE",
        help=f"where the settings go ({installation.CONFIGURATION}, which the services read)",
    )


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    """Set the robot up. The exit code is that of the examination at the end.

    Raises:
        CommandError: something is wrong: nothing was written yet, or the text says what could not be.
    """
    del settings  # Those of the file that is to be written count, not those of who asks.
    if arguments.config is not None:
        raise CommandError("--config names no file to write: --output does", ExitCode.USAGE)
    return int(set_up(arguments, Machine(_say, is_dry=arguments.dry_run), stopped))


def set_up(arguments: argparse.Namespace, machine: Machine, stopped: Callable[[], bool]) -> ExitCode:
    """Set a machine up; see ``run``."""
    machine.check_root()
    bundles = _bundles(arguments)
    _compare(arguments, machine, bundles)
    file = machine.path(arguments.output)
    before = load_settings(str(file) if file.exists() else None, {}, {})
    answers = _answers(arguments, machine, before, bundles)
    wanted = _settings(answers, before)
    _examine(arguments, machine, answers, wanted, stopped)
    for bundle_file, bundle in bundles.items():
        _install(arguments, machine, bundle_file, bundle)
    tables = tomllib.loads(file.read_text("utf-8-sig")) if file.exists() else {}
    machine.write(arguments.output, installation.configuration(answers, tables))
    if not machine.has_systemd:
        _say("there is no systemd here; what it would do is left to you:")
        for line in installation.by_hand(answers):
            _say(f"    {line}")
        return ExitCode.OK
    for name, text in installation.system_files(answers).items():
        machine.write(name, text)
    for program in installation.start_services(answers):
        try:
            machine.run([program])
        except CommandError as error:
            # What keeps a service from starting is what is found below.
            _say(str(error))
    if machine.is_dry:
        return ExitCode.OK
    settings = load_settings(str(file), os.environ, {})
    facts, found = _wait_until_well(settings, stopped)
    return doctor.report(facts, found, as_json=False)


def _answers(
    arguments: argparse.Namespace, machine: Machine, before: Settings, bundles: dict[Path, Bundle]
) -> Answers:
    """The answers: from flags, from the person, or found."""
    ask = _Asking(is_silent=arguments.defaults)
    robot = next((one for one in bundles.values() if one.role is EnrolmentRole.ROBOT), None)
    name = (
        robot.name if robot is not None else ask("the robot's name", before.robot.name, arguments.name, robot_name)
    )
    if arguments.name not in {None, name}:
        raise CommandError(f"the bundle is for {plain(name)}, not for {arguments.name}", ExitCode.USAGE)
    interface = arguments.interface or before.can.interface
    channel, bitrate = before.can.channel, 0
    found = can_interfaces(machine.path("/sys/class/net"))
    if interface == "socketcan" and channel not in found and len(found) == 1:
        (channel,) = found
    channel = ask("the CAN interface", channel, arguments.channel)
    link = _interface(machine, interface, channel)
    if interface != "socketcand" and not link.is_virtual:
        usual = link.bitrate or before.can.bitrate or USUAL_BITRATE
        bitrate = int(ask("its bit rate", str(usual), arguments.bitrate, _bitrate))
    keys = {SERVICE_OF[one.role] for one in bundles.values()} | _installed(machine)
    routers = before.zenoh.connect
    if "gateway" not in keys:
        given = ",".join(arguments.router) if arguments.router else None
        router = ask("routers, with commas (empty: none, this machine alone)", ",".join(routers), given)
        routers = [one for one in router.split(",") if one]
    disk = look_at_disk(_existing(machine.path(installation.LOGS)))
    return Answers(
        name,
        robot.fleet.root if robot is not None else "",
        interface,
        channel,
        bitrate,
        routers,
        frozenset(keys),
        machine.path(f"{installation.NETWORK}/80-cruiser-{channel}.network").exists(),
        disk.free_bytes + disk.used_bytes,
    )


class _Asking:
    """Asks the person at the terminal; nobody, where all defaults are to do."""

    def __init__(self, *, is_silent: bool) -> None:
        self._is_silent = is_silent

    def __call__(
        self, question: str, default: str, given: str | None, check: Callable[[str], object] = str
    ) -> str:
        """The answer: the flag's, the person's, or the default.

        Raises:
            CommandError: there is nobody to ask.
        """
        if given is not None or self._is_silent:
            return default if given is None else given
        if not sys.stdin.isatty():
            raise CommandError("there is no terminal to ask: --defaults asks nothing", ExitCode.USAGE)
        while True:
            try:
                answer = input(f"{question} [{default}]: ").strip() or default
                check(answer)
            except EOFError as error:
                raise CommandError(f"no answer: {question}", ExitCode.USAGE) from error
            except argparse.ArgumentTypeError as error:
                _say(str(error))
            else:
                return answer


def _bitrate(text: str) -> str:
    if not text.isascii() or not text.isdigit() or not 0 < int(text) <= 1_000_000:
        raise argparse.ArgumentTypeError(f"{text!a} is no bit rate: 1 to 1000000 bit/s")
    return text


def _settings(answers: Answers, before: Settings) -> Settings:
    """The settings to listen by."""
    can = msgspec.structs.replace(
        before.can,
        interface=answers.interface,
        channel=answers.channel,
        bitrate=answers.bitrate,
    )
    robot = msgspec.structs.replace(before.robot, name=answers.name, root=answers.root or before.robot.root)
    state = msgspec.structs.replace(before.gateway, state_dir=installation.STATE)
    return msgspec.structs.replace(before, can=can, robot=robot, gateway=state)


# What is looked at before anything is written.


def _examine(
    arguments: argparse.Namespace,
    machine: Machine,
    answers: Answers,
    settings: Settings,
    stopped: Callable[[], bool],
) -> None:
    """Listen to the bus, and look at the disk.

    Raises:
        CommandError: the robot cannot be set up like this, or somebody commands it.
    """
    if arguments.without_bus:
        _refuse_for(_facts(machine, settings, None, stopped), "disk_unusable", "disk_read_only", "disk_full")
        return
    link = _interface(machine, answers.interface, answers.channel)
    undo: list[list[str]] = []
    if answers.is_kernels and link.is_present:
        differs = link.bitrate not in {None, answers.bitrate}
        if link.is_up and differs:
            # Nobody who drives a robot over this interface loses it.
            _refuse_for(_facts(machine, settings, link, stopped), "other_commander")
            was = msgspec.structs.replace(answers, bitrate=link.bitrate or answers.bitrate)
            undo = [*installation.bring_down(answers), *installation.bring_up(was)]
            machine.run(installation.bring_down(answers))
        if not link.is_up or differs:
            undo = undo or installation.bring_down(answers)
            machine.run(installation.bring_up(answers))
            if machine.is_dry:
                _say("would listen to the bus")
                return
    _say(f"listens to {answers.interface} {answers.channel}")
    try:
        facts = _facts(machine, settings, _interface(machine, answers.interface, answers.channel), stopped)
        _refuse_for(facts, *installation.REFUSALS)
    except CommandError:
        machine.run(undo)
        raise
    health = facts.health
    variant = "" if health is None else f", variant {health.variant.value}"
    _say(f"the chassis is there{variant}; nobody commands it")


def _facts(machine: Machine, settings: Settings, link: CanInterface | None, stopped: Callable[[], bool]) -> Facts:
    """Collect the facts that setup needs; without an interface the bus is not listened to."""
    is_running = any(unit.name == "cruiser-gateway.service" and unit.state == "active" for unit in look_at_units())
    # The service's own gateway is about to be started anew; any other is one too many.
    claims = count_claims(settings.can) + (0 if is_running else 1)
    return Facts(
        settings,
        "",
        time.time(),
        earliest_s(settings),
        interface=link,
        claims=claims,
        bus=None if link is None else listen(settings, stopped),
        disk=look_at_disk(_existing(machine.path(installation.LOGS))),
    )


def _refuse_for(facts: Facts, *names: str) -> None:
    """Go no further if any of these findings is there, or if the robot moves."""
    found = next((one for one in diagnose(facts) if one.check in names), None)
    if found is not None:
        raise CommandError(f"{found.text} -> {found.cure}", _CODES.get(found.check, ExitCode.FAILURE))
    speed_mps = None if facts.state is None else facts.state.speed_mps
    if speed_mps is not None and abs(speed_mps) > STANDSTILL_MPS:
        raise CommandError(f"the robot moves at {speed_mps:+.2f} m/s: nothing is changed", ExitCode.REFUSED)


_CODES: Final = {
    "other_commander": ExitCode.REFUSED,
    "two_gateways": ExitCode.REFUSED,
    "interface_missing": ExitCode.UNREACHABLE,
    "interface_down": ExitCode.UNREACHABLE,
    "bus_unreachable": ExitCode.UNREACHABLE,
}


def _interface(machine: Machine, interface: str, channel: str) -> CanInterface:
    """The interface; one that is well where it is none of the kernel's."""
    can = msgspec.structs.replace(Settings().can, interface=interface, channel=channel)
    settings = msgspec.structs.replace(Settings(), can=can)
    found = look_at_interface(settings, run_program, machine.path("/sys/class/net"))
    return found or CanInterface(is_present=True, is_up=True)


def _existing(directory: Path) -> Path:
    """The directory, or the nearest above it that is there."""
    return next((one for one in (directory, *directory.parents) if one.is_dir()), directory)


# Keys and certificates.


def _bundles(arguments: argparse.Namespace) -> dict[Path, Bundle]:
    """The bundles that were named, by their files.

    Raises:
        CommandError: one is none, is somebody else's file, or its certificate is over.
    """
    bundles = {}
    for file in map(Path, arguments.bundle or ()):
        try:
            bundle = read_bundle(_own_input(file), int(time.time()))
            ends_s = expires_s(read_certificates(bundle.certificate)[0])
        except (EnrolmentError, CertificateError) as error:
            raise CommandError(f"{plain(str(file))}: {error}", ExitCode.USAGE) from error
        if ends_s < time.time():
            days = (time.time() - ends_s) / 86_400
            raise CommandError(
                f"{plain(str(file))}: its certificate ended {days:.1f} days ago -> 'cruiser provision renew "
                f"{bundle.role.value}' asks for another",
                ExitCode.USAGE,
            )
        if bundle.role not in SERVICE_OF:
            raise CommandError(f"{plain(str(file))} is for a {bundle.role.value}, and for no service here")
        bundles[file] = bundle
    return bundles


def _own_input(file: Path) -> bytes:
    """The content of a file of root's, or of who asks, by sudo or not.

    Raises:
        CommandError: it cannot be read, or is somebody else's.
    """
    found = find(file)
    if not found.is_own and str(file.stat().st_uid) != os.environ.get("SUDO_UID"):
        raise CommandError(f"{plain(str(file))} belongs to another user; chown it to yours", ExitCode.USAGE)
    return found.content


def _compare(arguments: argparse.Namespace, machine: Machine, bundles: dict[Path, Bundle]) -> None:
    """Have the authority of bundles compared where it is not known here.

    Raises:
        CommandError: it is another than was given, or nobody has compared it.
    """
    fresh = []
    for file, bundle in bundles.items():
        if arguments.fingerprint not in {None, bundle.fingerprint}:
            raise CommandError(
                f"{plain(str(file))} is of the authority {bundle.fingerprint}, not of that one", ExitCode.USAGE
            )
        store = KeyStore(machine.path(f"{installation.KEYS}/{SERVICE_OF[bundle.role]}"))
        if arguments.fingerprint is None and not machine.is_dry and unknown_of(store, bundle):
            fresh.append(bundle.fingerprint)
    for fingerprint in dict.fromkeys(fresh):
        showed = f"'provision authority' or 'sign' showed {fingerprint} there"
        if arguments.defaults:
            raise CommandError(f"--fingerprint takes the authority over, if {showed}", ExitCode.USAGE)
        if _Asking(is_silent=False)(f"is it so that {showed}? yes or no", "no", None) != "yes":
            raise CommandError("nothing is installed: it is the bundle of another authority", ExitCode.USAGE)


def _installed(machine: Machine) -> set[str]:
    """Services whose certificates are installed."""
    return {
        service
        for service, role in installation.SERVICES.items()
        if machine.path(f"{installation.KEYS}/{service}/{role}.json5").exists()
    }


def _install(
    arguments: argparse.Namespace,
    machine: Machine,
    file: Path,
    bundle: Bundle,
) -> None:
    """Install a bundle where its service has its keys, as its user."""
    service = SERVICE_OF[bundle.role]
    with machine.keys_of(service) as directory:
        store = KeyStore(directory)
        if _is_installed(store, bundle):
            _say(f"{plain(str(file))}: is installed")
            return
        _say(f"{'would install' if machine.is_dry else 'installs'} {plain(str(file))} in {directory}")
        if machine.is_dry:
            return
        try:
            done = install(store, bundle, replace=arguments.replace, is_compared=True)
        except ValueError as error:
            raise CommandError(f"{plain(str(file))}: {error}", ExitCode.USAGE) from error
    _say(f"    {', '.join(done.files)}: of authority {bundle.fingerprint}")


def _is_installed(store: KeyStore, bundle: Bundle) -> bool:
    name = f"{bundle.role.value}-tls.pem"
    return store.has(name) and store.read(name, "").decode(errors="replace") == bundle.certificate


# The end.


def _wait_until_well(settings: Settings, stopped: Callable[[], bool]) -> tuple[Facts, list[Diagnosis]]:
    """Examine the robot until it is well, or will not become so."""
    _say("waits until the gateway is ready")
    end_s = time.monotonic() + READY_S
    while True:
        facts = doctor.look(settings, 3.0, stopped)
        found = diagnose(facts)
        must = {one.check for one in found if not one.is_note}
        if not must & installation.PENDING or stopped() or time.monotonic() > end_s:
            return facts, found


def _say(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()
