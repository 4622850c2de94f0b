"""``cruiser review replay``: publish a log's messages again."""

from __future__ import annotations

import argparse
import math
import re
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from typing import Final

import msgspec

from recorder.cli.asking import Asked, add_logs, add_period, end_with, find
from recorder.cli.show import show
from recorder.reading.logs import Faults
from recorder.reading.rows import Selection, read_rows
from recorder.reading.survey import survey
from recorder.replay import (
    AS_FAST_AS_POSSIBLE,
    DEFAULT_ROOT,
    FOR_EVER,
    KeyMap,
    Pace,
    ReplaySample,
    Samples,
    Wants,
    ZenohOutlet,
    may_hold,
    once,
    overlap,
    play,
    roots_of,
    runs,
    wants_of,
)
from schemas import keys
from schemas.arguments import add_link_arguments, seconds, whole_number
from schemas.command_line import CommandError, ExitCode, plain
from schemas.settings import DEFAULT_ENDPOINT, Settings

EXAMPLE: Final = """\
  cruiser review replay logs                                   then: cruiser watch --root replay
  cruiser review replay LOG --from 12.5 --speed 4 --loop forever --listen tcp/127.0.0.1:7447
  cruiser review replay LOG --key 'fleet/cruiser-1/chassis/**' --speed max"""
DESCRIPTION: Final = (
    "Publishes a log's messages on Zenoh again, under the root 'replay': fleet/cruiser-1/state becomes "
    "replay/cruiser-1/state. Commands are never published, nor anything under a root where a gateway is "
    "connected. Exit codes: 3 if a part was not read or not sent, 4 if no Zenoh node is connected, 5 if it is "
    "refused."
)

TIMEOUT_S: Final = 3.0

NOTHING: Final = "the logs hold nothing to replay"
SPEED_MIN: Final = 0.001
SPEED_MAX: Final = 1e6


class Replayed(msgspec.Struct, frozen=True):
    """The outcome of a replay.

    Attributes:
        sent, failed: number of samples.
        withheld: samples not to be sent, by reason.
        loops: number of starts.
        lateness_max_ms: 0 at the speed 'max'.
        slipped_s: the total delay of a replay that could not keep up.
        pauses_cut: shortened pauses of the log.
        was_alone: at times no node was connected, and samples were lost.
        ended: ``end``, ``stopped``, or the reason for an early end.
    """

    to: str
    sent: int
    failed: int
    withheld: dict[str, int]
    loops: int
    took_s: float
    lateness_max_ms: float
    slipped_s: float
    pauses_cut: int
    was_alone: bool
    ended: str


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_logs(parser, json_help="print the outcome as JSON")
    add_period(parser)
    parser.add_argument(
        "--speed", type=_speed, default=1.0, metavar="X", help="X times as fast; 'max' is without pauses (1)"
    )
    parser.add_argument("--loop", type=_loops, default=1, metavar="N", help="how often, or 'forever' (1)")
    parser.add_argument(
        "--key",
        action="append",
        metavar="KEY",
        help="key expression, of keys as they are in the log; may be repeated (all but those with @)",
    )
    parser.add_argument(
        "--root", default=DEFAULT_ROOT, metavar="ROOT", help=f"first chunks of every key ({DEFAULT_ROOT})"
    )
    parser.add_argument(
        "--force", action="store_true", help="allow the log's own root; never where a gateway is connected"
    )
    parser.add_argument("--now", action="store_true", help="move the messages' time stamps into the present")
    add_link_arguments(parser)
    parser.add_argument(
        "--listen",
        dest="zenoh.listen",
        action="append",
        metavar="ENDPOINT",
        help="Zenoh endpoint to listen on; the replay begins when a client subscribes there, and joins no other "
        "node without --connect",
    )
    parser.add_argument(
        "--timeout",
        type=seconds,
        default=TIMEOUT_S,
        metavar="S",
        help=f"how long to wait for a Zenoh node, and for subscribers ({TIMEOUT_S:g})",
    )


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    wants = wants_of(arguments.key or ["**"])
    asked = find(arguments, settings, stopped)
    replayed, halt = _replay(arguments, settings, asked, wants, stopped)
    show(replayed, describe(replayed), as_json=arguments.json)
    sys.stdout.flush()
    code = end_with(asked.faults)
    if halt is not None:
        raise halt
    if not replayed.sent and not replayed.failed and replayed.ended == "end":
        raise CommandError(NOTHING)
    return int(ExitCode.PARTIAL) if replayed.failed or replayed.was_alone else code


def _replay(
    arguments: argparse.Namespace, settings: Settings, asked: Asked, wants: Wants, stopped: Callable[[], bool]
) -> tuple[Replayed, CommandError | None]:
    root = arguments.root
    if re.fullmatch(keys.ROOT_PATTERN, root) is None:
        raise CommandError(f"{root!a} cannot be a root: it is {keys.ROOT_PATTERN}", ExitCode.USAGE)
    # Faults are reported when the rows are read.
    topics = survey(asked.logs, Faults()).topics.values()
    roots = roots_of(topics)
    _check_root(root, {*roots, settings.robot.root}, is_forced=arguments.force)
    samples = Samples(KeyMap(root, roots), wants, asked.faults)
    selection = Selection(lambda topic: may_hold(topic, wants), asked.from_ns, asked.to_ns)
    faults = [asked.faults]

    def read() -> Iterator[ReplaySample]:
        # Faults are reported once, not in every loop.
        rows = read_rows(asked.logs, selection, faults.pop() if faults else Faults())
        return samples.of(runs(once(rows) if len(asked.logs) > 1 else rows))

    if not any(may_hold(topic, wants) for topic in topics):
        raise CommandError(NOTHING)
    pace = Pace(arguments.speed)
    with closing(ZenohOutlet(settings.zenoh, root, waits=not pace.speed)) as outlet:
        _meet(outlet, root, arguments.timeout, stopped)
        if not outlet.wait_for_subscriber(arguments.timeout, stopped) and not stopped():
            _tell(f"no subscriber of {root}/** yet")
        _tell(f"{len(asked.logs)} logs to {root}/**")
        begun_s = time.monotonic()
        played = play(read, pace, outlet, stopped, loops=arguments.loop, is_now=arguments.now)
    replayed = Replayed(
        to=f"{root}/**",
        sent=outlet.sent,
        failed=outlet.failed,
        withheld={"commands, and invalid keys or encodings": samples.withheld} if samples.withheld else {},
        loops=played.loops,
        took_s=round(time.monotonic() - begun_s, 3),
        lateness_max_ms=played.late_ns / 1e6,
        slipped_s=played.slipped_ns / 1e9,
        pauses_cut=pace.cut,
        # With --listen, viewers come and go.
        was_alone=outlet.was_alone and not outlet.listen,
        ended=str(played.halt) if played.halt else "end" if played.has_ended else "stopped",
    )
    return replayed, played.halt


def _check_root(root: str, others: set[str], *, is_forced: bool) -> None:
    """Refuse a root that may be a robot's, unless forced."""
    for other in sorted(others):
        # A recorded replay is no robot.
        is_replay = f"{other}/".startswith(f"{DEFAULT_ROOT}/")
        if overlap(root, other) and not is_replay and not is_forced:
            raise CommandError(
                f"a replay under {root} would be mistaken for a robot: robots are under {other}, in the log or by "
                f"the settings; omit --root (default {DEFAULT_ROOT}), or use --force",
                ExitCode.REFUSED,
            )


def _meet(outlet: ZenohOutlet, root: str, timeout_s: float, stopped: Callable[[], bool]) -> None:
    """Wait for a node or a subscriber, and check that no gateway is under this root."""
    if outlet.listen:
        _tell(f"waiting for a subscriber of {root}/** at {', '.join(outlet.listen)}")
        outlet.wait_for_subscriber(None, stopped)
    elif not outlet.wait_for_link(timeout_s, stopped) and not stopped():
        raise CommandError(
            f"no Zenoh node answered within {timeout_s:g} s; use --listen {DEFAULT_ENDPOINT} to accept them",
            ExitCode.UNREACHABLE,
        )
    halt = outlet.find_gateway()
    if halt is not None:
        raise halt


def describe(replayed: Replayed) -> Iterator[str]:
    rate = replayed.sent / replayed.took_s if replayed.took_s else 0
    yield f"{replayed.to}: {replayed.sent} sent in {replayed.took_s:.1f} s, {rate:.0f}/s"
    if replayed.failed:
        yield f"  {replayed.failed} could not be published"
    yield from (f"  {count} withheld: {why}" for why, count in replayed.withheld.items())
    if replayed.lateness_max_ms:
        yield f"  lateness: at most {replayed.lateness_max_ms:.1f} ms"
    if replayed.slipped_s:
        yield f"  delayed by {replayed.slipped_s:.1f} s"
    if replayed.pauses_cut:
        yield f"  {replayed.pauses_cut} pauses of the log were shortened"
    if replayed.was_alone:
        yield "  at times no Zenoh node was connected, and samples were lost"
    if replayed.loops > 1:
        yield f"  {replayed.loops} times"


def _tell(text: str) -> None:
    sys.stderr.write(f"replay: {plain(text)}\n")


def _speed(text: str) -> float:
    if text == "max":
        return AS_FAST_AS_POSSIBLE
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not SPEED_MIN <= value <= SPEED_MAX:
        raise argparse.ArgumentTypeError(
            f"{text!r} is no speed: use a number from {SPEED_MIN} to {SPEED_MAX:g}, or 'max'"
        )
    return value


def _loops(text: str) -> int:
    return FOR_EVER if text == "forever" else whole_number(1, 2**31 - 1)(text)
