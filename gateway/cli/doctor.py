"""``cruiser doctor``: what is wrong with a robot's computer, with cures. Listens and asks; sends no command.

With ``--intrude`` it tries to command, under a name and a certificate without rights.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable, Collection, Iterable, Mapping
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import Final

import msgspec

from gateway.can.open_bus import count_claims, describe
from gateway.client.fleet import read_sample
from gateway.doctor.checks import Diagnosis, diagnose, summary
from gateway.doctor.facts import Facts, ZenohReport, reach
from gateway.host.looks import (
    booted_s,
    earliest_s,
    is_synchronised,
    listen,
    look_at_credentials,
    look_at_disk,
    look_at_interface,
    look_at_stop_note,
    look_at_units,
    run_program,
    was_shut_down,
)
from gateway.host.self_test import find_hole
from gateway.provisioning.key_files import role_of
from gateway.telemetry.samples import Received, TokenChange
from gateway.zenoh.client import FleetListener, PendingQuery
from schemas.arguments import add_bus_arguments, add_zenoh_arguments, seconds
from schemas.authority.key_files import KEY_FILE, directory_of
from schemas.command_line import CommandError, ExitCode, plain
from schemas.configuration import SETTINGS, TomlSource, merge
from schemas.decisions import SafetyState
from schemas.messages import GatewayHealth, GatewayInfo, Message, RobotState
from schemas.recording import RecorderHealth
from schemas.settings import Settings, ZenohSettings
from schemas.zenoh_session import place

EXAMPLE: Final = """\
  cruiser doctor
  cruiser doctor --config /etc/cruiser/cruiser.toml --json | jq -r '.findings[].cure'"""

HEARS_S: Final = 1.3  # health comes once a second
POLL_S: Final = 0.02

# Zenoh files of roles that see telemetry
SEEING: Final = ("viewer.json5", "recorder.json5", "operator.json5", "desk.json5")

INSTALLED: Final = (
    "gateway/robot.json5",
    "recorder/recorder.json5",
    "router/router.json5",
    "desk/desk.json5",
    "metrics/viewer.json5",
)
"""Zenoh files of the services, below /etc/cruiser."""

ROBOT_FILE: Final = "robot.json5"

# roles of machines that are not a robot's computer
OTHER_ROLES: Final = frozenset({"operator", "viewer", "desk", "recorder"})


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Listens to the bus, asks the gateway and the recorder, and checks this computer. Prints one line per\n"
        "finding, with its cure, then the stopping distance that the settings add up to. Sends no command.\n"
        "Exit code 1 if something must be done."
    )
    add_bus_arguments(parser)
    parser.add_argument("--logs", dest="recorder.directory", metavar="DIR", help="directory of the logs")
    parser.add_argument(
        "--timeout", type=seconds, default=3.0, metavar="S", help="time to wait for the gateway (default 3)"
    )
    parser.add_argument(
        "--intrude",
        action="store_true",
        help="signed mode: test that the router rejects a certificate without rights; takes some seconds",
    )
    parser.add_argument("--json", action="store_true", help="one JSON object: ok, summary, findings, reach")
    add_zenoh_arguments(parser)


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    """Print the findings. Exit code 1 if something must be done."""
    if getattr(arguments, "zenoh.config") is None and SETTINGS["zenoh.config"].variable not in os.environ:
        _check_role(settings)
    names_bus = (getattr(arguments, "can.interface"), getattr(arguments, "can.channel")) != (None, None)
    facts = look(settings, arguments.timeout, stopped, follows_gateway=not names_bus)
    facts = msgspec.structs.replace(facts, hole=_tried(settings) if arguments.intrude else None)
    return int(report(facts, diagnose(facts), as_json=arguments.json))


def _tried(settings: Settings) -> str:
    """Return what a client without rights can do to the robot, or why that was not tested; empty if nothing."""
    if settings.authority.mode != "signed":
        return 'open mode rejects no client; set authority.mode = "signed"'
    try:
        return find_hole(settings)
    except CommandError as error:
        return f"the router's access control cannot be tested: {error}"


def _check_role(settings: Settings) -> None:
    """Refuse the settings of a machine that is not a robot's computer: the findings would not be about it."""
    role = role_of(Path(settings.zenoh.config)) if settings.zenoh.config else ""
    if role in OTHER_ROLES and not (directory_of(settings.authority) / KEY_FILE.format(who="robot")).exists():
        raise CommandError(
            f"these are the settings of a machine of the role {role} ({plain(settings.zenoh.config)}), but doctor "
            "checks a robot's computer: run it there, 'cruiser doctor --config robot.toml'; from here use "
            "'cruiser list' and 'cruiser why ROBOT'",
            ExitCode.USAGE,
        )


def look(
    settings: Settings, timeout_s: float, stopped: Callable[[], bool], *, follows_gateway: bool = False
) -> Facts:
    """Collect all facts. ``follows_gateway``: of the running gateway's bus, if it is another one."""
    now_s = time.time()
    zenoh = ask(settings, timeout_s, stopped)
    bus_of_settings = ""
    if zenoh.settings is not None:
        settings = msgspec.structs.replace(settings, command=zenoh.settings.command)
        if follows_gateway and describe(zenoh.settings.can) != describe(settings.can):
            bus_of_settings = f"{describe(settings.can)}, by the settings here"
            settings = msgspec.structs.replace(settings, can=zenoh.settings.can)
    return Facts(
        settings,
        version("cruiser-gateway"),
        now_s,
        earliest_s(settings),
        is_synchronised(run_program),
        look_at_interface(settings, run_program),
        count_claims(settings.can),
        None if zenoh.health is not None else listen(settings, stopped),
        zenoh,
        look_at_disk(Path(settings.recorder.directory)),
        look_at_units(),
        look_at_credentials(settings, _zenoh_files(settings), now_s),
        booted_s(),
        was_shut_down(),
        look_at_stop_note(settings),
        bus_of_settings,
    )


def report(facts: Facts, found: list[Diagnosis], *, as_json: bool) -> ExitCode:
    """Print the findings, and return the exit code."""
    is_well = all(one.is_note for one in found)
    text = summary(facts) if is_well else ""
    if as_json:
        said = reach(facts)
        ways = [way._asdict() for way in said.ways]
        record = {"ok": is_well, "summary": text, "findings": found, "reach": said._asdict() | {"ways": ways}}
        sys.stdout.write(f"{msgspec.json.encode(record).decode()}\n")
    else:
        sys.stdout.writelines(f"{one.line}\n" for one in found)
        if not facts.settings.gateway.listen_only:
            sys.stdout.writelines(f"{line}\n" for line in reach(facts).lines)
        if is_well:
            sys.stdout.write(f"{text}\n")
    sys.stdout.flush()
    return ExitCode.OK if is_well else ExitCode.FAILURE


def ask(settings: Settings, timeout_s: float, stopped: Callable[[], bool]) -> ZenohReport:
    """Ask the gateway and the recorders, as far as the keys here allow."""
    zenoh = settings_to_ask(settings)
    settings = msgspec.structs.replace(settings, zenoh=zenoh)
    is_blind = Path(zenoh.config).name == ROBOT_FILE
    where = "the place of the Zenoh file"
    try:
        where = place(zenoh)
        with FleetListener.open(settings, settings.robot.name) as listener:
            return _ask(listener, where, timeout_s, stopped, is_blind=is_blind)
    except CommandError as error:
        return ZenohReport(where, str(error), is_blind)


def _ask(
    listener: FleetListener, where: str, timeout_s: float, stopped: Callable[[], bool], *, is_blind: bool
) -> ZenohReport:
    newest: dict[type[Message], Message] = {}
    recorders: dict[str, RecorderHealth] = {}
    is_named, ahead_s = False, 0.0
    question: PendingQuery | None = None
    runs: dict[int, GatewayInfo] = {}
    linked_s: float | None = None
    end_s = time.monotonic() + timeout_s
    while not stopped() and (now_s := time.monotonic()) < end_s:
        if linked_s is None and listener.links():
            linked_s, question = now_s, listener.ask_info(timeout_s)
        for arrival in listener.drain():
            is_named = arrival.present if isinstance(arrival, TokenChange) else is_named
            message = _message(arrival) if isinstance(arrival, Received) else None
            if isinstance(message, RecorderHealth):
                recorders[message.recorder] = message
            elif message is not None:
                newest[type(message)] = message
                if isinstance(message, GatewayHealth):
                    ahead_s = (message.time_ns - time.time_ns()) / 1e9
        runs |= _runs(question.poll() if question is not None else ())
        is_answered = GatewayHealth in newest or (is_blind and bool(runs))
        if linked_s is not None and is_answered and now_s - linked_s > HEARS_S:
            break
        time.sleep(POLL_S)
    why_not = "" if linked_s is not None else f"no Zenoh node answered within {timeout_s:g} s"
    health, safety, state = (newest.get(kind) for kind in (GatewayHealth, SafetyState, RobotState))
    return ZenohReport(
        where,
        why_not,
        is_blind,
        is_named,
        len(runs),
        health if isinstance(health, GatewayHealth) else None,
        safety if isinstance(safety, SafetyState) else None,
        state if isinstance(state, RobotState) else None,
        ahead_s,
        _clock_moved_s(health, runs) if isinstance(health, GatewayHealth) else 0.0,
        [recorders[name] for name in sorted(recorders)],
        _settings_of(runs),
    )


def _message(received: Received) -> Message | None:
    sample = read_sample(received)
    return sample.message if sample is not None and isinstance(sample.message, Message) else None


def _runs(replies: Iterable[Received]) -> dict[int, GatewayInfo]:
    """Return the gateways that replied, by start time: each run once."""
    found = (_message(reply) for reply in replies)
    return {info.started_ns: info for info in found if isinstance(info, GatewayInfo)}


def _settings_of(runs: Mapping[int, GatewayInfo]) -> Settings | None:
    """Return the gateway's settings as it reports them; None unless exactly one gateway replied."""
    if len(runs) != 1:
        return None
    (info,) = runs.values()
    with suppress(CommandError):  # It may be of another version.
        return merge(TomlSource("gateway/info", info.configuration, is_recorded=True), {}, {})
    return None


def _clock_moved_s(health: GatewayHealth, runs: Collection[int]) -> float:
    """Return by how much the robot's clock was set since its gateway started; 0 unless exactly one is known."""
    if len(runs) != 1:
        return 0.0
    (started_ns,) = runs
    return (health.time_ns - started_ns) / 1e9 - health.uptime_s


def settings_to_ask(settings: Settings) -> ZenohSettings:
    """Return settings that can see: a robot's own certificate sees nothing, and a gateway may only listen."""
    zenoh = settings.zenoh
    own = Path(zenoh.config)
    if own.name == ROBOT_FILE:
        beside = [own.parent / name for name in SEEING]
        services = [own.parent.parent / name for name in INSTALLED if Path(name).name in SEEING]
        seeing = next((file for file in (*beside, *services) if file.exists()), own)
        return msgspec.structs.replace(zenoh, config=str(seeing))
    if zenoh.listen and not zenoh.connect:
        return msgspec.structs.replace(zenoh, connect=[_loopback(one) for one in zenoh.listen], listen=[])
    return zenoh


def _loopback(endpoint: str) -> str:
    for anywhere, here in (("0.0.0.0", "127.0.0.1"), ("[::]", "[::1]")):  # noqa: S104 - nothing listens here
        endpoint = endpoint.replace(f"/{anywhere}:", f"/{here}:")
    return endpoint


def _zenoh_files(settings: Settings) -> list[Path]:
    """Return the installed Zenoh files that have certificates."""
    base = directory_of(settings.authority).parent
    found = [Path(settings.zenoh.config)] if settings.zenoh.config else []
    found += [file for file in (base / name for name in INSTALLED) if file.exists()]
    return list(dict.fromkeys(found))
