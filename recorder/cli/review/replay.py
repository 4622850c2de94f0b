"""``cruiser review replay``: publish a log's messages again, or put its frames on a CAN bus."""

from __future__ import annotations

import argparse
import math
import re
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from functools import lru_cache
from typing import Final, TypeVar

import msgspec

from recorder.cli.review.asking import Asked, add_logs, add_period, end_with, find
from recorder.cli.show import show
from recorder.reading.faults import Faults
from recorder.reading.rows import Row, Selection, read_rows
from recorder.reading.topics import Topic
from recorder.replay.can import CanOutlet, CanPlace, is_virtual
from recorder.replay.controls import ReplayControls
from recorder.replay.frames import DANGER, Frames, Rules, buses_of, holds_frames, refusal
from recorder.replay.replay import AS_FAST_AS_POSSIBLE, FOR_EVER, Pace, ReplayScheduler, Timed
from recorder.replay.rows import By, frames, in_order, once, runs, topics_of
from recorder.replay.run import Halt, Outlet, ReplayClock, play
from recorder.replay.samples import (
    DEFAULT_ROOT,
    KeyMap,
    ReplaySample,
    Samples,
    Wants,
    may_hold,
    overlap,
    roots_of,
)
from recorder.replay.zenoh import ZenohOutlet, key_checked
from recorder.zenoh.session import key_matches
from schemas import keys
from schemas.arguments import add_link_arguments, seconds
from schemas.exit_codes import CommandError, ExitCode
from schemas.printable import plain
from schemas.settings import DEFAULT_ENDPOINT, Settings

EXAMPLE: Final = """\
  cruiser review replay logs                                   then: cruiser watch --root replay
  cruiser review replay LOG --from 12.5 --speed 4 --loop forever --listen tcp/127.0.0.1:7447
  cruiser review replay LOG --keys 'fleet/cruiser-1/chassis/**' --speed max
  cruiser review replay LOG --interface socketcan --channel vcan0"""
DESCRIPTION: Final = (
    "Publishes a log's messages again on Zenoh as what they were, or, with --interface, puts its raw frames "
    "on a CAN bus. On Zenoh they go under a root of their own, 'replay': fleet/cruiser-1/state becomes "
    "replay/cruiser-1/state. Commands are never published, nor anything under a root where a gateway is "
    "connected. A CAN bus must be virtual. At a terminal: space pauses, arrows seek 10 s, q ends. Exit codes: "
    "3 if a part was not read or not sent, 4 if nobody is there, 5 if it is refused."
)

TIMEOUT_S: Final = 3.0
EVERY_KEY: Final = "**"
MATCHES_KEPT: Final = 10_000
MAX: Final = "max"
FOREVER: Final = "forever"
NOTHING: Final = "the logs hold nothing that could be replayed"
SPEED_MIN: Final = 0.001
SPEED_MAX: Final = 1e6
LONGEST_PAUSE_S: Final = 60.0

T = TypeVar("T", bound=Timed)


class Replayed(msgspec.Struct, frozen=True):
    """The outcome of a replay.

    Attributes:
        to: the destination.
        sent: samples, or frames; ``failed`` were not taken.
        withheld: those that are not to be sent, by why; of Zenoh commands, keys that name several things,
            and encodings that are too long.
        loops: number of times that it was begun.
        took_s: its duration.
        lateness_p50_ms, lateness_p99_ms, lateness_max_ms: how late they were sent; 0 at the speed 'max'.
        slipped_s: by how much it fell behind altogether, as it could not keep up.
        pauses_cut: pauses of the log that were shortened.
        was_alone: for a while nobody was connected; what was sent then is lost.
        ended: ``end``; ``stopped``, by a person; or why it could not go on.
    """

    to: str
    sent: int
    failed: int
    withheld: dict[str, int]
    loops: int
    took_s: float
    lateness_p50_ms: float
    lateness_p99_ms: float
    lateness_max_ms: float
    slipped_s: float
    pauses_cut: int
    was_alone: bool
    ended: str


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags."""
    add_logs(parser, json_help="print the outcome as JSON")
    add_period(parser)
    parser.add_argument(
        "--speed", type=_speed, default=1.0, metavar="X", help="so many times as fast; 'max' waits for nothing (1)"
    )
    parser.add_argument("--loop", type=_loops, default=1, metavar="N", help="how often, or 'forever' (1)")
    parser.add_argument(
        "--longest-pause",
        type=seconds,
        default=LONGEST_PAUSE_S,
        metavar="S",
        help=f"a longer pause of the log is shortened to this ({LONGEST_PAUSE_S:g})",
    )
    parser.add_argument(
        "--keys",
        action="append",
        metavar="KEY",
        help="key expression, of keys as they are in the log; may be repeated (all but those with @)",
    )
    zenoh = parser.add_argument_group("to Zenoh")
    zenoh.add_argument("--root", default=None, metavar="ROOT", help=f"first chunks of every key ({DEFAULT_ROOT})")
    zenoh.add_argument(
        "--force", action="store_true", help="allow the log's own root; never where a gateway is connected"
    )
    zenoh.add_argument(
        "--time", choices=[by.value for by in By], default=None, help="whose time counts: receipt, or source (log)"
    )
    zenoh.add_argument("--now", action="store_true", help="move the messages' time stamps into the present")
    add_link_arguments(zenoh)
    zenoh.add_argument(
        "--listen",
        dest="zenoh.listen",
        action="append",
        metavar="ENDPOINT",
        help="Zenoh endpoint to listen on; the replay begins when somebody subscribes there, and joins no other "
        "node without --connect",
    )
    zenoh.add_argument(
        "--timeout",
        type=seconds,
        default=TIMEOUT_S,
        metavar="S",
        help=f"how long to wait for a Zenoh node, and for subscribers ({TIMEOUT_S:g})",
    )
    bus = parser.add_argument_group("to a CAN bus")
    bus.add_argument(
        "--interface", metavar="NAME", help="python-can interface: virtual, socketcan, socketcand, ..."
    )
    bus.add_argument("--channel", metavar="NAME", help="its channel; for socketcand HOST:PORT or HOST:PORT/BUS")
    bus.add_argument("--bitrate", type=int, default=0, metavar="BIT/S", help="for interfaces that set it")
    bus.add_argument("--fd", action="store_true", help="the bus takes CAN FD frames")
    bus.add_argument("--tx", action="store_true", help="also what the gateway sent: the commands of the drive")
    bus.add_argument(
        "--force-real-bus", action="store_true", help="allow a bus that is not virtual; command frames stay out"
    )
    bus.add_argument(
        "--force-command-frames", action="store_true", help=f"let them out there, too. DANGER: {DANGER}"
    )


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    """Replay, and print what became of it."""
    _check_flags(arguments)
    expressions = [key_checked(text) for text in arguments.keys or [EVERY_KEY]]

    @lru_cache(MATCHES_KEPT)
    def wants(key: str) -> bool:
        return any(key_matches(expression, key) for expression in expressions)

    asked = find(arguments)
    replay = _to_zenoh if arguments.interface is None else _to_bus
    replayed, halt = replay(arguments, settings, asked, wants, stopped)
    show(replayed, describe(replayed), as_json=arguments.json)
    sys.stdout.flush()
    code = end_with(asked.faults)
    if halt is not None:
        raise CommandError(halt.detail, halt.code)
    if not replayed.sent and not replayed.failed and replayed.ended == "end":
        raise CommandError(NOTHING)
    return int(ExitCode.PARTIAL) if replayed.failed or replayed.was_alone else code


def _to_zenoh(
    arguments: argparse.Namespace, settings: Settings, asked: Asked, wants: Wants, stopped: Callable[[], bool]
) -> tuple[Replayed, Halt | None]:
    root = DEFAULT_ROOT if arguments.root is None else arguments.root
    if re.fullmatch(keys.ROOT_PATTERN, root) is None:
        raise CommandError(f"{root!a} cannot be a root: it is {keys.ROOT_PATTERN}", ExitCode.USAGE)
    roots = roots_of(topics_of(asked.logs))
    _check_root(root, {*roots, settings.robot.root}, is_forced=arguments.force)
    samples = Samples(KeyMap(root, roots), wants, asked.faults)
    by = By(arguments.time or By.LOG)

    def read(rows: Iterator[Row]) -> Iterator[ReplaySample]:
        found = runs(rows, by)
        return samples.of(in_order(found) if by is By.PUBLISH else found)

    # Or it would wait for somebody, and have nothing to say.
    if not any(may_hold(topic, wants) for topic in topics_of(asked.logs)):
        raise CommandError(NOTHING)
    player = _player(arguments, asked, lambda topic: may_hold(topic, wants), read)
    with closing(ZenohOutlet(settings.zenoh, root, waits=not player.pace.is_paced)) as outlet:
        _meet(outlet, root, arguments.timeout, stopped)
        if not outlet.wait_for_subscriber(arguments.timeout, stopped) and not stopped():
            _tell(f"nobody subscribes to {root}/** yet")
        _tell(f"{len(asked.logs)} logs to {root}/**")
        replayed, halt = _play(player, outlet, f"{root}/**", stopped, takes_keys=True, is_now=arguments.now)
    # Who listens has guests that come and go.
    was_alone = outlet.was_alone and not outlet.listen
    withheld = {"commands, and keys or encodings that are unfit": samples.withheld} if samples.withheld else {}
    return msgspec.structs.replace(replayed, withheld=withheld, was_alone=was_alone), halt


def _check_root(root: str, others: set[str], *, is_forced: bool) -> None:
    """Nothing goes under a root that may be a robot's, unless that is meant."""
    for other in sorted(others):
        # What was recorded of a replay is no robot's.
        is_replay = f"{other}/".startswith(f"{DEFAULT_ROOT}/")
        if overlap(root, other) and not is_replay and not is_forced:
            raise CommandError(
                f"what goes under {root} would be taken for a robot's: robots are under {other}, in the log or by "
                f"the settings; leave out --root (it is {DEFAULT_ROOT}), or say --force",
                ExitCode.REFUSED,
            )


def _meet(outlet: ZenohOutlet, root: str, timeout_s: float, stopped: Callable[[], bool]) -> None:
    """Wait for somebody to be there, and see that it is no gateway under this root."""
    if outlet.listen:
        _tell(f"waits for somebody who connects to {', '.join(outlet.listen)} and subscribes to {root}/**")
        outlet.wait_for_subscriber(None, stopped)
    elif not outlet.wait_for_link(timeout_s, stopped) and not stopped():
        raise CommandError(
            f"no Zenoh node answered within {timeout_s:g} s; with --listen {DEFAULT_ENDPOINT} others connect here",
            ExitCode.UNREACHABLE,
        )
    halt = outlet.find_gateway()
    if halt is not None:
        raise CommandError(halt.detail, halt.code)


def _to_bus(
    arguments: argparse.Namespace, _settings: Settings, asked: Asked, wants: Wants, stopped: Callable[[], bool]
) -> tuple[Replayed, Halt | None]:
    place = CanPlace(arguments.interface, arguments.channel, arguments.bitrate, arguments.fd)
    virtual = is_virtual(place)
    why = refusal(place.interface, is_virtual=virtual, is_forced=arguments.force_real_bus)
    if why:
        raise CommandError(why, ExitCode.REFUSED)
    drives = not virtual and arguments.force_command_frames
    if drives and (arguments.speed != 1 or arguments.loop != 1):
        raise CommandError("command frames go to a real bus at their own speed, and once", ExitCode.USAGE)

    def holds(topic: Topic) -> bool:
        return holds_frames(topic, wants, with_sent=arguments.tx)

    buses = buses_of(filter(holds, topics_of(asked.logs)))
    if len(buses) > 1:
        raise CommandError(
            f"there are several buses: {', '.join(map(plain, buses))}; choose with --keys", ExitCode.USAGE
        )
    found = Frames(Rules(virtual, takes_commands=drives, takes_fd=place.is_fd), asked.faults)
    player = _player(arguments, asked, holds, lambda rows: found.of(in_order(frames(rows))))
    where = f"{place.interface} {place.channel}"
    with closing(CanOutlet(place)) as outlet:
        _tell(f"{len(asked.logs)} logs to {where}, {'virtual' if virtual else 'NOT VIRTUAL'}")
        # To stand still, or to step, in the middle of a drive is not for a real bus.
        replayed, halt = _play(player, outlet, where, stopped, takes_keys=virtual)
    if drives:
        _tell("nothing is sent any more, and a chassis obeys the last command for ever: 'cruiser halt' stops it")
    return msgspec.structs.replace(replayed, withheld=dict(found.withheld)), halt


def _player(
    arguments: argparse.Namespace,
    asked: Asked,
    wants: Callable[[Topic], bool],
    make: Callable[[Iterator[Row]], Iterator[T]],
) -> ReplayScheduler[T]:
    faults = [asked.faults]

    def read(from_ns: int | None) -> Iterator[T]:
        selection = Selection(wants, max(asked.from_ns, from_ns or 0), asked.to_ns)
        # What cannot be read is told once, however often it is read.
        rows = read_rows(asked.logs, selection, faults.pop() if faults else Faults())
        return make(once(rows) if len(asked.logs) > 1 else rows)

    return ReplayScheduler(read, Pace(arguments.speed, round(arguments.longest_pause * 1e9)), arguments.loop)


def _play(
    player: ReplayScheduler[T],
    outlet: Outlet[T],
    where: str,
    stopped: Callable[[], bool],
    *,
    takes_keys: bool,
    is_now: bool = False,
) -> tuple[Replayed, Halt | None]:
    begun_s = time.monotonic()
    with ReplayControls(takes_keys=takes_keys) as controls:
        halt = play(player, outlet, ReplayClock(), controls, stopped, is_now=is_now)
    late = player.lateness
    ended = "end" if player.is_ended else "stopped"
    replayed = Replayed(
        to=where,
        sent=outlet.sent,
        failed=outlet.failed,
        withheld={},
        loops=player.loop,
        took_s=round(time.monotonic() - begun_s, 3),
        lateness_p50_ms=late.quantile_ns(0.5) / 1e6,
        lateness_p99_ms=late.quantile_ns(0.99) / 1e6,
        lateness_max_ms=late.max_ns / 1e6,
        slipped_s=player.slipped_ns / 1e9,
        pauses_cut=player.pace.cut,
        was_alone=False,
        ended=ended if halt is None else halt.detail,
    )
    return replayed, halt


def describe(replayed: Replayed) -> Iterator[str]:
    """Yield lines for people about what became of a replay."""
    rate = replayed.sent / replayed.took_s if replayed.took_s else 0
    yield f"{replayed.to}: {replayed.sent} sent in {replayed.took_s:.1f} s, {rate:.0f}/s"
    if replayed.failed:
        yield f"  {replayed.failed} were not taken"
    yield from (f"  {count} withheld: {why}" for why, count in replayed.withheld.items())
    if replayed.lateness_max_ms:
        yield (
            f"  lateness: median {replayed.lateness_p50_ms:.1f} ms, p99 {replayed.lateness_p99_ms:.1f} ms, "
            f"at most {replayed.lateness_max_ms:.1f} ms"
        )
    if replayed.slipped_s:
        yield f"  it fell {replayed.slipped_s:.1f} s behind"
    if replayed.pauses_cut:
        yield f"  {replayed.pauses_cut} pauses of the log were shortened"
    if replayed.was_alone:
        yield "  for a while no Zenoh node was connected, and what was sent then is lost"
    if replayed.loops > 1:
        yield f"  {replayed.loops} times"


def _check_flags(arguments: argparse.Namespace) -> None:
    """A flag that would do nothing is a mistake."""
    given = vars(arguments)
    if arguments.interface is None:
        idle = [name for name in _OF_BUSES if given[name]]
        other = "without --interface"
    else:
        idle = [name for name in _OF_ZENOH if given[name]]
        other = "with --interface"
        if not arguments.channel:
            raise CommandError("--interface wants its --channel", ExitCode.USAGE)
    if arguments.force_command_frames and not arguments.force_real_bus:
        raise CommandError("--force-command-frames is about a bus of --force-real-bus", ExitCode.USAGE)
    if idle:
        flags = ", ".join(f"--{name.replace('_', '-')}" for name in idle)
        raise CommandError(f"{flags} says nothing {other}", ExitCode.USAGE)


_OF_BUSES: Final = ("channel", "bitrate", "fd", "tx", "force_real_bus", "force_command_frames")
_OF_ZENOH: Final = ("root", "force", "time", "now")


def _tell(text: str) -> None:
    sys.stderr.write(f"replay: {plain(text)}\n")


def _speed(text: str) -> float:
    if text == MAX:
        return AS_FAST_AS_POSSIBLE
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not SPEED_MIN <= value <= SPEED_MAX:
        raise argparse.ArgumentTypeError(
            f"{text!r} is no speed: a number from {SPEED_MIN} to {SPEED_MAX:g}, or 'max'"
        )
    return value


def _loops(text: str) -> int:
    if text == FOREVER:
        return FOR_EVER
    if not (text.isascii() and text.isdigit() and int(text) > 0):
        raise argparse.ArgumentTypeError(f"{text!r} is no number of times, nor 'forever'")
    return int(text)
