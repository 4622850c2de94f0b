"""``cruiser sim``: a virtual chassis on a CAN bus."""

from __future__ import annotations

import argparse
import contextlib
import logging
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Final

from gateway.can.socketcand_server import SocketcandServer
from gateway.chassis.cruiser.layout import load
from gateway.cli.sim_run import CanBusLink, SimBus, SimClock, live
from gateway.cli.typed_lines import TypedLines
from gateway.sim.address import parse_address, show_address
from gateway.sim.faults import GRAMMAR, FaultTextError, ScheduledFault, parse_scheduled
from gateway.sim.model import VirtualChassis
from gateway.sim.parameters import (
    CONDITION_BOUNDS,
    MAX_RATE_MULTIPLIER,
    MIN_RATE_MULTIPLIER,
    NOMINAL,
    Conditions,
    StopMode,
)
from schemas.arguments import seconds
from schemas.command_line import CommandError, ExitCode
from schemas.messages import Variant
from schemas.settings import CanSettings, Settings

_logger = logging.getLogger(__name__)

EXAMPLE: Final = """\
  cruiser sim                                     a coarse chassis on 127.0.0.1:29536
  cruiser sim --variant fine --fault "3s bumper front on" --fault "5s silence Auto_GearFeedBack for 2s"
  cruiser sim --slope 8 --payload 100 --stop-mode coasts
  cruiser sim --interface socketcan --channel vcan0
  cruiser gateway --interface socketcand --channel 127.0.0.1:29536      puts it on Zenoh"""

_STDIN: Final = 0

_CONDITION_FLAGS: Final = {
    "slope_deg": ("--slope", "DEG", "stand on a slope, nose up positive, from {low:g} to {high:g}"),
    "payload_kg": ("--payload", "KG", "carry this much, up to {high:g}"),
    "pedal_gain": (
        "--pedal-gain",
        "GAIN",
        "how much of the brake the brake pedal applies, from {low:g} to {high:g}",
    ),
    "parking_grip": ("--parking-grip", "SHARE", "share of its grip that the parking brake has, to {high:g}"),
    "parking_delay_s": ("--parking-delay", "S", "seconds that the parking brake takes, up to {high:g}"),
}
"""The conditions that have a flag: its name, its value, its help."""

_FAULT_HELP: Final = f"""\
Faults, for --fault (with a delay before them, as in '3s bumper front on'), for 'cruiser fault', or typed while
the chassis runs:

{GRAMMAR}"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the flags."""
    parser.description = f"{parser.description or ''}\n\n{_FAULT_HELP}"
    parser.add_argument(
        "--listen",
        dest="sim.listen",
        metavar="HOST:PORT",
        help="serve the bus by the socketcand protocol here; port 0 takes a free one (default 127.0.0.1:29536)",
    )
    parser.add_argument("--variant", dest="sim.variant", choices=["coarse", "fine"], help="firmware variant")
    parser.add_argument(
        "--fault", action="append", default=[], metavar="TEXT", help="cause a fault; may be given repeatedly"
    )
    parser.add_argument("--seconds", type=seconds, metavar="N", help="end after this time")
    parser.add_argument(
        "--rate-multiplier",
        type=partial(_bounded, low=MIN_RATE_MULTIPLIER, high=MAX_RATE_MULTIPLIER),
        default=1.0,
        metavar="N",
        help="send the feedback N times as often as the DBC says, to load a bus: 11.9 gives 7,500 frames/s",
    )
    for field, (flag, metavar, text) in _CONDITION_FLAGS.items():
        low, high = CONDITION_BOUNDS[field]
        default = getattr(NOMINAL, field)
        parser.add_argument(
            flag,
            dest=field,
            type=partial(_bounded, low=low, high=high),
            default=default,
            metavar=metavar,
            help=f"{text.format(low=low, high=high)} (default {default:g})",
        )
    parser.add_argument(
        "--stop-mode",
        choices=[mode.value for mode in StopMode],
        default=NOMINAL.stop_mode.value,
        help="what the chassis does in mode stop, of which the manual says nothing (default brakes)",
    )
    parser.add_argument(
        "--interface", dest="can.interface", metavar="NAME", help="be on this python-can bus instead of listening"
    )
    parser.add_argument("--channel", dest="can.channel", metavar="NAME", help="the channel of --interface")


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    """Runs the chassis until it is stopped."""
    flags = vars(arguments)
    attached = flags.get("can.interface") is not None
    if attached and flags.get("sim.listen") is not None:
        raise CommandError("--listen and --interface exclude each other", ExitCode.USAGE)
    if not attached and flags.get("can.channel") is not None:
        raise CommandError("--channel needs --interface", ExitCode.USAGE)
    faults = [_scheduled(text) for text in arguments.fault]
    layout = load(Variant(settings.sim.variant))
    with _bus(settings.can) if attached else _server(settings.sim.listen) as (link, place):
        clock = SimClock()
        now_ns = clock.monotonic_ns()
        chassis = VirtualChassis(
            layout, now_ns, rate_multiplier=arguments.rate_multiplier, conditions=_conditions(flags)
        )
        for fault in faults:
            chassis.inject(fault.line, now_ns + fault.after_ns)
        _say(f"{layout.variant.value} chassis on {place}")
        summary = live(
            chassis,
            link,
            stopped,
            clock=clock,
            lines=TypedLines(_STDIN),
            answer=_say,
            seconds=arguments.seconds,
        )
    _logger.info("%d frames sent, %d received", summary.sent, summary.received)
    return ExitCode.OK


@contextlib.contextmanager
def _server(address: str) -> Iterator[tuple[SimBus, str]]:
    host, port = parse_address(address)
    try:
        server = SocketcandServer(host, port)
    except (OSError, UnicodeError) as error:  # UnicodeError: no host's name looks like that
        number = getattr(error, "errno", None) or 0
        # Python adds the address to the system's own words; the line has it already.
        why = os.strerror(number) if number > 0 else getattr(error, "strerror", None) or str(error)
        raise CommandError(f"cannot listen on {address}: {why}", ExitCode.UNREACHABLE) from error
    try:
        yield server, show_address(*server.address)
    finally:
        server.close()


@contextlib.contextmanager
def _bus(settings: CanSettings) -> Iterator[tuple[SimBus, str]]:
    # python-can takes a while to import, and the server does without it.
    from gateway.can.can_bus import BusLost  # noqa: PLC0415
    from gateway.can.open_bus import describe, open_bus  # noqa: PLC0415

    try:
        bus = open_bus(settings)
        try:
            yield CanBusLink(bus), describe(settings)
        finally:
            bus.close()
    except BusLost as error:
        raise CommandError(f"no bus: {error}", ExitCode.UNREACHABLE) from error


def _scheduled(text: str) -> ScheduledFault:
    fault = parse_scheduled(text)
    if isinstance(fault, FaultTextError):
        raise CommandError(f"--fault {text!r}: {fault.reason}", ExitCode.USAGE)
    return fault


def _conditions(flags: Mapping[str, object]) -> Conditions:
    stop_mode = StopMode(flags["stop_mode"])
    return Conditions(**{field: flags[field] for field in _CONDITION_FLAGS}, stop_mode=stop_mode)  # type: ignore[arg-type]


def _bounded(text: str, low: float, high: float) -> float:
    try:
        value = float(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text!r} is no number") from error
    if not low <= value <= high:
        raise argparse.ArgumentTypeError(f"{text} is not from {low:g} to {high:g}")
    return value


def _say(text: str) -> None:
    sys.stderr.write(f"sim: {text}\n")
