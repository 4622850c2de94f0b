"""``cruiser sim``: a virtual chassis on a CAN bus, in real time."""

from __future__ import annotations

import argparse
import contextlib
import logging
import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from typing import Final, Protocol

import msgspec

from gateway.can.can_bus import Bus, BusFull, BusLost
from gateway.can.open_bus import describe, open_bus
from gateway.can.socketcand_server import SocketcandServer
from gateway.chassis.frame import ERROR, Frame
from gateway.choice.chassis import CHASSIS
from gateway.sim.body import MAX_RATE_MULTIPLIER, MIN_RATE_MULTIPLIER, NOMINAL, Conditions, StopMode
from gateway.sim.disturbances import (
    GRAMMAR,
    FaultLine,
    FaultTextError,
    parse,
    parse_address,
    parse_scheduled,
    show_address,
)
from gateway.sim.model import VirtualChassis
from schemas.arguments import number, seconds
from schemas.command_line import CommandError, ExitCode
from schemas.messages import Variant
from schemas.settings import CanSettings, Settings

_logger = logging.getLogger(__name__)

_NS_PER_S: Final = 1_000_000_000

_MAX_WAIT_NS: Final = 50_000_000  # a signal to stop is seen after this time at the latest
_STALL_NS: Final = 500_000_000
"""A longer delay is left out of the chassis's life: the process was stopped, and no chassis sends bursts."""

_MAX_FRAMES_PER_WAIT: Final = 200  # frames taken from a CAN bus before the chassis has its turn again
# causes the fault that a text names; returns what is wrong with the text, or nothing
Inject = Callable[[str], str]


class SimBus(Protocol):
    """A bus for the chassis. Only ``wait`` may block."""

    def wait(self, timeout_s: float) -> None:
        """Wait for input, at most this long."""

    def read(self, now_ns: int, wall_ns: int, inject: Inject) -> list[Frame]:
        """Return the frames from others."""

    def send(self, frames: Iterable[Frame], now_ns: int) -> None: ...


class SimClock:
    """The machine's clocks."""

    def monotonic_ns(self) -> int:
        return time.monotonic_ns()

    def wall_ns(self) -> int:
        return time.time_ns()


class SimSummary(msgspec.Struct):
    """Counts of a run."""

    sent: int = 0
    received: int = 0
    stalled_ns: int = 0


class CanBusLink:
    """A bus of python-can."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self._frames: list[Frame] = []

    def wait(self, timeout_s: float) -> None:
        """Wait for a frame, and take those that are there already."""
        frame = self._bus.receive(timeout_s)
        while frame is not None and len(self._frames) < _MAX_FRAMES_PER_WAIT:
            self._frames.append(frame)
            frame = self._bus.receive(0.0)
        if frame is not None:
            self._frames.append(frame)

    def read(self, now_ns: int, wall_ns: int, inject: Inject) -> list[Frame]:
        del now_ns, wall_ns, inject  # A CAN bus stamps its frames, and carries no words.
        frames, self._frames = self._frames, []
        return frames

    def send(self, frames: Iterable[Frame], now_ns: int) -> None:
        """Send frames; a node cannot send error frames."""
        del now_ns
        for frame in frames:
            if not frame.can_id & ERROR:
                try:
                    self._bus.send(frame)
                except BusFull as error:
                    _logger.debug("a frame is lost: %s", error)


def live(
    chassis: VirtualChassis,
    link: SimBus,
    stopped: Callable[[], bool],
    clock: SimClock,
    seconds: float | None = None,
) -> SimSummary:
    """Run the chassis, powered up at the clock's monotonic time, on the bus until interrupted."""
    summary = SimSummary()
    now_ns = clock.monotonic_ns()
    end_ns = None if seconds is None else now_ns + round(seconds * _NS_PER_S)

    def inject(text: str) -> str:
        line = parse(text)
        if isinstance(line, FaultTextError):
            return line.reason
        chassis.inject(line, now_ns)
        return ""

    while not stopped() and (end_ns is None or now_ns < end_ns):
        link.wait(min(max(chassis.next_due_ns - now_ns, 0), _MAX_WAIT_NS) / _NS_PER_S)
        now_ns = _time_of_life(clock, chassis, summary)
        wall_ns = clock.wall_ns()
        for frame in link.read(now_ns, wall_ns, inject):
            chassis.receive(frame, now_ns)
            summary.received += 1
        frames = chassis.advance(now_ns, wall_ns)
        if frames:
            link.send(frames, now_ns)
            summary.sent += len(frames)
    return summary


def _time_of_life(clock: SimClock, chassis: VirtualChassis, summary: SimSummary) -> int:
    """Return the monotonic time without the times during which this process was stopped."""
    now_ns = clock.monotonic_ns() - summary.stalled_ns
    late_ns = now_ns - chassis.next_due_ns
    if late_ns <= _STALL_NS:
        return now_ns
    summary.stalled_ns += late_ns
    _logger.warning("the process was stopped for %.1f s; the chassis continues from there", late_ns / _NS_PER_S)
    return now_ns - late_ns


EXAMPLE: Final = """\
  cruiser sim                                     a coarse chassis on 127.0.0.1:29536
  cruiser sim --variant fine --fault "3s bumper front on" --fault "5s silence Auto_GearFeedBack for 2s"
  cruiser sim --slope 8 --fault "payload 100" --stop-mode coasts
  cruiser sim --interface socketcan --channel vcan0
  cruiser gateway --interface socketcand --channel 127.0.0.1:29536      puts it on Zenoh"""

_FAULT_HELP: Final = f"""\
Faults, for --fault (with a delay before them, as in '3s bumper front on'), or for 'cruiser fault' while the
chassis runs:

{GRAMMAR}"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = f"{parser.description or ''}\n\n{_FAULT_HELP}"
    parser.add_argument(
        "--listen",
        dest="sim.listen",
        metavar="HOST:PORT",
        help="address of the socketcand server; port 0: a free port (default 127.0.0.1:29536)",
    )
    parser.add_argument(
        "--variant",
        dest="sim.variant",
        choices=["coarse", "fine"],
        help="firmware variant, which sets the scale of speeds",
    )
    parser.add_argument(
        "--fault", action="append", default=[], metavar="TEXT", help="fault to cause; may be repeated"
    )
    parser.add_argument("--seconds", type=seconds, metavar="N", help="duration")
    parser.add_argument(
        "--rate-multiplier",
        type=number(MIN_RATE_MULTIPLIER, MAX_RATE_MULTIPLIER, "a factor"),
        default=1.0,
        metavar="N",
        help="factor on the feedback's rate, to load a bus: 11.9 gives 7,500 frames/s",
    )
    parser.add_argument(
        "--slope", type=_slope, default=0.0, metavar="DEG", help="slope, nose up positive (default 0)"
    )
    parser.add_argument(
        "--stop-mode",
        choices=[mode.value for mode in StopMode],
        default=NOMINAL.stop_mode.value,
        help="behaviour in mode stop, which the manual does not define (default brakes)",
    )
    parser.add_argument(
        "--interface", dest="can.interface", metavar="NAME", help="python-can interface to use instead of a server"
    )
    parser.add_argument("--channel", dest="can.channel", metavar="NAME", help="channel of --interface")


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    flags = vars(arguments)
    attached = flags.get("can.interface") is not None
    if attached and flags.get("sim.listen") is not None:
        raise CommandError("--listen and --interface cannot be combined", ExitCode.USAGE)
    if not attached and flags.get("can.channel") is not None:
        raise CommandError("--channel needs --interface", ExitCode.USAGE)
    faults = [_scheduled(text) for text in arguments.fault]
    variant = Variant(settings.sim.variant)
    with _bus(settings.can) if attached else _server(settings.sim.listen) as (link, place):
        clock = SimClock()
        now_ns = clock.monotonic_ns()
        conditions = Conditions(slope_deg=arguments.slope, stop_mode=StopMode(arguments.stop_mode))
        chassis = VirtualChassis(
            CHASSIS, variant, now_ns, rate_multiplier=arguments.rate_multiplier, conditions=conditions
        )
        for fault in faults:
            chassis.inject(fault, now_ns + fault.after_ns)
        sys.stderr.write(f"sim: {variant.value} chassis on {place}\n")
        summary = live(chassis, link, stopped, clock, arguments.seconds)
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
    try:
        bus = open_bus(settings)
        try:
            yield CanBusLink(bus), describe(settings)
        finally:
            bus.close()
    except BusLost as error:
        raise CommandError(f"bus unavailable: {error}", ExitCode.UNREACHABLE) from error


def _scheduled(text: str) -> FaultLine:
    fault = parse_scheduled(text)
    if isinstance(fault, FaultTextError):
        raise CommandError(f"--fault {text!r}: {fault.reason}", ExitCode.USAGE)
    return fault


def _slope(text: str) -> float:
    line = parse(f"slope {text}")
    if isinstance(line, FaultTextError):
        raise argparse.ArgumentTypeError(line.reason)
    return float(text)
