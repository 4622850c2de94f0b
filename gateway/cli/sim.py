"""``cruiser sim``: a virtual chassis in real time.

- Lines that are typed, or piped in, while a command runs. Never blocks, never spins.
- The virtual chassis in real time: the one place of this package with clocks.
- ``cruiser sim``: a virtual chassis on a CAN bus.
"""

from __future__ import annotations

import argparse
import contextlib
import logging
import os
import select
import stat
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from typing import Final, Protocol

import msgspec

from gateway.can.can_bus import Bus, BusFull
from gateway.can.socketcand_server import SocketcandServer
from gateway.chassis.frame import ERROR, Frame
from gateway.choice import CHASSIS
from gateway.sim.body import (
    CONDITION_BOUNDS,
    MAX_RATE_MULTIPLIER,
    MIN_RATE_MULTIPLIER,
    NOMINAL,
    Conditions,
    StopMode,
)
from gateway.sim.disturbances import (
    GRAMMAR,
    FaultTextError,
    ScheduledFault,
    parse,
    parse_address,
    parse_scheduled,
    show_address,
)
from gateway.sim.model import VirtualChassis
from schemas.arguments import seconds
from schemas.command_line import CommandError, ExitCode
from schemas.messages import Variant
from schemas.settings import CanSettings, Settings

_READ_BYTES: Final = 4096
_MAX_LINE_BYTES: Final = 1024
"""A line that gets longer than this is given up."""


class TypedLines:
    """The lines of a terminal or a pipe; of anything else, none."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._buffer = b""
        self._open = _can_be_typed_into(descriptor)

    def read(self) -> list[str]:
        """The lines that are complete by now."""
        if not self._open or not self._is_ready():
            return []
        try:
            data = os.read(self._descriptor, _READ_BYTES)
        except OSError:
            data = b""  # The terminal has gone.
        if not data:
            self._open = False
            *lines, rest = [*self._buffer.split(b"\n"), b""]
        else:
            *lines, rest = (self._buffer + data).split(b"\n")
        self._buffer = rest[:_MAX_LINE_BYTES]
        return [text for line in lines if (text := line.decode("utf-8", errors="replace").strip())]

    def _is_ready(self) -> bool:
        # A process in the background that reads its terminal is stopped by SIGTTIN.
        if _is_in_background(self._descriptor):
            return False
        return bool(select.select([self._descriptor], [], [], 0)[0])


def _is_in_background(descriptor: int) -> bool:
    try:
        return os.tcgetpgrp(descriptor) != os.getpgrp()
    except OSError:
        return False  # A pipe, or a terminal that does not control this process: it stops nobody.


def _can_be_typed_into(descriptor: int) -> bool:
    try:
        return os.isatty(descriptor) or stat.S_ISFIFO(os.fstat(descriptor).st_mode)
    except OSError:
        return False  # The process was started without it.


_logger = logging.getLogger(__name__)

_NS_PER_S: Final = 1_000_000_000

_MAX_WAIT_NS: Final = 50_000_000
"""A signal to stop is seen after this time at the latest."""

_TYPED_PERIOD_NS: Final = 100_000_000
"""The period in which typed lines are read."""

_STALL_NS: Final = 500_000_000
"""Later than this, the process was stopped rather than late: the time is left out of the chassis's life.

Catching up would put seconds of feedback on the bus at once, which no chassis does.
"""

_MAX_FRAMES_PER_WAIT: Final = 200
"""Frames taken from a CAN bus before the chassis has its turn again."""

Inject = Callable[[str], str]
"""Causes the fault that a text names; returns what is wrong with the text, or nothing."""


class SimBus(Protocol):
    """A bus to be on. ``wait`` is the only call that may block."""

    def wait(self, timeout_s: float) -> None:
        """Waits for something to read, at most this long."""

    def read(self, now_ns: int, wall_ns: int, inject: Inject) -> list[Frame]:
        """The frames that others sent."""
        ...

    def send(self, frames: Iterable[Frame], now_ns: int) -> None:
        """Puts frames on the bus."""


class SimClock:
    """The machine's clocks."""

    def monotonic_ns(self) -> int:
        """For deadlines."""
        return time.monotonic_ns()

    def wall_ns(self) -> int:
        """For the frames' time stamps."""
        return time.time_ns()


class SimSummary(msgspec.Struct):
    """The counts of a run."""

    sent: int = 0
    received: int = 0
    stalled_ns: int = 0


class CanBusLink:
    """A bus of python-can."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self._frames: list[Frame] = []

    def wait(self, timeout_s: float) -> None:
        """Waits for a frame, and takes those that are there already.

        Raises:
            BusLost: the bus has gone.
        """
        frame = self._bus.receive(timeout_s)
        while frame is not None and len(self._frames) < _MAX_FRAMES_PER_WAIT:
            self._frames.append(frame)
            frame = self._bus.receive(0.0)
        if frame is not None:
            self._frames.append(frame)

    def read(self, now_ns: int, wall_ns: int, inject: Inject) -> list[Frame]:
        """The frames of the last wait."""
        del now_ns, wall_ns, inject  # A CAN bus stamps its frames, and carries no words.
        frames, self._frames = self._frames, []
        return frames

    def send(self, frames: Iterable[Frame], now_ns: int) -> None:
        """Puts frames on the bus, but for error frames: a node cannot send those at will.

        Raises:
            BusLost: the bus has gone.
        """
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
    *,
    clock: SimClock,
    lines: TypedLines,
    answer: Callable[[str], None],
    seconds: float | None = None,
) -> SimSummary:
    """Run the chassis on the bus until interrupted.

    Args:
        chassis: powered up at the clock's monotonic time.
        stopped: turns true when the run should end.
        seconds: ends the run by itself after this time.
    """
    summary = SimSummary()
    now_ns = clock.monotonic_ns()
    end_ns = None if seconds is None else now_ns + round(seconds * _NS_PER_S)
    next_lines_ns = now_ns

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
        if now_ns >= next_lines_ns:
            next_lines_ns = now_ns + _TYPED_PERIOD_NS
            for text in lines.read():
                answer(inject(text) or f"ok: {text}")
    return summary


def _time_of_life(clock: SimClock, chassis: VirtualChassis, summary: SimSummary) -> int:
    """The monotonic time without the times during which this process was stopped."""
    now_ns = clock.monotonic_ns() - summary.stalled_ns
    late_ns = now_ns - chassis.next_due_ns
    if late_ns <= _STALL_NS:
        return now_ns
    summary.stalled_ns += late_ns
    _logger.warning("the process was stopped for %.1f s; the chassis goes on where it was", late_ns / _NS_PER_S)
    return now_ns - late_ns


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
    variant = Variant(settings.sim.variant)
    with _bus(settings.can) if attached else _server(settings.sim.listen) as (link, place):
        clock = SimClock()
        now_ns = clock.monotonic_ns()
        chassis = VirtualChassis(
            CHASSIS, variant, now_ns, rate_multiplier=arguments.rate_multiplier, conditions=_conditions(flags)
        )
        for fault in faults:
            chassis.inject(fault.line, now_ns + fault.after_ns)
        _say(f"{variant.value} chassis on {place}")
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
